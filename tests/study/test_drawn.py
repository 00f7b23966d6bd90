"""Torsos with the estimated stiffness and with draws: the files have it, the table tells it."""

from __future__ import annotations

import csv
import re
from types import SimpleNamespace

import numpy as np
import pytest

from results import register
from spinestiff.anatomy.stiffness import NMM_PER_NM
from spinestiff.anatomy.template import template_torso
from spinestiff.errors import SubjectError, TorsoError
from spinestiff.estimation.unknowns import LAMBDA_SHARE
from spinestiff.study import drawn
from spinestiff.study.drawn import ESTIMATE, TABLE, check_format, drawn_ratios, export_drawn
from spinestiff.study.visit import open_visit
from spinestiff.subject.estimate_outcome import Estimate, NuisanceRecord
from spinestiff.subject.run_record import read_outcome, write_outcome


def rows_of(path):
    return list(csv.reader(path.read_text().splitlines()))


def test_draws_are_rows_of_the_posterior_from_one_end_to_the_other(finished):
    visit = open_visit(finished.folder)
    found = drawn_ratios(visit, 3).ratios
    header, *rows = rows_of(finished.folder / "results" / "posterior.csv")
    estimate = read_outcome(visit.subject, Estimate)
    assert list(found) == [ESTIMATE, "draw-001", "draw-002", "draw-003"]
    volume = next(one for one in estimate.nuisances if one.name == "tissue's volume")
    assert found[ESTIMATE]["lateral_bending"] == estimate.values["lateral_bending"]
    assert found[ESTIMATE]["tissue_lambda"] == pytest.approx(np.exp(volume.value))
    for name, row in (("draw-001", rows[0]), ("draw-003", rows[-1])):
        told = {key: float(value) for key, value in zip(header, row)}
        assert found[name]["lateral_bending"] == pytest.approx(told["lateral_bending"])
        assert found[name]["tissue_lambda"] == pytest.approx(np.exp(volume.prior_sd * told["tissue's volume"]))
    assert list(drawn_ratios(visit, 0).ratios) == [ESTIMATE]


def test_what_the_fit_found_beside_the_ratios_is_in_the_files(monkeypatch, tmp_path):
    """The ribs' turning on their vertebrae, and the tissue's resistance to a change of volume at its stiffness."""

    def nuisance(name, standard, prior):
        given = {"name": name, "group": name, "unit": "", "value": prior * standard, "sd": 0.5, "prior_sd": prior}
        return NuisanceRecord(**given, standard=standard)

    beside = (
        nuisance("rib joints", -0.8, 1.5),
        nuisance("trunk breadth", 0.1, 0.07),
        nuisance("tissue's volume", 0.5, 1.0),
    )
    estimate = SimpleNamespace(
        values={"lateral_bending": 0.2, "tissue": 0.05}, parameters=("lateral_bending", "tissue"), nuisances=beside,
        method="weighed",
    )  # fmt: skip
    (tmp_path / "posterior.csv").write_text(
        "lateral_bending,tissue,rib joints,trunk breadth,tissue's volume\n0.3,0.04,-1,2,0\n0.1,0.06,1,-2,-1\n"
    )
    monkeypatch.setattr(drawn, "refuse_changed", lambda *steps: None)
    monkeypatch.setattr(drawn, "read_outcome", lambda subject, kind: estimate)
    monkeypatch.setattr(drawn, "result_path", lambda subject, name, step: tmp_path / name)
    torso = template_torso(157.0)
    found = drawn_ratios(SimpleNamespace(subject=None, torso=lambda: torso), 2)
    wanted = {
        ESTIMATE: (0.2, 0.05 * np.exp(-0.5 * LAMBDA_SHARE), np.exp(-1.2), np.exp(0.5)),
        "draw-001": (0.3, 0.04, np.exp(-1.5), 1.0),
        "draw-002": (0.1, 0.06 * np.exp(LAMBDA_SHARE), np.exp(1.5), np.exp(-1.0)),
    }
    export_drawn(found, tmp_path / "out", "osim", lambda line: None)
    header, *rows = rows_of(tmp_path / "out" / TABLE)
    assert header[1:5] == ["lateral_bending", "tissue", "rib_rotation", "tissue_lambda"]
    for row in rows:
        name = row[0].removesuffix(".osim")
        assert list(found.ratios[name].values()) == pytest.approx(wanted[name])
        assert [float(value) for value in row[1:5]] == pytest.approx(wanted[name], rel=1e-5)
        text = (tmp_path / "out" / row[0]).read_text()
        first = re.findall(r"<rotational_stiffness>([^<]*)<", text)[torso.joints.names.index("T5-R5_L")]
        assert float(first.split()[0]) == pytest.approx(9.7 * wanted[name][2])


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
    found = drawn_ratios(open_visit(finished.folder), 2)
    lines: list[str] = []
    export_drawn(found, tmp_path / "out", "osim", lines.append)
    header, *rows = rows_of(tmp_path / "out" / TABLE)
    assert [row[0] for row in rows] == ["estimate.osim", "draw-001.osim", "draw-002.osim"]
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == sorted([TABLE, *(row[0] for row in rows)])
    joints = found.torso.joints
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
    found = drawn_ratios(open_visit(finished.folder), 1)
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "mine.txt").write_text("")
    with pytest.raises(TorsoError, match="out: exists and is no empty folder"):
        export_drawn(found, tmp_path / "out", "osim", lambda line: None)
    assert [path.name for path in tmp_path.iterdir()] == ["out"]
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["mine.txt"]


@pytest.mark.parametrize("kind", ["vtu", "glb", "mrk", "stl"])
def test_a_format_without_stiffness_is_refused(kind):
    with pytest.raises(TorsoError, match="no stiffness to draw; formats with stiffness are osim, mjcf, feb"):
        check_format(kind)
