"""Results that are not as their step left them: every verb that reads one ends in a line that says what to run."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest

from spinestiff.files import read_json
from spinestiff.study.report.frame_content import prediction_content
from spinestiff.study.report.pictures import curve_changes
from spinestiff.study.steps import stored_predictions
from spinestiff.study.visit import open_visit
from spinestiff.study.wording.numbers import fixed
from spinestiff.subject.assessment_outcome import Assessment
from spinestiff.subject.run_record import read_outcome

# Verbs that read a result and don't make it, and the step that makes it.
READERS = {
    "tracked.json": ("track", ("response", "estimate", "assess", "report", "view", "cobb")),
    "response.json": ("response", ("report",)),
    "personalised.json": ("personalise", ("estimate", "assess", "report", "view")),
    "torso.npz": ("personalise", ("estimate", "assess", "report", "view", "torso")),
    "estimate.json": ("estimate", ("assess", "report", "view")),
    "training.npz": ("estimate", ("assess",)),
    "assessment.json": ("assess", ("report",)),
    "predictions.npz": ("assess", ("report", "view")),
}


def damages(content):
    """Bytes of a result -> damaged ones, by what was done to it."""
    found = {
        "empty object": b"{}",
        "null": b"null",
        "list": b"[]",
        "nothing": b"",
        "truncated": content[: len(content) // 2],
    }
    if content.startswith(b"{"):
        text = content.decode()
        digit = next(re.finditer(r"(?<=[\s\[:-])\d", text)).start()
        edited = text[:digit] + str((int(text[digit]) + 1) % 10) + text[digit + 1 :]
        assert json.loads(edited) != json.loads(text)
        later = {**json.loads(text), "schema_version": 99}
        found |= {"a digit by hand": edited.encode(), "another version": json.dumps(later).encode()}
    else:
        middle = len(content) // 2
        found["a bit"] = content[:middle] + bytes([content[middle] ^ 1]) + content[middle + 1 :]
    return found


def asked(spinestiff, verb, subject, tmp_path):
    arguments = {
        "view": ("view", subject, "--no-open"),
        "torso": ("torso", "export", subject, "--out", tmp_path / "t.vtu"),
    }
    return spinestiff(*arguments.get(verb, (verb, subject)))


def everything(folder):
    return {path.relative_to(folder): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.parametrize("name", READERS)
def test_single_verbs_end_in_one_line(spinestiff, subject, tmp_path, name):
    step, verbs = READERS[name]
    path = subject / "results" / name
    for what, content in damages(path.read_bytes()).items():
        path.write_bytes(content)
        before = everything(subject)
        for verb in verbs:
            ended = asked(spinestiff, verb, subject, tmp_path)
            assert ended.status == 2, (what, verb)
            assert ended.out == "" and len(ended.lines) == 1, (what, verb, ended.err)
            wanted = f"spinestiff: {path}: was changed after spinestiff {step} had written it; run spinestiff {step} "
            assert ended.lines[0].startswith(wanted), (what, verb, ended.err)
        assert everything(subject) == before, what


def test_a_damaged_comparison_ends_the_report_in_one_line(spinestiff, subject, finished):
    path = subject / "results" / "comparison.json"
    for what, content in damages(path.read_bytes()).items():
        path.write_bytes(content)
        ended = spinestiff("report", subject, "--truth", finished.truth, "--redo")
        assert ended.status == 2, what
        last = ended.lines[-1]
        assert last.startswith(f"spinestiff: {path}: was changed after spinestiff assess"), last
        assert sum(line.startswith("spinestiff: ") for line in ended.lines) == 1


@pytest.mark.parametrize("text", [b"{}", b"null", b"[]", b"", b"\xff", b'{"schema_version": 99}'])
def test_without_the_record_of_the_run_nothing_is_believed(spinestiff, subject, tmp_path, text):
    run = subject / "results" / "run.json"
    run.write_bytes(text)
    for verb, name, step in (
        ("estimate", "tracked.json", "track"),
        ("view", "tracked.json", "track"),
        ("cobb", "tracked.json", "track"),
        ("torso", "torso.npz", "personalise"),
    ):
        ended = asked(spinestiff, verb, subject, tmp_path)
        assert (ended.status, ended.out, len(ended.lines)) == (2, "", 1)
        path = subject / "results" / name
        assert f"{path}: {run} does not say how it was made; run spinestiff {step} {subject} again" in ended.err


def test_the_record_of_the_run_comes_back_with_the_steps(spinestiff, subject):
    """For real, with the step that is quick: what was there is made again, to the same bytes."""
    tracked = subject / "results" / "tracked.json"
    before = tracked.read_bytes()
    (subject / "results" / "run.json").write_text("[]")
    ended = spinestiff("track", subject)
    assert ended.status == 0 and "up to date" not in ended.err
    assert tracked.read_bytes() == before
    assert set(read_json(subject / "results" / "run.json")["steps"]) == {"track"}
    tracked.write_text("null")
    ended = spinestiff("track", subject)
    assert ended.status == 0 and "results/tracked.json is not as it was written; made again" in ended.err
    assert tracked.read_bytes() == before


def test_a_cobb_change_is_one_wherever_it_is_shown(spinestiff, finished):
    """Of the same frames: ``assessment.json``, the report's table, its picture, and ``spinestiff cobb``."""
    visit = open_visit(finished.folder)
    assessment, predictions = read_outcome(visit.subject, Assessment), stored_predictions(visit)
    printed = {frame["image"]: frame for frame in json.loads(spinestiff("cobb", finished.folder, "--json").out)}
    table = prediction_content(assessment)["cobb"]
    drawn = {change.push: change for change in curve_changes(predictions)}
    compared = 0
    for frame, shown in zip(assessment.frames, table, strict=True):
        written = frame.cobb_change_deg["measured"]
        of_cobb = printed[f"{frame.push} frame {frame.frame}, {frame.force_n:.0f} N"]["change_deg"]
        for form in ("signed", "fixed_levels", "tilt"):
            assert of_cobb[form] == pytest.approx(getattr(written, form), abs=5.1e-4), form
        assert tuple(of_cobb["levels"]) == written.levels
        assert tuple(of_cobb["tilt_levels"]) == written.tilt_levels
        rows = {row["title"]: row["cells"] for row in shown["rows"]}
        forms = ("signed", "fixed_levels", "tilt")
        shown_as = [f"{fixed(of_cobb[form], 1, True)}° ± {1.96 * of_cobb['sds'][form]:.1f}°" for form in forms]
        ends = [written.signed_levels, "–".join(of_cobb["levels"]), "–".join(of_cobb["tilt_levels"])]
        assert rows["Measured"] == [f"{one} ({levels})" for one, levels in zip(shown_as, ends, strict=True)]
        points = drawn[frame.push]
        (force, tilt, half_width) = points.measured["validation"][-1]
        assert half_width == pytest.approx(1.96 * of_cobb["sds"]["tilt"], rel=1e-4)
        assert (force, tilt) == (frame.force_n, pytest.approx(of_cobb["tilt"], abs=1e-9))
        for model in ("default", "fit"):
            simulated = points.simulated[model]
            (last,) = simulated[np.isclose(simulated[:, 0], frame.force_n)]
            assert last[1] == pytest.approx(frame.cobb_change_deg[model].tilt, abs=5.1e-4)
            assert abs(last[1]) > 0.1
            compared += 1
    assert compared == 4
