"""What a notebook shows of this package's objects, and what its loggers say."""

from __future__ import annotations

import base64
import logging
import re
import warnings
from dataclasses import fields, replace

import cv2
import numpy as np
import pytest

import spinestiff as ss
from spinestiff.errors import OutsideWarning
from spinestiff.estimation.fitted import StiffnessFit
from spinestiff.estimation.status import FitStatus
from spinestiff.mechanics.push import PushSite, Rig, push_load
from spinestiff.shown import as_html

PNG = re.compile(r'src="data:image/png;base64,([^"]+)"')


@pytest.fixture(scope="module")
def torso():
    return ss.template_torso(157.0, "coarse")


@pytest.fixture(scope="module")
def problem(torso):
    return ss.EquilibriumProblem(torso, ss.three_point_supports(torso, "right"))


def picture(html):
    (found,) = PNG.findall(html)
    image = cv2.imdecode(np.frombuffer(base64.b64decode(found), np.uint8), cv2.IMREAD_COLOR)
    assert image.std() > 5.0, "an empty picture"
    return image


def test_a_torso_a_problem_and_an_equilibrium_are_a_picture_beside_a_table(torso, problem):
    found = problem.solve(ss.rib_push(torso, "right", 8.0, 20.0))
    for thing, words in ((torso, "157 cm"), (problem, "unknowns"), (found, "CONVERGED")):
        html = thing._repr_html_()
        assert words in html and html.count("<table>") == html.count("</table>") == 1
        high, wide, _ = picture(html).shape
        assert 150 < wide < high < 400
        assert len(html) < 150_000
        assert "\n" not in repr(thing) and len(repr(thing)) <= 160
    shoulder = found.reaction("shoulder")
    assert f'shoulder exerts</td><td style="text-align:left">{shoulder[0]:.1f}, ' in found._repr_html_()


def test_a_fit_is_its_ratios_with_intervals():
    ratios = ss.stiffness_ratios({"lateral_bending": 0.1, "tissue": 0.05})
    given = dict.fromkeys(field.name for field in fields(StiffnessFit))
    intervals = {"lateral_bending": (0.05, 0.2), "tissue": (float("nan"), float("nan"))}
    given |= {"ratios": ratios, "status": FitStatus.CONVERGED, "intervals95": intervals, "bounds": (0.005, 5.0)}
    given |= {"at_bound": {"lateral_bending": False, "tissue": True}, "rmse_mm": 0.5, "default_rmse_mm": 8.0}
    html = StiffnessFit(**{**given, "warnings": ("<doubtful>",)})._repr_html_()
    assert "0.1, 95 % 0.05 to 0.2" in html and "0.05, at its bound" in html and "&lt;doubtful&gt;" in html
    picture(html)


def test_a_torso_without_surfaces_is_shown_as_well(torso):
    picture(replace(torso, bone_surfaces=())._repr_html_())


def test_what_is_shown_is_no_markup():
    assert "<script>" not in as_html("<script>", [("<script>", "<script>")])


def test_a_push_far_outside_warns_once_where_it_is_asked_for(torso):
    with pytest.warns(OutsideWarning, match=r"^a push of 120 N: the model was made for up to 114 N") as caught:
        ss.rib_push(torso, "right", 8.0, 120.0)
    assert [one.filename for one in caught] == [__file__]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        ss.rib_push(torso, "right", 8.0, 114.0)
        # A subject's own forces are told by its folder.
        push_load(torso, PushSite("right", 8.0, 400.0, 200.0), 120.0, Rig("level", "bilateral"))


def test_the_package_is_silent_until_it_is_asked(torso, problem, caplog):
    assert [type(one) for one in logging.getLogger("spinestiff").handlers] == [logging.NullHandler]
    load = ss.rib_push(torso, "right", 8.0, 20.0)
    with caplog.at_level(logging.INFO, "spinestiff"):
        problem.solve(load)
    assert caplog.records == []
    with caplog.at_level(logging.DEBUG, "spinestiff"):
        problem.solve(load)
    (record,) = caplog.records
    assert record.name == "spinestiff.mechanics.equilibrium"
    assert re.match(r"CONVERGED after \d+ iterations and \d+ factorisations, residual ", record.getMessage())
