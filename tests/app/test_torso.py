"""``spinestiff torso show`` and ``export``: whose torso it is, and what contradicts that."""

from __future__ import annotations

import json
import re

import pytest
from typer.testing import CliRunner

from spinestiff.anatomy.files import write_torso
from spinestiff.anatomy.template import template_torso
from spinestiff.app.cli import app
from spinestiff.errors import SpinestiffError
from spinestiff.files import read_json, write_json
from spinestiff.study.imported import torso_facts


def said(*arguments) -> str:
    done = CliRunner().invoke(app, ["torso", *map(str, arguments)], catch_exceptions=False)
    assert done.exit_code == 0
    return done.output


def refusal(*arguments) -> str:
    error = CliRunner().invoke(app, ["torso", *map(str, arguments)]).exception
    assert isinstance(error, SpinestiffError) and "\n" not in str(error)
    return str(error)


def test_the_template_takes_the_sizes_of_a_body():
    sizes = {"age_years": 11.0, "sex": "male", "mass_kg": 33.0, "kyphosis_deg": 30.0, "lordosis_deg": 40.0}
    options = [
        "--height",
        "141",
        "--age",
        "11",
        "--sex",
        "M",
        "--mass",
        "33",
        "--kyphosis",
        "30",
        "--lordosis",
        "40",
    ]
    wanted = torso_facts(template_torso(141.0, "coarse", **sizes))
    found = dict(line.split(": ", 1) for line in said("show", *options).splitlines())
    assert found == wanted
    assert found["tissue"] != torso_facts(template_torso(141.0))["tissue"]
    usual = dict(line.split(": ", 1) for line in said("show").splitlines())
    assert usual == torso_facts(template_torso(157.0))


def test_an_export_has_the_sizes_too(tmp_path):
    curved, usual = tmp_path / "curved.mrk.json", tmp_path / "usual.mrk.json"
    said("export", "--format", "mrk", "--kyphosis", 50, "--out", curved)
    said("export", "--format", "mrk", "--out", usual)
    assert json.loads(curved.read_text()) != json.loads(usual.read_text())


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--sex", "girl"), "--sex girl: wanted female or male"),
        (("--mass", 150), "body mass 150 kg at 157 cm"),
        (("--mesh", ""), "unknown tissue mesh ''"),
        (("--mesh", "finest"), "unknown tissue mesh 'finest'"),
    ],
)
def test_sizes_of_no_body_are_refused_in_one_line(options, message):
    assert message in refusal("show", *options)


def test_a_torso_of_its_own_takes_no_sizes(tmp_path):
    path = tmp_path / "own.npz"
    write_torso(path, template_torso(150.0))
    assert "height: 150 cm" in said("show", path)
    assert refusal("show", path, "--height", 157).endswith("has a size and a mesh of its own; leave out --height")


def test_a_subject_folder_stands_for_its_torso(subject, tmp_path):
    assert "height: 157 cm" in said("show", subject)
    assert "default stiffness" not in said("export", subject, "--format", "vtu", "--out", tmp_path / "s.vtu")
    assert (tmp_path / "s.vtu").stat().st_size > 10_000
    told = said("export", subject, "--format", "osim", "--out", tmp_path / "s.osim")
    assert "note: of default stiffness; --draws 0 with --out, a new folder, writes the estimated one" in told
    own = subject / "results" / "torso.npz"
    for place, found in ((own, "this command reads it"), (subject / "s.vtu", "lies among the inputs")):
        assert found in refusal("export", subject, "--format", "vtu", "--out", place, "--force")
    assert "is there already" in refusal("export", "--out", tmp_path / "s.vtu")
    assert "this command reads it" in refusal("export", own, "--format", "vtu", "--out", own, "--force")
    record = read_json(subject / "subject.json")
    write_json(subject / "subject.json", {**record, "height_cm": 158.0})
    words = r"torso\.npz: was made before subject\.json: body changed; run spinestiff personalise again"
    assert re.search(words, refusal("show", subject))
    write_json(subject / "subject.json", record)
    path = subject / "results" / "torso.npz"
    write_torso(path, template_torso(150.0))
    assert "torso.npz: was changed after spinestiff personalise had written it" in refusal("show", subject)
    path.unlink()
    assert f"torso.npz: no such file; run the step that makes it first (spinestiff personalise {subject})" in refusal(
        "show", subject
    )


def test_the_format_is_what_the_ending_says(tmp_path):
    assert "for any 3-D viewer" in said("export", "--out", tmp_path / "t.GLB")
    assert (tmp_path / "t.GLB").read_bytes()[:4] == b"glTF"
    assert "for 3D Slicer" in said("export", "--out", tmp_path / "t.mrk.json")
    assert "for MuJoCo" in said("export", "--format", "mjcf", "--out", tmp_path / "model")
    for options, words in (
        (("--format", "vtu", "--out", "t.glb"), "--out t.glb: ends as a file of format glb, and --format is vtu"),
        (("--out", "t.stl"), "--out t.stl: its ending names no format; wanted one of .vtu, .glb, .osim, .xml, .feb"),
        (("--format", "stl", "--out", "t.stl"), "unknown format 'stl'"),
    ):
        assert words in refusal("export", *options)


def test_a_place_for_no_new_folder_is_told_before_an_import(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "empty").mkdir()
    (tmp_path / "link").symlink_to("empty")
    # There are no bones either.
    for out, words in (
        (".", ".: is no folder that could be made anew"),
        ("link", "link: is a link; name a new folder"),
    ):
        assert words in refusal("import", tmp_path / "none", "--out", out)


def test_draws_of_a_subject_go_into_a_new_folder(subject, tmp_path):
    out = tmp_path / "drawn"
    assert "2 torsos and stiffness.csv, for OpenSim 4" in said(
        "export", subject, "--format", "osim", "--draws", 1, "--out", out
    )
    assert sorted(path.name for path in out.iterdir()) == ["draw-001.osim", "estimate.osim", "stiffness.csv"]
    for words, *given in (
        ("exists and is no empty folder", subject, "--format", "osim", "--draws", 1, "--out", out),
        ("is no folder that could be made anew", subject, "--format", "osim", "--draws", 1, "--out", "."),
        ("lies among the inputs", subject, "--format", "osim", "--draws", 1, "--out", subject / "drawn"),
        ("no stiffness to draw", subject, "--draws", 1, "--out", tmp_path / "other"),
        ("wanted a subject folder, and --out a new folder", "--format", "osim", "--draws", 1),
    ):
        assert words in refusal("export", *given)
