"""Whole folders of bones: refused in one line, or a torso that solves."""

from __future__ import annotations

import json
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial import cKDTree
from typer.testing import CliRunner

from spinestiff.anatomy import carving, importing, meshing
from spinestiff.anatomy.files import read_torso
from spinestiff.anatomy.importing import import_torso
from spinestiff.anatomy.importing.carried_skin import ROWS, _template_rows, refuse_bones_outside
from spinestiff.anatomy.importing.orienting import axes_matrix
from spinestiff.anatomy.importing.placing import template_column_mm
from spinestiff.anatomy.mmg import NO_MMG
from spinestiff.anatomy.names import BONES
from spinestiff.anatomy.solids import enclosed
from spinestiff.anatomy.template.surfaces import ball, loft, signed_volume
from spinestiff.anatomy.tetrahedra import signed_volumes
from spinestiff.app.cli import app
from spinestiff.errors import TorsoError
from spinestiff.mechanics.equilibrium import EquilibriumProblem
from spinestiff.mechanics.loads import rib_push
from spinestiff.mechanics.supports import three_point_supports
from spinestiff.personalise.quality import mesh_quality

needs_mmg = pytest.mark.usefixtures("mmg_installed")


@pytest.fixture
def mmg_installed():
    pytest.importorskip("mmgpy", reason="needs MMG (extra [mesh])")


@pytest.fixture
def no_mesher(monkeypatch):
    """MMG is not installed: what is wrong with the bones is told all the same."""
    monkeypatch.setattr(meshing, "find_spec", lambda name: None)


@pytest.fixture
def placed_before(monkeypatch, placed, shift):
    """The bones are the template's: their joints are not looked for again."""
    skeleton, origin = placed
    monkeypatch.setattr(importing, "place_joints", lambda surfaces: (skeleton, origin - shift))


def refusal(folder, **options) -> str:
    with pytest.raises(TorsoError) as caught:
        import_torso(folder, **options)
    message = str(caught.value)
    assert "\n" not in message
    return message


def rewrite(meshes, folder, bones, name, change):
    vertices, faces = bones[name]
    (folder / f"{name}.stl").write_bytes(meshes.stl(*change(vertices.copy(), faces.copy())))


def with_nan(vertices, faces):
    vertices[faces[7, 0]] = np.nan
    return vertices, faces


def without_a_half(vertices, faces):
    middle = vertices[faces].mean(1)
    return vertices, faces[middle[:, 0] > np.median(middle[:, 0])]


@pytest.mark.usefixtures("no_mesher")
@pytest.mark.parametrize(
    ("name", "change", "message"),
    [
        ("L2", with_nan, "L2.stl has a vertex that is no finite number"),
        ("L4", without_a_half, r"L4.stl has a hole of"),
        ("sternum", lambda v, f: (1e-3 * v, f), r"sternum is .* times too small .*\(mm against m\?\)"),
        ("T7", lambda v, f: (v[:3], np.array([[0, 1, 2]])), "T7"),
    ],
)
def test_one_bad_mesh_is_named(bone_folder, meshes, template_bones, name, change, message):
    rewrite(meshes, bone_folder, template_bones, name, change)
    with pytest.raises(TorsoError, match=message):
        import_torso(bone_folder)


@pytest.mark.parametrize("spacing", [0.0, -3.0, 1e-9, 1e300, float("nan"), float("inf")])
def test_an_impossible_spacing_is_told_before_anything_is_read(tmp_path, spacing):
    assert refusal(tmp_path / "none", spacing_mm=spacing) == f"spacing {spacing:g} mm; wanted 9 to 60 mm"


@pytest.mark.usefixtures("no_mesher")
def test_missing_empty_duplicate_and_copied_meshes(bone_folder, meshes, template_bones):
    (bone_folder / "T3.stl").write_bytes(b"")
    assert refusal(bone_folder) == "T3.stl is empty"
    rewrite(meshes, bone_folder, template_bones, "T3", lambda v, f: template_bones["T4"])
    assert refusal(bone_folder) == "T3.stl and T4.stl are the same mesh under two names"
    rewrite(meshes, bone_folder, template_bones, "T3", lambda v, f: (v, f))
    (bone_folder / "vertebrae_T3.ply").write_bytes(b"x")
    assert "would all be T3" in refusal(bone_folder)
    (bone_folder / "vertebrae_T3.ply").unlink()
    (bone_folder / "T3.stl").unlink()
    assert "no mesh for T3" in refusal(bone_folder)


@pytest.mark.usefixtures("no_mesher")
def test_what_the_user_says_wrongly_is_refused(bone_folder):
    assert "look like mm" in refusal(bone_folder, unit="m")
    assert "look like LSA" in refusal(bone_folder, axes="LPS")


def test_a_skin_in_another_unit_is_refused_before_it_is_worked_on(bone_folder, meshes, monkeypatch):
    def nothing(surfaces):
        raise AssertionError("the skin was taken")

    monkeypatch.setattr(importing, "place_joints", nothing)
    vertices, faces = ball(np.zeros(3), 300.0)
    (bone_folder / "skin.stl").write_bytes(meshes.stl(10.0 * vertices, faces))
    message = "skin.stl is 14.9 times as large as all bones together; wanted a skin in their unit"
    assert refusal(bone_folder) == message
    (bone_folder / "skin.stl").write_bytes(meshes.stl(vertices, faces))
    with pytest.raises(AssertionError, match="was taken"):
        import_torso(bone_folder)


def test_a_height_that_the_spine_contradicts_is_refused(bone_folder, monkeypatch):
    """As of bones in inches, which look like the centimetres of a small body; one that nobody has, before."""
    spine = SimpleNamespace(column_mm=template_column_mm() / 2.54, notes=())
    monkeypatch.setattr(importing, "place_joints", lambda surfaces: (spine, np.zeros(3)))
    message = refusal(bone_folder, height_cm=157.0)
    assert message.startswith("body height 157 cm, but a spine of 160 mm goes with some 62 cm; check the height and")
    assert "body height 400 cm; wanted 90 to 230 cm" in refusal(bone_folder, height_cm=400.0)


@pytest.mark.usefixtures("placed_before")
def test_an_unknown_mesher_is_said_before_any_work_a_missing_one_after_the_bones(bone_folder, no_mesher):
    told = []
    assert "no mesher 'gmsh'; installed: mmg" in refusal(bone_folder, mesher="gmsh", observer=told.append)
    assert told == []
    assert refusal(bone_folder, observer=told.append) == (
        'meshing needs MMG; install it with pip install "spinestiff[mesh]"'
    )
    assert [line.split(":")[0] for line in told] == ["note", "read", "axes", "repair", "joints", "skin"]


def test_a_bone_outside_the_skin_is_named(template, template_bones):
    faces = template.tissue.boundary_faces()[:, :3]
    skin = (template.tissue.rest_positions, faces)
    small = (skin[0] * [0.6, 1.0, 1.0], faces)
    with pytest.raises(TorsoError, match=r"^(humerus|scapula)_[LR] sticks out of the skin by \d+ mm; wanted all"):
        refuse_bones_outside(template_bones, small)


@needs_mmg
@pytest.mark.slow
def test_mixed_formats_metres_and_dicom_axes_give_a_torso_on_the_command_line(
    template, template_bones, meshes, tmp_path
):
    """The template's bones through files and back: 49 bones, 67 joints where they were, and a picture."""
    folder = meshes.write(
        tmp_path / "bones", template_bones, (".stl", ".obj", ".ply", ".vtp"), axes_matrix("LPS").T / 1000.0
    )
    (folder / "T5.stl" if (folder / "T5.stl").exists() else next(folder.glob("T5.*"))).rename(folder / "object.dat")
    vertices, faces = template_bones["T5"]
    (folder / "object.dat").rename(folder / "object.stl")
    (folder / "object.stl").write_bytes(meshes.stl(vertices @ (axes_matrix("LPS").T / 1000.0).T, faces[:, ::-1]))
    (tmp_path / "map.json").write_text(json.dumps({"bones": {"T5": "object.stl"}}))
    arguments = [
        "torso",
        "import",
        str(folder),
        "--out",
        str(tmp_path / "own"),
        "--mapping",
        str(tmp_path / "map.json"),
    ]
    done = CliRunner().invoke(app, [*arguments, "--spacing", "36", "--height", "157"], catch_exceptions=False)
    assert done.exit_code == 0
    for words in ("unit m (found), axes LPS", "object.stl: it faced inwards", "bones: 49", "joints: 67", "torso.png"):
        assert words in done.output
    torso = read_torso(tmp_path / "own" / "torso.npz")
    record = json.loads((tmp_path / "own" / "torso.json").read_text())
    assert record["axes"] == "LPS" and record["bones"]["T5"] == ["object.stl"] and record["height_cm"] == 157.0
    assert (tmp_path / "own" / "torso.png").read_bytes().startswith(b"\x89PNG")
    assert torso.joints.names == template.joints.names
    np.testing.assert_array_equal(torso.joints.stiffness, template.joints.stiffness)
    off = [
        t.rest_pose.bone_positions[t.joints.parent] + np.einsum(
            "jik,jk->ji", t.rest_pose.bone_rotations[t.joints.parent], t.joints.parent_position
        )
        for t in (torso, template)
    ]  # fmt: skip
    assert np.median(np.linalg.norm(off[0] - off[1], axis=1)) < 3.0
    counts = np.bincount(torso.tissue.bone_of_node[torso.tissue.bone_of_node >= 0], minlength=49)
    assert counts.min() >= 3
    # The skin holds the bones with a cover, and about as much tissue as the template has.
    ratio = torso.tissue.corner_volumes().sum() / template.tissue.corner_volumes().sum()
    assert 0.85 < ratio < 1.2
    again = CliRunner().invoke(app, [*arguments, "--spacing", "36"])
    assert again.exit_code != 0 and "no empty folder" in str(again.exception)


@needs_mmg
@pytest.mark.slow
def test_the_real_bone_set_imports_and_solves(shared_bones):
    found = import_torso(shared_bones, spacing_mm=34.0)
    torso = found.torso
    assert torso.bone_names == BONES and len(torso.joints) == 67
    assert (found.placement.unit, found.placement.axes, found.placement.told) == ("m", "ASR", ())
    assert {path.name for path in found.files.bones["pelvis"]} == {"sacrum.stl", "l_pelvis.stl", "r_pelvis.stl"}
    # The six that are not closed.
    for name in ("l_pelvis", "r_pelvis", "clavicle_L", "clavicle_R", "scapula_L", "scapula_R"):
        assert any(line.startswith(f"{name}.stl: ") and "closed" in line for line in found.repairs), name
    assert found.tissue.least_angle_deg >= meshing.LEAST_ANGLE_DEG
    joints = json.loads((shared_bones / "joint_frames_default_pose.json").read_text())
    _assert_near(torso, joints)
    problem = EquilibriumProblem(torso, three_point_supports(torso, side="right"))
    solved = problem.solve(rib_push(torso, side="right", level=8, force_n=40.0)).require()
    apex = torso.bone("T8")
    moved = solved.state.bone_positions[apex] - torso.rest_pose.bone_positions[apex]
    assert 0.05 < moved[0] < 10.0
    reactions = solved.reaction("shoulder")[0] + solved.reaction("pelvis")[0]
    assert reactions == pytest.approx(-40.0, abs=0.5)


def _assert_near(torso, frames):
    # The shoulders of the source's own model, relative to each other: no common origin is known.
    world = axes_matrix("ASR") * 1000.0
    names = {"scapula_L-humerus_L": "humerus_l", "scapula_R-humerus_R": "humerus_r"}
    ours, theirs = [], []
    centre = torso.rest_pose.bone_positions[torso.joints.parent] + np.einsum(
        "jik,jk->ji", torso.rest_pose.bone_rotations[torso.joints.parent], torso.joints.parent_position
    )
    for joint, body in names.items():
        ours.append(centre[torso.joints.names.index(joint)])
        theirs.append(world @ np.array(frames[body]["joint_center_in_pelvis_m"]))
    assert np.linalg.norm((ours[0] - ours[1]) - (theirs[0] - theirs[1])) < 15.0


@needs_mmg
@pytest.mark.slow
@pytest.mark.usefixtures("placed_before")
def test_a_given_skin_is_used_and_too_tight_a_one_refused(bone_folder, meshes, template, tmp_path):
    nodes, faces = template.tissue.rest_positions, np.array(template.tissue.boundary_faces()[:, :3])
    wide = nodes * [1.1, 1.04, 1.15]
    (bone_folder / "skin.ply").write_bytes(meshes.ply(wide, faces))
    found = import_torso(bone_folder, spacing_mm=38.0)
    assert found.files.skin.name == "skin.ply"
    volume = found.torso.tissue.corner_volumes().sum()
    assert volume == pytest.approx(signed_volume((wide, faces)), rel=meshing.VOLUME_TOLERANCE)
    (bone_folder / "skin.ply").unlink()
    (tmp_path / "tight.stl").write_bytes(meshes.stl(nodes * [0.7, 1.0, 0.8], faces))
    assert "sticks out of the skin by" in refusal(bone_folder, skin=tmp_path / "tight.stl")


@needs_mmg
@pytest.mark.slow
@pytest.mark.usefixtures("placed_before")
def test_a_skin_of_few_large_triangles_is_rounded_and_meshed(bone_folder, meshes, template):
    """Every fourth point of every third row: about 500 triangles with edges of 50 to 90 mm."""
    rows = _template_rows(template)[np.linspace(0, ROWS - 1, 17).round().astype(int), ::4]
    low = loft(rows * [1.08, 1.0, 1.1])
    assert 450 < len(low[1]) < 600
    (bone_folder / "skin.ply").write_bytes(meshes.ply(*low))
    found = import_torso(bone_folder, spacing_mm=36.0)
    assert any("large, flat triangles were rounded" in note for note in found.notes)
    assert found.tissue.least_angle_deg >= meshing.LEAST_ANGLE_DEG
    volume = found.torso.tissue.corner_volumes().sum()
    assert volume == pytest.approx(signed_volume(low), rel=meshing.VOLUME_TOLERANCE)
    assert mesh_quality(found.torso).good


def test_the_gate_refuses_a_mesher_that_gives_flat_elements(monkeypatch, template_bones):
    skin = ball(np.array([0.0, 130.0, 16.0]), np.array([270.0, 400.0, 200.0]), 20, 30)
    assert all(enclosed(skin, vertices).all() for vertices, _ in template_bones.values())
    told = []
    monkeypatch.setattr(meshing, "find_mesher", lambda name: lambda points, tetrahedra, required: (points, tetrahedra))
    with pytest.raises(TorsoError, match=r"no mesh with dihedral angles above 5 degrees in 2 tries \(last: smallest"):
        meshing.mesh_tissue(template_bones, skin, 60.0, observer=told.append, tried_shares=(1.0, 0.95))
    assert len(told) == 2

    def mover(points, tetrahedra, required):
        return points + 0.01, tetrahedra

    monkeypatch.setattr(meshing, "find_mesher", lambda name: mover)
    with pytest.raises(TorsoError, match="the mesher moved points of the bones"):
        meshing.mesh_tissue(template_bones, skin, 60.0, tried_shares=(1.0,))


def test_another_seed_is_another_mesh(template_bones):
    """In its bones and inside altogether, on the skin most of it; the same seed is the same mesh."""
    skin = ball(np.array([0.0, 130.0, 16.0]), np.array([270.0, 400.0, 200.0]), 20, 30)
    first, again, other = (meshing.starting_mesh(template_bones, skin, 60.0, (seed, 0)) for seed in (1, 1, 2))
    for one, same in zip(first, again):
        assert np.array_equal(one, same)
    shared = cKDTree(first[0]).query(other[0])[0] < 1e-6
    skinned = np.zeros(len(other[0]), dtype=bool)
    skinned[carving.boundary(other[1])] = True
    assert (~skinned).sum() > 200
    assert not shared[~skinned].any()
    assert shared[skinned].mean() < 0.4  # this skin has few large triangles


def test_the_mesh_gets_the_skins_volume(monkeypatch, template_bones):
    """The facets of few large triangles cut the curves; corners of the skin move out for that, those of bones stay."""
    skin = ball(np.array([0.0, 130.0, 16.0]), np.array([270.0, 400.0, 200.0]), 20, 30)
    points, tetrahedra, required = meshing.starting_mesh(template_bones, skin, 60.0)
    volumes = signed_volumes(points[tetrahedra])
    tetrahedra = np.where((volumes < 0.0)[:, None], tetrahedra[:, [1, 0, 2, 3]], tetrahedra)
    wanted = signed_volume(skin)
    assert abs(np.abs(volumes).sum() / wanted - 1.0) > 1e-3
    moved = meshing._with_volume(points, tetrahedra, wanted, required)
    assert signed_volumes(moved[tetrahedra]).sum() == pytest.approx(wanted, rel=1e-6)
    assert np.array_equal(moved[required], points[required])
    assert np.linalg.norm(moved - points, axis=1).max() < 5.0


def test_a_plug_in_is_found_by_its_entry_point(monkeypatch):
    class Entry:
        name = "mine"

        def load(self):
            return mesher

    def mesher(points, tetrahedra, required):
        return points, tetrahedra

    monkeypatch.setattr(meshing, "entry_points", lambda group: [Entry()] if group == "spinestiff.meshers" else [])
    assert meshing.find_mesher("mine") is mesher
    with pytest.raises(TorsoError, match="installed: mmg, mine"):
        meshing.find_mesher("yours")


@pytest.mark.parametrize("spacing", [1.0, 500.0])
def test_spacings_that_can_not_be_meant(template_bones, spacing):
    with pytest.raises(TorsoError, match="wanted 9 to 60 mm"):
        meshing.mesh_tissue(template_bones, ball(np.zeros(3), 300.0), spacing)


def test_that_mmg_is_missing_is_told_before_the_bones_are_read(tmp_path, no_mesher):
    lines = []
    with pytest.raises(TorsoError):
        import_torso(tmp_path, observer=lines.append)
    assert lines == [f"note: {NO_MMG}; until then the bones are checked, and no torso is made"]
