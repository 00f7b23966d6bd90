"""A subject whose own bones stand in for the template."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from spinestiff.anatomy.files import read_torso, write_torso
from spinestiff.anatomy.template import template_torso
from spinestiff.errors import SubjectError
from spinestiff.study.runner import ALL_STEPS
from spinestiff.study.starting_torso import starting_torso
from spinestiff.study.visit import open_visit
from spinestiff.subject.folder import read_subject


def point_at(folder, name):
    record = json.loads((folder / "subject.json").read_text())
    (folder / "subject.json").write_text(json.dumps(record | {"torso": name}))
    return record["height_cm"]


def test_the_own_torso_is_what_is_shaped_and_an_input(subject):
    height = point_at(subject, "torso/own.npz")
    (subject / "torso").mkdir()
    own = template_torso(0.97 * height)
    write_torso(subject / "torso" / "own.npz", own)
    visit = open_visit(subject)
    assert visit.subject.torso_path == subject / "torso" / "own.npz"
    assert "torso/own.npz" in ALL_STEPS["personalise"].inputs(visit)
    np.testing.assert_array_equal(starting_torso(visit).vertebra_boxes, own.vertebra_boxes)


def test_without_one_it_is_the_template(subject):
    visit = open_visit(subject)
    assert visit.subject.torso_path is None
    assert starting_torso(visit).height_cm == pytest.approx(visit.subject.record.height_cm)


def test_torsos_that_are_not_the_subjects_are_refused(subject):
    height = point_at(subject, "own.npz")
    with pytest.raises(SubjectError, match=r"own.npz: no such file; wanted the torso.npz"):
        read_subject(subject)
    write_torso(subject / "own.npz", template_torso(min(1.25 * height, 200.0)))
    with pytest.raises(SubjectError, match=r"is of a body of .* cm, but subject.json says"):
        starting_torso(open_visit(subject))
    few = read_torso(subject / "own.npz")
    write_torso(subject / "own.npz", replace(few, bone_names=(*few.bone_names[:-1], "tail"), height_cm=height))
    with pytest.raises(SubjectError, match="49"):
        starting_torso(open_visit(subject))
    point_at(subject, "../own.npz")
    with pytest.raises(SubjectError, match="inside the subject folder"):
        read_subject(subject)
