"""A three-point push as it is modelled: load and supports, which belong together (paper 2.1, 2.3, Eqs. 1-2)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from spinestiff.anatomy.names import RIBS
from spinestiff.anatomy.points import PointsOnBones
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.errors import TorsoError
from spinestiff.mechanics.contact import OneSidedProblem
from spinestiff.mechanics.equilibrium import EquilibriumProblem
from spinestiff.mechanics.loads import PUSH_DIRECTION, LoadCase, rib_load, three_point_reactions
from spinestiff.mechanics.result import Equilibrium
from spinestiff.mechanics.supports import PELVES, SupportKind, held_shoulder, three_point_supports

WALLS = ("bilateral", "one-sided")
LEAST_SPACING_MM = 5.0


@dataclass(frozen=True)
class Rig:
    """How pushes are held against.

    Attributes
    ----------
    pelvis : "level", "hinge" or "dead-loads" (``mechanics.supports.three_point_supports``). With dead loads F1 acts on
        the opposite shoulder and F2 on the pelvis' belt, as Eqs. 1-2 have them, beside F3.
    wall : "bilateral", it can pull, or "one-sided", it only pushes (``mechanics.contact``).

    Raises
    ------
    TorsoError : another word, or a one-sided wall with dead loads, which have none.
    """

    pelvis: str = "level"
    wall: str = "bilateral"

    def __post_init__(self) -> None:
        for what, found, known in (("pelvis", self.pelvis, PELVES), ("wall", self.wall, WALLS)):
            if found not in known:
                raise TorsoError(f"{what} '{found}'; wanted one of {', '.join(known)}")
        if self.pelvis == "dead-loads" and self.wall != "bilateral":
            raise TorsoError(f"wall '{self.wall}' with dead loads, which leave the wall out; wanted 'bilateral'")


@dataclass(frozen=True)
class PushSite:
    """Where the gauge pushes, and the distances of Eqs. 1-2.

    Attributes
    ----------
    side : "left" or "right", the patient's. level : rib number (``mechanics.loads.rib_push``).
    d21_mm, d31_mm : from the shoulder downward to pelvis and push; only dead loads need them. None: not known.
    """

    side: str
    level: float
    d21_mm: float | None = None
    d31_mm: float | None = None


@dataclass(frozen=True)
class SupportForces:
    """What holds a torso against a push, as loads or as reactions, in world axes.

    Attributes
    ----------
    shoulder, pelvis : lateral force on the torso, N, along +x.
    pelvis_moment : N mm about the pelvis' AP axis, +z.
    wall_pull : N, the most that the wall pulls at one of its points; 0 where it only pushes.
    """

    shoulder: float
    pelvis: float
    pelvis_moment: float
    wall_pull: float


def push_problem(torso: TorsoModel, side: str, rig: Rig) -> EquilibriumProblem:
    """The torso as it is held against pushes on ``side``. Raises TorsoError for an unknown side."""
    kind = OneSidedProblem if rig.wall == "one-sided" else EquilibriumProblem
    return kind(torso, three_point_supports(torso, side, rig.pelvis))


def push_load(torso: TorsoModel, site: PushSite, force_n: float, rig: Rig, label: str = "") -> LoadCase:
    """The forces that a push of ``force_n`` is modelled by.

    Raises
    ------
    TorsoError : unknown side, level outside 1-12, negative force, or, for dead loads, distances that are not known or
        none of Eqs. 1-2.
    """
    push = rib_load(torso, site.side, site.level, force_n, label=label)
    if rig.pelvis != "dead-loads":
        return push
    if site.d21_mm is None or site.d31_mm is None:
        raise TorsoError(f"{label or 'a push'}: d21 or d31 is not known; dead loads at shoulder and pelvis need both")
    f1, f2 = three_point_reactions(force_n, site.d21_mm, site.d31_mm)
    parts = (push.points, held_shoulder(torso, site.side), torso.landmark("pelvis_belt"))
    points = PointsOnBones(np.concatenate([p.bone for p in parts]), np.concatenate([p.offset for p in parts]))
    against = np.zeros((2, 3))
    against[:, 0] = -PUSH_DIRECTION[site.side] * np.array([f1, f2])
    return LoadCase(points, np.vstack([push.forces, against]), label, against=len(against))


def push_heights(torso: TorsoModel, side: str, level: float) -> tuple[float, float, float]:
    """Heights of the held shoulder, the pelvis and the point of a push at rest, mm."""
    rest, marks = torso.rest_pose, torso.landmarks
    load = rib_load(torso, side, level, 1.0)
    share = np.abs(load.forces[:, 0])
    return (
        float(held_shoulder(torso, side).positions(rest)[0, 1]),
        float(marks["pelvis_belt"].positions(rest)[0, 1]),
        float(share @ load.points.positions(rest)[:, 1]),
    )


def raised_level(torso: TorsoModel, side: str, level: float, mm: float) -> tuple[float, float]:
    """Rib level of the point ``mm`` above that of a push at ``level``, and how far it rises, mm.

    Nothing lies above rib 1 or below rib 12, where it stops. Rib 12 may reach as high as rib 11: from level to level a
    point is taken to lie lower by ``LEAST_SPACING_MM`` at least.
    """
    levels = np.arange(1.0, 13.0)
    rows = [RIBS.index(f"R{i:.0f}_{side[0].upper()}") for i in levels]
    floor = LEAST_SPACING_MM * levels
    down = np.maximum.accumulate(-torso.landmark("rib_lateral")[rows].positions(torso.rest_pose)[:, 1] - floor) + floor
    here = float(np.interp(level, levels, down))
    there = float(np.clip(here - mm, down[0], down[-1]))
    return float(np.interp(there, down, levels)), here - there


def support_forces(torso: TorsoModel, load: LoadCase, equilibrium: Equilibrium) -> SupportForces:
    """What shoulder, pelvis and wall do in an equilibrium under ``load``, whose forces on them count as theirs."""
    pelvis = torso.bone("pelvis")
    shoulders = torso.landmark("humerus_head").bone
    held = next(r for r in equilibrium.reactions if r.kind is SupportKind.HELD and r.name == "pelvis")
    shoulder = sum(r.force[0] for r in equilibrium.reactions if r.kind is SupportKind.SHOULDER)
    pulls = [-r.force[2] for r in equilibrium.reactions if r.kind is SupportKind.WALL]
    loads, at = load.forces, load.points
    moments = np.cross(at.positions(equilibrium.state) - equilibrium.state.bone_positions[pelvis], loads)
    return SupportForces(
        float(shoulder + loads[np.isin(at.bone, shoulders), 0].sum()),
        float(held.force[0] + loads[at.bone == pelvis, 0].sum()),
        float(held.moment[2] + moments[at.bone == pelvis, 2].sum()),
        max(0.0, *map(float, pulls)) if pulls else 0.0,
    )
