"""spinestiff.verification.checks: all pass here, and each kind of judgement can fail."""

from __future__ import annotations

import numpy as np
import pytest

from spinestiff.anatomy.points import rotation_second_derivative
from spinestiff.mechanics import joints, potential, tissue
from spinestiff.verification import checks, derivatives, energies, equilibria, solutions
from spinestiff.verification.outcome import compared, counted, judged, vanishing


@pytest.mark.parametrize("group", checks.GROUPS, ids=lambda g: g.__name__)
def test_every_check_passes_by_its_own_measured_error(group):
    done = checks.run_checks(groups=(group,))
    assert done
    assert [f"{c.name}: {c.error:.1e} > {c.tolerance:.0e}" for c in done if not c.passed] == []
    assert all(c.kind == "independent" and c.tolerance <= 0.25 for c in done)
    assert len({c.name for c in done}) == len(done)


def test_no_gradient_or_hessian_is_held_to_more_than_1e_8():
    done = checks.run_checks(groups=energies.GROUPS[:4])
    derivative = [c for c in done if c.name.startswith(("gradient", "Hessian"))]
    assert len(derivative) >= 26
    assert max(c.tolerance for c in derivative) <= 1e-8


def test_the_observer_sees_each_check_in_order():
    seen = []
    done = checks.run_checks(seen.append, groups=(solutions.push_reactions, energies.joint_axes))
    assert seen == done
    assert len(done) > 5


def test_a_group_that_breaks_is_a_failed_check_and_the_rest_runs():
    def broken():
        yield judged("first", 0.0, 1.0)
        raise RuntimeError("no such library")

    done = checks.run_checks(groups=(broken, solutions.push_reactions))
    assert done[0].passed
    assert not done[1].passed
    assert "no such library" in done[1].name
    assert len(done) > 3


@pytest.mark.parametrize(
    ("check", "passed"),
    [
        (compared("", [1.0, 2.0], [1.0, 2.0 + 1e-9], 1e-9), True),
        (compared("", [1.0, 2.0], [1.0, 2.0 + 1e-8], 1e-9), False),
        (compared("", [0.0], [0.0], 1.0), False),
        (compared("", [np.nan], [1.0], 1.0), False),
        (compared("", [1.0], [np.inf], 1.0), False),
        (compared("", [], [], 1.0), False),
        (compared("", [1.0], [[1.0]], 1.0), False),
        (vanishing("", [1e-9], 1.0, 1e-8), True),
        (vanishing("", [1e-7], 1.0, 1e-8), False),
        (vanishing("", [0.0], 0.0, 1.0), False),
        (vanishing("", [np.nan], 1.0, 1.0), False),
        (counted("", 0, 3), True),
        (counted("", 1, 3), False),
        (counted("", 0, 0), False),
        (judged("", np.inf, 1.0), False),
        (judged("", np.nan, 1.0), False),
    ],
)
def test_judgements_fail_where_they_should(check, passed):
    assert check.passed is passed


def _failed(*groups):
    return [c.name for c in checks.run_checks(groups=groups) if not c.passed]


def test_checks_catch_a_joint_without_its_parents_arm(monkeypatch):
    real = joints.joint_gradients

    def wrong(table, state, stiffness):
        gradient = real(table, state, stiffness)
        pose = joints.joint_pose(table, state)
        force, _ = joints._world_force_and_moment(pose, stiffness)
        gradient[:, joints.PARENT_W] += np.cross(pose.gap - pose.parent_arm, force)
        return gradient

    monkeypatch.setattr(joints, "joint_gradients", wrong)
    assert any("gradient: joint" in name for name in _failed(energies.joint_derivatives))
    assert any("moment" in name for name in _failed(energies.internal_balance))


def test_checks_catch_a_missing_rotation_term_of_tied_nodes(monkeypatch):
    def zero(gradient, arm):
        return 0.0 * rotation_second_derivative(gradient, arm)

    monkeypatch.setattr(potential, "rotation_second_derivative", zero)
    assert any("Hessian" in name for name in _failed(energies.tissue_derivatives))
    assert any("order" in name for name in _failed(equilibria.newton))


def test_checks_catch_a_force_without_the_volume_part(monkeypatch):
    real = tissue.element_gradients

    def wrong(*arguments):
        parts = real(*arguments)
        parts[:, 1] = 0.0
        return parts

    monkeypatch.setattr(tissue, "element_gradients", wrong)
    assert _failed(energies.tissue_derivatives)
    assert _failed(solutions.hybrid)


def test_checks_catch_a_sensitivity_of_the_wrong_sign(monkeypatch):
    real = potential.Potential.ratio_gradients
    monkeypatch.setattr(potential.Potential, "ratio_gradients", lambda self, *a: -real(self, *a))
    assert any("Eq. 7" in name for name in _failed(derivatives.sensitivities))
    assert any("Taylor" in name for name in _failed(derivatives.taylor))
    assert _failed(derivatives.superposition)
