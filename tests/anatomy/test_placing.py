"""The rules that place joints, asked for the template's own bones: there the right answer is known."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from spinestiff.anatomy.importing import placing
from spinestiff.anatomy.importing.naming import find_files
from spinestiff.anatomy.importing.orienting import axes_matrix
from spinestiff.anatomy.importing.placing import _measured, cut_below, place_joints, rearmost, template_column_mm
from spinestiff.anatomy.importing.reading import read_surface
from spinestiff.anatomy.importing.repairing import edges_of, repaired
from spinestiff.anatomy.importing.tubes import centreline, fitted_sphere
from spinestiff.anatomy.importing.vertebra import measure_vertebra, median_plane
from spinestiff.anatomy.names import JOINTS, SIDES, VERTEBRAE
from spinestiff.anatomy.points import PointsOnBones
from spinestiff.anatomy.rotation import exp_so3
from spinestiff.anatomy.solids import dense_points
from spinestiff.anatomy.template.assemble import centroid
from spinestiff.anatomy.template.ribs import left_ribs
from spinestiff.anatomy.template.surfaces import ball, joined, resampled, signed_volume, tube
from spinestiff.anatomy.template.vertebrae import build_spine
from spinestiff.errors import TorsoError


@pytest.fixture
def measured_before(monkeypatch, placed, shift):
    """The vertebrae are the template's: they are not measured again."""
    skeleton, origin = placed
    vertebrae = {name: placing._shifted(v, shift - origin) for name, v in skeleton.vertebrae.items()}
    monkeypatch.setattr(placing, "_measured", lambda *args: vertebrae)


def turned_deg(a, b):
    return np.degrees(np.arccos(np.clip((np.einsum("jik,jik->j", a, b) - 1.0) / 2.0, -1.0, 1.0)))


def test_joints_lie_where_the_template_has_them(placed, shift, template):
    skeleton, origin = placed
    own = PointsOnBones(template.joints.parent, template.joints.parent_position).positions(template.rest_pose)
    axes = template.rest_pose.bone_rotations[template.joints.parent] @ template.joints.parent_axes
    assert origin == pytest.approx(shift, abs=2.0)
    off, turn = np.linalg.norm(skeleton.centres - own, axis=1), turned_deg(axes, skeleton.axes)
    limits = {"thoracic": (1.0, 2.0), "lumbar": (1.0, 2.0), "rib_vertebra": (5.0, 30.0), "rib_sternum": (5.0, 35.0)}
    for j, joint in enumerate(JOINTS):
        far, wide = limits.get(joint.kind, (6.0, 10.0))
        assert off[j] < far and turn[j] < wide, f"{joint}: {off[j]:.1f} mm, {turn[j]:.0f} degrees"
    assert np.median(off) < 2.5 and np.median(turn) < 5.0


def test_vertebral_bodies_are_measured(placed, template):
    skeleton, _ = placed
    for i, name in enumerate(VERTEBRAE):
        found = skeleton.vertebrae[name]
        assert found.centre == pytest.approx(template.rest_pose.bone_positions[i], abs=1.0)
        assert turned_deg(found.axes[None], template.rest_pose.bone_rotations[[i]])[0] < 1.5
        assert np.abs(found.box - template.vertebra_boxes[i]).max() < 3.0
        assert np.median(np.abs(found.box - template.vertebra_boxes[i])) < 2.0


def test_humeral_heads_and_length(placed, template):
    skeleton, _ = placed
    heads = template.landmarks["humerus_head"].positions(template.rest_pose)
    assert np.abs(skeleton.humerus_heads - heads).max() < 3.0
    assert skeleton.column_mm == pytest.approx(template_column_mm(), rel=0.01)


def test_a_turned_and_tilted_vertebra_is_found_as_it_stands(template, template_bones):
    i = VERTEBRAE.index("T8")
    vertices, faces = template_bones["T8"]
    centre = template.rest_pose.bone_positions[i]
    turn = exp_so3(np.array([0.1, 0.35, -0.3]))  # 6 degrees forward, 20 axially, 17 to the side
    moved = ((vertices - centre) @ turn.T + centre, faces)
    found = measure_vertebra("T8", moved, np.array([0.0, 1.0, 0.0]), dense_points(moved, 2.5))
    assert found.centre == pytest.approx(centre, abs=2.0)
    assert turned_deg(found.axes[None], (turn @ template.rest_pose.bone_rotations[i])[None])[0] < 2.0


def with_dense_end(surface, axis, side, share=0.1, rounds=4):
    """The same surface, its triangles at one end along an axis split in four, ``rounds`` times."""
    vertices, faces = surface
    low, high = vertices[:, axis].min(), vertices[:, axis].max()
    for _ in range(rounds):
        place = (vertices[faces].mean(1)[:, axis] - low) / (high - low)
        chosen = np.flatnonzero(place > 1.0 - share if side > 0 else place < share)
        vertices, faces = trimesh.remesh.subdivide(vertices, faces, face_index=chosen)
    return vertices, faces


def test_where_a_mesh_is_dense_changes_no_measurement(template_bones, placed, shift):
    """L3 and L5 at opposite ends of their transverse processes, T1 at its spinous process."""
    dense = {
        "L3": with_dense_end(template_bones["L3"], 0, -1.0),
        "L5": with_dense_end(template_bones["L5"], 0, 1.0),
        "T1": with_dense_end(template_bones["T1"], 2, -1.0, 0.12),
    }
    for name, surface in dense.items():
        assert signed_volume(surface) == pytest.approx(signed_volume(template_bones[name]))
        assert np.linalg.norm(surface[0].mean(0) - template_bones[name][0].mean(0)) > 20.0
    found, origin = place_joints(template_bones | dense)
    assert origin == pytest.approx(placed[1] - shift, abs=0.2)
    for name in VERTEBRAE:
        assert turned_deg(found.vertebrae[name].axes[None], placed[0].vertebrae[name].axes[None])[0] < 0.5, name


def test_a_real_vertebra_dense_on_one_side_stands_as_before(shared_bones):
    """Its right transverse process alone leans it by 36 degrees where up is told by means of vertices."""
    files, scale = find_files(shared_bones), 1000.0 * axes_matrix("ASR")
    bones = {}
    for name in VERTEBRAE:
        vertices, faces = read_surface(files.bones[name][0])
        bones[name] = repaired(name, (vertices @ scale.T, faces))[0]
    up = centroid(bones["L3"]) - centroid(bones["L5"])
    before = measure_vertebra("L5", bones["L5"], up, dense_points(bones["L5"], 2.5))
    bones["L5"] = with_dense_end(bones["L5"], 0, -1.0, rounds=5)
    found = _measured(bones, {name: dense_points(surface, 2.5) for name, surface in bones.items()}, [])
    assert turned_deg(found["L5"].axes[None], before.axes[None])[0] < 0.5


def test_the_median_plane_of_a_vertebra_turned_about_its_axis(template, template_bones):
    i = VERTEBRAE.index("T6")
    points = dense_points(template_bones["T6"], 2.0) - template.rest_pose.bone_positions[i]
    turn = exp_so3(np.array([0.0, 0.6, 0.2]))  # 34 degrees about its own axis
    at, normal = median_plane(points @ turn.T + [5.0, 0.0, 0.0], np.array([0.0, 1.0, 0.0]))
    assert np.degrees(np.arccos(normal @ turn[:, 0])) < 0.5
    assert (at - [5.0, 0.0, 0.0]) @ normal == pytest.approx(0.0, abs=0.2)


def test_what_is_no_vertebra_is_refused_by_name():
    rod = tube(np.array([[0.0, 0, -40], [0, 0, 0], [0, 0, 40]]), np.array([4.0, 4.0]), np.array([0.0, 1.0, 0.0]))
    with pytest.raises(TorsoError, match=r"^T9: "):
        measure_vertebra("T9", rod, np.array([0.0, 1.0, 0.0]), dense_points(rod, 2.0))


@pytest.mark.usefixtures("measured_before")
def test_a_rib_named_after_another_vertebra_is_refused(template_bones):
    bones = dict(template_bones)
    for side in SIDES:
        bones |= {f"R4_{side}": template_bones[f"R8_{side}"], f"R8_{side}": template_bones[f"R4_{side}"]}
    with pytest.raises(TorsoError, match=r"^R4_L: its head lies .* mm from T4 .* from T[789]; is its name right"):
        place_joints(bones)


@pytest.mark.usefixtures("measured_before")
def test_neighbouring_ribs_with_swapped_names_are_refused(template_bones):
    bones = template_bones | {"R5_L": template_bones["R6_L"], "R6_L": template_bones["R5_L"]}
    with pytest.raises(TorsoError, match=r"^R5_L: its head lies 2\d mm below that of R6_L; are their names swapped\?"):
        place_joints(bones)


def test_the_centreline_of_a_bent_tube():
    angle = np.linspace(0.0, 2.2, 40)
    arc = 80.0 * np.stack([np.cos(angle), 0.1 * angle, np.sin(angle)], -1)
    found = centreline("R5_L", tube(arc, np.array([4.0, 6.0]), np.array([0.0, 1.0, 0.0])))
    found = found if np.linalg.norm(found[0] - arc[0]) < np.linalg.norm(found[-1] - arc[0]) else found[::-1]
    assert np.linalg.norm(found[[0, -1]] - arc[[0, -1]], axis=1).max() < 2.5
    apart = np.min(np.linalg.norm(found[:, None] - arc[None], axis=-1), axis=1)
    assert apart.max() < 2.5


def test_a_bone_in_two_pieces_has_no_centreline():
    two = joined(ball(np.zeros(3), 8.0), ball(np.array([60.0, 0.0, 0.0]), 8.0))
    with pytest.raises(TorsoError, match="R5_L is in pieces"):
        centreline("R5_L", two)


def test_a_sphere_among_other_points():
    rng = np.random.default_rng(2)
    on = rng.normal(size=(300, 3))
    on = np.array([5.0, 6.0, 7.0]) + 21.0 * on / np.linalg.norm(on, axis=1, keepdims=True)
    centre, radius = fitted_sphere(np.vstack([on, rng.uniform(-40, 60, (150, 3))]), (12.0, 30.0))
    assert centre == pytest.approx([5.0, 6.0, 7.0], abs=0.05) and radius == pytest.approx(21.0, abs=0.05)


def test_a_long_humerus_is_cut_and_closed(template_bones):
    shaft = tube(
        np.array([[0.0, 0, 0], [0, -100, 0], [2, -300, 1]]), np.array([10.0, 9.0]), np.array([0.0, 0.0, 1.0]), 12
    )
    cut = cut_below(shaft, -60.0)
    assert cut[0][:, 1].min() == pytest.approx(-60.0)
    assert repaired("humerus", cut)[1] == []
    assert signed_volume(cut) == pytest.approx(signed_volume(shaft) * 0.2, rel=0.02)
    assert len(np.unique(np.sort(edges_of(cut[1]), axis=1), axis=0)) == 1.5 * len(cut[1])
    assert cut_below(shaft, -400.0) is None


def test_rearmost_points_keep_their_distance():
    points = np.array([[0.0, 0, -9], [1, 0, -8], [50, 0, -7], [0, 0, 5]])
    assert rearmost(points, 2, 40.0).tolist() == [[0.0, 0, -9], [50, 0, -7]]
    assert rearmost(points, 1, 0.0).tolist() == [[0.0, 0, -9]]


def test_overlapping_vertebrae_are_noted_and_misplaced_ones_refused(template, template_bones, placed):
    skeleton, _ = placed
    assert not any("overlap" in note for note in skeleton.notes)
    vertices, faces = template_bones["T9"]
    down = -template.rest_pose.bone_rotations[VERTEBRAE.index("T9")][:, 1]
    some = template_bones | {"T9": (vertices + 9.0 * down, faces)}
    noted, _ = place_joints(some)
    assert any("T9 and T10: their bodies overlap by" in note for note in noted.notes)
    with pytest.raises(TorsoError, match="T9 and T10: their bodies overlap"):
        place_joints(template_bones | {"T9": (vertices + 19.0 * down, faces)})


def cut_short(surface, share):
    """A left rib's tube from its head along a share of its length, and where it ends."""
    curve = centreline("R5_L", surface)
    curve = curve if curve[0, 2] < curve[-1, 2] else curve[::-1]
    whole = resampled(curve, 401)
    some = resampled(whole[: int(401 * share)], 30)
    return tube(some, np.array([3.0, 5.0]), np.array([0.0, 1.0, 0.0])), some[-1]


@pytest.mark.usefixtures("measured_before")
def test_ribs_that_end_where_their_cartilage_begins_are_taken(template_bones):
    ribs = left_ribs(build_spine())
    cut = {f"R{i + 1}_L": cut_short(template_bones[f"R{i + 1}_L"], ribs[i].bony) for i in range(10)}
    skeleton, origin = place_joints(template_bones | {name: rib for name, (rib, _) in cut.items()})
    ends = {note.split()[0]: float(note.split()[2]) for note in skeleton.notes if "from sternum" in note}
    assert {f"R{i}_L" for i in range(3, 11)} <= set(ends)
    assert ends["R10_L"] > 100.0
    # So far from the sternum, the joint lies where the rib ends.
    for name in ends:
        j = [str(joint) for joint in JOINTS].index(f"sternum-{name}")
        assert np.linalg.norm(skeleton.centres[j] + origin - cut[name][1]) < 4.0, name


@pytest.mark.usefixtures("measured_before")
def test_a_rib_too_short_for_its_cartilage_is_refused(template_bones):
    short = template_bones | {"R5_L": cut_short(template_bones["R5_L"], 0.55)[0]}
    with pytest.raises(TorsoError, match=r"^R5_L ends 1\d\d mm from sternum; wanted at most 8\d mm; is it whole"):
        place_joints(short)


@pytest.mark.usefixtures("measured_before")
def test_a_whole_rib_that_misses_the_sternum_is_refused(template_bones):
    """Turned about its head; its cartilage is there, so nothing can lie between."""
    vertices, faces = template_bones["R8_L"]
    ends = centreline("R8_L", (vertices, faces))[[0, -1]]
    head = ends[np.argmin(ends[:, 2])]
    turned = (vertices - head) @ exp_so3(np.array([0.0, 0.9, 0.0])).T + head
    with pytest.raises(TorsoError, match=r"^R8_L ends 10\d mm from sternum; wanted at most 8\d mm"):
        place_joints(template_bones | {"R8_L": (turned, faces)})
