"""A skin scan in a subject folder, through the personalise step."""

from __future__ import annotations

import json

import numpy as np
import pytest
import trimesh

from spinestiff.anatomy.files import read_torso
from spinestiff.errors import SubjectError
from spinestiff.personalise.skin_surface import skin_surface
from spinestiff.study.runner import run_steps
from spinestiff.study.visit import Settings, open_visit
from spinestiff.subject.folder import read_subject
from spinestiff.subject.geometry_outcome import GeometryRecord
from spinestiff.subject.run_record import read_outcome

AXES = {"left": "+x", "up": "+z", "front": "-y"}


def stated(folder, **changes):
    record = json.loads((folder / "subject.json").read_text())
    record["skin_scan"] = {"file": "scan.ply", "unit": "cm", "axes": AXES, **changes}
    (folder / "subject.json").write_text(json.dumps(record))


def test_the_personalise_step_takes_the_scan(subject):
    """The skin of the folder's own result, thicker by 8 mm, in the scanner's frame and in cm."""
    before = read_torso(subject / "results" / "torso.npz")
    skin = skin_surface(before)
    faces = np.delete(skin.faces, np.unique(skin.face[skin.ends]), axis=0)
    nodes, outward = skin.corners
    points = np.array(before.tissue.rest_positions)
    points[nodes] += 8.0 * outward
    mesh = trimesh.Trimesh(points, faces, process=False).subdivide_to_size(15.0)
    scanned = (mesh.vertices + [40.0, 900.0, -70.0]) @ np.array([[1.0, 0, 0], [0, 0, 1.0], [0, -1.0, 0]]) / 10.0
    trimesh.Trimesh(scanned, mesh.faces, process=False).export(subject / "scan.ply")
    stated(subject)
    lines = []
    assert run_steps(open_visit(subject, Settings(mesh="coarse")), ("personalise",), lines.append) == ["personalise"]
    found = read_outcome(read_subject(subject), GeometryRecord).skin_scan
    assert found.before_mm[0] > 5.0
    assert found.after_mm[0] < 2.0
    assert found.covered > 0.95
    assert found.left_to_template == ()
    assert any("scan to skin" in line for line in lines)
    after = read_torso(subject / "results" / "torso.npz")
    np.testing.assert_allclose(after.rest_pose.bone_positions, before.rest_pose.bone_positions, atol=1e-6)
    assert np.linalg.norm(after.tissue.rest_positions - before.tissue.rest_positions, axis=1).max() > 5.0
    assert (subject / "results" / "skin_scan.png").read_bytes()[:4] == b"\x89PNG"
    assert run_steps(open_visit(subject, Settings(mesh="coarse")), ("personalise",)) == []


def test_a_wrong_unit_ends_before_anything_is_written(subject):
    before = (subject / "results" / "personalised.json").read_bytes()
    trimesh.creation.box((300.0, 200.0, 500.0)).export(subject / "scan.ply")
    stated(subject)
    with pytest.raises(SubjectError, match=r"scan.ply extends 5000 mm along up, .* check unit \(cm\) and axes"):
        run_steps(open_visit(subject, Settings(mesh="coarse")), ("personalise",))
    assert (subject / "results" / "personalised.json").read_bytes() == before
