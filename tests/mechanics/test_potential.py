"""spinestiff.mechanics.potential: assembly of the total energy (Eq. 3) and its derivatives."""

from __future__ import annotations

import numpy as np
import pytest

from spinestiff.anatomy.points import PointsOnBones
from spinestiff.anatomy.state import retract
from spinestiff.anatomy.stiffness import StiffnessRatios, parameter_group, stiffness_ratios
from spinestiff.mechanics import joints as joint_law
from spinestiff.mechanics import tissue as tissue_law
from spinestiff.mechanics.assembly import Configuration, Law, build_pattern
from spinestiff.mechanics.equilibrium import EquilibriumProblem
from spinestiff.mechanics.loads import LoadCase, no_load
from spinestiff.mechanics.potential import Potential
from spinestiff.mechanics.supports import Supports
from spinestiff.mechanics.terms import PointSprings
from spinestiff.verification.blocks import holds
from spinestiff.verification.energies import dense
from spinestiff.verification.equilibria import toy_supports
from spinestiff.verification.models import points_on, shaken, toy_torso


@pytest.fixture(scope="module", params=[4, 10])
def case(request):
    torso = toy_torso(1, request.param)
    random = np.random.default_rng(3)
    load = LoadCase(points_on(torso, 3, 5), random.uniform(-20, 20, (3, 3)))
    spring = PointSprings(
        PointsOnBones(np.array([0]), np.ones((1, 3))), np.zeros((1, 3)), np.array([[0.6, 0, 0.8]]), np.array([3.0])
    )
    return torso, Potential(torso), shaken(torso, 4), (load, spring)


def test_models_visit_every_way_two_nodes_of_an_element_can_be_tied():
    for nodes in (4, 10):
        torso = toy_torso(1, nodes)
        owner = torso.tissue.bone_of_node[torso.tissue.elements]
        a, b = np.tril_indices(owner.shape[1], -1)
        first, second = owner[:, a], owner[:, b]
        both = (first >= 0) & (second >= 0)
        assert (both & (first == second)).any()
        assert (both & (first != second)).any()
        assert ((first >= 0) ^ (second >= 0)).any()
        assert ((first < 0) & (second < 0)).any()


def test_eq3_total_energy_is_the_sum_of_its_terms(case):
    torso, potential, state, terms = case
    stiffness = potential.stiffness(None)
    data = potential.tissue
    parts, smallest = tissue_law.element_energies(
        torso.node_positions(state), data.elements, data.gradients, data.weights
    )
    tissue = stiffness.mu @ parts[:, 0] + stiffness.lambda_ @ parts[:, 1]
    joints = joint_law.joint_energies(torso.joints, state, stiffness.joints).sum()
    loads, springs = (term.energy(state) for term in terms)
    energy, j = potential.energy(state, stiffness, terms)
    assert energy == pytest.approx(tissue + joints + loads + springs, rel=1e-13)
    assert j == smallest.min()
    assert min(abs(tissue), abs(joints), abs(loads), abs(springs)) > 1.0


def test_eq5_gradient_and_tangent_by_differences_along_a_line(case):
    _, potential, state, terms = case
    stiffness = potential.stiffness(None)
    direction = np.random.default_rng(6).normal(size=potential.dofs)
    direction[: 6 * potential.bones].reshape(-1, 6)[:, 3:] *= 0.03
    h = 2e-4
    up, mid, down = (potential.energy(retract(state, s * direction), stiffness, terms)[0] for s in (h, 0.0, -h))
    assert potential.gradient(state, stiffness, terms) @ direction == pytest.approx((up - down) / (2 * h), rel=1e-6)
    hessian = dense(potential, potential.hessian(state, stiffness, terms))
    assert direction @ hessian @ direction == pytest.approx((up - 2 * mid + down) / h**2, rel=1e-4)


def test_pattern_holds_every_diagonal_and_sorted_rows(case):
    _, potential, _, _ = case
    indptr, indices = potential.pattern.indptr, potential.pattern.indices
    for column in range(potential.dofs):
        rows = indices[indptr[column] : indptr[column + 1]]
        assert rows[0] == column
        assert (np.diff(rows) > 0).all()


def test_pattern_of_a_small_graph():
    # Two entities of 6 and one of 3; pairs in any order and repeated.
    pattern = build_pattern(np.array([[2, 0], [0, 2], [1, 1]]), np.array([6, 6, 3]))
    full = np.zeros((15, 15), dtype=bool)
    for column in range(15):
        full[pattern.indices[pattern.indptr[column] : pattern.indptr[column + 1]], column] = True
    wanted = np.tril(np.ones((15, 15), dtype=bool))
    wanted[6:12, :6] = wanted[12:, 6:12] = False
    assert (full == wanted).all()
    assert pattern.offset(np.array([0, 2]), np.array([2, 0])).tolist() == [6, 6]


def test_ratios_scale_energy_terms_by_themselves(case):
    torso, potential, state, _ = case
    kinds = torso.joints.kinds
    base, doubled = potential.stiffness(None), potential.stiffness(stiffness_ratios({"everything": 2.0}, kinds))
    assert potential.energy(state, doubled, ())[0] == pytest.approx(
        2.0 * potential.energy(state, base, ())[0], rel=1e-14
    )
    mu = potential.stiffness(stiffness_ratios({"tissue_mu": 3.0}, kinds))
    assert mu.mu == pytest.approx(3.0 * base.mu)
    assert (mu.lambda_ == base.lambda_).all()
    assert (mu.joints == base.joints).all()
    bending = potential.stiffness(stiffness_ratios({"lateral_bending": 0.5}, kinds)).joints
    assert bending[:, 5] == pytest.approx(0.5 * base.joints[:, 5])
    assert (bending[:, :5] == base.joints[:, :5]).all()


def test_eq6_right_hand_side_is_the_derivative_of_the_force(case):
    torso, potential, state, _ = case
    kinds = torso.joints.kinds
    for name in ("tissue_mu", "tissue_lambda", "tissue", "lateral_bending", "separation"):
        group, h = parameter_group(name, kinds), 1e-4
        found = potential.ratio_gradients(state, potential.stiffness(None), [group])[:, 0]
        up, down = (
            potential.gradient(state, potential.stiffness(stiffness_ratios({name: np.exp(s * h)}, kinds)), ())
            for s in (1, -1)
        )
        assert np.abs(found - (up - down) / (2 * h)).max() < 1e-7 * np.abs(found).max()
        assert np.abs(found).max() > 0.1


def test_projected_hessian_has_no_negative_curvature_where_the_exact_one_has(case):
    torso, potential, _, terms = case
    state, stiffness = shaken(torso, 3), potential.stiffness(None)
    exact = np.linalg.eigvalsh(dense(potential, potential.hessian(state, stiffness, terms)))
    projected = np.linalg.eigvalsh(dense(potential, potential.hessian(state, stiffness, terms, project=True)))
    assert exact[0] < -1e-6 * exact[-1]
    assert projected[0] > -1e-10 * projected[-1]


def test_projected_hessian_equals_the_exact_one_where_nothing_is_negative(case):
    torso, potential, _, _ = case
    stiffness = potential.stiffness(None)
    exact = potential.hessian(torso.rest_pose, stiffness, ())
    assert potential.hessian(torso.rest_pose, stiffness, (), project=True) == pytest.approx(
        exact, abs=1e-9 * np.abs(exact).max()
    )


def test_infinite_energy_where_an_element_is_turned_out(case):
    torso, potential, _, terms = case
    rest = torso.rest_pose
    state = retract(rest, np.concatenate([np.zeros(6 * potential.bones), -2.0 * rest.tissue_positions.ravel()]))
    energy, smallest = potential.energy(state, potential.stiffness(None), terms)
    assert energy == np.inf
    assert smallest < 0.0


def test_holds_are_supports_without_springs():
    supports = holds(np.ones((2, 6), dtype=bool))
    assert isinstance(supports, Supports)
    assert len(supports.springs.points) == 0


def test_shares_of_parts_of_a_group_add_up_and_are_derivatives(case):
    """By joints and by elements: the parts' shares sum to the whole's, and each is a difference of gradients."""
    torso, potential, state, _ = case
    whole = parameter_group("everything", torso.joints.kinds)
    joints = torso.joints_among(torso.bone_names[:2])
    elements = np.arange(len(torso.tissue.elements)) % 3 == 0
    assert joints.any() and not joints.all()
    parts = [whole.within("a", joints, elements), whole.within("b", ~joints, ~elements)]
    stiffness = potential.stiffness(None)
    both = potential.ratio_gradients(state, stiffness, parts)
    total = potential.ratio_gradients(state, stiffness, [whole])[:, 0]
    assert both.sum(1) == pytest.approx(total, abs=1e-12 * np.abs(total).max())
    direction = np.random.default_rng(2).normal(size=potential.dofs)
    products = potential.ratio_products(state, stiffness, parts, direction)
    assert products == pytest.approx(direction @ both, rel=1e-11)
    h = 1e-4
    for part, share in zip(parts, both.T):
        ends = [StiffnessRatios((part,), np.exp([sign * h])) for sign in (1, -1)]
        up, down = (potential.gradient(state, potential.stiffness(ratios), ()) for ratios in ends)
        assert np.abs(share - (up - down) / (2 * h)).max() < 1e-7 * np.abs(share).max()


class Cable(Law):
    """k l^3 / 3 for the distance l from a bone's origin to a free node: one's own law, which couples the two."""

    def __init__(self, bone, node, k):
        self.bone, self.node, self.k = bone, node, k

    def pairs(self, unknowns):
        return np.array([[self.bone, unknowns.bones + self.node]])

    def _across(self, at):
        return at.state.tissue_positions[self.node] - at.state.bone_positions[self.bone]

    def energy(self, at, stiffness):
        return self.k * np.linalg.norm(self._across(at)) ** 3 / 3.0, np.inf

    def add_gradient(self, at, stiffness, gradient):
        across = self._across(at)
        force = self.k * np.linalg.norm(across) * across
        at.unknowns.bone_rows(gradient)[self.bone, :3] -= force
        at.unknowns.node_rows(gradient)[self.node] += force

    def add_hessian(self, at, stiffness, tangent, offsets, project):
        across = self._across(at)
        length = np.linalg.norm(across)
        block = self.k * (length * np.eye(3) + np.outer(across, across) / length)
        tangent.bones[self.bone, :3, :3] += block
        tangent.nodes[self.node] += block
        row, column = np.array([at.unknowns.bones + self.node]), np.array([self.bone])
        tangent.add(np.hstack([-block, np.zeros((3, 3))])[None], row, column, offsets)


def test_a_law_of_ones_own_takes_part_in_energy_gradient_hessian_and_solve(case):
    torso, plain, state, terms = case
    # Far from its bone, so that no element couples the two.
    far = np.argmax(np.linalg.norm(state.tissue_positions - state.bone_positions[0], axis=1))
    law = Cable(0, int(far), 0.02)
    potential = Potential(torso, [law])
    stiffness = potential.stiffness(None)
    with_it, without = (p.energy(state, stiffness, terms)[0] for p in (potential, plain))
    assert with_it - without == pytest.approx(
        law.energy(Configuration(potential.unknowns, state), stiffness)[0], rel=1e-9
    )
    direction = np.random.default_rng(6).normal(size=potential.dofs)
    direction[: 6 * potential.bones].reshape(-1, 6)[:, 3:] *= 0.03
    h = 2e-4
    up, mid, down = (potential.energy(retract(state, s * direction), stiffness, terms)[0] for s in (h, 0.0, -h))
    assert potential.gradient(state, stiffness, terms) @ direction == pytest.approx((up - down) / (2 * h), rel=1e-6)
    hessian = dense(potential, potential.hessian(state, stiffness, terms))
    assert direction @ hessian @ direction == pytest.approx((up - 2 * mid + down) / h**2, rel=1e-4)
    group = [parameter_group("everything", torso.joints.kinds)]
    assert (potential.ratio_gradients(state, stiffness, group) == plain.ratio_gradients(state, stiffness, group)).all()
    supports = toy_supports(torso)
    pulled, free = (EquilibriumProblem(torso, supports, laws=laws).solve(no_load()).require() for laws in ([law], []))
    before, after = (np.linalg.norm(f.state.tissue_positions[far] - f.state.bone_positions[0]) for f in (free, pulled))
    assert after < before - 0.1
