"""``spinestiff study``."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from spinestiff.app.study import live
from spinestiff.app.volume import Volume, speaking
from spinestiff.errors import SubjectError
from spinestiff.files import read_json, write_json
from spinestiff.study.seven.participants import seven
from spinestiff.study.seven.subject import known_outcome, result_file, settings_digest, stored_outcome
from spinestiff.study.synthetic.subject import truth_path
from spinestiff.study.visit import Settings
from spinestiff.study.wording.numbers import listed
from spinestiff.subject.lock import sole_run
from spinestiff.subject.program import program_of_numbers
from study_outcomes import outcome

SETTINGS = Settings(mesh="coarse")


@pytest.fixture
def told(tmp_path):
    """A folder with what was found of the first of the seven, without the subject."""
    first = seven()[0]
    found = outcome(1, program=program_of_numbers(), settings=settings_digest(first, SETTINGS), mesh="coarse")
    write_json(result_file(tmp_path, first), found.model_dump(mode="json"))
    return tmp_path


@pytest.fixture
def study(told, finished):
    """The same with the subject: a finished one of another recipe."""
    first = seven()[0]
    shutil.copytree(finished.folder, told / first.name)
    shutil.copy(finished.truth, truth_path(told / first.name))
    return told


def test_help_names_command_and_options_and_imports_nothing_heavy(spinestiff):
    shown = spinestiff("study", "seven", "--help")
    assert shown.status == 0
    own = {"--others", "--mesh", "--workers", "--page", "--page-only", "--json"}
    everywhere = {"--quiet", "--verbose", "--settings", "--help"}
    assert set(re.findall(r"^ +(?:-\w, )?(--[a-z-]+)", shown.out, re.M)) == own | everywhere
    assert re.search(r"^ +study ", spinestiff("--help").out, re.M)
    code = """
import sys
from spinestiff.app.cli import main
sys.argv = ["spinestiff", "study", "seven", "--help"]
try:
    main()
except SystemExit:
    pass
print([name for name in ("numba", "scipy", "matplotlib", "numpy", "pydicom") if name in sys.modules], file=sys.stderr)
"""
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True)
    assert ended.stderr.strip() == "[]"


def test_the_page_and_tables_of_what_is_there(spinestiff, study, tmp_path):
    page = tmp_path / "docs" / "study.md"
    shown = spinestiff("study", "seven", study, "--mesh", "coarse", "--page-only", "--page", page)
    assert shown.status == 0, shown.err
    for number in range(2, 8):
        assert f"Table {number}: " in shown.out
    assert "Goals, 1 of 7 subjects" in shown.out and f"page: {page}" in shown.out.replace("\n", "")
    text = page.read_text(encoding="utf-8")
    assert "**1 of the 7 subjects**" in text and "on the coarse mesh" in text
    assert "No outcome, and no reason noted, of subject-2 to subject-7." in text
    for number in (2, 4):
        assert f"(images/study-figure-{number}.png)" in text
        assert (page.parent / "images" / f"study-figure-{number}.png").stat().st_size > 10_000
    assert "Fig. 2. Tracked corners under rising force (# 1)." in text and "default, estimate (# 1)." in text
    assert "figure-5" not in text and "could not be drawn" not in text


def test_json_is_a_list_of_errors_by_subject(spinestiff, study):
    shown = spinestiff("study", "seven", study, "--mesh", "coarse", "--page-only", "--json")
    assert shown.status == 0, shown.err
    assert json.loads(shown.out) == [
        {
            "subject": "subject-1",
            "rmse_mm": {"default": 10.0, "fit": 2.0},
            "cobb_error_deg": {"default": 16.0, "fit": 1.0},
            "cobb_error_signed_deg": {"default": 16.0, "fit": 1.0},
        }
    ]
    others = spinestiff("study", "seven", study, "--mesh", "coarse", "--page-only", "--others", "--json")
    assert json.loads(others.out) == []


def test_what_was_found_with_other_settings_does_not_count(spinestiff, told):
    page = told / "page.md"
    page.write_text("of an earlier run")

    def refused(folder, mesh):
        shown = spinestiff("study", "seven", folder, "--mesh", mesh, "--page-only", "--page", page)
        assert shown.status == 2 and shown.out == ""
        assert len(shown.lines) == 1 and f"has no outcome of a study with --mesh {mesh}" in shown.lines[0]
        assert page.read_text() == "of an earlier run"

    refused(told, "fine")
    refused(told / "mistyped", "coarse")
    assert not (told / "mistyped").exists()
    path = result_file(told, seven()[0])
    write_json(path, {**read_json(path), "settings": "others"})
    refused(told, "coarse")


STORED = Path(__file__).parents[2] / "benchmarks" / "results" / "study"


def test_stored_outcomes_of_another_program_are_enough_for_page_and_json(spinestiff, tmp_path):
    """Of a program whose hash was of all sources, without a day and without the subjects' folders."""
    folder, page = tmp_path / "seven", tmp_path / "docs" / "study.md"
    shutil.copytree(STORED, folder)
    # A subject without an estimate has no outcome.
    there = [one.name for one in seven() if (folder / f"{one.name}.json").is_file()]
    for name in there:
        path = folder / f"{name}.json"
        found = {key: value for key, value in read_json(path).items() if key != "date"}
        write_json(path, found | {"program": "0.1.0+0123456789ab"})
    kept = page.parent / "images" / "study-figure-5.png"
    kept.parent.mkdir(parents=True)
    kept.write_bytes(b"of an earlier page")
    shown = spinestiff("study", "seven", folder, "--page-only", "--page", page, "--json")
    assert shown.status == 0, shown.err
    found = json.loads(shown.out)
    assert [one["subject"] for one in found] == there and "subject-3" in there
    stored = read_json(folder / "subject-3.json")
    (main,) = [frame for frame in stored["frames"] if frame["push"] == "main"]
    assert found[there.index("subject-3")]["rmse_mm"] == {name: main["rmse_mm"][name] for name in ("default", "fit")}
    for name in there:
        assert f"warning: {name} is in no picture: " in shown.err
    text = page.read_text(encoding="utf-8")
    assert f"**{len(there)} of the 7 subjects**" in text
    who = f"{len(there)} subjects" if len(there) == len(seven()) else listed(there)
    assert f"by program `{stored['program']}` ({who}; day not noted)" in text
    assert stored["program"] in shown.err and f"written by program `{program_of_numbers()}`" in text
    # No picture is drawn; one that was there stays and is told as such.
    assert re.findall(r"\((images/.*?)\)", text) == ["images/study-figure-5.png"]
    assert kept.read_bytes() == b"of an earlier page"
    assert f"{len(there)} subjects could not be drawn" in text and "Fig. 5: of an earlier page" in text


def test_a_run_finds_anew_what_another_program_found(told):
    first = seven()[0]
    assert known_outcome(told, first, SETTINGS) == stored_outcome(told, first, SETTINGS) is not None
    path = result_file(told, first)
    write_json(path, {**read_json(path), "program": "0.1.0+another"})
    assert known_outcome(told, first, SETTINGS) is None
    assert stored_outcome(told, first, SETTINGS).program == "0.1.0+another"


def test_a_study_at_work_is_left_alone(spinestiff, told):
    left = told / ".subject-1.0.tmp"
    left.mkdir()
    with sole_run(told):
        shown = spinestiff("study", "seven", told, "--mesh", "coarse")
    assert shown.status == 2 and len(shown.lines) == 1
    assert "another run of spinestiff is at work here" in shown.lines[0]
    assert left.is_dir()


def test_what_can_not_be_a_study_is_refused_at_once(spinestiff, study, tmp_path):
    (tmp_path / "file").touch()
    for arguments, words in (
        ((study / "subject-1",), "is a subject folder; a study has subject folders inside"),
        ((tmp_path / "file",), "is there already and no folder"),
        ((tmp_path / "new", "--page", "page.html"), r"--page page\.html: wanted the name of a file that ends in \.md"),
        ((tmp_path / "new", "--mesh", "finest"), "unknown mesh 'finest'"),
    ):
        shown = spinestiff("study", "seven", *arguments)
        assert shown.status == 2 and shown.out == ""
        assert len(shown.lines) == 1 and re.search(words, shown.lines[0]), shown.lines
    assert not (tmp_path / "new").exists()


def test_a_folder_that_the_study_did_not_make_is_left_alone(tmp_path):
    from spinestiff.study.seven.subject import study_subject

    own = tmp_path / "subject-1"
    own.mkdir()
    (own / "notes.txt").touch()
    with pytest.raises(SubjectError, match="is no subject of a study"):
        study_subject(tmp_path, seven()[0], SETTINGS, lambda line: None)
    assert [path.name for path in own.iterdir()] == ["notes.txt"]


def test_progress_in_a_log_has_a_line_each(capsys):
    with live(["subject-1"]) as on_line:
        on_line("subject-1", "make: [bold]")
    with speaking(Volume(quiet=True)), live(["subject-1"]) as on_line:
        on_line("subject-1", "never seen")
    err = capsys.readouterr().err
    assert re.search(r"^ +\d+\.\d s  subject-1: make: \[bold\]$", err, re.M)
    assert "never" not in err
