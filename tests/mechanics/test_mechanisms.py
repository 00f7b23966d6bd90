"""spinestiff.mechanics.mechanisms: motions that nothing resists are found and named, and nothing else is."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
import pytest

from spinestiff.anatomy.points import PointsOnBones
from spinestiff.anatomy.template import template_torso
from spinestiff.anatomy.torso import TissueMesh, TorsoModel
from spinestiff.errors import EquilibriumError
from spinestiff.mechanics.assembly import Law
from spinestiff.mechanics.equilibrium import EquilibriumProblem
from spinestiff.mechanics.joints import JointLaw, joint_energies, joint_hessians
from spinestiff.mechanics.loads import LoadCase
from spinestiff.mechanics.mechanisms import mechanisms, require_no_mechanism
from spinestiff.mechanics.neutral_zone import NeutralZone
from spinestiff.mechanics.potential import Potential
from spinestiff.mechanics.supports import SupportKind, Supports, three_point_supports
from spinestiff.mechanics.terms import PointSprings, TermBlocks
from spinestiff.verification.blocks import holds
from spinestiff.verification.energies import dense
from spinestiff.verification.equilibria import toy_load, toy_supports
from spinestiff.verification.models import box_mesh, make_torso, toy_torso

STIFF = np.array([10.0, 20.0, 30.0, 1e3, 2e3, 3e3])


@pytest.fixture(scope="module")
def torso() -> TorsoModel:
    return template_torso(157.0, "coarse")


@pytest.fixture(scope="module")
def bare(torso) -> TorsoModel:
    """The torso without tissue."""
    none = TissueMesh(np.empty((0, 3)), np.empty((0, 10), np.int64), np.empty(0, np.int64), np.empty(0), np.empty(0))
    return replace(torso, tissue=none, rest_pose=replace(torso.rest_pose, tissue_positions=np.empty((0, 3))))


def slackened(torso, changes):
    """``torso`` with the named joints' stiffness zero in the given columns."""
    stiffness = np.array(torso.joints.stiffness)
    for name, columns in changes.items():
        stiffness[torso.joints.names.index(name), columns] = 0.0
    return replace(torso, joints=replace(torso.joints, stiffness=stiffness))


def without_springs(supports, without):
    kept = [i for i, kind in enumerate(supports.kinds) if kind is not without]
    s = supports.springs
    springs = PointSprings(s.points[kept], s.targets[kept], s.directions[kept], s.stiffness[kept])
    return Supports(
        supports.held, springs, tuple(supports.names[i] for i in kept), tuple(supports.kinds[i] for i in kept)
    )


def unresisted(torso, supports):
    """Number of zero eigenvalues of the assembled tangent at rest: the same answer by brute force."""
    potential = Potential(torso)
    hessian = dense(potential, potential.hessian(torso.rest_pose, potential.stiffness(None), (supports.springs,)))
    free = np.setdiff1d(np.arange(potential.dofs), np.flatnonzero(supports.held.ravel()))
    scale = np.ones(potential.dofs)
    scale[: 6 * potential.bones].reshape(-1, 6)[:, 3:] = 30.0
    values = np.linalg.eigvalsh((hessian / scale / scale[:, None])[np.ix_(free, free)])
    return int(np.sum(np.abs(values) < 1e-10 * np.abs(values).max()))


@pytest.mark.parametrize("mesh", ["coarse", "fine"])
def test_shipped_torsos_have_none_and_asking_is_quick(mesh):
    torso = template_torso(157.0, mesh)
    for options in ({}, {"wall": False}, {"pelvis": "hinge"}):
        supports = three_point_supports(torso, "right", **options)
        began = time.process_time()
        assert mechanisms(torso, supports) == ()
        assert time.process_time() - began < 0.5  # about 0.01 s on one core; a solve takes seconds
    require_no_mechanism(torso, supports)


def test_a_torso_without_supports_is_one_free_body(torso):
    (found,) = mechanisms(torso, holds(np.zeros((49, 6), dtype=bool)))
    assert (found.modes, found.bones) == (6, torso.bone_names)
    assert "held by no support" in found.text


@pytest.mark.parametrize("which", ["torso", "bare"])
def test_hinged_pelvis_without_a_shoulder_turns_with_all_that_stands_on_it(which, request):
    torso = request.getfixturevalue(which)
    (found,) = mechanisms(torso, without_springs(three_point_supports(torso, "right", "hinge"), SupportKind.SHOULDER))
    assert (found.modes, found.bones) == (1, torso.bone_names)
    assert "the whole torso can turn about the AP (z) axis through pelvis's origin: no support" in found.text


def test_a_removed_joint_leaves_a_bone_unconnected_unless_tissue_holds_it(torso, bare):
    supports = three_point_supports(torso, "right")
    changes = {"T11-R11_L": slice(None)}
    assert mechanisms(slackened(torso, changes), supports) == ()
    (found,) = mechanisms(slackened(bare, changes), supports)
    assert (found.modes, found.bones) == (6, ("R11_L",))
    assert "R11_L is connected to nothing" in found.text
    assert "joint T11-R11_L without any stiffness" in found.text


def test_a_part_of_several_bones_without_connection_is_one_free_body(bare):
    changes = {"sternum-clavicle_L": slice(None)}
    (found,) = mechanisms(slackened(bare, changes), three_point_supports(bare, "left", wall=False))
    assert (found.modes, found.bones) == (6, ("clavicle_L", "scapula_L", "humerus_L"))
    assert "clavicle_L, scapula_L, humerus_L are connected with each other and with nothing else" in found.text


def test_an_axis_without_stiffness_is_named_where_no_tissue_holds_the_rib(torso, bare):
    supports = three_point_supports(torso, "right")
    changes = {"T11-R11_L": [5], "T12-R12_R": [3, 4, 5]}
    assert mechanisms(slackened(torso, changes), supports) == ()
    one, three = mechanisms(slackened(bare, changes), supports)
    assert (one.modes, one.bones) == (1, ("R11_L",))
    assert "R11_L can turn about the axis" in one.text
    assert "through joint T11-R11_L: joint T11-R11_L has no stiffness in gamma" in one.text
    assert (three.modes, three.bones) == (3, ("R12_R",))
    assert "R12_R can turn about all axes through joint T12-R12_R" in three.text
    assert "alpha, beta, gamma" in three.text


def test_the_axis_of_a_turn_is_the_joints_own(bare):
    joint = bare.joints.names.index("T11-R11_L")
    axis = (bare.rest_pose.bone_rotations[bare.joints.parent[joint]] @ bare.joints.parent_axes[joint])[:, 1]
    axis = axis * np.sign(axis[np.argmax(np.abs(axis))])
    (found,) = mechanisms(slackened(bare, {"T11-R11_L": [4]}), three_point_supports(bare, "right"))
    assert "({:.2f}, {:.2f}, {:.2f})".format(*(axis.round(2) + 0.0)) in found.text


def test_a_slide_is_told_from_a_turn(bare):
    (found,) = mechanisms(slackened(bare, {"T11-R11_L": [1]}), three_point_supports(bare, "right"))
    assert "R11_L can shift along" in found.text
    assert "no stiffness in y" in found.text


def test_a_rib_slack_at_one_end_is_held_by_the_other(bare):
    assert mechanisms(slackened(bare, {"T5-R5_L": slice(None)}), three_point_supports(bare, "right")) == ()


def tied_block(tied, young=0.05):
    """A held block of tissue with a second bone tied to it by the nodes where ``tied`` says so."""
    positions, elements = box_mesh((2, 2, 2), (20.0, 20.0, 20.0), 10)
    owner = np.where(positions[:, 1] < 1.0, 0, np.where(tied(positions), 1, -1))
    bones = np.array([[10.0, 0.0, 10.0], [10.0, 20.0, 10.0]])
    held = np.zeros((2, 6), dtype=bool)
    held[0] = True
    return make_torso(bones, [], np.zeros(6), (positions, elements), owner, young), holds(held)


def top(positions):
    return positions[:, 1] > 19.0


TIES = {
    "a face": (lambda p: top(p), 0),
    "a line": (lambda p: top(p) & (p[:, 2] < 1.0), 1),
    "a point": (lambda p: top(p) & (p[:, 2] < 1.0) & (p[:, 0] < 1.0), 3),
}


@pytest.mark.parametrize("name", TIES)
def test_bones_that_tissue_holds_by_a_line_or_a_point_can_turn(name):
    tied, modes = TIES[name]
    torso, supports = tied_block(tied)
    found = mechanisms(torso, supports)
    assert sum(m.modes for m in found) == modes == unresisted(torso, supports)
    assert all(m.bones == ("bone1",) and "can turn about" in m.text for m in found)
    assert all("not resist that" in m.text for m in found)
    if name == "a line":
        assert "turn about the lateral (x) axis through (10, 20, 0) mm" in found[0].text


def test_a_slack_bone_beside_tissue_that_does_not_hold_it():
    mesh = box_mesh((1, 1, 1), (20.0, 20.0, 20.0), 4)
    owner = np.where(mesh[0][:, 1] < 1.0, 0, -1)
    bones, stiffness = np.array([[10.0, 0.0, 10.0], [40.0, 0.0, 10.0]]), STIFF * [1, 1, 1, 1, 1, 0]
    held = np.zeros((2, 6), dtype=bool)
    held[0] = True
    (found,) = mechanisms(make_torso(bones, [(0, 1)], stiffness, mesh, owner), holds(held))
    assert found.text == (
        "bone1 can turn about the AP (z) axis through joint bone0-bone1: "
        "joint bone0-bone1 has no stiffness in gamma, and no tissue node holds it"
    )


def test_pieces_of_tissue_that_share_an_edge_are_hinged():
    """Two blocks that touch along an edge; the second is tied to nothing else."""
    one = box_mesh((1, 1, 1), (10.0, 10.0, 10.0), 4)
    positions = np.vstack([one[0], one[0] + [10.0, 10.0, 0.0]])
    positions, inverse = np.unique(positions.round(9), axis=0, return_inverse=True)
    elements = inverse.ravel()[np.vstack([one[1], one[1] + len(one[0])])]
    owner = np.where(positions[:, 1] < 1.0, 0, -1)
    torso = make_torso(np.zeros((1, 3)), [], np.zeros(6), (positions, elements), owner)
    supports = holds(np.ones((1, 6), dtype=bool))
    (found,) = mechanisms(torso, supports)
    assert (found.modes, found.bones) == (1, ())
    assert "tissue around" in found.text
    assert "turn about the AP (z) axis" in found.text
    assert unresisted(torso, supports) == 1


def test_tissue_without_shear_stiffness_holds_nothing():
    torso, supports = tied_block(top)
    none = replace(torso, tissue=replace(torso.tissue, lame_mu=np.zeros(len(torso.tissue.elements))))
    loose, bone = mechanisms(none, supports)
    assert loose.modes == 3 * len(torso.tissue.free_nodes)
    assert "no element with stiffness" in loose.text
    assert "bone1 is connected to nothing" in bone.text
    potential = Potential(torso)
    slack = potential.stiffness(None)._replace(mu=np.zeros(len(potential.tissue.number)))
    assert [m.text for m in mechanisms(torso, supports, slack)] == [loose.text, bone.text]


def test_count_agrees_with_the_assembled_tangent_on_random_chains():
    """Five bones in a chain with random slack axes, random holds and springs, in random places and frames."""
    counts = []
    for seed in range(30):
        random = np.random.default_rng(seed)
        stiffness = STIFF * (random.random((4, 6)) > 0.15)
        torso = make_torso(random.uniform(-200, 200, (5, 3)), [(0, 1), (1, 2), (2, 3), (3, 4)], STIFF)
        torso = replace(torso, joints=replace(torso.joints, stiffness=stiffness))
        points = PointsOnBones(random.integers(0, 5, 2), random.uniform(-30, 30, (2, 3)))
        directions = random.normal(size=(2, 3))
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        springs = PointSprings(points, points.positions(torso.rest_pose), directions, np.array([5.0, 0.0]))
        supports = Supports(random.random((5, 6)) < 0.2, springs, ("a", "b"))
        counts.append(sum(m.modes for m in mechanisms(torso, supports)))
        assert counts[-1] == unresisted(torso, supports), seed
    assert min(counts) == 0
    assert len(set(counts)) > 3


@pytest.mark.parametrize("nodes", [4, 10])
def test_verification_models_have_none(nodes):
    torso = toy_torso(0, nodes)
    assert mechanisms(torso, toy_supports(torso)) == ()
    assert sum(m.modes for m in mechanisms(torso, holds(np.zeros((3, 6), dtype=bool)))) == 6


def test_an_image_term_holds_a_bone_as_a_support_does():
    torso = make_torso(np.array([[0.0, 0, 0], [0, 30.0, 0]]), [(0, 1)], STIFF)
    free = holds(np.zeros((2, 6), dtype=bool))
    points = PointsOnBones(np.array([0, 0, 0, 1, 1, 1]), np.random.default_rng(0).uniform(-9, 9, (6, 3)))
    directions = np.tile(np.eye(3), (2, 1))
    term = PointSprings(points, points.positions(torso.rest_pose), directions, np.ones(6))
    assert len(mechanisms(torso, free)) == 1
    assert mechanisms(torso, free, terms=(term,)) == ()


class Pad:
    """Springs of k N/mm, all ways or k (3,) along the axes, from free nodes to where they are at rest."""

    def __init__(self, torso, nodes, k):
        self.nodes, self.k, self.rest = nodes, k, torso.rest_pose.tissue_positions[nodes]

    def energy(self, state):
        return 0.5 * self.k * np.sum((state.tissue_positions[self.nodes] - self.rest) ** 2)

    def blocks(self, state):
        bones = np.empty(0, np.int64), np.empty((0, 6)), np.empty((0, 6, 6))
        force = self.k * (state.tissue_positions[self.nodes] - self.rest)
        return TermBlocks(*bones, self.nodes, force, np.tile(self.k * np.eye(3), (len(self.nodes), 1, 1)))


def test_a_pad_on_tissue_nodes_holds_a_torso_and_bears_its_load():
    """Springs on three free nodes hold all that hangs on the tissue; one node leaves three turns about it."""
    torso = toy_torso(0, 10)
    free = holds(np.zeros((3, 6), dtype=bool))
    far = np.array([0, 9, len(torso.rest_pose.tissue_positions) - 1])
    assert mechanisms(torso, free, terms=(Pad(torso, far, 2.0),)) == ()
    (turns,) = mechanisms(torso, free, terms=(Pad(torso, far[:1], 2.0),))
    assert turns.modes == 3
    pad, load = Pad(torso, far, 2.0), toy_load(1.0)
    found = EquilibriumProblem(torso, free, (pad,)).solve(load).require()
    assert -pad.blocks(found.state).node_gradient.sum(0) == pytest.approx(-load.total, abs=1e-8)


class OwnJoints(JointLaw):
    """Joints of a table beside the torso's, with the table's stiffness whatever the ratios."""

    def secant(self, state, stiffness):
        return self.joints.stiffness

    def hessians(self, state, stiffness):
        return joint_hessians(self.joints, state, self.joints.stiffness)

    def energy(self, at, stiffness):
        return float(joint_energies(self.joints, at.state, self.joints.stiffness).sum()), np.inf

    def add_shares(self, at, stiffness, groups, columns):
        pass

    def share_products(self, at, stiffness, groups, direction):
        return np.zeros(len(groups))


class Strut(Law):
    """k |u - u0|^2 / 2 of what lies between free node and bone's origin, or, for no bone, the world's."""

    def __init__(self, node, bone, k):
        self.node, self.bone, self.k = node, bone, k

    def pairs(self, unknowns):
        return super().pairs(unknowns) if self.bone is None else np.array([[self.bone, unknowns.bones + self.node]])

    def energy(self, at, stiffness):
        across = at.state.tissue_positions[self.node] - self._rest(at)
        return 0.5 * self.k * float(across @ across), np.inf

    def _rest(self, at):
        rest, now = at.unknowns.torso.rest_pose, at.state
        moved = 0.0 if self.bone is None else now.bone_positions[self.bone] - rest.bone_positions[self.bone]
        return rest.tissue_positions[self.node] + moved

    def add_gradient(self, at, stiffness, gradient):
        force = self.k * (at.state.tissue_positions[self.node] - self._rest(at))
        at.unknowns.node_rows(gradient)[self.node] += force
        if self.bone is not None:
            at.unknowns.bone_rows(gradient)[self.bone, :3] -= force

    def add_hessian(self, at, stiffness, tangent, offsets, project):
        tangent.nodes[self.node] += self.k * np.eye(3)
        if self.bone is not None:
            tangent.bones[self.bone, :3, :3] += self.k * np.eye(3)
            row, column = np.array([at.unknowns.bones + self.node]), np.array([self.bone])
            tangent.add(np.hstack([-self.k * np.eye(3), np.zeros((3, 3))])[None], row, column, offsets)


CHAIN = np.array([[0.0, 0, 0], [5.0, 30.0, -8.0], [-4.0, 61.0, 3.0]])


def chains(stiffness=STIFF):
    """Three bones, both joints in the table; the first alone; and the second as a law."""
    both = make_torso(CHAIN, [(0, 1), (1, 2)], np.array([STIFF, stiffness]))
    first = make_torso(CHAIN, [(0, 1)], STIFF)
    return both, first, OwnJoints(make_torso(CHAIN, [(1, 2)], stiffness).joints)


def first_held():
    return holds(np.arange(3)[:, None] < np.full(6, 1))


def test_a_law_of_ones_own_holds_as_a_joint_does():
    both, first, law = chains()
    supports = first_held()
    assert sum(m.modes for m in mechanisms(first, supports)) == 6
    assert mechanisms(first, supports, laws=(law,)) == ()
    load = LoadCase(PointsOnBones(np.array([2]), np.array([[0.0, 5.0, 2.0]])), np.array([[8.0, 1.0, -3.0]]))
    wanted = EquilibriumProblem(both, supports).solve(load).require().state
    found = EquilibriumProblem(first, supports, laws=(law,)).solve(load).require().state
    np.testing.assert_allclose(found.bone_positions, wanted.bone_positions, atol=1e-7)


@pytest.mark.parametrize("slack", [[0], [1, 5], [3, 4, 5], [0, 1, 2, 4]])
def test_a_law_holds_no_more_than_it_curves(slack):
    stiffness = STIFF.copy()
    stiffness[slack] = 0.0
    both, first, law = chains(stiffness)
    (wanted,) = mechanisms(both, first_held())
    (found,) = mechanisms(first, first_held(), laws=(law,))
    assert (found.bones, found.modes) == (wanted.bones, wanted.modes) == (("bone2",), len(slack))


def test_a_law_between_bones_holds_nothing_to_the_ground():
    _, first, law = chains()
    (found,) = mechanisms(first, holds(np.zeros((3, 6), dtype=bool)), laws=(law,))
    assert found.modes == 6
    assert found.text == "the whole torso is held by no support (six free motions)"


def test_a_neutral_zone_holds_nothing_at_rest():
    slack = np.array([10.0, 20.0, 30.0, 1e3, 2e3, 0.0])
    torso = make_torso(CHAIN, [(0, 1), (1, 2)], np.array([STIFF, slack]))
    zone = NeutralZone(torso.joints, np.ones((2, 6), dtype=bool), 0.05, 1.0)
    found, wanted = (mechanisms(torso, first_held(), laws=laws) for laws in ((zone,), ()))
    assert found == wanted != ()


def test_laws_on_tissue_nodes_hold_a_torso():
    """Struts from three free nodes to the ground; one leaves the turns about its node."""
    torso = toy_torso(0, 10)
    free = holds(np.zeros((3, 6), dtype=bool))
    nodes = (0, 9, len(torso.rest_pose.tissue_positions) - 1)
    assert mechanisms(torso, free, laws=[Strut(node, None, 2.0) for node in nodes]) == ()
    (turns,) = mechanisms(torso, free, laws=[Strut(nodes[0], None, 2.0)])
    assert turns.modes == 3


def with_a_loose_node():
    """The toy torso with one more free node, which no element has; its number among the free ones."""
    torso = toy_torso(0, 10)
    mesh = torso.tissue
    places = np.vstack([mesh.rest_positions, [[0.0, 200.0, 0.0]]])
    mesh = replace(mesh, rest_positions=places, bone_of_node=np.append(mesh.bone_of_node, -1))
    pose = replace(torso.rest_pose, tissue_positions=places[mesh.free_nodes])
    return replace(torso, tissue=mesh, rest_pose=pose), len(mesh.free_nodes) - 1


def test_a_loose_node_may_be_held_by_a_term_or_a_law():
    torso, node = with_a_loose_node()
    supports = toy_supports(torso)
    (loose,) = mechanisms(torso, supports)
    assert loose.text.endswith("belongs to no element with stiffness")
    pad, strut = Pad(torso, np.array([node]), 2.0), Strut(node, 1, 2.0)
    assert mechanisms(torso, supports, terms=(pad,)) == ()
    assert mechanisms(torso, supports, laws=(strut,)) == ()
    for problem in (EquilibriumProblem(torso, supports, (pad,)), EquilibriumProblem(torso, supports, laws=(strut,))):
        assert problem.solve(toy_load()).converged
    with pytest.raises(EquilibriumError, match="belongs to no element with stiffness"):
        EquilibriumProblem(torso, supports).solve(toy_load())


def test_a_loose_node_that_is_held_two_ways_only_is_named():
    torso, node = with_a_loose_node()
    rail = Pad(torso, np.array([node]), np.array([2.0, 0.0, 2.0]))
    (loose,) = mechanisms(torso, toy_supports(torso), terms=(rail,))
    assert loose.modes == 3


def test_the_error_is_one_line_with_names_and_what_is_left_out(bare):
    changes = {f"T{i}-R{i}_{side}": slice(None) for i in (11, 12) for side in "LR"}
    changes |= {f"scapula_{side}-humerus_{side}": slice(None) for side in "LR"}
    free = slackened(bare, changes)
    with pytest.raises(EquilibriumError) as error:
        require_no_mechanism(free, three_point_supports(free, "right", "hinge", wall=False))
    text = str(error.value)
    assert text.startswith("no equilibrium is determined: R11_L is connected to nothing")
    # Four ribs, two humeri, and the torso that turns about the pelvis since nothing ties it to the held humerus.
    assert text.endswith("; and 2 more")
    assert "\n" not in text
