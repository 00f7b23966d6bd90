"""Trials in equilibrium: adjoint and forward derivatives, push errors, predicted starts."""

from __future__ import annotations

import numpy as np
import pytest
from spinestiff.estimation.uncertainty import UncertaintySettings

from spinestiff.anatomy.stiffness import stiffness_ratios
from spinestiff.estimation.evaluation import TrialSet, compliance_step, log_step

TRUTH = {"lateral_bending": 0.1, "tissue": 0.03}


def test_adjoint_gradient_is_forward_gradient_and_the_difference_quotient(spine, trials) -> None:
    groups = stiffness_ratios(TRUTH, spine.torso.joints.kinds).groups
    trial_set = TrialSet([spine] * 2, trials(error=0.5), groups, "procrustes", None)
    here = np.log([0.3, 0.2])
    point = trial_set.solve(here)
    slope = trial_set.slope(point)
    adjoint, forward = trial_set.gradient(point), slope.jacobian.T @ point.values
    assert np.abs(adjoint).min() > 1.0
    assert np.allclose(adjoint, forward, rtol=1e-10)
    for i in range(2):
        step = np.zeros(2)
        step[i] = 1e-4
        quotient = (trial_set.solve(here + step).loss - trial_set.solve(here - step).loss) / 2e-4
        assert adjoint[i] == pytest.approx(quotient, rel=1e-6)


def test_push_error_columns_are_difference_quotients(spine, trials) -> None:
    groups = stiffness_ratios(TRUTH, spine.torso.joints.kinds).groups
    trial = trials(forces=(50.0,))[0]
    trial_set = TrialSet([spine], [trial], groups, "procrustes", None)
    here = np.log(list(TRUTH.values()))
    slope = trial_set.slope(trial_set.solve(here))

    def at(load):
        other = TrialSet([spine], [trial.__class__(load, trial.corners, trial.view)], groups, "procrustes", None)
        return other.solve(here).values

    quotient = (at(trial.load.scaled(1.001)) - at(trial.load.scaled(0.999))) / 0.002
    assert np.abs(quotient).max() > 1.0
    assert np.allclose(slope.responses[0][:, 0], quotient, atol=1e-4 * np.abs(quotient).max())
    load = trial.load
    places = load.points.positions(spine.torso.rest_pose)
    moved = [
        load.__class__(load.points.at(spine.torso.rest_pose, load.points.bone, places + [0, dy, 0]), load.forces)
        for dy in (0.1, -0.1)
    ]
    quotient = (at(moved[0]) - at(moved[1])) / 0.2
    assert np.allclose(slope.responses[0][:, 1], quotient, atol=1e-2 * np.abs(quotient).max())


def test_an_equilibrium_starts_on_the_last_tangent(spine, trials, monkeypatch) -> None:
    groups = stiffness_ratios(TRUTH, spine.torso.joints.kinds).groups
    trial_set = TrialSet([spine] * 2, trials(), groups, "procrustes", None)
    near = trial_set.solve(np.log([0.12, 0.04]))
    slope, ahead = trial_set.slope(near), np.log([0.115, 0.039])
    plain, starts, real = trial_set.solve(ahead, near), [], spine.solve

    def solve(load, ratios, start):
        starts.append(start)
        return real(load, ratios, start)

    monkeypatch.setattr(spine, "solve", solve)
    warm = trial_set.solve(ahead, near, slope)
    assert tuple(starts) == slope.tangents
    assert np.allclose(warm.values, plain.values, atol=1e-7)


def test_compliance_steps_are_exact_for_a_spring_and_first_order_in_the_log() -> None:
    change = np.log([0.1, 3.0, 1.0])
    assert np.allclose(log_step(compliance_step(change)), change)
    assert compliance_step(change)[0] == pytest.approx(1.0 - 10.0)
    assert compliance_step(np.array([1e-6]))[0] == pytest.approx(1e-6, rel=1e-5)


def test_frames_of_a_push_share_its_errors_and_pushes_do_not(spine, trials) -> None:
    first, second, third = trials(forces=(20.0, 40.0, 50.0))
    apart = third.__class__(third.load, third.corners, third.view, third.label, "push 2")
    trial_set = TrialSet(
        [spine] * 3,
        [first, second, apart],
        stiffness_ratios(TRUTH, spine.torso.joints.kinds).groups,
        "procrustes",
        None,
    )
    slope = trial_set.slope(trial_set.solve(np.log(list(TRUTH.values()))))
    found = {n.name: n for n in trial_set.nuisances(slope, UncertaintySettings(force_sd=0.03))}
    touched = {name: np.abs(n.column.reshape(3, -1)).max(axis=1) > 0.0 for name, n in found.items()}
    for what in ("force", "push height"):
        assert touched[f"{what} of push 1"].tolist() == [True, True, False]
        assert touched[f"{what} of push 2"].tolist() == [False, False, True]
    assert found["force of push 2"].sd == 0.03
    assert [touched[name].sum() for name in found if name.startswith("place")] == [1] * 6
