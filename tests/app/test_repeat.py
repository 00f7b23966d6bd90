"""``spinestiff repeat``: what it prints and writes."""

from __future__ import annotations

import json
import re
import shutil

from spinestiff.files import read_json


def test_two_visits_of_one_person(spinestiff, subject, tmp_path):
    later = tmp_path / "later" / "girl2"
    shutil.copytree(subject, later)
    ran = spinestiff("repeat", subject, later, "--out", tmp_path / "out")
    assert (ran.status, ran.err) == (0, "")
    assert re.search(r"smallest *\n.*\bchange +expected", ran.out)
    assert "tissue: two estimates of one unchanged person differ by less than a factor of 1.00" in ran.out
    assert f"picture: {tmp_path / 'out/repeat.png'}" in ran.out
    written = read_json(tmp_path / "out/repeat.json")
    assert written["scatter"]["tissue"]["degrees"] == 1
    assert [visit["label"] for visit in written["visits"]] == ["girl", "girl2"]
    assert written["of"] == "visits"
    assert (tmp_path / "out/repeat.png").stat().st_size > 5000
    ran = spinestiff("repeat", subject, later, "--annotators", "--json")
    again = json.loads(ran.out)
    assert again["of"] == "annotators"
    wider = written["scatter"]["lateral_bending"]["expected_sd_log"]
    assert 0.0 < again["scatter"]["lateral_bending"]["expected_sd_log"] < wider


def test_folders_that_can_not_be_compared_end_in_one_line(spinestiff, subject):
    ran = spinestiff("repeat", subject, subject)
    assert ran.status == 2
    assert ran.lines == [f"spinestiff: {subject}: given twice; a visit compared with itself never changes"]
    other = subject.with_name("other")
    shutil.copytree(subject, other)
    ran = spinestiff("repeat", subject, other, "--out", subject / "results")
    assert ran.status == 2
    assert "lies in a folder that is read" in ran.err
    ran = spinestiff("repeat", subject)
    assert ran.status == 2
    assert "repeatability needs two or more of one: give them the same id in subject.json" in ran.err
