"""benchmarks/own_model.py: radiographs drawn from an estimate's own model, and what is summed up of their estimates."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from programs import benchmark
from spinestiff.estimation.objective import make_target, residuals
from spinestiff.study.visit import Manner, load_pushes, open_visit

benchmark("coverage_subjects")
own_model = benchmark("own_model")
RATIOS = {"lateral_bending": 0.1, "tissue": 0.05}


@pytest.fixture(scope="module")
def asked(finished):
    return own_model.asked_with(load_pushes(open_visit(finished.folder), Manner()), RATIOS, 30.0)


def own_trials(asked, random):
    return [item.trial for item in own_model.drawn(asked, random).fitted]


def test_without_errors_the_drawn_corners_are_the_models_own(asked):
    nothing = SimpleNamespace(normal=lambda size: np.zeros(size))
    trials, torso = own_trials(asked, nothing), asked.pushes.torso
    point = asked.problem.solve(asked.log_ratios, np.zeros(len(asked.problem.unknowns)))
    states = [*(found.state for found in point.evaluation.equilibria), *[torso.rest_pose] * len(trials)]
    for trial, state in zip(trials, states):
        assert residuals(torso, make_target(torso, trial), state).rmse < 0.02
    # What was measured lies elsewhere: the person has other ratios.
    assert point.evaluation.rmse > 0.5


class ErrorsAlone:
    """Random numbers for as many errors; nothing else is drawn."""

    def __init__(self, seed, count):
        self.random, self.count = np.random.default_rng(seed), count

    def normal(self, size):
        return self.random.normal(size=size) if size == self.count else np.zeros(size)


def test_errors_are_those_that_the_estimate_expects(asked):
    size = asked.problem.noise.size
    point = asked.problem.solve(asked.log_ratios, np.zeros(len(asked.problem.unknowns)))
    expected = asked.problem.covariance(point)[:size, :size] - asked.problem.noise.parts["stance"]
    values, vectors = np.linalg.eigh(expected)
    for seed in range(2):
        trials, torso = own_trials(asked, ErrorsAlone(seed, size)), asked.pushes.torso
        states = [*(found.state for found in point.evaluation.equilibria), *[torso.rest_pose] * len(trials)]
        apart = np.concatenate(
            [
                channels.apply(residuals(torso, make_target(torso, trial), state).difference)
                for trial, state, channels in zip(trials, states, asked.problem.noise.channels)
            ]
        )
        errors = vectors @ (np.sqrt(np.maximum(values, 0.0)) * np.random.default_rng(seed).normal(size=size))
        assert np.linalg.norm(apart - errors) < 0.05 * np.linalg.norm(errors)


def test_an_estimate_of_drawn_corners_is_counted(asked):
    row = own_model.run_one(5, "paper", asked)
    assert row["ratios"] == RATIOS
    failed = {"seed": 6, "acquisition": "paper", "ratios": RATIOS, "kind": "", "failed": "no equilibrium"}
    (found,) = own_model.summed_up([row, failed])["acquisitions"]
    assert (found["scenario"], found["subjects"], found["without_estimate"]) == ("paper", 1, 1)
    z = own_model.countable([row])[0]["z"][0]
    assert found["lateral_bending"]["all"]["rms_z"] == pytest.approx(abs(z), abs=1e-3)
    assert found["coverage95"]["lateral_bending"] == float(row["low"][0] <= 0.1 <= row["high"][0])
    assert found["median_factor"]["tissue"] == pytest.approx((row["high"][1] / row["low"][1]) ** 0.5, abs=1e-3)


def test_rows_without_intervals_are_refused_and_the_stored_summary_stays():
    with pytest.raises(SystemExit, match="no row has an interval to count; nothing was written"):
        own_model.summed_up([{"seed": 1, "acquisition": "paper", "errors": [0.1, 0.2], "sds": [0.1, 0.1]}])
