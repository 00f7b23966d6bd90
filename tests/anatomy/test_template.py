import numpy as np
import pytest
from scipy.spatial import cKDTree

from spinestiff.anatomy.names import BONES, JOINTS, LUMBAR, RIBS, THORACIC, VERTEBRAE
from spinestiff.anatomy.points import PointsOnBones
from spinestiff.anatomy.stiffness import DEFAULT_POISSON, DEFAULT_YOUNG_MPA, joint_stiffness, lame_parameters
from spinestiff.anatomy.template import template_torso
from spinestiff.anatomy.template.assemble import build_skeleton
from spinestiff.anatomy.template.surfaces import inside, meet, signed_volume
from spinestiff.anatomy.torso import TET10_EDGES
from spinestiff.errors import TorsoError

MIRROR = np.array([-1.0, 1.0, 1.0])
# Adult endplate widths and depths above, of Panjabi's tables, and the scale of a girl of 157 cm.
ADULT_UPPER = {"T1": (24.5, 18.5), "T6": (26.2, 26.0), "T12": (39.0, 32.8), "L3": (44.1, 35.2), "L5": (47.3, 34.7)}


@pytest.fixture(scope="module", params=["coarse", "fine"])
def torso(request):
    return template_torso(157.0, request.param)


@pytest.fixture(scope="module")
def coarse():
    return template_torso(157.0, "coarse")


@pytest.fixture(scope="module")
def skeleton():
    return build_skeleton()


def world(torso, name):
    index = torso.bone(name)
    return torso.surface_positions(torso.rest_pose, index), torso.bone_surfaces[index].faces


def opposite(name):
    return name[:-1] + {"L": "R", "R": "L"}[name[-1]] if name[-2:] in ("_L", "_R") else name


def edge_count(faces):
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    directed = {tuple(e) for e in edges.tolist()}
    return len(edges), directed


# Bones


def test_bones_and_joints_are_those_of_the_paper(coarse):
    assert coarse.bone_names == BONES
    assert coarse.joints.names == tuple(str(joint) for joint in JOINTS)
    assert coarse.vertebrae == VERTEBRAE
    np.testing.assert_array_equal(coarse.joints.stiffness, joint_stiffness())
    assert len(coarse.bone_surfaces) == 49


def test_bone_surfaces_are_watertight_and_outward(coarse):
    for name in BONES:
        vertices, faces = world(coarse, name)
        count, directed = edge_count(faces)
        assert len(directed) == count, name
        assert directed == {(b, a) for a, b in directed}, name
        assert signed_volume((vertices, faces)) > 100.0, name
        assert set(faces.ravel()) == set(range(len(vertices))), name


def test_bones_mirror_each_other(coarse):
    rest = coarse.rest_pose
    for name in BONES:
        a, b = coarse.bone(name), coarse.bone(opposite(name))
        np.testing.assert_allclose(rest.bone_positions[a] * MIRROR, rest.bone_positions[b], atol=1e-9)
        ours, theirs = world(coarse, name)[0] * MIRROR, world(coarse, opposite(name))[0]
        gap = np.linalg.norm(ours[:, None] - theirs[None], axis=2).min(1).max()
        assert gap < 1e-9, name


def test_bones_lie_inside_the_skin(skeleton):
    for name, (vertices, _) in zip(BONES, skeleton.surfaces):
        assert skeleton.skin.depth(vertices).min() > 4.0, name


def test_built_skeleton_is_the_one_in_the_data(coarse, skeleton):
    for name, (vertices, _) in zip(BONES, skeleton.surfaces):
        np.testing.assert_allclose(world(coarse, name)[0], vertices, atol=1e-9, err_msg=name)


def test_origin_is_the_middle_of_the_sacral_endplate(coarse):
    # L5's disc starts there: its centre is half a disc up, tilted between L5 and the sacrum.
    centre, _ = joint_places(coarse)
    last = centre[coarse.joints.names.index("pelvis-L5")]
    assert np.linalg.norm(last) == pytest.approx(0.5 * 10.7 * 146.0 / 158.5, abs=0.05)
    assert last[1] > 0.0


def joint_places(torso):
    table = torso.joints
    centre = PointsOnBones(table.parent, table.parent_position).positions(torso.rest_pose)
    return centre, torso.rest_pose.bone_rotations[table.parent] @ table.parent_axes


# Vertebrae


@pytest.mark.parametrize("name", ADULT_UPPER)
def test_vertebral_bodies_have_the_tables_size(coarse, name):
    vertices = coarse.bone_surfaces[coarse.bone(name)].vertices
    scale = 244.0 / 267.6 if name in THORACIC else 146.0 / 158.5
    width, depth = ADULT_UPPER[name]
    box = coarse.vertebra_boxes[VERTEBRAE.index(name)]
    height = box[:, 1].max()
    # The upper rim is the widest ring of the body's upper half.
    rim = vertices[(vertices[:, 1] > 0.7 * height) & (vertices[:, 1] < 1.01 * height) & (vertices[:, 2] > 0.0)]
    assert 2.0 * rim[:, 0].max() == pytest.approx(width * scale, rel=0.05)
    assert 2.0 * rim[:, 2].max() == pytest.approx(depth * scale, rel=0.05)


def test_boxes_follow_the_corner_order_and_bound_the_body(coarse):
    boxes = coarse.vertebra_boxes.reshape(17, 2, 2, 2, 3)
    assert (boxes[:, 0, ..., 1] > 0).all() and (boxes[:, 1, ..., 1] < 0).all()
    assert (boxes[:, :, 0, :, 0] > 0).all() and (boxes[:, :, 1, :, 0] < 0).all()
    assert (boxes[..., 0, 2] > 0).all() and (boxes[..., 1, 2] < 0).all()
    np.testing.assert_allclose(boxes.mean((1, 2, 3)), 0.0, atol=1e-12)


def test_lengths_and_curves_of_the_spine(coarse):
    rest, boxes = coarse.rest_pose, coarse.vertebra_boxes
    up = rest.bone_rotations[:17, :, 1]
    half = boxes[:, 0, 1][:, None] * up
    top, bottom = rest.bone_positions[:17] + half, rest.bone_positions[:17] - half
    along = np.linalg.norm(top - bottom, axis=1)
    discs = np.append(np.linalg.norm(bottom[:-1] - top[1:], axis=1), np.linalg.norm(bottom[-1]))
    assert along[:12].sum() + discs[:11].sum() == pytest.approx(244.0, abs=0.5)
    assert along[12:].sum() + discs[12:16].sum() == pytest.approx(146.0, abs=0.5)
    tilt = np.rad2deg(np.arctan2(up[:, 2], up[:, 1]))
    assert tilt[0] - tilt[11] == pytest.approx(38.0, abs=0.5)
    assert (np.diff(tilt[:12]) < 0.0).all() and (np.diff(tilt[12:]) > 0.0).all()
    assert abs(rest.bone_positions[0, 2]) < 30.0  # T1 stands over the sacrum
    np.testing.assert_array_equal(rest.bone_positions[:17, 0], 0.0)


def test_no_bone_enters_another(coarse):
    surfaces = {name: world(coarse, name) for name in BONES}
    left = [name for name in BONES if not name.endswith("_R")]
    pairs = [(a, b) for i, a in enumerate(left) for b in left[i + 1 :]]
    pairs += [(name, opposite(name)) for name in left if name.endswith("_L")]
    assert [pair for pair in pairs if meet(surfaces[pair[0]], surfaces[pair[1]])] == []


# Ribs and joints


def test_ribs_meet_their_vertebra_and_the_sternum(coarse):
    centre, axes = joint_places(coarse)
    for joint, at, x in zip(JOINTS, centre, axes[:, :, 0]):
        if joint.kind not in ("rib_vertebra", "rib_sternum"):
            continue
        rib = world(coarse, joint.child)[0]
        assert np.linalg.norm(rib - at, axis=1).min() < 10.0, joint
        carrier = world(coarse, joint.parent)[0]
        assert np.linalg.norm(carrier - at, axis=1).min() < 16.0, joint
        # X points from the carrier out along the rib.
        assert x @ (rib[np.argsort(np.linalg.norm(rib - at, axis=1))[:60]].mean(0) - at) > 0.0, joint


def test_shoulder_joints_lie_on_their_bones(coarse):
    centre, _ = joint_places(coarse)
    for joint, at in zip(JOINTS, centre):
        if joint.kind in ("sternum_clavicle", "clavicle_scapula", "scapula_humerus"):
            for bone in (joint.parent, joint.child):
                assert np.linalg.norm(world(coarse, bone)[0] - at, axis=1).min() < 22.0, (joint, bone)


def test_joint_axes_of_the_spine_are_anatomical(coarse):
    _, axes = joint_places(coarse)
    for joint, axis in zip(JOINTS, axes):
        if joint.child in VERTEBRAE:
            np.testing.assert_allclose(axis[:, 0], [1.0, 0.0, 0.0], atol=1e-12)
            assert axis[1, 1] > 0.8 and axis[2, 2] > 0.8


def test_joints_mirror_each_other(coarse):
    centre, axes = joint_places(coarse)
    place = {(j.parent, j.child): i for i, j in enumerate(JOINTS)}
    for (parent, child), i in place.items():
        k = place[opposite(parent), opposite(child)]
        np.testing.assert_allclose(centre[i] * MIRROR, centre[k], atol=1e-9)
        if child not in VERTEBRAE:
            np.testing.assert_allclose(axes[i, :, 0] * MIRROR, axes[k, :, 0], atol=1e-9)


def test_rib_cage_slopes_down_and_has_a_girls_breadth(coarse):
    for name in RIBS:
        vertices = world(coarse, name)[0]
        back = vertices[np.abs(vertices[:, 0]) < 40.0][:, 1].max()
        assert vertices[np.argmax(np.abs(vertices[:, 0])), 1] < back
    reach = np.abs(np.vstack([world(coarse, name)[0] for name in RIBS])[:, 0]).max()
    assert 0.5 * 220.0 < reach < 0.5 * 255.0


def test_ribs_bony_length_follows_the_table(skeleton):
    adult = (140, 238, 291, 325, 344, 352, 344, 331, 304, 263, 184, 109)
    for rib, length in zip(skeleton.ribs, adult):
        bony = np.linalg.norm(np.diff(rib.curve, axis=0), axis=1).sum() * rib.bony
        assert bony == pytest.approx(0.79 * length, rel=0.05)


def test_scapulae_lie_behind_ribs_two_to_seven(coarse):
    vertices = world(coarse, "scapula_L")[0]
    blade = vertices[vertices[:, 0] < 90.0]
    level = {name: world(coarse, name)[0].mean(0)[1] for name in ("T2", "T7", "T8")}
    assert level["T8"] - 25.0 < blade[:, 1].min() < level["T7"]
    assert abs(blade[:, 1].max() - level["T2"]) < 20.0
    for name in RIBS[2:14:2]:
        assert not inside(world(coarse, name), vertices).any()
        assert not inside(world(coarse, "scapula_L"), world(coarse, name)[0]).any()


# Landmarks


def test_landmarks(coarse):
    marks, rest = coarse.landmarks, coarse.rest_pose
    lateral = marks["rib_lateral"]
    assert [BONES[b] for b in lateral.bone] == list(RIBS)
    at = lateral.positions(rest)
    assert (at[::2, 0] > 0).all() and (at[1::2, 0] < 0).all()
    for name, point in zip(RIBS, at):
        assert abs(point[0]) == pytest.approx(np.abs(world(coarse, name)[0][:, 0]).max())
    wall = marks["wall"]
    assert sorted({BONES[b] for b in wall.bone}) == sorted(
        [f"scapula_{s}" for s in "LR"] + [f"R{i}_{s}" for i in range(4, 11) for s in "LR"]
    )
    assert len(wall) == 4 + 14
    assert (wall.positions(rest)[:, 2] < -30.0).all()
    heads = marks["humerus_head"].positions(rest)
    assert heads[0, 0] > 140.0
    np.testing.assert_allclose(heads[0] * MIRROR, heads[1])
    assert [BONES[b] for b in marks["humerus_head"].bone] == ["humerus_L", "humerus_R"]
    belt = marks["pelvis_belt"]
    np.testing.assert_array_equal(belt.offset, 0.0)
    pelvis = world(coarse, "pelvis")[0]
    middle = 0.5 * (pelvis[:, 1].min() + pelvis[:, 1].max())
    assert belt.positions(rest)[0, 1] == pytest.approx(middle, abs=1e-9)


# Tissue


def test_mesh_sizes(torso):
    nodes = len(torso.tissue.rest_positions)
    assert 2500 < nodes < 3500 or 9000 < nodes < 11000
    assert torso.tissue.elements.shape[1] == 10
    assert len(np.unique(torso.tissue.elements)) == nodes


def test_elements_are_well_shaped(torso):
    p = torso.tissue.rest_positions[torso.tissue.elements[:, :4]]
    smallest = 180.0
    for i, j, k, m in ((0, 1, 2, 3), (0, 2, 1, 3), (0, 3, 1, 2), (1, 2, 0, 3), (1, 3, 0, 2), (2, 3, 0, 1)):
        e = p[:, j] - p[:, i]
        a, b = np.cross(e, p[:, k] - p[:, i]), np.cross(e, p[:, m] - p[:, i])
        angle = np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), np.einsum("ti,ti->t", a, b))
        smallest = min(smallest, float(np.rad2deg(angle).min()))
    assert smallest > 15.9
    assert torso.tissue.corner_volumes().min() > 20.0


def test_elements_are_straight_sided_so_their_jacobian_is_constant(torso):
    x, elements = torso.tissue.rest_positions, torso.tissue.elements
    for k, (i, j) in enumerate(TET10_EDGES):
        middle = 0.5 * (x[elements[:, i]] + x[elements[:, j]])
        np.testing.assert_allclose(x[elements[:, 4 + k]], middle, atol=1e-9)


def test_tissue_fills_the_skin_with_one_closed_boundary(torso, skeleton):
    faces = torso.tissue.boundary_faces()[:, :3]
    count, directed = edge_count(faces)
    assert len(directed) == count
    assert directed == {(b, a) for a, b in directed}
    corners = len(np.unique(faces))
    assert corners - count // 2 + len(faces) == 2  # Euler: a sphere
    p = torso.tissue.rest_positions[faces]
    assert signed_volume((p.reshape(-1, 3), np.arange(3 * len(p)).reshape(-1, 3))) == pytest.approx(
        torso.tissue.corner_volumes().sum()
    )
    assert torso.tissue.corner_volumes().sum() == pytest.approx(
        signed_volume(skeleton.skin.surface(160, 240)), rel=0.002
    )
    assert torso.tissue.bone_of_node[np.unique(torso.tissue.boundary_faces())].max() == -1  # no bone is bare


def test_nodes_inside_bones_are_tied_to_one_of_them(torso):
    x, bone = torso.tissue.rest_positions, torso.tissue.bone_of_node
    within = np.zeros(len(x), dtype=bool)
    own = np.zeros(len(x), dtype=bool)
    for index, name in enumerate(BONES):
        hit = inside(world(torso, name), x)
        within |= hit
        own |= hit & (bone == index)
    assert within.any()
    assert (bone[within] >= 0).all()
    assert own[within].all()


def test_tied_nodes_lie_in_or_near_their_bone(torso):
    x, bone = torso.tissue.rest_positions, torso.tissue.bone_of_node
    for index, name in enumerate(BONES):
        tied = x[bone == index]
        surface = world(torso, name)
        outside = tied[~inside(surface, tied)]
        triangles = surface[0][surface[1]]
        samples = np.vstack([triangles.reshape(-1, 3), triangles.mean(1), 0.5 * (triangles[:, 0] + triangles[:, 1])])
        if len(outside):
            assert np.linalg.norm(outside[:, None] - samples, axis=2).min(1).max() < 8.0, name


def test_nodes_close_to_a_bone_ride_on_it_except_midway_between_two(torso):
    # Within 0.11 of the spacing inside (39 and 24.5 mm) and a third of the next bone's distance: tied nodes make bones
    # neither too thin nor weld them.
    near = 4.29 if len(torso.tissue.rest_positions) < 5000 else 2.69
    x, bone = torso.tissue.rest_positions, torso.tissue.bone_of_node
    inner = np.setdiff1d(np.arange(len(x)), torso.tissue.boundary_faces())
    i, j = np.nonzero(np.add.outer(np.arange(6), np.arange(6)) <= 5)
    weights = np.stack([i, j, 5 - i - j], -1) / 5.0
    distance = np.empty((len(inner), len(BONES)))
    for index, name in enumerate(BONES):
        vertices, faces = world(torso, name)
        samples = cKDTree((weights @ vertices[faces]).reshape(-1, 3))
        distance[:, index] = samples.query(x[inner], distance_upper_bound=60.0)[0]  # infinite beyond, without a search
        distance[inside((vertices, faces), x[inner]), index] *= -1.0
    first, second = np.sort(distance, axis=1)[:, :2].T
    tied = bone[inner] >= 0
    assert first[tied].max() < 20.0
    slack = 1.0  # mm, of the samples above
    assert (first[tied] <= np.maximum(second[tied] / 3.0, 0.0) + slack).all()
    side = np.array([name[-2:] in ("_L", "_R") for name in BONES])
    middle = (x[inner, 0] == 0.0) & side[distance.argmin(1)]  # belongs to neither side
    free = ~tied & ~middle & (first < near - slack)
    assert free.any()
    assert (first[free] >= second[free] / 3.0 - slack).all()


def test_every_bone_has_at_least_three_tied_nodes_that_span_a_plane(torso):
    x, bone = torso.tissue.rest_positions, torso.tissue.bone_of_node
    for index, name in enumerate(BONES):
        tied = x[bone == index]
        assert len(tied) >= 3, name
        spread = np.linalg.svd(tied - tied.mean(0), compute_uv=False)
        assert spread[1] > 2.0, name  # mm off a line: all six motions of the bone are felt


def test_mesh_mirrors_itself(torso):
    x, bone = torso.tissue.rest_positions, torso.tissue.bone_of_node
    key = {tuple(np.round(p, 6) + 0.0): i for i, p in enumerate(x)}
    other = np.array([key[tuple(np.round(p * MIRROR, 6) + 0.0)] for p in x])
    swap = np.array([BONES.index(opposite(name)) for name in BONES] + [-1])
    np.testing.assert_array_equal(bone[other], swap[bone])
    corners = {frozenset(e) for e in torso.tissue.elements[:, :4].tolist()}
    assert {frozenset(e) for e in other[torso.tissue.elements[:, :4]].tolist()} == corners


def test_tissue_has_the_default_material(torso):
    mu, lambda_ = lame_parameters(DEFAULT_YOUNG_MPA, DEFAULT_POISSON)
    np.testing.assert_allclose(torso.tissue.lame_mu, mu)
    np.testing.assert_allclose(torso.tissue.lame_lambda, lambda_)


# Heights


@pytest.mark.parametrize("height", [120.0, 139.0, 157.0, 168.0, 180.0, 200.0])
def test_heights_scale_everything(coarse, height):
    torso = template_torso(height)
    factor = height / 157.0
    assert torso.height_cm == pytest.approx(height)
    np.testing.assert_allclose(torso.tissue.rest_positions, factor * coarse.tissue.rest_positions)
    np.testing.assert_allclose(torso.rest_pose.bone_positions, factor * coarse.rest_pose.bone_positions)
    assert torso.tissue.corner_volumes().min() > 0.0


@pytest.mark.parametrize("height", [119.0, 201.0, float("nan"), -1.0])
def test_impossible_heights_are_refused(height):
    with pytest.raises(TorsoError, match="120 to 200"):
        template_torso(height)


def test_unknown_meshes_are_refused():
    with pytest.raises(TorsoError, match="coarse, fine"):
        template_torso(150.0, "medium")


def test_lumbar_names_follow_the_thoracic():
    assert VERTEBRAE == THORACIC + LUMBAR
