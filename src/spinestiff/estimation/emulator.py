"""The weighed fit's residuals as smooth functions of the log ratios, from the places that were solved.

Where a place was solved, residuals, nuisances and their slopes are known. Kriging (``kriging``) carries them to all
others at no equilibrium. What needs many places (profiles, regions, draws) is read there; the ends of intervals are
solved for and become places themselves (``profiles``). Where the same residuals are known on a coarser mesh, those tell
the shape, and what phi differs by at the places of the finer one, which changes slowly, is carried to all others.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from spinestiff.arrays import Floats
from spinestiff.estimation.kriging import LENGTH, Kriging
from spinestiff.estimation.point import WeighedPoint, WeighedSlope
from spinestiff.estimation.weighed import Reduced, Weights, reduced

# Of what phi and nuisances on a finer mesh differ by from those on a coarser one: lengths tried beside ``LENGTH``, each
# with these variances of what slopes have beside the difference's own, in units of its variance; the likeliest are
# taken. Where tissue creases, the slope at a place says little of the way to the next one.
DIFFERENCE_LENGTHS, SLOPE_NOISES = (1.4, 1.0, 0.7, 0.5), (0.0, 0.1, 1.0, 10.0)
# Of a difference's derivatives by its own values, in log ratio.
DIFFERENCE = 1e-3
# A place whose nuisances are farther than this from the most probable ones there tells of another part of the space,
# unless phi would gain no more than so much by those; where psi is higher than the estimate's by ``HIGH``, the second
# numbers count. One where it is higher by ``HIGHEST`` tells of nothing that matters, one as near as ``NEAREST`` to
# another of no more than that.
FARTHEST_NUISANCES, LITTLE_GAIN, HIGH, HIGHEST, NEAREST = (0.3, 1.0), (0.2, 1.0), 6.0, 200.0, 0.03
_CHUNK = 64


@dataclass(frozen=True)
class Place:
    """Where residuals are known: a solved point and first order around it."""

    point: WeighedPoint
    slope: WeighedSlope


def _kept(places: Sequence[Place], weights: Weights, telling: bool) -> list[tuple[Place, Reduced]]:
    known = [(place, reduced(place.point, place.slope, weights)) for place in places]
    return _apart(_telling(known) if telling else known)


def _telling(places: list[tuple[Place, Reduced]]) -> list[tuple[Place, Reduced]]:
    """The places that tell of where the estimate may be, the estimate first."""
    least = places[0][1].psi
    others = [
        (place, model)
        for place, model in places[1:]
        if model.psi - least < HIGHEST and tells(place.point, model, least)
    ]
    return [places[0], *others]


def tells(point: WeighedPoint, model: Reduced, least: float) -> bool:
    """Whether a place's nuisances are near enough to the most probable ones to tell psi; ``least``: the estimate's."""
    far, high = np.abs(point.nuisances - model.nuisances).max(initial=0.0), int(model.psi - least >= HIGH)
    return bool(far < FARTHEST_NUISANCES[high] or model.gain < LITTLE_GAIN[high])


def _apart(places: list[tuple[Place, Reduced]]) -> list[tuple[Place, Reduced]]:
    """Of places next to each other the latest, whose nuisances are the best known; the estimate in any case."""
    kept = places[:1]
    for place, model in reversed(places[1:]):
        if min(np.abs(place.point.log_ratios - other.point.log_ratios).max() for other, _ in kept) > NEAREST:
            kept.append((place, model))
    return kept


class _Surface:
    """Whitened residuals, and their derivatives in the nuisances, over the log ratios.

    Residuals are a smooth function of the ratios only together with nuisances that are one. Those that a search came by
    with are none: residuals are taken, to first order, at the most probable ones, as interpolated.

    Parameters
    ----------
    kept : places and their linear models.
    """

    def __init__(self, kept: list[tuple[Place, Reduced]], weights: Weights) -> None:
        log_ratios = np.array([place.point.log_ratios for place, _ in kept])
        most, follow = (np.array([getattr(model, name) for _, model in kept]) for name in ("nuisances", "follow"))
        self.nuisances = Kriging(log_ratios, most, follow)
        smooth, along = self.nuisances.at(log_ratios), self.nuisances.slopes(log_ratios)
        values, slopes, columns = [], [], []
        for (place, _), nuisances, change in zip(kept, smooth, along):
            there = place.point.values + place.slope.nuisances @ (nuisances - place.point.nuisances)
            whitened = weights.whiten(np.column_stack([there, place.slope.ratios, place.slope.nuisances]))
            p = place.slope.ratios.shape[1]
            values.append(whitened[:, 0])
            columns.append(whitened[:, 1 + p :])
            slopes.append(whitened[:, 1 : 1 + p] + columns[-1] @ change)
        across = np.array(columns)
        self._shape = across.shape[1:]
        self._residuals = Kriging(log_ratios, np.array(values), np.array(slopes))
        self._columns = Kriging(log_ratios, across.reshape(len(kept), -1), None)

    def at(self, where: Floats) -> tuple[Floats, Floats]:
        """(S, R) residuals with all nuisances 0, to first order, and (S, R, M) derivatives, at places (S, P)."""
        columns = self._columns.at(where).reshape(len(where), *self._shape)
        return self._residuals.at(where) - np.einsum("snm,sm->sn", columns, self.nuisances.at(where)), columns


@dataclass(frozen=True)
class _Solved:
    """On a surface: phi (S,), half the log determinant of the nuisances' precision (S,), the most probable nuisances
    (S, M) and, if asked for, their covariance (S, M, M), in prior sds."""

    phi: Floats
    precision: Floats
    nuisances: Floats
    covariance: Floats


class Emulator:
    """psi over the log ratios, nuisances integrated out (``weighed``), and its two parts.

    Parameters
    ----------
    places : where residuals are known, the estimate first, then in the order in which they were solved.
    weights : of the estimate.
    prior_sds : (M,) factors on the nuisances' prior standard deviations.
    telling : keep only places that tell of where the estimate may be.
    rough : where the same residuals are known on a coarser mesh, its estimate first; they tell the shape, ``places``
        what is to be added to phi, to the most probable nuisances and to their log precision.
    """

    def __init__(
        self,
        places: Sequence[Place],
        weights: Weights,
        prior_sds: Floats | None = None,
        telling: bool = True,
        rough: Sequence[Place] = (),
    ) -> None:
        kept = _kept(places, weights, telling)
        self._surface = _Surface(_kept(rough, weights, True) if rough else kept, weights)
        self.log_ratios = np.array([place.point.log_ratios for place, _ in kept])
        self._m = kept[0][0].slope.nuisances.shape[1]
        self._sds = np.ones(self._m)
        self._added = self._difference([model for _, model in kept]) if rough else None
        if prior_sds is not None:
            self._sds = prior_sds

    def _difference(self, models: list[Reduced]) -> tuple[Kriging, Kriging, Kriging]:
        """Of phi, of the most probable nuisances, and of half their precision's log determinant, at the kept places,
        from what the surface alone has there.

        Each of the first two may be one that goes over within a short way, which then keeps to where it was seen:
        carried on as far as residuals are, it would dig holes where nothing was solved. One place tells no length.
        """
        wanted = np.array([[model.psi - model.log_precision, *model.nuisances] for model in models])
        slopes = np.array([np.vstack([model.ratios.T @ model.values, model.follow]) for model in models])
        steps = DIFFERENCE * np.eye(self.log_ratios.shape[1])
        own, climbing = self._on_surface(self.log_ratios), np.zeros_like(slopes)
        for i, step in enumerate(steps):
            ahead, behind = (self._on_surface(self.log_ratios + sign * step) for sign in (1.0, -1.0))
            climbing[:, :, i] = (ahead - behind) / (2.0 * DIFFERENCE)
        apart, changing = wanted - own, slopes - climbing
        precise = np.array([model.log_precision for model in models]) - self._solved(self.log_ratios).precision
        return (
            self._likeliest(apart[:, :1], changing[:, :1]),
            self._likeliest(apart[:, 1:], changing[:, 1:]),
            Kriging(self.log_ratios, precise[:, None], None),
        )

    def _likeliest(self, values: Floats, slopes: Floats) -> Kriging:
        """Through values (K, R) and slopes (K, R, P) at the kept places, of the length and noise that they tell."""
        ways: list[tuple[float, bool, float]] = [(LENGTH, True, 0.0)]
        if len(values) > 1:
            ways += [(length, False, noise) for length in DIFFERENCE_LENGTHS for noise in SLOPE_NOISES]
            ways += [(LENGTH, False, noise) for noise in SLOPE_NOISES[1:]]
        told = np.any(values != values[0], axis=0) | np.any(slopes != slopes[0], axis=(0, 2))
        tried = [Kriging(self.log_ratios, values, slopes, *way) for way in ways]
        return max(tried, key=lambda one: float(one.log_likelihood[told].sum()))

    def _on_surface(self, where: Floats) -> Floats:
        solved = self._solved(where)
        return np.column_stack([solved.phi, solved.nuisances])

    def phi(self, log_ratios: Floats) -> Floats:
        """(S,) with nuisances at their most probable, at places (S, P)."""
        return self._parts(log_ratios)[0]

    def psi(self, log_ratios: Floats) -> Floats:
        """(S,) with nuisances integrated out, at places (S, P)."""
        phi, precision = self._parts(log_ratios)
        return phi + precision

    def residuals(self, log_ratios: Floats) -> tuple[Floats, Floats]:
        """Whitened, with all nuisances 0 (S, R), and their derivatives in the nuisances (S, R, M), at places (S, P);
        of the coarser mesh, where the shape is from one."""
        return self._surface.at(np.atleast_2d(log_ratios))

    def _parts(self, log_ratios: Floats) -> tuple[Floats, Floats]:
        """(S,) phi, and half the log determinant of the nuisances' precision, at places (S, P)."""
        where = np.atleast_2d(log_ratios)
        solved = self._solved(where)
        if self._added is None:
            return solved.phi, solved.precision
        phi, _, precision = (added.at(where)[:, 0] for added in self._added)
        return solved.phi + phi, solved.precision + precision

    def nuisances(self, log_ratios: Floats) -> tuple[Floats, Floats]:
        """Most probable nuisances (M,) at a place (P,), and their covariance (M, M) there, in prior sds."""
        where = np.atleast_2d(log_ratios)
        solved = self._solved(where, True)
        most = solved.nuisances if self._added is None else solved.nuisances + self._added[1].at(where)
        return most[0], solved.covariance[0]

    def _solved(self, where: Floats, covariance: bool = False) -> _Solved:
        phi, precision, most, inverses = [], [], [], []
        for begin in range(0, len(where), _CHUNK):
            part = where[begin : begin + _CHUNK]
            free, columns = self._surface.at(part)
            columns = columns * self._sds
            normal = np.eye(self._m) + np.swapaxes(columns, 1, 2) @ columns
            right = np.einsum("snm,sn->sm", columns, free)
            solved = np.linalg.solve(normal, right[..., None])[..., 0]
            phi.append(0.5 * (np.sum(free**2, axis=1) - np.sum(right * solved, axis=1)))
            precision.append(0.5 * np.linalg.slogdet(normal)[1])
            most.append(-solved * self._sds)
            if covariance:
                inverses.append(np.linalg.inv(normal) * np.outer(self._sds, self._sds))
        return _Solved(
            np.concatenate(phi),
            np.concatenate(precision),
            np.concatenate(most),
            np.concatenate(inverses) if covariance else np.zeros(0),
        )


def by_differences(function: Callable[[Floats], Floats], step: float) -> Callable[[Floats], tuple[float, Floats]]:
    """Value and central differences over ``step`` (P,) at one place (P,), of a function of places (S, P)."""

    def both(where: Floats) -> tuple[float, Floats]:
        count = len(where)
        values = function(where + step * np.vstack([np.zeros(count), np.eye(count), -np.eye(count)]))
        return float(values[0]), (values[1 : 1 + count] - values[1 + count :]) / (2.0 * step)

    return both
