"""spinestiff.anatomy.state: where bones and nodes are, how they move, and whether two states are the same."""

import numpy as np
import pytest

from spinestiff.anatomy.rotation import exp_so3
from spinestiff.anatomy.state import TorsoState, retract, state_digest
from spinestiff.errors import TorsoError


@pytest.fixture
def state():
    turns = exp_so3(np.array([[0.0, 0.1, 0.0], [0.3, 0.0, -0.2]]))
    return TorsoState(np.array([[5.0, 5, 5], [30, 30, 30]]), turns, np.array([[0.0, 40, 0], [0, 0, 40]]))


def test_retract_adds_translations_and_turns_from_the_left(state):
    w = np.array([0.2, -0.1, 0.3])
    moved = retract(state, np.concatenate([[1.0, 2, 3], w, np.zeros(6), np.arange(6.0)]))
    np.testing.assert_allclose(moved.bone_positions[0] - state.bone_positions[0], [1, 2, 3])
    np.testing.assert_allclose(moved.bone_rotations[0], exp_so3(w) @ state.bone_rotations[0])
    np.testing.assert_allclose(moved.tissue_positions - state.tissue_positions, np.arange(6.0).reshape(2, 3))
    assert state.dofs == 18


@pytest.mark.parametrize("dof", [0, 3, 12], ids=["bone shifted", "bone turned", "node moved"])
def test_the_digest_tells_states_apart(state, dof):
    step = np.zeros(state.dofs)
    same = TorsoState(state.bone_positions, state.bone_rotations, state.tissue_positions)
    step[dof] = 1e-9
    assert state_digest(same) == state_digest(state) != state_digest(retract(state, step))


def test_arrays_that_do_not_fit_together_are_refused(state):
    with pytest.raises(TorsoError, match=r"bone_rotations has shape \(1, 3, 3\), wanted \(2, 3, 3\)"):
        TorsoState(state.bone_positions, state.bone_rotations[:1], state.tissue_positions)
