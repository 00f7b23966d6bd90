"""A visit: what may be asked of the steps, and what earlier ones left for later ones."""

from __future__ import annotations

import numpy as np
import pytest

from results import altered
from spinestiff.anatomy.files import read_torso
from spinestiff.errors import SubjectError, TorsoError
from spinestiff.estimation.fitted import METHODS
from spinestiff.files import read_json, write_json
from spinestiff.study.predictions import Model
from spinestiff.study.steps import estimated_model
from spinestiff.study.visit import Manner, Settings, load_pushes, open_visit
from spinestiff.subject.estimate_outcome import Estimate
from spinestiff.subject.outcomes import Tracked
from spinestiff.subject.run_record import read_outcome


@pytest.mark.parametrize(
    "wrong", [{"mesh": "huge"}, {"method": "guess"}, {"orientation": "upright"}, {"population": "everyone"}]
)
def test_unknown_settings_are_refused(wrong):
    ((what, value),) = wrong.items()
    with pytest.raises(SubjectError, match=f"unknown {what} '{value}'; wanted one of "):
        Settings(**wrong)


@pytest.mark.parametrize(
    ("priors", "words"),
    [
        ({"force": 0.1}, r"subject\.json: priors\.force: unknown prior; wanted one of annotation_mm, "),
        ({"force_scale": -0.1}, r"subject\.json: priors\.force_scale: found -0\.1, wanted "),
        ({"force_scale": "2 %"}, r"subject\.json: priors\.force_scale: "),
        (
            {"frame_shoulder_mm": 4},
            r"json: priors: prior frame_shoulder_mm 4 is a part of shoulder_mm 3; wanted less$",
        ),
    ],
)
def test_impossible_priors_are_refused_before_any_step(subject, priors, words):
    content = read_json(subject / "subject.json")
    write_json(subject / "subject.json", {**content, "priors": priors})
    with pytest.raises(SubjectError, match=words) as caught:
        open_visit(subject)
    assert str(caught.value).startswith(f"{subject / 'subject.json'}: ") and "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ({"parameters": ["lateral_bending@neck"]}, r"subject\.json: parameters: unknown part 'neck' in "),
        ({"parameters": ["tissue", "tissue"]}, r"subject\.json: parameters: .*'tissue' is named twice"),
        ({"parameters": []}, r"subject\.json: parameters: "),
        (
            {"population": "everyone"},
            r"subject\.json: population: unknown population 'everyone'; known are koutras2025$",
        ),
        (
            {"population": "koutras2025", "parameters": ["lateral_bending@lumbar", "tissue"]},
            r"population 'koutras2025' is of the lateral bending of the whole spine; the ratios to fit leave 11 of 17 "
            r"levels at their default; estimate the whole spine's bending, or ask for no population$",
        ),
    ],
)
def test_impossible_parameters_are_refused_before_any_step(subject, content, words):
    write_json(subject / "subject.json", {**read_json(subject / "subject.json"), **content})
    with pytest.raises(SubjectError, match=words) as caught:
        open_visit(subject)
    assert "\n" not in str(caught.value)


def test_what_is_asked_goes_before_subject_json_and_that_before_the_usual(subject):
    assert (open_visit(subject).parameters, open_visit(subject).population) == (("lateral_bending", "tissue"), None)
    chosen = {"parameters": ["lateral_bending@levels", "tissue"], "population": "koutras2025"}
    write_json(subject / "subject.json", {**read_json(subject / "subject.json"), **chosen})
    visit = open_visit(subject)
    assert (visit.parameters, visit.population) == (("lateral_bending@levels", "tissue"), "koutras2025")
    visit = open_visit(subject, Settings(parameters=("everything",), population="none"))
    assert (visit.parameters, visit.population) == (("everything",), None)
    with pytest.raises(SubjectError, match="population 'koutras2025' with the paper's method, which knows no priors"):
        open_visit(subject, Settings(method="paper"))
    assert open_visit(subject, Settings(method="paper", population="none")).population is None
    with pytest.raises(TorsoError, match="unknown stiffness parameter 'stiffness'"):
        Settings(parameters=("stiffness",))


def test_a_truth_may_be_named_by_text(finished):
    assert open_visit(str(finished.folder), truth=str(finished.truth)).truth == finished.truth


def test_ratios_are_read_back(finished):
    visit = open_visit(finished.folder)
    pushes = load_pushes(visit, visit.manner)
    model = estimated_model(read_outcome(visit.subject, Estimate), pushes)
    assert model.ratios.as_dict() == finished.fit.ratios.as_dict()
    assert model.known == Model.of(finished.fit).known
    torso = read_torso(finished.folder / "results" / "torso.npz")
    np.testing.assert_array_equal(pushes.torso.rest_pose.bone_positions, torso.rest_pose.bone_positions)


@pytest.mark.parametrize("orientation", ["procrustes", "covariance"])
def test_trials_keep_the_orientation_that_was_asked(finished, orientation):
    assert load_pushes(open_visit(finished.folder), Manner(orientation)).orientation == orientation


def test_the_papers_method_holds_the_pelvis_level_and_no_population(finished):
    visit = open_visit(finished.folder)
    weighed, paper = (load_pushes(visit, Manner("procrustes", method, "koutras2025")).known for method in METHODS)
    assert (weighed.population, paper.population) == ("koutras2025", None)
    assert weighed.priors.obliquity_deg > paper.priors.obliquity_deg == 0.0


@pytest.mark.parametrize(
    ("damage", "field"),
    [
        (lambda entry: entry.update(frames=[]), "frames: found none"),
        (lambda entry: entry.pop("view"), r"pushes\.main\.view: missing"),
        (lambda entry: entry["frames"][1].pop("quality"), r"pushes\.main\.frames\[1\]\.quality: missing"),
        (lambda entry: entry["frames"][1]["quality"].pop(), r"frames\[1\]\.quality: \d+ for \d+ vertebrae"),
        (lambda entry: entry["frames"][1].update(corners_px="none"), r"frames\[1\]\.corners_px: "),
    ],
)
def test_a_tracked_file_that_is_not_whole_is_refused(subject, damage, field):
    altered(subject, Tracked, lambda content: damage(content["pushes"]["main"]))
    with pytest.raises(SubjectError, match=rf"tracked\.json: .*{field}.*; run spinestiff track {subject} again"):
        load_pushes(open_visit(subject), Manner())


def test_a_tracked_file_of_other_frames_is_refused(subject):
    altered(subject, Tracked, lambda content: content["pushes"]["main"]["frames"].pop())
    with pytest.raises(SubjectError, match="push 'main': 3 tracked frames for 4 forces_n; run spinestiff track again"):
        load_pushes(open_visit(subject), Manner())


def test_a_torso_is_read_only_as_it_was_written(subject):
    visit = open_visit(subject)
    path = visit.file("torso.npz")
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2])
    with pytest.raises(SubjectError, match=rf"torso\.npz: was changed after .*; run spinestiff personalise {subject}"):
        visit.torso()
    path.unlink()
    with pytest.raises((SubjectError, TorsoError), match="no such file; run the step that makes it first"):
        visit.torso()
