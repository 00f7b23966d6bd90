"""spinestiff.verification.checks: all pass here, and each kind of judgement can fail."""

from __future__ import annotations

import re
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from spinestiff.anatomy.points import rotation_second_derivative
from spinestiff.mechanics import factor, joints, potential, tissue
from spinestiff.verification import checks, derivatives, energies, solutions, solving, whole
from spinestiff.verification.outcome import GOLD, INDEPENDENT, Check, compared, counted, judged, summary, vanishing


@pytest.mark.parametrize("group", checks.GROUPS, ids=lambda g: g.__name__)
def test_every_check_passes_by_its_own_measured_error(group):
    done = checks.run_checks(groups=(group,))
    assert done
    assert [f"{c.name}: {c.error:.1e} > {c.tolerance:.0e}" for c in done if not c.passed] == []
    assert all(c.tolerance <= 0.2 for c in done)
    assert {c.kind for c in done} == {GOLD if group is whole.gold else INDEPENDENT}
    assert len({c.name for c in done}) == len(done)
    SEEN.update({c.name: c for c in done})


# Filled by the test above, group by group.
SEEN: dict[str, Check] = {}


def test_every_item_of_the_list_is_checked_and_its_tolerance_kept():
    if len(SEEN) < 200:
        pytest.skip("needs the checks of all groups, run before")
    assert {c.item for c in SEEN.values()} == set(checks.ITEMS)
    # Tolerances of all checks of an item; what is looser, is so for a reason that stands beside it.
    for item, most in TOLERANCES.items():
        worst = max((c for c in SEEN.values() if c.item == item), key=lambda c: c.tolerance)
        assert worst.tolerance <= most, worst
    assert sum(c.kind == INDEPENDENT for c in SEEN.values()) >= 250


TOLERANCES = {
    "A1": 1e-12, "A2": 1e-12, "A3": 1e-12, "A4": 1e-12, "A5": 0.0, "A6": 1e-6, "A7": 1e-4, "A8": 1e-12, "A9": 1e-8,
    "A10": 1e-12, "B1": 1e-12, "B2": 1e-10, "B3": 1e-10, "B4": 5e-8, "B5": 0.05, "B6": 0.15, "B7": 0.15, "B8": 1e-12,
    "C1": 0.02, "C2": 1e-10, "C3": 1e-6, "C4": 1e-9, "C5": 1e-8, "C6": 1e-9, "C7": 1e-8, "C8": 1e-2, "D1": 1e-10,
    "D2": 0.05, "D3": 1e-6, "D4": 3e-2, "D5": 1e-12, "D6": 1e-11, "D7": 1e-5, "gold": 1e-6,
}  # fmt: skip


def test_the_documents_list_is_the_programs():
    text = (Path(__file__).parents[2] / "docs" / "validation.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| ([A-D]\d+) \| (.+?) \|", text, re.MULTILINE)
    assert dict(rows) == {item: what for item, what in checks.ITEMS.items() if item != "gold"}


def test_gold_numbers_are_told_from_independent_checks():
    kinds = [judged("A1 a", 0.0, 1.0), judged("A1 b", 2.0, 1.0), compared("gold: c", 1.0, 1.0, 1.0, GOLD)]
    assert summary(kinds) == "1 of 2 independent checks passed, 1 of 1 gold regressions"
    assert summary(kinds[:2]) == "1 of 2 independent checks passed"
    assert [c.item for c in kinds] == ["A1", "A1", "gold"]


def test_a_gold_number_that_changes_or_goes_missing_is_noticed(monkeypatch):
    values = whole.gold_values()
    name = "soft, 60 N at rib 8: T8 to the left, mm"
    monkeypatch.setattr(whole, "gold_values", lambda: {**values, name: values[name] * (1.0 + 1e-5)})
    assert [c.name for c in whole.gold() if not c.passed] == [f"gold: {name}"]
    monkeypatch.setattr(whole, "gold_values", lambda: {**{k: v for k, v in values.items() if k != name}, "new": 1.0})
    assert {c.name for c in whole.gold() if not c.passed} == {f"gold: {name}", "gold: new"}


def test_no_gradient_is_held_to_more_than_1e_13_and_no_hessian_to_more_than_1e_12():
    done = checks.run_checks(groups=energies.GROUPS[:4])
    derivative = [c for c in done if c.name.startswith(("A1 gradient", "A2 Hessian"))]
    assert len(derivative) >= 26
    assert max(c.tolerance for c in derivative if c.item == "A1") <= 1e-13
    assert max(c.tolerance for c in derivative if c.item == "A2") <= 1e-12


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
    assert any("A1 gradient: joint" in name for name in _failed(energies.joint_derivatives))
    assert any("moment" in name for name in _failed(energies.internal_balance))


def test_checks_catch_a_missing_rotation_term_of_tied_nodes(monkeypatch):
    def zero(gradient, arm):
        return 0.0 * rotation_second_derivative(gradient, arm)

    monkeypatch.setattr(tissue, "rotation_second_derivative", zero)
    assert any("Hessian" in name for name in _failed(energies.tissue_derivatives))
    assert any("order" in name for name in _failed(solving.newton))


def test_checks_catch_a_force_without_the_volume_part(monkeypatch):
    real = tissue.element_gradients

    def wrong(*arguments):
        parts = real(*arguments)
        parts[:, 1] = 0.0
        return parts

    monkeypatch.setattr(tissue, "element_gradients", wrong)
    assert _failed(energies.tissue_derivatives)
    assert _failed(solutions.hybrid)


def test_checks_catch_what_is_no_number(monkeypatch):
    class Blind(factor.Analysis):
        def factor(self, values):
            found = super().factor(values)
            return SimpleNamespace(
                solve=lambda right: np.full(right.shape, np.nan), positive_definite=found.positive_definite
            )

    monkeypatch.setattr(solving, "Analysis", Blind)
    assert "C7 sparse solvers: solutions against dense algebra" in _failed(solving.solvers)
    real = potential.Potential.hessian
    monkeypatch.setattr(potential.Potential, "hessian", lambda self, *a: np.nan * real(self, *a))
    for group in (energies.tissue_derivatives, energies.sweep):
        hessians = [check for check in checks.run_checks(groups=(group,)) if "A2 Hessian" in check.name]
        assert hessians and not any(check.passed for check in hessians)


def test_checks_catch_a_sensitivity_of_the_wrong_sign(monkeypatch):
    real, products = potential.Potential.ratio_gradients, potential.Potential.ratio_products
    monkeypatch.setattr(potential.Potential, "ratio_gradients", lambda self, *a: -real(self, *a))
    assert any("D1 Eqs. 6-7: adjoint against forward" in name for name in _failed(derivatives.sensitivities))
    monkeypatch.setattr(potential.Potential, "ratio_products", lambda self, *a: -products(self, *a))
    assert any("D3 Eq. 7" in name for name in _failed(derivatives.sensitivities))
    assert any("Taylor" in name for name in _failed(derivatives.taylor))
    assert _failed(derivatives.superposition)
