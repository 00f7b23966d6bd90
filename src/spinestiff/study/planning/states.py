"""Which of the pushes that a plan may propose a torso carries, and how it stands under them.

All of them, and those that an estimate has been made from, are put into equilibrium at a few places where the ratios
may lie, once for all views.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from spinestiff.anatomy.regions import parameter_groups
from spinestiff.anatomy.state import TorsoState
from spinestiff.anatomy.stiffness import StiffnessRatios
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.arrays import Floats
from spinestiff.curves.tilts import cobb_angle, tilts
from spinestiff.errors import EquilibriumError
from spinestiff.estimation.objective import Picture, Trial
from spinestiff.imaging.features import Features, VertebraCorners, state_features
from spinestiff.imaging.projection import XRayView
from spinestiff.mechanics.equilibrium import EquilibriumProblem
from spinestiff.mechanics.loads import no_load
from spinestiff.mechanics.push import PushSite, push_load, push_problem
from spinestiff.observer import Observer
from spinestiff.study.planning.scene import Scene
from spinestiff.study.planning.wish import SHARES, VIEWS, Candidate, Frame, Wish
from spinestiff.words import counted

# A push under which vertebrae would turn against each other by more than this is not proposed.
MOST_TURN = np.deg2rad(45.0)
# Quality of a corner that tracking follows well; its error is about 0.11 mm.
QUALITY = 0.7
# The paper's distances; they matter where forces on shoulder and pelvis are loads.
D21_MM, D31_MM = 400.0, 200.0


def _at_rest(torso: TorsoModel, view: XRayView) -> Features:
    return state_features(torso, view, torso.rest_pose)


def none_carried(wish: Wish) -> EquilibriumError:
    """What is told where a torso carries no push of a wish."""
    return EquilibriumError(
        f"no push of {min(SHARES) * wish.limit_n:g} to {wish.limit_n:g} N leaves all vertebrae within "
        f"{np.degrees(MOST_TURN):.0f} degrees; allow smaller forces with --limit"
    )


class CarriedPushes:
    """The frames that the torso can carry at all places, with their trials and states."""

    def __init__(self, scene: Scene, wish: Wish, say: Observer = lambda line: None) -> None:
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
            raise none_carried(wish)
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
            now = state_features(torso, view, state).angle
            if np.ptp(now - rest) > MOST_TURN:
                break
            found[frame] = state
        return found

    @staticmethod
    def _curve(scene: Scene, corners: VertebraCorners) -> tuple[int, int]:
        """Rows of the end vertebrae of the largest curve at rest."""
        angle = cobb_angle(tilts(corners.vertebrae, corners.corners, scene.view))
        return corners.vertebrae.index(angle.upper), corners.vertebrae.index(angle.lower)
