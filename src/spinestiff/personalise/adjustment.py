"""The most probable vertebrae: a robust bundle adjustment of poses, sizes and stances under the elastic prior.

Minimised over the vertebrae's poses x, what they are in themselves s (log sizes, pedicles' places, tapers) and each
view's stance n (Gauss and Newton, with weights renewed at every step):

    sum_k rho(|r_k(x, s, n)|) + E(x) / ENERGY_SCALE + s . C^-1 s / 2 + sum (n / sd_n)^2 / 2
    rho(e) = e^2 / (2 sigma^2) / (1 + (e / c)^2),    c = max(4 sigma, 3 mm)     (Geman and McClure 1987)

The corners' standard deviation sigma falls from 16 mm by halves to what the residuals themselves show: the image's
weight 1/sigma^2 is annealed, and a wrong corner is told from the shape that the others agree on (graduated
non-convexity; Blake and Zisserman 1987). A vertebra that is unusual, though, looks like a wrong one as long as the
others hold it where they would have it, and so does a whole spine far from the template. So the fit is repeated from
where it leads with next to no prior, from where their own corners put the vertebrae with a corner set aside, then with
those that all views set aside let go by the prior (one in a hundred is expected to be like that). The most probable
answer is kept: that of the smallest minus logarithm, with what the points' standard deviations (the logarithm of each
point's variance: sigma^2, of a pedicle PEDICLE_SD^2 more) and the prior (``ElasticPrior.norm``) are normalised by. The
covariance is the inverse of the Gauss-Newton Hessian at the end.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from spinestiff.anatomy.rotation import exp_so3
from spinestiff.arrays import Floats, Ints
from spinestiff.errors import FitError
from spinestiff.observer import Observer
from spinestiff.personalise.image_terms import UNKNOWNS, VIEW_UNKNOWNS, ImagePoints, Shape
from spinestiff.personalise.prior import ElasticPrior, own_precision

# mm at the patient plane.
FIRST_SD, SD_LIMITS = 16.0, (0.25, 4.0)
# A residual of this many standard deviations, and of this many mm, has lost three quarters of its weight.
CUTOFF, LEAST_CUTOFF_MM = 4.0, 3.0
# Weight below which a point counts as wrong.
WRONG_WEIGHT = 0.1
# Part of all vertebrae that lie where none is expected.
UNUSUAL = 0.01
STEPS = 15
# 1/rad^2, of a turn that stays as it is.
HELD = 1e9
# Share of the prior in the fit that shows where it would lead without.
SOFT = 0.02
# mm, of each pedicle about the place that left and right share mirrored.
PEDICLE_SD = 1.0
# mm, or rad times 30 mm: while annealing, and at the end.
SMALL_STEP, SMALLEST_STEP = 0.1, 1e-3


@dataclass(frozen=True)
class Adjusted:
    """What ``adjust`` found.

    Attributes
    ----------
    shape : the vertebrae.
    poses : (N, 4) of the views: two shifts (mm), roll and yaw (rad).
    weights : of each view's points (P,), 0 = wrong to 1.
    corner_sd : mm, the corners' standard deviation along one axis.
    covariance : (15V, 15V), unknowns as ``image_terms.UNKNOWNS``, vertebra by vertebra.
    pose_covariance : (4N, 4N) of the views' unknowns; zero where one is held.
    prior_share : (V, 6) the prior's share in what is uncertain of a vertebra's dt and dw, its neighbours fixed: with
        C = (I + P)^-1 of the image's and the prior's parts, (C P C)_kk / C_kk.
    """

    shape: Shape
    poses: Floats
    weights: tuple[Floats, ...]
    corner_sd: float
    covariance: Floats
    pose_covariance: Floats
    prior_share: Floats


def adjust(
    views: Sequence[ImagePoints],
    prior: ElasticPrior,
    start: Shape,
    poses: Floats,
    pose_sd: Floats,
    first_sd: float = FIRST_SD,
    observer: Observer | None = None,
) -> Adjusted:
    """The most probable vertebrae for the annotated points.

    Parameters
    ----------
    views : annotated points.
    prior : of the poses.
    start, poses : where to begin; poses (N, 4).
    pose_sd : (N, 4) standard deviations of the views' unknowns about zero; 0 holds one where it is.
    first_sd : mm, where the annealing begins.

    Raises
    ------
    FitError : no finite solution, or hardly a point that agrees with the others.
    """
    system = _System(views, prior, pose_sd)
    best = system.refined(*system.annealed(start, poses, first_sd, observer))
    shape, stance, soft = system.softened().annealed(start, poses, first_sd)
    soft = system.normal(shape, stance, max(soft.estimated_sd, SD_LIMITS[0]))
    best = min(best, system.refined(shape, stance, soft), key=_Answer.cost)
    for again in (_System.doubted, _System.disowned):
        which = again(system, best.normal)
        if len(which):
            tried = system.freeing(which) if again is _System.disowned else system
            own = tried.by_own_corners(best.shape, best.poses, which)
            other = tried.refined(own, best.poses, tried.normal(own, best.poses, best.normal.sd))
            best = min(best, other, key=_Answer.cost)
    if observer:
        observer(
            f"corner sd {best.normal.sd:.2f} mm: rms {best.normal.rms:.2f} mm, {best.normal.wrong} points set aside"
        )
    if best.normal.weights.sum() < 0.5 * len(best.normal.weights):
        raise FitError(
            "most annotated corners contradict each other or the template; check vertebra names, the order of corners, "
            "spacing and the directions of the views"
        )
    return best.system.result(best)


@dataclass(frozen=True)
class _Normal:
    """Normal equations at one point: image part and whole Hessian, slope, weights of all points, weighted squares.

    ``cost`` is what is minimised there, with the logarithm of each point's variance, and ``sd`` sigma in mm.
    """

    image: Floats
    hessian: Floats
    slope: Floats
    weights: Floats
    squares: float
    cost: float
    sd: float

    @property
    def rms(self) -> float:
        """mm, of the weighted residuals."""
        return float(np.sqrt(self.squares / self.weights.sum()))

    @property
    def estimated_sd(self) -> float:
        """mm along one axis: what the residuals leave once the unknowns that the images fix are counted."""
        spent = float(np.trace(np.linalg.solve(self.hessian, self.image)))
        return float(np.sqrt(self.squares / max(2.0 * self.weights.sum() - spent, 1.0)))

    @property
    def wrong(self) -> int:
        return int((self.weights < WRONG_WEIGHT).sum())


@dataclass(frozen=True)
class _Answer:
    """Where one descent ended, and under which prior."""

    system: _System
    shape: Shape
    poses: Floats
    normal: _Normal

    def cost(self) -> float:
        """Minus the logarithm of its probability, but for what all answers share."""
        return self.normal.cost + self.system.norm


class _System:
    def __init__(self, views: Sequence[ImagePoints], prior: ElasticPrior, pose_sd: Floats, freed: int = 0) -> None:
        self.views, self.prior, self.pose_sd = views, prior, np.asarray(pose_sd, dtype=float)
        self.norm = prior.norm - freed * np.log(UNUSUAL)
        self.count = len(prior.positions)
        self.free = np.flatnonzero(self.pose_sd.ravel() > 0.0)
        self.own = own_precision(self.count)
        size = UNKNOWNS * self.count + len(self.free)
        first = UNKNOWNS * np.arange(self.count)
        self.pose_rows = (first[:, None] + np.arange(6)).ravel()
        self.own_rows = [first + 6 + k for k in range(UNKNOWNS - 6)]
        # The Hessian of all that is no image.
        self.fixed = fixed = np.zeros((size, size))
        fixed[np.ix_(self.pose_rows, self.pose_rows)] = self.prior.hessian
        for rows, precision in zip(self.own_rows, self.own):
            fixed[np.ix_(rows, rows)] = precision
        tail = np.arange(UNKNOWNS * self.count, size)
        fixed[tail, tail] = 1.0 / self.pose_sd.ravel()[self.free] ** 2

    def annealed(
        self, shape: Shape, poses: Floats, sd: float, observer: Observer | None = None
    ) -> tuple[Shape, Floats, _Normal]:
        """From corners that hardly count to those of the largest standard deviation that is believed."""
        while True:
            shape, poses, normal = self.settled(shape, poses, sd, SMALL_STEP)
            if observer:
                observer(f"corner sd {sd:.2f} mm: rms {normal.rms:.2f} mm, {normal.wrong} points set aside")
            if sd <= SD_LIMITS[1]:
                return shape, poses, normal
            sd = max(0.5 * sd, SD_LIMITS[1])

    def softened(self) -> _System:
        """The same with next to no prior."""
        prior = replace(self.prior, gradient=SOFT * self.prior.gradient, hessian=SOFT * self.prior.hessian)
        return _System(self.views, prior, self.pose_sd)

    def refined(self, shape: Shape, poses: Floats, normal: _Normal) -> _Answer:
        """From here on the residuals say how exact the corners are."""
        sd = normal.sd
        for _ in range(10):
            found = float(np.clip(normal.estimated_sd, 0.5 * sd, SD_LIMITS[1]))
            found = max(found, SD_LIMITS[0])
            close = abs(found - sd) <= 0.03 * sd
            sd = found
            shape, poses, normal = self.settled(shape, poses, sd, SMALLEST_STEP if close else SMALL_STEP)
            if close:
                break
        return _Answer(self, shape, poses, normal)

    def settled(self, shape: Shape, poses: Floats, sd: float, small: float) -> tuple[Shape, Floats, _Normal]:
        for _ in range(STEPS):
            normal = self.normal(shape, poses, sd)
            step = -np.asarray(np.linalg.solve(normal.hessian, normal.slope), dtype=float)
            if not np.isfinite(step).all():
                raise FitError(
                    "the fit to the radiographs has no finite solution; check corners, spacing and distances"
                )
            shape, poses, moved = self.moved(shape, poses, step)
            if moved < small:
                break
        return shape, poses, self.normal(shape, poses, sd)

    def normal(self, shape: Shape, poses: Floats, sd: float) -> _Normal:
        size = len(self.fixed)
        image, slope, cost = np.zeros((size, size)), np.zeros(size), self.prior.energy(shape)
        weights, squares = [], []
        for number, (view, pose) in enumerate(zip(self.views, poses)):
            residual, own, nuisance = view.linearised(shape, pose)
            # Left and right pedicles are not quite alike: a point is as exact as both scatters allow.
            share = np.where(view.outward == 0.0, 1.0, sd**2 / (sd**2 + PEDICLE_SD**2))
            error2 = share * np.sum(residual**2, axis=1)
            cutoff = np.maximum(CUTOFF * sd, LEAST_CUTOFF_MM * np.sqrt(share))
            root = 1.0 / (1.0 + error2 / cutoff**2)
            cost += float(np.sum(0.5 * error2 * root / sd**2 + 2.0 * np.log(sd) - np.log(share)))
            weight = root**2
            jacobian = np.zeros((len(view), 2, size))
            columns = UNKNOWNS * view.vertebra[:, None] + np.arange(UNKNOWNS)
            np.put_along_axis(jacobian, np.repeat(columns[:, None], 2, axis=1), own, axis=2)
            for column, which in enumerate(self.free):
                if which // VIEW_UNKNOWNS == number:
                    jacobian[:, :, UNKNOWNS * self.count + column] = nuisance[:, :, which % VIEW_UNKNOWNS]
            root = np.sqrt(weight * share)
            scaled = (root[:, None, None] * jacobian).reshape(-1, size) / sd
            image += scaled.T @ scaled
            slope += scaled.T @ ((root[:, None] * residual).ravel() / sd)
            weights.append(weight)
            squares.append(error2)
        weight, error2 = np.concatenate(weights), np.concatenate(squares)
        hessian = image + self.fixed
        slope[self.pose_rows] += self.prior.slope(shape)
        for rows, precision, values in zip(self.own_rows, self.own, shape.own.T):
            slope[rows] += precision @ values
            cost += 0.5 * float(values @ precision @ values)
        stance = poses.ravel()[self.free] / self.pose_sd.ravel()[self.free] ** 2
        slope[UNKNOWNS * self.count :] += stance
        cost += 0.5 * float(stance @ poses.ravel()[self.free])
        return _Normal(image, hessian, slope, weight, float(np.sum(weight * error2)), cost, sd)

    def doubted(self, normal: _Normal) -> Ints:
        """Vertebrae with a point set aside in some view."""
        return np.flatnonzero((np.nan_to_num(self._set_aside(normal)) > 0.0).any(0))

    def disowned(self, normal: _Normal) -> Ints:
        """Vertebrae of which every view, and more than one, sets more than half aside."""
        shares = self._set_aside(normal)
        seen = np.isfinite(shares)
        return np.flatnonzero((seen.sum(0) > 1) & ((shares > 0.5) | ~seen).all(0))

    def _set_aside(self, normal: _Normal) -> Floats:
        """(N, V) of each view the share of a vertebra's points that is set aside; NaN where it has none."""
        weights = np.split(normal.weights, np.cumsum([len(view) for view in self.views])[:-1])
        shares = []
        for view, weight in zip(self.views, weights):
            points, aside = (
                np.bincount(view.vertebra[which], minlength=self.count)
                for which in (slice(None), weight < WRONG_WEIGHT)
            )
            shares.append(np.where(points > 0, aside / np.maximum(points, 1), np.nan))
        return np.array(shares)

    def freeing(self, which: Ints) -> _System:
        """The same, the prior letting go of those vertebrae: what is so unusual says nothing about its neighbours."""
        prior = self.prior
        for vertebra in which:
            prior = prior.without(int(vertebra))
        return _System(self.views, prior, self.pose_sd, len(which))

    def by_own_corners(self, shape: Shape, poses: Floats, which: Ints) -> Shape:
        """The shape with each of those vertebrae where its own points put it, none of them wrong, its neighbours
        without a say: place and tilt are next to free, 100 mm and 1 rad. How it is turned about the vertical stays: the
        outline of one round body does not tell."""
        size = len(self.fixed)
        rows = (UNKNOWNS * which[:, None] + np.arange(UNKNOWNS)).ravel()
        precision = np.zeros((size, size))
        for first in UNKNOWNS * which:
            precision[first + np.arange(6), first + np.arange(6)] = [1e-4, 1e-4, 1e-4, 1.0, HELD, 1.0]
            block = slice(first + 6, first + UNKNOWNS)
            precision[block, block] = np.diag(np.diag(self.fixed)[block])
        for _ in range(STEPS):
            hessian, slope = precision.copy(), np.zeros(size)
            own = shape.own
            for first, vertebra in zip(UNKNOWNS * which, which):
                slope[first + 6 : first + UNKNOWNS] = np.diag(precision)[first + 6 : first + UNKNOWNS] * own[vertebra]
            for view, pose in zip(self.views, poses):
                residual, jacobian, _ = view.linearised(shape, pose)
                for point in np.flatnonzero(np.isin(view.vertebra, which)):
                    block = slice(UNKNOWNS * view.vertebra[point], UNKNOWNS * (view.vertebra[point] + 1))
                    hessian[block, block] += jacobian[point].T @ jacobian[point]
                    slope[block] += jacobian[point].T @ residual[point]
            step = np.zeros(size)
            step[rows] = -np.linalg.solve(hessian[np.ix_(rows, rows)], slope[rows])
            shape, _, _ = self.moved(shape, poses, step)
        return shape

    def moved(self, shape: Shape, poses: Floats, step: Floats) -> tuple[Shape, Floats, float]:
        own = step[: UNKNOWNS * self.count].reshape(-1, UNKNOWNS)
        turn = own[:, 3:6]
        # A turn beyond half a radian leaves the linear range; the whole step is shortened with it.
        share = min(1.0, 0.5 / max(float(np.abs(turn).max()), 1e-12))
        own, turn = share * own, share * turn
        there = poses.copy().ravel()
        there[self.free] += share * step[UNKNOWNS * self.count :]
        moved = replace(
            shape,
            positions=shape.positions + own[:, :3],
            rotations=exp_so3(turn) @ shape.rotations,
            log_sizes=shape.log_sizes + own[:, 6:9],
            pedicles=shape.pedicles + own[:, 9:12],
            tapers=shape.tapers + own[:, 12:],
        )
        largest = max(float(np.abs(own[:, :3]).max()), 30.0 * float(np.abs(turn).max()))
        return moved, there.reshape(poses.shape), largest

    def result(self, answer: _Answer) -> Adjusted:
        normal = answer.normal
        covariance = np.asarray(np.linalg.inv(normal.hessian), dtype=float)
        covariance = 0.5 * (covariance + covariance.T)
        size = UNKNOWNS * self.count
        views = np.zeros((self.pose_sd.size, self.pose_sd.size))
        views[np.ix_(self.free, self.free)] = covariance[size:, size:]
        shares = []
        for first in range(0, size, UNKNOWNS):
            block = slice(first, first + UNKNOWNS)
            own = np.linalg.inv(normal.hessian[block, block])
            # The variance of what both hold together is the sum of what each lets through.
            shares.append(np.diag(own @ self.fixed[block, block] @ own)[:6] / np.diag(own)[:6])
        ends = np.cumsum([len(view) for view in self.views])[:-1]
        return Adjusted(
            answer.shape,
            answer.poses,
            tuple(np.split(normal.weights, ends)),
            normal.sd,
            covariance[:size, :size],
            views,
            np.array(shares),
        )
