"""Torsos with the estimated stiffness and with draws: the files have it, the table tells it."""

from __future__ import annotations

import csv
import re

import numpy as np
import pytest

from results import register
from spinestiff.anatomy.stiffness import NMM_PER_NM
from spinestiff.errors import SubjectError, TorsoError
from spinestiff.study.drawn import ESTIMATE, TABLE, check_format, drawn_ratios, export_drawn
from spinestiff.study.visit import open_visit
from spinestiff.subject.estimate_outcome import Estimate
from spinestiff.subject.run_record import read_outcome, write_outcome


def rows_of(path):
    return list(csv.reader(path.read_text().splitlines()))


def test_draws_are_rows_of_the_posterior_from_one_end_to_the_other(finished):
    visit = open_visit(finished.folder)
    found = drawn_ratios(visit, 3).ratios
    header, *rows = rows_of(finished.folder / "results" / "posterior.csv")
    estimate = read_outcome(visit.subject, Estimate)
    assert list(found) == [ESTIMATE, "draw-001", "draw-002", "draw-003"]
    assert found[ESTIMATE] == estimate.values
    for name, row in (("draw-001", rows[0]), ("draw-003", rows[-1])):
        told = [float(row[header.index(ratio)]) for ratio in estimate.parameters]
        assert list(found[name].values()) == pytest.approx(told)
    assert list(drawn_ratios(visit, 0).ratios) == [ESTIMATE]


def test_more_draws_than_there_are_are_refused(finished):
    with pytest.raises(SubjectError, match=r"has \d+ draws; wanted 100000"):
        drawn_ratios(open_visit(finished.folder), 100_000)


def test_the_paper_s_estimate_has_no_draws(subject):
    visit = open_visit(subject)
    estimate = read_outcome(visit.subject, Estimate)
    write_outcome(visit.subject, estimate.model_copy(update={"method": "paper"}))
    register(visit.subject, "estimate", Estimate.FILE)
    with pytest.raises(SubjectError, match="paper's method, which has no draws"):
        drawn_ratios(visit, 2)
    assert list(drawn_ratios(visit, 0).ratios) == [ESTIMATE]


def test_each_file_has_the_stiffness_that_the_table_tells(finished, tmp_path):
    drawn = drawn_ratios(open_visit(finished.folder), 2)
    lines: list[str] = []
    export_drawn(drawn, tmp_path / "out", "osim", lines.append)
    header, *rows = rows_of(tmp_path / "out" / TABLE)
    assert [row[0] for row in rows] == ["estimate.osim", "draw-001.osim", "draw-002.osim"]
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == sorted([TABLE, *(row[0] for row in rows)])
    joints = drawn.torso.joints
    thoracic = np.array(joints.kinds) == "thoracic"
    default = float(joints.stiffness[thoracic, 5].mean()) / NMM_PER_NM
    for row in rows:
        told = dict(zip(header, row))
        bending = float(told["thoracic level, N m/rad"])
        assert bending == pytest.approx(float(told["lateral_bending"]) * default, rel=1e-4)
        text = (tmp_path / "out" / told["file"]).read_text()
        stiffness = [float(one.split()[2]) for one in re.findall(r"<rotational_stiffness>([^<]*)<", text)]
        assert sum(abs(one / bending - 1.0) < 1e-4 for one in stiffness) >= 10
    assert len(lines) == 3


def test_nothing_is_left_of_an_export_that_fails(finished, tmp_path):
    drawn = drawn_ratios(open_visit(finished.folder), 1)
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "mine.txt").write_text("")
    with pytest.raises(TorsoError, match="out: can't be written"):
        export_drawn(drawn, tmp_path / "out", "osim", lambda line: None)
    assert [path.name for path in tmp_path.iterdir()] == ["out"]
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["mine.txt"]


@pytest.mark.parametrize("kind", ["vtu", "glb", "mrk", "stl"])
def test_a_format_without_stiffness_is_refused(kind):
    with pytest.raises(TorsoError, match="no stiffness to draw; formats with stiffness are osim, mjcf, feb"):
        check_format(kind)
