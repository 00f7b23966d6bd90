"""Tables and JSON that commands print."""

from __future__ import annotations

import json

import pytest

from spinestiff import __version__
from spinestiff.app import tables
from spinestiff.mechanics.factor import default_backend
from spinestiff.subject.outcomes import Estimate, HeldOutFrame, PlainStiffness, RatioEstimate
from spinestiff.verification.outcome import Check

NAN = float("nan")
RATIOS = {
    "lateral_bending": RatioEstimate.of(0.10234, (0.0952, 0.1101), (False, False), False),
    "tissue": RatioEstimate.of(0.005, (0.005, 0.0123), (True, False), True),
}
LEVEL = {**RATIOS["lateral_bending"].scaled(120.0).model_dump(), "unit": "N m/rad", "ratio": "lateral_bending"}
NONE = {"value": 3.2154, "low": None, "high": None, "unit": "kPa", "ratio": None}
CHANGE = {"signed": -5.0, "fixed_levels": -5.1, "tilt": -7.04, "levels": ("T5", "T9"), "tilt_levels": ("T6", "L1")}
ASSESSMENT = {
    "push": "main",
    "frame": 6,
    "force_n": 60.0,
    "rmse_mm": {
        "forecast": 0.7,
        "rest": 9.0,
        "default": 7.126,
        "fit": 1.234,
        "fitted_supports": 0.5,
        "extrapolation": None,
        "single_ratio": 2.0,
        "truth": None,
    },
    "cobb_change_deg": {"measured": CHANGE, "fit": None},
}


@pytest.fixture
def printed(capsys):
    def show(table):
        tables.show(table)
        return capsys.readouterr().out

    return show


def row_of(text, start):
    (line,) = [line for line in text.splitlines() if line.strip("│┃ ").startswith(start)]
    return [cell.strip() for cell in line.strip("│").split("│")]


def estimate(**changed):
    plain = {
        "lateral_bending_thoracic": PlainStiffness.model_validate(LEVEL),
        "lateral_bending_lumbar": PlainStiffness.model_validate(LEVEL),
        "tissue_young": PlainStiffness.model_validate(NONE),
    }
    given = {"status": "CONVERGED", "determined": "weakly determined", "parameters": tuple(RATIOS), "ratios": RATIOS}
    return Estimate.model_construct(**{"method": "weighed", **given, "plain": plain, **changed})


def test_estimate(printed):
    """Digits as the interval leaves them, open ends as such, and how far each is determined."""
    text = printed(tables.estimate_table(estimate()))
    assert "Estimate: weakly determined" in text
    cells = ["ratio: lateral_bending", "0.102", "0.095 to 0.11", "determined", "no"]
    assert row_of(text, "ratio: lateral_bending") == cells
    assert row_of(text, "ratio: tissue") == ["ratio: tissue", "≤ 0.005", "≤ 0.005 to 0.012", "weakly determined", "yes"]
    assert row_of(text, "lateral bending of a thoracic level")[1:3] == ["12.3 N m/rad", "11 to 13 N m/rad"]
    assert row_of(text, "Young's modulus")[1:3] == ["3.2 kPa", ""]
    assert text.index("thoracic level") < text.index("ratio: ")  # plain units come first


def test_a_doubtful_estimate_says_so_above_its_numbers(printed):
    text = printed(tables.estimate_table(estimate().model_copy(update={"status": "DOUBTFUL"})))
    assert text.index("Estimate: doubtful") < text.index("lateral_bending")


def test_the_paper_s_estimate_says_that_it_has_no_intervals(printed):
    ratios = {name: RatioEstimate.of(one.value, (NAN, NAN), (False, False), False) for name, one in RATIOS.items()}
    text = printed(tables.estimate_table(estimate(method="paper", ratios=ratios, determined="not determined")))
    assert "Estimate: no intervals" in text and "determined" not in text
    assert row_of(text, "ratio: lateral_bending")[1:4] == ["0.10", "not available", "no intervals"]


def test_assessment(printed):
    text = printed(tables.assessment_table([HeldOutFrame.model_validate(ASSESSMENT)]))
    assert row_of(text, "main 6") == [
        "main 6",
        "60",
        "9.00",
        "7.13",
        "1.23",
        *["0.70", "0.50", "-", "2.00", "-"],
        "-7.0",
        "-",
    ]


def test_cobb(printed):
    text = printed(tables.cobb_table([("main [1]", "+12.0 deg (T5-L1)", "-1.0", "-2.0", "-3.0")]))
    assert row_of(text, "main [1]") == ["main [1]", "+12.0 deg (T5-L1)", "-1.0", "-2.0", "-3.0"]


def test_checks(printed):
    checks = [Check("energy [a]", "independent", 1e-12, 1e-9, True), Check("b", "independent", 2.0, 1e-9, False)]
    text = printed(tables.check_table(checks))
    assert "1 of 2 independent checks passed" in text
    assert row_of(text, "energy [a]") == ["energy [a]", "independent", "1.0e-12", "1e-09", "passed"]
    assert row_of(text, "b")[-1] == "FAILED"


@pytest.mark.parametrize(("error", "shown"), [(0.5, 0.5), (float("inf"), "inf"), (float("nan"), "nan")])
def test_a_check_as_json(capsys, error, shown):
    record = tables.check_record(Check("a", "independent", error, 1e-9, False))
    assert record == {"name": "a", "kind": "independent", "error": shown, "tolerance": 1e-9, "passed": False}
    tables.show_json([record])
    assert json.loads(capsys.readouterr().out) == [record]


def test_doctor(printed, monkeypatch):
    text = printed(tables.doctor_table())
    assert row_of(text, "spinestiff")[1] == __version__ if text.count("spinestiff") == 1 else __version__ in text
    assert row_of(text, "sparse solver in use")[1] == default_backend()
    assert "nodes" in row_of(text, "template mesh 'coarse'")[1]
    for name in tables.LIBRARIES:
        assert row_of(text, f"{name} ")[1]
    monkeypatch.setattr(tables, "_installed", lambda name: None)
    bare = printed(tables.doctor_table())
    assert bare.count("MISSING: pip install it") == len(tables.LIBRARIES)
    assert "not installed; needed for JPEG Lossless radiographs (extra [dicom])" in bare


def test_names_from_files_are_no_markup(printed):
    record = HeldOutFrame.model_validate({**ASSESSMENT, "push": "[red]x[/red]"})
    assert "[red]x[/red] 6" in printed(tables.assessment_table([record]))
