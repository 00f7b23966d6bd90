"""Cobb angles of a subject's own images, and one Cobb change wherever it is shown."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from results import altered, tracked_push
from spinestiff.anatomy.names import VERTEBRAE
from spinestiff.curves import pushes
from spinestiff.curves.angle_csv import angles_csv
from spinestiff.curves.pushes import cobb_frames, cobb_rows, push_responses, reading_of, rest_reading, seen_frames
from spinestiff.curves.tilts import tilts
from spinestiff.errors import SpinestiffError, SubjectError
from spinestiff.estimation.priors import Priors
from spinestiff.files import read_json, write_json
from spinestiff.imaging.features import VertebraCorners
from spinestiff.imaging.projection import frontal_view
from spinestiff.imaging.tracking.quality import LOWEST_QUALITY, error_of
from spinestiff.study.assessment import change_record
from spinestiff.study.steps import stored_predictions
from spinestiff.study.visit import open_visit
from spinestiff.subject.assessment_outcome import Assessment
from spinestiff.subject.folder import read_subject
from spinestiff.subject.outcomes import Responses, Tracked
from spinestiff.subject.run_record import read_outcome


def test_cobb_rows(finished, subject):
    rows = cobb_rows(cobb_frames(read_subject(finished.folder)))
    assert [row[0] for row in rows] == [
        "rest/frontal",
        "main frame 0, 0 N",
        "main frame 1, 15 N",
        "main frame 2, 22 N",
        "main frame 3, 30 N",
        "second frame 0, 0 N",
        "second frame 1, 30 N",
    ]
    # A left curve of 12 degrees or a little more.
    assert re.fullmatch(r"1\d\.\d° ± \d\.\d° \(T\d+–[TL]\d+, endplates, left-convex\)", rows[0][1])
    assert rows[0][2:] == ("", "", "")
    assert all(form.startswith("0.0° ± 0.") for form in rows[1][2:])
    truth = json.loads(finished.truth.read_text())["pushes"]["main"][3]["cobb_change_deg"]
    signed, fixed, tilt = (float(form.split("°")[0].replace("−", "-")) for form in rows[4][2:])
    assert tilt == pytest.approx(truth["tilt"], abs=2.5)
    assert tilt < -1.0
    assert fixed < 0.0
    assert signed < 0.0
    (subject / "results" / "tracked.json").unlink()
    assert cobb_rows(cobb_frames(read_subject(subject))) == rows[:1]


def test_the_change_is_that_of_the_assessment(finished):
    """One frame's measured change, by ``spinestiff cobb`` and in ``assessment.json``: forms and levels."""
    subject = read_subject(finished.folder)
    shown = {frame.reading.image: frame for frame in cobb_frames(subject)}
    for frame in read_outcome(subject, Assessment).frames:
        change = shown[f"{frame.push} frame {frame.frame}, {frame.force_n:.0f} N"].change
        assert change_record(change) == frame.cobb_change_deg["measured"]
        assert np.ptp([change.signed, change.fixed_levels, change.tilt]) > 0.01


def test_the_report_s_predictions_have_the_same_change(finished):
    visit = open_visit(finished.folder)
    predictions = stored_predictions(visit)
    written = {(f.push, f.frame): f.cobb_change_deg for f in read_outcome(visit.subject, Assessment).frames}
    for prediction in predictions.of_role("validation"):
        records = written[prediction.item.push, prediction.item.frame]
        assert change_record(predictions.measured_change(prediction.item)) == records["measured"]
        for name in ("default", "fit", "truth"):
            change = predictions.simulated_change(prediction, name)
            assert change_record(change) == records[name]
            assert change.levels == records["measured"].levels


def test_marks_that_changed_after_tracking_are_told_and_not_mixed_with_what_was_followed(subject):
    path = subject / "annotation.json"
    content = read_json(path)
    content["images"]["push/main"]["vertebrae"]["T6"][0][0] += 6.0
    write_json(path, content)
    with pytest.raises(SubjectError, match=r"results of track were made before annotation\.json: pushes changed"):
        cobb_frames(read_subject(subject))


def test_a_given_noise_is_in_angles_and_in_changes(subject):
    """Of the frame under most force, whose largest angle is of other corners than that of the frame without: the upper
    end vertebra is turned back by 10 degrees in it."""
    before = cobb_frames(read_subject(subject))[4].reading.largest.angle
    turn = np.exp(1j * np.deg2rad(10.0))

    def turned(content):
        push = content["pushes"]["main"]
        corners = push["frames"][3]["corners_px"]
        row = push["vertebrae"].index(before.upper)
        places = np.array(corners[row]) @ [1.0, 1j]
        places = places.mean() + turn * (places - places.mean())
        corners[row] = np.stack([places.real, places.imag], axis=1).tolist()

    changed = altered(subject, Tracked, turned)
    usual, noisy = (cobb_frames(changed, noise_px=noise)[4] for noise in (None, 8.0))
    assert usual.reading.largest.angle.lower != before.lower
    assert noisy.reading.largest.sd_deg > 2.0 * usual.reading.largest.sd_deg
    assert noisy.change.sds[0] > 2.0 * usual.change.sds[0]
    # Between the same corners the annotation's errors are the same in both frames.
    assert noisy.change.sds[1] == usual.change.sds[1]


def test_json_of_a_frame_names_its_levels(finished):
    frames = cobb_frames(read_subject(finished.folder))
    assert frames[0].as_dict()["change_deg"] is None
    record = frames[4].as_dict()["change_deg"]
    change = frames[4].change
    assert record == {
        "signed": change.signed,
        "fixed_levels": change.fixed_levels,
        "tilt": change.tilt,
        "levels": list(change.levels),
        "tilt_levels": list(change.tilt_levels),
        "sds": dict(zip(("signed", "fixed_levels", "tilt"), change.sds)),
    }


def test_the_rest_image_needs_no_tracking(finished):
    subject = read_subject(finished.folder)
    assert rest_reading(subject).as_dict() == cobb_frames(subject)[0].reading.as_dict()


def test_a_tracking_that_is_not_as_it_was_written_is_refused(subject):
    path = subject / "results" / Tracked.FILE
    path.write_text(path.read_text().replace("0", "1", 1))
    with pytest.raises(SubjectError, match=r"tracked\.json: was changed after spinestiff track had written it"):
        cobb_frames(read_subject(subject))


def test_a_tracking_of_another_push_is_refused(subject):
    altered(subject, Tracked, lambda content: content["pushes"].update(third=content["pushes"].pop("main")))
    with pytest.raises(SubjectError, match="no push 'third'"):
        cobb_frames(read_subject(subject))


def test_corner_noise_widens_what_annotation_leaves_open(finished):
    """Of the angle at rest, and so of flexibility; what changed is known by the tracking."""
    subject = read_subject(finished.folder)
    sharp, usual, wide = (push_responses(subject, noise_px=noise).pushes["main"] for noise in (0.0, None, 8.0))
    assert sharp.flexibility.high - sharp.flexibility.low < 0.9 * (usual.flexibility.high - usual.flexibility.low)
    assert usual.flexibility.percent is not None and wide.flexibility.percent is None
    assert sharp.curve.change_deg == usual.curve.change_deg == wide.curve.change_deg
    with pytest.raises(SpinestiffError, match="noise of corners: found nan"):
        push_responses(subject, noise_px=float("nan"))


def test_a_gauge_is_as_sure_as_the_subjects_priors_say(finished):
    subject = read_subject(finished.folder)
    usual = push_responses(subject)
    assert (usual.gauge_scale_sd, usual.gauge_zero_sd_n) == (Priors().force_scale, Priors().force_offset_n)
    record = subject.record.model_copy(update={"priors": {"force_scale": 0.2}})
    found = push_responses(replace(subject, record=record))
    assert (found.gauge_scale_sd, found.gauge_zero_sd_n) == (0.2, Priors().force_offset_n)
    narrow, wide = (one.pushes["main"].tilt.n_per_degree for one in (usual, found))
    assert wide.high - wide.low > 1.5 * (narrow.high - narrow.low)


def test_n_per_degree_of_a_subject(finished):
    """The subject's own true changes of tilt lie within the intervals, both of pushes."""
    subject = read_subject(finished.folder)
    responses = push_responses(subject)
    assert read_outcome(subject, Responses) == responses
    truth = json.loads(finished.truth.read_text())["pushes"]
    for name, force in (("main", 30.0), ("second", 30.0)):
        found = responses.pushes[name]
        assert found.force_n == force and found.missing == ""
        true = abs(truth[name][-1]["cobb_change_deg"]["tilt"])
        assert found.tilt.n_per_degree.low < force / true < (found.tilt.n_per_degree.high or np.inf)
        assert found.curve.levels == responses.pushes["main"].curve.levels
        assert found.flexibility.low < found.flexibility.percent < found.flexibility.high


def test_every_frame_is_seen_and_knows_its_annotation(subject):
    def change(content):
        content["pushes"]["main"]["annotated_frames"] = [0, 3]

    altered(subject, Tracked, change)
    found = seen_frames(read_outcome(read_subject(subject), Tracked).pushes["main"], (0.0, 15.0, 22.5, 30.0))
    assert [(frame.frame, frame.force_n, frame.origin) for frame in found] == [
        (0, 0.0, 0), (1, 15.0, 0), (2, 22.5, 3), (3, 30.0, 3),
    ]  # fmt: skip
    # Towards the patient's left, upwards, in millimetres of the patient.
    left, right = found[0].points[:, 0], found[0].points[:, 1]
    assert np.all(left[:, 0] > right[:, 0]) and found[0].points[0, 0, 1] > found[0].points[-1, 0, 1]
    assert 20.0 < np.median(left[:, 0] - right[:, 0]) < 40.0


VIEW = frontal_view()
BOXES = np.array([[20.0, -10.0], [-20.0, -10.0], [-20.0, 10.0], [20.0, 10.0]])
SPINE = VertebraCorners(
    VERTEBRAE[4:13], BOXES + [[[200.0 + 0.5 * (i - 4) ** 2, 100.0 + 30.0 * i]] for i in range(9)], np.full((9, 4), 0.8)
)


def test_an_angle_of_corners_that_were_hardly_followed_is_known_less_well():
    """Annotation's error and tracking's, against draws of both."""
    turns = np.radians([12.0, 12.0, 9.0, 5.0, 0.0, -5.0, -9.0, -12.0, -12.0])
    turn = np.array([[np.cos(turns), -np.sin(turns)], [np.sin(turns), np.cos(turns)]]).transpose(2, 0, 1)
    quads = BOXES @ turn + 200.0 + 30.0 * np.arange(9)[:, None, None] * [0.0, 1.0]
    marked, followed = (
        VertebraCorners(SPINE.vertebrae, quads, np.full((9, 4), quality)) for quality in (1.0, LOWEST_QUALITY)
    )
    sure, unsure = (reading_of("a", corners, VIEW) for corners in (marked, followed))
    random, found = np.random.default_rng(2), []
    error = np.hypot(0.02 * 40.0, VIEW.magnification * error_of(np.array(LOWEST_QUALITY)) / np.sqrt(2.0))
    for _ in range(600):
        spine = tilts(SPINE.vertebrae, quads + random.normal(0.0, error, quads.shape), VIEW)
        found.append(spine.cobb_degrees(unsure.largest.angle.upper, unsure.largest.angle.lower))
    assert unsure.largest.angle == sure.largest.angle
    assert unsure.largest.sd_deg == pytest.approx(np.std(found), rel=0.08)
    assert unsure.largest.sd_deg > 1.4 * sure.largest.sd_deg == pytest.approx(1.4 * np.degrees(2.0 * 0.02), rel=1e-6)


@pytest.fixture
def tracked(monkeypatch, tmp_path):
    """A subject whose one push was tracked in frames with these corners, and has these forces by now."""

    def make(corners, forces):
        found = tracked_push(VIEW, range(len(corners)), corners)
        monkeypatch.setattr(pushes, "read_rest", lambda *_: SimpleNamespace(view=VIEW))
        monkeypatch.setattr(pushes, "image_corners", lambda *_: SPINE)
        monkeypatch.setattr(pushes, "rest_reading", lambda *_: reading_of("rest/frontal", SPINE, VIEW))
        monkeypatch.setattr(pushes, "read_outcome", lambda *_: SimpleNamespace(pushes={"main": found}))
        (tmp_path / Tracked.FILE).touch()
        return SimpleNamespace(
            results=tmp_path,
            record=SimpleNamespace(priors={}),
            push=lambda name: SimpleNamespace(id=name, forces_n=forces),
        )

    return make


def test_a_frame_without_a_curve_stops_no_other(tracked):
    """One frame shows a single vertebra: it is refused with its reason, as images of a file are."""
    quality = np.where(np.arange(9)[:, None] == 3, SPINE.quality, 0.0)
    frames = cobb_frames(tracked([SPINE, replace(SPINE, quality=quality), SPINE], (0.0, 20.0, 40.0)))
    assert [frame.reading.status for frame in frames] == ["ok", "ok", "refused", "ok"]
    assert [frame.change is None for frame in frames] == [True, False, True, False]
    name, words, *forms = cobb_rows(frames)[2]
    assert name == "main frame 1, 20 N" and forms == ["", "", ""]
    assert words == "not measured: a curve needs the tilts of at least 2 vertebrae, found 1"
    assert words in angles_csv(frames) and frames[2].as_dict()["largest_deg"] is None


def test_changes_count_from_the_least_force_that_shows_a_curve(tracked):
    """Tracking lost the unloaded frame of a push that was let go."""
    lost = replace(SPINE, quality=np.zeros((9, 4)))
    bent = replace(SPINE, corners=SPINE.corners + 1e-3 * SPINE.corners[..., ::-1] * [[[1.0, 0.0]]])
    frames = cobb_frames(tracked([bent, SPINE, lost], (40.0, 20.0, 0.0)))
    assert [frame.change is None for frame in frames] == [True, False, False, True]
    assert frames[1].change.rest == frames[2].change.pushed


@pytest.mark.parametrize("forces", [(0.0,), (0.0, 20.0, 40.0)])
def test_other_forces_than_tracked_frames_are_refused(tracked, forces):
    subject = tracked([SPINE, SPINE], forces)
    for read in (cobb_frames, push_responses):
        with pytest.raises(SubjectError, match=r"push 'main': 2 tracked frames for \d forces_n; run spinestiff track"):
            read(subject)
