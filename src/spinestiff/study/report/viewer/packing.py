"""A scene packed for a browser: names and numbers as JSON, arrays as base64.

Bones are stored once, in their own frames, and a state holds a position and a quaternion for each; the skin is the
tissue's boundary, with positions for each state.
"""

from __future__ import annotations

import base64
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from spinestiff.anatomy.names import RIBS, VERTEBRAE
from spinestiff.anatomy.state import TorsoState
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.arrays import Floats, Ints
from spinestiff.imaging.projection import XRayView
from spinestiff.study.report.viewer.scene import Beside, PushScene, Scene

SCENE_VERSION = 1
_LARGEST_INT16 = 32767


def scene_record(scene: Scene) -> dict[str, Any]:
    """The scene as JSON: names and numbers as they are, arrays as ``packed``.

    ``states`` holds every state once, the rest pose first; steps name them by number.
    """
    torso = scene.torso
    used, faces = skin_faces(torso)
    states = _States(torso, used)
    pushes = [_push_record(push, states) for push in scene.pushes]
    surfaces = torso.bone_surfaces
    offsets, ends = joint_points(torso)
    return {
        "version": SCENE_VERSION,
        "title": scene.title,
        "bones": [
            {
                "name": name,
                "kind": "vertebra" if name in VERTEBRAE else "rib" if name in RIBS else "other",
                "vertices": len(surfaces[i].vertices) if surfaces else 0,
                "faces": len(surfaces[i].faces) if surfaces else 0,
            }
            for i, name in enumerate(torso.bone_names)
        ],
        "vertices": packed(_stacked([s.vertices for s in surfaces]), "int16"),
        "faces": packed(_stacked([s.faces for s in surfaces]), "uint16"),
        "skin": packed(faces, "uint16" if len(used) <= 65535 else "uint32"),
        "joints": {"names": list(torso.joints.names), "bone": ends.tolist(), "offset": packed(offsets, "int16")},
        "states": states.record(),
        "pushes": pushes,
    }


def packed(array: Floats | Ints, kind: str) -> dict[str, Any]:
    """An array as base64 of little-endian numbers.

    "float32", "uint16" and "uint32" are stored as they are; "int16" is a real array over ``scale``, so that the
    largest magnitude is 32767: half a ``scale`` is the most that a number loses.
    """
    values = np.asarray(array)
    scale = 1.0
    if kind == "int16":
        scale = float(np.abs(values).max(initial=0.0)) / _LARGEST_INT16 or 1.0
        values = np.rint(values / scale)
    stored = values.astype(np.dtype(kind).newbyteorder("<"))
    data = base64.b64encode(np.ascontiguousarray(stored).tobytes()).decode()
    return {"type": kind, "shape": list(values.shape), "scale": scale, "data": data}


def unpacked(record: Mapping[str, Any]) -> Floats:
    """Inverse of ``packed``: float64."""
    stored = np.frombuffer(base64.b64decode(record["data"]), np.dtype(record["type"]).newbyteorder("<"))
    return stored.reshape(record["shape"]) * float(record["scale"])


def skin_faces(torso: TorsoModel) -> tuple[Ints, Ints]:
    """The tissue's boundary: its nodes (n,) among the mesh's, and its faces (S, 3) or (S, 6) among those."""
    used, corners = np.unique(torso.tissue.boundary_faces(), return_inverse=True)
    width = torso.tissue.elements.shape[1]
    return used, corners.reshape(-1, 6 if width == 10 else 3)


def joint_points(torso: TorsoModel) -> tuple[Floats, Ints]:
    """Each joint's centre on its parent: offsets (J, 3) mm in the bone's frame, and the bones (J,)."""
    return torso.joints.parent_position, torso.joints.parent


def _stacked(arrays: Iterable[Any]) -> Any:
    found = list(arrays)
    return np.vstack(found) if found else np.empty((0, 3))


class _States:
    """Collects states, each once, the rest pose first."""

    def __init__(self, torso: TorsoModel, skin: Ints) -> None:
        self.torso, self.skin = torso, skin
        self.known: list[TorsoState] = []
        self.number(torso.rest_pose)

    def number(self, state: TorsoState) -> int:
        for i, other in enumerate(self.known):
            if other is state:
                return i
        self.known.append(state)
        return len(self.known) - 1

    def record(self) -> dict[str, Any]:
        poses = [
            np.hstack([s.bone_positions, Rotation.from_matrix(s.bone_rotations).as_quat(canonical=True)])
            for s in self.known
        ]
        skins = [self.torso.node_positions(s)[self.skin] for s in self.known]
        return {"bones": packed(np.stack(poses), "float32"), "skin": packed(np.stack(skins), "int16")}


def _push_record(push: PushScene, states: _States) -> dict[str, Any]:
    return {
        "id": push.push,
        "side": push.side,
        "level": push.level,
        "view": _view_record(push.view),
        # Here and below, what a push, a frame or a step has nothing of is left out.
        **({"further": {name: _view_record(view) for name, view in push.further.items()}} if push.further else {}),
        "load": {
            "bone": push.load.points.bone.tolist(),
            "offset": _rounded(push.load.points.offset),
            "force": _rounded(push.load.forces, 7),
        },
        "supports": [
            {
                "name": support.name,
                "kind": str(support.kind),
                "bone": support.bone,
                "offset": _rounded(support.offset),
                "direction": None if support.direction is None else _rounded(support.direction),
            }
            for support in push.supports
        ],
        "frames": [
            {
                "frame": frame.frame,
                "force": frame.force_n,
                "role": frame.role,
                "vertebrae": list(frame.vertebrae),
                "measured": _rounded(frame.measured),
                "rmse": {name: round(value, 4) for name, value in frame.rmse_mm.items()},
                **_beside_record(frame.beside),
            }
            for frame in push.frames
        ],
        "models": {
            name: [
                {
                    "force": step.force_n,
                    "frame": step.frame,
                    "state": states.number(step.state),
                    "vertebrae": list(step.vertebrae),
                    "boxes": _rounded(step.boxes),
                    "reactions": _rounded(step.reactions),
                    **_beside_record(step.beside),
                }
                for step in steps
            ]
            for name, steps in push.models.items()
        },
    }


def _view_record(view: XRayView) -> dict[str, Any]:
    """The source and the patient plane: a point q of it lies at origin + q0 columns + q1 rows."""
    foot = view.source + view.source_to_patient * view.normal
    return {
        "source": _rounded(view.source),
        "origin": _rounded(foot),
        "columns": _rounded(view.detector_axes[0], 7),
        "rows": _rounded(view.detector_axes[1], 7),
    }


def _beside_record(beside: Beside) -> dict[str, Any]:
    found: dict[str, Any] = _points_record("pedicles", beside.pedicles) | _points_record("markers", beside.markers)
    if beside.outlines:
        found["outlines"] = {
            view: {
                "vertebrae": list(seen.vertebrae),
                "boxes": _rounded(seen.boxes),
                **_points_record("pedicles", seen.pedicles),
            }
            for view, seen in beside.outlines.items()
        }
    return found


def _points_record(key: str, points: Mapping[str, Floats]) -> dict[str, Any]:
    return {key: {name: _rounded(place) for name, place in points.items()}} if points else {}


def _rounded(array: Floats, decimals: int = 3) -> Any:
    # Plus zero: no minus zeros.
    return (np.round(array, decimals) + 0.0).tolist()
