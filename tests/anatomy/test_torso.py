from dataclasses import replace

import numpy as np
import pytest

from spinestiff.anatomy.points import PointsOnBones
from spinestiff.anatomy.rotation import exp_so3
from spinestiff.anatomy.state import TorsoState, retract
from spinestiff.anatomy.torso import TET10_EDGES, BoneSurface, JointTable, TissueMesh, TorsoModel, joint_frames
from spinestiff.errors import TorsoError

CORNERS = np.array([[0.0, 0, 0], [40, 0, 0], [0, 40, 0], [0, 0, 40], [40, 40, 40]])
TETRAHEDRA = np.array([[0, 1, 2, 3], [1, 2, 3, 4]])


def ten_node(points, tetrahedra):
    edges = np.sort(tetrahedra[:, np.array(TET10_EDGES)].reshape(-1, 2), axis=1)
    unique, inverse = np.unique(edges, axis=0, return_inverse=True)
    middles = len(points) + inverse.reshape(-1, 6)
    return np.vstack([points, points[unique].mean(1)]), np.hstack([tetrahedra, middles])


def mesh(bones=(0, 0, -1, -1, 1), order=4):
    points, elements = (CORNERS, TETRAHEDRA) if order == 4 else ten_node(CORNERS, TETRAHEDRA)
    bone = np.full(len(points), -1)
    bone[:5] = bones
    return TissueMesh(points, elements, bone, np.full(2, 0.1), np.full(2, 0.9))


def joints(rest, **changes):
    frames = joint_frames(
        rest, np.array([0]), np.array([1]), np.array([[15.0, 20.0, 5.0]]), exp_so3(np.array([[0.1, 0.2, 0.3]]))
    )
    fields = {
        "names": ("a-b",),
        "kinds": ("lumbar",),
        "parent": [0],
        "child": [1],
        "stiffness": np.ones((1, 6)),
        **frames,
    }
    return JointTable(**(fields | changes))


@pytest.fixture
def rest():
    turns = exp_so3(np.array([[0.0, 0.1, 0.0], [0.3, 0.0, -0.2]]))
    return TorsoState(np.array([[5.0, 5, 5], [30, 30, 30]]), turns, CORNERS[[2, 3]])


@pytest.fixture
def torso(rest):
    surface = BoneSurface(CORNERS[:4] * 0.1, np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]]))
    return TorsoModel(
        bone_names=("a", "b"),
        rest_pose=rest,
        joints=joints(rest),
        tissue=mesh(),
        vertebra_boxes=np.ones((1, 8, 3)),
        bone_surfaces=(surface, surface),
        landmarks={"tip": PointsOnBones(np.array([1]), np.ones((1, 3)))},
        height_cm=150.0,
        vertebrae=("b",),
    )


def moved(rest):
    return retract(rest, np.concatenate([[1, 2, -1, 0.02, 0.01, -0.03], [0, 1, 2, -0.05, 0.02, 0.04], np.full(6, 0.5)]))


def test_rebased_joints_coincide_and_are_free_of_stress(torso, rest):
    state = moved(rest)
    based = torso.rebased(state)
    table = based.joints
    ends = []
    for side in ("parent", "child"):
        bone = getattr(table, side)
        ends.append(PointsOnBones(bone, getattr(table, f"{side}_position")).positions(state))
        ends.append(state.bone_rotations[bone] @ getattr(table, f"{side}_axes"))
    np.testing.assert_allclose(ends[0], ends[2], atol=1e-12)
    np.testing.assert_allclose(ends[1], ends[3], atol=1e-12)
    np.testing.assert_allclose(based.tissue.rest_positions, torso.node_positions(state))
    assert based.rest_pose is state


def test_rebased_centre_lies_between_the_parted_joint_ends(torso, rest):
    state = moved(rest)
    table = torso.joints
    parted = [
        PointsOnBones(getattr(table, s), getattr(table, f"{s}_position")).positions(state) for s in ("parent", "child")
    ]
    assert np.linalg.norm(parted[0] - parted[1]) > 1.0
    centre = PointsOnBones(table.parent, torso.rebased(state).joints.parent_position).positions(state)
    np.testing.assert_allclose(centre, 0.5 * (parted[0] + parted[1]), atol=1e-12)


def test_rebasing_to_the_rest_pose_changes_nothing(torso, rest):
    again = torso.rebased(rest)
    np.testing.assert_allclose(again.joints.parent_position, torso.joints.parent_position, atol=1e-12)
    np.testing.assert_allclose(again.joints.child_axes, torso.joints.child_axes, atol=1e-12)
    np.testing.assert_allclose(again.tissue.rest_positions, torso.tissue.rest_positions, atol=1e-12)


def test_rebasing_to_an_inverted_element_is_refused(torso, rest):
    flipped = replace(rest, tissue_positions=rest.tissue_positions - 100.0)
    with pytest.raises(TorsoError, match="volume"):
        torso.rebased(flipped)


def test_scaled_scales_lengths_and_nothing_else(torso):
    big = torso.scaled(1.5)
    assert big.height_cm == pytest.approx(225.0)
    np.testing.assert_allclose(big.tissue.corner_volumes(), 1.5**3 * torso.tissue.corner_volumes())
    np.testing.assert_allclose(big.joints.child_position, 1.5 * torso.joints.child_position)
    np.testing.assert_allclose(big.vertebra_boxes, 1.5 * torso.vertebra_boxes)
    np.testing.assert_allclose(
        big.node_positions(big.rest_pose), 1.5 * torso.node_positions(torso.rest_pose), atol=1e-12
    )
    np.testing.assert_allclose(
        big.surface_positions(big.rest_pose, 1), 1.5 * torso.surface_positions(torso.rest_pose, 1), atol=1e-12
    )
    np.testing.assert_allclose(big.landmarks["tip"].offset, 1.5)
    np.testing.assert_array_equal(big.joints.stiffness, torso.joints.stiffness)
    np.testing.assert_array_equal(big.rest_pose.bone_rotations, torso.rest_pose.bone_rotations)
    with pytest.raises(TorsoError, match="scale"):
        torso.scaled(0.0)


def test_tied_nodes_ride_on_their_bones(torso, rest):
    shift = np.concatenate([[0.0, 0, 7, 0, 0, 0], np.zeros(12)])
    change = torso.node_positions(retract(rest, shift)) - torso.tissue.rest_positions
    np.testing.assert_allclose(change, np.outer([1, 1, 0, 0, 0], [0.0, 0, 7]), atol=1e-12)


@pytest.mark.parametrize("order", [4, 10])
def test_boundary_faces_are_closed_and_outward(order):
    tissue = mesh(order=order)
    faces = tissue.boundary_faces()
    assert faces.shape == (6, 3 if order == 4 else 6)
    edges = [tuple(e) for f in faces[:, :3].tolist() for e in ((f[0], f[1]), (f[1], f[2]), (f[2], f[0]))]
    assert len(set(edges)) == len(edges)
    assert set(edges) == {(b, a) for a, b in edges}
    p = tissue.rest_positions[faces[:, :3]]
    volume = np.einsum("ti,ti->", p[:, 0], np.cross(p[:, 1], p[:, 2])) / 6.0
    assert volume == pytest.approx(tissue.corner_volumes().sum())


def test_boundary_middles_lie_between_their_corners():
    tissue = mesh(order=10)
    faces = tissue.boundary_faces()
    x = tissue.rest_positions
    for k in range(3):
        np.testing.assert_allclose(x[faces[:, 3 + k]], 0.5 * (x[faces[:, k]] + x[faces[:, (k + 1) % 3]]))


def test_an_inverted_element_is_refused_by_number():
    with pytest.raises(TorsoError, match="element 1"):
        TissueMesh(CORNERS, np.array([[0, 1, 2, 3], [2, 1, 3, 4]]), np.full(5, -1), np.ones(2), np.ones(2))


@pytest.mark.parametrize(
    ("elements", "message"),
    [(np.array([[0, 1, 2, 9]]), "node 9"), (np.array([[0, 1, 2]]), "3 nodes"), (np.array([[-1, 1, 2, 3]]), "node -1")],
)
def test_impossible_elements_are_refused(elements, message):
    with pytest.raises(TorsoError, match=message):
        TissueMesh(CORNERS, elements, np.full(5, -1), np.ones(len(elements)), np.ones(len(elements)))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"stiffness": -np.ones((1, 6))}, "a-b has a negative"),
        ({"child": [0]}, "to itself"),
        ({"parent_axes": np.diag([1.0, 1, -1])[None]}, "right-handed"),
        ({"kinds": ("lumbar", "lumbar")}, "kinds"),
        ({"child_position": np.zeros((2, 3))}, "child_position"),
    ],
)
def test_impossible_joints_are_refused(rest, change, message):
    with pytest.raises(TorsoError, match=message):
        joints(rest, **change)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"bone_names": ("a", "a")}, "unique"),
        ({"bone_names": ("a", "b", "c")}, "3 bones"),
        ({"vertebra_boxes": np.ones((2, 8, 3))}, "vertebra_boxes"),
        ({"tissue": mesh(bones=(0, 0, -1, -1, 5))}, "bone 5"),
        ({"tissue": mesh(bones=(0, 0, 0, -1, 1))}, "free nodes"),
        ({"tissue": mesh(bones=(0, 0, -2, -1, 1))}, "a node names bone -2, but there are 2"),
        ({"landmarks": {"tip": PointsOnBones(np.array([2]), np.ones((1, 3)))}}, "a landmark names bone 2"),
        ({"vertebrae": ("X1",)}, "no bone 'X1'"),
        ({"height_cm": 0.0}, "height of 0 cm; wanted a finite one above 0"),
        ({"height_cm": np.nan}, "height of nan cm"),
        ({"height_cm": np.inf}, "height of inf cm"),
    ],
)
def test_torsos_that_do_not_fit_together_are_refused(torso, change, message):
    with pytest.raises(TorsoError, match=message):
        replace(torso, **change)


@pytest.mark.parametrize("side", ["parent", "child"])
def test_a_joint_of_a_negative_bone_is_refused(torso, side):
    with pytest.raises(TorsoError, match="a joint names bone -1, but there are 2"):
        replace(torso, joints=replace(torso.joints, **{side: [-1]}))


def test_a_negative_shear_modulus_is_refused_and_none_is_not(torso):
    with pytest.raises(TorsoError, match="element 1 has a negative shear modulus"):
        replace(torso.tissue, lame_mu=[0.1, -0.1])
    assert replace(torso.tissue, lame_mu=[0.1, 0.0]).lame_mu[1] == 0.0


@pytest.mark.parametrize("vertex", [4, -1])
def test_a_face_of_a_vertex_that_there_is_not_is_refused(vertex):
    with pytest.raises(TorsoError, match=f"a face of a surface names vertex {vertex}, but there are 4"):
        BoneSurface(CORNERS[:4], [[0, 2, vertex]])


def test_landmarks_by_name(torso):
    assert torso.landmark("tip") is torso.landmarks["tip"]
    with pytest.raises(TorsoError, match=r"^no landmark 'wall' in this torso; there are tip$"):
        torso.landmark("wall")


def test_bones_by_name(torso):
    assert torso.bone("b") == 1
    assert torso.vertebra_bones.tolist() == [1]
    with pytest.raises(TorsoError, match="no bone 'c'"):
        torso.bone("c")


def test_arrays_are_read_only(torso):
    for array in (torso.vertebra_boxes, torso.tissue.elements, torso.joints.stiffness, torso.rest_pose.bone_positions):
        with pytest.raises(ValueError):
            array[...] = 0
    with pytest.raises(TypeError):
        torso.landmarks["tip"] = None
