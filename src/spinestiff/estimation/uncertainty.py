"""How well the ratios are known: covariance, intervals, joint region, identifiability.

The estimator is least squares, so an error e of the residuals moves the log ratios by -(J^T J)^-1 J^T e, and its
covariance is (J^T J)^-1 J^T Sigma J (J^T J)^-1 with Sigma the covariance of the errors. Sigma is far from white. The
four corners of a vertebra come from three numbers (two shifts, one turn); wrong rest geometry, template and
annotation are the same in every frame, and alike in neighbouring vertebrae; a wrong force bends the whole spine. White
errors, sigma^2 (J^T J)^-1, give intervals several times too narrow. So

- the residuals' own part takes each of the three numbers as a series along the spine with an exponential or a smooth
  (Gaussian) correlation. Its size comes from what the fit left over; its length, which the data know only roughly, is
  averaged over by restricted likelihood. Frames are taken by load: their load-weighted sum is what the ratios live on;
- it is never less than independent corner errors of a given size would give;
- the gauge's force, the pushed point's height and whatever else is known with a standard deviation n are added as
  J_n S_n J_n^T.

With simulated errors (tests/estimation/test_uncertainty.py: two deflections correlated at -0.99, 17 vertebrae, two
frames, 400 repeats a kind) the 95 % intervals cover the truth in 90-99 % for independent, vertebra-wise, neighbouring
and smooth errors alike; white errors do so in 30-60 % as soon as frames share errors, a cluster-robust sandwich by
vertebra in 55-96 %. Errors smooth over more than four vertebrae or so look like a deflection: no residual shows them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.stats import f as fisher
from scipy.stats import t as student

from spinestiff.arrays import Floats, Ints, ShortRepr, read_only
from spinestiff.errors import FitError
from spinestiff.imaging.features import FEATURE_SHAPE

# What is averaged over: correlation length along the spine in vertebrae, and whether errors vary smoothly.
CORRELATIONS = (
    *((length, False) for length in (0.0, 1.0, 2.0, 4.0, 8.0)),
    *((length, True) for length in (1.0, 2.0, 4.0)),
)
# Share of a smooth error that is a vertebra's own (annotation, tracking).
OWN_SHARE = 0.05
FEWEST_DOF = 4.0
# Directions in which the residuals change less than this, relative to the best one, are not estimated at all.
SMALLEST_RELATIVE_INFORMATION = 1e-12
CONFIDENCE = 0.95


@dataclass(frozen=True)
class UncertaintySettings:
    """What is known about the inputs' errors, as standard deviations.

    Attributes
    ----------
    corner_sd_mm : of a corner along u or v at the patient plane; a floor under what the residuals say.
    force_sd : of a push's force, relative; common to its frames.
    push_height_sd_mm : of the height of the pushed point; common to the frames of a push.
    picture_shift_sd_mm : of the patient's place in each radiograph against that at rest, along columns and rows, at
        the patient plane.
    motion_sd : relative error of the simulated motion that mesh and rest geometry leave, common to the frames of a
        push: one that scales it and one that grows along the spine. Both shipped meshes lie 3 to 5 % below the limit
        in their change of tilt (docs/validation.md).
    """

    corner_sd_mm: float = 0.3
    force_sd: float = 0.02
    push_height_sd_mm: float = 5.0
    picture_shift_sd_mm: float = 0.5
    motion_sd: float = 0.05

    def __post_init__(self) -> None:
        if not self.corner_sd_mm > 0.0:
            raise FitError(f"corner_sd_mm {self.corner_sd_mm}; wanted > 0")
        if not min(self.force_sd, self.push_height_sd_mm, self.picture_shift_sd_mm, self.motion_sd) >= 0.0:
            raise FitError("force_sd, push_height_sd_mm, picture_shift_sd_mm and motion_sd: wanted >= 0")


@dataclass(frozen=True, repr=False)
class Nuisance(ShortRepr):
    """An input that is not quite known.

    Attributes
    ----------
    name : e.g. "force of push 1".
    column : (n,) derivative of the weighted residuals in it.
    sd : its standard deviation, in the same unit.
    """

    name: str
    column: Floats
    sd: float


@dataclass(frozen=True, repr=False)
class ResidualLayout(ShortRepr):
    """What each block of eight residuals (four corners, u and v) belongs to.

    Attributes
    ----------
    vertebra : (m,) place along the spine, head to foot.
    trial : (m,) 0, 1, ...
    arms : (m, 4, 2) corners of the measured box from its centre; gives the residuals' turning part.
    """

    vertebra: Ints
    trial: Ints
    arms: Floats

    def __post_init__(self) -> None:
        set_ = object.__setattr__
        set_(self, "vertebra", read_only("vertebra", self.vertebra, (None,), FitError, np.int64))
        set_(self, "trial", read_only("trial", self.trial, (len(self.vertebra),), FitError, np.int64))
        set_(self, "arms", read_only("arms", self.arms, (len(self.vertebra), *FEATURE_SHAPE), FitError))

    def channels(self, values: Floats) -> Floats:
        """Shifts along u and v and turn of each vertebra in each trial, (3, T, V, k) mm, from values (8 m, k).

        The three are orthonormal combinations of the eight, so that sums of squares stay. What is not visible is 0.
        """
        arms = self.arms - self.arms.mean(axis=1, keepdims=True)
        turn = np.stack([-arms[..., 1], arms[..., 0]], -1)
        turn = turn / np.linalg.norm(turn, axis=(1, 2), keepdims=True)
        shift = np.zeros((2, len(self.vertebra), 4, 2))
        shift[0, :, :, 0] = shift[1, :, :, 1] = 0.5
        basis = np.stack([*shift, turn])
        blocks = values.reshape(len(self.vertebra), *FEATURE_SHAPE, -1)
        rows = np.unique(self.vertebra, return_inverse=True)[1]
        filled = np.zeros((3, int(self.trial.max()) + 1, int(rows.max()) + 1, blocks.shape[-1]))
        filled[:, self.trial, rows] = np.einsum("cmki,mkip->cmp", basis, blocks)
        return filled

    @property
    def places(self) -> Ints:
        """(V,) places along the spine of ``channels``' vertebra axis."""
        return np.asarray(np.unique(self.vertebra), dtype=np.int64)


@dataclass(frozen=True, repr=False)
class Uncertainty(ShortRepr):
    """Distribution of the estimated log ratios: normal with a covariance that is itself estimated.

    Attributes
    ----------
    covariance : (P, P) of the log ratios.
    dof : (P,) degrees of freedom of each variance (Student's t).
    parts : cause -> (P, P) share of the covariance: "residuals", then the nuisances by name.
    condition : condition number of J^T J, infinite if a ratio changes nothing.
    correlation_length : vertebrae, posterior mean of the residuals' correlation length.
    """

    covariance: Floats
    dof: Floats
    parts: dict[str, Floats] = field(repr=False)
    condition: float
    correlation_length: float

    @property
    def correlation(self) -> Floats:
        """(P, P); 1 on the diagonal, NaN for a ratio without information."""
        sd = np.sqrt(np.diag(self.covariance))
        with np.errstate(invalid="ignore"):
            return np.asarray(self.covariance / np.outer(sd, sd))

    @property
    def half_width(self) -> Floats:
        """(P,) half of the 95 % interval of each log ratio."""
        quantile = student.ppf(0.5 + 0.5 * CONFIDENCE, self.dof)
        return np.asarray(quantile * np.sqrt(np.diag(self.covariance)))

    def interval(self, log_ratios: Floats) -> tuple[Floats, Floats]:
        """Ends (P,), (P,) of the 95 % intervals of the ratios themselves (log-normal)."""
        with np.errstate(over="ignore"):
            return np.exp(log_ratios - self.half_width), np.exp(log_ratios + self.half_width)

    @property
    def region_size(self) -> float:
        """Squared Mahalanobis radius of the 95 % joint region, P F(P, dof)."""
        p = len(self.covariance)
        return float(p * fisher.ppf(CONFIDENCE, p, float(self.dof.min())))

    def distance2(self, offset: Floats) -> float:
        """Squared Mahalanobis length of an offset of the log ratios; 0 along directions without information."""
        if not np.isfinite(self.covariance).all():
            return 0.0
        return float(offset @ np.linalg.lstsq(self.covariance, offset, rcond=None)[0])


def estimator_uncertainty(
    jacobian: Floats,
    values: Floats,
    layout: ResidualLayout,
    nuisances: Sequence[Nuisance] = (),
    settings: UncertaintySettings | None = None,
) -> Uncertainty:
    """Uncertainty of the least-squares log ratios.

    Parameters
    ----------
    jacobian : (n, P) derivative of the weighted residuals at the estimate.
    values : (n,) the weighted residuals there, mm.
    layout : what the rows belong to.
    nuisances : inputs that are not quite known.
    settings : for the floor under the corners' error.
    """
    settings = settings or UncertaintySettings()
    p = jacobian.shape[1]
    information = jacobian.T @ jacobian
    scales = np.linalg.eigvalsh(information)
    if not scales[0] > SMALLEST_RELATIVE_INFORMATION * scales[-1]:
        return Uncertainty(np.full((p, p), np.inf), np.full(p, FEWEST_DOF), {}, float("inf"), float("nan"))
    inverse = np.linalg.inv(information)
    middle, dof, length = _residual_part(jacobian, values, layout)
    own = _larger(inverse @ middle @ inverse, settings.corner_sd_mm**2 * inverse)
    plain = Uncertainty(own, np.full(p, dof), {"residuals": own}, float(scales[-1] / scales[0]), length)
    return with_nuisances(plain, jacobian, nuisances)


def with_nuisances(spread: Uncertainty, jacobian: Floats, nuisances: Sequence[Nuisance]) -> Uncertainty:
    """The uncertainty with more inputs that are not quite known, J_n S_n J_n^T carried through the estimator.

    For what a fit does not know by itself: rest geometry, supports, distances. ``jacobian`` is the fit's, and each
    nuisance's column (n,) the change of its weighted residuals, e.g. by differences.
    """
    if not np.isfinite(spread.covariance).all():
        return spread
    parts = dict(spread.parts)
    inverse = np.linalg.inv(jacobian.T @ jacobian)
    for nuisance in nuisances:
        if nuisance.column.shape != (len(jacobian),):
            raise FitError(f"nuisance '{nuisance.name}' has {nuisance.column.size} rows, wanted {len(jacobian)}")
        if nuisance.name in parts:
            raise FitError(f"nuisance '{nuisance.name}' is given twice")
        shift = inverse @ (jacobian.T @ nuisance.column) * nuisance.sd
        parts[nuisance.name] = np.outer(shift, shift)
    covariance = np.sum(list(parts.values()), axis=0)
    # Welch-Satterthwaite: only the residuals' share is estimated, the rest is known.
    dof = spread.dof * (np.diag(covariance) / np.diag(spread.covariance)) ** 2
    return Uncertainty(covariance, dof, parts, spread.condition, spread.correlation_length)


def _residual_part(jacobian: Floats, values: Floats, layout: ResidualLayout) -> tuple[Floats, float, float]:
    """J^T Sigma J from the residuals, its degrees of freedom, and the mean correlation length."""
    x, e = layout.channels(jacobian), layout.channels(values[:, None])[..., 0]
    # Frames in order of what they say about the ratios: first their load-weighted sum, then what is left.
    weights, modes = np.linalg.eigh(np.einsum("ctvp,csvp->ts", x, x))
    modes = modes[:, ::-1]
    informative = weights[::-1] > 1e-2 * weights[-1]
    x, e = np.einsum("ctvp,tm->cmvp", x, modes), np.einsum("ctv,tm->cmv", e, modes)
    x, e = x[:, informative], e[:, informative]
    places = layout.places
    distance = np.abs(np.subtract.outer(places, places)).astype(float)
    found = [_at_length(x, e, distance, *how) for how in CORRELATIONS]
    likelihood = np.array([entry[0] for entry in found])
    share = np.exp(likelihood - likelihood.max())
    share = share / share.sum()
    middle = np.einsum("l,lpq->pq", share, np.array([entry[1] for entry in found]))
    dof = float(share @ np.array([entry[2] for entry in found]))
    return middle, max(dof, FEWEST_DOF), float(share @ np.array([length for length, _ in CORRELATIONS]))


def spine_kernel(distance: Floats, length: float, smooth: bool) -> Floats:
    """Correlation of two vertebrae's errors by their distance (V, V), in vertebrae."""
    if length == 0.0:
        return np.asarray((distance == 0.0).astype(float))
    if smooth:
        return np.asarray((1.0 - OWN_SHARE) * np.exp(-0.5 * (distance / length) ** 2) + OWN_SHARE * (distance == 0.0))
    return np.asarray(np.exp(-distance / length))


def _at_length(x: Floats, e: Floats, distance: Floats, length: float, smooth: bool) -> tuple[float, Floats, float]:
    """Restricted log likelihood, J^T Sigma J and degrees of freedom for one correlation length."""
    channels, modes, places, p = x.shape
    kernel = spine_kernel(distance, length, smooth)
    root = np.linalg.cholesky(kernel + 1e-9 * np.eye(places))
    determinant = 2.0 * float(np.log(np.diag(root)).sum())
    likelihood, middle, dofs, sizes = 0.0, np.zeros((p, p)), [], []
    for c in range(channels):
        left = np.empty((places, modes))
        for m in range(modes):
            # Whitened series and regressors; what the ratios could explain is taken out before the size is read.
            wx, we = np.linalg.solve(root, x[c, m]), np.linalg.solve(root, e[c, m])
            basis, scale, _ = np.linalg.svd(wx, full_matrices=False)
            kept = scale > 1e-6 * max(scale.max(initial=0.0), 1e-300)
            basis = basis[:, kept]
            left[:, m] = we - basis @ (basis.T @ we)
            likelihood -= float(np.log(scale[kept]).sum())
        free = max(places - p, 1)
        sizes_c = left.T @ left / free
        tiny = 1e-12 * (np.trace(sizes_c) + 1e-12)
        likelihood -= 0.5 * free * float(np.linalg.slogdet(sizes_c + tiny * np.eye(modes))[1])
        likelihood -= 0.5 * modes * determinant
        part = np.einsum("mn,mvp,vw,nwq->pq", sizes_c, x[c], kernel, x[c])
        middle += part
        sizes.append(float(np.trace(part)))
        dofs.append(max(places**2 / float(kernel.sum()) - 1.0, 1.0))
    share = np.array(sizes) / max(sum(sizes), 1e-300)
    return likelihood, middle, 1.0 / max(float(np.sum(share**2 / np.array(dofs))), 1e-12)


def _larger(a: Any, b: Any) -> Floats:
    """The smallest covariance of this construction not below ``a`` or ``b`` in any direction; b positive definite."""
    root = np.linalg.cholesky(b)
    inner = np.linalg.solve(root, np.linalg.solve(root, a).T)
    scale, axes = np.linalg.eigh(0.5 * (inner + inner.T))
    turned = root @ axes
    return np.asarray((turned * np.maximum(scale, 1.0)) @ turned.T)
