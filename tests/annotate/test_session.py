"""What a session keeps: every change on disk at once, whole images in annotation.json, the rest in a draft."""

from __future__ import annotations

import json
from dataclasses import replace
from threading import Thread

import numpy as np
import pydicom
import pytest

from phantoms import phantom, sixteen_bit
from spinestiff.anatomy.names import VERTEBRAE
from spinestiff.annotate.draft import Draft, DraftImage, parse_draft
from spinestiff.annotate.exchange import exported, imported
from spinestiff.annotate.server import application, session_record
from spinestiff.annotate.session import AnnotationSession, ChangedElsewhere
from spinestiff.curves.cobb import read_cobb
from spinestiff.curves.corner_files import read_corners
from spinestiff.curves.pushes import rest_reading
from spinestiff.curves.tilts import cobb_angle, tilts
from spinestiff.errors import SubjectError
from spinestiff.files import read_json
from spinestiff.imaging.projection import lateral_view
from spinestiff.imaging.radiograph import write_radiographs
from spinestiff.study.side_views import marked_pedicles
from spinestiff.subject.annotated_points import image_corners, push_corners
from spinestiff.subject.folder import read_annotation, read_rest, read_subject
from spinestiff.subject.inspection import inspect
from unannotated import CANARY, MM, drawn

ALL = ("rest/frontal", "rest/lateral", "push/a")


def marked(image, *levels):
    return DraftImage.model_validate_json(json.dumps({"vertebrae": drawn(image).named(*levels)}))


def draft(**images):
    return Draft(schema_version=1, images={name.replace("__", "/"): image for name, image in images.items()})


def whole():
    return Draft(schema_version=1, images={name: marked(name) for name in ALL})


def on_disk(session):
    return {path.name for path in session.subject.folder.iterdir() if path.is_file()}


def test_a_folder_without_annotation_opens_empty(session):
    assert session.images == ALL
    assert session.marks == {} and on_disk(session) == {"subject.json"}
    assert [line.partition(":")[0] for line in session.judge.missing({})] == list(ALL)


def test_a_complete_annotation_is_one_that_all_other_steps_read(session):
    assert session.save(whole(), session.revision) == session.revision
    assert on_disk(session) == {"subject.json", "annotation.json"}
    assert session.judge.missing(session.marks) == []
    subject = read_subject(session.subject.folder)
    for name in ALL:
        np.testing.assert_allclose(subject.annotation.images[name].pixels(), drawn(name).quads, atol=0.006)


def test_few_vertebrae_wait_in_a_draft_and_come_back(session):
    few = marked("rest/frontal", "T1", "T2", "T3")
    session.save(draft(rest__frontal=few), session.revision)
    assert on_disk(session) == {"subject.json", "annotation.draft.json"}
    assert AnnotationSession(session.subject.folder).marks == {"rest/frontal": few}
    assert "3 vertebrae, wanted at least 8" in session.judge.missing(session.marks)[0]
    # The eighth makes it an annotation, and the draft goes.
    eight = marked("rest/frontal", *VERTEBRAE[:8])
    session.save(draft(rest__frontal=eight), session.revision)
    assert on_disk(session) == {"subject.json", "annotation.json"}
    assert AnnotationSession(session.subject.folder).marks == {"rest/frontal": eight}


def test_a_proposal_waits_in_the_draft_until_every_vertebra_was_looked_at(session):
    proposed = marked("rest/frontal").model_copy(update={"unseen": ("T1", "L5")})
    session.save(draft(rest__frontal=proposed), session.revision)
    assert on_disk(session) == {"subject.json", "annotation.draft.json"}
    assert "rest/frontal: 2 of 17 vertebrae are proposed and not looked at yet" in session.judge.missing(session.marks)
    assert AnnotationSession(session.subject.folder).marks["rest/frontal"].unseen == ("T1", "L5")
    # What is no longer there needs no look.
    gone = {name: quad for name, quad in proposed.vertebrae.items() if name != "L5"}
    seen = proposed.model_copy(update={"unseen": ("L5",), "vertebrae": gone})
    session.save(draft(rest__frontal=seen), session.revision)
    assert on_disk(session) == {"subject.json", "annotation.json"}
    assert "unseen" not in session.annotation_path.read_text(encoding="utf-8")


def test_the_ends_of_the_points_along_the_spine_wait_in_the_draft_alone(session):
    proposed = marked("rest/frontal").model_copy(update={"unseen": ("T1",), "ends": ("T1", "L5")})
    session.save(draft(rest__frontal=proposed), session.revision)
    assert AnnotationSession(session.subject.folder).marks["rest/frontal"].ends == ("T1", "L5")
    assert session_record(session)["marks"]["rest/frontal"]["ends"] == ["T1", "L5"]
    session.save(draft(rest__frontal=proposed.model_copy(update={"unseen": ()})), session.revision)
    assert on_disk(session) == {"subject.json", "annotation.json"}
    assert "ends" not in session.annotation_path.read_text(encoding="utf-8")


def test_a_push_is_called_push_once(session):
    record = session.subject.record
    push = record.pushes[0].model_copy(update={"id": "push-1"})
    assert session_record(session)["images"][2]["title"] == "Push a"
    session.subject = replace(session.subject, record=record.model_copy(update={"pushes": (push,)}))
    session.images = ("push/push-1",)
    assert session_record(session)["images"][0]["title"] == "Push-1"


def test_a_lateral_proposal_is_told_how_vertebrae_lean(session):
    assert session.leans("rest/lateral") == {}
    session.save(draft(rest__frontal=marked("rest/frontal", "T5", "T6")), session.revision)
    leans = session.leans("rest/lateral")
    quads = drawn("rest/frontal").named("T5")["T5"]
    assert set(leans) == {"T5", "T6"} and session.leans("rest/frontal") == {} == session.leans("push/a")
    assert leans["T5"] == pytest.approx(-(quads[0][1] - quads[1][1]) / (quads[0][0] - quads[1][0]), abs=0.1)


def test_an_image_that_is_taken_apart_moves_to_the_draft_and_the_others_stay(session):
    session.save(whole(), session.revision)
    images = dict(session.marks) | {"push/a": marked("push/a", "T4")}
    session.save(Draft(schema_version=1, images=images), session.revision)
    assert set(read_annotation(session.annotation_path).images) == {"rest/frontal", "rest/lateral"}
    assert AnnotationSession(session.subject.folder).marks == images


def test_a_crash_between_the_two_files_loses_nothing(session, monkeypatch):
    """Whichever write fails, what was saved before is found again or what was to be saved."""
    from spinestiff.annotate import session as module

    session.save(draft(rest__frontal=marked("rest/frontal", "T1")), session.revision)
    before, after = session.marks, draft(rest__frontal=marked("rest/frontal"), push__a=marked("push/a", "T1"))

    def fail(*_):
        raise SubjectError("no space")

    for broken in ("write_annotation", "write_json"):
        with monkeypatch.context() as patch:
            patch.setattr(module, broken, fail)
            with pytest.raises(SubjectError, match="no space"):
                session.save(after, session.revision)
        assert AnnotationSession(session.subject.folder).marks in (before, after.images)
    session = AnnotationSession(session.subject.folder)
    session.save(after, session.revision)
    assert AnnotationSession(session.subject.folder).marks == after.images


def test_two_windows_do_not_overwrite_each_other(session):
    first = session.revision
    session.save(whole(), first)
    with pytest.raises(ChangedElsewhere, match="another window or program"):
        session.save(draft(rest__frontal=marked("rest/frontal", "T1")), first)
    assert set(session.marks) == set(ALL)


def test_a_page_is_given_the_revision_of_its_marks_while_another_saves(session, monkeypatch):
    session.save(whole(), session.revision)
    before, dump = session.revision, DraftImage.model_dump
    other = Thread(target=session.save, args=(draft(rest__frontal=marked("rest/frontal", "T1")), before))

    def meanwhile(image, **how):
        if not other.ident:
            other.start()
            other.join(1.0)
        return dump(image, **how)

    (page,) = (one.endpoint for one in application(session).routes if getattr(one, "path", "") == "/api/session")
    monkeypatch.setattr(DraftImage, "model_dump", meanwhile)
    given = page()
    other.join()
    assert (set(given["marks"]), given["revision"]) == (set(ALL), before)
    assert set(page()["marks"]) == {"rest/frontal"}


def test_what_a_page_saved_without_an_answer_it_may_save_again(session):
    """Also after the server was started anew, and only while the radiographs are those that the page shows."""
    first = session.revision
    proposed = marked("rest/frontal").model_copy(update={"spine": ((9.0, 9.0),), "ends": ("T1", "L5")})
    sent = draft(rest__frontal=proposed, push__a=marked("push/a", "T4"))
    now = session.save(sent, first)
    assert session.save(sent, first) == now == AnnotationSession(session.subject.folder).save(sent, first)
    # What was marked since then follows on the revision that was answered.
    session.save(whole(), now)
    with pytest.raises(ChangedElsewhere, match="another window or program"):
        session.save(sent, first)
    assert set(read_annotation(session.annotation_path).images) == set(ALL)
    path = session.subject.folder / "rest/frontal.dcm"
    path.with_suffix(".new").write_bytes(path.read_bytes())
    path.with_suffix(".new").replace(path)
    session.reload()
    with pytest.raises(ChangedElsewhere, match="another window or program"):
        session.save(whole(), now)


def test_what_another_program_wrote_is_not_overwritten(session):
    session.save(whole(), session.revision)
    text = session.annotation_path.read_text(encoding="utf-8")
    session.annotation_path.write_text(text.replace("\n", "\n "), encoding="utf-8")
    with pytest.raises(ChangedElsewhere, match=r"annotation\.json was changed by another program"):
        session.save(draft(), session.revision)
    session.reload()
    session.save(draft(rest__frontal=marked("rest/frontal")), session.revision)
    assert set(read_annotation(session.annotation_path).images) == {"rest/frontal"}


def test_a_page_from_before_another_programs_marks_saves_nothing_once_they_are_read(session):
    session.save(whole(), session.revision)
    before = session.revision
    other = AnnotationSession(session.subject.folder)
    other.save(draft(rest__frontal=marked("rest/frontal", *VERTEBRAE[:9])), other.revision)
    session.reload()  # as when a second window is opened
    with pytest.raises(ChangedElsewhere, match="another window or program"):
        session.save(whole(), before)
    assert list(read_annotation(session.annotation_path).images["rest/frontal"].vertebrae) == list(VERTEBRAE[:9])
    # What is there is the same to both.
    assert session.revision == other.revision
    session.save(whole(), other.revision)
    assert session.revision == before


def test_wrong_corners_are_named_and_wait_in_the_draft(session):
    quads = drawn("rest/frontal").named()
    quads["T7"] = [quads["T7"][i] for i in (1, 0, 3, 2)]
    crossed = DraftImage.model_validate_json(json.dumps({"vertebrae": quads}))
    session.save(draft(rest__frontal=crossed), session.revision)
    assert on_disk(session) == {"subject.json", "annotation.draft.json"}
    (line, *_) = session.judge.missing(session.marks)
    assert line.startswith("rest/frontal: ") and "T7" in line
    mirrored = {name: [quad[i] for i in (1, 0, 3, 2)] for name, quad in drawn("rest/frontal").named().items()}
    marks = DraftImage.model_validate_json(json.dumps({"vertebrae": mirrored}))
    assert "mirrored for this view" in session.judge.told("rest/frontal", {"rest/frontal": marks}).problem


def test_the_angle_is_the_one_that_spinestiff_cobb_reads(session):
    marks = marked("rest/frontal")
    judged = session.judge.told("rest/frontal", {"rest/frontal": marks})
    session.save(draft(rest__frontal=marks), session.revision)
    (image,) = read_corners(session.annotation_path)
    read = read_cobb(image)
    assert judged.cobb.curves == read.curves and judged.cobb.patient_left == read.patient_left == "right"
    # And the one that the report reads in the patient plane.
    view = session.radiographs.view("rest/frontal")
    quads = np.array(list(drawn("rest/frontal").named().values()))
    wanted = cobb_angle(tilts(VERTEBRAE, view.from_pixels(quads), view))
    assert judged.cobb.largest.angle.degrees == pytest.approx(wanted.degrees, abs=1e-9)
    assert (judged.cobb.largest.angle.upper, judged.cobb.largest.angle.lower) == (wanted.upper, wanted.lower)
    assert abs(wanted.degrees) > 20.0 and judged.problem == "" and judged.vertebrae == 17
    # Also while there are too few for a fit, and never in a lateral radiograph.
    assert (
        session.judge.told(
            "rest/frontal", {"rest/frontal": marked("rest/frontal", "T3", "T9")}
        ).cobb.largest.angle.lower
        == "T9"
    )
    assert session.judge.told("rest/lateral", {"rest/lateral": marked("rest/lateral")}).cobb is None


def test_the_angle_of_pixels_that_are_not_square_is_that_of_spinestiff_cobb(unannotated):
    path = unannotated / "rest/frontal.dcm"
    dataset = pydicom.dcmread(path)
    rows, columns = dataset.ImagerPixelSpacing
    dataset.ImagerPixelSpacing = [rows, round(1.4 * columns, 6)]
    dataset.save_as(path)
    session = AnnotationSession(unannotated)
    session.save(whole(), session.revision)
    read = rest_reading(read_subject(unannotated)).largest
    shown = session.judge.told("rest/frontal", {"rest/frontal": marked("rest/frontal")}).cobb.largest
    assert shown.angle.degrees == pytest.approx(read.angle.degrees, abs=1e-9)
    assert (shown.angle.upper, shown.angle.lower) == (read.angle.upper, read.angle.lower)
    assert shown.sd_deg == pytest.approx(read.sd_deg, rel=1e-6)


def test_a_radiograph_that_stands_on_its_head_can_be_complete(unannotated):
    """The fit reads its corners; only files of other programs, and so the angle, have no words for them."""
    path = unannotated / "rest/frontal.dcm"
    dataset = pydicom.dcmread(path)
    dataset.PixelData = np.flip(dataset.pixel_array, 0).tobytes()
    dataset.PatientOrientation = ["L", "H"]
    dataset.save_as(path)
    last = dataset.Rows - 1
    quads = {name: [[x, last - y] for x, y in quad] for name, quad in drawn("rest/frontal").named().items()}
    turned = DraftImage.model_validate({"vertebrae": quads})
    session = AnnotationSession(unannotated)
    judged = session.judge.told("rest/frontal", {"rest/frontal": turned})
    assert (judged.vertebrae, judged.problem, judged.cobb) == (17, "", None)
    session.save(Draft(schema_version=1, images={**whole().images, "rest/frontal": turned}), session.revision)
    assert session.judge.missing(session.marks) == []
    subject = read_subject(unannotated)
    assert len(image_corners(subject, "rest/frontal", read_rest(subject, "frontal").view)) == 17
    with pytest.raises(SubjectError, match="stands on its head"):
        exported(session, "csv")
    # What is wrong with it is told as of any other.
    upside = session.judge.told("rest/frontal", {"rest/frontal": marked("rest/frontal")})
    assert "the superior corners lie below" in upside.problem


def test_corners_of_a_further_frame_that_begin_at_the_wrong_one_wait_in_the_draft(session):
    """Alone they are in order; against the push's first frame they are turned by a right angle."""
    (quad,) = drawn("push/a/1").named("T8").values()
    turned = [
        image
        for by in (1, 3)
        if (image := DraftImage.model_validate({"vertebrae": {"T8": np.roll(quad, by, 0).tolist()}}))
        and not session.judge.told("push/a/1", {"push/a/1": image}).problem
    ]
    assert turned
    for image in turned:
        marks = {**whole().images, "push/a/1": image}
        session.save(Draft(schema_version=1, images=marks), session.revision)
        assert set(read_annotation(session.annotation_path).images) == set(ALL)
        assert AnnotationSession(session.subject.folder).marks == marks
        (line,) = session.judge.missing(session.marks)
        assert line.startswith("push/a/1: vertebrae.T8: turned by ")
        assert set(session.annotated().annotation.images) == set(ALL)
    # Beside a first frame that is a draft itself nothing tells, and what follows it is kept.
    marks["push/a"] = marked("push/a", "T8")
    session.save(Draft(schema_version=1, images=marks), session.revision)
    assert set(read_annotation(session.annotation_path).images) == {"rest/frontal", "rest/lateral", "push/a/1"}


def test_support_points_outside_the_picture_are_told_before_tracking_refuses_them(session):
    supports = marked("push/a").model_copy(update={"supports": {"pelvis": ((9999.0, 2.0),)}})
    session.save(Draft(schema_version=1, images={**whole().images, "push/a": supports}), session.revision)
    (line,) = session.judge.missing(session.marks)
    assert line.startswith("push/a: supports.pelvis: found a point at column 9999")
    assert "push/a" not in read_annotation(session.annotation_path).images


def test_points_that_do_not_belong_there_are_said_to(session):
    supports = marked("rest/frontal").model_copy(update={"supports": {"pelvis": ((1.0, 2.0),)}})
    assert "supports" in session.judge.told("rest/frontal", {"rest/frontal": supports}).problem


def test_a_later_frame_is_annotated_by_one_vertebra(session):
    session.save(
        Draft(schema_version=1, images={**whole().images, "push/a/2": marked("push/a/2", "T9")}), session.revision
    )
    assert list(read_annotation(session.annotation_path).images["push/a/2"].vertebrae) == ["T9"]
    with pytest.raises(SubjectError, match="the push has 3 frames"):
        session.save(draft(push__a__3=marked("push/a", "T9")), session.revision)


def pedicles_of(image, *levels):
    """Left and right, a quarter of the body's width from its middle, as pixels."""
    quads = drawn(image).named(*levels)
    middles = {name: np.mean(quad, axis=0) for name, quad in quads.items()}
    aside = {name: 0.25 * (np.array(quad[0]) - np.array(quad[1])) for name, quad in quads.items()}
    return {
        name: tuple(tuple(map(float, middles[name] + way)) for way in (aside[name], -aside[name])) for name in quads
    }


def test_pedicles_alone_annotate_a_later_frame_and_are_what_tracking_reads(session):
    pairs = pedicles_of("push/a/2", "T8", "T9")
    pedicles = DraftImage(pedicles=pairs)
    session.save(Draft(schema_version=1, images={**whole().images, "push/a/2": pedicles}), session.revision)
    assert on_disk(session) == {"subject.json", "annotation.json"} and session.judge.missing(session.marks) == []
    subject = read_subject(session.subject.folder)
    push = subject.push("a")
    view = session.radiographs.view("push/a")
    (marked,) = marked_pedicles(subject, push, view)
    assert (marked.frame, marked.vertebrae) == (2, ("T8", "T9"))
    np.testing.assert_allclose(marked.centres_px, list(pairs.values()), atol=1e-3)
    # No corner of that frame was marked: tracking begins where it did.
    assert list(push_corners(subject, push, view)) == [0]
    assert AnnotationSession(session.subject.folder).marks["push/a/2"] == pedicles


def test_a_pedicle_that_is_only_guessed_waits_in_the_draft(session):
    pairs = pedicles_of("rest/frontal", "T8", "T9")
    guessed = marked("rest/frontal").model_copy(update={"pedicles": pairs, "guessed": {"T9": 1}})
    session.save(draft(rest__frontal=guessed), session.revision)
    assert on_disk(session) == {"subject.json", "annotation.draft.json"}
    assert "rest/frontal: one pedicle of T9 is only guessed yet" in " ".join(session.judge.missing(session.marks))
    assert AnnotationSession(session.subject.folder).marks["rest/frontal"].guessed == {"T9": 1}
    # A guess of what is no longer there needs no look.
    gone = guessed.model_copy(update={"pedicles": pedicles_of("rest/frontal", "T8")})
    session.save(draft(rest__frontal=gone), session.revision)
    assert on_disk(session) == {"subject.json", "annotation.json"}
    assert "guessed" not in session.annotation_path.read_text(encoding="utf-8")


def test_pedicles_that_are_swapped_or_outside_are_said_to_be_before_a_fit_reads_them(session):
    (left, right), far = pedicles_of("push/a", "T9")["T9"], (9999.0, 10.0)
    for pair, why in (
        ((right, left), "pedicles.T9: the left one lies right"),
        ((left, far), "pedicles.T9: found a pedicle"),
    ):
        marks = marked("push/a").model_copy(update={"pedicles": {"T9": pair}})
        assert session.judge.told("push/a", {"push/a": marks}).problem.startswith(why)


def test_a_radiograph_that_can_not_be_read_keeps_its_annotation(session):
    session.save(whole(), session.revision)
    (session.subject.folder / "rest/lateral.dcm").write_bytes(b"no DICOM")
    session = AnnotationSession(session.subject.folder)
    assert any(line.startswith("rest/lateral: ") for line in session.judge.missing(session.marks))
    session.save(whole(), session.revision)
    assert on_disk(session) == {"subject.json", "annotation.json"}
    assert set(read_annotation(session.annotation_path).images) == set(ALL)


def test_folders_that_can_not_be_annotated_are_refused_in_a_line(tmp_path, unannotated):
    with pytest.raises(SubjectError, match="no such folder"):
        AnnotationSession(tmp_path / "nowhere")
    (unannotated / "subject.json").unlink()
    with pytest.raises(
        SubjectError, match=r"subject\.json: no such file; write one .*docs/subject-folder\.md"
    ) as refused:
        AnnotationSession(unannotated)
    assert "\n" not in str(refused.value)


def test_a_folder_that_is_not_complete_can_be_annotated_and_says_what_it_lacks(unannotated):
    path = unannotated / "subject.json"
    data = json.loads(path.read_text())
    data |= {"age": None, "height_cm": None}
    data["pushes"][0] |= {"level": None, "forces_n": [0, None, 40]}
    path.write_text(json.dumps(data))
    (unannotated / "rest/frontal.dcm").unlink()
    session = AnnotationSession(unannotated)
    assert session.images == ("rest/lateral", "push/a") and session.absent == ("rest/frontal",)
    lines = session.judge.missing({})
    assert lines[:2] == [
        "rest/frontal: no radiograph in the folder yet",
        "subject.json: not known yet: age, height_cm, pushes[0].level and 1 more",
    ]
    record = session_record(session)
    assert [image["forces"] for image in record["images"]] == [[None], [0.0, None, 40.0]]
    session.save(draft(push__a=marked("push/a")), session.revision)
    assert on_disk(session) == {"subject.json", "annotation.json"}
    data |= {"age": 13, "height_cm": 157}
    data["pushes"][0] |= {"level": 8, "forces_n": [0, 20, 40]}
    path.write_text(json.dumps(data))
    assert "subject.json" not in " ".join(AnnotationSession(unannotated).judge.missing({}))


def test_a_folder_without_any_radiograph_and_an_outer_one_are_refused(unannotated, tmp_path):
    frontal = unannotated / "rest/frontal.dcm"
    outside = tmp_path / "outside.dcm"
    frontal.rename(outside)
    (unannotated / "rest/lateral.dcm").unlink()
    (unannotated / "pushes/a.dcm").unlink()
    with pytest.raises(SubjectError, match="no radiograph to annotate"):
        AnnotationSession(unannotated)
    frontal.symlink_to(outside)
    with pytest.raises(SubjectError, match="leads out of the folder"):
        AnnotationSession(unannotated)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('{"schema_version": 2, "images": {}}', "schema_version"),
        ('{"schema_version": 1, "images": {"rest/frontal": {"vertebrae": {"T13": []}}}}', "T13"),
        ('{"schema_version": 1, "images": {"rest/frontal": {"spine": [[1e9, 0]]}}}', "wanted pixels of the image"),
        ('{"schema_version": 1, "images": {"rest/frontal": {"colour": 1}}}', "unknown key"),
        ('{"schema_version": 1, "images": {}, "images": {}}', "given twice"),
        ("[", "not JSON"),
    ],
)
def test_a_damaged_draft_is_refused_in_a_line(unannotated, text, message):
    (unannotated / "annotation.draft.json").write_text(text, encoding="utf-8")
    with pytest.raises(SubjectError, match=message) as refused:
        AnnotationSession(unannotated)
    assert "annotation.draft.json" in str(refused.value) and "\n" not in str(refused.value)


def test_a_draft_reads_what_it_writes():
    marks = DraftImage(vertebrae={"T1": ((1.0, 2.0), (0.0, 2.0), (0.0, 3.0), (1.0, 3.0))}, spine=((1.5, 2.5),))
    found = parse_draft(json.dumps(draft(rest__frontal=marks, rest__lateral=DraftImage()).record()), "draft")
    assert found.images == {"rest/frontal": marks}


# Files of other programs


@pytest.mark.parametrize("form", ["csv", "slicer"])
def test_corners_go_out_and_come_back(session, form):
    session.save(whole(), session.revision)
    text = exported(session, form).decode()
    assert CANARY not in text
    session.save(draft(), session.revision)
    marks, said = imported(session, {"csv": "a.CSV", "slicer": "a.mrk.json"}[form], text, "rest/frontal")
    assert said == []
    assert {name: image.vertebrae for name, image in marks.items()} == {
        name: image.vertebrae for name, image in whole().images.items()
    }


def test_the_csv_is_as_seen_in_the_image(session):
    session.save(draft(rest__frontal=marked("rest/frontal", "T1", "T2")), session.revision)
    rows = [line.split(",") for line in exported(session, "csv").decode().split()[1:5]]
    places = {row[2]: (float(row[3]), float(row[4])) for row in rows}
    assert places["top_left"][0] < places["top_right"][0] and places["top_left"][1] < places["bottom_left"][1]


def test_an_import_keeps_what_the_file_does_not_hold(session):
    before = marked("rest/frontal", "T1").model_copy(update={"pedicles": {"T1": ((2.0, 1.0), (1.0, 1.0))}})
    session.save(draft(rest__frontal=before), session.revision)
    text = "image,level,corner,x,y\n" + "".join(
        f"other.png,T2,{corner},{x},{y}\n"
        for corner, x, y in [("top_left", 1, 1), ("top_right", 9, 1), ("bottom_right", 9, 9), ("bottom_left", 1, 9)]
    )
    marks, _ = imported(session, "x.csv", text, "rest/frontal")
    # One image of another name is meant for the one in sight.
    assert list(marks) == ["rest/frontal"]
    assert marks["rest/frontal"].pedicles == before.pedicles
    # The patient's left is on the right of this picture.
    assert marks["rest/frontal"].vertebrae == {"T2": ((9.0, 1.0), (1.0, 1.0), (1.0, 9.0), (9.0, 9.0))}


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("x.exe", "", "ends in .csv"),
        ("x.csv", "a,b\n", "^the file: row 1: columns"),
        ("../../x.csv", "image,level,corner,x,y\n", "no corner in it"),
        ("x.json", "[", "the file"),
    ],
)
def test_a_file_that_holds_no_corners_is_refused(session, name, text, message):
    with pytest.raises(SubjectError, match=message) as refused:
        imported(session, name, text, "rest/frontal")
    assert "tmp" not in str(refused.value)


def slicers(per_pixel, *names):
    """Markups of the frontal radiograph as Slicer writes them: (column, row) times a spacing, of no stated unit."""
    quads = drawn("rest/frontal").named(*names)
    # The patient's left, where annotation.json begins, is on the right of this picture.
    labels = [
        f"{name} {corner}" for name in names for corner in ("top_right", "top_left", "bottom_left", "bottom_right")
    ]
    points = [np.append(np.array(place) * per_pixel, 0.0).tolist() for name in names for place in quads[name]]
    control = [{"label": label, "position": point} for label, point in zip(labels, points)]
    entry = {"type": "Fiducial", "coordinateSystem": "LPS", "name": "rest/frontal", "controlPoints": control}
    return json.dumps({"markups": [entry]})


@pytest.fixture
def fine(session, monkeypatch):
    """The session, its radiographs with pixels of 0.2 mm: a vertebra is 30 to 50 of them wide."""
    real = session.radiographs.frames

    def frames(name):
        shown = real(name)[0]
        return [replace(shown, view=replace(shown.view, pixel_spacing=np.array([0.2, 0.2])))]

    monkeypatch.setattr(session.radiographs, "frames", frames)
    return session


# Five pixels of the phantom for one: vertebrae as wide as in a radiograph of 0.2 mm.
@pytest.mark.parametrize(
    ("per_pixel", "factor", "word"), [(5.0, 5.0, "as in pixels"), (1.0, 5.0, "converted by 0.2 mm")]
)
def test_slicers_millimetres_are_told_from_pixels_by_the_vertebrae(fine, per_pixel, factor, word):
    marks, said = imported(fine, "a.mrk.json", slicers(per_pixel, "T5", "T6"), "rest/frontal")
    quads = drawn("rest/frontal").named("T5", "T6")
    for name in ("T5", "T6"):
        np.testing.assert_allclose(marks["rest/frontal"].vertebrae[name], np.array(quads[name]) * factor)
    assert len(said) == 1 and word in said[0]


def test_slicers_corners_of_a_unit_that_cant_be_told_are_refused(session, fine, monkeypatch):
    # A pixel of this phantom is 0.8 mm: as wide as a vertebra is in either.
    monkeypatch.undo()
    text = slicers(1.0, "T5")
    with pytest.raises(
        SubjectError, match=r"does not say whether .* pixels or mm.* mm \(in px\) or .*as CSV in pixels"
    ):
        imported(session, "a.mrk.json", text, "rest/frontal")


def test_slicers_millimetres_need_the_spacing_that_slicer_had(fine, monkeypatch):
    shown = replace(fine.radiographs.frames("rest/frontal")[0], provenance={"pixel spacing": "given imager_pixel_mm"})
    monkeypatch.setattr(fine.radiographs, "frames", lambda name: [shown])
    with pytest.raises(SubjectError, match=r"in mm, but the radiograph has no ImagerPixelSpacing .its pixel: given"):
        imported(fine, "a.mrk.json", slicers(1.0, "T5"), "rest/frontal")


def test_no_unit_is_told_by_a_pixel_that_nobody_gave(unannotated):
    path = unannotated / "rest/frontal.dcm"
    dataset = pydicom.dcmread(path)
    del dataset.ImagerPixelSpacing
    dataset.save_as(path)
    values, scale = read_json(unannotated / "subject.json"), {"rest/frontal": {"vertebra": "L1", "width_mm": 42}}
    (unannotated / "subject.json").write_text(json.dumps(values | {"xray": {"scale": scale}}), encoding="utf-8")
    session = AnnotationSession(unannotated)
    assert [session.radiographs.has_mm(name) for name in ALL] == [False, True, True]
    # By 0.15 mm a pixel these would be pixels, or millimetres.
    for per_pixel in (5.0, 1.0):
        with pytest.raises(
            SubjectError, match=r"the radiograph not how many mm a pixel has; .* or add 'spinestiffUnit': 'pixel'"
        ):
            imported(session, "a.mrk.json", slicers(per_pixel, "T5", "T6"), "rest/frontal")
    stated = slicers(1.0, "T5", "T6").replace('"type"', '"spinestiffUnit": "pixel", "type"')
    marks, said = imported(session, "a.mrk.json", stated, "rest/frontal")
    assert set(marks["rest/frontal"].vertebrae) == {"T5", "T6"} and said == []


def test_nothing_to_export_is_said(session):
    with pytest.raises(SubjectError, match="nothing to export"):
        exported(session, "csv")


def test_a_save_that_failed_can_be_tried_again(session, monkeypatch):
    from spinestiff.annotate import session as module

    session.save(draft(rest__frontal=marked("rest/frontal", "T1")), session.revision)
    with monkeypatch.context() as patch:
        patch.setattr(module, "write_annotation", lambda *_: (_ for _ in ()).throw(SubjectError("no space")))
        with pytest.raises(SubjectError, match="no space"):
            session.save(whole(), session.revision)
    # The draft was written before that, by this very program.
    assert session.save(whole(), session.revision) == session.revision
    assert set(read_annotation(session.annotation_path).images) == set(ALL)


def test_radiographs_from_other_sides_are_offered(unannotated):
    """Of a view the one with the least force is needed, and three vertebrae are enough."""
    record = json.loads((unannotated / "subject.json").read_text(encoding="utf-8"))
    record["pushes"][0]["views"] = [{"id": "side", "kind": "lateral", "files": "pushes/b.dcm", "frames": [2, 1]}]
    (unannotated / "subject.json").write_text(json.dumps(record), encoding="utf-8")
    view = lateral_view(shape=(640, 448), pixel=MM * 1500.0 / 1340.0)
    pixels = [sixteen_bit(phantom(kind="lateral", bend=bend).pixels) for bend in (-20.0, -18.0)]
    write_radiographs(unannotated / "pushes" / "b.dcm", np.stack(pixels), view)
    session = AnnotationSession(unannotated)
    assert session.images[-2:] == ("push/a/2/side", "push/a/1/side")
    images = {one["name"]: one for one in session_record(session)["images"]}
    assert images["push/a/1/side"] == {
        "name": "push/a/1/side", "title": "Push a, frame 1, view side", "kind": "lateral", "forces": [20.0],
        "roles": ("training",),
    }  # fmt: skip
    one, two = (session.radiographs.frames(f"push/a/{frame}/side")[0].pixels for frame in (1, 2))
    assert not np.array_equal(one, two)
    assert "push/a/1/side: no vertebra marked yet" in session.judge.missing({})
    assert not any(line.startswith("push/a/2/side") for line in session.judge.missing({}))
    marks = drawn("rest/lateral").named()
    few, enough = (DraftImage(vertebrae={name: marks[name] for name in list(marks)[:n]}) for n in (2, 3))
    assert "push/a/1/side: 2 vertebrae, wanted at least 3" in session.judge.missing({"push/a/1/side": few})
    assert not any("side" in line for line in session.judge.missing({"push/a/1/side": enough}))
    (unannotated / "pushes" / "b.dcm").unlink()
    assert AnnotationSession(unannotated).absent == ("push/a/1/side",)


@pytest.mark.parametrize(
    ("forces", "needed"),
    [([0, 20, None], [False, True]), ([0, None, 40], [True, False]), ([0, None, None], [False, False])],
)
def test_marks_of_a_radiograph_whose_force_is_open_are_not_asked_for(unannotated, forces, needed):
    record = json.loads((unannotated / "subject.json").read_text(encoding="utf-8"))
    record["pushes"][0] |= {
        "views": [{"id": "side", "kind": "lateral", "files": "pushes/b.dcm", "frames": [2, 1]}], "forces_n": forces,
    }  # fmt: skip
    (unannotated / "subject.json").write_text(json.dumps(record), encoding="utf-8")
    view = lateral_view(shape=(640, 448), pixel=MM * 1500.0 / 1340.0)
    pixels = [sixteen_bit(phantom(kind="lateral", bend=bend).pixels) for bend in (-20.0, -18.0)]
    write_radiographs(unannotated / "pushes" / "b.dcm", np.stack(pixels), view)
    names = ("push/a/2/side", "push/a/1/side")
    session = AnnotationSession(unannotated)
    assert session.views == dict(zip(names, needed))
    asked = [line for line in session.judge.missing({}) if line.partition(":")[0] in names]
    assert asked == [f"{name}: no vertebra marked yet" for name, need in zip(names, needed) if need]
    (side,) = [one for one in inspect(unannotated) if one.image == "push/a, view side"]
    assert side.missing == tuple(f"no corners of {n} in annotation.json" for n, need in zip(names, needed) if need)


def test_a_vertebra_that_sets_the_millimetres_can_be_marked_first(unannotated):
    for name in ("rest/frontal", "push/a"):
        path = unannotated / ("rest/frontal.dcm" if name == "rest/frontal" else "pushes/a.dcm")
        dataset = pydicom.dcmread(path)
        del dataset.ImagerPixelSpacing
        dataset.save_as(path)
    (unannotated / "subject.json").write_text(json.dumps(read_json(unannotated / "subject.json") | {"xray": {"scale": {
        "rest/frontal": {"vertebra": "L1", "width_mm": 42}, "push/a": {"vertebra": "L2", "width_mm": 44},
        "rest/lateral": {"vertebra": "L1", "width_mm": 30}}}}), encoding="utf-8")  # fmt: skip
    session = AnnotationSession(unannotated)
    session.save(whole(), session.revision)
    assert session.judge.missing(session.marks) == []
    # What the file tells counts where it tells something.
    spacing = session.radiographs.frames("rest/lateral")[0].view.pixel_spacing
    np.testing.assert_allclose(spacing, MM * 1500.0 / 1340.0, rtol=1e-6)
    # Now that it is marked, its millimetres are those of the vertebra.
    subject = read_subject(unannotated)
    quad = np.array(subject.annotation.images["rest/frontal"].vertebrae["L1"])
    width = np.linalg.norm(quad[[0, 3]].mean(axis=0) - quad[[1, 2]].mean(axis=0))
    view = read_rest(subject, "frontal").view
    np.testing.assert_allclose(view.pixel_spacing / view.magnification * width, 42.0, rtol=1e-6)


def test_such_a_picture_may_have_pixels_that_are_not_square(unannotated):
    path = unannotated / "rest/frontal.dcm"
    dataset = pydicom.dcmread(path)
    del dataset.ImagerPixelSpacing
    dataset.PixelAspectRatio = [6, 5]
    dataset.save_as(path)
    scale = {"rest/frontal": {"vertebra": "L1", "width_mm": 42}}
    (unannotated / "subject.json").write_text(
        json.dumps(read_json(unannotated / "subject.json") | {"xray": {"scale": scale}}), encoding="utf-8"
    )
    (frame,) = AnnotationSession(unannotated).radiographs.frames("rest/frontal")
    across, down = frame.view.pixel_spacing
    np.testing.assert_allclose(down / across, 1.2, rtol=1e-6)


def test_an_image_that_the_subject_has_not_is_told_of_the_file(session):
    corners = [("top_left", 1, 1), ("top_right", 9, 1), ("bottom_right", 9, 9), ("bottom_left", 1, 9)]
    rows = [f"{name},T2,{corner},{x},{y}" for name in ("rest/frontal", "nobody") for corner, x, y in corners]
    with pytest.raises(SubjectError, match=r"^mine\.csv: images\.nobody: unknown image"):
        imported(session, "mine.csv", "\n".join(["image,level,corner,x,y", *rows]), "rest/frontal")
