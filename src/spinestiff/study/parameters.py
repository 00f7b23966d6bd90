"""Which stiffness parameters the radiographs tell of (paper 4.3, 5.2 and Table 3), and whether a third ratio pays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from spinestiff.anatomy.regions import parameter_groups
from spinestiff.arrays import Floats
from spinestiff.errors import EquilibriumError, FitError, SpinestiffError, SubjectError
from spinestiff.estimation.asked import Start
from spinestiff.estimation.evaluation import TrialSet
from spinestiff.estimation.fitted import FitEnd, StiffnessFit
from spinestiff.observer import Observer
from spinestiff.study.fits import fit_pushes
from spinestiff.study.forecasts import forecast_frames
from spinestiff.study.paper import TABLE_3
from spinestiff.study.refits import Basis, basis_of, converged
from spinestiff.study.trials import PushSet, PushTrial
from spinestiff.study.visit import Visit
from spinestiff.subject.outcome_parts import finite
from spinestiff.subject.parameters_outcome import GradientRow, ModelScore, ParameterEffect, ParameterStudy
from spinestiff.words import counted

SIX = tuple(TABLE_3)
PAPER_RATIOS = {"intervertebral_bending": 0.1, "tissue": 0.04}
"""Ratios of the paper's two, with lambda tied to mu, and where their fit starts."""
EXTREME = 0.05
"""Of the bounds' distance in log, from either bound."""
UNTIED = ("tissue_mu", "tissue_lambda")
LAMBDA_UNKNOWN = "tissue's volume"


def table_3_average(name: str) -> float:
    """Mean of the absolute gradients of the paper's subjects."""
    return float(np.mean(np.abs(TABLE_3[name])))


def parameter_study(visit: Visit, say: Observer) -> ParameterStudy:
    """The six parameters' effects and gradients, and two ratios against three, on the mesh of the visit's settings.

    Raises
    ------
    SubjectError : see ``refits.basis_of``; or the estimate has no ratio ``tissue`` to take apart.
    FitError : no fit of the estimate's ratios, or none by the paper's method.
    """
    basis = basis_of(visit)
    if "tissue" not in basis.names:
        raise SubjectError(
            f"{visit.file('estimate.json')}: has no ratio tissue (it has {', '.join(basis.names)}), whose mu and "
            "lambda would be compared; run spinestiff estimate with lateral_bending,tissue"
        )
    pushes = basis.pushes()
    say("the estimate on this mesh")
    fit = basis.refit(pushes)
    say("what each parameter does")
    effects = parameter_effects(pushes, fit)
    say("the paper's objective")
    gradient, optimum = objective_gradients(basis.pushes("paper"))
    left_out, folds = cross_folds(pushes)
    models = (
        model_score(basis, pushes, fit, folds, say),
        _untied_score(basis, pushes, fit, folds, say),
    )
    volume = [one for one in fit.weighed.nuisances if one.name == LAMBDA_UNKNOWN] if fit.weighed else []
    return ParameterStudy(
        mesh=visit.settings.mesh,
        effects=effects,
        gradient=gradient,
        optimum=optimum,
        models=models,
        left_out=left_out,
        lambda_prior_sd=volume[0].prior_sd if volume else None,
        lambda_sd=volume[0].sd if volume else None,
    )


def parameter_effects(pushes: PushSet, fit: StiffnessFit) -> tuple[ParameterEffect, ...]:
    """What the six parameters do at the training frames, largest first; ``fit`` is a weighed one of these pushes."""
    assert fit.weighed is not None
    # Ratios of overlapping groups multiply: the six stay at 1 beside the estimate's.
    groups = (*fit.ratios.groups, *parameter_groups(pushes.torso, (*SIX, "everything")))
    trials = TrialSet(*pushes.posed(pushes.training), groups, pushes.orientation, None)
    own = len(fit.names)

    def moves(log_ratios: Floats, acts: Floats | None, starts: bool) -> Floats:
        states = [equilibrium.state for equilibrium in fit.equilibria] if starts else None
        point = trials.solve(np.concatenate([log_ratios, np.zeros(len(SIX) + 1)]), acts=acts, starts=states)
        slope = trials.slope(point)
        parts = [part.moved(found)[..., own:] for part, found in zip(point.residuals, slope.moves)]
        return np.concatenate([part.reshape(-1, *part.shape[-2:]) for part in parts])

    def sizes(found: Floats) -> Floats:
        return np.asarray(np.sqrt(np.mean(np.sum(found**2, axis=1), axis=0)))

    there = moves(np.log(fit.ratios.values), fit.weighed.acts, True)
    whole = there[..., -1]
    shares = np.einsum("cip,ci->p", there, whole) / np.sum(whole**2)
    try:
        default = sizes(moves(np.zeros(own), None, False)).tolist()
    except EquilibriumError:
        default = [None] * len(SIX)
    found = [
        ParameterEffect(name=name, default_mm=before, estimate_mm=after, share=share)
        for name, before, after, share in zip(SIX, default, sizes(there).tolist(), shares.tolist())
    ]
    return tuple(sorted(found, key=lambda effect: -effect.estimate_mm))


def objective_gradients(pushes: PushSet) -> tuple[tuple[GradientRow, ...], dict[str, float]]:
    """Gradients of the paper's objective (Eq. 10) in the six log ratios, at the default and where it is least.

    Parameters
    ----------
    pushes : trials as the paper's method has them, the pelvis level.

    Returns
    -------
    Rows in Table 3's order, and the ratios (``PAPER_RATIOS``) at the least value, lambda tied to mu.

    Raises
    ------
    FitError : the paper's fit ends without a minimum.
    """
    names = tuple(PAPER_RATIOS)
    fit = converged(fit_pushes(pushes, names, PAPER_RATIOS, "paper"))
    groups = (*fit.ratios.groups, *parameter_groups(pushes.torso, SIX))
    trials = TrialSet(*pushes.posed(pushes.training), groups, pushes.orientation, None)

    def gradient(log_ratios: Floats, starts: Sequence[object]) -> list[float]:
        states = [equilibrium.state for equilibrium in starts]  # type: ignore[attr-defined]
        point = trials.solve(np.concatenate([log_ratios, np.zeros(len(SIX))]), starts=states)
        return [float(value) for value in trials.gradient(point)[len(names) :]]

    optimum = gradient(np.log(fit.ratios.values), fit.equilibria)
    default: list[float] | list[None] = [None] * len(SIX)
    if fit.default_equilibria:
        default = gradient(np.zeros(len(names)), fit.default_equilibria)
    rows = [GradientRow(name=name, default=a, optimum=b) for name, a, b in zip(SIX, default, optimum)]
    return tuple(rows), fit.ratios.as_dict()


def default_gradients(pushes: PushSet) -> dict[str, float]:
    """Gradient of the paper's objective (Eq. 10) in the six ratios where all are 1, mm^2, in Table 3's order.

    Parameters
    ----------
    pushes : trials as the paper's method has them, the pelvis level.

    Raises
    ------
    EquilibriumError : no equilibrium there.
    """
    groups = parameter_groups(pushes.torso, SIX)
    trials = TrialSet(*pushes.posed(pushes.training), groups, pushes.orientation, None)
    found = trials.gradient(trials.solve(np.zeros(len(SIX))))
    return {name: float(value) for name, value in zip(SIX, found)}


def cross_folds(pushes: PushSet) -> tuple[str, list[list[PushTrial]]]:
    """What is left out at a time: training pushes where there are several, else training frames."""
    training = pushes.training
    by_push = [[t for t in training if t.push == push] for push in dict.fromkeys(t.push for t in training)]
    if len(by_push) > 1:
        return "push", by_push
    return ("frame", [[t] for t in training]) if len(training) > 1 else ("nothing", [])


def untied(names: Sequence[str]) -> tuple[str, ...]:
    """The ratios with tissue's lambda on its own, as in Table 3."""
    return tuple(part for name in names for part in (UNTIED if name == "tissue" else (name,)))


def extreme(fit: StiffnessFit) -> tuple[str, ...]:
    """Ratios within 5 % of a bound, in log."""
    low, high = np.log(fit.bounds)
    near = EXTREME * (high - low)
    logs = dict(zip(fit.names, np.log(fit.ratios.values).tolist()))
    return tuple(name for name, value in logs.items() if min(value - low, high - value) < near)


def _untied_score(
    basis: Basis, pushes: PushSet, two: StiffnessFit, folds: Sequence[Sequence[PushTrial]], say: Observer
) -> ModelScore:
    names = untied(basis.names)
    values = two.ratios.as_dict()
    start = {name: values["tissue" if name in UNTIED else name] for name in names}
    say(f"{', '.join(names)}: all training frames")
    try:
        fit = converged(
            fit_pushes(
                pushes,
                names,
                Start(start, two.standard_nuisances),
                extent="estimate",
            )
        )
    except SpinestiffError as error:
        nothing: dict[str, None] = dict.fromkeys(("training_rmse_mm", "left_out_rmse_mm", "held_out_rmse_mm", "aic"))
        return ModelScore(parameters=names, ratios={}, sd_log={}, extreme=(), note=str(error), **nothing)
    return model_score(basis, pushes, fit, folds, say)


def model_score(
    basis: Basis, pushes: PushSet, fit: StiffnessFit, folds: Sequence[Sequence[PushTrial]], say: Observer
) -> ModelScore:
    """How well a set of ratios does where it was fitted and where it was not; ``fit`` is of all training frames."""
    assert fit.weighed is not None
    errors, notes = list[Floats](), list[str]()
    for number, fold in enumerate(folds):
        say(f"{', '.join(fit.names)}: without {_named(fold)} ({number + 1} of {len(folds)})")
        less = without(pushes, fold)
        try:
            found = converged(
                fit_pushes(
                    less,
                    fit.names,
                    Start.at(fit),
                    extent="estimate",
                )
            )
            errors += _forecast_errors(less, fold, found)
        except (FitError, EquilibriumError) as error:
            notes.append(f"without {_named(fold)}: {error}")
    left_out = None if notes else _rmse(errors)
    held_out = [item for item in pushes.of_role("validation") if item.force_n > 0.0]
    outside = list[Floats]()
    try:
        outside = _forecast_errors(pushes, held_out, fit) if held_out else []
    except EquilibriumError as error:
        notes.append(f"frames held out: {error}")
    with np.errstate(invalid="ignore"):
        sds = np.sqrt(np.diag(fit.covariance))
    return ModelScore(
        parameters=fit.names,
        ratios=fit.ratios.as_dict(),
        sd_log={name: finite(float(sd)) for name, sd in zip(fit.names, sds)},
        extreme=extreme(fit),
        training_rmse_mm=fit.rmse_mm,
        left_out_rmse_mm=left_out,
        held_out_rmse_mm=_rmse(outside),
        aic=-2.0 * fit.weighed.log_likelihood + 2.0 * len(fit.names),
        note="; ".join(notes),
    )


def _named(fold: Sequence[PushTrial]) -> str:
    labels = [item.trial.label for item in fold]
    return labels[0] if len(labels) == 1 else f"{counted(len(labels), 'frame')} of push '{fold[0].push}'"


def without(pushes: PushSet, fold: Sequence[PushTrial]) -> PushSet:
    """The pushes with some training frames unused."""
    out = {(item.push, item.frame) for item in fold}
    return replace(
        pushes,
        trials=tuple(replace(t, role="unused") if (t.push, t.frame) in out else t for t in pushes.trials),
    )


def _forecast_errors(pushes: PushSet, unseen: Sequence[PushTrial], fit: StiffnessFit) -> list[Floats]:
    """(Nv, 4, 2) mm of each unseen frame: what a fit of the training frames forecasts, less what was measured."""
    states = {(t.push, t.frame): equilibrium.state for t, equilibrium in zip(pushes.training, fit.equilibria)}
    found = forecast_frames(pushes, unseen, FitEnd.of(fit), states)
    return [one.corner_errors for one in found]


def _rmse(errors: Sequence[Floats]) -> float | None:
    if not errors:
        return None
    return float(np.sqrt(np.mean(np.concatenate([np.sum(one**2, axis=-1).reshape(-1) for one in errors]))))
