"""When the steps run, and when they are redone: only what was made from something that changed."""

from __future__ import annotations

import errno
import os
from dataclasses import replace
from pathlib import Path

import pytest

from spinestiff import __version__
from spinestiff.errors import EquilibriumError, FitError, OptionError, RadiographError, SubjectError
from spinestiff.files import file_digest, read_json, write_json
from spinestiff.study.runner import ALL_STEPS, STEPS, Step, run_steps
from spinestiff.study.visit import Settings, open_visit
from spinestiff.subject.folder import read_subject
from spinestiff.subject.outcome_parts import OUTCOME_VERSION
from spinestiff.subject.program import program, program_of_numbers
from spinestiff.subject.run_record import input_digest, record_step, step_record

UP_TO_DATE = [f"{step}: up to date" for step in STEPS]
AFTER = {"estimate": ["estimate", "assess", "report"], "personalise": ["personalise", "estimate", "assess", "report"]}


def digests(folder):
    return {p.relative_to(folder).as_posix(): file_digest(p) for p in sorted(folder.rglob("*")) if p.is_file()}


def truth_of(subject):
    return subject.with_name("girl.truth.json")


def opened(subject, **settings):
    return open_visit(subject, Settings(**{"mesh": "coarse", **settings}), truth_of(subject))


def edited(subject, name, change):
    content = read_json(subject / name)
    change(content)
    write_json(subject / name, content)


def annotate_anew(subject):
    def move(content):
        content["images"]["push/main"]["vertebrae"]["T7"][0][0] += 0.25

    edited(subject, "annotation.json", move)


@pytest.fixture
def dry():
    """Run steps that only leave a new mark on what they write; ``dry(visit, ...)`` is ``run_steps``."""
    marks = []

    def marking(step):
        def run(visit, say):
            marks.append(step)
            for name in step.outputs(visit):
                visit.file(name).write_text(f"{len(marks)}")

        return replace(step, run=run)

    known = {name: marking(step) for name, step in ALL_STEPS.items()}

    def run(visit, wanted=STEPS, observer=None, force=False):
        return run_steps(visit, wanted, observer, force, known)

    return run


def test_a_folder_that_can_not_be_written_is_refused_before_any_work(subject, dry, monkeypatch):
    def refuse(self, *args, **kwargs):
        raise OSError(errno.EROFS, "x", str(self))

    visit, before, lines = opened(subject), digests(subject), []
    monkeypatch.setattr(Path, "touch", refuse)
    with pytest.raises(
        SubjectError, match=r"results: can't be written \(the file system is read-only\), but results go"
    ):
        dry(visit, observer=lines.append, force=True)
    assert digests(subject) == before and lines == []
    # Where nothing is to be done nothing has to be written.
    assert run_steps(visit, ("track",), lines.append) == []
    monkeypatch.undo()
    assert dry(visit, force=True) == list(STEPS)


# What is recorded


def test_the_record_of_a_run(finished):
    run = read_json(finished.folder / "results" / "run.json")
    assert run["version"] == __version__
    pages = {"report", "view"}
    assert {step["program"] for name, step in run["steps"].items() if name not in pages} == {program_of_numbers()}
    assert {run["steps"][name]["program"] for name in pages} == {program()}
    # The report writes the view as well.
    assert set(run["steps"]) == {*STEPS, "view"}
    of_subject = {f"subject.json: {part}" for part in ("X-ray geometry", "frames")}
    pushes = {"pushes/main.dcm", "pushes/second.dcm"}
    assert set(run["steps"]["track"]["inputs"]) == {*of_subject, "annotation.json: pushes", *pushes}
    assert set(run["steps"]["personalise"]["inputs"]) >= {
        "rest/frontal.dcm", "rest/lateral.dcm", "annotation.json: rest", "subject.json: body",
    }  # fmt: skip
    assert set(run["steps"]["assess"]["inputs"]) >= {"results/estimate.json", "results/torso.npz"}
    subject = read_subject(finished.folder)
    for record in run["steps"].values():
        assert record["seconds"] >= 0.0
        for name, digest in {**record["inputs"], **record["outputs"]}.items():
            assert digest == input_digest(subject, name), name
    assert run["steps"]["estimate"]["seconds"] > 0.1
    assert run["steps"]["estimate"]["cpu_seconds"] > 0.1
    assert run["steps"]["personalise"]["settings"] == {"mesh": "coarse"}
    assert run["steps"]["estimate"]["settings"]["method"] == "weighed"
    assert run["steps"]["estimate"]["settings"]["parameters"] == ["lateral_bending", "tissue"]
    assert run["steps"]["assess"]["settings"] == {"truth": file_digest(finished.truth)}


def test_every_result_says_its_form(finished):
    paths = [path for path in (finished.folder / "results").glob("*.json") if path.name != "run.json"]
    assert len(paths) == 6
    for path in paths:
        assert read_json(path)["schema_version"] == OUTCOME_VERSION, path.name


def test_every_step_says_what_it_does(finished):
    assert "track: push 'main': 4 of 4 frames" in finished.lines
    assert any(line.startswith("personalise: corner sd 16.00 mm") for line in finished.lines)
    first = "estimate: evaluation 0: lateral_bending 0.07, tissue 0.04: RMSE"
    assert any(line.startswith(first) for line in finished.lines)
    assert {line.partition(":")[0] for line in finished.lines} == set(STEPS)


def test_own_files_of_the_body_are_inputs(subject):
    """Bones and a skin scan of the subject's own count for the shape, rest radiographs only as far as there are any."""
    shape = ALL_STEPS["personalise"]
    assert "rest/lateral.dcm" in shape.inputs(open_visit(subject))
    (subject / "own.npz").write_bytes(b"torso")
    (subject / "scan.stl").write_bytes(b"solid")
    scan = {"file": "scan.stl", "unit": "cm", "axes": {"left": "+x", "up": "+z", "front": "-y"}}
    edited(subject, "subject.json", lambda content: content.update(torso="own.npz", skin_scan=scan))
    edited(subject, "annotation.json", lambda content: content["images"].pop("rest/lateral"))
    (subject / "rest" / "lateral.dcm").unlink()
    visit = open_visit(subject)
    assert {"own.npz", "scan.stl", "rest/frontal.dcm"} <= set(shape.inputs(visit))
    assert "rest/lateral.dcm" not in shape.inputs(visit)
    assert not {"own.npz", "scan.stl"} & set(ALL_STEPS["track"].inputs(visit))
    assert "skin_scan.png" in shape.outputs(visit)


def test_refits_are_an_input_of_the_report_while_they_are_of_this_estimate(subject):
    report, visit = ALL_STEPS["report"], open_visit(subject)
    assert "results/sensitivity.json" not in report.inputs(visit)
    for name in ("sensitivity.json", "sensitivity.png"):
        visit.file(name).write_bytes(b"{}")
    inputs = ALL_STEPS["sensitivity"].inputs(visit)
    assert {"results/estimate.json", "results/tracked.json", "results/torso.npz"} <= set(inputs)
    outputs = [visit.file(name) for name in ALL_STEPS["sensitivity"].outputs(visit)]
    record_step(visit.subject, "sensitivity", step_record(visit.subject, inputs, {}), outputs)
    assert {"results/sensitivity.json", "results/sensitivity.png"} <= set(report.inputs(visit))
    edited(subject, "results/estimate.json", lambda content: content.update(notes=["made again"]))
    assert "results/sensitivity.json" not in report.inputs(visit)


# When they are redone


def test_a_step_is_told_when_all_of_it_is_to_be_made_anew(subject):
    asked = []
    step = Step(lambda visit, say: asked.append(visit.settings.redo), (), (), (), ())
    visit, known = open_visit(subject), {"new": step}
    for force in (False, True, False):
        run_steps(visit, ("new",), force=force, known=known)
    assert asked == [False, True]
    assert not visit.settings.redo


def test_nothing_changed_nothing_is_redone(subject, dry):
    before = digests(subject)
    for path in subject.rglob("*"):
        os.utime(path)  # younger files with the same content are no change
    lines = []
    assert dry(opened(subject), observer=lines.append) == []
    assert lines == UP_TO_DATE
    assert digests(subject) == before


def test_a_new_annotation_has_tracking_and_what_follows_redone(subject, dry):
    annotate_anew(subject)
    assert dry(opened(subject)) == ["track", "response", *AFTER["estimate"]]
    lines = []
    assert dry(opened(subject), observer=lines.append) == []
    assert lines == UP_TO_DATE


def set_height(content):
    content["height_cm"] += 1.0


def set_role(content):
    content["pushes"][0]["roles"] = ["unused", "training", "unused", "validation"]


def set_prior(content):
    content["priors"] = {"force_scale": 0.01}


def set_parameters(content):
    content["parameters"] = ["lateral_bending@thoracic", "lateral_bending@lumbar", "tissue"]


def set_population(content):
    content["population"] = "koutras2025"


def set_force(content):
    content["pushes"][0]["forces_n"][1] += 1.0


def set_id(content):
    content["id"] = "another"


def set_age(content):
    content["age"] += 1.0


def set_distance(content):
    content["xray"]["source_detector_mm"] = 1499.0


def move_corner(image):
    def move(content):
        content["images"][image]["vertebrae"]["T7"][0][0] += 0.25

    return move


@pytest.mark.parametrize(
    ("name", "change", "redone"),
    [
        ("subject.json", set_height, AFTER["personalise"]),
        ("subject.json", set_role, AFTER["estimate"]),
        ("subject.json", set_prior, ["response", *AFTER["estimate"]]),
        ("subject.json", set_parameters, AFTER["estimate"]),
        ("subject.json", set_population, AFTER["estimate"]),
        ("subject.json", set_force, ["response", *AFTER["estimate"]]),
        ("subject.json", set_age, AFTER["personalise"]),
        ("subject.json", set_id, ["report"]),
        ("subject.json", set_distance, ["track", "response", *AFTER["personalise"]]),
        ("annotation.json", move_corner("rest/frontal"), ["response", *AFTER["personalise"]]),
        ("annotation.json", move_corner("push/second"), ["track", "response", *AFTER["estimate"]]),
    ],
    ids=["height", "role", "priors", "parameters", "population", "force", "age", "id", "geometry", "rest", "push"],
)
def test_a_change_redoes_what_uses_it_and_what_follows(subject, dry, name, change, redone):
    edited(subject, name, lambda content: content.setdefault("xray", {}) if name == "subject.json" else None)
    dry(opened(subject))
    edited(subject, name, change)
    assert dry(opened(subject)) == redone
    assert dry(opened(subject)) == []


def test_changed_code_has_all_redone_and_says_why(subject, dry, monkeypatch):
    for name in ("program", "program_of_numbers"):
        monkeypatch.setattr(f"spinestiff.study.runner.{name}", lambda: "0.1.0+another")
    lines = []
    assert dry(opened(subject), observer=lines.append) == list(STEPS)
    assert lines[0] == f"track: was made by spinestiff {program_of_numbers()}, this is 0.1.0+another; made again"
    assert dry(opened(subject)) == []


def test_changed_sentences_and_pages_have_only_pages_and_pictures_redone(subject, dry, monkeypatch):
    wanted = tuple(ALL_STEPS)
    dry(opened(subject), wanted)
    assert dry(opened(subject), wanted) == []
    monkeypatch.setattr("spinestiff.study.runner.program", lambda: "0.1.0+another")
    # The report writes the view as well.
    assert dry(opened(subject), wanted) == ["frames", "sensitivity", "report"]


def test_frames_follow_the_roles(subject, dry):
    assert dry(opened(subject), ("track", "frames")) == ["frames"]
    edited(subject, "subject.json", set_role)
    assert dry(opened(subject), ("track", "frames")) == ["frames"]
    edited(subject, "subject.json", set_height)
    assert dry(opened(subject), ("track", "frames")) == []


def test_a_setting_has_its_step_and_what_follows_redone(subject, dry):
    assert dry(opened(subject, method="paper")) == AFTER["estimate"]
    assert dry(opened(subject, method="paper", orientation="covariance")) == AFTER["estimate"]
    assert dry(opened(subject, mesh="fine")) == AFTER["personalise"]


def test_another_truth_touches_the_comparison_only(subject, dry, tmp_path):
    other = tmp_path / "other.truth.json"
    write_json(other, {"ratios": {"lateral_bending": 0.3, "tissue": 0.05}})
    assert dry(open_visit(subject, Settings(mesh="coarse"), other)) == ["assess", "report"]
    assert dry(open_visit(subject, Settings(mesh="coarse"), other)) == []


def test_without_a_truth_what_was_compared_with_one_stays(subject, dry):
    before = digests(subject)
    lines = []
    assert dry(open_visit(subject, Settings(mesh="coarse")), observer=lines.append) == []
    assert lines == UP_TO_DATE
    assert digests(subject) == before


def test_what_is_redone_without_a_truth_is_compared_with_none(subject, dry):
    annotate_anew(subject)
    assert dry(open_visit(subject, Settings(mesh="coarse"))) == ["track", "response", *AFTER["estimate"]]
    run = read_json(subject / "results" / "run.json")["steps"]
    assert run["assess"]["settings"] == run["report"]["settings"] == {"truth": None}
    assert dry(open_visit(subject, Settings(mesh="coarse"))) == []
    assert dry(opened(subject)) == ["assess", "report"]


@pytest.mark.parametrize(
    ("name", "redone"),
    [
        ("tracked.json", ["track", "response", *AFTER["estimate"]]),
        ("response.json", ["response", "report"]),
        ("torso.npz", AFTER["personalise"]),
        ("personalised.json", AFTER["personalise"]),
        ("estimate.json", AFTER["estimate"]),
        ("training.npz", AFTER["estimate"]),
        ("assessment.json", ["assess", "report"]),
        ("comparison.json", ["assess", "report"]),
        ("predictions.npz", ["assess", "report"]),
        ("report.html", ["report"]),
        ("view.html", ["report"]),
    ],
)
@pytest.mark.parametrize("how", ["deleted", "damaged"])
def test_a_lost_or_damaged_result_is_made_again(subject, dry, name, redone, how):
    path = subject / "results" / name
    path.unlink() if how == "deleted" else path.write_text("?")
    lines = []
    assert dry(opened(subject), observer=lines.append) == redone
    assert f"{redone[0]}: results/{name} is not as it was written; made again" in lines
    assert len([line for line in lines if "made again" in line]) == 1


@pytest.mark.parametrize("text", ["", "{}", "null", "[]", '{"schema_version": 99}'])
def test_whatever_was_done_to_a_result_it_is_made_again(subject, dry, text):
    (subject / "results" / "estimate.json").write_text(text)
    lines = []
    assert dry(opened(subject), observer=lines.append) == AFTER["estimate"]
    assert lines[3:4] == ["estimate: results/estimate.json is not as it was written; made again"]


@pytest.mark.parametrize("text", ["{}", "null", "[]", "{", '{"schema_version": 99, "version": "1", "steps": {}}'])
def test_a_damaged_record_redoes_all(subject, dry, text):
    (subject / "results" / "run.json").write_text(text)
    assert dry(opened(subject)) == list(STEPS)
    assert dry(opened(subject)) == []


def test_the_view_needs_no_report(subject, dry):
    """It is there once the report is, and made again from the predictions alone."""
    assert dry(opened(subject), ("view",)) == []
    (subject / "results" / "view.html").unlink()
    (subject / "results" / "report.html").unlink()
    assert dry(opened(subject), ("view",)) == ["view"]
    assert dry(opened(subject), ("view",)) == []
    assert dry(opened(subject), ("assess",), force=True) == ["assess"]
    assert dry(opened(subject), ("view",)) == ["view"]


def test_redo_runs_what_was_asked(subject, dry):
    assert dry(opened(subject), ("estimate",), force=True) == ["estimate"]
    assert dry(opened(subject), ("assess", "estimate"), force=True) == ["estimate", "assess"]


@pytest.mark.parametrize(
    ("change", "step", "words"),
    [
        (annotate_anew, "estimate", r"tracked\.json: was made before annotation\.json: pushes changed"),
        (lambda s: edited(s, "subject.json", set_height), "assess",
         r"torso\.npz: was made before subject\.json: body changed; run spinestiff personalise again"),
        (lambda s: edited(s, "subject.json", set_role), "report",
         r"estimate\.json: was made before subject\.json: roles changed; run spinestiff estimate again"),
    ],
    ids=["annotation", "height", "role"],
)  # fmt: skip
def test_results_made_from_something_else_are_refused(subject, dry, change, step, words):
    """What lies between the step asked for and the change has to be redone first."""
    change(subject)
    before = digests(subject)
    with pytest.raises(SubjectError, match=words):
        dry(opened(subject), (step,))
    assert digests(subject) == before


def test_an_edited_result_is_refused_by_single_steps(subject, dry):
    path = subject / "results" / "tracked.json"
    path.write_text(path.read_text(encoding="utf-8") + " ", encoding="utf-8")
    with pytest.raises(SubjectError, match=r"tracked\.json: was changed after spinestiff track had written it"):
        dry(opened(subject), ("assess",))
    assert dry(opened(subject), ("track", "estimate", "assess")) == ["track", "estimate", "assess"]


# What fails


@pytest.mark.parametrize("error", [FitError("no minimum"), EquilibriumError("no equilibrium")])
def test_a_failing_estimate_keeps_the_earlier_one(subject, error):
    before = digests(subject)

    def fails(visit, say):
        raise error

    known = {**ALL_STEPS, "estimate": replace(ALL_STEPS["estimate"], run=fails)}
    with pytest.raises(type(error), match=str(error)):
        run_steps(opened(subject), force=True, steps=("estimate", "assess"), known=known)
    assert digests(subject) == before


@pytest.mark.parametrize(
    ("lost", "step", "maker"),
    [
        ("tracked.json", "estimate", "track"),
        ("response.json", "report", "response"),
        ("torso.npz", "estimate", "personalise"),
        ("personalised.json", "estimate", "personalise"),
        ("estimate.json", "assess", "estimate"),
        ("training.npz", "assess", "estimate"),
        ("assessment.json", "report", "assess"),
        ("predictions.npz", "view", "assess"),
    ],
)
def test_a_missing_step_is_named(subject, lost, step, maker):
    (subject / "results" / lost).unlink()
    words = rf"{lost}: no such file; run the step that makes it first \(spinestiff {maker} {subject}\)"
    with pytest.raises(SubjectError, match=words):
        run_steps(opened(subject), (step,))


def test_a_step_that_there_is_not_is_refused(subject):
    with pytest.raises(OptionError, match="no step 'estmate'; wanted some of track, "):
        run_steps(opened(subject), ("estmate",))


def test_a_damaged_radiograph_keeps_all_results(subject):
    before = digests(subject / "results")
    path = subject / "pushes" / "second.dcm"
    path.write_bytes(path.read_bytes()[:-5000])
    with pytest.raises(RadiographError, match=r"second\.dcm"):
        run_steps(opened(subject))
    assert digests(subject / "results") == before


def test_no_step_without_a_frame_to_train_on(subject, dry):
    edited(subject, "subject.json", lambda content: [push.pop("roles") for push in content["pushes"]])
    with pytest.raises(SubjectError, match=r"no frame has the role training; .*--write sets them"):
        dry(opened(subject))
    assert dry(opened(subject), ("track",)) == []
