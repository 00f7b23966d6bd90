"""A step is redone only when something it depends on changed, and a result is read only as its step left it."""

from __future__ import annotations

import dataclasses
import json
import os
from pathlib import Path
from types import SimpleNamespace

import pytest

from results import altered, register
from spinestiff.errors import SpinestiffError, SubjectError
from spinestiff.files import read_json, write_json
from spinestiff.subject import run_record
from spinestiff.subject.annotation_record import Annotation
from spinestiff.subject.assessment_outcome import Comparison
from spinestiff.subject.folder import Subject, read_subject
from spinestiff.subject.outcomes import FrameProposals, Tracked
from spinestiff.subject.program import program, program_of_numbers
from spinestiff.subject.records import SubjectRecord, XRayRecord
from spinestiff.subject.run_record import (
    PARTS,
    StepRecord,
    changed_inputs,
    changed_lately,
    changed_outputs,
    input_digest,
    is_current,
    is_unchanged,
    read_outcome,
    record_step,
    recorded_steps,
    step_digest,
    step_record,
    why_stale,
    write_outcome,
)

PUSH = {"id": "a", "side": "right", "level": 8, "d21_mm": 400, "d31_mm": 200, "frames": "a.dcm", "forces_n": [0, 20]}
FOUND = Comparison(truth={"tissue": 0.05}, region_size=6.5, distance2=1.25, inside=True)
DAMAGED = {
    "empty object": "{}",
    "null": "null",
    "list": "[]",
    "nothing": "",
    "no text": b"\xff\xfe\x00{",
}


@pytest.fixture
def bare(tmp_path):
    """A subject whose files nobody reads: what matters here is the record."""
    record = SubjectRecord.model_validate(
        {"schema_version": 1, "id": "x", "age": 13, "sex": "female", "height_cm": 157, "pushes": [PUSH]}
    )
    (tmp_path / "a.dcm").write_bytes(b"frames")
    return Subject(tmp_path, record, Annotation.model_validate({"schema_version": 1, "images": {}}))


def spoiled(path, damage):
    path.write_bytes(damage if isinstance(damage, bytes) else damage.encode())


def test_a_step_is_current_until_something_changes(bare):
    settings = {"method": "weighed"}
    record = step_record(bare, ["a.dcm"], settings)
    assert not is_current(bare, "estimate", record)
    output = bare.results / "estimate.json"
    write_json(output, {"value": 1})
    record_step(bare, "track", StepRecord(digest="11"), [])
    record_step(bare, "estimate", record, [output], 1.5, 2.5)
    assert is_current(bare, "estimate", record)
    assert is_current(bare, "track", StepRecord(digest="11"))
    assert not is_current(bare, "estimate", StepRecord(digest="11"))
    run = read_json(bare.results / "run.json")
    assert set(run) == {"schema_version", "version", "steps"}
    written = run["steps"]["estimate"]
    assert written["inputs"] == {"a.dcm": input_digest(bare, "a.dcm")}
    assert set(written["outputs"]) == {"results/estimate.json"}
    assert (written["settings"], written["seconds"], written["cpu_seconds"]) == (settings, 1.5, 2.5)

    assert step_record(bare, ["a.dcm"], {"method": "paper"}).digest != record.digest
    assert step_digest({"a": "1", "b": "2"}, settings, "1") == step_digest({"b": "2", "a": "1"}, settings, "1")
    assert step_digest({"a": "1", "b": "3"}, settings, "1") != step_digest({"b": "2", "a": "1"}, settings, "1")
    write_json(output, {"value": 2})
    assert not is_current(bare, "estimate", record)
    assert changed_outputs(bare, "estimate") == ("results/estimate.json",)
    output.unlink()
    assert not is_current(bare, "estimate", record)
    assert changed_inputs(bare, "estimate") == ()
    (bare.folder / "a.dcm").write_bytes(b"other frames")
    assert changed_inputs(bare, "estimate") == ("a.dcm",)
    assert step_record(bare, ["a.dcm"], settings).digest != record.digest
    (bare.folder / "a.dcm").unlink()
    assert changed_inputs(bare, "estimate") == ("a.dcm",)
    with pytest.raises(SubjectError, match="no such file"):
        step_record(bare, ["a.dcm"], settings)


def test_a_look_at_a_folder_by_a_file_manager_changes_no_step(bare):
    frames, output = bare.folder / "frames", bare.results / "tracked.json"
    frames.mkdir()
    (frames / "1.dcm").write_bytes(b"one")
    write_json(output, {})
    record_step(bare, "track", step_record(bare, ["frames"], {}), [output])
    (frames / ".DS_Store").write_bytes(b"where icons lie")
    assert is_current(bare, "track", step_record(bare, ["frames"], {}))
    assert is_unchanged(bare, "track")


def test_a_step_is_unchanged_while_its_inputs_and_outputs_are(bare):
    output = bare.results / "estimate.json"
    for spoil in (output, bare.folder / "a.dcm"):
        assert not is_unchanged(bare, "assess")
        (bare.folder / "a.dcm").write_bytes(b"frames")
        write_json(output, {"value": 1})
        record_step(bare, "estimate", step_record(bare, ["a.dcm"], {}), [output])
        assert is_unchanged(bare, "estimate")
        spoil.write_bytes(b"other")
        assert not is_unchanged(bare, "estimate")


def test_a_file_that_is_younger_than_its_own_step_has_changed_though_another_step_has_run_since(bare):
    file, output = bare.folder / "a.dcm", bare.results / "estimate.json"
    write_json(output, {"value": 1})
    os.utime(output, (1_000_000_000, 1_000_000_000))
    record_step(bare, "estimate", step_record(bare, ["a.dcm"], {}), [output], seconds=100.0)
    os.utime(file, (999_999_899, 999_999_899))
    assert changed_lately(bare, "estimate") == ()
    file.write_bytes(b"other")
    for when in (999_999_950, 1_000_000_500):  # while the step was at work, and after it
        os.utime(file, (when, when))
        record_step(bare, "response", step_record(bare, [], {}), [])
        assert changed_lately(bare, "estimate") == ("a.dcm",)


def test_files_that_are_older_than_the_record_are_not_read_again(bare, monkeypatch):
    file, run = bare.folder / "a.dcm", bare.results / "run.json"
    assert changed_lately(bare, "estimate") == ()
    record_step(bare, "estimate", step_record(bare, ["a.dcm", "subject.json: forces"], {}), [])
    file.write_bytes(b"other")
    os.utime(run, (2_000_000_000, 2_000_000_000))
    assert changed_lately(bare, "estimate") == ()
    os.utime(file, (2_000_000_001, 2_000_000_001))
    assert changed_lately(bare, "estimate") == ("a.dcm",)
    file.write_bytes(b"frames")
    os.utime(file, (2_000_000_001, 2_000_000_001))
    assert changed_lately(bare, "estimate") == ()
    # What can't be read has changed, and so has what is gone, and a part of subject.json.
    other = dataclasses.replace(bare, record=bare.record.model_copy(update={"pushes": ()}))
    assert changed_lately(other, "estimate") == ("subject.json: forces",)
    file.unlink()
    assert changed_lately(bare, "estimate") == ("a.dcm",)
    file.symlink_to(file)
    assert changed_lately(bare, "estimate") == ("a.dcm",)


@pytest.mark.parametrize(
    "text",
    [
        "{",
        *DAMAGED.values(),
        '{"schema_version": 9, "version": "1", "steps": {}}',
        '{"schema_version": 99, "version": "1", "steps": {"track": {"digest": "11"}}}',
        '{"schema_version": 2, "version": "1", "steps": []}',
        '{"schema_version": 2, "version": "1", "steps": {"track": {"digest": "11", "hash": "1"}}}',
        '{"schema_version": 2, "version": "1", "steps": {"track": {"digest": "11", "seconds": NaN}}}',
        '{"schema_version": 2, "version": "1", "steps": {"track": {"digest": "11", "seconds": 1e999}}}',
    ],
)
def test_a_damaged_record_only_means_redoing(bare, text):
    bare.results.mkdir()
    spoiled(bare.results / "run.json", text)
    assert recorded_steps(bare) == {}
    assert not is_current(bare, "track", StepRecord(digest="11"))
    record_step(bare, "track", StepRecord(digest="11"), [])
    assert is_current(bare, "track", StepRecord(digest="11"))


def test_a_record_that_cannot_be_opened_is_told_and_kept(bare, monkeypatch):
    path = bare.results / "run.json"
    path.parent.mkdir(exist_ok=True)
    path.write_text("{}", encoding="utf-8")
    real = Path.open

    def refused(self, *args, **kwargs):
        if self == path:
            raise PermissionError(13, "Permission denied")
        return real(self, *args, **kwargs)

    monkeypatch.setattr(Path, "open", refused)
    with pytest.raises(SubjectError, match=r"run.json: can't be read \(no permission\)"):
        recorded_steps(bare)


def test_the_program_is_part_of_the_digest(bare):
    assert step_digest({}, {}, "1") != step_digest({}, {}, "2")
    assert step_record(bare, [], {}, "another").program == "another"
    assert step_record(bare, [], {}).program == program()


CHANGES = {
    "subject.json: X-ray geometry": (("record", "xray"), {"source_detector_mm": 1500.0}),
    "subject.json: body": (("record", "height_cm"), 158.0),
    "subject.json: forces": (("push", "forces_n"), (0.0, 21.0)),
    "subject.json: frames": (("push", "frames"), "b.dcm"),
    "subject.json: person": (("record", "age"), 14.0),
    "subject.json: id": (("record", "id"), "another"),
    "subject.json: pushes": (("push", "level"), 8.5),
    "subject.json: supports": (("record", "pelvis"), "hinge"),
    "subject.json: roles": (("push", "roles"), ("unused", "training")),
    "annotation.json: rest": (("image", "rest/frontal"), None),
    "annotation.json: pushes": (("image", "push/a"), None),
}
TOGETHER = {f"subject.json: {part}": {f"subject.json: {part}", "subject.json: pushes"} for part in ("forces", "frames")}
TOGETHER["subject.json: person"] = {"subject.json: person", "subject.json: body"}
QUAD = [[12.0, 10.0], [2.0, 10.0], [2.0, 20.0], [12.0, 20.0]]


def with_change(subject, what, value):
    where, name = what
    record = subject.record.model_dump(mode="json")
    images = subject.annotation.model_dump(mode="json")["images"]
    if where == "record":
        record[name] = value
    elif where == "push":
        record["pushes"][0][name] = value
    else:
        quads = {f"T{i}": [[x, y + 20.0 * i] for x, y in QUAD] for i in range(1, 13)}
        images[name] = {"vertebrae": quads}
    return Subject(
        subject.folder,
        SubjectRecord.model_validate(record),
        Annotation.model_validate({"schema_version": 1, "images": images}),
    )


@pytest.mark.parametrize("part", CHANGES)
def test_a_change_shows_in_its_part_alone(bare, part):
    assert set(CHANGES) == set(PARTS)
    after = with_change(bare, *CHANGES[part])
    changed = {name for name in PARTS if input_digest(after, name) != input_digest(bare, name)}
    assert changed == TOGETHER.get(part, {part})


def test_what_another_program_made_is_told_as_such(bare, monkeypatch):
    """It may have looked at other parts of the same files."""
    body = "subject.json: body"
    changed = with_change(bare, *CHANGES[body])
    for made_by, words in (
        ("0.0.9+old", f"made by spinestiff 0.0.9+old; by this one, {program()}, {body} changed"),
        (None, "made before subject.json: body changed"),
        (program_of_numbers(), "made before subject.json: body changed"),
    ):
        record = step_record(bare, [body], {}, made_by)
        monkeypatch.setattr(run_record, "recorded_steps", lambda subject, record=record: {"personalise": record})
        assert why_stale(bare, "personalise") == ""
        assert why_stale(changed, "personalise") == words


# Results


def written(bare):
    write_outcome(bare, FOUND)
    register(bare, "assess", Comparison.FILE)
    return bare.results / Comparison.FILE


def test_what_is_written_is_read_back(bare):
    path = written(bare)
    assert read_outcome(bare, Comparison) == FOUND
    assert json.loads(path.read_text())["schema_version"] == 3


def refusal(bare, kind=Comparison):
    with pytest.raises(SubjectError) as caught:
        read_outcome(bare, kind)
    message = str(caught.value)
    assert "\n" not in message
    assert str(bare.results / kind.FILE) in message and f"spinestiff {kind.STEP} {bare.folder}" in message
    return message


@pytest.mark.parametrize("damage", [*DAMAGED.values(), "half", "a digit", "a space"])
def test_a_result_that_is_not_as_its_step_left_it_is_refused(bare, damage):
    path = written(bare)
    text = path.read_text()
    changed = {"half": text[: len(text) // 2], "a digit": text.replace("1.25", "1.26"), "a space": text + " "}
    spoiled(path, changed.get(damage, damage))
    assert path.read_text(errors="replace") != text
    assert "was changed after spinestiff assess had written it" in refusal(bare)


def test_a_result_of_which_nothing_is_known_is_refused(bare):
    assert "no such file; run the step that makes it first" in refusal(bare)
    path = written(bare)
    (bare.results / "run.json").unlink()
    assert "run.json does not say how it was made" in refusal(bare)
    path.unlink()
    write_json(bare.results / Tracked.FILE, {})
    register(bare, "assess", Tracked.FILE)
    # Written by another step than the one that makes it.
    assert "run.json does not say how it was made" in refusal(bare, Tracked)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ({}, "found schema_version None, wanted 3"),
        (None, "found schema_version None, wanted 3"),
        ([], "found schema_version None, wanted 3"),
        ({"schema_version": 99}, "found schema_version 99, wanted 3"),
        ({"schema_version": 3}, "truth: missing"),
        ({**FOUND.model_dump(), "inside": "perhaps"}, "inside: "),
        ({**FOUND.model_dump(), "outside": True}, "outside: unknown key"),
        ({**FOUND.model_dump(), "truth": {"tissue": 0.0}}, "truth.tissue: "),
    ],
)
def test_a_result_of_another_form_is_refused(bare, content, words):
    """Even where ``run.json`` vouches for it: of another version of the program, or made by hand with its hash."""
    path = written(bare)
    path.write_text(json.dumps(content))
    register(bare, "assess", Comparison.FILE)
    assert words in refusal(bare)


def test_a_number_that_is_none_is_refused_by_name(bare):
    path = written(bare)
    path.write_text(path.read_text().replace("1.25", "NaN"))
    register(bare, "assess", Comparison.FILE)
    with pytest.raises(SpinestiffError, match=r"comparison\.json: found NaN"):
        read_outcome(bare, Comparison)


def test_the_helpers_of_these_tests_vouch_for_what_they_write(subject):
    """``altered`` leaves what other results' records say as it was."""
    before = recorded_steps(read_subject(subject))["assess"].outputs
    after = altered(subject, Comparison, lambda content: content.update(inside=None))
    assert read_outcome(after, Comparison).inside is None
    now = recorded_steps(after)["assess"].outputs
    assert set(now) == set(before)
    assert {name for name in now if now[name] != before[name]} == {"results/comparison.json"}
    assert not (after.results / FrameProposals.FILE).exists()


def test_a_geometry_of_no_picture_s_own_changes_no_digest():
    plain, empty, own = (
        PARTS["subject.json: X-ray geometry"](SimpleNamespace(record=SimpleNamespace(xray=XRayRecord(**told))))
        for told in ({}, {"images": {}}, {"images": {"rest/lateral": {"source_detector_mm": 1830.0}}})
    )
    assert "images" not in plain and plain == empty != own
