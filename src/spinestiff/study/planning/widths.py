"""How narrow an estimate would be, to first order, from any set of the radiographs that a plan may propose."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import ndtri

from spinestiff.anatomy.state import TorsoState
from spinestiff.anatomy.stiffness import RATIO_BOUNDS, ParameterGroup
from spinestiff.arrays import Floats
from spinestiff.estimation.causes import Cause
from spinestiff.estimation.design import Design, better_known, design_at
from spinestiff.estimation.evaluation import Evaluation, Slope, TrialSet
from spinestiff.estimation.objective import Trial
from spinestiff.estimation.profiles import CONFIDENCE, WIDTH_FACTOR
from spinestiff.estimation.ratio_priors import ratio_prior
from spinestiff.estimation.sights import MarkerTarget
from spinestiff.estimation.unknowns import ACTS
from spinestiff.estimation.weighed import WeighedProblem
from spinestiff.imaging.features import Orientation
from spinestiff.mechanics.equilibrium import EquilibriumProblem
from spinestiff.observer import Observer
from spinestiff.parallel import in_parallel
from spinestiff.study.planning.scene import Scene
from spinestiff.study.planning.states import CarriedPushes
from spinestiff.study.planning.wish import Candidate


@dataclass(frozen=True)
class Width:
    """Of what a set of radiographs leaves: log of the factor either way of each ratio, and degrees either way."""

    logs: tuple[float, ...]
    degrees: float | None


class ExpectedWidths:
    """Expected widths of the 95 % intervals, by set of radiographs.

    Attributes
    ----------
    taken : numbers of what an estimate has been made from, what cameras saw of markers among it.
    taken_radiographs : how many of these are radiographs.
    """

    def __init__(self, scene: Scene, carried: CarriedPushes, say: Observer = lambda line: None) -> None:
        loaded = [*carried.known, *carried.planned.values()]
        loaded += [] if carried.predicted is None else [carried.predicted]
        still = [*carried.known_still, *carried.still]
        seen_as = "procrustes" if scene.taken is None else scene.taken.orientation
        trials = _OneByOne([p for p, _ in loaded], [trial for _, trial in loaded], carried.groups, seen_as)
        known = scene.known
        held = ratio_prior(carried.groups, scene.torso.joints.kinds, known.priors.level_smoothness, known.population)
        problem = WeighedProblem(trials, still, seen_as, known, held)
        better: dict[Cause, float] = {"trunk size": known.priors.trunk_taped / max(known.priors.trunk, 1e-300)}
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
        aside = {one.radiograph for one in problem.noise.seen if isinstance(one.target, MarkerTarget)}
        self.taken_radiographs = sum(number not in aside for number in self.taken)
        self._of_push = {push: next(shown) for push in carried.pushes}
        self._own = problem.trials
        self._unseen = len(loaded) - 1 if carried.predicted is not None else None
        if self._unseen is not None:
            self._weights = problem.noise.boxes(self._unseen).turning(*carried.end_vertebrae)
        self._widest = 0.5 * float(np.log(RATIO_BOUNDS[1] / RATIO_BOUNDS[0]))

    def radiographs(self, candidate: Candidate, taken: Sequence[int]) -> tuple[int, ...]:
        """Numbers of those that taking it adds: its own, and the unloaded ones of its push that there are not yet."""
        views = 1 if candidate.view == "frontal" else 2
        wanted = self._of_push[candidate.frame.push][:views] + self._of_frame[candidate.frame][:views]
        return tuple(number for number in wanted if number not in taken)

    def cost(self, radiographs: Sequence[int], lateral_cost: float) -> float:
        """In frontal ones."""
        return sum(1.0 if number < self._own else lateral_cost for number in radiographs)

    def of(self, taken: Sequence[int], taped: bool = False) -> Width:
        """Mean over the places."""
        reach = WIDTH_FACTOR * ndtri(0.5 + 0.5 * CONFIDENCE)
        designs = self.taped if taped else self.designs
        logs = np.mean([np.minimum(reach * one.ratio_sds(taken), self._widest) for one in designs], axis=0)
        degrees = None
        if self._unseen is not None:
            sds = [one.prediction_sd(taken, self._unseen, self._weights) for one in designs]
            degrees = float(np.degrees(reach * np.mean(sds)))
        return Width(tuple(logs.tolist()), degrees)


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
