"""Skin scans: synthetic ones of bodies of other sizes, in frames of their own, whole, in parts and with arms."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
import trimesh

from scans import AXES, HEIGHT, YAW, body, errors, surface, written
from spinestiff.anatomy.axes import body_axes
from spinestiff.anatomy.solids import dense_points, enclosed
from spinestiff.errors import SubjectError
from spinestiff.personalise.quality import mesh_quality
from spinestiff.personalise.registration import register
from spinestiff.personalise.scan import SkinScan, read_scan
from spinestiff.personalise.scanned_skin import with_scan
from spinestiff.personalise.skin_surface import skin_surface


@dataclass(frozen=True)
class Fitted:
    before: object
    after: object
    fit: object


def back(points):
    return points[:, 2] < -10.0


@pytest.fixture(scope="module")
def usual():
    return body(46.0)


@pytest.fixture(scope="module")
def heavy():
    return body(58.0, "fine")


@pytest.fixture(scope="module")
def whole(usual, heavy, tmp_path_factory):
    """A heavier body's trunk with arms, in cm, as PLY."""
    path = written(surface(heavy, arms=True), tmp_path_factory.mktemp("scan") / "whole.ply", unit=10.0)
    return Fitted(usual, *with_scan(usual, read_scan(path, "cm", AXES, HEIGHT)))


@pytest.fixture(scope="module")
def half(usual, heavy, tmp_path_factory):
    """The back of the heavier body alone, in m, as OBJ, its triangles inside out."""
    mesh = surface(heavy, keep=back)
    mesh.invert()
    path = written(mesh, tmp_path_factory.mktemp("scan") / "back.obj", unit=1000.0)
    return Fitted(usual, *with_scan(usual, read_scan(path, "m", AXES, HEIGHT)))


def test_the_skin_comes_to_a_heavier_bodys(whole, heavy):
    was, now = errors(whole.before, heavy), errors(whole.after, heavy)
    assert np.median(was) > 9.0
    assert np.median(now) < 4.5
    assert np.percentile(now, 95) < 12.0
    fit = whole.fit
    assert fit.before_mm[0] > 9.0
    assert fit.after_mm[0] < 2.5 < fit.after_mm[1] < 8.0
    assert abs(fit.yaw_deg + YAW) < 3.0
    assert fit.tilt_deg < 5.0


def test_arms_are_left_out(whole):
    """A good third of the scan's surface is arms."""
    assert 0.5 < whole.fit.used < 0.75
    assert np.abs(whole.fit.points[:, 0]).max() < 215.0
    assert whole.fit.covered > 0.95
    assert whole.fit.left == ()


def test_bones_stay_and_keep_their_cover(whole, usual):
    after = whole.after
    assert after.joints is usual.joints
    assert np.array_equal(after.rest_pose.bone_positions, usual.rest_pose.bone_positions)
    tied = usual.tissue.bone_of_node[usual.tissue.elements[:, :4]] >= 0
    tied = np.unique(usual.tissue.elements[:, :4][tied])
    assert np.array_equal(after.tissue.rest_positions[tied], usual.tissue.rest_positions[tied])
    assert mesh_quality(after).good


def test_what_the_scan_does_not_show_stays_with_the_template(half, heavy, usual):
    fit = half.fit
    assert fit.turned_round
    assert 0.35 < fit.covered < 0.6
    assert any(part.startswith("front") for part in fit.left)
    assert not any(part.startswith("back") for part in fit.left)
    (line,) = (w for w in fit.warnings if "left to the template" in w)
    assert "front" in line
    moved = np.linalg.norm(half.after.tissue.rest_positions - usual.tissue.rest_positions, axis=1)
    front = np.argsort(usual.tissue.rest_positions[:, 2])[-200:]
    assert np.median(moved[front]) < 3.0 < moved.max()
    assert fit.after_mm[0] < 2.5
    assert abs(fit.yaw_deg + YAW) < 3.0


def test_a_leaner_body_never_bares_a_bone(usual):
    """Ten kilograms less, and three millimetres shaved off: the ribs would stick out."""
    lean = skin_surface(body(36.0))
    keep = ~lean.ends
    torso, fit = with_scan(usual, SkinScan((lean.points - 3.0 * lean.normals)[keep], lean.normals[keep], "lean.stl"))
    assert fit.held_mm > 4.0
    assert any("least cover of a bone" in line for line in fit.warnings)
    nodes, faces = torso.tissue.rest_positions, torso.tissue.boundary_faces()[:, :3]
    bones = np.vstack(
        [
            dense_points((torso.surface_positions(torso.rest_pose, i), s.faces), 6.0)
            for i, s in enumerate(torso.bone_surfaces)
        ]
    )
    assert enclosed((nodes, faces), bones).all()


def test_no_scan_is_not_guessed_from_a_box(usual):
    box = trimesh.creation.box((300.0, 520.0, 190.0))
    for _ in range(5):
        box = box.subdivide()
    with pytest.raises(SubjectError, match=r"skin scan: .* (mm from|would move the skin)"):
        with_scan(usual, SkinScan(box.triangles_center, box.face_normals, "box.stl"))


def test_a_ring_does_not_tell_its_height(usual):
    angle = np.linspace(0.0, 2.0 * np.pi, 4000)
    tube = np.stack([120.0 * np.sin(angle), np.linspace(0, 300.0, 4000), 88.0 * np.cos(angle)], -1)
    around = np.stack([np.sin(angle) / 120.0, 0.0 * angle, np.cos(angle) / 88.0], -1)
    around /= np.linalg.norm(around, axis=1, keepdims=True)
    with pytest.raises(SubjectError, match="does not tell how high"):
        register(SkinScan(tube, around, "tube.stl"), usual)


@pytest.mark.parametrize(
    ("axes", "match"),
    [
        (("-x", "+z", "+y"), "left and front turned round"),
        (("-x", "-z", "-y"), "left and up turned round"),
        (("+x", "-z", "+y"), "up and front turned round"),
    ],
)
def test_axes_that_the_body_contradicts_are_refused(usual, tmp_path, axes, match):
    path = written(surface(body(46.0), noise=0.5), tmp_path / "scan.stl", yaw=0.0)
    with pytest.raises(SubjectError, match=rf"fits the body better with {match} .*; check the axes"):
        register(read_scan(path, "mm", body_axes(*axes), HEIGHT), usual)


def test_units_axes_and_things_that_are_no_trunk_are_refused(tmp_path):
    def refusal(path, unit="mm", axes=AXES):
        with pytest.raises(SubjectError) as caught:
            read_scan(path, unit, axes, HEIGHT)
        assert "\n" not in str(caught.value)
        return str(caught.value)

    trunk = written(surface(body(46.0), size=40.0), tmp_path / "trunk.stl")
    assert len(read_scan(trunk, "mm", AXES, HEIGHT).points) > 2000
    assert "trunk.stl extends 59" in refusal(trunk, "cm")
    assert "check unit (m) and axes" in refusal(trunk, "m")
    assert "check the axes" in refusal(trunk, axes=body_axes("-y", "+z", "-x"))
    assert "along front" in refusal(trunk, axes=body_axes("+x", "+y", "+z"))
    hand = trimesh.creation.box((90.0, 30.0, 180.0))
    hand.export(tmp_path / "hand.stl")
    assert "hand.stl extends 180 mm along up" in refusal(tmp_path / "hand.stl")
    stick = trimesh.creation.box((170.0, 40.0, 240.0))
    stick.faces = stick.faces[:2]
    stick.export(tmp_path / "few.stl")
    assert "few.stl" in refusal(tmp_path / "few.stl")
    (tmp_path / "empty.ply").write_text("")
    assert "empty.ply is empty" in refusal(tmp_path / "empty.ply")
    (tmp_path / "text.stl").write_text("solid nothing\nendsolid nothing\n")
    assert "text.stl" in refusal(tmp_path / "text.stl")
    (tmp_path / "nan.obj").write_text("v nan 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    assert "nan.obj has a vertex that is no finite number" in refusal(tmp_path / "nan.obj")
    assert "unknown kind of file" in refusal(tmp_path / "scan.xyz")
    assert "no such file" in refusal(tmp_path / "none.stl")
    with (tmp_path / "huge.stl").open("wb") as file:
        file.truncate(200_000_001)
    assert "at most 200 MB" in refusal(tmp_path / "huge.stl")


def test_axes_are_a_frame():
    np.testing.assert_array_equal(body_axes("+x", "+z", "-y") @ [1.0, 2.0, 3.0], [1.0, 3.0, -2.0])
    with pytest.raises(SubjectError, match="each of x, y and z once"):
        body_axes("+x", "+x", "-y")
    with pytest.raises(SubjectError, match="in a mirror"):
        body_axes("+x", "+z", "+y")
