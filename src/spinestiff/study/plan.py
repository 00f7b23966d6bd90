"""Which push to take next: the radiographs that would make an estimate narrowest (``estimation.design``).

Candidates are pushes from the sides and at the ribs that are allowed, each at half and at the whole of the largest
force, seen from the front or from the front and the side, with an unloaded radiograph of each push and view first. All
of them, and those that the estimate has been made from, are put into equilibrium at a few places where the ratios may
lie, once for both views; there, the 95 % interval that a set of radiographs leaves follows to first order. What is
reported is the mean over the places, of factors the geometric one.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Literal

import numpy as np
from scipy.stats import norm

from spinestiff.anatomy.regions import parameter_groups
from spinestiff.anatomy.state import TorsoState
from spinestiff.anatomy.stiffness import RATIO_BOUNDS, ParameterGroup, StiffnessRatios
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.arrays import Floats
from spinestiff.curves.tilts import cobb_angle, tilts
from spinestiff.errors import EquilibriumError, SubjectError
from spinestiff.estimation.design import Design, better_known, design_at
from spinestiff.estimation.evaluation import Evaluation, Slope, TrialSet
from spinestiff.estimation.objective import Picture, Trial
from spinestiff.estimation.profiles import CONFIDENCE, WIDTH_FACTOR
from spinestiff.estimation.ratio_priors import ratio_prior
from spinestiff.estimation.unknowns import ACTS
from spinestiff.estimation.weighed import WeighedProblem
from spinestiff.imaging.features import Features, Orientation, VertebraCorners, silhouette_shares, state_features
from spinestiff.imaging.projection import XRayView
from spinestiff.mechanics.equilibrium import EquilibriumProblem
from spinestiff.mechanics.loads import no_load
from spinestiff.mechanics.push import PushSite, push_load, push_problem
from spinestiff.observer import Observer
from spinestiff.parallel import in_parallel
from spinestiff.study.plan_scene import Scene
from spinestiff.subject.plan_outcome import Plan, PlannedPush, PlannedView, PlanStep, Target
from spinestiff.words import counted

LEAST_LIMIT_N = 5.0
COMFORT_N = 80.0
"""The largest force that is proposed unless another one is given."""
DISCOMFORT_N = (116.0, 25.0)
"""At the chest of women (adults, n = 16), mean and standard deviation: Applied Ergonomics 2021."""
RIBS = (5.0, 6.0, 7.0, 8.0, 9.0, 10.0)
SIDES: tuple[Literal["left", "right"], ...] = ("left", "right")
SHARES = (0.5, 1.0)  # of the largest force
VIEWS: tuple[PlannedView, ...] = ("frontal", "frontal+lateral")
EXPOSURES = 8
# A push under which vertebrae would turn against each other by more than this is not proposed.
MOST_TURN = np.deg2rad(45.0)
# An exposure pays if it narrows the log of the interval (or the degrees) by more than this share.
PAYS = 0.03
ROUNDING = 1e-9  # of a sum of costs
# Quality of a corner that tracking follows well; its error is about 0.11 mm.
QUALITY = 0.7
RATIO_OF: Mapping[Target, str] = {
    "bending": "lateral_bending",
    "tissue": "tissue",
    "rotation": "axial_rotation",
}
# The paper's distances; they matter where forces on shoulder and pelvis are loads.
D21_MM, D31_MM = 400.0, 200.0


@dataclass(frozen=True)
class Frame:
    """A torso under a push from ``side`` at rib ``level``, N."""

    side: Literal["left", "right"]
    level: float
    force_n: float

    @property
    def push(self) -> str:
        return f"push from the {self.side} at rib {self.level:g}"

    def __str__(self) -> str:
        return f"{self.force_n:g} N from the {self.side} at rib {self.level:g}"


@dataclass(frozen=True)
class Candidate:
    """What may be taken: a pushed state, and from where it is seen."""

    frame: Frame
    view: PlannedView


@dataclass(frozen=True)
class Wish:
    """What a plan is asked for.

    Attributes
    ----------
    target : "bending", "tissue", "rotation" (about the axis), or "cobb", the Cobb angle under the push ``predicted``.
    limit_n : largest force. exposures : radiographs at most, unloaded ones included, in frontal ones.
    sides, ribs : where to push. views : of a pushed state.
    lateral_cost : of a lateral radiograph, in frontal ones.

    Raises
    ------
    SubjectError : a Cobb angle without the push that it is to be predicted for, or the other way round; a force too
        small to plan with; no push or no view at all; a lateral radiograph that costs nothing; too few exposures for
        any push.
    """

    target: Target = "bending"
    limit_n: float = COMFORT_N
    exposures: float = EXPOSURES
    sides: tuple[Literal["left", "right"], ...] = SIDES
    ribs: tuple[float, ...] = RIBS
    predicted: Frame | None = None
    views: tuple[PlannedView, ...] = VIEWS
    lateral_cost: float = 1.0

    def __post_init__(self) -> None:
        if self.target == "cobb" and self.predicted is None:
            raise SubjectError("a Cobb angle is predicted under a push; give --under SIDE,RIB,FORCE, e.g. right,8,60")
        if self.target != "cobb" and self.predicted is not None:
            raise SubjectError("--under names a push to predict a Cobb angle under; it goes with --target cobb")
        if not LEAST_LIMIT_N <= self.limit_n < math.inf:
            raise SubjectError(f"a largest force of {self.limit_n:g} N; wanted {LEAST_LIMIT_N:g} N or more")
        if not self.sides or not self.ribs:
            raise SubjectError("no side or no rib to push; give at least one of each")
        if not self.views:
            raise SubjectError(f"no view to take; give one of {', '.join(VIEWS)}, or both")
        if not 0.0 < self.lateral_cost < math.inf:
            raise SubjectError(
                f"a lateral radiograph that costs {self.lateral_cost:g} frontal ones; wanted a number above 0"
            )
        # An unloaded and a loaded one of each view.
        least = 2.0 if "frontal" in self.views else 2.0 * (1.0 + self.lateral_cost)
        if not self.exposures >= least - ROUNDING:
            raise SubjectError(
                f"exposures for {self.exposures:g} frontal radiographs; a push seen as {self.views[0]} takes {least:g}"
            )

    @property
    def frames(self) -> list[Frame]:
        """All pushed states."""
        pushes = product(self.sides, self.ribs, SHARES)
        # Down, so that none is above the limit.
        return [Frame(side, rib, math.floor(10.0 * share * self.limit_n + 1e-9) / 10.0) for side, rib, share in pushes]


def make_plan(scene: Scene, wish: Wish, say: Observer = lambda line: None) -> Plan:
    """The best single push, and the best sequence.

    Raises
    ------
    SubjectError : the target is no ratio of the estimate.
    EquilibriumError : the torso can carry no push that is allowed, or not the one whose Cobb angle is wanted.
    """
    if wish.target != "cobb" and RATIO_OF[wish.target] not in scene.names:
        raise SubjectError(
            f"the estimate has no ratio {RATIO_OF[wish.target]} (it has {', '.join(scene.names)}); "
            f"run spinestiff estimate with {RATIO_OF[wish.target]} among its --parameters, or choose another target"
        )
    carried = _Carried(scene, wish, say)
    widths = _Widths(scene, wish, carried, say)
    return _composed(scene, wish, carried, widths, say)


def _at_rest(torso: TorsoModel, view: XRayView) -> Features:
    return state_features(torso, view, torso.rest_pose, silhouette_shares(torso, view, torso.rest_pose))


class _Carried:
    """The frames that the torso can carry at all places, with their trials and states."""

    def __init__(self, scene: Scene, wish: Wish, say: Observer) -> None:
        torso, taken = scene.torso, scene.taken
        self.groups = parameter_groups(torso, scene.names)
        self._problems: dict[str, EquilibriumProblem] = {}
        rest = _at_rest(torso, scene.view)
        corners = VertebraCorners(torso.vertebrae, rest.corners).selected(scene.vertebrae)
        tracked = VertebraCorners(corners.vertebrae, corners.corners, np.full(corners.corners.shape[:2], QUALITY))
        self._aside: tuple[VertebraCorners, XRayView] | None = None
        if any(view != "frontal" for view in wish.views):
            seen = VertebraCorners(torso.vertebrae, _at_rest(torso, scene.lateral).corners)
            self._aside = seen.selected(scene.aside), scene.lateral
        self.known: list[tuple[EquilibriumProblem, Trial]] = []
        self.known_still: list[tuple[EquilibriumProblem, Trial]] = []
        for item in taken.fitted if taken else ():
            assert taken is not None
            (self.known if item.force_n > 0.0 else self.known_still).append((taken.problems[item.push], item.trial))

        def trial(frame: Frame, push: str, seen: VertebraCorners, by_hand: bool) -> tuple[EquilibriumProblem, Trial]:
            if frame.side not in self._problems:
                self._problems[frame.side] = push_problem(torso, frame.side, scene.rig)
            site = PushSite(frame.side, frame.level, D21_MM, D31_MM)
            load = push_load(torso, site, frame.force_n, scene.rig, str(frame))
            return self._problems[frame.side], Trial(load, seen, scene.view, str(frame), push, by_hand)

        planned = {
            frame: (problem, self._from_aside(one))
            for frame in wish.frames
            for problem, one in [trial(frame, frame.push, tracked, False)]
        }
        self.predicted = (
            None if wish.predicted is None else trial(wish.predicted, f"predicted {wish.predicted}", corners, True)
        )
        self.states: list[list[TorsoState]] = []  # by place: of the known, the frames and the predicted one
        self.places: list[Floats] = []
        found: list[dict[Frame, TorsoState]] = []
        before: dict[Frame, TorsoState] = {}
        for number, place in enumerate(scene.places):
            say(f"place {number + 1} of {len(scene.places)}: {counted(len(planned), 'candidate')}")
            ratios = StiffnessRatios(self.groups, np.exp(place))
            try:
                known = self._chain(self.known, ratios)
            except EquilibriumError:
                continue  # a place that what was seen already rules out
            last = [] if self.predicted is None else self._chain([self.predicted], ratios)
            there: dict[Frame, TorsoState] = {}
            for push in dict.fromkeys(frame.push for frame in planned):
                own = [(frame, one) for frame, one in planned.items() if frame.push == push]
                there |= self._carried_by(own, ratios, rest.angle, before)
            before = there
            self.places.append(place)
            self.states.append([*known, *last])
            found.append(there)
        if not self.places:
            raise EquilibriumError("no equilibrium under the pushes that were taken, wherever the ratios may lie")
        self.frames = [frame for frame in planned if all(frame in there for there in found)]
        if not self.frames:
            raise EquilibriumError(
                f"no push of {min(SHARES) * wish.limit_n:g} to {wish.limit_n:g} N leaves all vertebrae within "
                f"{np.degrees(MOST_TURN):.0f} degrees; allow smaller forces with --limit"
            )
        self.planned = {frame: planned[frame] for frame in self.frames}
        self.left_out = [frame for frame in planned if frame not in self.planned]
        count = len(self.known)
        self.states = [
            [*own[:count], *(there[frame] for frame in self.frames), *own[count:]]
            for own, there in zip(self.states, found)
        ]
        self.pushes = list(dict.fromkeys(frame.push for frame in self.frames))
        self.still = [
            (
                planned[f][0],
                self._from_aside(Trial(no_load(), corners, scene.view, f"{push} unloaded", push, annotated=True)),
            )
            for push in self.pushes
            for f in [next(frame for frame in self.frames if frame.push == push)]
        ]
        self.candidates = [Candidate(frame, view) for frame in self.frames for view in VIEWS if view in wish.views]
        self.end_vertebrae = self._curve(scene, corners)

    def _from_aside(self, trial: Trial) -> Trial:
        """A trial that is to be taken, with a lateral radiograph beside where one is allowed.

        Where its corners are taken from does not matter; a plan depends on what they tell of a change.
        """
        if self._aside is None:
            return trial
        corners, view = self._aside
        return replace(trial, further=(Picture(corners, view, f"{trial.label} lateral", f"{trial.push} lateral"),))

    @staticmethod
    def _chain(trials: Sequence[tuple[EquilibriumProblem, Trial]], ratios: StiffnessRatios) -> list[TorsoState]:
        """States of trials in their order, each from the one of less force in its push."""
        states: dict[int, TorsoState] = {}
        last: dict[str, TorsoState] = {}
        for i in sorted(range(len(trials)), key=lambda i: trials[i][1].load.size):
            problem, trial = trials[i]
            states[i] = last[trial.push] = problem.solve(trial.load, ratios, last.get(trial.push)).require().state
        return [states[i] for i in range(len(trials))]

    def _carried_by(
        self,
        trials: Sequence[tuple[Frame, tuple[EquilibriumProblem, Trial]]],
        ratios: StiffnessRatios,
        rest: Floats,
        before: Mapping[Frame, TorsoState],
    ) -> dict[Frame, TorsoState]:
        """States of a push's frames up to the first that the torso can't carry, or that turns vertebrae too far.

        ``before`` : states at another place, to start from.
        """
        found: dict[Frame, TorsoState] = {}
        state: TorsoState | None = None
        for frame, (problem, trial) in sorted(trials, key=lambda one: one[0].force_n):
            try:
                state = problem.solve(trial.load, ratios, before.get(frame, state)).require().state
            except EquilibriumError:
                break
            torso, view = problem.torso, trial.view
            now = state_features(torso, view, state, silhouette_shares(torso, view, torso.rest_pose)).angle
            if np.ptp(now - rest) > MOST_TURN:
                break
            found[frame] = state
        return found

    @staticmethod
    def _curve(scene: Scene, corners: VertebraCorners) -> tuple[int, int]:
        """Rows of the end vertebrae of the largest curve at rest."""
        angle = cobb_angle(tilts(corners.vertebrae, corners.corners, scene.view))
        return corners.vertebrae.index(angle.upper), corners.vertebrae.index(angle.lower)


@dataclass(frozen=True)
class _Width:
    """Of what a set of radiographs leaves: log of the factor either way of each ratio, and degrees either way."""

    logs: tuple[float, ...]
    degrees: float | None


class _Widths:
    """Expected widths of the 95 % intervals, by set of radiographs."""

    def __init__(self, scene: Scene, wish: Wish, carried: _Carried, say: Observer) -> None:
        loaded = [*carried.known, *carried.planned.values()]
        loaded += [] if carried.predicted is None else [carried.predicted]
        still = [*carried.known_still, *carried.still]
        seen_as = "procrustes" if scene.taken is None else scene.taken.orientation
        trials = _OneByOne([p for p, _ in loaded], [trial for _, trial in loaded], carried.groups, seen_as)
        known = scene.known
        held = ratio_prior(carried.groups, scene.torso.joints.kinds, known.priors.level_smoothness, scene.population)
        problem = WeighedProblem(trials, still, seen_as, known.priors, known.geometry, known.taped, held)
        better = {"trunk size": known.priors.trunk_taped / max(known.priors.trunk, 1e-300)}
        self.designs: list[Design] = []
        for number, (place, states) in enumerate(zip(carried.places, carried.states)):
            say(f"place {number + 1} of {len(carried.places)}: what each radiograph would tell")
            self.designs.append(_told(problem, place, states, scene.tracking_factor))
        self.taped = [] if known.taped else [better_known(one, problem.unknowns, better) for one in self.designs]
        shown = iter(problem.shown)
        known_ones = [n for _ in carried.known for n in next(shown)]
        self._of_frame = {frame: next(shown) for frame in carried.frames}
        if carried.predicted is not None:
            next(shown)
        self.taken = (*known_ones, *(n for _ in carried.known_still for n in next(shown)))
        self._of_push = {push: next(shown) for push in carried.pushes}
        self._own = problem.trials
        self._lateral_cost = wish.lateral_cost
        self._unseen = len(loaded) - 1 if carried.predicted is not None else None
        if self._unseen is not None:
            self._weights = problem.noise.boxes(self._unseen).turning(*carried.end_vertebrae)
        self._target = wish.target
        self._index = None if wish.target == "cobb" else scene.names.index(RATIO_OF[wish.target])
        self._widest = 0.5 * float(np.log(RATIO_BOUNDS[1] / RATIO_BOUNDS[0]))

    def radiographs(self, candidate: Candidate, taken: Sequence[int]) -> tuple[int, ...]:
        """Numbers of those that taking it adds: its own, and the unloaded ones of its push that there are not yet."""
        views = 1 if candidate.view == "frontal" else 2
        wanted = self._of_push[candidate.frame.push][:views] + self._of_frame[candidate.frame][:views]
        return tuple(number for number in wanted if number not in taken)

    def cost(self, radiographs: Sequence[int]) -> float:
        """In frontal ones."""
        return sum(1.0 if number < self._own else self._lateral_cost for number in radiographs)

    def of(self, taken: Sequence[int], taped: bool = False) -> _Width:
        """Mean over the places."""
        reach = WIDTH_FACTOR * norm.ppf(0.5 + 0.5 * CONFIDENCE)
        designs = self.taped if taped else self.designs
        logs = np.mean([np.minimum(reach * one.ratio_sds(taken), self._widest) for one in designs], axis=0)
        degrees = None
        if self._unseen is not None:
            sds = [one.prediction_sd(taken, self._unseen, self._weights) for one in designs]
            degrees = float(np.degrees(reach * np.mean(sds)))
        return _Width(tuple(logs.tolist()), degrees)

    def size(self, width: _Width) -> float:
        """What is to become small."""
        if self._index is not None:
            return width.logs[self._index]
        assert width.degrees is not None
        return width.degrees


class _OneByOne(TrialSet):
    """Trials whose tangents are let go one by one: each holds a factor, 30 MB on the coarse mesh, and there are dozens.

    First order comes with the equilibria, and without tangents.
    """

    def __init__(
        self,
        problems: Sequence[EquilibriumProblem],
        trials: Sequence[Trial],
        groups: tuple[ParameterGroup, ...],
        orientation: Orientation,
    ) -> None:
        super().__init__(problems, trials, groups, orientation, None)
        self._orientation: Orientation = orientation
        self._last: tuple[Evaluation, Slope] | None = None

    def solve(
        self,
        log_ratios: Floats,
        near: Evaluation | None = None,
        slope: Slope | None = None,
        acts: Floats | None = None,
        starts: Sequence[TorsoState] | None = None,
        linearised: bool = True,
        most_factorisations: float = np.inf,
    ) -> Evaluation:
        """As that of all at once; from ``starts``, else from rest."""
        assert near is None
        assert slope is None
        assert linearised
        acts = np.zeros((len(self.trials), len(ACTS))) if acts is None else acts

        def solved(i: int) -> tuple[Evaluation, Slope]:
            # A set of its own, which keeps its last tangent, ends with this call.
            alone = TrialSet([self.problems[i]], [self.trials[i]], self.groups, self._orientation, None)
            start = None if starts is None else starts[i : i + 1]
            found = alone.solve(
                log_ratios,
                acts=acts[i : i + 1],
                starts=start,
                linearised=True,
                most_factorisations=most_factorisations,
            )
            return found, replace(alone.slope(found, with_acts=True), tangents=())

        self._last = None
        parts = in_parallel(solved, range(len(self.trials)))
        found = Evaluation(
            np.array(log_ratios),
            np.array(acts),
            tuple(part.equilibria[0] for part, _ in parts),
            tuple(part.residuals[0] for part, _ in parts),
        )
        moves, acted = zip(*((first.moves[0], first.acted[0]) for _, first in parts if first.acted is not None))
        self._last = found, Slope((), moves, acted)
        return found

    def slope(self, point: Evaluation, with_acts: bool = False) -> Slope:
        """Of the point that was solved last."""
        assert with_acts
        assert self._last is not None
        assert self._last[0] is point
        return self._last[1]


def _told(problem: WeighedProblem, place: Floats, states: Sequence[TorsoState], tracking_factor: float) -> Design:
    """What each radiograph would tell at a place."""
    point = problem.solve(place, np.zeros(len(problem.unknowns)), starts=states)
    return design_at(problem, point, problem.slope(point), tracking_factor)


@dataclass(frozen=True)
class _Option:
    """A candidate after what was taken: radiographs that it adds, their cost, what all of them leave."""

    candidate: Candidate
    added: tuple[int, ...]
    cost: float
    width: _Width


def _composed(scene: Scene, wish: Wish, carried: _Carried, widths: _Widths, say: Observer) -> Plan:
    def described(option: _Option) -> PlannedPush:
        frame, width = option.candidate.frame, option.width
        factors = {name: round(float(np.exp(log)), 3) for name, log in zip(scene.names, width.logs)}
        ratio = wish.target != "cobb"
        return PlannedPush(
            side=frame.side,
            level=frame.level,
            force_n=frame.force_n,
            view=option.candidate.view,
            radiographs=len(option.added),
            expected_factor=factors[RATIO_OF[wish.target]] if ratio else None,
            expected_deg=None if ratio or width.degrees is None else round(width.degrees, 2),
            factors=factors,
        )

    def options(taken: tuple[int, ...], at_most: float) -> list[_Option]:
        """All that add something, in the candidates' order."""
        found = []
        for candidate in carried.candidates:
            added = widths.radiographs(candidate, taken)
            if added and (cost := widths.cost(added)) <= at_most + ROUNDING:
                found.append(_Option(candidate, added, cost, widths.of((*taken, *added))))
        return found

    def narrowness(one: tuple[PlannedPush, _Option]) -> tuple[float, int]:
        """As it is told, so that of two that come to the same the one with fewer radiographs is the better."""
        push = one[0]
        told = push.expected_deg if push.expected_factor is None else push.expected_factor
        return told or 0.0, push.radiographs

    say("comparing")
    singles = sorted(((described(one), one) for one in options(widths.taken, np.inf)), key=narrowness)
    taken, sequence = widths.taken, list[PlanStep]()
    size, spent, pays = widths.size(widths.of(taken)), 0.0, True
    while True:
        count = len(taken) - len(widths.taken)
        say(f"sequence: {counted(count, 'exposure')}")
        found = options(taken, wish.exposures - spent)
        if not found:
            break
        before = size
        best = min(found, key=lambda one: (widths.size(one.width) - before) / one.cost)
        taken, spent, size = (*taken, *best.added), spent + best.cost, widths.size(best.width)
        pays = pays and 1.0 - size / before > PAYS * best.cost
        sequence.append(PlanStep(push=described(best), exposures=count + len(best.added), pays=bool(pays)))
    now = widths.of(widths.taken) if widths.taken else None
    taped = None
    if widths.taped:
        with_tape = widths.of(widths.taken or singles[0][1].added, taped=True)
        taped = widths.size(with_tape)
        taped = round(taped if wish.target == "cobb" else float(np.exp(taped)), 3)
    notes = [*scene.doubts, *_left_out(carried.left_out)]
    if len(carried.places) < len(scene.places):
        lost = len(scene.places) - len(carried.places)
        notes.append(f"{counted(lost, 'place')} of {len(scene.places)} left out: no equilibrium under what was seen")
    return Plan(
        target=wish.target,
        limit_n=wish.limit_n,
        basis="population" if scene.taken is None else "estimate",
        taken=len(widths.taken),
        now={} if now is None else {n: round(float(np.exp(v)), 3) for n, v in zip(scene.names, now.logs)},
        estimated={name: round(factor, 3) for name, factor in scene.intervals.items()},
        now_deg=None if now is None or now.degrees is None else round(now.degrees, 2),
        next=tuple(push for push, _ in singles),
        sequence=tuple(sequence),
        taped=taped,
        predicted=None
        if wish.predicted is None
        else (wish.predicted.side, wish.predicted.level, wish.predicted.force_n),
        notes=tuple(notes),
    )


def _left_out(frames: Sequence[Frame]) -> list[str]:
    """A line for each side and force."""
    found = []
    for side, force in dict.fromkeys((frame.side, frame.force_n) for frame in frames):
        ribs = [f"{frame.level:g}" for frame in frames if (frame.side, frame.force_n) == (side, force)]
        found.append(
            f"{force:g} N from the {side} at {'rib' if len(ribs) == 1 else 'ribs'} {', '.join(ribs)}: left out; where "
            f"the ratios may lie, the torso can't carry it or vertebrae would turn by more than "
            f"{np.degrees(MOST_TURN):.0f} degrees"
        )
    return found
