"""The steps: what they write from what earlier ones left, and what a failing one leaves."""

from __future__ import annotations

import csv
from dataclasses import replace

import numpy as np
import pydicom
import pytest

from canaries import CANARY, traces
from results import altered
from spinestiff.anatomy.files import read_torso
from spinestiff.anatomy.names import VERTEBRAE
from spinestiff.anatomy.regions import torso_ratios
from spinestiff.errors import EquilibriumError, FitError, NoMinimum, SubjectError
from spinestiff.estimation.priors import Priors
from spinestiff.estimation.profiles import region_rise
from spinestiff.estimation.status import FitStatus
from spinestiff.estimation.unknowns import ACTS
from spinestiff.files import file_digest, read_json, write_json
from spinestiff.mechanics.contact import OneSidedProblem
from spinestiff.mechanics.equilibrium import EquilibriumProblem
from spinestiff.study import steps, truth, written
from spinestiff.study.forecasts import fit_end
from spinestiff.study.report.estimate_content import result_content
from spinestiff.study.runner import ALL_STEPS, run_steps
from spinestiff.study.steps import assess_step, stored_predictions, usual_ratios, view_step
from spinestiff.study.truth import read_truth
from spinestiff.study.visit import Settings, load_pushes, open_visit
from spinestiff.study.wording.estimate import held_lines
from spinestiff.study.wording.numbers import number
from spinestiff.subject.assessment_outcome import Assessment, Comparison
from spinestiff.subject.estimate_outcome import Estimate, RatioEstimate
from spinestiff.subject.geometry_outcome import GeometryRecord
from spinestiff.subject.outcomes import Tracked
from spinestiff.subject.run_record import read_outcome


def digests(folder):
    return {p.relative_to(folder).as_posix(): file_digest(p) for p in sorted(folder.rglob("*")) if p.is_file()}


def opened(subject, **settings):
    return open_visit(subject, Settings(**{"mesh": "coarse", **settings}), subject.with_name("girl.truth.json"))


def annotate_anew(subject):
    content = read_json(subject / "annotation.json")
    content["images"]["push/main"]["vertebrae"]["T7"][0][0] += 0.25
    write_json(subject / "annotation.json", content)


def result(finished, kind):
    return read_outcome(open_visit(finished.folder).subject, kind)


@pytest.fixture
def solved(monkeypatch):
    """Every equilibrium that is solved while the fixture's user runs: the load's label and the ratios."""
    asked = []

    def counted(real):
        def solve(self, load, ratios=None, *args, **kwargs):
            asked.append((load.label, ratios))
            return real(self, load, ratios, *args, **kwargs)

        return solve

    for name in ("solve", "solve_linearised"):
        monkeypatch.setattr(EquilibriumProblem, name, counted(getattr(EquilibriumProblem, name)))
    return asked


# What is written


def test_tracked_corners_are_where_the_truth_is(finished):
    truth = read_json(finished.truth)["pushes"]["main"]
    push = result(finished, Tracked).pushes["main"]
    assert len(push.frames) == 4
    view = push.view.view()
    for index, true in enumerate(truth):
        assert push.frames[index].support_note == ""
        found = push.corners(index)
        rows = [VERTEBRAE.index(v) for v in found.vertebrae]
        wanted = view.to_patient_plane(view.from_pixels(np.array(true["corners_px"])[rows]))
        error = view.to_patient_plane(found.corners) - wanted
        good = found.quality > 0.3
        assert good.mean() >= 0.8
        # 0.3 mm of annotation in each direction, and the tracking's own.
        assert np.sqrt(np.mean(np.sum(error**2, -1)[good])) < 1.0


def test_the_personalised_torso(finished):
    record = result(finished, GeometryRecord)
    assert max(record.rmse_mm.values()) < 0.6
    assert set(record.poses) == set(record.views) == set(record.millimetres) == {"frontal", "lateral"}
    assert set(record.fits) == set(record.rmse_mm) == {"frontal", "lateral"}
    shown = {v for seen in record.fits.values() for v in seen}
    assert record.prior_only == tuple(v for v in VERTEBRAE if v not in shown)
    for fits in record.fits.values():
        assert all(0.0 < fit.rmse_mm < 2.0 for fit in fits.values())
        assert all(fit.angle_deg < 5.0 and fit.wrong_corners == 0 for fit in fits.values())
    assert all(0.0 < pose.rms_mm < 1.0 for pose in record.poses.values())
    # The annotation's 0.3 mm, and what a sized box does not show of a box of another shape.
    assert 0.2 < record.corner_sd_mm < 0.45
    assert record.length_scale == pytest.approx(1.0, abs=0.02)
    assert set(record.size_scale) == set(VERTEBRAE)
    covariance = np.array(record.covariance).reshape(102, 102)
    np.testing.assert_allclose(covariance, covariance.T, atol=1e-9)
    assert np.linalg.eigvalsh(covariance).min() > 0.0
    assert np.array(record.covariance).shape == (17, 6, 102)
    assert record.mesh.smallest_j > 0.2
    assert record.mesh.path == "kept"
    assert (record.warnings == ()) == (record.prior_only == ())
    assert record.skin_scan is None
    assert read_torso(finished.folder / "results" / "torso.npz").height_cm == pytest.approx(157.0)


def test_the_estimate(finished):
    record, fit = result(finished, Estimate), finished.fit
    assert record.fit_status == fit.status.name
    assert record.fit_status_text == fit.status.value
    assert record.parameters == fit.names == ("lateral_bending", "tissue")
    assert record.values == fit.ratios.as_dict()
    for name, entry in record.ratios.items():
        assert entry.low < entry.value == fit.ratios.as_dict()[name] < entry.high
        assert (entry.low, entry.high) == fit.intervals95[name]
        assert entry.at_bound is False
        assert (entry.open_low, entry.open_high) == fit.open_ends[name]
        assert entry.determined == entry.determination
    assert record.correlation == pytest.approx(fit.correlation[0, 1])
    assert -1.0 <= record.correlation <= 1.0
    assert record.training_rmse_mm.model_dump() == {"default": fit.default_rmse_mm, "fit": fit.rmse_mm}
    assert fit.rmse_mm < 0.6 * fit.default_rmse_mm
    assert set(record.cost.model_dump()) == {"equilibria", "newton_iterations", "factorisations", "seconds"}
    assert all(value > 0 for value in record.cost.model_dump().values())
    assert len(record.history) == len(fit.history)
    assert np.array(record.covariance_log) == pytest.approx(fit.covariance)
    assert record.region == tuple(map(tuple, np.exp(fit.likely.region).tolist()))
    assert record.region_size == region_rise(2)
    assert record.orientation == fit.orientation == "procrustes"
    assert set(record.poses) == {"main", "second"}
    assert set(fit.warnings) <= set(record.notes)


def test_what_only_the_weighed_fit_tells(finished):
    record, fit = result(finished, Estimate), finished.fit
    assert [one.name for one in record.nuisances] == [one.name for one in fit.weighed.nuisances]
    units = {one.name: one.unit for one in record.nuisances}
    assert units["force offset of main"] == "N" and units["obliquity under pushes from the left"] == "rad"
    assert units["force of main"] == ""
    assert [(place.push, place.frame) for place in record.supports] == [("main", 1), ("main", 2)]
    first, second = (place.obliquity_deg for place in record.supports)
    acts = fit.weighed.acts[:, ACTS.index("obliquity")]
    assert (first, second) == pytest.approx(np.degrees(acts).tolist())
    for name, kind in zip(fit.names, fit.likely.kinds, strict=True):
        assert record.ratios[name].profile == kind
    for row in record.budget:
        for name in fit.names:
            assert record.sd_log_tracking[name] <= row.alone[name] + 1e-9
            assert row.without[name] <= record.sd_log[name] + 1e-9
            assert row.alone[name] <= record.sd_log[name] + 1e-9
    assert {(change.name, change.factor) for change in record.prior_changes} >= {
        (name, factor) for name in ("force scale", "annotation", "model discrepancy") for factor in (0.5, 2.0)
    }
    assert (record.p_value, record.tracking_factor) == (fit.weighed.p_value, fit.weighed.tracking_factor)


def test_the_draws_are_ratios_and_nuisances_row_by_row(finished):
    lines = (finished.folder / "results" / "posterior.csv").read_text(encoding="utf-8").splitlines()
    ratios, nuisances = finished.fit.likely.draws
    names = next(csv.reader(lines))
    assert names == [*finished.fit.names, *(one.name for one in finished.fit.weighed.nuisances)]
    table = np.array([[float(cell) for cell in row] for row in csv.reader(lines[1:])])
    np.testing.assert_allclose(table, np.hstack([np.exp(ratios), nuisances]), rtol=1e-5, atol=1e-9)
    assert len(table) >= 100
    # Of one kind with the intervals.
    for column, name in enumerate(finished.fit.names):
        low, high = finished.fit.intervals95[name]
        assert 0.85 < np.mean((table[:, column] > low) & (table[:, column] < high)) <= 1.0
    record = read_json(finished.folder / "results" / "run.json")["steps"]["estimate"]
    assert "results/posterior.csv" in record["outputs"]


def test_the_paper_s_method_is_level_and_has_no_intervals(subject, finished, monkeypatch):
    """The steps around it for real; the fit itself is tested where it lives."""
    content = read_json(subject / "subject.json")
    write_json(subject / "subject.json", {**content, "pelvis": "hinge", "wall": "one-sided"})
    asked = []
    nothing = (float("nan"), float("nan"))
    paper = replace(
        finished.fit, method="paper", weighed=None, intervals95=dict.fromkeys(finished.fit.names, nothing),
        open_ends=dict.fromkeys(finished.fit.names, (False, False)), covariance=np.full((2, 2), np.nan),
    )  # fmt: skip
    monkeypatch.setattr(
        steps, "fit_from_coarse", lambda coarse, pushes, *args, **kwargs: asked.append((pushes, args)) or paper
    )
    visit = opened(subject, method="paper")
    assert visit.file("posterior.csv").exists()
    run_steps(visit, ("estimate",))
    ((pushes, args),) = asked
    assert "paper" in args
    assert all(p.supports.held[pushes.torso.bone("pelvis")].all() for p in pushes.problems.values())
    assert not any(isinstance(p, OneSidedProblem) for p in pushes.problems.values())
    assert pushes.known.priors.obliquity_deg == 0.0
    record = read_outcome(visit.subject, Estimate)
    assert all((one.low, one.high, one.profile) == (None, None, None) for one in record.ratios.values())
    assert (record.p_value, record.budget, record.nuisances, record.region) == (None, (), (), None)
    assert any("equal weights with the pelvis level: it has no intervals" in note for note in record.notes)
    assert {check.name: check.passed for check in record.checks}["residuals as expected"] is None
    # Draws of an earlier estimate are none of this one.
    assert not visit.file("posterior.csv").exists()


def test_the_estimate_is_judged(finished):
    record = result(finished, Estimate)
    found = {(check.name, check.passed) for check in record.checks}
    assert {name for name, passed in found if passed is False} == set()
    assert record.status == record.fit_status
    # Of every push; the second one has a single force.
    assert found >= {("rest and push", True), ("training frames", True), ("motion grows with force", None)}
    assert len([check for check in record.checks if check.name == "rest and push"]) == 2
    (rest, _) = [check for check in record.checks if check.name == "rest and push"]
    assert rest.value == record.poses["main"].rms_mm


def test_a_failed_check_makes_the_estimate_doubtful(subject, finished):
    """Kilograms as newtons, and a push of another patient; nothing of either patient is said."""
    content = read_json(subject / "subject.json")
    for push in content["pushes"]:
        push["forces_n"] = [round(force / 9.81, 3) for force in push["forces_n"]]
    write_json(subject / "subject.json", content)
    for name, patient in (("rest/frontal", 1), ("rest/lateral", 1), ("pushes/main", 2), ("pushes/second", 1)):
        dataset = pydicom.dcmread(subject / f"{name}.dcm")
        dataset.PatientID, dataset.PatientIdentityRemoved = f"{CANARY}{patient}", "NO"
        dataset.PatientName = f"{CANARY}^{patient}"
        dataset.save_as(subject / f"{name}.dcm")
    visit = open_visit(subject)
    geometry = read_outcome(visit.subject, GeometryRecord)
    record = written.estimate_record(visit, load_pushes(visit, visit.manner), finished.fit, geometry)
    assert record.status == "DOUBTFUL"
    assert record.fit_status == finished.fit.status.name
    assert [check.name for check in record.failed] == ["same patient", "size of the force"]
    assert record.failed[0].text.startswith("rest/frontal and push/main name different patients; look for")
    assert not traces(record.model_dump_json())


def test_plain_units_have_the_interval_of_their_ratio(finished):
    record = result(finished, Estimate)
    for name, ratio in (
        ("lateral_bending_thoracic", "lateral_bending"),
        ("lateral_bending_lumbar", "lateral_bending"),
        ("tissue_young", "tissue"),
    ):
        plain, of = record.plain[name], record.ratios[ratio]
        assert plain.ratio == ratio
        assert plain.low / plain.value == pytest.approx(of.low / of.value)
        assert plain.high / plain.value == pytest.approx(of.high / of.value)


def test_the_least_determined_ratio_says_how_far_all_are(finished):
    record = result(finished, Estimate)
    order = written.LEAST_FIRST
    assert record.determined == min((r.determined for r in record.ratios.values()), key=order.index)
    assert record.status == "DOUBTFUL" if record.failed else record.fit_status


def test_the_reactions_balance_the_push(finished):
    """Three points in the frontal plane: shoulder and pelvis carry the push, split as the simple beam says."""
    reactions = result(finished, Estimate).reactions_n
    assert reactions.push == "push 'main' frame 2"
    assert reactions.f3 == 22.5
    assert reactions.eq2_shoulder + reactions.eq1_pelvis == pytest.approx(22.5)
    push = open_visit(finished.folder).subject.push("main")
    assert reactions.eq1_pelvis == pytest.approx(22.5 * push.d31_mm / push.d21_mm)
    # Of the force as the fit has it, within the standard deviation of a gauge's zero.
    assert reactions.shoulder + reactions.pelvis == pytest.approx(22.5, abs=Priors().force_offset_n)
    # About the pelvis, whose moment Eqs. 1-2 leave out; lever arms are those at rest.
    shared = reactions.shoulder + 1000.0 * reactions.pelvis_moment_nm / push.d21_mm
    assert shared == pytest.approx(reactions.eq2_shoulder, rel=0.1)
    held = finished.fit.equilibria[-1].reactions
    (pelvis,) = [reaction for reaction in held if reaction.name == "pelvis"]
    assert reactions.pelvis_moment_nm == pytest.approx(push.sign * pelvis.moment[2] / 1000.0)
    assert reactions.pelvis_moment_nm > 0.1
    assert reactions.wall_pull == pytest.approx(max(-r.force[2] for r in held if r.kind == "wall"))


def test_tracking_again_is_the_same_tracking(subject):
    """For real: the same folder gives the same bytes, a moved corner gives others."""
    before = file_digest(subject / "results" / "tracked.json")
    assert run_steps(opened(subject), ("track",), force=True) == ["track"]
    assert file_digest(subject / "results" / "tracked.json") == before
    annotate_anew(subject)
    assert run_steps(opened(subject), ("track",)) == ["track"]
    assert file_digest(subject / "results" / "tracked.json") != before


def test_a_frame_whose_supports_moved_is_found_and_kept(subject):
    """The whole picture of one training frame moved by 9 pixels, 6.7 mm at the patient plane."""
    path = subject / "pushes" / "main.dcm"
    dataset = pydicom.dcmread(path)
    pixels = dataset.pixel_array.copy()
    pixels[1] = np.roll(pixels[1], 9, axis=1)
    dataset.PixelData = pixels.tobytes()
    dataset.save_as(path)
    lines = []
    visit = opened(subject)
    run_steps(visit, ("track",), lines.append)
    frames = read_outcome(visit.subject, Tracked).pushes["main"].frames
    assert [bool(frame.support_note) for frame in frames] == [False, True, False, False]
    assert frames[1].support_motion_mm["shoulder"] == pytest.approx(6.7, abs=1.0)
    assert frames[1].shoulder_mm.value == pytest.approx(6.7, abs=1.0)
    assert max(frames[3].support_motion_mm.values()) < 3.0
    assert any(line.startswith("track: push 'main' frame 1: the ") for line in lines)
    pushes = load_pushes(visit, visit.manner)
    assert [t.frame for t in pushes.of_role("training")] == [1, 2]
    (warning,) = [w for w in pushes.warnings if "moved by" in w]
    assert warning.startswith("push 'main' frame 1: the ")
    assert warning.endswith("; the paper leaves such a frame out")


# Every equilibrium is solved once


def test_assess_solves_no_training_frame_again(subject, finished, solved, monkeypatch):
    """Of default and estimated stiffness only what the fit never saw.

    The one-ratio baseline is a fit of its own, and so are held-out frames' supports. Forecasts linearise all frames.
    """
    monkeypatch.setattr(steps, "single_ratio", lambda *args: None)
    monkeypatch.setattr(steps, "forecasts", lambda *args: {})
    monkeypatch.setattr(steps, "with_fitted_supports", lambda predictions, model: predictions)
    visit = open_visit(subject)
    assert run_steps(visit, ("assess",), force=True) == ["assess"]
    assert sorted((label, ratios is None) for label, ratios in solved) == [
        (f"push {frame}", default) for frame in ("'main' frame 3", "'second' frame 1") for default in (False, True)
    ]
    training = stored_predictions(visit).of_role("training")
    assert [p.item.frame for p in training] == [1, 2]
    for prediction, fitted, default in zip(
        training, finished.fit.equilibria, finished.fit.default_equilibria, strict=True
    ):
        np.testing.assert_array_equal(prediction.solved["fit"].state.bone_positions, fitted.state.bone_positions)
        np.testing.assert_array_equal(prediction.solved["default"].state.bone_positions, default.state.bone_positions)
        forces = [reaction.force for reaction in fitted.reactions]
        np.testing.assert_array_equal(prediction.solved["fit"].reactions, forces)


def test_without_a_forecast_the_rest_of_the_assessment_is_there(subject, monkeypatch):
    def fails(*args):
        raise EquilibriumError("push 'main' frame 3: no equilibrium")

    monkeypatch.setattr(steps, "single_ratio", lambda *args: None)
    monkeypatch.setattr(steps, "with_fitted_supports", lambda predictions, model: predictions)
    monkeypatch.setattr(steps, "forecasts", fails)
    lines = []
    visit = open_visit(subject)
    assess_step(visit, lines.append)
    assert "no forecast: push 'main' frame 3: no equilibrium" in lines
    for frame in Assessment.model_validate(read_json(subject / "results" / Assessment.FILE)).frames:
        assert frame.forecast is None
        assert frame.rmse_mm["forecast"] is None
        assert frame.rmse_mm["fit"] > 0.0


def test_the_view_solves_nothing(subject, solved):
    (subject / "results" / "view.html").unlink()
    view_step(open_visit(subject), lambda line: None)
    assert "main: 30 N from the" in (subject / "results" / "view.html").read_text(encoding="utf-8")
    assert solved == []


# What fails, and what is at its limits


@pytest.mark.parametrize("status", [FitStatus.ITERATION_LIMIT, FitStatus.STALLED])
def test_a_fit_without_a_minimum_is_no_estimate(subject, finished, monkeypatch, status):
    before = digests(subject)
    monkeypatch.setattr(steps, "fit_from_coarse", lambda *args, **kwargs: replace(finished.fit, status=status))
    looked_at = r"^no estimate: no stiffness .*; look at forces_n \(newtons.*side and level .*corners .*another patient"
    with pytest.raises(FitError, match=looked_at) as raised:
        run_steps(opened(subject), ("estimate",), force=True)
    # What a user can mend comes before any talk of the search.
    assert str(raised.value).endswith(f"; if all of these are right, the search itself: {status.value}")
    assert digests(subject) == before


def test_a_fit_without_a_start_is_told_by_the_likely_mistakes_too(subject, monkeypatch):
    def nowhere(*args, **kwargs):
        raise NoMinimum("no equilibrium at the start of the fit, push 'main' frame 2: it folded")

    monkeypatch.setattr(steps, "fit_from_coarse", nowhere)
    monkeypatch.setattr(steps, "fit_pushes", nowhere)
    with pytest.raises(FitError, match=r"^no estimate: .*look at forces_n .*right, the search itself: no equilibrium"):
        run_steps(opened(subject), ("estimate",), force=True)


def test_a_fit_without_a_minimum_names_what_the_forces_and_motions_say(subject, finished, monkeypatch):
    record = read_json(subject / "subject.json")
    for push in record["pushes"]:
        push["side"] = "left" if push["side"] == "right" else "right"
    write_json(subject / "subject.json", record)
    stalled = replace(finished.fit, status=FitStatus.STALLED)
    monkeypatch.setattr(steps, "fit_from_coarse", lambda *args, **kwargs: stalled)
    lines = []
    side = r"^no estimate: the inputs do not agree: push 'main': .* against the push .*look for the wrong side"
    with pytest.raises(FitError, match=side + ".*the search itself: "):
        run_steps(opened(subject), ("estimate",), lines.append)
    # Told before the search, too, which may take minutes.
    assert any(line.startswith("estimate: doubtful: push 'main': ") for line in lines)


@pytest.mark.parametrize("status", [FitStatus.AT_BOUND, FitStatus.NOT_IDENTIFIABLE])
def test_a_fit_at_a_bound_is_written_with_its_status(subject, finished, monkeypatch, status):
    monkeypatch.setattr(steps, "fit_from_coarse", lambda *args, **kwargs: replace(finished.fit, status=status))
    visit = opened(subject)
    run_steps(visit, ("estimate",), force=True)
    estimate = read_outcome(visit.subject, Estimate)
    assert estimate.fit_status == status.name
    assert estimate.fit_status_text == status.value


def test_what_is_not_finite_is_written_as_null(subject, finished, monkeypatch):
    fit = finished.fit
    broken = replace(
        fit,
        covariance=np.full((2, 2), np.inf),
        intervals95={name: (low, np.inf) for name, (low, _) in fit.intervals95.items()},
        weighed=replace(fit.weighed, likely=replace(fit.likely, region=None)),
        default_rmse_mm=float("nan"),
    )
    monkeypatch.setattr(steps, "fit_from_coarse", lambda *args, **kwargs: broken)
    visit = opened(subject)
    run_steps(visit, ("estimate",), force=True)
    record = read_outcome(visit.subject, Estimate)
    assert record.covariance_log == ((None, None), (None, None))
    assert record.region is None
    assert record.ratios["tissue"].high is None
    assert record.ratios["tissue"].determined == record.determined == "not determined"
    assert record.plain["tissue_young"].high is None
    assert record.training_rmse_mm.default is None
    content = read_json(visit.file(Estimate.FILE))
    assert content["covariance_log"] == [[None, None], [None, None]]
    assert content["ratios"]["tissue"]["high"] is None


def test_open_ends_reach_the_file(subject, finished, monkeypatch):
    """An end at the fit's bound is open, and what is open at both ends is not determined."""
    opens = {"lateral_bending": (False, True), "tissue": (True, True)}
    monkeypatch.setattr(steps, "fit_from_coarse", lambda *args, **kwargs: replace(finished.fit, open_ends=opens))
    visit = opened(subject)
    run_steps(visit, ("estimate",), force=True)
    record = read_outcome(visit.subject, Estimate)
    bending, tissue = (record.ratios[name] for name in ("lateral_bending", "tissue"))
    assert isinstance(bending, RatioEstimate)
    assert (bending.open_low, bending.open_high, tissue.open_low, tissue.open_high) == (False, True, True, True)
    assert tissue.determined == record.determined == "not determined"
    assert (record.plain["tissue_young"].open_low, record.plain["tissue_young"].open_high) == (True, True)


def test_an_estimate_of_another_orientation_is_shown_in_it(subject):
    """What the fit compared is what assessment, report and viewer compare."""
    altered(subject, Estimate, lambda content: content.update(orientation="covariance"))
    assert stored_predictions(open_visit(subject)).pushes.orientation == "covariance"


def test_assess_writes_the_comparison(subject, finished):
    visit = opened(subject)
    assess_step(visit, lambda line: None)
    written = Comparison.model_validate(read_json(visit.file(Comparison.FILE)))
    assert written.inside is (written.distance2 <= written.region_size)
    assert written.truth == read_json(finished.truth)["ratios"]
    before = result(finished, Assessment)
    assert Assessment.model_validate(read_json(visit.file(Assessment.FILE))) == before


def test_a_push_that_was_never_tracked_is_refused(subject):
    altered(subject, Tracked, lambda content: content["pushes"].pop("second"))
    with pytest.raises(SubjectError, match=r"tracked\.json: no push 'second'; run spinestiff track again"):
        ALL_STEPS["estimate"].run(open_visit(subject), lambda line: None)


# Other parameters


def test_other_parameters_and_a_population_asked_in_subject_json(subject, finished, monkeypatch):
    """What is held is named, and the truth of a part is its group's. The fit itself is tested where it lives."""
    names, asked = ("lateral_bending@T1-S1", "tissue"), []
    held = {"population koutras2025": "so much"}

    def fit(coarse, pushes, wanted, start, *args):
        asked.append((wanted, start, pushes.known.population))
        ratios = torso_ratios(pushes.torso, dict(zip(wanted, finished.fit.ratios.values)))
        by_name = {
            what: dict(zip(wanted, getattr(finished.fit, what).values()))
            for what in ("intervals95", "open_ends", "at_bound")
        }
        weighed = replace(finished.fit.weighed, held=held, data_sd=np.array([2.0, 0.1]))
        return replace(finished.fit, ratios=ratios, weighed=weighed, **by_name)

    monkeypatch.setattr(steps, "fit_from_coarse", fit)
    content = read_json(subject / "subject.json")
    write_json(subject / "subject.json", {**content, "parameters": list(names), "population": "koutras2025"})
    visit = opened(subject)
    run_steps(visit, ("estimate",))
    assert asked == [(names, {names[0]: 0.07, "tissue": 0.04}, "koutras2025")]
    record = read_outcome(visit.subject, Estimate)
    assert record.parameters == names
    assert (record.intervals, record.population, record.held) == ("profile", "koutras2025", held)
    assert record.data_sd_log == {names[0]: 2.0, "tissue": 0.1}
    assert record.ratios[names[0]].determined == "not determined"
    assert record.plain["lateral_bending_lumbar"].ratio == names[0]
    lines = held_lines(record)
    assert lines[0] == "held before the fit, no data: population koutras2025: so much"
    assert lines[1].startswith("the radiographs without it (95 %, to first order): tissue within a factor of 1.22 and ")
    page = result_content(visit, record, result(finished, Assessment))
    assert page["held"] == lines
    assert page["ratios"][0]["title"] == "Lateral bending of the spine, T1-S1"
    true_bending = read_truth(visit.truth)["lateral_bending"]
    assert page["ratios"][0]["truth"] == number(true_bending)
    assert page["bending"] is not None
    # At its own equilibria.
    compared = []
    monkeypatch.setattr(truth, "rise_of", lambda *args: compared.append(args[1:]) or 1.0)
    truth.compare_with_truth(record, load_pushes(visit, visit.manner), visit.truth)
    wanted = {names[0]: true_bending, "tissue": read_truth(visit.truth)["tissue"]}
    assert compared == [(fit_end(record), wanted, record.training_rmse_mm.fit, None)]


def test_many_ratios_say_how_their_intervals_were_found(finished):
    record = result(finished, Estimate)
    assert held_lines(record) == []
    (line,) = held_lines(record.model_copy(update={"intervals": "linear"}))
    assert line.startswith("intervals: to first order")


def test_fits_start_at_usual_ratios_and_parts_beside_their_whole_at_1():
    assert usual_ratios(("lateral_bending@lumbar", "tissue", "axial_rotation")) == {
        "lateral_bending@lumbar": 0.07, "tissue": 0.04,
    }  # fmt: skip
    assert usual_ratios(("lateral_bending", "lateral_bending@lumbar")) == {"lateral_bending": 0.07}
