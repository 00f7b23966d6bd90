"""A torso in one file: npz without pickles, with a schema version inside."""

from __future__ import annotations

import json
import zlib
from io import BytesIO
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np

from spinestiff.anatomy.points import PointsOnBones
from spinestiff.anatomy.state import TorsoState
from spinestiff.anatomy.torso import BoneSurface, JointTable, TissueMesh, TorsoModel
from spinestiff.errors import TorsoError
from spinestiff.files import regular_file, write_bytes

SCHEMA = "spinestiff-torso"
SCHEMA_VERSION = 1
MAKERS = "spinestiff personalise and torso import"
_JOINT_FIELDS = ("parent", "child", "parent_position", "parent_axes", "child_position", "child_axes", "stiffness")
_TISSUE_FIELDS = ("rest_positions", "elements", "bone_of_node", "lame_mu", "lame_lambda")
_STATE_FIELDS = ("bone_positions", "bone_rotations", "tissue_positions")
_COORDINATES = ("rest_bone_positions", "rest_tissue_positions", "tissue_rest_positions", "surface_vertices")
# Of a damaged or encrypted archive, of arrays of an impossible size or type, of parts that are missing or don't fit.
_UNREADABLE = (
    BadZipFile, zlib.error, ValueError, EOFError, LookupError, TypeError, AttributeError, MemoryError, RuntimeError
)  # fmt: skip
FARTHEST_MM = 10_000.0
"""Of a coordinate; no body reaches as far from where it stands."""


def write_torso(path: str | Path, torso: TorsoModel) -> None:
    """Write a torso; the same torso gives the same bytes.

    Raises
    ------
    TorsoError : the file can't be written.
    """
    header = {
        "schema": SCHEMA,
        "schema_version": SCHEMA_VERSION,
        "bone_names": torso.bone_names,
        "vertebrae": torso.vertebrae,
        "joint_names": torso.joints.names,
        "joint_kinds": torso.joints.kinds,
        "landmarks": sorted(torso.landmarks),
    }
    arrays: dict[str, Any] = {"header": np.array(json.dumps(header)), "height_cm": np.array(torso.height_cm)}
    arrays |= {f"joints_{key}": _compact(getattr(torso.joints, key)) for key in _JOINT_FIELDS}
    arrays |= {f"tissue_{key}": _compact(getattr(torso.tissue, key)) for key in _TISSUE_FIELDS}
    arrays |= {f"rest_{key}": _compact(getattr(torso.rest_pose, key)) for key in _STATE_FIELDS}
    arrays["vertebra_boxes"] = torso.vertebra_boxes
    for name, points in torso.landmarks.items():
        arrays |= {f"landmark_{name}_bone": _compact(points.bone), f"landmark_{name}_offset": points.offset}
    surfaces = torso.bone_surfaces
    arrays["surface_sizes"] = np.array([(len(s.vertices), len(s.faces)) for s in surfaces], dtype=np.int32).reshape(
        -1, 2
    )
    if surfaces:
        arrays["surface_vertices"] = np.vstack([s.vertices for s in surfaces])
        arrays["surface_faces"] = _compact(np.vstack([s.faces for s in surfaces]))
    stream = BytesIO()
    np.savez_compressed(stream, **arrays)
    write_bytes(Path(path), stream.getvalue(), TorsoError)


def read_torso(path: str | Path) -> TorsoModel:
    """Read a torso that ``write_torso`` wrote.

    Raises
    ------
    TorsoError : no such file, not a torso file, another schema version, or damaged content.
    """
    regular_file(Path(path), TorsoError)
    try:
        # Opened here: np.load leaves a damaged file open.
        with open(path, "rb") as stream:
            if stream.read(2) != b"PK":  # NumPy's words of other files advise to have code in them run
                raise TorsoError(f"{path} is no torso file, or it is damaged; name a torso.npz, as {MAKERS} write it")
            stream.seek(0)
            with np.load(stream, allow_pickle=False) as stored:
                if "header" not in stored.files:
                    raise TorsoError(f"{path} is no torso file; name a torso.npz, as {MAKERS} write it")
                arrays = {key: stored[key] for key in stored.files}
    except OSError as error:
        raise TorsoError(
            f"{path}: {(error.strerror or 'unreadable').lower()}; name a torso.npz, as {MAKERS} write it"
        ) from None
    except _UNREADABLE as error:
        raise TorsoError(f"{path} is no torso file, or it is damaged ({_one_line(error)})") from None
    header = _header(path, arrays)
    try:
        return _torso(header, arrays)
    except TorsoError as error:
        raise TorsoError(f"{path} is damaged: {error}") from None
    except _UNREADABLE as error:
        raise TorsoError(f"{path} is damaged: {_one_line(error)} is missing or unreadable") from None


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split()) or type(error).__name__


def _header(path: str | Path, arrays: dict[str, Any]) -> dict[str, Any]:
    try:
        header = json.loads(str(arrays["header"]))
        schema, version = header["schema"], header["schema_version"]
    except (ValueError, TypeError, KeyError, RecursionError):
        raise TorsoError(f"{path} is no torso file: its header can't be read") from None
    if schema != SCHEMA:
        raise TorsoError(f"{path} is no torso file: schema '{schema}', wanted '{SCHEMA}'")
    if version != SCHEMA_VERSION:
        raise TorsoError(f"{path} has torso schema version {version}; this program reads version {SCHEMA_VERSION}")
    return dict(header)


def _torso(header: dict[str, Any], arrays: dict[str, Any]) -> TorsoModel:
    complex_one = next((key for key, array in arrays.items() if array.dtype.kind == "c"), None)
    if complex_one is not None:
        raise TorsoError(f"{complex_one} holds complex numbers")
    places = [arrays[key] for key in _COORDINATES if key in arrays and arrays[key].dtype.kind == "f"]
    farthest = max((float(np.abs(array).max(initial=0.0)) for array in places), default=0.0)
    if farthest > FARTHEST_MM:
        raise TorsoError(f"found a coordinate of {farthest:.3g} mm, wanted at most {FARTHEST_MM:g}")
    joints = JointTable(
        _words(header, "joint_names"),
        _words(header, "joint_kinds"),
        **{key: arrays[f"joints_{key}"] for key in _JOINT_FIELDS},
    )
    tissue = TissueMesh(**{key: arrays[f"tissue_{key}"] for key in _TISSUE_FIELDS})
    rest = TorsoState(**{key: arrays[f"rest_{key}"] for key in _STATE_FIELDS})
    landmarks = {
        key: PointsOnBones(arrays[f"landmark_{key}_bone"], arrays[f"landmark_{key}_offset"])
        for key in _words(header, "landmarks")
    }
    return TorsoModel(
        bone_names=_words(header, "bone_names"),
        rest_pose=rest,
        joints=joints,
        tissue=tissue,
        vertebra_boxes=arrays["vertebra_boxes"],
        bone_surfaces=_surfaces(arrays),
        landmarks=landmarks,
        height_cm=float(arrays["height_cm"]),
        vertebrae=_words(header, "vertebrae"),
    )


def _words(header: dict[str, Any], key: str) -> tuple[str, ...]:
    words = header[key]
    if not (isinstance(words, list) and all(isinstance(word, str) for word in words)):
        raise TorsoError(f"{key} is no list of words")
    return tuple(words)


def _surfaces(arrays: dict[str, Any]) -> tuple[BoneSurface, ...]:
    sizes = arrays["surface_sizes"]
    if not len(sizes):
        return ()
    vertices, faces = arrays["surface_vertices"], arrays["surface_faces"]
    ends = np.cumsum(sizes, axis=0)
    if sizes.min() < 0 or tuple(ends[-1]) != (len(vertices), len(faces)):
        raise TorsoError("the sizes of the bones' surfaces don't add up to the vertices and faces there are")
    vertices, faces = np.split(vertices, ends[:-1, 0]), np.split(faces, ends[:-1, 1])
    return tuple(BoneSurface(v, f) for v, f in zip(vertices, faces))


def _compact(array: Any) -> Any:
    # Indices fit 32 bits; floats keep all their digits.
    return array.astype(np.int32) if array.dtype.kind == "i" else array
