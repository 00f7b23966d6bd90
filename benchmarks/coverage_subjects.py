"""Subjects of known stiffness for ``coverage.py``, by corners alone, with everything wrong that a real visit has wrong.

The truth is a body of 10 to 16 years with its own kyphosis, lordosis, length of spine and sizes of vertebrae, a curve
of 10 to 80 degrees, and a tissue mesh of its own points: about as many as the estimator's coarse mesh, or more. Belt
and shoulder's pad are springs (``study.synthetic.elastic_supports``). What the estimator is not told is drawn with the
standard deviations of ``estimation.priors.Priors``: force, offset, direction, height and depth of each push, breath and
what belt and pad do in each frame by themselves, where the patient stood and swayed, how far the source was. The
template is that of the body's age, sex and height, but of another mass, so that the trunk is of another size. Ribs turn
on their vertebrae, and tissue resists a change of volume, as the priors have it, too. Every seventh subject each has
discs that turn farther behind, discs with a neutral zone, or layered tissue, as ``discrepancy_pairs`` has them, with
their true ratios as there; the mesh, the geometry and the body's proportions, the other four kinds that an estimate
expects, differ in all. Corners are annotated and tracked as ``judgement_subjects`` has it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, Literal

import numpy as np
from discrepancy_pairs import (
    FORCE_N,
    LEAST_FORCE_N,
    MOST_TILT,
    OF_BASE,
    STANDARD_LAW,
    Bench,
    drawn_body,
    equal_ratios,
    less_force,
)
from judgement_subjects import (
    AGES,
    drawn_drag,
    drawn_height,
    nominal_view,
    projected,
    standing,
    tracked_push,
)

from spinestiff.anatomy.names import VERTEBRAE
from spinestiff.anatomy.rotation import exp_so3
from spinestiff.anatomy.state import TorsoState
from spinestiff.anatomy.stiffness import RIB_ROTATION, parameter_group, stiffness_ratios
from spinestiff.anatomy.template import Mesh, template_torso
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.arrays import Floats
from spinestiff.curves.tilts import cobb_angle, tilts
from spinestiff.errors import EquilibriumError
from spinestiff.estimation.known import Known
from spinestiff.estimation.load_acts import changed_load, load_changes
from spinestiff.estimation.priors import Priors
from spinestiff.estimation.unknowns import ACTS, LAMBDA_SHARE
from spinestiff.imaging.features import VertebraCorners
from spinestiff.imaging.projection import XRayView, frontal_view, lateral_view
from spinestiff.mechanics.equilibrium import EquilibriumProblem
from spinestiff.mechanics.loads import LoadCase, rib_push
from spinestiff.mechanics.places import shifted_shoulder
from spinestiff.mechanics.push import raised_level
from spinestiff.mechanics.supports import SupportKind, Supports
from spinestiff.personalise.placing import place_vertebrae
from spinestiff.personalise.shape import personalise
from spinestiff.study.synthetic.elastic_supports import (
    SyntheticSupports,
    drawn_supports,
    elastic_supports,
    support_stiffness,
)
from spinestiff.study.synthetic.spines import CURVES, curved_spine
from spinestiff.study.trials import PushSet, push_set
from spinestiff.subject.outcomes import TrackedPush
from spinestiff.subject.records import PushRecord, Role

# Ratios of the default moduli; tissue of 4.4 to 115 kPa.
BENDING, TISSUE = (0.0075, 0.84), (0.029, 0.77)
COBB_DEG = (10.0, 80.0)
START = {"lateral_bending": 0.07, "tissue": 0.04}
"""Ratios where a fit of a subject begins, Table 4's mean."""
ANNOTATION_MM = 0.3
COARSE_NODES = 3300
"""Of a truth's mesh, as asked of the mesher, beside an estimate on the coarse mesh: with fewer a truth is coarser than
the estimate, and comes out too stiff."""
# What a subject's body has that the model lacks; the four others are the kinds that all have.
KINDS = ("disc centres", "stiffening", "layers", "", "", "", "")
RAISED = np.array([float(act == "height") for act in ACTS])
WIDEST = 2.0  # standard deviations of a stiffness that is drawn
Acquisition = Literal["paper", "three pushes", "four frames", "both sides"]
Side = Literal["left", "right"]
OTHER: Mapping[Side, Side] = {"left": "right", "right": "left"}


@dataclass(frozen=True)
class PlacedPush:
    """A push that a subject gets.

    Attributes
    ----------
    level : rib about which it is placed. frames : share of the largest force, and role.
    side : None: the convex one, or with ``concave`` the other one. force_n : the largest; None: drawn, the same for all
        pushes.
    """

    level: float
    frames: tuple[tuple[float, Role], ...]
    side: Side | None = None
    force_n: float | None = None
    concave: bool = False


PUSHES: Mapping[Acquisition, Mapping[str, PlacedPush]] = {
    "paper": {
        "main": PlacedPush(8.0, ((0.0, "unused"), (1 / 3, "training"), (2 / 3, "training"), (1.0, "validation"))),
    },
    "three pushes": {
        "high": PlacedPush(5.5, ((0.0, "unused"), (1.0, "training"))),
        "middle": PlacedPush(8.0, ((0.0, "unused"), (1.0, "training"), (2 / 3, "validation"))),
        "low": PlacedPush(10.0, ((0.0, "unused"), (1.0, "training"))),
    },
    # Four loaded frames in all, of as much force as a person bears, 80 N at most.
    "four frames": {
        "high": PlacedPush(5.5, ((0.0, "unused"), (1.0, "training")), force_n=80.0),
        "middle": PlacedPush(8.0, ((0.0, "unused"), (2 / 3, "training"), (1.0, "training")), force_n=80.0),
        "low": PlacedPush(10.0, ((0.0, "unused"), (1.0, "training")), force_n=80.0),
    },
    # As plans propose for a target of bending before any push (plan.py): few frames, far apart, from both sides.
    "both sides": {
        "low": PlacedPush(10.2, ((0.0, "unused"), (1.0, "training")), force_n=80.0),
        "other-high": PlacedPush(5.2, ((0.0, "unused"), (1.0, "training")), force_n=80.0, concave=True),
        "other-low": PlacedPush(9.2, ((0.0, "unused"), (1.0, "training")), force_n=80.0, concave=True),
    },
}


@dataclass(frozen=True)
class Subject:
    """A subject as the steps get it, and what it was made of.

    Attributes
    ----------
    height_cm, age, sex : as told. cobb_deg : of the truth at rest. ratios : true ones.
    kind : what else the body has that the model lacks, of ``KINDS``.
    rest : view name -> annotated corners and nominal view.
    records, tracked : the pushes as told and as tracked.
    """

    seed: int
    height_cm: float
    age: float
    sex: Literal["female", "male"]
    cobb_deg: float
    ratios: Mapping[str, float]
    kind: str
    rest: Mapping[str, tuple[VertebraCorners, XRayView]]
    records: tuple[PushRecord, ...]
    tracked: Mapping[str, TrackedPush]


@dataclass(frozen=True)
class PushedPerson:
    """A person under all pushes of a visit, before anything is seen of them but at rest.

    Attributes
    ----------
    height_cm, age, sex, cobb_deg, ratios, kind : as ``Subject`` has them, the height not rounded.
    nominal : view name -> where source and detector are told to be.
    rest : the annotated corners there, with these views. stood : the views in which the patient truly stood.
    records : the pushes as told. states : of each, one a frame.
    random : what the rest of the visit is drawn with. hand : another annotator's errors; None: of ``random``.
    """

    sex: Literal["female", "male"]
    age: float
    height_cm: float
    cobb_deg: float
    ratios: Mapping[str, float]
    kind: str
    torso: TorsoModel
    nominal: Mapping[str, XRayView]
    rest: Mapping[str, tuple[VertebraCorners, XRayView]]
    stood: Mapping[str, XRayView]
    records: tuple[PushRecord, ...]
    states: Mapping[str, list[TorsoState]]
    random: np.random.Generator
    hand: np.random.Generator | None


def make_subject(
    seed: int,
    acquisition: Acquisition | Mapping[str, PlacedPush],
    nodes: int | None = 3000,
    visit: int = 0,
    annotator: int = 0,
    ratios: Mapping[str, float] | None = None,
) -> Subject:
    """The subject of a seed, at a visit, as an annotator marks the radiographs; see ``pushed_person``."""
    person = pushed_person(seed, acquisition, nodes, visit, annotator, ratios)
    drag = drawn_drag(np.random.default_rng([23, seed, visit]))
    tracked = {
        push.id: tracked_push(
            person.torso,
            person.nominal["frontal"],
            person.states[push.id],
            list(push.forces_n),
            ANNOTATION_MM,
            drag,
            person.random,
            person.hand,
        )
        for push in person.records
    }
    told = (seed, round(person.height_cm, 0), person.age, person.sex, person.cobb_deg, person.ratios, person.kind)
    return Subject(*told, person.rest, person.records, tracked)


def pushed_person(
    seed: int,
    acquisition: Acquisition | Mapping[str, PlacedPush],
    nodes: int | None = 3000,
    visit: int = 0,
    annotator: int = 0,
    ratios: Mapping[str, float] | None = None,
) -> PushedPerson:
    """The person of a seed, at a visit, under all pushes, and an annotator's marks in the rest radiographs.

    Each visit follows one protocol: the ribs that are aimed at, and the force, are those of the first.
    Pushes of one's own make a later visit (``visit`` from 1 on): so the person is the same whatever they are. All
    forces shrink alike where one bends the torso too far.

    Parameters
    ----------
    nodes : of the truth's mesh; None: the estimate's coarse one, carried, where the spine lets it be.
    ratios : true ones; drawn if left out.

    Raises
    ------
    SpinestiffError : this torso can't be bent that far, or can't carry even a small push.
    """
    pushes = first = PUSHES[acquisition] if isinstance(acquisition, str) else acquisition
    if not isinstance(acquisition, str):
        assert visit, "pushes of one's own make a later visit"
        first = PUSHES["paper"]
    body, p = _body(seed, nodes), Priors()
    sex, age, height, torso = body.sex, body.age, body.height, body.torso
    random = np.random.default_rng()
    random.bit_generator.state = body.drawn_next
    drawn = {
        name: float(np.exp(random.uniform(*np.log(limits))))
        for name, limits in (("lateral_bending", BENDING), ("tissue", TISSUE))
    }
    ratios = drawn if ratios is None else dict(ratios)
    nominal = {
        name: nominal_view(make, height) for name, make in (("frontal", frontal_view), ("lateral", lateral_view))
    }
    cobb = cobb_angle(
        tilts(VERTEBRAE, projected(torso, nominal["frontal"], torso.rest_pose), nominal["frontal"])
    ).degrees
    convex: Side = "left" if cobb > 0.0 else "right"
    sides = {name: push.side or (OTHER[convex] if push.concave else convex) for name, push in pushes.items()}
    hand = None if not annotator else np.random.default_rng([17, seed, visit, annotator])
    own = _drawn_visit(torso, nominal, first, p, random, None if visit else hand)
    if visit:
        # What belongs to the person is drawn as at the first visit.
        again = np.random.default_rng([19, seed, visit])
        anew = _drawn_visit(torso, nominal, pushes, p, again, hand)
        own = replace(anew, force=own.force, levels=own.levels) if isinstance(acquisition, str) else anew
    forces = {name: push.force_n or own.force for name, push in pushes.items()}

    def load(push: str, share: float, breath: float = 0.0) -> LoadCase:
        acts = own.acts[push]
        level, _ = raised_level(torso, sides[push], own.levels[push], float(acts @ RAISED) + breath)
        told = rib_push(torso, sides[push], level, share * forces[push])
        return changed_load(told, load_changes(told, torso), acts * (1.0 - RAISED))

    moves = np.random.default_rng([31, seed, visit])
    own_frames = {push: [_OwnFrame.drawn(moves, p) for _ in one.frames] for push, one in pushes.items()}
    stiffness = stiffness_ratios(ratios, torso.joints.kinds)
    lacking = np.random.default_rng([29, seed])  # of its own: how much a visit draws depends on its pushes
    kind = str(lacking.choice(KINDS))
    bench = OF_BASE[kind](torso, lacking)[0] if kind else Bench(torso)
    if kind and kind not in STANDARD_LAW:
        # As much energy as the same body stores without what the model lacks, its volume's resistance included.
        stores = stiffness.with_values(Bench(torso).true_ratios(stiffness))
        stiffness, _ = equal_ratios(bench, stores)
    torso, laws = bench.torso, bench.laws
    while True:
        try:
            states = {}
            for side in dict.fromkeys(sides.values()):
                here = [push for push in own.levels if sides[push] == side]
                springs = support_stiffness(torso, side, [load(push, 1.0) for push in here], stiffness, own.give)
                problem = EquilibriumProblem(torso, elastic_supports(torso, side, springs), laws=laws)
                for push in here:
                    shares, frames = [share for share, _ in pushes[push].frames], own_frames[push]
                    problems = [
                        problem.with_supports(frame.moved(problem.supports, torso)) if share else problem
                        for share, frame in zip(shares, frames, strict=True)
                    ]
                    loads = [load(push, share, frame.breath_mm) for share, frame in zip(shares, frames, strict=True)]
                    states[push] = _pushed(problems, loads, stiffness)
            bent = max(_bent(torso, nominal["frontal"], state) for found in states.values() for state in found)
        except EquilibriumError:
            bent = 2.0 * MOST_TILT
        if bent <= MOST_TILT:
            break
        less = less_force(bent)
        forces = {push: less * force for push, force in forces.items()}
        if min(forces.values()) < LEAST_FORCE_N:
            raise EquilibriumError(
                f"subject {seed}: bends by more than {np.rad2deg(MOST_TILT):.0f} degrees under any push"
            )
    records = [
        PushRecord(
            id=push,
            side=sides[push],
            level=round(own.levels[push], 1),
            d21_mm=400.0,
            d31_mm=200.0,
            frames=push,
            forces_n=tuple(round(share * forces[push], 1) for share, _ in pushes[push].frames),
            roles=tuple(role for _, role in pushes[push].frames),
        )
        for push in own.levels
    ]
    next_random = again if visit else random
    return PushedPerson(
        sex, age, height, float(cobb), ratios, kind, torso, nominal, own.rest, own.stood, tuple(records), states,
        next_random, hand,
    )  # fmt: skip


def seen_by(subject: Subject, mesh: Mesh) -> PushSet:
    """The subject's pushes on the torso that personalisation makes of it."""
    template = template_torso(subject.height_cm, mesh, age_years=subject.age, sex=subject.sex)
    shaped = personalise(template, subject.rest)
    return push_set(shaped.torso, subject.records, subject.tracked, known=Known(Priors(), shaped.covariance))


@dataclass(frozen=True)
class _Body:
    """A person before any push, and the state of the random numbers that the rest is drawn with."""

    sex: Literal["female", "male"]
    age: float
    height: float
    torso: TorsoModel
    drawn_next: Mapping[str, Any]


@lru_cache(maxsize=2)  # pushes of one person that follow each other: meshing takes as long as the first pushes
def _body(seed: int, nodes: int | None) -> _Body:
    random = np.random.default_rng([13, seed])
    sex: Literal["female", "male"] = "female" if random.uniform() < 0.8 else "male"
    age = float(random.uniform(*AGES))
    height = drawn_height(random, age, sex)
    torso = _of_drawn_stiffness(_true_torso(random, height, age, sex, nodes, seed), random, Priors())
    return _Body(sex, age, height, torso, random.bit_generator.state)


@dataclass(frozen=True)
class _DrawnVisit:
    """What is drawn anew at each visit: annotated rest radiographs with their nominal views, where the patient stood
    for them, largest force as told, told level and what is wrong of each push, how far the supports give."""

    rest: Mapping[str, tuple[VertebraCorners, XRayView]]
    stood: Mapping[str, XRayView]
    force: float
    levels: Mapping[str, float]
    acts: Mapping[str, Floats]
    give: SyntheticSupports


@dataclass(frozen=True)
class _OwnFrame:
    """What belongs to a loaded frame alone: belt and pad are moved by so much, and the pushed point by a breath."""

    turn: float
    shoulder_mm: float
    breath_mm: float

    @classmethod
    def drawn(cls, random: np.random.Generator, p: Priors) -> _OwnFrame:
        turn, shoulder, breath = random.normal(size=3) * [p.frame_obliquity_deg, p.frame_shoulder_mm, p.breathing_mm]
        return cls(float(np.deg2rad(turn)), float(shoulder), float(breath))

    def moved(self, supports: Supports, torso: TorsoModel) -> Supports:
        """The supports in this frame; a pelvis that is held level stays level."""
        supports = shifted_shoulder(supports, self.shoulder_mm)
        belt = np.array([name == "pelvis" for name in supports.names]) & supports.of_kind(SupportKind.SPRING)
        about, springs = torso.rest_pose.bone_positions[torso.bone("pelvis")], supports.springs
        turn = exp_so3(np.array([[0.0, 0.0, self.turn]]))[0]
        turned = np.where(belt[:, None], about + (springs.targets - about) @ turn.T, springs.targets)
        return replace(supports, springs=replace(springs, targets=turned))


def _drawn_visit(
    torso: TorsoModel,
    nominal: Mapping[str, XRayView],
    pushes: Mapping[str, PlacedPush],
    p: Priors,
    random: np.random.Generator,
    hand: np.random.Generator | None,
) -> _DrawnVisit:
    rest, stood = {}, {}
    for name, view in nominal.items():
        stood[name] = standing(view, random, lateral=name == "lateral")
        corners = projected(torso, stood[name], torso.rest_pose)
        wrong = random.normal(0.0, ANNOTATION_MM * view.magnification, corners.shape)
        if hand is not None:
            wrong = hand.normal(0.0, ANNOTATION_MM * view.magnification, corners.shape)
        rest[name] = (VertebraCorners(VERTEBRAE, corners + wrong), view)
    force = float(random.uniform(*FORCE_N))
    levels, found = {}, {}
    for push, placed in pushes.items():
        levels[push] = placed.level + float(random.uniform(-0.7, 0.7))
        acts = np.zeros(len(ACTS))
        angle = np.deg2rad(p.direction_deg)
        sizes = (p.force_scale, p.force_offset_n, angle, angle, p.push_height_mm, p.push_depth_mm)
        acts[: len(sizes)] = random.normal(0.0, sizes)
        found[push] = acts
    return _DrawnVisit(rest, stood, force, levels, found, drawn_supports(random))


def _true_torso(
    random: np.random.Generator, height: float, age: float, sex: Literal["female", "male"], nodes: int | None, seed: int
) -> TorsoModel:
    body = drawn_body(random, height, age, sex)
    cobb = float(random.uniform(*COBB_DEG)) * float(random.choice([-1.0, 1.0]))
    curve = str(random.choice(list(CURVES)))
    return place_vertebrae(body, *curved_spine(body, cobb, curve), nodes=nodes, seed=seed)


def _of_drawn_stiffness(torso: TorsoModel, random: np.random.Generator, p: Priors) -> TorsoModel:
    """The same with ribs and tissue's volume as stiff as the priors allow."""
    ribs, volume = np.clip(random.normal(size=2), -WIDEST, WIDEST) * [p.rib_joints, p.tissue_volume]
    turning = parameter_group(RIB_ROTATION, torso.joints.kinds).joints
    joints = replace(torso.joints, stiffness=np.where(turning, np.exp(ribs), 1.0) * torso.joints.stiffness)
    tissue, both = torso.tissue, np.exp(-LAMBDA_SHARE * volume)
    tissue = replace(tissue, lame_mu=both * tissue.lame_mu, lame_lambda=both * np.exp(volume) * tissue.lame_lambda)
    return replace(torso, joints=joints, tissue=tissue)


def _pushed(problems: Sequence[EquilibriumProblem], loads: Sequence[LoadCase], stiffness) -> list[TorsoState]:  # type: ignore[no-untyped-def]
    """States under the loads, each in its own problem; each starts from the one under the next smaller force."""
    states = [problem.torso.rest_pose for problem in problems]
    state = states[0]
    for i in sorted(range(len(loads)), key=lambda i: float(np.linalg.norm(loads[i].total))):
        if loads[i].size:
            state = states[i] = problems[i].solve(loads[i], stiffness, state).require().state
    return states


def _bent(torso: TorsoModel, view: XRayView, state: TorsoState) -> float:
    """rad, the largest change of tilt between two vertebrae."""
    before, after = (tilts(VERTEBRAE, projected(torso, view, s), view).superior for s in (torso.rest_pose, state))
    return float(np.ptp(after - before))
