"""What a fit tells beside its ratios: what else it found, how well it knows it, and what to be careful of."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from spinestiff.arrays import Floats
from spinestiff.estimation.budget import Budget, PriorChange, linear_sds, prior_changes, repeated_sds, variance_budget
from spinestiff.estimation.emulator import Place
from spinestiff.estimation.evaluation import Evaluation
from spinestiff.estimation.fitted import NuisanceEstimate, Weighed
from spinestiff.estimation.linear import best_known
from spinestiff.estimation.mode import CLOSE_SD, NEARLY
from spinestiff.estimation.objective import Target, residuals, undetermined_vertebrae
from spinestiff.estimation.profiles import Likely
from spinestiff.estimation.weighed import WeighedFit, WeighedProblem, reduced
from spinestiff.imaging.features import FEATURE_SHAPE

# Of the ratios' precision: beyond, what parts two combinations of ratios is rounding.
WORST_CONDITION = 1e12
# Draws are told as poor where they are worth less than so many independent ones.
FEWEST_DRAWS = 100.0
# Of a ratio's direction that lies where nothing is known: below, rounding of the eigenvectors.
SHARE_OF_UNKNOWN = 1e-9


def told(
    asked: WeighedProblem,
    found: WeighedFit,
    likely: Likely | None,
    known: tuple[Place, ...],
    rough: tuple[Place, ...],
    everything: bool,
) -> Weighed:
    """All that a weighed fit found beside its ratios.

    Parameters
    ----------
    likely, known : intervals, and the places that they come from.
    rough : places that are known on a coarser mesh. everything : with variance budget and other priors.
    """
    budget: Budget | None = None
    changes: tuple[PriorChange, ...] = ()
    if everything and likely is not None:
        budget = variance_budget(asked, found)
        changes = prior_changes(asked, found, known, rough) if known else ()
    return Weighed(
        nuisances=_nuisances(asked, found),
        acts=found.point.evaluation.acts,
        p_value=asked.p_value(found.point, found.slope),
        tracking_factor=found.weights.tracking_factor,
        outlying=tuple(asked.outlying(found.weights.inflation)),
        likely=likely,
        budget=budget,
        changes=changes,
        held=asked.ratio_prior.texts,
        data_sd=_data_sd(asked, found),
        visit_sd=repeated_sds(asked, found),
        annotation_sd=repeated_sds(asked, found, annotation_alone=True),
        best_known=best_known(found.point.log_ratios, _data_precision(asked, found)),
        log_likelihood=asked.log_likelihood(found.point, found.slope, found.weights),
        places=known,
        tilt=found.tilt,
    )


def ratio_covariance(found: WeighedFit) -> Floats:
    """(P, P) of the log ratios, to first order; rows and columns of ratios that the data can't part are infinite."""
    return partial_inverse(_precision(found))


def partial_inverse(precision: Floats) -> Floats:
    """(P, P) inverse of a precision; infinite in rows and columns of what takes part in a direction without any."""
    if not np.isfinite(precision).all():
        return np.full(precision.shape, np.inf)
    values, vectors = np.linalg.eigh(precision)
    known = values > values[-1] / WORST_CONDITION
    inverse = vectors[:, known] / values[known] @ vectors[:, known].T
    unknown = (vectors[:, ~known] ** 2).sum(axis=1) > SHARE_OF_UNKNOWN
    inverse[unknown] = inverse[:, unknown] = np.inf
    return np.asarray(inverse)


def trial_warnings(asked: WeighedProblem, default: Evaluation | None, point: Evaluation) -> list[str]:
    """What is odd about single trials."""
    trial_set, found = asked.trial_set, []
    for i, (problem, target) in enumerate(zip(trial_set.problems, trial_set.targets)):
        name = trial_set.trials[i].label or f"trial {i + 1}"
        rest = residuals(problem.torso, target, problem.torso.rest_pose).difference
        stood = _where_stood(asked, i)
        measured = stood[target.rows] - rest
        simulated = np.where(np.isnan(measured), 0.0, (default or point).residuals[i].difference - rest)
        if np.einsum("v,vki,vki->", target.quality, np.nan_to_num(measured), simulated) < 0.0:
            found.append(f"{name}: the spine moved against the push; check the side of the push and of the picture")
        square = undetermined_vertebrae(problem.torso, target)
        if square:
            found.append(f"{name}: orientation by covariance means little for {', '.join(square)} (near-square box)")
    return found


def _where_stood(asked: WeighedProblem, trial: int) -> Floats:
    """(V, 4, 2) mm, the torso at rest minus what the unloaded frame of a loaded trial's push shows, NaN of vertebrae
    that it does not; 0 where there is no such frame."""
    seen, loaded = asked.noise.seen, len(asked.trial_set.trials)
    torso = asked.trial_set.problems[trial].torso
    shape = (len(torso.vertebrae), *FEATURE_SHAPE)
    for one in seen[loaded : asked.trials]:
        if one.sequence == seen[trial].sequence and isinstance(one.target, Target):
            found = np.full(shape, np.nan)
            found[one.target.rows] = residuals(torso, one.target, torso.rest_pose).difference
            return found
    return np.zeros(shape)


def open_end_warnings(opens: Mapping[str, tuple[bool, bool]], bounds: tuple[float, float]) -> list[str]:
    """Intervals that reach the fit's bounds."""
    found = []
    for name, ends in opens.items():
        sides = [f"{side} {bound:g}" for side, bound, is_open in zip(("below", "above"), bounds, ends) if is_open]
        if sides:
            found.append(f"{name}: the radiographs also allow ratios {' and '.join(sides)}, the bounds of the fit")
    return found


def unsettled_warnings(
    search_end: WeighedFit | None, likely: Likely | None, names: Sequence[str], close_sd: float = CLOSE_SD
) -> list[str]:
    """Where search and intervals could not come as near as they should; ``close_sd``: as near as was asked."""
    if search_end is None or not search_end.status.usable:
        return []
    found = []
    if search_end.short > max(np.sqrt(2.0 * NEARLY), close_sd):
        found.append(
            "beside the estimate the torso jumps between equilibria, as where soft tissue creases; "
            f"the estimate is settled to {search_end.short:.1g} standard deviations"
        )
    if search_end.carried:
        found.append(
            "the radiographs tell so little of the ratios that the estimate still moved by "
            f"{search_end.carried:.1g} standard deviations when nuisances were integrated out for the last time"
        )
    if likely is None:
        return found
    if not likely.settled:
        found.append(
            "an end of the intervals, or a place between, is interpolated where the model was not solved, "
            "and less certain"
        )
    if likely.effective < FEWEST_DRAWS:
        found.append(f"the draws are worth no more than {likely.effective:.0f} independent ones; take the intervals")
    if likely.likelier is not None:
        ratios = np.exp(likely.likelier.log_ratios)
        where = ", ".join(f"{name} {ratio:.2g}" for name, ratio in zip(names, ratios))
        found.append(
            f"{where} explains the radiographs about as well as the estimate; take the interval, not the number"
        )
    return found


def _nuisances(asked: WeighedProblem, found: WeighedFit) -> tuple[NuisanceEstimate, ...]:
    columns = found.weights.whiten(np.column_stack([found.slope.nuisances, found.slope.ratios]))
    m, p = len(asked.unknowns), columns.shape[1] - len(asked.unknowns)
    # A direction of the ratios without information must not stop the rest.
    precision = columns.T @ columns + np.diag(np.r_[np.ones(m), np.full(p, 1e-9)])
    sds = np.sqrt(np.diag(np.linalg.inv(precision))[:m])
    result = []
    for unknown, value, sd in zip(asked.unknowns.each, found.point.nuisances, sds):
        size = max(unknown.sizes, key=abs)
        result.append(
            NuisanceEstimate(
                unknown.name,
                unknown.group,
                unknown.act,
                float(value),
                float(value * size),
                float(sd * abs(size)),
                float(abs(size)),
            )
        )
    return tuple(result)


def _data_sd(asked: WeighedProblem, found: WeighedFit) -> Floats:
    return linear_sds(_data_precision(asked, found))


def _data_precision(asked: WeighedProblem, found: WeighedFit) -> Floats:
    """Without what is held of the ratios themselves."""
    rows = asked.ratio_prior.rows
    return np.asarray(_precision(found) - rows.T @ rows)


def _precision(found: WeighedFit) -> Floats:
    model = reduced(found.point, found.slope, found.weights)
    return np.asarray(model.ratios.T @ model.ratios)
