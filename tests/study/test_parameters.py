"""Which parameters the radiographs tell of: effects, the paper's gradients, and two ratios against three."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from results import altered
from spinestiff.anatomy.regions import torso_ratios
from spinestiff.errors import EquilibriumError, SubjectError
from spinestiff.estimation.objective import make_target
from spinestiff.imaging.features import state_features
from spinestiff.study import parameters
from spinestiff.study.paper import TABLE_3
from spinestiff.study.parameters import (
    SIX,
    cross_folds,
    default_gradients,
    extreme,
    model_score,
    objective_gradients,
    parameter_effects,
    parameter_study,
    table_3_average,
    untied,
    without,
)
from spinestiff.study.refits import basis_of
from spinestiff.study.visit import Settings, open_visit
from spinestiff.study.wording.parameters import TITLES, gradient_rows, parameter_lines
from spinestiff.subject.estimate_outcome import Estimate
from spinestiff.subject.parameters_outcome import GradientRow, ModelScore, ParameterEffect, ParameterStudy

COARSE = Settings(mesh="coarse")


def say(line):
    pass


@pytest.fixture(scope="module")
def basis(finished):
    return basis_of(open_visit(finished.folder, COARSE))


@pytest.fixture(scope="module")
def pushes(basis):
    return basis.pushes()


@pytest.fixture(scope="module")
def fit(finished):
    return finished.fit


def test_effects_are_how_far_corners_move(pushes, fit) -> None:
    """Against whole solves with one parameter a little stiffer; supports are at rest here, as without nuisances."""
    there = [pushes.problems[t.push].solve(t.trial.load, fit.ratios).require() for t in pushes.training]
    weighed = replace(fit.weighed, acts=np.zeros_like(fit.weighed.acts))
    still = replace(fit, weighed=weighed, equilibria=tuple(there))
    effects = {effect.name: effect for effect in parameter_effects(pushes, still)}
    assert set(effects) == set(SIX)
    values = fit.ratios.as_dict()
    for name in ("intervertebral_bending", "tissue_lambda"):
        squares = []
        for item, start in zip(pushes.training, there, strict=True):
            problem, target = pushes.problems[item.push], make_target(pushes.torso, item.trial)
            places = []
            for step in (0.02, -0.02):
                ratios = torso_ratios(pushes.torso, {**values, name: np.exp(step)})
                state = problem.solve(item.trial.load, ratios, start.state).require().state
                seen = state_features(pushes.torso, item.trial.view, state, target.shares, used=target.used)
                places.append(seen.z[target.rows])
            squares.append(np.sum(((places[0] - places[1]) / 0.04) ** 2, axis=-1))
        assert effects[name].estimate_mm == pytest.approx(np.sqrt(np.mean(squares)), rel=0.01)
    sizes = [effect.estimate_mm for effect in effects.values()]
    assert sizes == sorted(sizes, reverse=True)
    assert 0.4 < sum(effect.share for effect in effects.values()) < 1.0


def test_gradients_are_the_objectives_slope_at_the_default_and_none_where_it_is_least(basis) -> None:
    pushes = basis.pushes("paper")
    rows, optimum = objective_gradients(pushes)
    assert tuple(row.name for row in rows) == SIX
    assert set(optimum) == {"intervertebral_bending", "tissue"}
    of = {row.name: row for row in rows}
    starts = [pushes.problems[item.push].solve(item.trial.load).require().state for item in pushes.training]
    for name in ("axial_rotation", "tissue_mu"):
        losses = []
        for step in (0.02, -0.02):
            ratios = torso_ratios(pushes.torso, {name: np.exp(step)})
            total = 0.0
            for item, start in zip(pushes.training, starts, strict=True):
                state = pushes.problems[item.push].solve(item.trial.load, ratios, start).require().state
                target = make_target(pushes.torso, item.trial)
                seen = state_features(pushes.torso, item.trial.view, state, target.shares, used=target.used)
                error = seen.z[target.rows] - target.z
                total += 0.5 * float(np.sum(error**2))
            losses.append(total)
        assert of[name].default == pytest.approx((losses[0] - losses[1]) / 0.04, rel=0.01)
    assert default_gradients(pushes) == pytest.approx({name: of[name].default for name in SIX}, rel=1e-3)
    scale = abs(of["intervertebral_bending"].default)
    assert abs(of["intervertebral_bending"].optimum) < 1e-3 * scale
    # Lambda is tied: what mu alone would gain, lambda alone would lose.
    assert abs(of["tissue_mu"].optimum + of["tissue_lambda"].optimum) < 1e-3 * scale
    assert abs(of["tissue_mu"].optimum) > 1e-3 * scale


def test_a_frame_left_out_is_forecast_from_the_others(basis, pushes, fit) -> None:
    left_out, folds = cross_folds(pushes)
    assert (left_out, len(folds)) == ("frame", 2)
    lines = []
    score = model_score(basis, pushes, fit, folds, lines.append)
    assert [line.partition(" (")[0] for line in lines] == [
        f"lateral_bending, tissue: without push 'main' frame {frame}" for frame in (1, 2)
    ]
    assert score.parameters == ("lateral_bending", "tissue")
    assert score.ratios == fit.ratios.as_dict()
    assert 0.0 < score.training_rmse_mm < score.left_out_rmse_mm < 3.0
    assert 0.0 < score.held_out_rmse_mm < 3.0
    assert score.aic == pytest.approx(-2.0 * fit.weighed.log_likelihood + 4.0)


def test_a_held_out_frame_without_a_forecast_takes_no_score_of_those_left_out(basis, pushes, fit, monkeypatch) -> None:
    forecast = parameters._forecast_errors

    def failing(pushes, unseen, *args):
        if unseen[0].role == "validation":
            raise EquilibriumError("no equilibrium")
        return forecast(pushes, unseen, *args)

    monkeypatch.setattr(parameters, "_forecast_errors", failing)
    monkeypatch.setattr(parameters, "fit_pushes", lambda *args, **kwargs: fit)
    score = model_score(basis, pushes, fit, cross_folds(pushes)[1], lambda line: None)
    assert score.left_out_rmse_mm > 0.0
    assert score.held_out_rmse_mm is None
    assert score.note == "frames held out: no equilibrium"


def test_what_is_left_out_is_not_fitted(pushes) -> None:
    first, second = pushes.training
    less = without(pushes, [first])
    assert less.training == (second,)
    assert [t.force_n for t in less.fitted] == [second.force_n, 0.0]
    assert len(less.trials) == len(pushes.trials)


def test_pushes_are_left_out_where_there_are_several(pushes) -> None:
    second = [t for t in pushes.trials if t.push == "second"][-1]
    several = replace(pushes, trials=tuple(replace(t, role="training") if t is second else t for t in pushes.trials))
    left_out, folds = cross_folds(several)
    assert left_out == "push"
    assert [[t.push for t in fold] for fold in folds] == [["main", "main"], ["second"]]
    one = replace(pushes, trials=tuple(t for t in pushes.trials if t not in pushes.training[1:]))
    assert cross_folds(one) == ("nothing", [])


def test_lambda_is_taken_from_mu() -> None:
    assert untied(("lateral_bending", "tissue")) == ("lateral_bending", "tissue_mu", "tissue_lambda")


@pytest.mark.parametrize(("value", "near"), [(0.0036, True), (0.0038, False), (3.3, False), (3.5, True)])
def test_extreme_is_within_5_percent_of_a_bound_in_log(fit, value, near) -> None:
    # Bounds 0.0025 and 5: a twentieth of their distance is a factor of 1.462.
    odd = replace(fit, ratios=fit.ratios.with_values([0.1, value]))
    assert extreme(odd) == (("tissue",) if near else ())


def test_an_estimate_without_tissue_is_refused(subject) -> None:
    def less(content):
        content["parameters"] = ["lateral_bending"]
        del content["ratios"]["tissue"]

    altered(subject, Estimate, less)
    with pytest.raises(SubjectError, match="has no ratio tissue"):
        parameter_study(open_visit(subject, COARSE), say)


def test_the_papers_averages_are_as_printed() -> None:
    printed = (77.9, 9.0, 91.5, 522.8, 797.4, 130.3)
    for name, value in zip(TABLE_3, printed):
        assert table_3_average(name) == pytest.approx(value, abs=0.06), name


def score(names, left_out, aic, extreme=()):
    return ModelScore(
        parameters=names, ratios=dict.fromkeys(names, 0.1), sd_log={}, extreme=extreme,
        training_rmse_mm=0.5, left_out_rmse_mm=left_out, held_out_rmse_mm=None, aic=aic,
    )  # fmt: skip


def study(two, three, lambda_sd=0.98):
    effects = [ParameterEffect(name=name, default_mm=1.0, estimate_mm=6.0 - i, share=0.1) for i, name in enumerate(SIX)]
    return ParameterStudy(
        mesh="coarse", effects=effects, gradient=[GradientRow(name=name, default=None, optimum=1.0) for name in SIX],
        optimum={}, models=(two, three), left_out="frame", lambda_prior_sd=1.0, lambda_sd=lambda_sd,
    )  # fmt: skip


THREE = ("lateral_bending", "tissue_mu", "tissue_lambda")


@pytest.mark.parametrize(
    ("left_out", "aic", "at_a_bound", "words"),
    [
        (0.8, 90.0, (), "is worth a ratio here"),
        (0.99, 90.0, (), "is not worth a ratio here: frames left out are forecast no better"),
        (None, 90.0, (), "is not worth a ratio here: no frame could be left out"),
        (0.8, 99.0, (), "is not worth a ratio here: Akaike's criterion does not ask for it"),
        (0.8, 90.0, ("tissue_mu",), "is not worth a ratio here: tissue_mu at the edge of what a fit allows"),
    ],
)
def test_a_third_ratio_pays_only_if_everything_says_so(left_out, aic, at_a_bound, words) -> None:
    two = score(("lateral_bending", "tissue"), 1.0, 100.0)
    lines = parameter_lines(study(two, score(THREE, left_out, aic, at_a_bound)))
    assert f"lambda on its own {words}" in lines
    assert any("tissue_mu ends within 5 % of a bound" in line for line in lines) == bool(at_a_bound)


def test_pushes_and_frames_left_out_are_named() -> None:
    two, three = score(("lateral_bending", "tissue"), 1.0, 100.0), score(THREE, 2.0, 100.0)
    for left_out, words in (
        ("push", "training pushes left out: 1.00 mm"),
        ("frame", "training frames left out: 1.00 mm"),
    ):
        found = study(two, three).model_copy(update={"left_out": left_out})
        assert any(line.startswith(words) for line in parameter_lines(found))


def test_what_is_known_of_lambda_is_told() -> None:
    two = score(("lateral_bending", "tissue"), 1.0, 100.0)
    for sd, words in ((0.98, "next to nothing of lambda"), (0.5, "tell some of it")):
        assert any(words in line for line in parameter_lines(study(two, score(THREE, 1.0, 100.0), sd)))


def test_what_is_left_for_ribs_and_girdle_is_rounded_as_the_shares_are() -> None:
    two = score(("lateral_bending", "tissue"), 1.0, 100.0)
    for share, left in ((0.167, "0 %"), (0.18, "−8 %")):
        found = study(two, two)
        effects = [effect.model_copy(update={"share": share}) for effect in found.effects]
        lines = parameter_lines(found.model_copy(update={"effects": effects}))
        assert any(f"the remaining {left} are ribs" in line for line in lines)


def test_rows_are_in_the_papers_order_with_what_is_missing_said() -> None:
    rows = gradient_rows(study(score(THREE, 1.0, 1.0), score(THREE, 1.0, 1.0)))
    assert [row[0] for row in rows] == [TITLES[name] for name in TABLE_3]
    assert rows[0][1:] == ("not available", "1.00", "77.9")
    assert rows[4][3] == "797.4"
