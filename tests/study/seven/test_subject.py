"""One subject of the study."""

from __future__ import annotations

from spinestiff.files import write_json
from spinestiff.study.seven.participants import seven
from spinestiff.study.seven.subject import _make
from spinestiff.study.synthetic import truth_path


def test_a_subject_that_is_there_is_not_told_as_made(tmp_path):
    recipe, folder, lines = seven()[0].recipe(), tmp_path / "subject-1", []
    folder.mkdir()
    (folder / "subject.json").touch()
    write_json(truth_path(folder), {"recipe": recipe.as_record()})
    assert _make(folder, recipe, lines.append) is False
    assert lines == []
