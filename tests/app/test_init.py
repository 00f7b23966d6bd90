"""``spinestiff init``: a subject folder from what a hospital exports, as the installed program makes it."""

from __future__ import annotations

import csv
import io
import json
import os
import re
import sys

import numpy as np
import pydicom
import pytest

from hospital import CANARY, disc, export, gauged
from spinestiff.app import questions
from spinestiff.app.init import Asked, force_words, make_subject
from spinestiff.app.init_logs import LogOptions
from spinestiff.errors import OptionError, SpinestiffError
from spinestiff.files import read_json, write_json
from spinestiff.subject.folder import read_unannotated
from spinestiff.subject.inspection import inspect
from spinestiff.subject.intake.making import Given

TABLE = """file,frame,force_n,side,level,d21_mm,d31_mm,role
SE000007/IM000001,0,0,left,5,401.5,65.6,unused
SE000007/IM000001,1,30,,,,,training
SE000007/IM000001,2,60.5,,,,,training
SE000008/IM000001,0,0,left,9,401.5,164.4,unused
SE000008/IM000001,1,60,,,,,validation
"""
PERSON = ("--age", 13, "--sex", "female", "--height", 157)


@pytest.fixture
def source(tmp_path):
    return disc(tmp_path / "disc")


@pytest.fixture
def table(tmp_path):
    path = tmp_path / "pushes.csv"
    path.write_text(TABLE, encoding="utf-8")
    return path


@pytest.fixture(autouse=True)
def nobody_to_ask(monkeypatch):
    """Whoever reads the input fails."""

    class Closed(io.StringIO):
        def read(self, *_):
            raise AssertionError("the input was read")

        readline = read

    monkeypatch.setattr(sys, "stdin", Closed())


def files_of(folder):
    return sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file())


def test_where_no_radiograph_becomes_part_of_it_there_is_no_folder(spinestiff, tmp_path):
    for name in ("a", "b"):
        export(tmp_path / "disc" / name, time=None)
    result = spinestiff("init", tmp_path / "new", tmp_path / "disc", *PERSON)
    assert result.status == 2
    assert result.err.strip().splitlines()[-1] == (
        "spinestiff: no radiograph becomes part of the subject, and nothing is written; a: one of several single "
        "frontal radiographs of unknown order; say which is at rest with --frontal"
    )
    assert not (tmp_path / "new").exists()


def test_a_beam_that_nothing_tells_is_asked_for_and_taken(spinestiff, tmp_path):
    export(tmp_path / "disc" / "a", without=("ViewPosition",))
    assert spinestiff("init", tmp_path / "one", tmp_path / "disc", *PERSON).status == 0
    (rest,) = (one for one in inspect(tmp_path / "one") if one.image == "rest/frontal")
    assert any(line.startswith("nothing tells which way the beam goes, which is taken as") for line in rest.warnings)
    assert spinestiff("init", tmp_path / "two", tmp_path / "disc", *PERSON, "--beam", "pa").status == 0
    assert read_json(tmp_path / "two" / "subject.json")["xray"]["beam"] == "PA"
    (rest,) = (one for one in inspect(tmp_path / "two") if one.image == "rest/frontal")
    assert not any("beam" in line for line in rest.warnings)
    assert rest.seen["beam_to"] == "A"


def rows_of(path):
    return list(csv.DictReader(path.read_text(encoding="utf-8").splitlines()))


def bytes_of(folder):
    return {name: (folder / name).read_bytes() for name in files_of(folder)}


def table_of(text):
    """What the printed table tells of each file, by its name; it is 80 characters wide at most."""
    _, head, _, *lines = text.partition("subject: ")[0].splitlines()
    assert max(map(len, lines)) <= 80
    name, words = slice(head.index("frames")), slice(head.index("becomes"), None)
    told = []
    for line in lines:
        if re.search(r"^(rest, |push |left out)[^:]*: ", line[words]):
            told.append(("", ""))
        told[-1] = (told[-1][0] + line[name].rstrip(), f"{told[-1][1]} {line[words].strip()}")
    return dict(told)


def test_a_disc_and_a_table_make_a_subject_that_steps_take(spinestiff, tmp_path, source, table):
    before = bytes_of(source)
    out = tmp_path / "girl"
    done = spinestiff("init", out, source, "--pushes", table, *PERSON)
    assert done.status == 0, done.err
    assert files_of(out) == [
        "pushes/left-5.dcm", "pushes/left-9.dcm", "rest/frontal.dcm", "rest/lateral.dcm", "subject.json",
    ]  # fmt: skip
    inside = source / "DICOM/PA000001/ST000001"
    for name, place in (("SE000003", "rest/frontal.dcm"), ("SE000007", "pushes/left-5.dcm")):
        assert (inside / name / "IM000001").read_bytes() == (out / place).read_bytes()
    subject = read_unannotated(out)
    assert subject.gaps == () and subject.record.id == "girl"
    assert [(push.id, push.forces_n, push.roles, push.d31_mm) for push in subject.pushes] == [
        ("left-5", (0.0, 30.0, 60.5), ("unused", "training", "training"), 65.6),
        ("left-9", (0.0, 60.0), ("unused", "validation"), 164.4),
    ]
    assert "open still" not in done.out
    assert bytes_of(source) == before
    assert {one.image: one.missing for one in inspect(out)} == {
        name: (f"no corners of {name} in annotation.json",)
        for name in ("rest/frontal", "rest/lateral", "push/left-5", "push/left-9")
    }


def test_every_file_is_in_the_table_with_its_reason_and_nobody_is_named(spinestiff, tmp_path, source, table):
    done = spinestiff("init", tmp_path / "girl", source, "--pushes", table, *PERSON)
    told = table_of(done.out)
    for name, words in (
        ("DICOM/PA000001/ST000001/SE000003/IM000001", "rest, frontal"),
        ("DICOM/PA000001/ST000001/SE000004/IM000001", "rest, lateral"),
        ("DICOM/PA000001/ST000001/SE000007/IM000001", "push left-5"),
        ("DICOM/PA000001/ST000001/SE000008/IM000001", "in the table of pushes, rows 5, 6"),
        ("DICOM/PA000001/ST000001/SE000011/IM000001", "Modality: found CT"),
        ("autorun.inf", "no DICOM file"),
        ("5 files in VIEWER", "left out"),
    ):
        assert words in told[name]
    assert CANARY not in done.out + done.err


def test_what_is_not_known_stays_open_and_each_step_names_it(spinestiff, tmp_path, source):
    out = tmp_path / "girl"
    done = spinestiff("init", out, source, "--age", 13, "--sex", "female", "--side", "right")
    assert done.status == 0
    data = json.loads((out / "subject.json").read_text())
    assert data["height_cm"] is None and data["pushes"][0]["forces_n"] == [None] * 3
    assert [push["id"] for push in data["pushes"]] == ["push-1", "push-2"]
    assert f"note: no frame has a role yet; once it is annotated, spinestiff frames {out} proposes them" in done.out
    lines = done.out.partition("open still")[2]
    assert lines.count("is missing: ") == 5 and "d21" not in lines
    for step in ("run", "track", "estimate", "frames"):
        ended = spinestiff(step, out)
        assert ended.status == 2
        assert len(ended.lines) == 5
        assert all(re.match(r"spinestiff: .*subject\.json: [\w.\[\] ]+ is missing: ", line) for line in ended.lines)
    assert "pushes[1].level is missing: the rib that was pushed" in ended.err


def test_age_and_sex_of_the_header_are_taken_and_said(spinestiff, tmp_path):
    export(tmp_path / "in" / "a", PatientBirthDate="20120504", PatientSex="F")
    done = spinestiff("init", tmp_path / "one", tmp_path / "in", "--height", 150)
    assert "age: 13.1 years, from the DICOM header (PatientBirthDate and the day of the exposure)" in done.out
    data = json.loads((tmp_path / "one/subject.json").read_text())
    assert (data["age"], data["sex"], data["pushes"]) == (13.1, "female", [])
    assert "no pushes were found" in done.out
    done = spinestiff("init", tmp_path / "two", tmp_path / "in", "--age", 15, "--sex", "male", "--height", 150)
    data = json.loads((tmp_path / "two/subject.json").read_text())
    assert (data["age"], data["sex"]) == (15.0, "male")
    assert "from the DICOM header" not in done.out
    assert "sex: male as given, though the DICOM header tells female" in done.out
    assert "age: 15.0 as given, though the DICOM header tells 13.1" in done.out


def test_what_counts_for_several_pushes_says_so(spinestiff, tmp_path, source):
    done = spinestiff("init", tmp_path / "girl", source, "--d21", 400, "--side", "left")
    assert done.status == 0, done.err
    assert "d21_mm: 400.0 for 2 pushes alike; where one differs, correct it in subject.json" in done.out
    assert "side: left for 2 pushes alike" in done.out
    assert "give --level to spinestiff init, which counts for all pushes that lack it" in done.out


def test_headers_that_contradict_each_other_tell_nothing(spinestiff, tmp_path):
    export(tmp_path / "in" / "a", PatientAge="013Y", PatientSex="F")
    export(tmp_path / "in" / "b", "lateral", PatientAge="031Y", PatientSex="M")
    done = spinestiff("init", tmp_path / "out", tmp_path / "in")
    data = json.loads((tmp_path / "out/subject.json").read_text())
    assert (data["age"], data["sex"]) == (None, None)
    assert "age: not taken from the DICOM headers, which tell 13 to 31 years" in done.out


def test_two_patients_are_refused_and_one_can_be_chosen(spinestiff, tmp_path, source):
    export(source / "other" / "I1", patient="P2", study="1.2.9", time="090000")
    out = tmp_path / "girl"
    done = spinestiff("init", out, source)
    assert done.status == 2 and not out.exists()
    (line,) = [line for line in done.lines if line.startswith("spinestiff: ")]
    assert "found 2 patients and 2 studies, wanted one: A1 (1 file: 1 frontal; other/I1), B1 (4 files" in line
    assert "P2" not in done.out + done.err
    done = spinestiff("init", out, source, "--study", "B1")
    assert done.status == 0 and len(files_of(out)) == 5
    assert "left out: another study than asked for" in table_of(done.out)["A1 (1 file: 1 frontal; other/I1)"]


def test_no_radiograph_of_two_discs_with_the_same_names_is_lost(spinestiff, tmp_path):
    discs = [tmp_path / number / "DICOM" for number in ("cd1", "cd2")]
    export(discs[0] / "IM1", time="101500")
    export(discs[1] / "IM1", frames=3, time="102200")
    path = tmp_path / "pushes.csv"
    path.write_text(TABLE.replace("SE000007/IM000001", "cd2/DICOM/IM1").partition("SE000008")[0], encoding="utf-8")
    for number, options in enumerate([(), ("--pushes", path)]):
        out = tmp_path / f"girl{number}"
        done = spinestiff("init", out, *discs, *options, *PERSON)
        assert done.status == 0, done.err
        (push,) = sorted((out / "pushes").iterdir())
        assert push.read_bytes() == (discs[1] / "IM1").read_bytes()
        assert (out / "rest/frontal.dcm").read_bytes() == (discs[0] / "IM1").read_bytes()
        assert "cd1/DICOM/IM1" in done.out and "cd2/DICOM/IM1" in done.out


def test_nothing_is_overwritten_and_nothing_is_left_behind(spinestiff, tmp_path, source, table):
    out = tmp_path / "girl"
    assert spinestiff("init", out, source, "--pushes", table).status == 0
    before = bytes_of(out)
    done = spinestiff("init", out, source, "--pushes", table)
    assert done.status == 2 and "is there already (a subject folder, with subject.json); nothing is" in done.err
    assert bytes_of(out) == before
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "a").touch()
    assert "is there already (not empty)" in spinestiff("init", tmp_path / "full", source).err
    assert "which is read; name a folder outside of it" in spinestiff("init", source / "inner", source).err
    table.write_text(TABLE.replace("60.5", "600"))
    done = spinestiff("init", tmp_path / "new", source, "--pushes", table)
    assert done.status == 2 and "row 4: force_n: found '600'" in done.err
    table.write_text(TABLE.replace(",65.6", ",500"))
    done = spinestiff("init", tmp_path / "new", source, "--pushes", table)
    assert done.status == 2 and "d31_mm 500 is not below d21_mm 401.5" in done.err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["disc", "full", "girl", "pushes.csv"]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--sex", "girl"), "--sex girl: wanted female or male"),
        (("--sex", ""), "--sex : wanted female or male"),
        (("--side", "up"), "--side up: wanted left or right"),
        (("--id", "a b"), "--id 'a b': wanted 1 to 64 letters"),
        (("--orientation", "odd"), "--orientation odd: wanted standard"),
        (("--frontal", "nowhere"), "--frontal: no radiograph 'nowhere' in the sources"),
        (("--lateral", "SE000007/IM000001"), "of several frames or files, wanted one rest radiograph"),
        (("--pushes", "nowhere.csv"), "nowhere.csv: no such file"),
        (("--log", "a.csv"), "--log a.csv: found 2 pushes (push-1, push-2), wanted one; say which: --log PUSH=a.csv"),
        (("--log", "other=a.csv"), "--log other=a.csv: no push 'other'; wanted one of push-1, push-2"),
        (("--imager-pixel", "wide"), "--imager-pixel wide: wanted MM, or PICTURE=MM, e.g. rest/lateral=1500"),
        (("--imager-pixel", "=0.4"), "--imager-pixel =0.4: wanted the name of a picture before ="),
        (("--imager-pixel", "rest/lateral=nan"), "--imager-pixel rest/lateral=nan: wanted MM"),
        (("--source-patient", 0), "--source-patient 0: wanted 300 to 10000 mm"),
        (("--source-patient", 900, "--source-patient", 901), "901: given twice for all pictures; wanted once"),
        (
            ("--source-detector", "lateral=1500"),
            "--source-detector lateral=1500: no such picture; wanted one of rest/frontal, rest/lateral, push/push-1, "
            "push/push-2",
        ),
        (("--log-offset", "push-1=3"), "--log-offset: belongs to a --log of the same push"),
        (("--log-units", "s,N"), "--log-units: belongs to a --log; give both"),
        (("--log-columns", "t,F"), "--log-columns: belongs to a --log; give both"),
        (("--log-rate", "10"), "--log-rate: belongs to a --log; give both"),
        (("--log-rate", "0"), "--log-rate 0: wanted 0.1 to 100000 Hz"),
        (("--mass", 0), "--mass 0: wanted above 0 and at most 300 kg"),
        (("--trunk", "T9"), "--trunk T9: wanted LEVEL=BREADTH,DEPTH, a vertebra from T1 to L5 and mm, e.g. T9=245,172"),
        (("--trunk", "T19=245,172"), "--trunk T19=245,172: wanted LEVEL=BREADTH,DEPTH"),
        (("--trunk", "T9=245"), "--trunk T9=245: wanted LEVEL=BREADTH,DEPTH"),
        (("--trunk", "T9=245,17.2"), "--trunk T9=245,17.2, depth 17.2: wanted 80 to 500 mm"),
        (("--trunk", "T9=24.5,172"), "breadth 24.5: wanted 100 to 600 mm"),
        (("--trunk", "T9=245,172", "--trunk", "T9=246,172"), "T9=246,172: given twice for T9; wanted once"),
        (("--mass", 150, "--height", 150), "mass_kg: body mass 150 kg at 150 cm is 66.7 kg/m2"),
    ],
)
def test_options_that_say_nothing_sensible_are_refused(spinestiff, tmp_path, source, options, words):
    done = spinestiff("init", tmp_path / "girl", source, *options)
    assert done.status == 2 and not (tmp_path / "girl").exists()
    (line,) = [line for line in done.lines if line.startswith("spinestiff: ")]
    assert words in line


def test_geometry_that_the_files_lack_is_named_and_can_be_given(spinestiff, tmp_path):
    lacking = ("ImagerPixelSpacing", "DistanceSourceToDetector", "DistanceSourceToPatient", "PatientOrientation")
    export(tmp_path / "in" / "a", without=lacking)
    done = spinestiff("init", tmp_path / "one", tmp_path / "in", *PERSON)
    assert done.out.partition("open still")[2].count("rest/frontal: ") == 3
    geometry = ("--source-detector", 1500, "--source-patient", 1340, "--imager-pixel", 0.4, "--orientation", "standard")
    done = spinestiff("init", tmp_path / "two", tmp_path / "in", *PERSON, *geometry)
    assert "open still" not in done.out
    assert inspect(tmp_path / "two")[0].seen["pixel_mm_at_detector"] == [0.4, 0.4]


def test_frames_without_times_and_numbers_go_by_their_names_and_it_is_said(spinestiff, tmp_path):
    for name in ("img10", "img9", "img11"):
        export(tmp_path / "in" / name, time=None, without=("InstanceNumber",))
    table = tmp_path / "pushes.csv"
    rows = [f"img{number},,{force},right,8,400,210" for number, force in ((9, 0), (10, 20), (11, 41))]
    table.write_text("\n".join([TABLE.splitlines()[0].removesuffix(",role"), *rows]) + "\n")
    out = tmp_path / "girl"
    done = spinestiff("init", out, tmp_path / "in", "--pushes", table, *PERSON)
    assert done.status == 0, done.err
    assert "in order of the files' names" in " ".join(done.out.split())
    assert "note: push/right-8: " in done.out and "ordered by file name: check the order" in done.out
    for number, name in enumerate(("img9", "img10", "img11")):
        assert (out / f"pushes/right-8/{number:03d}.dcm").read_bytes() == (tmp_path / "in" / name).read_bytes()
    assert read_unannotated(out).pushes[0].forces_n == (0.0, 20.0, 41.0)


def test_geometry_of_single_pictures_is_given_by_their_names(spinestiff, tmp_path):
    lacking = ("ImagerPixelSpacing", "DistanceSourceToDetector", "DistanceSourceToPatient")
    export(tmp_path / "in" / "a", without=lacking)
    export(tmp_path / "in" / "b", "lateral", without=lacking)
    export(tmp_path / "in" / "c", frames=2, time="102000", without=lacking)
    usual = ("--source-detector", 1500, "--source-patient", 1340, "--imager-pixel", 0.4)
    own = ("--source-detector", "rest/lateral=1830", "--source-patient", "rest/lateral=1700")
    # On a terminal the push's name comes last, from side and rib.
    asked = Given(images={"imager_pixel_mm": {"push/push-1": 0.5}})
    answers = {"side": "left", "level": "5"}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            questions, "_terminal", lambda question: next((answers[key] for key in answers if key in question), "")
        )
        make_subject(tmp_path / "asked", [tmp_path / "in"], Asked(asked, may_ask=True))
    assert read_json(tmp_path / "asked" / "subject.json")["xray"] == {
        "images": {"push/left-5": {"imager_pixel_mm": 0.5}}
    }
    done = spinestiff("init", tmp_path / "girl", tmp_path / "in", *PERSON, *usual, *own)
    assert done.status == 0, done.err
    xray = {"source_detector_mm": 1500.0, "source_patient_mm": 1340.0, "imager_pixel_mm": 0.4}
    lateral = {"source_detector_mm": 1830.0, "source_patient_mm": 1700.0}
    assert read_json(tmp_path / "girl" / "subject.json")["xray"] == {**xray, "images": {"rest/lateral": lateral}}
    # Later, for a subject that is there; what it knows stays.
    later = ("--imager-pixel", "push/push-1=0.5", "--source-patient", "rest/lateral=1650")
    done = spinestiff("init", tmp_path / "girl", *later)
    assert done.status == 0 and "xray.images.rest/lateral.source_patient_mm: stays 1700.0, 1650.0 was given" in done.out
    images = {"rest/lateral": lateral, "push/push-1": {"imager_pixel_mm": 0.5}}
    assert read_json(tmp_path / "girl" / "subject.json")["xray"]["images"] == images
    seen = {one.image: one.seen["pixel_mm_at_detector"] for one in inspect(tmp_path / "girl") if one.seen}
    assert seen == {"rest/frontal": [0.4, 0.4], "rest/lateral": [0.4, 0.4], "push/push-1": [0.5, 0.5]}


def test_single_frames_become_a_folder_in_order_of_time_each_with_its_force(spinestiff, tmp_path):
    for name, time, number in (("z", "102000", 1), ("a", "102010", 2), ("m", "102020", 3)):
        export(tmp_path / "in" / name, time=time, InstanceNumber=number)
    export(tmp_path / "in" / "rest", time="101000")
    table = tmp_path / "pushes.csv"
    rows = ["a,,20,right,8,400,210", "m,,41,right,8,400,210", "z,,0,right,8,400,210"]
    table.write_text("\n".join([TABLE.splitlines()[0].removesuffix(",role"), *rows]) + "\n")
    out = tmp_path / "girl"
    assert spinestiff("init", out, tmp_path / "in", "--pushes", table, *PERSON).status == 0
    assert files_of(out / "pushes") == ["right-8/000.dcm", "right-8/001.dcm", "right-8/002.dcm"]
    assert (out / "pushes/right-8/000.dcm").read_bytes() == (tmp_path / "in/z").read_bytes()
    (push,) = read_unannotated(out).pushes
    assert push.forces_n == (0.0, 20.0, 41.0)
    seen = {one.image: one.seen for one in inspect(out)}["push/right-8"]
    assert (seen["frames"], seen["times_s"]) == (3, [0.0, 10.0, 20.0])


# What is open is filled later


def test_what_is_open_is_filled_and_nothing_else_changes(spinestiff, tmp_path, source, table):
    out = tmp_path / "girl"
    spinestiff("init", out, source, "--pushes", table)
    before = bytes_of(out)
    done = spinestiff("init", out, "--height", 157, "--age", 12, "--level", 3)
    assert done.status == 0
    assert "push left-5, level: stays 5.0, 3.0 was given for all pushes" in done.out
    assert "sex is missing" in done.out
    after = bytes_of(out)
    assert {name for name in after if before.get(name) != after[name]} == {"subject.json"}
    old, new = (json.loads(files["subject.json"]) for files in (before, after))
    assert new == {**old, "height_cm": 157.0, "age": 12.0}
    assert spinestiff("init", out, "--sex", "F").status == 0
    assert read_unannotated(out).gaps == ()
    done = spinestiff("init", out, "--sex", "male")
    assert done.status == 2 and "nothing is missing" in done.err
    assert "nothing changes (sex: stays female, male was given; change it in subject.json)" in done.err
    # X-ray geometry is nothing that is open: it can be given where the files or subject.json have none.
    done = spinestiff("init", out, "--imager-pixel", 0.417, "--sex", "male")
    assert done.status == 0 and "sex: stays female, male was given; change it in subject.json" in done.out
    assert json.loads((out / "subject.json").read_text())["xray"] == {"imager_pixel_mm": 0.417}
    done = spinestiff("init", out, "--imager-pixel", 0.2)
    assert done.status == 2 and "xray.imager_pixel_mm: stays 0.417, 0.2 was given" in done.err
    assert "belongs to DICOM files" in spinestiff("init", out, "--pushes", table).err
    assert "no such file; name the DICOM files" in spinestiff("init", tmp_path / "nowhere").err


def without_distances(folder):
    """Leave ``d21_mm`` and ``d31_mm`` out of every push of a subject, and its height open; returns what is left."""
    path = folder / "subject.json"
    data = json.loads(path.read_text())
    for push in data["pushes"]:
        del push["d21_mm"], push["d31_mm"]
    path.write_text(json.dumps({**data, "height_cm": None}))
    return data


def test_mass_and_the_trunks_sizes_are_taken_at_once_or_later(spinestiff, tmp_path, source, table):
    out = tmp_path / "girl"
    assert spinestiff("init", out, source, "--pushes", table, "--mass", 44, "--trunk", "T9=245,172").status == 0
    data = json.loads((out / "subject.json").read_text())
    assert (data["mass_kg"], data["trunk"]) == (44.0, {"T9": {"breadth_mm": 245.0, "depth_mm": 172.0}})
    done = spinestiff("init", out, "--trunk", "L3 = 220.5, 160", "--trunk", "T9=250,172", "--mass", 45)
    assert done.status == 0
    assert "trunk.T9: stays 245.0 by 172.0 mm, 250.0 by 172.0 mm was given; change it in subject.json" in done.out
    assert "mass_kg: stays 44.0, 45.0 was given" in done.out
    changed = json.loads((out / "subject.json").read_text())
    assert changed == {**data, "trunk": {**data["trunk"], "L3": {"breadth_mm": 220.5, "depth_mm": 160.0}}}


def test_distances_that_are_left_out_are_shown_as_unknown_and_stay_so(spinestiff, tmp_path, source):
    out = tmp_path / "girl"
    spinestiff("init", out, source, "--age", 13)
    left = without_distances(out)
    done = spinestiff("init", out, "--height", 157)
    assert done.status == 0, done.err
    assert "push-1: 3 frames, from the ?, rib ?, d21 ? mm, d31 ? mm, ?, ?, ? N" in done.out
    assert "sex is missing" in done.out.partition("open still")[2]
    assert json.loads((out / "subject.json").read_text()) == {**left, "height_cm": 157.0}
    done = spinestiff("init", out, "--d21", 400)
    assert done.status == 0 and "d21_mm: 400.0 for 2 pushes alike" in done.out


def test_distances_that_are_left_out_are_asked_for_on_a_terminal(spinestiff, tmp_path, source, monkeypatch):
    out = tmp_path / "girl"
    spinestiff("init", out, source, *PERSON)
    left = without_distances(out)
    given = {"height_cm,": ["157"], "d21_mm,": ["", "400"], "d31_mm,": ["", "66"]}
    said = answering(monkeypatch, **{key: ["", ""] for key in ("side,", "level,", "force of each")}, **given)
    make_subject(out, [], Asked(Given(), may_ask=True))
    assert sum("d21_mm, vertical distance" in question for question in said) == 2
    one, two = left["pushes"]
    filled = {**left, "height_cm": 157.0, "pushes": [one, {**two, "d21_mm": 400.0, "d31_mm": 66.0}]}
    assert json.loads((out / "subject.json").read_text()) == filled


def test_geometry_that_is_null_is_filled_as_geometry_that_is_left_out(spinestiff, tmp_path, source):
    out = tmp_path / "girl"
    spinestiff("init", out, source, *PERSON)
    path = out / "subject.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), "xray": {"imager_pixel_mm": None, "images": None}}))
    done = spinestiff("init", out, "--imager-pixel", 0.417, "--source-patient", "rest/lateral=1300")
    assert done.status == 0 and "stays" not in done.out, done.err
    assert json.loads(path.read_text())["xray"] == {
        "imager_pixel_mm": 0.417, "images": {"rest/lateral": {"source_patient_mm": 1300.0}}
    }  # fmt: skip


def test_a_push_folder_without_pictures_stops_no_filling(spinestiff, tmp_path, source, table):
    out = tmp_path / "girl"
    assert spinestiff("init", out, source, *PERSON, "--pushes", table).status == 0
    record = json.loads((out / "subject.json").read_text())
    push = out / record["pushes"][0]["frames"]
    push.unlink()
    push.mkdir()
    record["age"] = None
    (out / "subject.json").write_text(json.dumps(record))
    done = spinestiff("init", out, *PERSON)
    assert "found no radiographs in this folder" in done.out + done.err
    assert json.loads((out / "subject.json").read_text())["age"] == 13, done.err


# Logs of gauges


@pytest.fixture
def logged(tmp_path):
    """An export with a push of 30 frames at 4 a second, its first frame 3.1 s after the log's start."""
    return tmp_path, gauged(tmp_path)


SITE = ("--side", "left", "--level", 5, "--d21", 400, "--d31", 66)


def test_a_log_is_put_beside_the_frames_by_their_motion_and_shown(spinestiff, logged):
    folder, true = logged
    out = folder / "girl"
    done = spinestiff("init", out, folder / "in", "--log", folder / "gauge.csv", *PERSON, *SITE)
    assert done.status == 0, done.err
    (offset, low, high) = map(
        float, re.search(r"frame at ([\d.]+) s of the log, 95 % ([\d.]+) to ([\d.]+) s", done.out).groups()
    )
    assert low <= 3.1 <= high and abs(offset - 3.1) < 0.1
    assert "time in column 'Time (ms)' (ms), force in column 'Load (kgf)' (kgf)" in done.out
    (push,) = read_unannotated(out).pushes
    np.testing.assert_allclose(push.forces_n, true, atol=2.5)
    assert push.forces_n[0] == 0.0
    assert (out / "results/force-log-left-5.png").read_bytes()[:4] == b"\x89PNG"
    rows = rows_of(out / "results/force-log-left-5.csv")
    assert [
        float(row["force_low_n"]) <= f + 0.6 and f - 0.6 <= float(row["force_high_n"]) for row, f in zip(rows, true)
    ] == [True] * 30
    assert "SubjectGaps" not in done.err and "open still" not in done.out


def test_two_pushes_on_one_stretch_of_a_log_are_left_open(spinestiff, logged):
    folder, true = logged
    pixels = pydicom.dcmread(folder / "in" / "x" / "I7").pixel_array
    export(folder / "in" / "x" / "J7", frames=30, pixels=pixels + 1.0, time="120000")
    log = [f"--log={push}={folder / 'gauge.csv'}" for push in ("I7", "J7")]
    done = spinestiff("init", folder / "a", folder / "in", *log, *PERSON, *SITE)
    assert done.status == 0, done.err
    for name, other in (("left-5", "left-5-2"), ("left-5-2", "left-5")):
        assert re.search(
            rf"log of push {name}: where it begins is not determined: it would lie at 3.\d to 10.\d s of the log, "
            rf"where push {other} lies; give",
            done.out,
        )
    still_open = [f"pushes[{number}].forces_n[0 to 29]" for number in range(2)]
    assert [gap.field for gap in read_unannotated(folder / "a").gaps] == still_open
    done = spinestiff("init", folder / "b", folder / "in", *log, *PERSON, *SITE, "--log-offset", "I7=3.1")
    found = read_unannotated(folder / "b")
    np.testing.assert_allclose(found.pushes[0].forces_n, true, atol=0.6)
    assert [gap.field for gap in found.gaps] == still_open[1:]


def test_a_log_without_times_is_put_beside_by_its_rate(spinestiff, logged):
    folder, true = logged
    untimed = folder / "untimed.csv"
    lines = (folder / "gauge.csv").read_text().splitlines()
    (start,) = (i for i, line in enumerate(lines) if line.startswith("Time (ms)"))
    forces = [line.split(";")[1] for line in lines[start:]]
    untimed.write_text("\n".join(forces) + "\n")
    log = (folder / "in", "--log", untimed, *PERSON, *SITE)
    done = spinestiff("init", folder / "girl", *log)
    assert done.status == 2 and "found no header of fields between commas" in done.err
    done = spinestiff("init", folder / "girl", *log, "--log-rate", 50)
    assert done.status == 0, done.err
    assert "entries 50 a second, force in column 'Load (kgf)' (kgf)" in done.out
    np.testing.assert_allclose(read_unannotated(folder / "girl").pushes[0].forces_n, true, atol=2.5)
    untimed.write_text("\n".join(["Load", *forces[1:]]) + "\n")
    log = ("init", folder / "other", *log, "--log-rate", 50)
    assert "column 'Load' tells no unit" in spinestiff(*log).err
    assert "--log-units s,kgf,N: wanted s,N or N" in spinestiff(*log, "--log-units", "s,kgf,N").err
    assert "--log-columns ,: wanted TIME,FORCE or FORCE" in spinestiff(*log, "--log-columns", ",").err
    done = spinestiff(*log, "--log-units", "kgf", "--log-columns", "load")
    assert done.status == 0, done.err
    np.testing.assert_allclose(read_unannotated(folder / "other").pushes[0].forces_n, true, atol=2.5)


def test_a_log_without_an_offset_leaves_the_forces_open_until_it_is_given(spinestiff, logged):
    folder, true = logged
    out, flat = folder / "girl", folder / "flat.csv"
    flat.write_text("time_s,force_n\n" + "\n".join(f"{i / 10},1.5" for i in range(200)))
    done = spinestiff("init", out, folder / "in", "--log", f"x/I7={flat}", *PERSON, *SITE)
    assert done.status == 0
    assert "where it begins is not determined: the log's force changes by 0.0 N only; give the log's time" in done.out
    assert [gap.field for gap in read_unannotated(out).gaps] == ["pushes[0].forces_n[0 to 29]"]
    (open_still,) = [line for line in done.out.splitlines() if "forces_n[0 to 29] is missing" in line]
    assert "give --log again with --log-offset to spinestiff init: where the log begins" in open_still
    rows = rows_of(out / "results/force-log-left-5.csv")
    assert {row["force_n"] for row in rows} == {""} and rows[29]["time_s"] == "7.250"
    done = spinestiff("init", out, "--log", folder / "gauge.csv", "--log-offset", "left-5=3.1")
    assert done.status == 0 and "first frame at 3.10 s of the log, as given" in done.out
    np.testing.assert_allclose(read_unannotated(out).pushes[0].forces_n, true, atol=0.6)


def test_an_offset_that_the_motion_contradicts_is_taken_with_a_warning(spinestiff, logged):
    folder, _ = logged
    log = ("--log", folder / "gauge.csv", *PERSON, *SITE, "--log-offset")
    done = spinestiff("init", folder / "wrong", folder / "in", *log, 5.5)
    assert done.status == 0 and "first frame at 5.50 s of the log, as given" in done.out
    assert re.search(r"warning: the motion says 3\.\d+ s \(95 % [\d.]+ to [\d.]+ s\); look at the picture", done.out)
    done = spinestiff("init", folder / "right", folder / "in", *log, 3.1)
    assert done.status == 0 and "warning" not in done.out


def test_an_offset_beside_the_push_says_so(spinestiff, logged):
    folder, _ = logged
    log = folder / "late.csv"
    log.write_text("time_s,force_n\n" + "\n".join(f"{i / 10},{30 if i > 250 else 0}" for i in range(400)))
    done = spinestiff("init", folder / "a", folder / "in", "--log", log, *PERSON, *SITE, "--log-offset", 2)
    assert done.status == 2
    assert re.search(r"first frame at 2 s of the log no frame has a force: .* its push, from 25.1 to 39.9 s", done.err)
    assert not (folder / "a").exists()


def test_forces_from_two_places_a_wrong_offset_and_no_times_are_refused(spinestiff, logged, tmp_path):
    folder, _ = logged
    table = folder / "pushes.csv"
    table.write_text("file,frame,force_n,side,level,d21_mm,d31_mm\nI7,3,20,left,5,400,66\n")
    done = spinestiff("init", folder / "a", folder / "in", "--pushes", table, "--log", folder / "gauge.csv")
    assert done.status == 2 and "the forces of push left-5 are known already; leave out either" in done.err
    log = ("--log", folder / "gauge.csv", *SITE)
    done = spinestiff("init", folder / "a", folder / "in", *log, "--log-offset", 30)
    assert done.status == 2 and "beyond its ends (0 and 15.98 s)" in done.err
    done = spinestiff("init", folder / "a", folder / "in", *log, "--log-offset", "soon")
    assert done.status == 2 and "--log-offset: found 'soon', wanted a number" in done.err
    done = spinestiff("init", folder / "a", folder / "in", *log, "--log-units", "s,kgf")
    assert done.status == 2 and "column 'Time (ms)' is in ms, but s was given" in done.err
    done = spinestiff("init", folder / "a", folder / "in", *log, "--log-units", "s,stone")
    assert done.status == 2 and "--log-units s,stone: found 'stone', wanted N, kgf, lbf" in done.err
    path = folder / "in" / "x" / "I7"
    dataset = pydicom.dcmread(path)
    del dataset.FrameTime
    dataset.save_as(path)
    done = spinestiff("init", folder / "a", folder / "in", *log)
    assert done.status == 2 and "tell no times of their frames" in done.err
    assert not (folder / "a").exists()


# Questions


def test_on_a_terminal_what_is_open_is_asked_for(tmp_path, source, monkeypatch, capsys):
    def answers(question):
        key = re.match(r"(?:(?:push )?\S+ \(\d+ frames\), )?(\w+),|.*(force)", question)
        return given[key[1] or key[2]].pop(0)

    given = {
        "age": ["old", "13"],
        "sex": ["f"],
        "height_cm": ["1570", "157"],
        "side": ["up", "left", "r"],
        "level": ["5", "9"],
        "d21_mm": ["400", ""],
        "d31_mm": ["400", "66", ""],
        "force": ["0 30", "0 30 x", "0 30,5 60", ""],
    }
    monkeypatch.setattr(questions, "_terminal", answers)
    make_subject(tmp_path / "girl", [source], Asked(Given(), may_ask=True))
    subject = read_unannotated(tmp_path / "girl")
    record = subject.record
    assert (record.age, record.sex, record.height_cm) == (13.0, "female", 157.0)
    one, two = subject.pushes
    assert (one.id, one.level, one.d21_mm, one.d31_mm, one.forces_n) == ("left-5", 5.0, 400.0, 66.0, (0.0, 30.5, 60.0))
    assert (two.id, two.side, two.d21_mm, two.d31_mm) == ("right-9", "right", None, None)
    assert [gap.field for gap in subject.gaps] == ["pushes[1].forces_n[0 to 1]"]
    complaints = capsys.readouterr().err
    for words in ("found 'old', wanted a number", "found 1570, wanted 120 to 200", "wanted d31_mm below d21_mm",
                  "found 2 numbers, wanted 3", "found 'x', wanted a number", "wanted left or right"):  # fmt: skip
        assert words in complaints


def test_the_end_of_the_input_leaves_everything_open(tmp_path, source, monkeypatch):
    monkeypatch.setattr(sys, "stdin", io.StringIO(""))
    make_subject(tmp_path / "girl", [source], Asked(Given(), may_ask=True))
    assert len(read_unannotated(tmp_path / "girl").gaps) == 9


@pytest.mark.skipif(os.name == "nt", reason="no terminals of this kind")
def test_without_a_terminal_or_with_no_questions_nobody_is_asked(monkeypatch):
    class Terminal(io.StringIO):
        def isatty(self):
            return True

    monkeypatch.setattr(sys, "stdin", io.StringIO())
    monkeypatch.setattr(sys, "stderr", Terminal())
    assert not questions.on_terminal()
    monkeypatch.setattr(sys, "stdin", Terminal())
    assert questions.on_terminal()


CONFIRM = "gauge.csv: time in column 'Time (ms)' (ms), force in column 'Load (kgf)' (kgf); is that right; yes or no"
ANSWERS = {"age": "13", "sex": "f", "height_cm": "157", "side": "left", "level": "5", "d21_mm": "400", "d31_mm": "66"}


def answering(monkeypatch, **others):
    """Answer questions by what is in them, in turn where there are several; the questions are in the list returned."""
    said = []
    answers = {**{f"{key},": [answer] for key, answer in ANSWERS.items()}, "is that right": ["yes"], **others}

    def answer(question):
        said.append(question)
        return next(several for key, several in answers.items() if key in question).pop(0)

    monkeypatch.setattr(questions, "_terminal", answer)
    return said


def test_columns_and_units_of_a_log_are_confirmed_before_any_other_question(logged, monkeypatch):
    folder, _ = logged
    said = answering(monkeypatch, **{"is that right": ["no"]})
    with pytest.raises(OptionError, match="columns and units were not confirmed; say them with --log-columns and --lo"):
        make_subject(
            folder / "a", [folder / "in"], Asked(Given(), logs=LogOptions((str(folder / "gauge.csv"),)), may_ask=True)
        )
    assert said == [CONFIRM]


def test_an_empty_line_confirms_and_the_end_of_the_input_does_not():
    def ended(question):
        raise EOFError

    assert questions.confirmed("is that right", lambda question: " ")
    assert not questions.confirmed("is that right", ended)


@pytest.mark.parametrize(
    ("log", "options", "words"),
    [
        ("gauge.csv", {"offsets": ("300",)}, "push-1: with the first frame at 300 s"),
        ("gauge.csv", {"offsets": ("inf",)}, "--log-offset: found 'inf', wanted a number"),
        ("gauge.csv", {"offsets": ("2,5",)}, "--log-offset: found '2,5', wanted a decimal point, as in 12.5"),
        ("none.csv", {}, "none.csv"),
        ("back.csv", {}, "line 3: the time does not grow"),
        ("push-2=gauge.csv", {}, "no push 'push-2'; wanted one of push-1, or the name of its file"),
    ],
)
def test_a_log_that_is_refused_loses_no_answers(logged, monkeypatch, log, options, words):
    folder, _ = logged
    (folder / "back.csv").write_text("time_s,force_n\n1,1\n0,2\n")
    monkeypatch.chdir(folder)
    said = answering(monkeypatch)
    with pytest.raises(SpinestiffError, match=re.escape(words)):
        make_subject(folder / "a", [folder / "in"], Asked(Given(), logs=LogOptions((log,), **options), may_ask=True))
    assert [question for question in said if "is that right" not in question] == []


def test_a_push_of_a_log_is_named_as_the_table_shows_it(logged, monkeypatch, capsys):
    folder, true = logged
    answering(monkeypatch)
    log = f"push-1={folder / 'gauge.csv'}"
    make_subject(folder / "a", [folder / "in"], Asked(Given(), logs=LogOptions((log,), ("push-1=3.1",)), may_ask=True))
    subject = read_unannotated(folder / "a")
    assert subject.gaps == () and [push.id for push in subject.pushes] == ["left-5"]
    np.testing.assert_allclose(subject.pushes[0].forces_n, true, atol=0.6)
    told = capsys.readouterr().out
    assert "log of push left-5: time in column" in told and "log of push-1" not in told


def test_frames_of_which_a_log_tells_no_force_stay_open(spinestiff, logged):
    folder, _ = logged
    log = folder / "cut.csv"
    log.write_text("time_s,force_n\n" + "\n".join(f"{i / 10},{min(5 * i, 300) / 10}" for i in range(87)))
    done = spinestiff("init", folder / "a", folder / "in", "--log", log, "--log-offset", 2, *PERSON, *SITE)
    assert done.status == 0, done.err
    assert "log of push left-5: frames 28, 29 lie beyond the log, or in a gap of it, where it tells no" in done.out
    assert "forces_n[28 to 29] is missing" in done.out and "where the log begins is not determined" not in done.out
    rows = rows_of(folder / "a/results/force-log-left-5.csv")
    assert [row["force_n"] == "" for row in rows] == [False] * 28 + [True] * 2
    assert json.loads((folder / "a/subject.json").read_text())["pushes"][0]["forces_n"][27:] == [30.0, None, None]


def test_an_offset_that_can_not_be_is_asked_for_again(logged, monkeypatch, capsys):
    folder, _ = logged
    (folder / "flat.csv").write_text("time_s,force_n\n" + "\n".join(f"{i / 10},1.5" for i in range(200)))
    answering(monkeypatch, **{"time of the log": ["inf", "nan", "300", "2"]})
    make_subject(
        folder / "a", [folder / "in"], Asked(Given(), logs=LogOptions((str(folder / "flat.csv"),)), may_ask=True)
    )
    assert read_unannotated(folder / "a").pushes[0].forces_n == (1.5,) * 30
    complaints = capsys.readouterr().err
    for words in ("found 'inf', wanted a number", "found 'nan', wanted a number", "frames lie 287.4 s beyond its ends"):
        assert words in complaints


def test_values_that_contradict_each_other_are_refused_before_any_question(tmp_path, source, table, monkeypatch):
    table.write_text(TABLE.replace(",65.6", ",500"))
    said = answering(monkeypatch)
    with pytest.raises(SpinestiffError, match="d31_mm 500 is not below d21_mm"):
        make_subject(tmp_path / "girl", [source], Asked(Given(), table=table, may_ask=True))
    assert said == []


def test_forces_with_which_there_is_no_estimate_are_asked_for_again(tmp_path, source, table, monkeypatch, capsys):
    one = TABLE.partition("SE000008")[0]
    table.write_text(one.replace(",1,30,", ",1,,").replace(",60.5,", ",,"))
    answering(monkeypatch, **{"force of each": ["0 0 0", "0 30 60"]})
    make_subject(tmp_path / "girl", [source], Asked(Given(), table=table, may_ask=True))
    assert read_unannotated(tmp_path / "girl").pushes[0].forces_n == (0.0, 30.0, 60.0)
    assert "all forces are zero, so there is nothing to identify" in capsys.readouterr().err


def test_a_name_of_several_pushes_is_not_told_as_missing(spinestiff, tmp_path, source):
    done = spinestiff("init", tmp_path / "girl", source, "--log", "IM000001=gauge.csv")
    assert done.status == 2 and "'IM000001' names 2 pushes; write more of the file's path" in done.err


@pytest.mark.parametrize(
    ("forces", "words"),
    [
        ([0.0, None, 60.0], "0, ?, 60 N"),
        ([None] * 40, "? N"),
        ([0.0] * 10 + [20.0, 60.5] * 10, "0 to 60.5 N"),
        ([0.0] * 20 + [None] * 3 + [60.0], "0 to 60 N, unknown in 3 frames"),
    ],
    ids=["few", "many unknown", "many", "some unknown"],
)
def test_forces_of_many_frames_are_told_by_the_least_and_the_largest(forces, words):
    assert force_words(forces) == words


def test_geometry_that_a_picture_contradicts_is_refused_before_anything_is_written(spinestiff, tmp_path, source):
    out = tmp_path / "girl"
    done = spinestiff("init", out, source, *PERSON, "--source-detector", 1234)
    (line,) = [line for line in done.lines if line.startswith("spinestiff: ")]
    assert done.status == 2 and not out.exists()
    assert "rest/frontal: IM000001: DistanceSourceToDetector: found " in line and line.endswith("; nothing is written")
    assert spinestiff("init", out, source, *PERSON).status == 0
    before = bytes_of(out)
    for option, value in (("--source-detector", 1234), ("--imager-pixel", "push/push-1=0.9")):
        done = spinestiff("init", out, option, value)
        assert done.status == 2 and done.err.endswith("; nothing is written\n")
        assert bytes_of(out) == before
    # What a picture contradicted before keeps nothing else from being filled.
    data = read_json(out / "subject.json") | {"xray": {"source_detector_mm": 1234.0}}
    write_json(out / "subject.json", data)
    assert spinestiff("init", out, "--side", "left").status == 0


def test_how_to_read_a_log_again_is_told_and_works(spinestiff, logged):
    folder, true = logged
    out, log = folder / "girl", ("--log", folder / "gauge.csv", "--log-offset")
    done = spinestiff("init", out, folder / "in", *PERSON, *SITE, *log, 5.5)
    again = "to read a force log again, write null for each of the push's forces_n in subject.json"
    assert done.status == 0 and f"if the offset is wrong ({again})" in done.out
    done = spinestiff("init", out, *log, 3.1)
    assert done.status == 2 and done.err.endswith(f"nothing is missing in it; {again}\n")
    data = read_json(out / "subject.json")
    data["pushes"][0]["forces_n"] = [None] * 30
    write_json(out / "subject.json", data)
    assert spinestiff("init", out, *log, 3.1).status == 0
    np.testing.assert_allclose(read_unannotated(out).pushes[0].forces_n, true, atol=0.6)
