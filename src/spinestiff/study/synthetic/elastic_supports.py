"""Supports that give: a belt that lets the pelvis turn and a pad that lets the shoulder move, as people are held."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from spinestiff.anatomy.points import PointsOnBones
from spinestiff.anatomy.state import TorsoState
from spinestiff.anatomy.stiffness import StiffnessRatios
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.errors import EquilibriumError, SubjectError
from spinestiff.mechanics.equilibrium import EquilibriumProblem
from spinestiff.mechanics.loads import PUSH_DIRECTION, LoadCase
from spinestiff.mechanics.places import SupportPlace, shifted_shoulder
from spinestiff.mechanics.result import Equilibrium
from spinestiff.mechanics.supports import SPRING_STIFFNESS, SupportKind, Supports, three_point_supports
from spinestiff.mechanics.terms import PointSprings
from spinestiff.parallel import in_parallel
from spinestiff.words import counted

PAD = SPRING_STIFFNESS[SupportKind.SHOULDER]
LARGEST_OBLIQUITY_DEG, LARGEST_SHOULDER_MM = 4.0, 4.0  # of subjects whose supports are drawn
FARTHEST_OBLIQUITY_DEG, FARTHEST_SHOULDER_MM = 20.0, 50.0  # that may be asked for
BELT_ARM_MM = 100.0  # from the pelvis' origin to each of the belt's two springs; only their moment matters
STILL = 1e5  # N/mm, of a pad that is to be at a place: 40 N move it by 0.4 um
UNCHANGED = 1e-4  # of a stiffness, between rounds; a soft torso under a large push gives tens of times as much
STEPS = (1 / 3, 2 / 3, 1.0)  # of push and places, the first time
MAX_ROUNDS = 20


@dataclass(frozen=True)
class SyntheticSupports:
    """How much a synthetic subject's supports give at the recipe's largest force, the way that the push moves them.

    Attributes
    ----------
    obliquity_deg : turn of the pelvis, 0 to 20; 0 holds it level.
    shoulder_mm : lateral motion of the held shoulder, 0 to 50; 0 leaves it to the pad of ``three_point_supports``.

    Raises
    ------
    SubjectError : one is outside its range.
    """

    obliquity_deg: float
    shoulder_mm: float

    def __post_init__(self) -> None:
        for what, value, most in (
            ("obliquity_deg", self.obliquity_deg, FARTHEST_OBLIQUITY_DEG),
            ("shoulder_mm", self.shoulder_mm, FARTHEST_SHOULDER_MM),
        ):
            if not 0.0 <= value <= most:
                raise SubjectError(f"supports that give: {what} {value:g}; wanted 0 to {most:g}")


@dataclass(frozen=True)
class SupportStiffness:
    """Stiffness of what holds a torso that is pushed.

    Attributes
    ----------
    belt : N mm/rad, against turning of the pelvis about the AP axis through its origin; None: held level.
    shoulder : N/mm, against lateral motion of the shoulder opposite the push.
    """

    belt: float | None
    shoulder: float


def drawn_supports(random: np.random.Generator) -> SyntheticSupports:
    """What one subject's supports give, uniform in 0 to 4 degrees and in 0 to 4 mm."""
    return SyntheticSupports(random.uniform(0.0, LARGEST_OBLIQUITY_DEG), random.uniform(0.0, LARGEST_SHOULDER_MM))


def elastic_supports(torso: TorsoModel, side: str, stiffness: SupportStiffness) -> Supports:
    """``three_point_supports`` for a push on ``side`` with a belt and a shoulder's pad of this stiffness.

    The belt is two vertical springs beside the pelvis' origin, of the kind ``SupportKind.SPRING``.
    """
    supports = three_point_supports(torso, side, pelvis="level" if stiffness.belt is None else "hinge")
    springs = supports.springs
    pad = supports.of_kind(SupportKind.SHOULDER)
    springs = replace(springs, stiffness=np.where(pad, stiffness.shoulder, springs.stiffness))
    if stiffness.belt is None:
        return replace(supports, springs=springs)
    bone = np.full(2, torso.bone("pelvis"))
    targets = torso.rest_pose.bone_positions[bone] + np.array([[BELT_ARM_MM, 0.0, 0.0], [-BELT_ARM_MM, 0.0, 0.0]])
    points = PointsOnBones.at(torso.rest_pose, bone, targets)
    each = stiffness.belt / (2.0 * BELT_ARM_MM**2)
    with_belt = PointSprings(
        PointsOnBones(
            np.concatenate([springs.points.bone, points.bone]), np.concatenate([springs.points.offset, points.offset])
        ),
        np.concatenate([springs.targets, targets]),
        np.concatenate([springs.directions, np.tile([0.0, 1.0, 0.0], (2, 1))]),
        np.concatenate([springs.stiffness, [each, each]]),
    )
    return Supports(
        supports.held,
        with_belt,
        (*supports.names, "pelvis", "pelvis"),
        (*supports.kinds, SupportKind.SPRING, SupportKind.SPRING),
    )


def support_stiffness(
    torso: TorsoModel,
    side: str,
    pushes: Sequence[LoadCase],
    ratios: StiffnessRatios,
    give: SyntheticSupports,
    max_rounds: int = MAX_ROUNDS,
) -> SupportStiffness:
    """The stiffness at which the supports give what is asked, each under the one of ``pushes`` that moves it most.

    What a support must exert where it is to be is a reaction of an equilibrium at that place
    (``mechanics.places.SupportPlace``); its stiffness is that over the way. A support that gives less although nothing
    holds it has none.

    Parameters
    ----------
    side : pushed, by all of them.
    max_rounds : of belt and pad in turn, where different pushes move them most.

    Raises
    ------
    EquilibriumError : the torso can't carry a push, or the two stiffnesses don't settle.
    """
    if not give.obliquity_deg and not give.shoulder_mm:
        return SupportStiffness(None, PAD)
    places = _Places(torso, side, pushes, ratios, give)
    belts, pads = zip(*in_parallel(places.both, range(len(pushes))))
    belt, pad = max(0.0, *belts), max(0.0, *pads)
    if not give.shoulder_mm:
        return SupportStiffness(belt if give.obliquity_deg else None, PAD)
    if not give.obliquity_deg:
        return SupportStiffness(None, min(pad, PAD))
    turning, shifting = int(np.argmax(belts)), int(np.argmax(pads))
    if turning == shifting and belt > 0.0 and 0.0 < pad < PAD:
        return SupportStiffness(belt, pad)
    # One push turns the pelvis most and another moves the shoulder most, or one of the two is free: what either support
    # must exert then depends on how the other one gives.
    for round_ in range(max_rounds):
        # Where one of them stays, so does the other one, which was found with it.
        before, belt = belt, max(0.0, places.belt(turning, pad))
        if round_ and np.isclose(before, belt, rtol=UNCHANGED, atol=0.0):
            return SupportStiffness(belt, pad)
        before, pad = pad, min(max(0.0, places.pad(shifting, belt)), PAD)
        if np.isclose(before, pad, rtol=UNCHANGED, atol=0.0):
            return SupportStiffness(belt, pad)
    raise EquilibriumError(
        f"found no springs with which the supports give {give.obliquity_deg:g} degrees and {give.shoulder_mm:g} mm "
        f"(after {counted(max_rounds, 'round')} {belt:.3g} N mm/rad, {pad:.3g} N/mm); ask for less, or for 0 of one"
    )


class _Places:
    """What the supports must exert where they are to be, as stiffness; below 0 where the push falls short of it."""

    def __init__(
        self,
        torso: TorsoModel,
        side: str,
        pushes: Sequence[LoadCase],
        ratios: StiffnessRatios,
        give: SyntheticSupports,
    ) -> None:
        self.torso, self.side, self.pushes, self.ratios = torso, side, pushes, ratios
        self.last: list[TorsoState | None] = [None for _ in pushes]  # where belt and pad start, left by both
        # A push bends the torso like a beam on two supports: above the pelvis it leans the way of the push.
        self.turn = -PUSH_DIRECTION[side] * math.radians(give.obliquity_deg)
        self.slide = PUSH_DIRECTION[side] * give.shoulder_mm
        self.level = EquilibriumProblem(torso, elastic_supports(torso, side, SupportStiffness(None, PAD)))
        self.hinge = EquilibriumProblem(torso, elastic_supports(torso, side, SupportStiffness(0.0, PAD)))
        both = elastic_supports(torso, side, SupportStiffness(None, STILL if self.slide else PAD))
        self.held = self.level.with_supports(both)
        _, self.at_rest = self.held.solve_linearised(pushes[0].scaled(0.0), ratios)

    def both(self, push: int) -> tuple[float, float]:
        """Belt, N mm/rad, and pad, N/mm, with pelvis and shoulder both where they are to be.

        Push and places grow together, each step from the last one's tangent. With the demo's torso that takes three
        quarters of the work of placing the supports first (27 and 36 CPU s).
        """
        start = self.at_rest
        for share in STEPS:
            placed = self.held.with_place(SupportPlace(share * self.turn, share * self.slide))
            found, start = placed.solve_linearised(self.pushes[push].scaled(share), self.ratios, start)
        self.last[push] = found.state
        return self._belt_of(found), self._pad_of(found)

    def belt(self, push: int, pad: float) -> float:
        """N mm/rad, with the pelvis where it is to be and the shoulder on a pad of this stiffness, N/mm."""
        supports = elastic_supports(self.torso, self.side, SupportStiffness(None, pad))
        return self._belt_of(self._solve(push, self.level.with_supports(supports).with_place(SupportPlace(self.turn))))

    def pad(self, push: int, belt: float) -> float:
        """N/mm, with the shoulder where it is to be and the pelvis in a belt of this stiffness, N mm/rad."""
        supports = elastic_supports(self.torso, self.side, SupportStiffness(belt, STILL))
        return self._pad_of(self._solve(push, self.hinge.with_supports(shifted_shoulder(supports, self.slide))))

    def _solve(self, push: int, held: EquilibriumProblem) -> Equilibrium:
        found = held.solve(self.pushes[push], self.ratios, self.last[push]).require()
        self.last[push] = found.state
        return found

    def _belt_of(self, found: Equilibrium) -> float:
        if not self.turn:
            return math.inf
        moment = next(r.moment[2] for r in found.reactions if r.kind is SupportKind.HELD)
        return float(-moment / (math.sin(self.turn) * math.cos(self.turn)))  # of two vertical springs on level arms

    def _pad_of(self, found: Equilibrium) -> float:
        return float(-found.reaction(SupportKind.SHOULDER)[0] / self.slide) if self.slide else PAD


def shoulder_shift(supports: Supports, state: TorsoState) -> float:
    """Lateral motion of the held shoulder since rest, mm, to the patient's left (+x)."""
    springs, pad = supports.springs, supports.of_kind(SupportKind.SHOULDER)
    return float((springs.extension(state) * springs.directions[:, 0])[pad].sum())
