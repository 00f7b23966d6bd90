"""JSON files are written whole or not at all, and digests tell every change of a file or folder."""

from __future__ import annotations

import json

import numpy as np
import pytest

from spinestiff.errors import SpinestiffError, SubjectError
from spinestiff.files import file_digest, read_json, write_json


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


def test_digests_tell_every_change(tmp_path):
    (tmp_path / "pushes/a").mkdir(parents=True)
    (tmp_path / "pushes/a/Doe^Jane2.dcm").write_bytes(b"two")
    (tmp_path / "pushes/a/Doe^Jane1.dcm").write_bytes(b"one")
    (tmp_path / "subject.json").write_bytes(b"")
    assert file_digest(tmp_path / "subject.json") == "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855"
    with pytest.raises(SubjectError, match="can't be read"):
        file_digest(tmp_path / "missing.json")
    # A file more, another content and another order are all changes of the folder.
    first = file_digest(tmp_path / "pushes/a")
    (tmp_path / "pushes/a/3.dcm").write_bytes(b"three")
    second = file_digest(tmp_path / "pushes/a")
    (tmp_path / "pushes/a/3.dcm").write_bytes(b"other")
    third = file_digest(tmp_path / "pushes/a")
    (tmp_path / "pushes/a/3.dcm").rename(tmp_path / "pushes/a/Z.dcm")
    assert len({first, second, third, file_digest(tmp_path / "pushes/a")}) == 4
