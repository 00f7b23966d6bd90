"""Trials in equilibrium: adjoint and forward derivatives, all acts of what is not quite known, predicted starts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from spinestiff.anatomy.points import PointsOnBones
from spinestiff.anatomy.rotation import log_so3
from spinestiff.errors import EquilibriumError
from spinestiff.estimation.evaluation import acted, compliance_step, log_step
from spinestiff.estimation.unknowns import ACTS, LAMBDA_SHARE
from spinestiff.mechanics.equilibrium import EquilibriumProblem
from spinestiff.mechanics.loads import LoadCase
from spinestiff.mechanics.terms import PointSprings

HERE = np.log([0.25, 0.5])
# Acts at which derivatives are taken: none is 0, so that none's derivative is that at rest.
GIVEN = np.array([0.05, -2.0, 0.04, -0.03, 3.0, -4.0, 0.03, -2.0, 0.1, -0.3, 0.2, 0.02])
STEPS = {"force": 1e-3, "offset": 0.05, "upward": 1e-3, "forward": 1e-3, "height": 1.0, "depth": 1.0}
STEPS |= {"obliquity": 5e-4, "shoulder": 0.02, "tissue": 1e-3, "ribs": 1e-3, "volume": 1e-3}


def test_adjoint_gradient_is_forward_gradient_and_the_difference_quotient(column, clean) -> None:
    trial_set = column.trial_set(clean[1:])
    point = trial_set.solve(HERE)
    slope = trial_set.slope(point)
    adjoint, forward = trial_set.gradient(point), trial_set.jacobian(point, slope).T @ point.values
    assert np.abs(adjoint).min() > 1.0
    assert np.allclose(adjoint, forward, rtol=1e-9)
    for step in 1e-3 * np.eye(2):
        quotient = (trial_set.solve(HERE + step).loss - trial_set.solve(HERE - step).loss) / 2e-3
        assert adjoint @ step / 1e-3 == pytest.approx(quotient, rel=1e-5)


@pytest.mark.parametrize("bones", [(3, 4), (4,)], ids=["two points", "one point"])
@pytest.mark.parametrize("act", STEPS)
def test_derivative_of_each_act_against_differences_of_whole_solves(column, act, bones) -> None:
    """The last, motion, moves no state (tests/estimation/test_weighed.py)."""
    # The uppermost joint counts as one of a rib, so that every act moves something.
    kinds = ("rib_vertebra", *column.torso.joints.kinds[1:])
    torso = replace(column.torso, joints=replace(column.torso.joints, kinds=kinds))
    column = replace(column, problem=EquilibriumProblem(torso, column.problem.supports))
    trial_set = column.trial_set(column.trials(forces=(60.0,), bones=bones)[1:])
    point = trial_set.solve(HERE, acts=GIVEN[None])
    column_of = trial_set.slope(point, with_acts=True).acted[0][:, [ACTS.index(act)]]
    slope = point.residuals[0].moved(column_of)[..., 0]
    step = STEPS[act] * np.eye(len(ACTS))[ACTS.index(act)]
    # Fourth order: a bone's turn makes the second one visible.
    far, near, ahead, farther = (
        trial_set.solve(HERE, point, acts=(GIVEN + k * step)[None]).residuals[0].difference for k in (-2, -1, 1, 2)
    )
    quotient = (8.0 * (ahead - near) - (farther - far)) / (12.0 * STEPS[act])
    assert np.abs(quotient).max() > 1e-3
    assert np.allclose(slope, quotient, atol=2e-6 * np.abs(quotient).max())


def test_a_push_on_tissue_nodes_has_no_height_nor_depth(column, clean) -> None:
    none = PointsOnBones(np.empty(0, np.int64), np.empty((0, 3)))
    nodes = np.arange(5)
    load = LoadCase(none, np.empty((0, 3)), "pressed", nodes, np.tile([4.0, 0.0, 0.0], (5, 1)))
    trial_set = column.trial_set([replace(clean[1], load=load)])
    point = trial_set.solve(HERE)
    moved = np.abs(trial_set.slope(point, with_acts=True).acted[0]).max(axis=0)
    assert {act for act, size in zip(ACTS, moved) if size == 0.0} == {"height", "depth", "ribs", "motion"}


def test_all_stiffness_and_the_force_are_one_scale(column) -> None:
    """Twice the force on a torso twice as stiff, held by nothing but its pelvis, is the same picture (Eq. 4)."""
    supports = column.problem.supports
    springs = PointSprings(supports.springs.points[[]], np.empty((0, 3)), np.empty((0, 3)), np.empty(0))
    free = EquilibriumProblem(column.torso, replace(supports, springs=springs, names=(), kinds=()))
    own = replace(column, problem=free)
    trial_set = own.trial_set(own.trials()[1:], ("everything",))
    point = trial_set.solve(np.log([0.5]))
    slope = trial_set.slope(point, with_acts=True)
    for part, moves, acts in zip(point.residuals, slope.moves, slope.acted):
        stiffness, force = part.moved(moves)[..., 0], part.moved(acts)[..., ACTS.index("force")]
        assert np.abs(force).max() > 1.0
        assert np.allclose(stiffness, -force, atol=1e-8 * np.abs(force).max())


def test_acts_of_nothing_are_not_there(column, clean) -> None:
    problem, load, ratios = column.problem, clean[1].load, column.ratios(column.truth)
    assert acted(problem, load, ratios, np.zeros(len(ACTS))) == (problem, load, ratios)
    other, pushed, scaled = acted(problem, load, ratios, GIVEN)
    assert other is not problem
    assert pushed.size > load.size
    # Tissue: by its own act, and by what the volume's act takes from it.
    sizes = dict(zip(scaled.names[2:], np.log(scaled.values[2:])))
    wanted = {"tissue": 0.1 - LAMBDA_SHARE * 0.2, "rib_rotation": -0.3, "tissue_lambda": 0.2}
    assert sizes == pytest.approx(wanted)


def test_an_equilibrium_starts_on_the_last_tangent(column, clean, monkeypatch) -> None:
    trial_set = column.trial_set(clean[1:])
    near = trial_set.solve(np.log([0.32, 0.44]))
    slope, ahead = trial_set.slope(near), np.log([0.31, 0.42])
    plain, starts, real = trial_set.solve(ahead, near), [], column.problem.solve

    def solve(load, ratios, start, **limits):
        starts.append(start)
        return real(load, ratios, start, **limits)

    monkeypatch.setattr(column.problem, "solve", solve)
    warm = trial_set.solve(ahead, near, slope)
    assert tuple(starts) == slope.tangents[::-1]  # the largest load first
    assert np.allclose(warm.values, plain.values, atol=1e-7)


@pytest.mark.parametrize("linearised", [False, True])
def test_where_the_largest_load_has_no_equilibrium_the_others_are_not_solved(column, linearised, monkeypatch) -> None:
    monkeypatch.setenv("SPINESTIFF_THREADS", "1")
    trial_set, name = column.trial_set(column.trials(forces=(5.0, 200.0, 10.0))[1:]), "solve_linearised"
    real, tried = getattr(column.problem, name if linearised else "solve"), []

    def solve(load, *args, **limits):
        tried.append(load.push.size)
        return real(load, *args, **limits)

    monkeypatch.setattr(column.problem, name if linearised else "solve", solve)
    with pytest.raises(EquilibriumError, match=f"^{trial_set.trials[1].label}: .*gives way under this load"):
        trial_set.solve(np.log([0.01, 0.01]), linearised=linearised)
    assert tried == [200.0]
    # With loads that it bears all are solved, and told in their own order.
    found = trial_set.solve(np.log([1.0, 1.0]), linearised=linearised)
    assert tried == [200.0, 200.0, 10.0, 5.0]
    moved = [
        np.abs(one.state.bone_positions - column.problem.torso.rest_pose.bone_positions).max()
        for one in found.equilibria
    ]
    assert moved[0] < moved[2] < moved[1]


@pytest.mark.parametrize("linearised", [False, True])
def test_a_torso_that_folds_under_a_push_is_no_equilibrium(column, linearised, monkeypatch) -> None:
    trial_set = column.trial_set(column.trials(forces=(200.0,))[1:])
    soft = np.log([0.01, 0.01])
    with pytest.raises(EquilibriumError, match="gives way under this load"):
        trial_set.solve(soft, linearised=linearised)
    # Nothing else is wrong: left to itself, the column comes to rest bent over by more than a right angle.
    monkeypatch.setattr("spinestiff.estimation.evaluation.FOLDED", np.inf)
    state = trial_set.solve(soft, linearised=linearised).equilibria[0].state
    assert np.linalg.norm(log_so3(state.bone_rotations), axis=1).max() > np.pi / 2


def test_compliance_steps_are_exact_for_a_spring_and_first_order_in_the_log() -> None:
    change = np.log([0.1, 3.0, 1.0])
    assert np.allclose(log_step(compliance_step(change)), change)
    assert compliance_step(change)[0] == pytest.approx(1.0 - 10.0)
    assert compliance_step(np.array([1e-6]))[0] == pytest.approx(1e-6, rel=1e-5)


def test_threads_change_nothing(column, clean, monkeypatch) -> None:
    found = []
    crushing = np.zeros((len(clean) - 1, len(ACTS)))
    crushing[:, ACTS.index("force")] = np.log(1e5)
    for count in ("1", "4"):
        monkeypatch.setenv("SPINESTIFF_THREADS", count)
        trial_set = column.trial_set(clean[1:])
        assert len(trial_set.trials) > 1
        point = trial_set.solve(HERE)
        slope = trial_set.slope(point, with_acts=True)
        found.append((point.values, np.hstack(slope.moves), np.hstack(slope.acted), trial_set.gradient(point)))
        found[-1] += (vars(trial_set.cost),)
        with pytest.raises(EquilibriumError, match=f"^{trial_set.trials[-1].label}"):
            trial_set.solve(HERE, acts=crushing)
    for one, four in zip(*found):
        assert one == four if isinstance(one, dict) else np.array_equal(one, four)
