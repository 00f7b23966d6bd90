"""What was learnt of the model's discrepancy, kind by kind, as shipped; and which of it an estimate expects.

The data (``data/discrepancy.npz``, docs/discrepancy.md) come from pairs of the model and a variant of it at equal true
ratios; a kind of variant is another mesh, other joints, other tissue and so on. A difference of motion, divided by the
size of the model's own motion, is a vector over push site, vertebra and channel. Its second moments, kind by kind, each
for the share of people who have it, are added up to a few modes and a remainder of each entry by itself, which
``estimation.discrepancy`` makes a covariance of.
"""

from __future__ import annotations

import json
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from importlib.resources import as_file, files
from io import BytesIO
from pathlib import Path
from types import MappingProxyType
from typing import Any
from zipfile import BadZipFile

import numpy as np

from spinestiff.anatomy.names import VERTEBRAE
from spinestiff.anatomy.template import Mesh
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.arrays import ByFields, Floats, ShortRepr, read_only
from spinestiff.errors import FitError
from spinestiff.estimation.discrepancy import CHANNELS, HIGHEST_LEVEL, LOWEST_LEVEL, SIDES, DiscrepancyModes
from spinestiff.files import regular_file, write_bytes

SCHEMA = "spinestiff-discrepancy"
SCHEMA_VERSION = 2
# By the mesh that an estimate ends on, the kinds that it expects, and of how many people each. Everybody has a body of
# their own, and differs from a mesh as another mesh of its size does; other laws of discs and tissue are expected of
# one in seven each. Not here are kinds that are among an estimate's own unknowns (``unknowns``: ribs, volume, depth),
# nor the wall: whether a back may leave it is a choice of the model, which no covariance makes up for
# (docs/discrepancy.md).
LAWS = dict.fromkeys(("disc centres", "stiffening", "layers"), 1.0 / 7.0)
EXPECTED: Mapping[Mesh, Mapping[str, float]] = {
    "coarse": {"body": 1.0, "other mesh": 1.0, **LAWS},
    "fine": {"body": 1.0, "other fine mesh": 1.0, **LAWS},
}
MODES = 40  # of a covariance
# The kind whose models have a geometry that personalisation found from marked corners, and these corners' sd, mm.
GEOMETRY, GEOMETRY_MM = "geometry", 0.5
# A stance that nobody was told does to a geometry's motions what corners do that are off by so much, mm
# (``benchmarks/discrepancy_stance.py``).
STANCE_MM = 0.3
FINE_NODES = 6000
LARGEST_ENTRY = 100.0  # of a mode or remainder, over the size of the motion; no data of this kind have it


@dataclass(frozen=True, repr=False)
class KindModes(ByFields, ShortRepr):
    """What was learnt from one kind of variant, relative to the size of the model's motion.

    Attributes
    ----------
    pairs : how many there were.
    modes : (K, 2, S, 17, 3) of unit variance each: left and right sites, T1 to L5, channels in mm (turns times
        ``TURN_ARM_MM``) per mm of the motion's size.
    remainder : (2, S, 17, 3) standard deviation of what the modes leave.
    own_share : of the variance, what two frames of one push do not share.

    Raises
    ------
    FitError : wrong shapes, values out of range.
    """

    pairs: int
    modes: Floats
    remainder: Floats
    own_share: float

    def __post_init__(self) -> None:
        set_ = object.__setattr__
        shape = (len(SIDES), None, len(VERTEBRAE), len(CHANNELS))
        remainder = read_only("remainder", self.remainder, shape, FitError)
        set_(self, "remainder", remainder)
        set_(self, "modes", read_only("modes", self.modes, (None, *remainder.shape), FitError))
        if (remainder < 0.0).any():
            raise FitError("a remainder is negative")
        for what, values in (("mode", self.modes), ("remainder", remainder)):
            if np.abs(values).max(initial=0.0) > LARGEST_ENTRY:
                raise FitError(f"a {what} has an entry above {LARGEST_ENTRY:g}")
        if not 0.0 <= self.own_share <= 1.0:
            raise FitError(f"own share {self.own_share:g}; wanted 0 to 1")

    @property
    def moment(self) -> Floats:
        """(n, n) second moment over (side, site, vertebra, channel)."""
        flat = self.modes.reshape(len(self.modes), -1)
        return np.asarray(flat.T @ flat + np.diag(self.remainder.ravel() ** 2))


@dataclass(frozen=True, repr=False)
class DiscrepancyData(ByFields, ShortRepr):
    """All that was learnt.

    Attributes
    ----------
    levels : (S,) rib levels of the learnt sites, rising; each was learnt on the left and on the right.
    kinds : by name.
    inflation : of the kinds' second moments together, so that a kind that was not learnt is covered, too.
    untried : variance in shapes that no kind has, over the variance of those that they have, at each entry.
    made : date and hash of the code that made them.

    Raises
    ------
    FitError : levels out of order, another number of sites in a kind, values out of range.
    """

    levels: Floats
    kinds: Mapping[str, KindModes]
    inflation: float
    untried: float
    made: str = ""

    def __post_init__(self) -> None:
        set_ = object.__setattr__
        set_(self, "levels", read_only("levels", self.levels, (None,), FitError))
        set_(self, "kinds", MappingProxyType(dict(self.kinds)))
        inside = (self.levels >= LOWEST_LEVEL) & (self.levels <= HIGHEST_LEVEL)
        if not len(self.levels) or not inside.all() or (np.diff(self.levels) <= 0.0).any():
            raise FitError(f"levels {self.levels.tolist()}; wanted rising rib numbers from 1 to 12")
        for name, kind in self.kinds.items():
            if kind.remainder.shape[1] != len(self.levels):
                raise FitError(f"'{name}' has {kind.remainder.shape[1]} sites a side, wanted {len(self.levels)}")
        for what, value in (("inflation", self.inflation), ("untried", self.untried)):
            if not 0.0 <= value <= LARGEST_ENTRY:
                raise FitError(f"{what} {value:g}; wanted 0 to {LARGEST_ENTRY:g}")

    def combined(self, shares: Mapping[str, float]) -> DiscrepancyModes:
        """The covariance of people of whom each kind has its share (``EXPECTED``), independent of the others.

        Raises
        ------
        FitError : no kind, or one that was not learnt.
        """
        for name in shares:
            if name not in self.kinds:
                raise FitError(f"no discrepancy of the kind '{name}'; known are {', '.join(self.kinds)}")
        if not shares:
            raise FitError("a discrepancy of no kind; name one at least")
        kinds = [self.kinds[name] for name in shares]
        moments = [share * kind.moment for share, kind in zip(shares.values(), kinds)]
        moment = self.inflation * np.sum(moments, axis=0)
        sizes = np.array([np.trace(own) for own in moments])
        own = float(sizes @ [kind.own_share for kind in kinds] / max(sizes.sum(), 1e-300))
        shape = kinds[0].remainder.shape
        values, vectors = np.linalg.eigh(moment)
        modes = (np.sqrt(np.maximum(values, 0.0)) * vectors).T[::-1][:MODES]
        diagonal = np.diag(moment)
        left = np.maximum(diagonal - np.sum(modes**2, axis=0), 0.0) + self.untried * diagonal
        return DiscrepancyModes(self.levels, modes.reshape(-1, *shape), np.sqrt(left).reshape(shape), own)


def write_data(path: Path, data: DiscrepancyData) -> None:
    """Write what was learnt; the same data give the same bytes.

    Raises
    ------
    FitError : the file can't be written.
    """
    header = {"schema": SCHEMA, "schema_version": SCHEMA_VERSION, "made": data.made, "kinds": list(data.kinds)}
    header |= {"inflation": data.inflation, "untried": data.untried}
    header |= {"pairs": [kind.pairs for kind in data.kinds.values()]}
    header |= {"own_shares": [kind.own_share for kind in data.kinds.values()]}
    arrays: dict[str, Any] = {"header": np.array(json.dumps(header)), "levels": data.levels}
    for number, kind in enumerate(data.kinds.values()):
        arrays |= {f"{key}_{number}": getattr(kind, key).astype(np.float32) for key in ("modes", "remainder")}
    stream = BytesIO()
    np.savez_compressed(stream, **arrays)
    write_bytes(Path(path), stream.getvalue(), FitError)


def read_data(path: Path) -> DiscrepancyData:
    """What ``write_data`` wrote.

    Raises
    ------
    FitError : no such file, another schema version, or damaged content.
    """
    regular_file(Path(path), FitError)
    try:
        with open(path, "rb") as stream, np.load(stream, allow_pickle=False) as stored:
            arrays = {key: stored[key] for key in stored.files}
        header = json.loads(str(arrays["header"]))
        schema, version = header["schema"], header["schema_version"]
        if schema != SCHEMA or version != SCHEMA_VERSION:
            raise FitError(f"schema '{schema}' version {version}, wanted '{SCHEMA}' version {SCHEMA_VERSION}")
        told = zip(header["kinds"], header["pairs"], header["own_shares"])
        kinds = {
            str(name): KindModes(int(pairs), arrays[f"modes_{number}"], arrays[f"remainder_{number}"], float(own))
            for number, (name, pairs, own) in enumerate(told)
        }
        factors = float(header["inflation"]), float(header["untried"])
        return DiscrepancyData(arrays["levels"], kinds, *factors, str(header["made"]))
    except OSError as error:
        raise FitError(f"{path}: {(error.strerror or 'unreadable').lower()}; install spinestiff anew") from None
    except (FitError, BadZipFile, zlib.error, ValueError, EOFError, KeyError, TypeError, AttributeError) as error:
        why = " ".join(str(error).split()) or type(error).__name__
        raise FitError(f"{path} holds no discrepancy that can be read ({why}); install spinestiff anew") from None


@lru_cache(maxsize=1)
def shipped_data() -> DiscrepancyData:
    """What comes with the package.

    Raises
    ------
    FitError : missing or damaged data.
    """
    with as_file(files("spinestiff.estimation") / "data" / "discrepancy.npz") as path:
        return read_data(path)


@lru_cache(maxsize=len(EXPECTED))
def shipped_modes(mesh: Mesh) -> DiscrepancyModes:
    """The covariance for an estimate that ends on the "coarse" or on the "fine" mesh.

    Raises
    ------
    FitError : an unknown mesh, or data that are missing or damaged.
    """
    if mesh not in EXPECTED:
        raise FitError(f"unknown tissue mesh '{mesh}'; known are {', '.join(EXPECTED)}")
    return shipped_data().combined(EXPECTED[mesh])


def modes_of(torso: TorsoModel) -> DiscrepancyModes | None:
    """What was learnt for a torso's mesh; None for one of other vertebrae than T1 to L5."""
    return None if torso.vertebrae != VERTEBRAE else shipped_modes(mesh_size(torso))


def geometry_modes(torso: TorsoModel, corner_mm: float) -> DiscrepancyModes | None:
    """What a geometry that was found from corners of this standard deviation does to the motions, mm along an axis.

    It is part of the kind "body" of ``modes_of``; alone it is what another annotation brings. None for a torso of other
    vertebrae than T1 to L5.
    """
    if torso.vertebrae != VERTEBRAE:
        return None
    found, scale = shipped_data().combined({GEOMETRY: 1.0}), corner_mm / GEOMETRY_MM
    return replace(found, modes=scale * found.modes, remainder=scale * found.remainder)


def mesh_size(torso: TorsoModel) -> Mesh:
    """Which of the two meshes, for which something was learnt, a torso's tissue mesh has the size of."""
    return "coarse" if len(torso.tissue.rest_positions) < FINE_NODES else "fine"
