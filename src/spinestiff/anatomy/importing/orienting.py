"""Unit, axes and order of a set of bones, told by the bones themselves; what contradicts them is refused.

The skeleton's size tells millimetres from metres (they differ a thousandfold); pelvis to T1 is up, right-named to
left-named bones is left, thoracic spine to sternum is forward.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import permutations

import numpy as np

from spinestiff.anatomy.names import BONES, GIRDLE, RIBS, THORACIC, VERTEBRAE
from spinestiff.anatomy.template import template_torso
from spinestiff.anatomy.template.surfaces import Surface
from spinestiff.arrays import Floats
from spinestiff.errors import TorsoError

UNITS = {"mm": 1.0, "cm": 10.0, "m": 1000.0}
LETTERS = {
    "L": (1, 0, 0), "R": (-1, 0, 0), "S": (0, 1, 0), "I": (0, -1, 0), "A": (0, 0, 1), "P": (0, 0, -1),
}  # fmt: skip
VERTEBRA_MM = (35.0, 160.0)  # diagonal of a vertebra's bounding box, child to large adult
MOST_OFF_DEG = 35.0
# A bone's size over the template's, beside the median over all bones.
SIZE_RANGE = (0.35, 3.0)
WHOLE_HUMERUS = 12.0  # the template's is a stump
# Of the template's half pelvis, at the bones' size, how far a pelvis reaches to either side of L5; a sacrum: 0.34.
LEAST_HALF_PELVIS = 0.6
LARGEST_SKIN = 5.0  # diagonal over that of all bones together: 1.2 of a torso's skin, 3 of a whole body's


@dataclass(frozen=True)
class Placement:
    """How the files' coordinates become the world's: ``world = scale * world_from_file @ file``.

    Attributes
    ----------
    unit : "mm", "cm" or "m". axes : where the file's x, y, z point, e.g. "ASR" = anterior, superior, right.
    told : which of "unit", "axes" the user gave.
    """

    unit: str
    axes: str
    told: tuple[str, ...]

    @property
    def world_from_file(self) -> Floats:
        """(3, 3) mm per unit of the file."""
        return UNITS[self.unit] * axes_matrix(self.axes)

    def __str__(self) -> str:
        def source(what: str) -> str:
            return "as told" if what in self.told else "found"

        words = {"L": "left", "R": "right", "S": "up", "I": "down", "A": "front", "P": "back"}
        axes = ", ".join(f"{name} to the {words[a]}" if words[a] not in ("up", "down") else f"{name} {words[a]}"
                         for name, a in zip("xyz", self.axes))  # fmt: skip
        return f"unit {self.unit} ({source('unit')}), axes {self.axes}: {axes} ({source('axes')})"


def axes_matrix(axes: str) -> Floats:
    """(3, 3) world_from_file rotation of three letters, e.g. "LPS".

    Raises
    ------
    TorsoError : not one letter of each pair L/R, S/I, A/P, or a left-handed order.
    """
    word = axes.upper()
    if len(word) != 3 or any(letter not in LETTERS for letter in word):
        raise TorsoError(
            f"axes '{axes[:12]}': wanted three letters of L/R, S/I, A/P: where the file's x, y and z point"
        )
    matrix = np.array([LETTERS[letter] for letter in word], dtype=float).T
    sense = round(float(np.linalg.det(matrix)))
    if sense == 0:
        raise TorsoError(f"axes '{axes}': two of them lie along one line; wanted one of L/R, one of S/I, one of A/P")
    if sense < 0:
        raise TorsoError(f"axes '{axes}' are left-handed; a file in them shows the mirror image of the patient")
    return matrix


def find_placement(bones: Mapping[str, Surface], unit: str | None = None, axes: str | None = None) -> Placement:
    """Unit and axes of 49 bones in their files' coordinates; ``unit`` and ``axes`` are what the user says of them.

    Raises
    ------
    TorsoError : what the user says, the names or one bone's size contradict the others.
    """
    if unit is not None and unit not in UNITS:
        raise TorsoError(f"unit '{unit[:12]}'; wanted {', '.join(UNITS)}")
    told = tuple(key for key, value in (("unit", unit), ("axes", axes)) if value is not None)
    size = {name: float(np.linalg.norm(np.ptp(vertices, axis=0))) for name, (vertices, _) in bones.items()}
    found = _unit(size)
    if unit is not None and unit != found:
        raise TorsoError(
            f"in {unit} a vertebra would measure {np.median([size[v] for v in VERTEBRAE]) * UNITS[unit]:.3g} mm "
            f"across; the files look like {found}"
        )
    typical = _refuse_other_sizes(size)
    middle = {name: 0.5 * (vertices.min(0) + vertices.max(0)) for name, (vertices, _) in bones.items()}
    seen = _directions(middle)
    _refuse_half_a_pelvis((bones["pelvis"][0] - middle["L5"]) @ seen[0], typical, UNITS[found])
    if axes is None:
        axes = _nearest_axes(seen)
    matrix = axes_matrix(axes)
    off = np.degrees(np.arccos(np.clip(np.einsum("ij,ij->i", seen, matrix), -1.0, 1.0)))
    if "axes" in told and off.max() > 60.0:
        raise TorsoError(f"axes {axes} contradict the bones' names and places, which look like {_nearest_axes(seen)}")
    _refuse_disorder({name: matrix @ at for name, at in middle.items()})
    return Placement(found, axes.upper(), told)


def _unit(size: Mapping[str, float]) -> str:
    typical = float(np.median([size[name] for name in VERTEBRAE]))
    for unit, factor in UNITS.items():
        if VERTEBRA_MM[0] <= typical * factor <= VERTEBRA_MM[1]:
            return unit
    raise TorsoError(
        f"a vertebra measures {typical:.3g} across, which is none in {', '.join(UNITS)} "
        f"(wanted {VERTEBRA_MM[0]:g} to {VERTEBRA_MM[1]:g} mm); convert the files"
    )


def _refuse_other_sizes(size: Mapping[str, float]) -> float:
    # The bones' size in the file's unit over the template's in mm, the median.
    torso = template_torso(157.0)
    usual = {name: float(np.linalg.norm(np.ptp(s.vertices, axis=0))) for name, s in zip(BONES, torso.bone_surfaces)}
    ratio = {name: size[name] / usual[name] for name in BONES}
    typical = float(np.median(list(ratio.values())))
    for name in BONES:
        share = ratio[name] / typical
        most = WHOLE_HUMERUS if name.startswith("humerus") else SIZE_RANGE[1]
        if not SIZE_RANGE[0] <= share <= most:
            factor = max(share, 1.0 / share)
            why = "mm against m?" if 300.0 < factor < 3000.0 else "mm against cm?" if 6.0 < factor < 20.0 else "whose?"
            large = "large" if share > 1.0 else "small"
            raise TorsoError(f"{name} is {factor:.3g} times too {large} beside the other bones ({why})")
    return typical


def _refuse_half_a_pelvis(left: Floats, typical: float, mm: float) -> None:
    # ``left`` (n,) of its vertices, how far left of L5 they lie, in the file's unit, which has ``mm``.
    torso = template_torso(157.0)
    whole = typical * 0.5 * float(np.ptp(torso.bone_surfaces[torso.bone("pelvis")].vertices[:, 0]))
    for side, reach in (("left", float(left.max())), ("right", -float(left.min()))):
        if reach < LEAST_HALF_PELVIS * whole:
            raise TorsoError(
                f"pelvis reaches {reach * mm:.0f} mm to the {side} of L5, wanted some {whole * mm:.0f} mm as the other "
                f"bones are; is the {side} hip bone part of it?"
            )


def refuse_large_skin(name: str, skin: Surface, bones: Mapping[str, Surface]) -> None:
    """Raise TorsoError, naming the file, for a skin in another unit than the bones, all as they stand in the files."""
    all_bones = np.vstack([vertices for vertices, _ in bones.values()])
    share = float(np.linalg.norm(np.ptp(skin[0], axis=0)) / np.linalg.norm(np.ptp(all_bones, axis=0)))
    if share > LARGEST_SKIN:
        raise TorsoError(f"{name} is {share:.3g} times as large as all bones together; wanted a skin in their unit")


def _directions(middle: Mapping[str, Floats]) -> Floats:
    # (3, 3) rows: left, up, forward in the files' axes.
    def mean(names: tuple[str, ...]) -> Floats:
        return np.mean([middle[name] for name in names], axis=0)

    pairs = [name[:-2] for name in (*RIBS, *GIRDLE) if name.endswith("_L")]
    left = np.median([middle[f"{name}_L"] - middle[f"{name}_R"] for name in pairs], axis=0)
    up = mean(VERTEBRAE[:6]) - 0.5 * (mean(VERTEBRAE[-4:]) + middle["pelvis"])
    forward = middle["sternum"] - mean(THORACIC[2:9])
    directions = np.array([left, up, forward])
    if (np.linalg.norm(directions, axis=1) < 1e-9).any():
        raise TorsoError("the bones lie on top of each other: each file must hold its bone where it is in the body")
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    directions[2] -= (directions[2] @ directions[1]) * directions[1]
    directions[2] /= np.linalg.norm(directions[2])
    return directions


def _nearest_axes(seen: Floats) -> str:
    letters = [tuple(pair[0] if s > 0 else pair[1] for pair, s in zip(("LR", "SI", "AP"), signs)) for signs in _SIGNS]
    best, code = -np.inf, ""
    for choice in letters:
        for order in permutations(choice):
            matrix = np.array([LETTERS[letter] for letter in order], dtype=float).T
            if (score := float(np.sum(seen * matrix))) > best:
                best, code = score, "".join(order)
    matrix = np.array([LETTERS[letter] for letter in code], dtype=float).T
    off = np.degrees(np.arccos(np.clip(np.einsum("ij,ij->i", seen, matrix), -1.0, 1.0)))
    if np.linalg.det(matrix) < 0.0:
        raise TorsoError(
            f"going by the names, the axes would be {code}, which is left-handed: left and right are swapped in the "
            "names, or the meshes are mirrored"
        )
    if off.max() > MOST_OFF_DEG:
        raise TorsoError(
            f"the bones lie {off.max():.0f} degrees off the files' axes (nearest: {code}); turn them, or give --axes"
        )
    return code


_SIGNS = [(a, b, c) for a in (1, -1) for b in (1, -1) for c in (1, -1)]


def _refuse_disorder(middle: Mapping[str, Floats]) -> None:
    # ``middle`` in world axes.
    column = (*VERTEBRAE, "pelvis")
    for upper, lower in zip(column, column[1:]):
        if middle[upper][1] <= middle[lower][1]:
            raise TorsoError(f"{upper} lies below {lower}; are their names swapped?")
    for name in (*RIBS, *GIRDLE):
        if name.endswith("_L") and middle[name][0] <= middle[f"{name[:-1]}R"][0]:
            raise TorsoError(f"{name} lies to the right of {name[:-1]}R; are their names swapped?")
