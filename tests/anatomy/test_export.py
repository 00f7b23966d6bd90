"""Each format read back by something that isn't its writer, where there is such a thing without an extra."""

from __future__ import annotations

import io
import json
import xml.etree.ElementTree as ElementTree
from dataclasses import replace
from itertools import permutations, product

import numpy as np
import pytest
from typer.testing import CliRunner

from spinestiff.anatomy.export import FORMATS, export_torso
from spinestiff.anatomy.export.feb import springs_of_joint
from spinestiff.anatomy.export.mjcf import quaternion
from spinestiff.anatomy.export.mrk import lps_from_world
from spinestiff.anatomy.export.osim import xyz_angles
from spinestiff.anatomy.export.rigid import masses
from spinestiff.anatomy.points import PointsOnBones
from spinestiff.anatomy.rotation import exp_so3
from spinestiff.anatomy.state import retract
from spinestiff.anatomy.stiffness import TABLE_1
from spinestiff.app.cli import app
from spinestiff.errors import TorsoError
from spinestiff.verification.models import make_torso

SIGNS = list(product((1.0, -1.0), repeat=3))


@pytest.fixture(scope="module")
def moved(template):
    """A state with bones and nodes out of rest."""
    dx = np.random.default_rng(0).uniform(-0.05, 0.05, template.rest_pose.dofs)
    return retract(template.rest_pose, dx)


def test_vtu_holds_tissue_bones_joints_and_the_displacement(template, moved, tmp_path):
    meshio = pytest.importorskip("meshio")
    mesh = meshio.read(export_torso(template, tmp_path / "torso.vtu", "vtu", moved))
    kinds = {block.type: block.data for block in mesh.cells}
    np.testing.assert_array_equal(kinds["tetra10"], template.tissue.elements)
    assert len(kinds["triangle"]) == sum(len(s.faces) for s in template.bone_surfaces)
    assert len(kinds["vertex"]) == 67
    n = len(template.tissue.rest_positions)
    np.testing.assert_allclose(mesh.points[:n], template.node_positions(moved))
    np.testing.assert_allclose(mesh.points[:n] - mesh.point_data["displacement_mm"][:n], template.tissue.rest_positions)
    pelvis = mesh.points[kinds["triangle"][mesh.cell_data["bone"][1] == template.bone("pelvis")]]
    wanted = template.surface_positions(moved, template.bone("pelvis"))
    np.testing.assert_allclose(pelvis.reshape(-1, 3).min(0), wanted.min(0))


def test_glb_holds_named_bones_in_metres_that_are_no_metal(template, moved, tmp_path):
    trimesh = pytest.importorskip("trimesh")
    path = export_torso(template, tmp_path / "torso.glb", "glb", moved)
    content = path.read_bytes()
    header = json.loads(content[20 : 20 + int.from_bytes(content[12:16], "little")])
    assert len(header["materials"]) == 50
    assert {m["pbrMetallicRoughness"]["metallicFactor"] for m in header["materials"]} == {0.0}
    assert all("NORMAL" in p["attributes"] for m in header["meshes"] for p in m["primitives"])
    scene = trimesh.load(io.BytesIO(content), file_type="glb")
    assert set(scene.geometry) == {*template.bone_names, "skin"}
    wanted = template.surface_positions(moved, template.bone("T6")) / 1000.0
    np.testing.assert_allclose(scene.geometry["T6"].bounds, [wanted.min(0), wanted.max(0)], atol=1e-6)


def test_markups_are_lps_millimetres(template, moved, tmp_path):
    record = json.loads(export_torso(template, tmp_path / "torso.mrk.json", "mrk", moved).read_text())
    lists = {entry["name"]: entry for entry in record["markups"]}
    assert {entry["coordinateSystem"] for entry in lists.values()} == {"LPS"}
    assert len(lists["joints"]["controlPoints"]) == 67
    assert len(lists["vertebral bodies"]["controlPoints"]) == 17 * 8
    joints = PointsOnBones(template.joints.parent, template.joints.parent_position).positions(moved)
    x, y, z = joints[5]
    point = lists["joints"]["controlPoints"][5]
    assert point["label"] == template.joints.names[5]
    assert point["position"] == pytest.approx([x, -z, y], abs=1e-3)
    front, left, up = lps_from_world(np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]]))
    assert front.tolist() == [0, -1, 0] and left.tolist() == [1, 0, 0] and up.tolist() == [0, 0, 1]


def test_osim_holds_bodies_bushings_and_their_stiffness_in_metres(template, tmp_path):
    root = ElementTree.parse(export_torso(template, tmp_path / "torso.osim", "osim")).getroot()
    assert len(root.findall(".//Body")) == 49 and len(root.findall(".//FreeJoint")) == 49
    bushings = root.findall(".//BushingForce")
    assert len(bushings) == 67
    for bushing, stiffness in zip(bushings, template.joints.stiffness):
        found = [float(v) for tag in ("translational", "rotational")
                 for v in bushing.findtext(f"{tag}_stiffness").split()]  # fmt: skip
        assert found == pytest.approx([*(1000.0 * stiffness[:3]), *(0.001 * stiffness[3:])])


def test_mjcf_holds_a_spring_a_direction_and_closes_every_loop(template, tmp_path):
    root = ElementTree.parse(export_torso(template, tmp_path / "torso.xml", "mjcf")).getroot()
    joints = root.findall(".//joint")
    assert len(joints) == 6 * 67 and len(root.findall(".//weld")) == 67 - 48
    assert sum(float(j.get("stiffness")) for j in joints if j.get("type") == "slide") == pytest.approx(
        1000.0 * template.joints.stiffness[:, :3].sum()
    )


@pytest.mark.parametrize("kind", ["mjcf", "feb"])
def test_formats_whose_springs_are_at_rest_as_written_refuse_another_state(template, moved, tmp_path, kind):
    """Moved altogether, and each of what makes a state alone."""
    rest = template.rest_pose
    parts = [replace(rest, **{key: getattr(moved, key)}) for key in ("bone_positions", "bone_rotations")]
    for state in (moved, *parts, replace(rest, tissue_positions=moved.tissue_positions)):
        with pytest.raises(TorsoError, match="is written at rest"):
            export_torso(template, tmp_path / "torso", kind, state)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("kind", sorted(TABLE_1))
def test_nine_springs_have_a_joints_stiffness(kind):
    wanted = np.array(TABLE_1[kind]) * [1.0, 1.0, 1.0, 1e3, 1e3, 1e3]
    middle, direction, stiffness = springs_of_joint(wanted)
    assert len(stiffness) == 9 and (stiffness >= 0.0).all()
    # A spring resists the stretch along it of the child's small motion (u, w): d . (u + w x m).
    rows = np.hstack([direction, np.cross(middle, direction)])
    np.testing.assert_allclose(rows.T @ (stiffness[:, None] * rows), np.diag(wanted), atol=1e-9 * wanted.max())


def test_feb_holds_tissue_rigid_bones_ties_and_springs(template, tmp_path):
    pytest.importorskip("pyfebio", reason="needs pyfebio (extra [febio])")
    root = ElementTree.parse(export_torso(template, tmp_path / "torso.feb", "feb")).getroot()
    materials = [m.get("type") for m in root.find("Material")]
    assert materials.count("rigid body") == 49 and materials.count("neo-Hookean") == 1
    tissue = next(e for e in root.find("Mesh").findall("Elements") if e.get("type") == "tet10")
    assert len(tissue) == len(template.tissue.elements)
    assert [int(v) - 1 for v in tissue[7].text.split(",")] == template.tissue.elements[7].tolist()
    tied = sum(len(s.text.split(",")) for s in root.find("Mesh").findall("NodeSet"))
    assert tied == int((template.tissue.bone_of_node >= 0).sum())
    assert 67 * 3 < len(root.find("Rigid").findall("rigid_connector")) <= 67 * 9


def test_angles_and_quaternions_are_those_of_the_rotation():
    rng = np.random.default_rng(3)
    for vector in [*rng.normal(size=(20, 3)), np.array([np.pi, 0.0, 0.0]), np.zeros(3)]:
        r = exp_so3(vector)
        x, y, z = (exp_so3(a * e) for a, e in zip(xyz_angles(r), np.eye(3)))
        np.testing.assert_allclose(x @ y @ z, r, atol=1e-12)
        w, *v = quaternion(r)
        v = np.array(v)
        cross = np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])
        np.testing.assert_allclose((w**2 - v @ v) * np.eye(3) + 2 * np.outer(v, v) + 2 * w * cross, r, atol=1e-12)


def test_angles_of_every_frame_along_the_axes_are_those_of_the_rotation():
    """At y = 90 degrees x and z turn about the same axis."""
    frames = [np.eye(3)[list(order)] * np.array(signs)[:, None] for order in permutations(range(3)) for signs in SIGNS]
    frames = [frame for frame in frames if np.linalg.det(frame) > 0.0]
    assert len(frames) == 24
    leaning = exp_so3(np.array([0.0, 0.0, 0.7])) @ exp_so3(np.array([0.0, np.pi / 2, 0.0]))
    for r in (*frames, exp_so3(np.array([0.4, 0.0, 0.0])) @ exp_so3(np.array([0.0, np.pi / 2, 0.0])), leaning):
        x, y, z = (exp_so3(a * e) for a, e in zip(xyz_angles(r), np.eye(3)))
        np.testing.assert_allclose(x @ y @ z, r, atol=1e-9)


def test_glb_of_a_torso_without_surfaces_is_refused(tmp_path):
    bare = make_torso(np.eye(3), [(0, 1), (1, 2)], np.ones((1, 6)))
    with pytest.raises(TorsoError, match=r"^this torso has no surfaces, [^\n]*$"):
        export_torso(bare, tmp_path / "torso.glb", "glb")
    assert not list(tmp_path.iterdir())


def test_masses_are_those_of_bones(template):
    mass, inertia = masses(template)
    assert 1.0 < mass.sum() < 8.0
    assert (inertia > 0.0).all()
    assert (2.0 * inertia.max(1) <= inertia.sum(1) + 1e-12).all()  # no body can do otherwise


def test_every_format_says_what_it_is_and_leaves_out(tmp_path):
    for kind in ("mrk", "osim", "mjcf"):
        out = tmp_path / f"torso{FORMATS[kind].suffix}"
        done = CliRunner().invoke(app, ["torso", "export", "--format", kind, "--out", str(out)], catch_exceptions=False)
        assert done.exit_code == 0 and FORMATS[kind].leaves_out in done.output and out.stat().st_size > 1000


def test_what_can_not_be_exported_leaves_nothing(template, tmp_path):
    with pytest.raises(TorsoError, match="unknown format 'stl'; known are vtu, glb"):
        export_torso(template, tmp_path / "torso.stl", "stl")
    (tmp_path / "none").write_bytes(b"")
    with pytest.raises(TorsoError, match=r"torso\.osim: can't be written"):
        export_torso(template, tmp_path / "none" / "torso.osim", "osim")
    assert [path.name for path in tmp_path.iterdir()] == ["none"]
    done = CliRunner().invoke(app, ["torso", "show", str(tmp_path / "none.npz")])
    assert isinstance(done.exception, TorsoError)
    assert "joints: 67" in CliRunner().invoke(app, ["torso", "show"]).output
