"""``spinestiff repeat``: what it prints and writes."""

from __future__ import annotations

import json
import re
import shutil
from dataclasses import replace

import pytest

from spinestiff.app import repeat
from spinestiff.errors import SubjectError
from spinestiff.files import read_json
from spinestiff.study.repeatability import VisitEstimate, VisitRatio


@pytest.fixture
def taken_anew(monkeypatch):
    """Copies of a folder count as visits with radiographs of their own, or as annotations that differ."""
    real = repeat.estimate_of

    def estimate_of(visit, annotators=False):
        one = real(visit, annotators)
        folder = visit.subject.folder.name
        return replace(one, marks=folder) if annotators else replace(one, push_pictures=frozenset({folder}))

    monkeypatch.setattr(repeat, "estimate_of", estimate_of)


@pytest.mark.usefixtures("taken_anew")
def test_two_visits_of_one_person(spinestiff, subject, tmp_path):
    later = tmp_path / "later" / "girl2"
    shutil.copytree(subject, later)
    ran = spinestiff("repeat", subject, later, "--out", tmp_path / "out")
    assert (ran.status, ran.err) == (0, "")
    assert re.search(r"smallest *\n.*\bchange +expected", ran.out)
    assert "tissue: one repetition tells nothing of how far two estimates of one unchanged person differ" in ran.out
    assert "× 1 " not in ran.out
    assert f"picture: {tmp_path / 'out/repeat.png'}" in ran.out
    written = read_json(tmp_path / "out/repeat.json")
    assert written["scatter"]["tissue"]["degrees"] == 1
    assert [visit["label"] for visit in written["visits"]] == ["girl", "girl2"]
    assert written["of"] == "visits"
    assert "marks" not in written["visits"][0]
    assert (tmp_path / "out/repeat.png").stat().st_size > 5000
    ran = spinestiff("repeat", subject, later, "--annotators", "--json")
    again = json.loads(ran.out)
    assert again["of"] == "annotators"
    wider = written["scatter"]["lateral_bending"]["expected_sd_log"]
    assert 0.0 < again["scatter"]["lateral_bending"]["expected_sd_log"] < wider


@pytest.mark.usefixtures("taken_anew")
@pytest.mark.parametrize("name", ["repeat.json", "repeat.png"])
def test_somebody_elses_file_is_not_replaced(spinestiff, subject, tmp_path, name):
    later, out = tmp_path / "later" / "girl2", tmp_path / "out"
    shutil.copytree(subject, later)
    out.mkdir()
    (out / name).write_text('{"mine": 1}', encoding="utf-8")
    ran = spinestiff("repeat", subject, later, "--out", out)
    assert ran.status == 2 and f"has another {name}, which repeat would replace; name another" in ran.err
    assert [path.name for path in out.iterdir()] == [name] and (out / name).read_text() == '{"mine": 1}'
    (out / name).unlink()
    for _ in range(2):  # its own are
        assert spinestiff("repeat", subject, later, "--out", out).status == 0


@pytest.mark.parametrize("out", ["file", "file/in/it"])
def test_an_output_that_can_not_be_written_is_refused_by_its_name(tmp_path, monkeypatch, out):
    (tmp_path / "file").write_text("no folder", encoding="utf-8")
    monkeypatch.setattr(repeat, "open_visit", lambda folder: folder.name)
    monkeypatch.setattr(
        repeat, "estimate_of", lambda name, _: VisitEstimate(name, "girl", {"tissue": VisitRatio(0.1, 0.2, 0.5)})
    )
    with pytest.raises(SubjectError, match=r"file(/in/it)?/repeat\.json: can't be written \("):
        repeat.compare_visits([tmp_path / "may", tmp_path / "june"], tmp_path / out)


def test_folders_that_can_not_be_compared_end_in_one_line(spinestiff, subject):
    ran = spinestiff("repeat", subject, subject)
    assert ran.status == 2
    assert ran.lines == [f"spinestiff: {subject}: given twice; a visit compared with itself never changes"]
    other = subject.with_name("other")
    shutil.copytree(subject, other)
    ran = spinestiff("repeat", subject, other, "--out", subject / "results")
    assert ran.status == 2
    assert "lies in a folder that is read" in ran.err
    ran = spinestiff("repeat", subject, other)
    assert (ran.status, ran.out) == (2, "")
    assert "other: a push has the same radiographs as in girl: a copy is no second visit" in ran.err
    ran = spinestiff("repeat", subject, other, "--annotators")
    assert "other: the annotation is that of girl, corner by corner" in ran.err
    ran = spinestiff("repeat", subject)
    assert ran.status == 2
    assert "repeatability needs two or more of one: give them the same id in subject.json" in ran.err
