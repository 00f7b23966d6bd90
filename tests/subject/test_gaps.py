"""A subject that is not complete: what is missing is named a line each, and nothing but looking is done with it."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from spinestiff.errors import SubjectError, SubjectGaps
from spinestiff.subject.folder import read_subject, read_unannotated
from spinestiff.subject.gaps import OPTIONS, PERSON, PUSH, check_open_record, gaps_of, read_open_record
from spinestiff.subject.inspection import inspect
from spinestiff.subject.records import PushRecord, SubjectRecord

DOCUMENT = (Path(__file__).parents[2] / "docs/subject-folder.md").read_text(encoding="utf-8")
SUBJECT = json.loads(re.findall(r"```json\n(.*?)```", DOCUMENT, re.S)[0])


@pytest.fixture
def folder(tmp_path):
    def make(**changes):
        push = {key: changes.pop(key) for key in list(changes) if key in PushRecord.model_fields and key != "id"}
        data = {**SUBJECT, **changes, "pushes": [{**SUBJECT["pushes"][0], **push}]}
        (tmp_path / "subject.json").write_text(json.dumps(data), encoding="utf-8")
        return tmp_path

    return make


def test_a_complete_subject_has_no_gaps(folder):
    record, gaps = read_open_record(folder() / "subject.json")
    assert gaps == () and record == SubjectRecord.model_validate_json(json.dumps(SUBJECT))


def test_each_thing_that_is_not_known_has_a_line_that_says_what_it_is(folder):
    path = folder(age=None, level=None, forces_n=[0, None, None, 60]) / "subject.json"
    (path.parent / "rest").mkdir()
    (path.parent / "rest/frontal.dcm").touch()
    with pytest.raises(SubjectGaps) as caught:
        read_subject(path.parent)
    assert caught.value.exit_status == 2
    end = "write it there, or give {} to spinestiff init"
    assert caught.value.lines == (
        f"{path}: age is missing: age in years (above 0, at most 120); {end.format('--age')}",
        f"{path}: pushes[0].level is missing: the rib that was pushed (1 to 12; 8.5 lies between two); "
        f"{end.format('--level')}, which counts for all pushes that lack it",
        f"{path}: pushes[0].forces_n[1 to 2] is missing: force on the ribs in N (0 to 500); {end.format('--log')}",
        f"{path.parent / 'pushes/right-8.dcm'}: no such file; wanted the radiograph of push/right-8",
    )


def test_everything_that_may_be_open_is_named_and_everything_else_still_checked(folder):
    open_ = dict.fromkeys([*PERSON, *PUSH])
    subject = read_unannotated(folder(**open_, forces_n=[None] * 4, pelvis="dead-loads"))
    assert [gap.key for gap in subject.gaps] == [*PERSON, *PUSH, "forces_n"]
    assert subject.gaps[-1].frames == (0, 1, 2, 3) and subject.gaps[-1].push == 0
    assert set(OPTIONS) == {gap.key for gap in subject.gaps}
    assert subject.pushes[0].roles == ("unused",) * 4
    for wrong, words in (
        ({"age": None, "colour": 1}, "colour: unknown key"),
        ({"age": None, "sex": "girl"}, "sex: found 'girl'"),
        ({"level": None, "d31_mm": 395}, "d31_mm 395 is not below d21_mm 395"),
        ({"level": None, "forces_n": [0, 1, 2, -3]}, "frame 3 has -3 N"),
        ({"id": None}, "id: found null"),
        ({"age": None, "frames": None}, "frames: found null"),
    ):
        with pytest.raises(SubjectError, match=re.escape(words)) as caught:
            read_unannotated(folder(**wrong))
        assert not isinstance(caught.value, SubjectGaps)


@pytest.mark.parametrize("mass", [18, 25.0, 95.0, 150])
def test_a_mass_is_judged_by_no_height_that_only_stands_in(folder, mass):
    subject = read_unannotated(folder(height_cm=None, mass_kg=mass))
    assert [gap.key for gap in subject.gaps] == ["height_cm"]
    assert SubjectRecord.model_validate({**SUBJECT, "height_cm": 200 if mass > 90 else 120, "mass_kg": mass})


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"mass_kg": -1.0}, "mass_kg: found -1.0, wanted greater than 0"),
        ({"mass_kg": 400}, "mass_kg: found 400, wanted less than or equal to 300"),
        ({"mass_kg": True}, "mass_kg: found true, wanted a valid number"),
        ({"mass_kg": "45"}, "mass_kg: found '45', wanted a number without quotes: 45"),
    ],
)
def test_a_mass_that_nobody_has_is_refused_without_a_height_too(folder, wrong, words):
    with pytest.raises(SubjectError, match=re.escape(words)):
        read_unannotated(folder(height_cm=None, **wrong))


def test_distances_are_open_to_dead_loads_alone(folder):
    for change in ({"d21_mm": None, "d31_mm": None}, {"d31_mm": None}):
        subject = read_unannotated(folder(**change))
        assert subject.gaps == ()
        # Nothing stands in for them, whatever else is open.
        push = read_unannotated(folder(**change, age=None)).pushes[0]
        assert (push.d21_mm, push.d31_mm) == (change.get("d21_mm", 395.0), None)
        assert {gap.key for gap in read_unannotated(folder(**change, pelvis="dead-loads")).gaps} == set(change)
    data = {**SUBJECT, "pelvis": "dead-loads"}
    data["pushes"] = [{key: value for key, value in SUBJECT["pushes"][0].items() if key != "d31_mm"}]
    with pytest.raises(ValueError, match=r"pushes\[0\].d31_mm: missing; pelvis 'dead-loads' needs it"):
        SubjectRecord.model_validate(data)
    assert SubjectRecord.model_validate({**data, "pelvis": "level"}).pushes[0].d31_mm is None


@pytest.mark.parametrize("known", [{"d21_mm": 31.0}, {"d31_mm": 999.0}, {"d21_mm": 1000.0}])
def test_stand_ins_stand_beside_every_distance(folder, known):
    lacking = {"d31_mm": None} if "d21_mm" in known else {"d21_mm": None}
    check_open_record(json.loads((folder(**known, **lacking, pelvis="dead-loads") / "subject.json").read_text()))


def test_what_is_no_subject_has_no_gaps():
    for data in (None, [], 3, {"pushes": 3}, {"pushes": [3]}, {"pushes": [{"forces_n": None}]}, {"name": None}):
        assert gaps_of(data) == ()


def test_inspection_lists_what_is_open(folder):
    one, *rest = inspect(folder(sex=None, side=None))
    assert (one.image, one.status) == ("subject.json", "incomplete")
    assert one.missing == ("sex: female or male", "pushes[0].side: the patient's side that was pushed (left or right)")
    assert [other.image for other in rest] == ["rest/frontal", "push/right-8"]
