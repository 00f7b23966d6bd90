"""A short spine in a block of tissue, on the supports of a push and small enough that a fit takes a second."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from spinestiff.anatomy.names import VERTEBRAE
from spinestiff.anatomy.points import PointsOnBones
from spinestiff.anatomy.state import TorsoState
from spinestiff.anatomy.stiffness import ParameterGroup, StiffnessRatios, lame_parameters, stiffness_ratios
from spinestiff.anatomy.tissue_points import PointsOnTissue
from spinestiff.anatomy.torso import JointTable, TissueMesh, TorsoModel, joint_frames
from spinestiff.estimation.emulator import Place
from spinestiff.estimation.evaluation import TrialSet
from spinestiff.estimation.known import Known
from spinestiff.estimation.mode import likeliest, search
from spinestiff.estimation.objective import Picture, SkinMarkers, Trial
from spinestiff.estimation.priors import Priors
from spinestiff.estimation.profiles import Likely, likely_ratios
from spinestiff.estimation.weighed import WeighedFit, WeighedProblem
from spinestiff.imaging.features import VertebraCorners, silhouette_shares, state_features
from spinestiff.imaging.pedicles import PediclePoints, pedicle_centres
from spinestiff.imaging.projection import XRayView, frontal_view
from spinestiff.imaging.tracking.quality import quality_of
from spinestiff.mechanics.equilibrium import Equilibrium, EquilibriumProblem
from spinestiff.mechanics.loads import LoadCase, no_load
from spinestiff.mechanics.places import AT_REST, SupportPlace
from spinestiff.mechanics.result import SolveStatus
from spinestiff.mechanics.supports import SupportKind, Supports
from spinestiff.mechanics.terms import PointSprings
from spinestiff.verification.models import box_mesh

NAMES = (*VERTEBRAE[8:], "pelvis")
SPACING = 30.0
TRUTH = {"lateral_bending": 0.3, "tissue": 0.4}
LIMITS = (float(np.log(0.01)), float(np.log(10.0)))
VIEW = frontal_view(centre=(0, 150, 0))


def column_torso() -> TorsoModel:
    """T9 to L5 and a pelvis, 30 mm apart, in the middle of a block of soft tissue."""
    count = len(NAMES)
    positions = np.stack([np.zeros(count), SPACING * np.arange(count)[::-1], np.zeros(count)], 1)
    nodes, elements = box_mesh((4, 9, 2), (160.0, SPACING * (count - 1), 80.0), 4)
    nodes = nodes - [80.0, 0.0, 40.0]
    near = np.linalg.norm(nodes[:, None] - positions, axis=-1)
    bone_of_node = np.where(near.min(1) < 18.0, near.argmin(1), -1)
    # The sides go with the pelvis, so that tissue is a bed for the spine, unlike its joints.
    bone_of_node[(nodes[:, 1] < 1.0) | (np.abs(nodes[:, 0]) > 79.0)] = count - 1
    rest = TorsoState(positions, np.tile(np.eye(3), (count, 1, 1)), nodes[bone_of_node < 0])
    parent, child = np.arange(1, count), np.arange(count - 1)
    centres = 0.5 * (positions[1:] + positions[:-1])
    mu, lam = lame_parameters(0.02, 0.4)
    stiffness = np.tile([200.0, 800.0, 200.0, 1e5, 1e5, 1e5], (count - 1, 1))
    joints = JointTable(
        tuple(f"{b}-{a}" for a, b in zip(NAMES, NAMES[1:])),
        ("thoracic",) * (count - 1),
        parent,
        child,
        stiffness=stiffness,
        **joint_frames(rest, parent, child, centres, np.tile(np.eye(3), (count - 1, 1, 1))),
    )
    tissue = TissueMesh(nodes, elements, bone_of_node, np.full(len(elements), mu), np.full(len(elements), lam))
    box = np.array([[x, y, z] for y in (9, -9) for x in (16, -16) for z in (13, -13)], dtype=float)
    return TorsoModel(NAMES, rest, joints, tissue, np.tile(box, (count - 1, 1, 1)), (), {}, 160.0, NAMES[:-1])


def column_supports(torso: TorsoModel) -> Supports:
    """The pelvis held, a pad at the uppermost vertebra and a wall that keeps it from leaning forward."""
    held = np.zeros((len(torso.bone_names), 6), dtype=bool)
    held[torso.bone("pelvis")] = True
    points = PointsOnBones(np.array([0, 0, 4]), np.array([[5.0, 10.0, 0.0], [0.0, 0.0, -10.0], [0.0, 0.0, -10.0]]))
    kinds = (SupportKind.SHOULDER, SupportKind.WALL, SupportKind.WALL)
    springs = PointSprings(points, points.positions(torso.rest_pose), np.eye(3)[[0, 2, 2]], np.array([1e3, 1e2, 1e2]))
    return Supports(held, springs, tuple(NAMES[bone] for bone in points.bone), kinds)


class BrittleProblem(EquilibriumProblem):
    """Has no equilibrium where the ratio of lateral bending is below ``fails_below``."""

    fails_below = 0.0

    def solve(self, load: LoadCase, ratios: StiffnessRatios | None = None, *args, **kwargs) -> Equilibrium:
        found = super().solve(load, ratios, *args, **kwargs)
        return replace(found, status=SolveStatus.STALLED) if self.fails(ratios) else found

    def solve_linearised(self, load: LoadCase, ratios: StiffnessRatios | None = None, *args, **kwargs):
        found, tangent = super().solve_linearised(load, ratios, *args, **kwargs)
        return (replace(found, status=SolveStatus.STALLED) if self.fails(ratios) else found).require(), tangent

    def fails(self, ratios: StiffnessRatios | None) -> bool:
        bending = 1.0 if ratios is None else ratios.scale_joints(np.ones((len(self.torso.joints), 6)))[0, 5]
        return bool(bending < self.fails_below)


@dataclass(frozen=True)
class Column:
    """The short spine's problem, and what radiographs of it show."""

    problem: EquilibriumProblem
    truth: Mapping[str, float] = field(default_factory=lambda: dict(TRUTH))
    limits: tuple[float, float] = LIMITS

    @property
    def groups(self) -> tuple[ParameterGroup, ...]:
        return self.ratios(self.truth).groups

    @property
    def torso(self) -> TorsoModel:
        return self.problem.torso

    def ratios(self, values: Mapping[str, float]) -> StiffnessRatios:
        return stiffness_ratios(dict(values), self.torso.joints.kinds)

    def push(self, force: float, bones: Sequence[int] = (3, 4)) -> LoadCase:
        """From the right onto a place beside two vertebrae."""
        offset = np.tile([-40.0, 0.0, 5.0], (len(bones), 1))
        forces = np.tile([force / len(bones), 0.0, 0.0], (len(bones), 1))
        return LoadCase(PointsOnBones(np.array(bones), offset), forces, f"{force:g} N")

    def corners(self, state: TorsoState, view: XRayView = VIEW) -> np.ndarray:
        shares = silhouette_shares(self.torso, view, self.torso.rest_pose)
        return state_features(self.torso, view, state, shares).corners

    def pedicles(self, state: TorsoState, view: XRayView = VIEW) -> PediclePoints:
        """All of them where they are."""
        local = pedicle_centres(self.torso)
        points = PointsOnBones(np.repeat(self.torso.vertebra_bones, 2), local.reshape(-1, 3))
        return PediclePoints(self.torso.vertebrae, view.project(points.positions(state)).reshape(-1, 2, 2))

    def picture(self, state: TorsoState, view: XRayView, label: str, sequence: str, pedicles: bool = False) -> Picture:
        """A further radiograph of a state, without errors."""
        corners = VertebraCorners(self.torso.vertebrae, self.corners(state, view))
        return Picture(corners, view, label, sequence, self.pedicles(state, view) if pedicles else None)

    def markers(self, state: TorsoState, sequence: str = "push 1 markers") -> SkinMarkers:
        """On nodes of the block's front, without errors; one rides on a bone's node, too."""
        tissue = self.torso.tissue
        front = np.flatnonzero((tissue.rest_positions[:, 2] > 39.0) & (tissue.bone_of_node < 0))[::3]
        tied = np.flatnonzero((tissue.bone_of_node >= 0) & (tissue.bone_of_node < len(NAMES) - 1))
        nodes = np.column_stack([front, np.roll(front, 1), np.resize(tied, len(front))])
        points = PointsOnTissue(nodes, np.tile([0.7, 0.2, 0.1], (len(front), 1)))
        names = tuple(f"m{i}" for i in range(len(front)))
        outward = np.tile([0.0, 0.0, 1.0], (len(front), 1))
        return SkinMarkers(names, points.positions(self.torso, state), points, outward, sequence)

    def shown(self, load: LoadCase, state: TorsoState, errors: np.ndarray | float = 0.0, **facts) -> Trial:
        """A radiograph of a state, ``errors`` (9, 4, 2) in mm at the patient plane."""
        seen = self.corners(state) + VIEW.magnification * np.asarray(errors)
        quality = np.full(seen.shape[:2], float(quality_of(np.array(0.1))))
        return Trial(load, VertebraCorners(self.torso.vertebrae, seen, quality), VIEW, **facts)

    def trials(
        self,
        truth: Mapping[str, float] = TRUTH,
        forces: Sequence[float] = (40.0, 100.0),
        annotation: float = 0.0,
        tracking: float = 0.0,
        seed: int = 0,
        places: Sequence[SupportPlace] = (),
        gauge: float = 1.0,
        bones: Sequence[int] = (3, 4),
        push: str = "push 1",
    ) -> list[Trial]:
        """The unloaded frame, annotated by hand, and loaded ones of one push; ``annotation``, ``tracking``: sds, mm."""
        random = np.random.default_rng(seed)
        shape = (len(self.torso.vertebrae), 4, 2)
        common = annotation * random.normal(size=shape)
        found = [self.shown(no_load(), self.torso.rest_pose, common, label=f"{push} rest", push=push, annotated=True)]
        for force, place in zip(forces, places or (AT_REST,) * len(forces)):
            load = self.push(force, bones)
            placed = self.problem.with_place(place)
            state = placed.solve(load.scaled(gauge), self.ratios(truth)).require().state
            errors = common + tracking * random.normal(size=shape)
            found.append(self.shown(load, state, errors, label=f"{push} {force:g} N", push=push))
        return found

    def trial_set(self, trials: Sequence[Trial], names: Sequence[str] = tuple(TRUTH)) -> TrialSet:
        groups = self.ratios(dict.fromkeys(names, 1.0)).groups
        return TrialSet([self.problem] * len(trials), trials, groups, "procrustes", None)

    def weighed(
        self, trials: Sequence[Trial], priors: Priors | None = None, names: Sequence[str] = tuple(TRUTH)
    ) -> WeighedProblem:
        loaded = [trial for trial in trials if trial.load.size]
        still = [(self.problem, trial) for trial in trials if not trial.load.size]
        known = Known(priors or Priors())
        return WeighedProblem(self.trial_set(loaded, names), still, "procrustes", known, limits=self.limits)

    def searched(
        self, problem: WeighedProblem, start: Sequence[float] = (1.0, 1.0), max_evaluations: int = 50
    ) -> WeighedFit:
        """Where the weighed search for the least phi ends from ratios to ``start`` at."""
        first = problem.solve(np.log(start), np.zeros(len(problem.unknowns)))
        return search(problem, first, max_evaluations)

    def estimated(self, problem: WeighedProblem, start: Sequence[float] = (1.0, 1.0)) -> WeighedFit:
        """The likeliest ratios, nuisances integrated out."""
        first = problem.solve(np.log(start), np.zeros(len(problem.unknowns)))
        return likeliest(problem, first, 50)


@pytest.fixture(scope="session")
def column() -> Column:
    torso = column_torso()
    return Column(EquilibriumProblem(torso, column_supports(torso)))


@pytest.fixture
def brittle(column):
    """A problem that fails below a ratio."""

    def make(fails_below: float) -> BrittleProblem:
        problem = BrittleProblem(column.torso, column.problem.supports)
        problem.fails_below = fails_below
        return problem

    return make


@pytest.fixture(scope="session")
def known_exactly() -> Priors:
    """All that moves an equilibrium is known but the ratios."""
    return Priors(
        force_scale=0.0,
        force_offset_n=0.0,
        direction_deg=0.0,
        push_height_mm=0.0,
        push_depth_mm=0.0,
        breathing_mm=0.0,
        obliquity_deg=0.0,
        shoulder_mm=0.0,
        frame_obliquity_deg=0.0,
        frame_shoulder_mm=0.0,
        trunk=0.0,
        rib_joints=0.0,
        tissue_volume=0.0,
        mesh=0.0,
        source_distance=0.0,
    )


@pytest.fixture(scope="session")
def clean(column) -> list[Trial]:
    """A sequence without errors."""
    return column.trials()


@pytest.fixture(scope="session")
def noisy(column) -> list[Trial]:
    """A sequence with errors of annotation and tracking, and supports that gave way."""
    places = [SupportPlace(np.deg2rad(2.0) * share, 2.0 * share) for share in (0.5, 1.0)]
    return column.trials(annotation=0.3, tracking=0.12, places=places, gauge=1.02, seed=3)


@pytest.fixture(scope="session")
def asked(column, noisy) -> WeighedProblem:
    return column.weighed(noisy)


@pytest.fixture(scope="session")
def found(column, asked) -> WeighedFit:
    return column.estimated(asked)


@pytest.fixture(scope="session")
def told(column, asked, found) -> tuple[Likely, tuple[Place, ...]]:
    return likely_ratios(asked, found, [Place(*place) for place in found.visited])


@pytest.fixture(scope="session")
def likely(told) -> Likely:
    return told[0]


@pytest.fixture(scope="session")
def places(told) -> tuple[Place, ...]:
    """Those that ``likely`` was made from."""
    return told[1]
