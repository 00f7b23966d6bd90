"""The report's pictures as figures: each is drawn of a finished subject, and what there is not is refused."""

from __future__ import annotations

import ast
import inspect
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

import spinestiff as ss
from spinestiff import plot
from spinestiff.errors import SubjectError
from spinestiff.study.visit import open_visit

OF_A_VISIT = ("rest", "force_and_curve", "tilt_by_level", "joint_region", "profiles", "variance_budget", "supports")
NOT_YET = {"sensitivity": "sensitivity", "plan": "plan"}
OF_OTHERS = ("torso", "skin_scan", "problem", "equilibrium", "fit", "cobb", "held_out", "first_page")
ELSEWHERE = ("views_and_markers",)  # tests/study/report/test_beside.py, with a push that has both


def test_every_picture_is_looked_at_here() -> None:
    drawn = {name for name, one in vars(plot).items() if inspect.isfunction(one) and one.__module__ == plot.__name__}
    assert {name for name in drawn if name[0] != "_"} == {*OF_A_VISIT, *NOT_YET, *OF_OTHERS, *ELSEWHERE}
    tree = ast.parse(Path(plot.__file__).read_text(encoding="utf-8"))
    assert all(
        "Figure" in ast.unparse(one.returns) for one in tree.body if hasattr(one, "returns") and one.name[0] != "_"
    )
    assert ss.plot is plot


def seen(figure: object) -> Figure:
    assert isinstance(figure, Figure)
    assert figure.axes and any(axis.has_data() for axis in figure.axes)
    figure.draw_without_rendering()
    return figure


def test_pictures_of_a_finished_visit(finished) -> None:
    visit = open_visit(finished.folder)
    for name in OF_A_VISIT:
        seen(getattr(plot, name)(visit))
    assert [len(seen(figure).axes) for figure in plot.held_out(visit)] == [3, 3]
    # At rest, pushed and predicted: the measured corners beside the simulated ones in the last alone.
    outlines = [len(seen(figure).axes[0].patches) + len(figure.axes[0].lines) for figure in plot.first_page(visit)]
    assert len(outlines) == 3 and outlines[2] > outlines[1]
    assert plot.views_and_markers(visit) == ()
    seen(plot.rest(visit, "lateral"))
    seen(plot.torso(visit.torso()))
    seen(plot.skin_scan(visit.torso(), np.array([[0.0, 100.0, 80.0], [50.0, 200.0, -60.0]])))
    seen(plot.fit(finished.fit))
    seen(plot.equilibrium(finished.fit.equilibria[0]))
    seen(plot.problem(ss.EquilibriumProblem(visit.torso(), ss.three_point_supports(visit.torso(), "right"))))
    for name, verb in NOT_YET.items():
        with pytest.raises(SubjectError, match=rf"no such file; run the step that makes it first \(spinestiff {verb}"):
            getattr(plot, name)(visit)
    with pytest.raises(SubjectError, match="no rest radiograph 'oblique'; there are frontal, lateral"):
        plot.rest(visit, "oblique")


def test_picture_of_cobb_readings(finished) -> None:
    from spinestiff.curves.pushes import rest_reading

    seen(plot.cobb([rest_reading(ss.read_subject(finished.folder))]))


def test_pushes_without_vertebrae_in_common_are_told_in_one_line(monkeypatch) -> None:
    monkeypatch.setattr("spinestiff.study.steps.stored_predictions", lambda visit: None)
    monkeypatch.setattr("spinestiff.study.report.pictures.tilt_picture", lambda visit, predictions: None)
    with pytest.raises(SubjectError, match="no push shows two vertebrae in two frames"):
        plot.tilt_by_level(None)
