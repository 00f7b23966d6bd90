"""JSON files are written whole or not at all, and a step is redone only when something it depends on changed."""

from __future__ import annotations

import json

import numpy as np
import pytest

from spinestiff.errors import SpinestiffError, SubjectError
from spinestiff.files import inputs_digest, read_json, write_json
from spinestiff.subject.run_record import StepRecord, is_current, record_step, step_digest


def test_written_json_is_sorted_and_plain(tmp_path):
    path = tmp_path / "results/estimate.json"
    write_json(path, {"b": np.array([1.5, 2.0]), "a": {"z": np.float64(0.1), "y": np.int64(3)}, "c": (1, None)})
    assert read_json(path) == {"a": {"y": 3, "z": 0.1}, "b": [1.5, 2.0], "c": [1, None]}
    assert list(json.loads(path.read_text())) == ["a", "b", "c"]


@pytest.mark.parametrize("bad", [float("nan"), np.array([1.0, np.inf]), {1, 2}, object()])
def test_what_json_lacks_leaves_the_old_file(tmp_path, bad):
    path = tmp_path / "a.json"
    write_json(path, {"old": 1})
    with pytest.raises(SpinestiffError, match=r"a\.json is not written"):
        write_json(path, {"new": bad})
    assert read_json(path) == {"old": 1}
    assert [p.name for p in tmp_path.iterdir()] == ["a.json"]


def test_an_interrupted_write_leaves_the_old_file(tmp_path, monkeypatch):
    path = tmp_path / "a.json"
    write_json(path, {"old": 1})

    def fail(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("spinestiff.files.os.fsync", fail)
    with pytest.raises(SubjectError, match=r"can't be written \(No space left"):
        write_json(path, {"new": 1})
    assert read_json(path) == {"old": 1}
    assert [p.name for p in tmp_path.iterdir()] == ["a.json"]


def test_a_folder_in_the_way_is_one_line(tmp_path):
    (tmp_path / "results").write_text("a file")
    with pytest.raises(SubjectError, match="can't be written"):
        write_json(tmp_path / "results/run.json", {})


def test_digests_are_named_relative_to_the_folder(tmp_path):
    (tmp_path / "pushes/a").mkdir(parents=True)
    (tmp_path / "pushes/a/Doe^Jane2.dcm").write_bytes(b"two")
    (tmp_path / "pushes/a/Doe^Jane1.dcm").write_bytes(b"one")
    (tmp_path / "subject.json").write_bytes(b"")

    def found():
        return inputs_digest(tmp_path, [tmp_path / "subject.json", tmp_path / "pushes/a"])

    first = found()
    assert list(first) == ["pushes/a", "subject.json"]
    assert first["subject.json"] == "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855"
    with pytest.raises(SubjectError, match="can't be read"):
        inputs_digest(tmp_path, [tmp_path / "missing.json"])
    # A file more, another content and another order are all changes of the folder.
    (tmp_path / "pushes/a/3.dcm").write_bytes(b"three")
    second = found()
    (tmp_path / "pushes/a/3.dcm").write_bytes(b"other")
    third = found()
    (tmp_path / "pushes/a/3.dcm").rename(tmp_path / "pushes/a/Z.dcm")
    assert len({content["pushes/a"] for content in (first, second, third, found())}) == 4


def test_a_step_is_current_until_something_changes(tmp_path):
    inputs, settings = {"subject.json": "00"}, {"method": "lm"}
    digest = step_digest(inputs, settings)
    assert not is_current(tmp_path, "estimate", digest)
    output = tmp_path / "results/estimate.json"
    write_json(output, {"value": 1})
    record_step(tmp_path, "track", StepRecord("11"))
    record = StepRecord(digest, inputs, settings, 1.5, inputs_digest(tmp_path, [output]))
    record_step(tmp_path, "estimate", record)
    assert is_current(tmp_path, "estimate", digest)
    assert is_current(tmp_path, "track", "11")
    assert not is_current(tmp_path, "estimate", "11")
    run = read_json(tmp_path / "results/run.json")
    assert run["steps"]["estimate"]["inputs"] == inputs
    assert set(run) == {"schema_version", "version", "steps"}

    assert step_digest(inputs, {"method": "lbfgsb"}) != digest
    assert step_digest({"subject.json": "01"}, settings) != digest
    assert step_digest(dict(reversed(inputs.items())), settings) == digest
    write_json(output, {"value": 2})
    assert not is_current(tmp_path, "estimate", digest)
    output.unlink()
    assert not is_current(tmp_path, "estimate", digest)


@pytest.mark.parametrize(
    "text", ["{", "[]", '{"schema_version": 9, "steps": {}}', '{"schema_version": 1, "steps": []}']
)
def test_a_damaged_record_only_means_redoing(tmp_path, text):
    (tmp_path / "results").mkdir()
    (tmp_path / "results/run.json").write_text(text)
    assert not is_current(tmp_path, "track", "11")
    record_step(tmp_path, "track", StepRecord("11"))
    assert is_current(tmp_path, "track", "11")


def test_the_version_is_part_of_the_digest(monkeypatch):
    before = step_digest({}, {})
    monkeypatch.setattr("spinestiff.subject.run_record.package_version", lambda: "another")
    assert step_digest({}, {}) != before
