"""What a set of radiographs would tell of the ratios, before any is taken."""

from __future__ import annotations

import numpy as np
import pytest

from spinestiff.estimation.design import LEAST_PREDICTING, Design, better_known, design_at
from spinestiff.estimation.forecast import forecast
from spinestiff.estimation.weighed import reduced

HERE = np.log([0.35, 0.36])


@pytest.fixture
def random_design():
    """Three radiographs of four residuals each, and two residuals that always count."""
    random = np.random.default_rng(4)
    root = random.normal(size=(14, 20))
    rows = tuple(np.arange(4 * i, 4 * i + 4) for i in range(3))
    nuisances, turns = random.normal(size=(14, 3)), random.normal(size=(14, 2))
    slopes = random.normal(size=(14, 2))
    return Design(root @ root.T, nuisances, turns, slopes, rows, frozenset({2}), slice(12, 14))


def whole(design, turned):
    """The covariance with all that is not known, with the patient's turn or without."""
    columns = np.column_stack([design.nuisances, design.turns]) if turned else design.nuisances
    return design.covariance + columns @ columns.T


@pytest.fixture
def of_column(column):
    asked = column.weighed(column.trials(forces=(40.0, 70.0, 100.0), annotation=0.3, tracking=0.2))
    point = asked.solve(HERE, np.zeros(len(asked.unknowns)))
    return asked, point, asked.slope(point)


def test_sds_are_those_of_generalised_least_squares(random_design) -> None:
    rows = np.r_[0:4, 8:12, 12:14]
    inverse = np.linalg.inv(whole(random_design, turned=True)[np.ix_(rows, rows)])
    x = random_design.slopes[rows]
    wanted = np.sqrt(np.diag(np.linalg.inv(x.T @ inverse @ x)))
    assert np.allclose(random_design.ratio_sds((0, 2)), wanted, rtol=1e-4)
    assert np.allclose(random_design.ratio_sds((2, 0)), wanted, rtol=1e-4)


def test_the_patients_turn_counts_where_more_is_seen_than_frontal_corners(random_design) -> None:
    for taken, turned in (((0, 1), False), ((0, 2), True)):
        rows = np.concatenate([*(random_design.rows[i] for i in taken), np.r_[12:14]])
        inverse = np.linalg.inv(whole(random_design, turned)[np.ix_(rows, rows)])
        x = random_design.slopes[rows]
        wanted = np.sqrt(np.diag(np.linalg.inv(x.T @ inverse @ x)))
        assert np.allclose(random_design.ratio_sds(taken), wanted, rtol=1e-4)


def test_every_radiograph_more_narrows(random_design) -> None:
    few, more = random_design.ratio_sds((0,)), random_design.ratio_sds((0, 1))
    assert (more < few).all()
    assert (random_design.ratio_sds(()) > few).all()
    weights = np.array([1.0, 0.0, 0.0, -1.0])
    assert random_design.prediction_sd((0, 1), 2, weights) < random_design.prediction_sd((0,), 2, weights)


def test_a_prediction_is_that_of_the_joint_normal_distribution(random_design) -> None:
    """Of all residuals, with ratios that are as little known as the design takes them to be."""
    rows, own = np.r_[0:4, 12:14], np.r_[4:8]
    x = random_design.slopes
    joint = whole(random_design, turned=False) + x @ x.T / LEAST_PREDICTING
    across = np.linalg.solve(joint[np.ix_(rows, rows)], joint[np.ix_(rows, own)])
    left = joint[np.ix_(own, own)] - joint[np.ix_(own, rows)] @ across
    weights = np.array([0.5, -1.0, 0.0, 2.0])
    wanted = np.sqrt(weights @ left @ weights)
    assert random_design.prediction_sd((0,), 1, weights) == pytest.approx(wanted, rel=1e-3)


def test_with_all_radiographs_it_is_the_covariance_of_the_fit(of_column) -> None:
    asked, point, slope = of_column
    model = reduced(point, slope, asked.as_expected(point))
    wanted = np.sqrt(np.diag(np.linalg.inv(model.ratios.T @ model.ratios)))
    design = design_at(asked, point, slope)
    assert np.allclose(design.ratio_sds(range(len(design.rows))), wanted, rtol=1e-3)


def test_an_unseen_radiograph_is_predicted_as_by_a_forecast(of_column) -> None:
    asked, point, slope = of_column
    design = design_at(asked, point, slope, 1.5)
    others = [i for i in range(len(design.rows)) if i != 1]
    weights = asked.noise.channels[1].turning(1, 5)
    _, wanted, _ = forecast(asked, point, slope, 1.5, [1])[0].turn(1, 5)
    assert design.prediction_sd(others, 1, weights) == pytest.approx(wanted, rel=1e-4)


def test_what_is_measured_besides_counts_for_its_group_alone(of_column) -> None:
    asked, point, slope = of_column
    plain = design_at(asked, point, slope)
    better = better_known(plain, asked.unknowns, {"trunk size": 0.0})
    mine = slope.nuisances[:, asked.unknowns.in_group("trunk size")]
    assert mine.any()
    assert np.allclose(whole(plain, turned=False) - whole(better, turned=False), mine @ mine.T)
    everything = range(len(plain.rows))
    assert better.ratio_sds(everything)[1] < 0.995 * plain.ratio_sds(everything)[1]
