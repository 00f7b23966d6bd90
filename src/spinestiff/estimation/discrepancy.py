"""How far a person's spine may move from what the model says: a covariance learnt from variants of the model.

The shipped data (``data/discrepancy.npz``, docs/discrepancy.md) come from pairs of the model and a variant of it (another
mesh, other joints, other tissue, ...) at equal true ratios. A difference of motion, divided by the size of the model's
own motion, is a vector over push site, vertebra and channel; its second moment over the pairs is kept as a few modes and
a remainder of each entry by itself:

    truth - model = size * sum_s w_s (sum_k z_k phi_ks + r_s) + the frame's own part,

with w the weights of the learnt sites in a frame's site, z and r independent with unit and learnt variance. z belongs
to the person, so what pushes share stays shared.
"""

from __future__ import annotations

import json
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from importlib.resources import as_file, files
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal
from zipfile import BadZipFile

import numpy as np

from spinestiff.anatomy.names import VERTEBRAE
from spinestiff.arrays import Floats, ShortRepr, read_only
from spinestiff.errors import FitError
from spinestiff.files import regular_file, write_bytes
from spinestiff.imaging.features import picture_axes

if TYPE_CHECKING:
    from spinestiff.imaging.projection import XRayView

SCHEMA = "spinestiff-discrepancy"
SCHEMA_VERSION = 1
SIDES = ("left", "right")
Mesh = Literal["coarse", "fine"]
MESHES: tuple[Mesh, ...] = ("coarse", "fine")
# A turn counts as the shift, mm, that it gives a point at this distance: about that of a vertebra's corners.
TURN_ARM_MM = 20.0
CHANNELS = np.array([1.0, 1.0, TURN_ARM_MM])
# Mirroring turns a shift to the left into one to the right, and with it the sense of a turn.
MIRROR = np.array([-1.0, 1.0, -1.0])
LOWEST_LEVEL, HIGHEST_LEVEL = 1.0, 12.0
LARGEST_ENTRY = 100.0  # of a mode or remainder, over the size of the motion; no data of this kind have it


@dataclass(frozen=True, repr=False)
class DiscrepancyFrame(ShortRepr):
    """A loaded frame as the model has it.

    Attributes
    ----------
    side : "left" or "right", the patient's side that is pushed.
    level : rib level of the push, 1 to 12.
    motion : (17, 3) the model's own motion of T1 to L5 from its unloaded state: ``plane_motion``.

    Raises
    ------
    FitError : an unknown side, a level out of range, another number of vertebrae, a motion that is not finite.
    """

    side: str
    level: float
    motion: Floats

    def __post_init__(self) -> None:
        if self.side not in SIDES:
            raise FitError(f"push side '{self.side}'; wanted 'left' or 'right'")
        if not LOWEST_LEVEL <= self.level <= HIGHEST_LEVEL:
            raise FitError(f"push level {self.level:g}; wanted a rib number from 1 to 12")
        motion = read_only("motion of the vertebrae", self.motion, (len(VERTEBRAE), 3), FitError)
        object.__setattr__(self, "motion", motion)


@dataclass(frozen=True, repr=False)
class DiscrepancyModes(ShortRepr):
    """Learnt covariance of relative differences of motion.

    Attributes
    ----------
    levels : (S,) rib levels of the learnt sites, rising; each was learnt on the left and on the right.
    modes : (K, 2, S, 17, 3) of unit variance each: left and right sites, T1 to L5, channels in mm (turns times
        ``TURN_ARM_MM``) per mm of the motion's size.
    remainder : (2, S, 17, 3) standard deviation of what the modes leave, independent of entry to entry.
    own_share : standard deviation of a frame's own part over that of the part shared by the frames of a push.
    made : date and hash of the code that made them.

    Raises
    ------
    FitError : wrong shapes, levels out of order, values out of range.
    """

    levels: Floats
    modes: Floats
    remainder: Floats
    own_share: float
    made: str = ""

    def __post_init__(self) -> None:
        set_ = object.__setattr__
        set_(self, "levels", read_only("levels", self.levels, (None,), FitError))
        shape = (len(SIDES), len(self.levels), len(VERTEBRAE), len(CHANNELS))
        set_(self, "modes", read_only("modes", self.modes, (None, *shape), FitError))
        set_(self, "remainder", read_only("remainder", self.remainder, shape, FitError))
        inside = (self.levels >= LOWEST_LEVEL) & (self.levels <= HIGHEST_LEVEL)
        if not len(self.levels) or not inside.all() or (np.diff(self.levels) <= 0.0).any():
            raise FitError(f"levels {self.levels.tolist()}; wanted rising rib numbers from 1 to 12")
        if (self.remainder < 0.0).any():
            raise FitError("a remainder is negative")
        for what, values in (("mode", self.modes), ("remainder", self.remainder)):
            if np.abs(values).max(initial=0.0) > LARGEST_ENTRY:
                raise FitError(f"a {what} has an entry above {LARGEST_ENTRY:g}")
        if not 0.0 <= self.own_share <= 1.0:
            raise FitError(f"own share {self.own_share:g}; wanted 0 to 1")

    def weights(self, side: str, level: float) -> Floats:
        """(2, S) of the learnt sites in a push: linear between two levels, the outermost level's beyond it."""
        weights = np.zeros((len(SIDES), len(self.levels)))
        for site, unit in enumerate(np.eye(len(self.levels))):
            weights[SIDES.index(side), site] = np.interp(level, self.levels, unit)
        return weights


def plane_motion(rest: Floats, moved: Floats, view: XRayView) -> Floats:
    """(V, 3) motion of vertebrae in a picture: shift to the patient's left and upwards, mm at the patient plane, and
    turn from left towards up, rad, of the boxes ``rest`` and ``moved`` (V, 4, 2) mm (``imaging.features.Features.z``).
    """
    axes = np.stack(picture_axes(view), axis=1)
    a, b = rest @ axes, moved @ axes
    arms, turned = a - a.mean(axis=1, keepdims=True), b - b.mean(axis=1, keepdims=True)
    across = np.sum(arms[..., 0] * turned[..., 1] - arms[..., 1] * turned[..., 0], axis=1)
    along = np.sum(arms * turned, axis=(1, 2))
    return np.column_stack([b.mean(axis=1) - a.mean(axis=1), np.arctan2(across, along)])


def motion_size(motion: Floats) -> float:
    """mm, root mean square over the vertebrae of a motion (..., 3): shift and turn (times ``TURN_ARM_MM``) together."""
    return float(np.sqrt(np.mean(np.sum((np.asarray(motion) * CHANNELS) ** 2, axis=-1))))


def discrepancy_columns(frames: Sequence[DiscrepancyFrame], modes: DiscrepancyModes) -> Floats:
    """(F, 17, 3, K) C with C C^T the covariance of truth - model of the frames' motions.

    Rows are in the units of ``DiscrepancyFrame.motion`` (mm, mm, rad). Frames pushed at one site differ by the sizes of
    their motions and by their own part; those of other sites share what the modes share.
    """
    if not frames:
        return np.zeros((0, len(VERTEBRAE), 3, 0))
    weights = np.stack([modes.weights(frame.side, frame.level) for frame in frames])
    sizes = np.array([motion_size(frame.motion) for frame in frames])
    followed = np.einsum("f,fas,kasvc->fvck", sizes, weights, modes.modes)
    count, rows = len(frames), len(VERTEBRAE) * len(CHANNELS)
    shape = (count, len(VERTEBRAE), len(CHANNELS), -1)
    used = np.argwhere(weights.any(axis=0))
    # Between two sites, independent parts keep their variance.
    mixed = weights / np.linalg.norm(weights, axis=(1, 2), keepdims=True)
    left = [
        np.einsum("f,r,rq->frq", sizes * mixed[:, side, site], modes.remainder[side, site].ravel(), np.eye(rows))
        for side, site in used
    ]
    own = np.einsum("fg,fvck->fvcgk", modes.own_share * np.eye(count), followed)
    parts = [followed, *(part.reshape(shape) for part in left), own.reshape(shape)]
    return np.concatenate(parts, axis=-1) / CHANNELS[:, None]


def write_modes(path: Path, sets: dict[Mesh, DiscrepancyModes]) -> None:
    """Write the modes of each mesh; the same modes give the same bytes.

    Raises
    ------
    FitError : the file can't be written.
    """
    header = {"schema": SCHEMA, "schema_version": SCHEMA_VERSION, "made": {mesh: sets[mesh].made for mesh in MESHES}}
    arrays: dict[str, Any] = {"header": np.array(json.dumps(header))}
    for mesh in MESHES:
        found = sets[mesh]
        arrays |= {f"{mesh}_levels": found.levels, f"{mesh}_own_share": np.array(found.own_share)}
        arrays |= {f"{mesh}_{key}": getattr(found, key).astype(np.float32) for key in ("modes", "remainder")}
    stream = BytesIO()
    np.savez_compressed(stream, **arrays)
    write_bytes(Path(path), stream.getvalue(), FitError)


def read_modes(path: Path, mesh: Mesh) -> DiscrepancyModes:
    """The modes of a mesh from a file of ``write_modes``.

    Raises
    ------
    FitError : an unknown mesh, no such file, another schema version, or damaged content.
    """
    if mesh not in MESHES:
        raise FitError(f"unknown tissue mesh '{mesh}'; known are {', '.join(MESHES)}")
    regular_file(Path(path), FitError)
    try:
        with open(path, "rb") as stream, np.load(stream, allow_pickle=False) as stored:
            arrays = {key: stored[key] for key in stored.files}
        header = json.loads(str(arrays["header"]))
        schema, version = header["schema"], header["schema_version"]
        if schema != SCHEMA or version != SCHEMA_VERSION:
            raise FitError(f"schema '{schema}' version {version}, wanted '{SCHEMA}' version {SCHEMA_VERSION}")
        keys = ("levels", "modes", "remainder")
        own = float(arrays[f"{mesh}_own_share"])
        return DiscrepancyModes(*(arrays[f"{mesh}_{key}"] for key in keys), own, str(header["made"][mesh]))
    except OSError as error:
        raise FitError(f"{path}: {(error.strerror or 'unreadable').lower()}; install spinestiff anew") from None
    except (FitError, BadZipFile, zlib.error, ValueError, EOFError, KeyError, TypeError, AttributeError) as error:
        why = " ".join(str(error).split()) or type(error).__name__
        raise FitError(f"{path} holds no discrepancy that can be read ({why}); install spinestiff anew") from None


@lru_cache(maxsize=len(MESHES))
def shipped_modes(mesh: Mesh) -> DiscrepancyModes:
    """The modes that come with the package, for an estimate that ends on the "coarse" or on the "fine" mesh.

    Raises
    ------
    FitError : an unknown mesh, or data that are missing or damaged.
    """
    with as_file(files("spinestiff.estimation") / "data" / "discrepancy.npz") as path:
        return read_modes(path, mesh)
