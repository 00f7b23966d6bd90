"""``spinestiff parameters`` and ``spinestiff sensitivity``: what they print and write, and what they refuse."""

from __future__ import annotations

import json

import cv2
import pytest

from spinestiff.files import read_json
from spinestiff.study import steps
from spinestiff.study.sensitivity import force_percent
from spinestiff.subject.run_record import write_outcome
from spinestiff.subject.sensitivity_outcome import Refit, Sensitivity
from studied import NAMES, STUDY


def refit(series, what, by, *percent, names=NAMES):
    found = dict(zip(names, percent))
    return Refit(
        series=series, what=what, by=by, ratios=dict.fromkeys(names, 0.1), percent=found, stiffness_percent=found
    )


REFITS = (
    refit("weighed", "nothing", "", 0.0, 0.0),
    refit("weighed", "force", "−10 %", -9.2, -12.4),
    refit("weighed", "force", "+10 %", 9.0, 12.7),
    refit("weighed", "corners", "covariance", -9.25, 7.4),
    refit("everything", "force", "−10 %", -10.0, names=("everything",)),
    refit("everything", "force", "+10 %", 10.0, names=("everything",)),
)
SENSITIVITY = Sensitivity(
    basis="", mesh="coarse", parameters=NAMES, estimate=dict.fromkeys(NAMES, 0.1), interval95=dict.fromkeys(NAMES),
    refits=REFITS, force_percent=force_percent(REFITS), complete=True,
)  # fmt: skip


@pytest.fixture
def studied(monkeypatch):
    """The steps find the results above; gives the meshes that they were asked for."""
    asked = []

    def found(visit, say):
        asked.append(visit.settings.mesh)
        write_outcome(visit.subject, SENSITIVITY)
        return SENSITIVITY

    monkeypatch.setattr(steps, "sensitivity_study", found)
    monkeypatch.setattr(steps, "parameter_study", lambda visit, say: asked.append(visit.settings.mesh) or STUDY)
    return asked


def test_sensitivity_is_printed_written_and_drawn_once(spinestiff, subject, studied):
    ran = spinestiff("sensitivity", subject)
    assert ran.status == 0, ran.err
    assert studied == ["coarse"]
    lines = ran.out.splitlines()
    assert any("force ±10 %" in line and "−9.2" in line and "−12.4" in line for line in lines)
    assert any("corners' orientation" in line and "covariance" in line and "+7.4" in line for line in lines)
    assert any("weighed, the estimate's ratios" in line and "9.1" in line and "12.6" in line for line in lines)
    assert any("Koutras et al. 2025" in line and "7.6" in line and "28.6" in line for line in lines)
    assert "10 % of force is 10.0 % of stiffness" in ran.out
    assert ran.out.splitlines()[-1] == f"picture: {subject / 'results/sensitivity.png'}"
    assert cv2.imread(str(subject / "results/sensitivity.png")).shape[1] > 800
    ran = spinestiff("sensitivity", subject, "--json")
    assert [line.split(maxsplit=2)[2] for line in ran.lines] == ["sensitivity: up to date"]
    assert json.loads(ran.out) == read_json(subject / "results/sensitivity.json")
    assert studied == ["coarse"]
    assert spinestiff("sensitivity", subject, "--redo", "--mesh", "fine").status == 0
    assert studied == ["coarse", "fine"]


def test_parameters_are_printed_and_written(spinestiff, subject, studied):
    ran = spinestiff("parameters", subject)
    assert ran.status == 0, ran.err
    lines = ran.out.splitlines()
    assert any("lateral translation k_v,x" in line and "0.12" in line and "6.0" in line for line in lines)
    assert any("Lamé's μ" in line and "16.00" in line and "797.4" in line for line in lines)
    assert any(line.startswith("lateral ") and "0.010, 0.020, 0.030" in line for line in lines)
    assert "training frames left out: 1.00 mm as estimated, 0.99 mm with lambda on its own (−1.0 %)" in lines
    ran = spinestiff("parameters", subject, "--json")
    assert [line.split(maxsplit=2)[2] for line in ran.lines] == ["parameters: up to date"]
    assert json.loads(ran.out) == read_json(subject / "results/parameters.json")
    assert studied == ["coarse"]


@pytest.mark.parametrize("verb", ["parameters", "sensitivity"])
def test_what_can_not_be_refitted_ends_in_one_line(spinestiff, subject, verb):
    ran = spinestiff(verb, subject, "--mesh", "finest")
    assert (ran.status, ran.lines) == (2, ["spinestiff: unknown mesh 'finest'; wanted one of coarse, fine"])
    ran = spinestiff(verb, subject, "--mesh", "fine")
    assert ran.status == 2
    assert "was shaped on the coarse mesh alone" in ran.lines[-1]
    content = read_json(subject / "subject.json")
    content["pushes"][0]["forces_n"][1] += 1.0
    (subject / "subject.json").write_text(json.dumps(content))
    ran = spinestiff(verb, subject)
    assert ran.status == 2
    assert "was made before subject.json: pushes changed" in ran.lines[-1]
    assert not (subject / "results" / f"{verb}.json").exists()
