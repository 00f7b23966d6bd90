"""The steps: what they write, when they are redone, and what a failing one leaves."""

from __future__ import annotations

import os
from dataclasses import replace

import numpy as np
import pydicom
import pytest
from spinestiff.study.pipeline import STEPS, run_steps

from spinestiff.anatomy.files import read_torso
from spinestiff.anatomy.names import VERTEBRAE
from spinestiff.errors import EquilibriumError, FitError, RadiographError, SubjectError
from spinestiff.estimation.fit import FitStatus
from spinestiff.files import file_digest, read_json, write_json
from spinestiff.study import pipeline
from spinestiff.study.visit import Settings, load_pushes, load_tracked, open_visit
from spinestiff.subject.run_record import package_version

UP_TO_DATE = [f"{step}: up to date" for step in STEPS]


def digests(folder):
    return {p.relative_to(folder).as_posix(): file_digest(p) for p in sorted(folder.rglob("*")) if p.is_file()}


def truth_of(subject):
    return subject.with_name("girl.truth.json")


def opened(subject, **settings):
    return open_visit(subject, Settings(**settings), truth_of(subject))


def annotate_anew(subject):
    path = subject / "annotation.json"
    content = read_json(path)
    content["images"]["push/main"]["vertebrae"]["T7"][0][0] += 0.25
    write_json(path, content)


@pytest.fixture
def dry(monkeypatch):
    """Steps that only leave a new mark on what they write."""
    marks = []

    def write(*names):
        def step(visit, say):
            marks.append(names)
            for name in names:
                visit.file(name).write_text(f"{len(marks)}")

        return step

    made = {
        "track": write("tracked.json"),
        "personalise": write("torso.npz", "personalised.json"),
        "estimate": write("estimate.json"),
        "assess": write("assessment.json"),
        "report": write("report.html", "view.html"),
        "view": write("view.html"),
    }
    monkeypatch.setattr(pipeline, "_FUNCTIONS", made)


# What is written


def test_the_record_of_a_run(finished):
    run = read_json(finished.folder / "results" / "run.json")
    assert run["version"] == package_version()
    # The report writes the view as well.
    assert set(run["steps"]) == {*STEPS, "view"}
    images = {"pushes/main.dcm", "pushes/second.dcm", "rest/frontal.dcm", "rest/lateral.dcm"}
    assert set(run["steps"]["track"]["inputs"]) == {"subject.json", "annotation.json", *images}
    assert set(run["steps"]["assess"]["inputs"]) >= {"results/estimate.json", "results/torso.npz", "annotation.json"}
    for record in run["steps"].values():
        assert record["seconds"] >= 0.0
        for name, digest in {**record["inputs"], **record["outputs"]}.items():
            assert digest == file_digest(finished.folder / name), name
    assert run["steps"]["estimate"]["seconds"] > 0.1
    assert run["steps"]["personalise"]["settings"] == {"mesh": "coarse"}
    assert run["steps"]["estimate"]["settings"]["method"] == "lm"
    assert run["steps"]["estimate"]["settings"]["parameters"] == ["lateral_bending", "tissue"]
    assert run["steps"]["assess"]["settings"] == {"truth": file_digest(finished.truth)}


def test_tracked_corners_are_where_the_truth_is(finished):
    truth = read_json(finished.truth)["pushes"]["main"]
    push = load_tracked(open_visit(finished.folder))["main"]
    assert len(push.frames) == 4
    for frame, true in zip(push.frames, truth):
        assert frame.dropped == ""
        rows = [VERTEBRAE.index(v) for v in frame.corners.vertebrae]
        wanted = push.view.to_patient_plane(push.view.from_pixels(np.array(true["corners_px"])[rows]))
        error = push.view.to_patient_plane(frame.corners.corners) - wanted
        good = frame.corners.quality > 0.3
        assert good.mean() > 0.8
        # 0.3 mm of annotation in each direction, and the tracking's own.
        assert np.sqrt(np.mean(np.sum(error**2, -1)[good])) < 1.0


def test_the_personalised_torso(finished):
    record = read_json(finished.folder / "results" / "personalised.json")
    assert max(record["rmse_mm"].values()) < 0.6
    assert set(record["poses"]) == set(record["views"]) == set(record["millimetres"]) == {"frontal", "lateral"}
    shown = {v for seen in record["vertebra_rmse_mm"].values() for v in seen}
    assert record["prior_only"] == [v for v in VERTEBRAE if v not in shown]
    for name, fits in record["vertebra_fit"].items():
        assert {v: fit["rmse_mm"] for v, fit in fits.items()} == record["vertebra_rmse_mm"][name]
        assert all(fit["angle_deg"] < 5.0 and fit["wrong_corners"] == 0 for fit in fits.values())
    # The annotation's 0.3 mm, and what a sized box does not show of a box of another shape.
    assert 0.2 < record["corner_sd_mm"] < 0.45
    assert record["length_scale"] == pytest.approx(1.0, abs=0.02)
    assert np.array(record["covariance"]["blocks"]).shape == (17, 6, 6)
    assert record["mesh"]["smallest_j"] > 0.2
    assert record["mesh"]["path"] == "kept"
    assert (record["warnings"] == []) == (record["prior_only"] == [])
    assert read_torso(finished.folder / "results" / "torso.npz").height_cm == pytest.approx(157.0)


def test_the_estimate(finished):
    record, fit = read_json(finished.folder / "results" / "estimate.json"), finished.fit
    assert record["schema_version"] == 1
    assert record["status"] == fit.status.name
    assert record["status_text"] == fit.status.value
    assert list(record["ratios"]) == ["lateral_bending", "tissue"]
    for name, entry in record["ratios"].items():
        low, high = entry["interval95"]
        assert low < entry["value"] == fit.ratios.as_dict()[name] < high
        assert (low, high) == fit.intervals95[name]
        assert entry["at_bound"] is False
    assert record["correlation"] == pytest.approx(fit.correlation[0, 1])
    assert -1.0 <= record["correlation"] <= 1.0
    assert record["condition"] == fit.condition >= 1.0
    assert record["training_rmse_mm"] == {"default": fit.default_rmse_mm, "fit": fit.rmse_mm}
    assert fit.rmse_mm < 0.6 * fit.default_rmse_mm
    assert set(record["cost"]) == {"equilibria", "newton_iterations", "factorisations", "seconds"}
    assert all(value > 0 for value in record["cost"].values())
    assert len(record["history"]) == len(fit.history)
    assert np.array(record["covariance_log"]) == pytest.approx(fit.uncertainty.covariance)
    assert len(record["joint_region"]) == 100


def test_the_reactions_balance_the_push(finished):
    """Three points in the frontal plane: shoulder and pelvis carry the push, split as the simple beam says."""
    reactions = read_json(finished.folder / "results" / "estimate.json")["reactions_n"]
    assert reactions["push"] == "push 'main' frame 2"
    assert reactions["f3"] == 22.5
    assert reactions["eq2_shoulder"] + reactions["eq1_pelvis"] == pytest.approx(22.5)
    push = open_visit(finished.folder).subject.push("main")
    assert reactions["eq1_pelvis"] == pytest.approx(22.5 * push.d31_mm / push.d21_mm)
    assert reactions["shoulder"] + reactions["pelvis"] == pytest.approx(22.5, rel=0.05)
    assert reactions["shoulder"] == pytest.approx(reactions["eq2_shoulder"], rel=0.35)


def test_every_step_says_what_it_does(finished):
    assert "track: push 'main', frame 4 of 4" in finished.lines
    assert any(line.startswith("personalise: corner sd 16.00 mm") for line in finished.lines)
    first = "estimate: evaluation 0: lateral_bending 0.07, tissue 0.04: RMSE"
    assert any(line.startswith(first) for line in finished.lines)
    assert {line.partition(":")[0] for line in finished.lines} == set(STEPS)


# When they are redone


def test_nothing_changed_nothing_is_redone(subject, dry):
    before = digests(subject)
    for path in subject.rglob("*"):
        os.utime(path)  # younger files with the same content are no change
    lines = []
    assert run_steps(opened(subject), observer=lines.append) == []
    assert lines == UP_TO_DATE
    assert digests(subject) == before


def test_a_new_annotation_has_tracking_and_what_follows_redone(subject, dry):
    annotate_anew(subject)
    assert run_steps(opened(subject)) == list(STEPS)
    lines = []
    assert run_steps(opened(subject), observer=lines.append) == []
    assert lines == UP_TO_DATE


def test_a_setting_has_its_step_and_what_follows_redone(subject, dry):
    assert run_steps(opened(subject, method="lbfgsb")) == ["estimate", "assess", "report"]
    assert run_steps(opened(subject, method="lbfgsb", orientation="covariance")) == ["estimate", "assess", "report"]
    assert run_steps(opened(subject, mesh="fine")) == ["personalise", "estimate", "assess", "report"]


def test_another_truth_touches_the_comparison_only(subject, dry):
    assert run_steps(open_visit(subject)) == ["assess", "report"]


@pytest.mark.parametrize(
    ("name", "redone"),
    [
        ("tracked.json", ["track", "estimate", "assess", "report"]),
        ("torso.npz", ["personalise", "estimate", "assess", "report"]),
        ("assessment.json", ["assess", "report"]),
        ("report.html", ["report"]),
        ("view.html", ["report"]),
    ],
)
@pytest.mark.parametrize("how", ["deleted", "damaged"])
def test_a_lost_or_damaged_result_is_made_again(subject, dry, name, redone, how):
    path = subject / "results" / name
    path.unlink() if how == "deleted" else path.write_text("?")
    assert run_steps(opened(subject)) == redone


def test_the_view_needs_no_report(subject, dry):
    """It is there once the report is, and made again from the estimate alone."""
    assert run_steps(opened(subject), ("view",)) == []
    (subject / "results" / "view.html").unlink()
    (subject / "results" / "assessment.json").unlink()
    assert run_steps(opened(subject), ("view",)) == ["view"]
    assert run_steps(opened(subject), ("view",)) == []
    assert run_steps(opened(subject), ("estimate",), force=True) == ["estimate"]
    assert run_steps(opened(subject), ("view",)) == ["view"]


def test_redo_runs_what_was_asked(subject, dry):
    assert run_steps(opened(subject), ("estimate",), force=True) == ["estimate"]
    assert run_steps(opened(subject), ("assess", "estimate"), force=True) == ["estimate", "assess"]


def test_results_made_from_something_else_are_refused(subject, dry):
    """What lies between the step asked for and the changed file has to be redone first."""
    path = subject / "results" / "tracked.json"
    path.write_text(path.read_text(encoding="utf-8") + " ", encoding="utf-8")
    with pytest.raises(SubjectError, match=r"estimate\.json: was made before results/tracked\.json changed"):
        run_steps(opened(subject), ("assess",))
    assert run_steps(opened(subject), ("estimate", "assess")) == ["estimate", "assess"]


def test_tracking_again_is_the_same_tracking(subject):
    """For real: the same folder gives the same bytes, a moved corner gives others."""
    before = file_digest(subject / "results" / "tracked.json")
    assert run_steps(opened(subject), ("track",), force=True) == ["track"]
    assert file_digest(subject / "results" / "tracked.json") == before
    annotate_anew(subject)
    assert run_steps(opened(subject), ("track",)) == ["track"]
    assert file_digest(subject / "results" / "tracked.json") != before


# What fails


@pytest.mark.parametrize("error", [FitError("no minimum"), EquilibriumError("no equilibrium")])
def test_a_failing_estimate_keeps_the_earlier_one(subject, monkeypatch, error):
    before = digests(subject)

    def fails(*args, **kwargs):
        raise error

    monkeypatch.setattr(pipeline, "fit_stiffness", fails)
    with pytest.raises(type(error), match=str(error)):
        run_steps(opened(subject), force=True, steps=("estimate", "assess"))
    assert digests(subject) == before


@pytest.mark.parametrize("status", [FitStatus.ITERATION_LIMIT, FitStatus.STALLED])
def test_a_fit_without_a_minimum_is_no_estimate(subject, finished, monkeypatch, status):
    before = digests(subject)
    monkeypatch.setattr(pipeline, "fit_stiffness", lambda *args, **kwargs: replace(finished.fit, status=status))
    with pytest.raises(FitError, match="no estimate: "):
        run_steps(opened(subject), ("estimate",), force=True)
    assert digests(subject) == before


@pytest.mark.parametrize("status", [FitStatus.AT_BOUND, FitStatus.NOT_IDENTIFIABLE])
def test_a_fit_at_a_bound_is_written_with_its_status(subject, finished, monkeypatch, status):
    monkeypatch.setattr(pipeline, "fit_stiffness", lambda *args, **kwargs: replace(finished.fit, status=status))
    run_steps(opened(subject), ("estimate",), force=True)
    assert read_json(subject / "results" / "estimate.json")["status"] == status.name


def test_what_is_not_finite_is_written_as_null(subject, finished, monkeypatch):
    spread = replace(finished.fit.uncertainty, covariance=np.full((2, 2), np.inf))
    intervals = replace(finished.fit.intervals, high=np.full(2, np.inf))
    broken = replace(finished.fit, uncertainty=spread, intervals=intervals, default_rmse_mm=float("nan"))
    monkeypatch.setattr(pipeline, "fit_stiffness", lambda *args, **kwargs: broken)
    run_steps(opened(subject), ("estimate",), force=True)
    record = read_json(subject / "results" / "estimate.json")
    assert record["covariance_log"] == [[None, None], [None, None]]
    assert record["joint_region"] is None
    assert record["ratios"]["tissue"]["interval95"][1] is None
    assert record["training_rmse_mm"]["default"] is None


@pytest.mark.parametrize(
    ("lost", "step", "maker"),
    [
        ("tracked.json", "estimate", "spinestiff track"),
        ("torso.npz", "estimate", "spinestiff personalise"),
        ("estimate.json", "assess", "spinestiff estimate"),
        ("assessment.json", "report", "spinestiff assess"),
    ],
)
def test_a_missing_step_is_named(subject, lost, step, maker):
    (subject / "results" / lost).unlink()
    with pytest.raises(SubjectError, match=rf"{lost}: no such file; run the step that makes it first \({maker}\)"):
        run_steps(opened(subject), (step,))


def test_a_damaged_radiograph_keeps_all_results(subject):
    before = digests(subject / "results")
    path = subject / "pushes" / "second.dcm"
    path.write_bytes(path.read_bytes()[:-5000])
    with pytest.raises(RadiographError, match=r"second\.dcm"):
        run_steps(opened(subject))
    assert digests(subject / "results") == before


def test_a_frame_whose_supports_moved_is_found_and_left_out(subject):
    """The whole picture of one training frame moved by 9 pixels, 6.7 mm at the patient plane."""
    path = subject / "pushes" / "main.dcm"
    dataset = pydicom.dcmread(path)
    pixels = dataset.pixel_array.copy()
    pixels[1] = np.roll(pixels[1], 9, axis=1)
    dataset.PixelData = pixels.tobytes()
    dataset.save_as(path)
    lines = []
    run_steps(opened(subject), ("track",), lines.append)
    frames = read_json(subject / "results" / "tracked.json")["pushes"]["main"]["frames"]
    assert [bool(frame["dropped"]) for frame in frames] == [False, True, False, False]
    assert frames[1]["support_motion_mm"]["shoulder"] == pytest.approx(6.7, abs=1.0)
    assert max(frames[3]["support_motion_mm"].values()) < 3.0
    assert any(line.startswith("track: push 'main': frame 1: the ") for line in lines)
    visit = opened(subject)
    pushes = load_pushes(visit, read_torso(visit.file("torso.npz")))
    assert [t.frame for t in pushes.of_role("training")] == [2]
    (warning,) = [w for w in pushes.warnings if "dropped" in w]
    assert warning.startswith("push 'main' frame 1: the ")
    assert "mm); the frame is dropped" in warning
