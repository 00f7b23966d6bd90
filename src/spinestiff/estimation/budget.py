"""Where an estimate's uncertainty comes from, and how far it rests on what was taken as known before the fit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular
from scipy.optimize import minimize

from spinestiff.arrays import Floats
from spinestiff.estimation.causes import ANNOTATED, DISCREPANCY, DRAG, PERSONAL, STANCE, TRACKING, Cause
from spinestiff.estimation.discrepancy_data import STANCE_MM
from spinestiff.estimation.emulator import Emulator, Place, by_differences
from spinestiff.estimation.noise import lower_root
from spinestiff.estimation.weighed import WeighedFit, WeighedProblem, Weights

FACTORS = (0.5, 2.0)
SMALLEST_MM = 0.02
# Of a log ratio that the data say nothing of.
LEAST_PRECISION = 1e-6


@dataclass(frozen=True)
class BudgetRow:
    """What one unknown does to the standard deviations (P,) of the log ratios, to first order at the estimate.

    Where the patient stood for a sequence is unknown throughout: no measurement but the pictures tells it.

    Attributes
    ----------
    alone : with this unknown and tracking's errors only.
    without : with all unknowns but this one: what measuring it would gain.
    """

    name: Cause
    alone: tuple[float, ...]
    without: tuple[float, ...]


@dataclass(frozen=True)
class Budget:
    """All rows, with the standard deviations (P,) of everything together, and of tracking (and stance) alone."""

    rows: tuple[BudgetRow, ...]
    together: tuple[float, ...]
    tracking: tuple[float, ...]


@dataclass(frozen=True)
class PriorChange:
    """The estimate (P,) and the sd of its logs (P,), by the likelihood's curvature there, with one prior's standard
    deviation times ``factor``."""

    name: Cause
    factor: float
    ratios: tuple[float, ...]
    sd: tuple[float, ...]


def variance_budget(problem: WeighedProblem, fit: WeighedFit) -> Budget:
    """By unknown, at the estimate."""
    parts = covariance_parts(problem, fit)
    # A radiograph annotated by hand has no tracking error; without any it would be the exact truth.
    base = parts.pop(TRACKING) + parts[STANCE] + SMALLEST_MM**2 * np.eye(problem.size)

    def spread(covariance: Floats) -> tuple[float, ...]:
        root = lower_root(covariance)
        whitened = solve_triangular(root, fit.slope.ratios, lower=True)
        return tuple(linear_sds(whitened.T @ whitened))

    whole = base + sum(part for name, part in parts.items() if name != STANCE)
    rows = [
        BudgetRow(name, spread(base + part), spread(whole - part)) for name, part in parts.items() if name != STANCE
    ]
    return Budget(tuple(rows), spread(whole), spread(base))


def linear_sds(precision: Floats) -> Floats:
    """(P,) standard deviations of log ratios, to first order; large where ``precision`` (P, P) can't part them."""
    return np.asarray(np.sqrt(np.diag(np.linalg.inv(precision + LEAST_PRECISION * np.eye(len(precision))))))


def covariance_parts(problem: WeighedProblem, fit: WeighedFit) -> dict[Cause, Floats]:
    """(n, n) of the residuals, by cause; tracking's holds the errors of measured supports, too."""
    n, channels = problem.size, slice(0, problem.noise.size)

    def whole(part: Floats) -> Floats:
        result = np.zeros((n, n))
        result[channels, channels] = part
        return result

    tracking = whole(problem.noise.tracking(fit.weights.tracking_factor, fit.weights.inflation))
    tracking[range(problem.noise.size, n), range(problem.noise.size, n)] = 1.0
    found: dict[Cause, Floats] = {TRACKING: tracking}
    found |= {name: whole(part) for name, part in problem.noise.parts.items()}
    found |= {DRAG: whole(problem.moving.drag(fit.point)), DISCREPANCY: whole(problem.moving.discrepancy(fit.point))}
    for group in problem.unknowns.groups:
        columns = fit.slope.nuisances[:, problem.unknowns.in_group(group)]
        found[group] = columns @ columns.T
    return found


def repeated_sds(problem: WeighedProblem, fit: WeighedFit, annotation_alone: bool = False) -> Floats:
    """(P,) standard deviations of the log ratios from visit to visit of one person whose stiffness stays.

    To first order the estimate is off by G e, G = (X^T C^-1 X)^-1 X^T C^-1, for residuals' errors e with covariance C.
    What belongs to the person (``PERSONAL``) is off by the same at each visit; all else is drawn anew. With
    ``annotation_alone`` only what an annotation of the same radiographs brings is (``ANNOTATED``). Either way the
    geometry is found anew, and with it the motions are off: by what annotation does, and from visit to visit by what
    the stance does, too.
    """
    parts = covariance_parts(problem, fit)
    drawn = [name for name in parts if (name in ANNOTATED if annotation_alone else name not in PERSONAL)]
    anew = sum((parts[name] for name in drawn), start=np.zeros((problem.size, problem.size)))
    channels = slice(0, problem.noise.size)
    marked = problem.priors.annotation_mm
    corner_mm = marked if annotation_alone else float(np.hypot(marked, STANCE_MM))
    anew[channels, channels] += problem.moving.of_geometry(fit.point, corner_mm)
    # What is held of the ratios is no data, and the same at each visit.
    anew[problem.data :] = anew[:, problem.data :] = 0.0
    nuisances = fit.slope.nuisances
    whole = fit.weights.root @ fit.weights.root.T + nuisances @ nuisances.T
    solved = np.linalg.solve(whole, fit.slope.ratios)
    precision = fit.slope.ratios.T @ solved
    # A direction that the data say nothing of stays where it is.
    gain = np.linalg.pinv(precision, hermitian=True) @ solved.T
    return np.asarray(np.sqrt(np.maximum(np.diag(gain @ anew @ gain.T), 0.0)))


def prior_changes(
    problem: WeighedProblem, fit: WeighedFit, places: Sequence[Place], rough: Sequence[Place] = ()
) -> tuple[PriorChange, ...]:
    """The estimate with each prior's standard deviation halved and doubled, on the emulator."""
    found: list[PriorChange] = []
    for group in problem.unknowns.groups:
        for factor in FACTORS:
            sds = np.where(problem.unknowns.in_group(group), factor, 1.0)
            found.append(_changed(group, factor, Emulator(places, fit.weights, sds, rough=rough), fit, problem.limits))
    parts = covariance_parts(problem, fit)
    kept = (DRAG, DISCREPANCY, *problem.noise.parts)
    fixed = sum(parts[name] for name in (TRACKING, *kept))
    for name in kept:
        for factor in FACTORS:
            root = lower_root(fixed + (factor**2 - 1.0) * parts[name])
            weights = Weights(root, fit.weights.tracking_factor, fit.weights.inflation)
            found.append(_changed(name, factor, Emulator(places, weights, rough=rough), fit, problem.limits))
    return tuple(found)


def _changed(
    name: Cause, factor: float, emulator: Emulator, fit: WeighedFit, limits: tuple[float, float]
) -> PriorChange:
    start, step = fit.point.log_ratios, 1e-2
    height = by_differences(emulator.psi, step)
    best = minimize(height, start, jac=True, method="L-BFGS-B", bounds=[limits] * len(start)).x
    gradients = [
        (height(best + step * axis)[1] - height(best - step * axis)[1]) / (2.0 * step) for axis in np.eye(len(start))
    ]
    values, axes = np.linalg.eigh(0.5 * (np.array(gradients) + np.array(gradients).T))
    # No ratio is known less well than anywhere within the bounds.
    values = np.maximum(values, (limits[1] - limits[0]) ** -2)
    sd = np.sqrt(np.diag(axes / values @ axes.T))
    return PriorChange(name, factor, tuple(np.exp(best).tolist()), tuple(sd.tolist()))
