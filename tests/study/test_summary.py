"""Results as CSV: the numbers of their JSON, by name."""

from __future__ import annotations

import csv

import pytest

from spinestiff.files import read_json
from spinestiff.study.summary import assessment_csv, estimate_csv, response_csv
from spinestiff.subject.assessment_outcome import Assessment, ForecastRecord, HeldOutFrame
from spinestiff.subject.estimate_outcome import Estimate
from spinestiff.subject.outcomes import PushResponse, Responses
from study_outcomes import change as change_of


def rows(path):
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def number(text):
    return None if text == "" else float(text)


def test_the_response_s_csv_has_its_numbers(finished):
    results = finished.folder / "results"
    pushes, told = read_json(results / "response.json")["pushes"], rows(results / "response.csv")
    assert [(row["push"], row["quantity"]) for row in told] == [
        (push, quantity) for push in pushes for quantity in ("curve", "tilt", "flexibility")
    ]
    for row in told:
        one = pushes[row["push"]][row["quantity"]]
        ends = one.get("n_per_degree", one)
        assert [number(row["value"]), number(row["low95"]), number(row["high95"])] == pytest.approx(
            [ends.get("value", ends.get("percent")), ends["low"], ends["high"]]
        )
        assert row["unit"] == ("%" if row["quantity"] == "flexibility" else "N/degree")
        if "levels" in one:
            assert [row["upper_level"], row["lower_level"]] == one["levels"]
            assert number(row["change_deg"]) == one["change_deg"]
            assert number(row["change_half_width95_deg"]) == pytest.approx(1.96 * one["change_sd_deg"])


def test_a_push_without_numbers_says_why_in_its_row():
    missing = PushResponse(force_n=40.0, missing="no usable frame without force")
    text = response_csv(Responses(gauge_scale_sd=0.02, gauge_zero_sd_n=1.0, pushes={"main": missing}))
    (row,) = csv.DictReader(text.splitlines())
    assert (row["push"], row["force_n"], row["quantity"]) == ("main", "40.0", "")
    assert row["missing"] == "no usable frame without force"


def test_a_curve_between_other_end_vertebrae_says_so_in_its_row(finished):
    found = Responses.model_validate_json((finished.folder / "results/response.json").read_text())
    push, one = next(iter(found.pushes.items()))
    text = response_csv(
        found.model_copy(update={"pushes": {push: one.model_copy(update={"instead_of": ("T3", "L4")})}})
    )
    told = {row["quantity"]: row["instead_of"] for row in csv.DictReader(text.splitlines())}
    assert told == {"curve": "T3-L4", "tilt": "", "flexibility": ""}


def test_the_estimate_s_csv_has_its_numbers(finished):
    results = finished.folder / "results"
    found, told = read_json(results / "estimate.json"), rows(results / "estimate.csv")
    assert sorted(row["quantity"] for row in told) == sorted([*found["plain"], *found["ratios"]])
    for row in told:
        one = {**found["plain"], **found["ratios"]}[row["quantity"]]
        assert [number(row[key]) for key in ("value", "low95", "high95")] == [one[k] for k in ("value", "low", "high")]
        assert (row["open_low"], row["open_high"]) == tuple(
            "yes" if one[k] else "no" for k in ("open_low", "open_high")
        )
        ratio = one if "determined" in one else found["ratios"][one["ratio"]]
        known = "doubtful" if found["status"] == "DOUBTFUL" else ratio["determined"]
        assert (row["unit"], row["determined"]) == (one.get("unit", ""), known)
        assert row["at_bound"] == ("yes" if ratio["at_bound"] else "no")
        assert row["status"] == found["status"]


def test_a_doubtful_estimate_is_determined_in_no_row(finished):
    found = Estimate.model_validate_json((finished.folder / "results/estimate.json").read_text())
    ratios = {name: one.model_copy(update={"determined": "determined"}) for name, one in found.ratios.items()}
    plain = {**found.plain, "tissue_young": found.plain["tissue_young"].model_copy(update={"ratio": None, "low": None})}
    for status, known in (("CONVERGED", "determined"), ("DOUBTFUL", "doubtful")):
        text = estimate_csv(found.model_copy(update={"status": status, "ratios": ratios, "plain": plain}))
        told = {row["quantity"]: row["determined"] for row in csv.DictReader(text.splitlines())}
        # A stiffness that was not estimated is known to no degree.
        assert told.pop("tissue_young") == ""
        assert set(told.values()) == {known} and {"tissue", "lateral_bending_lumbar"} <= set(told)


def test_a_forecast_s_half_width_is_that_between_fixed_levels():
    errors = dict.fromkeys(("rest", "default", "fit", "forecast"), 1.0)
    changes = {name: change_of(-10.0) for name in ("measured", "fit", "forecast")}
    spread = ForecastRecord(rmse_mm=1.0, sd_mm=1.0, inside95=0.9, cobb_error_deg=0.5, cobb_sd_deg=0.75)
    frame = HeldOutFrame(push="main", frame=1, force_n=60.0, rmse_mm=errors, cobb_change_deg=changes, forecast=spread)
    (row,) = csv.DictReader(assessment_csv(Assessment(frames=(frame,))).splitlines())
    widths = {name: text for name, text in row.items() if "half_width95" in name and text}
    assert widths.keys() == {"fixed_levels_change_half_width95_deg_forecast"}
    assert number(*widths.values()) == pytest.approx(1.96 * 0.75)


def test_the_assessment_s_csv_has_its_numbers(finished):
    results = finished.folder / "results"
    frames, told = read_json(results / "assessment.json")["frames"], rows(results / "assessment.csv")
    assert len(told) == len(frames) == 2
    for row, frame in zip(told, frames):
        assert (row["push"], int(row["frame"]), float(row["force_n"])) == (
            frame["push"],
            frame["frame"],
            frame["force_n"],
        )
        for name, error in frame["rmse_mm"].items():
            assert number(row[f"rmse_mm_{name}"]) == error
        for name, change in frame["cobb_change_deg"].items():
            for k, (form, of) in enumerate(
                (("signed", "signed_levels"), ("fixed_levels", "levels"), ("tilt", "tilt_levels"))
            ):
                shown, width = (number(row[f"{form}_change_{what}_{name}"]) for what in ("deg", "half_width95_deg"))
                assert shown == (None if change is None else pytest.approx(change[form]))
                sds = (None if change is None else change["sds"]) or [None] * 3
                if name == "forecast" and form == "fixed_levels":
                    sds[k] = frame["forecast"]["cobb_sd_deg"]
                assert width == (None if sds[k] is None else pytest.approx(1.96 * sds[k]))
                levels = "" if change is None else change[of]
                assert row[f"{form}_change_of_{name}"] == (levels if isinstance(levels, str) else "–".join(levels))
        assert number(row["tilt_change_half_width95_deg_measured"]) > 0.0
