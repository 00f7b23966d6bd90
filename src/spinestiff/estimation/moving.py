"""What the loaded trials show, how far the model moves it, and what is wrong in proportion to that, as covariances.

Three errors grow with the motion: tracking is taken along by what moves with the vertebra (drag), the model lacks
something of this person (``discrepancy``), and the geometry that the radiographs gave is not the person's. All are
shared by what shows one motion.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from spinestiff.arrays import Floats, Ints
from spinestiff.estimation.discrepancy import (
    IN_PLANE,
    OUT_OF_PLANE,
    DiscrepancyFrame,
    as_corners,
    discrepancy_columns,
    out_of_plane_columns,
    plane_motion,
    pushed_site,
    relative_covariance,
    skin_covariance,
)
from spinestiff.estimation.discrepancy_data import geometry_modes, modes_of
from spinestiff.estimation.evaluation import Evaluation, TrialSet
from spinestiff.estimation.noise import Noise
from spinestiff.estimation.point import WeighedPoint
from spinestiff.estimation.priors import Priors
from spinestiff.estimation.sights import MarkerTarget, Sight, SightResiduals
from spinestiff.imaging.features import state_features


class Moving:
    """What the loaded trials of a weighed fit show.

    Parameters
    ----------
    trial_set : the trials under load. noise : of all that is seen; the trials' own corners come first.
    at_rest : of all that is seen, what the model without load leaves of it.
    sights : place among what is seen, trial and target of all that loaded trials show beside their own corners.
    """

    def __init__(
        self,
        trial_set: TrialSet,
        noise: Noise,
        at_rest: Sequence[SightResiduals],
        sights: Sequence[tuple[int, int, Sight]],
        priors: Priors,
    ) -> None:
        self.trial_set, self.noise, self.sights, self.priors = trial_set, noise, tuple(sights), priors
        self.rows = (*range(len(trial_set.trials)), *(row for row, _, _ in sights))
        """Places among what is seen, in the order of ``parts``."""
        self._at_rest = at_rest
        self._modes = modes_of(trial_set.problems[0].torso)

    def parts(self, evaluation: Evaluation, further: Sequence[SightResiduals]) -> list[tuple[int, int, SightResiduals]]:
        """Place among what is seen, trial and residuals of all that the loaded trials show."""
        own: list[tuple[int, int, SightResiduals]] = [(i, i, part) for i, part in enumerate(evaluation.residuals)]
        return [*own, *((row, trial, part) for (row, trial, _), part in zip(self.sights, further, strict=True))]

    def motion(self, part: SightResiduals, row: int) -> Floats:
        """How far what is seen at a place lies from where it was at rest."""
        return np.asarray(part.difference - self._at_rest[row].difference)

    def motions(self, point: WeighedPoint) -> list[Floats]:
        """(n_i,) mm, channels of what the model moves from rest: of each loaded trial's own corners, (3 Nv,), then of
        all else that loaded trials show."""
        moving = self.parts(point.evaluation, point.further)
        return [self.noise.channels[row].apply(self.motion(part, row)) for row, _, part in moving]

    def drag(self, point: WeighedPoint) -> Floats:
        """(n, n) mm^2 of all channels: what tracking is taken along, as far as the model moves at ``point``."""
        moved = np.zeros(len(self.noise.seen))
        for (row, _, _), motion in zip(self.parts(point.evaluation, point.further), self.motions(point), strict=True):
            along = motion.reshape(-1, self.noise.channels[row].each)[:, 0]
            moved[row] = np.sign(along.sum()) * np.sqrt(np.mean(along**2))
        return self.noise.drag(moved)

    def discrepancy(self, point: WeighedPoint) -> Floats:
        """(n, n) mm^2 of all channels: what the model lacks, as large as it moves at ``point``."""
        covariance = np.zeros((self.noise.size, self.noise.size))
        where = self._channels(self.rows)
        if self._modes is None:
            covariance[np.ix_(where, where)] = relative_covariance(self.motions(point))
            return covariance
        frames = self._frames(point)
        columns = discrepancy_columns(frames, self._modes)
        whole = self._of_own_corners(columns)
        if self.sights:
            whole = self._with_further(whole, columns, out_of_plane_columns(frames, self._modes))
        covariance[np.ix_(where, where)] = whole @ whole.T
        skin = [(row, trial, target) for row, trial, target in self.sights if isinstance(target, MarkerTarget)]
        if skin:
            rows_of = self._channels([row for row, _, _ in skin])
            of = np.concatenate([np.full(len(target.rows), trial) for _, trial, target in skin])
            points = np.concatenate([target.resting for _, _, target in skin])
            covariance[np.ix_(rows_of, rows_of)] += skin_covariance(
                frames, self._modes, of, points, self.priors.marker_slide
            )
        return covariance

    def of_geometry(self, point: WeighedPoint, corner_mm: float) -> Floats:
        """(n, n) mm^2 of all channels: what a geometry found from corners off by ``corner_mm`` (standard deviation
        along an axis) does to the motions of the trials' own corners. ``discrepancy`` holds its share of it; 0 for
        torsos of which nothing was learnt."""
        covariance = np.zeros((self.noise.size, self.noise.size))
        modes = geometry_modes(self.trial_set.problems[0].torso, corner_mm)
        if modes is not None:
            where = self._channels(range(len(self.trial_set.trials)))
            whole = self._of_own_corners(discrepancy_columns(self._frames(point), modes))
            covariance[np.ix_(where, where)] = whole @ whole.T
        return covariance

    def _channels(self, rows: Iterable[int]) -> Ints:
        """Numbers of the channels of places among what is seen."""
        return np.concatenate([np.arange(self.noise.size)[self.noise.of(row)] for row in rows])

    def _frames(self, point: WeighedPoint) -> list[DiscrepancyFrame]:
        return [
            DiscrepancyFrame(*pushed_site(target.trial.load, problem.torso), self._whole_motion(i, point))
            for i, (target, problem) in enumerate(zip(self.trial_set.targets, self.trial_set.problems))
        ]

    def _of_own_corners(self, columns: Floats) -> Floats:
        """(n, K) channels of the loaded trials' own corners, of motions (F, V, 3, K) of the vertebrae."""
        rows = []
        for i, target in enumerate(self.trial_set.targets):
            moved = as_corners(columns[i][target.rows], target.z, target.trial.view)
            rows.append(self.noise.channels[i].apply(moved))
        return np.concatenate(rows)

    def _with_further(self, whole: Floats, columns: Floats, others: Floats) -> Floats:
        """(n, K) columns of the trials' own corners ``whole``, then of all else that the loaded trials show.

        ``columns`` (F, V, 3, k) and ``others`` (F, V, 3, l) are what the model lacks in and out of the frontal plane,
        as motions of the vertebrae. Learnt modes of corners hold what those see of the motion out of the plane.
        """
        jacobian = self.noise.pose_jacobian(self._at_rest, len(self.trial_set.problems[0].torso.vertebrae))
        rows = []
        for row, trial, _ in self.sights:
            slopes = jacobian[self.noise.of(row)]
            seen = [
                np.einsum("nvc,vck->nk", slopes[:, :, list(pose)], moved[trial])
                for pose, moved in ((IN_PLANE, columns), (OUT_OF_PLANE, others))
            ]
            rows.append(np.concatenate(seen, axis=1))
        nothing = np.zeros((len(whole), others.shape[-1]))
        return np.concatenate([np.concatenate([whole, nothing], axis=1), *rows])

    def _whole_motion(self, i: int, point: WeighedPoint) -> Floats:
        """(17, 3) of all vertebrae, seen or not, as ``discrepancy`` has motions."""
        target, torso = self.trial_set.targets[i], self.trial_set.problems[i].torso
        view, state = target.trial.view, point.evaluation.equilibria[i].state
        rest, now = (
            state_features(torso, view, s, target.shares, target.orientation, target.used).z
            for s in (torso.rest_pose, state)
        )
        return plane_motion(rest, now, view)
