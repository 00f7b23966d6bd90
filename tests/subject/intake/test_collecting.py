"""Files of nested folders, whose they are, and how the user names them."""

from __future__ import annotations

import os
import re

import pytest

from hospital import CANARY, disc, export
from spinestiff.errors import OptionError, RadiographError, SubjectError
from spinestiff.subject.intake.collecting import MOST_DEPTH, by_name, chosen_studies, collect, studies


def test_an_umlaut_is_the_same_however_a_system_writes_it(exported):
    """As one character, or as a Mac has it in names of files: a letter and two dots."""
    found = [exported("Scho\u0308n/I1"), exported("I2")]
    assert by_name("Schön/I1", found, "row 2") == (found[0],)
    assert by_name("Schön", [exported("Schön/I1"), exported("Schön/I2")], "row 2")[0].name == "Schön/I1"
    assert by_name("Scho\u0308n/I1", [exported("Schön/I1")], "row 2")[0].name == "Schön/I1"


def test_a_disc_is_read_to_its_depth_and_each_other_file_has_its_reason(tmp_path):
    found, refused = collect([disc(tmp_path / "disc")])
    assert [one.name.removeprefix("DICOM/PA000001/ST000001/") for one in found] == [
        f"SE00000{n}/IM000001" for n in (3, 4, 7, 8)
    ]
    assert [one.frames for one in found] == [1, 1, 3, 2]
    why = {one.name: one.why for one in refused}
    assert len(why) == 7
    assert why["DICOM/PA000001/ST000001/SE000011/IM000001"].startswith("Modality: found CT")
    assert why["autorun.inf"].startswith("no DICOM file")


def test_names_of_several_sources_begin_with_theirs(tmp_path):
    export(tmp_path / "one" / "a")
    export(tmp_path / "two" / "a")
    alone = export(tmp_path / "x.dcm")
    found, _ = collect([tmp_path / "one", tmp_path / "two", alone])
    assert [one.name for one in found] == ["one/a", "two/a", "x.dcm"]


def test_sources_of_one_name_are_told_apart_by_their_folders(tmp_path):
    for number, frames in (("cd1", 1), ("cd2", 20)):
        export(tmp_path / number / "DICOM" / "IM1", frames=frames)
    folders = [tmp_path / number / "DICOM" for number in ("cd1", "cd2")]
    for sources in (folders, [folder / "IM1" for folder in folders]):
        found, _ = collect(sources)
        assert [(one.name, one.frames) for one in found] == [("cd1/DICOM/IM1", 1), ("cd2/DICOM/IM1", 20)]
        assert by_name("cd2/DICOM/IM1", found, "row 2") == found[1:]
        with pytest.raises(SubjectError, match=r"'IM1' is the name of 2 radiographs \(cd1/DICOM/IM1, cd2/DICOM/IM1\)"):
            by_name("IM1", found, "row 2")


def test_a_source_named_twice_is_read_once(tmp_path):
    export(tmp_path / "cd" / "IM1")
    found, refused = collect([tmp_path / "cd", tmp_path / "cd"])
    assert ([one.name for one in found], refused) == (["IM1"], ())


@pytest.mark.skipif(os.name == "nt", reason="no links")
def test_sources_that_no_path_tells_apart_are_numbered(tmp_path):
    for folder in ("one", "two"):
        export(tmp_path / folder / "IM1")
    (tmp_path / "two" / "inner").mkdir()
    (tmp_path / "one" / "link").symlink_to(tmp_path / "two" / "inner")
    found, _ = collect([tmp_path / "one", tmp_path / "one" / "link" / ".."])
    assert [one.name for one in found] == ["1/one/IM1", "2/one/IM1"]


def test_the_same_image_counts_once(tmp_path):
    first = export(tmp_path / "in" / "a")
    (tmp_path / "in" / "b").write_bytes(first.read_bytes())
    found, refused = collect([tmp_path / "in"])
    assert [one.name for one in found] == ["a"]
    assert [(one.name, one.why) for one in refused] == [("b", "the same image as a")]


@pytest.mark.skipif(os.name == "nt", reason="no links")
def test_links_out_of_the_folder_and_to_folders_are_not_followed(tmp_path):
    outside = export(tmp_path / "elsewhere" / "a")
    export(tmp_path / "in" / "b")
    (tmp_path / "in" / "link").symlink_to(outside)
    (tmp_path / "in" / "loop").symlink_to(tmp_path / "in")
    found, refused = collect([tmp_path / "in"])
    assert [one.name for one in found] == ["b"]
    why = {one.name: one.why for one in refused}
    assert "leads out of the folder in" in why["link"] and why["loop"].startswith("a link to a folder")


def test_nothing_to_read_and_folders_without_end_are_refused(tmp_path):
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "a.txt").write_text("no")
    with pytest.raises(RadiographError, match=r"^found no radiograph in 1 file of .*; a\.txt: no DICOM file"):
        collect([tmp_path / "in"])
    export(tmp_path.joinpath("deep", *"f" * (MOST_DEPTH + 1), "a"))
    with pytest.raises(RadiographError, match=rf"folders more than {MOST_DEPTH} deep; name one of those inside$"):
        collect([tmp_path / "deep"])
    with pytest.raises(RadiographError, match="no such file"):
        collect([tmp_path / "nowhere"])


@pytest.fixture
def mixed(exported):
    return [
        exported("x/1", time="101500"),
        exported("x/2", "lateral", time="101600"),
        exported("x/3", frames=2, time="102000"),
        exported("y/1", study="1.2.2", time="111500"),
        exported("z/1", patient="P2", study="1.2.9", time="091500"),
    ]


def test_patients_and_studies_are_counted_in_order_of_time(mixed):
    assert [(group.label, [one.name for one in group.files]) for group in studies(mixed)] == [
        ("A1", ["z/1"]),
        ("B1", ["x/1", "x/2", "x/3"]),
        ("B2", ["y/1"]),
    ]


def test_several_are_refused_in_one_line_without_the_patients(mixed):
    with pytest.raises(SubjectError) as caught:
        chosen_studies(mixed, None)
    line = str(caught.value)
    assert line == (
        "found 2 patients and 3 studies, wanted one: A1 (1 file: 1 frontal; z/1), B1 (3 files: 1 frontal, 1 lateral, 1 "
        "of several frames; x/1), B2 (1 file: 1 frontal; y/1); choose with --study A1, or several of one patient, as "
        "--study B1,B2"
    )
    assert not any(plain in line for plain in (CANARY, "P1", "P2", "1.2.9"))


def test_one_study_or_several_of_one_patient_can_be_chosen(mixed):
    files, others = chosen_studies(mixed, "b1, B2")
    assert [one.name for one in files] == ["x/1", "x/2", "x/3", "y/1"]
    assert [group.label for group in others] == ["A1"]
    assert [one.name for one in chosen_studies(mixed[:3], None)[0]] == ["x/1", "x/2", "x/3"]
    with pytest.raises(OptionError, match=r"^--study C1: no such study; there are A1 "):
        chosen_studies(mixed, "C1")
    with pytest.raises(OptionError, match=r"^--study A1,B1: studies of several patients"):
        chosen_studies(mixed, "A1,B1")


def test_persons_without_a_number_are_told_apart_by_name_and_birth_date(exported):
    def of(path, study, **tags):
        return exported(path, study=study, **{"patient": "", "PatientBirthDate": "20110203", **tags})

    found = [
        of("a", "1.1", PatientName="Doe^Jane", time="100000"),
        of("b", "1.2", PatientName="Roe^Ann", time="100100"),
        of("c", "1.3", PatientName="", time="100200"),
        # Married, or registered anew: the number says it, else name and birth date.
        of("d", "1.4", PatientName="Doe^Jane", patient="7", time="100300"),
        of("e", "1.5", PatientName="Poe^Jane", patient="7", time="100400"),
    ]
    assert [(group.label, group.files[0].name) for group in studies(found[:4])] == [
        ("A1", "a"), ("A2", "d"), ("B1", "b"), ("C1", "c")
    ]  # fmt: skip
    for two in ("A1,B1", "A2,B1"):
        with pytest.raises(OptionError, match=f"^--study {two}: studies of several patients"):
            chosen_studies(found[:4], two)
    # Whose c is nothing tells: the user says it.
    assert [one.name for one in chosen_studies(found[:4], "A1,C1")[0]] == ["a", "c"]
    assert [group.label for group in studies(found[3:])] == ["A1", "A2"]
    # Pseudonyms of files whose patients were taken out stand for numbers.
    out = [of(f"x{name}", f"2.{name}", patient=f"P{name // 2}", PatientIdentityRemoved="YES") for name in (2, 3, 4)]
    assert [group.label for group in studies(out)] == ["A1", "A2", "B1"]


def test_a_person_is_one_however_name_and_date_are_written(exported):
    tags = ({"PatientName": "Doe^Jane", "PatientBirthDate": "20110203"},
            {"PatientName": "DOE ^Jane^^^", "PatientBirthDate": "2011.02.03"})  # fmt: skip
    found = [exported(name, study=f"1.{i}", patient="", **one) for i, (name, one) in enumerate(zip("ab", tags), 1)]
    assert [group.label for group in studies(found)] == ["A1", "A2"]


def test_a_study_is_of_one_person_unless_its_files_contradict_each_other(exported):
    def of(path, **tags):
        return exported(path, study="1.1", patient="", **{"PatientBirthDate": "20110203", **tags})

    found = [of("a", PatientName="Doe^Jane"), of("b", PatientName=""), of("c", PatientName="Roe^Ann")]
    assert [[one.name for one in group.files] for group in studies(found)] == [["a", "b"], ["c"]]
    out = [of(name, PatientName=name, PatientIdentityRemoved="YES") for name in ("x", "y")]
    assert [group.label for group in studies(out)] == ["A1"]


def test_a_file_of_a_study_that_is_left_out_is_told_as_such(mixed):
    files, others = chosen_studies(mixed, "B1")
    for text in ("y/1", "y"):
        with pytest.raises(SubjectError, match=f"^--frontal: '{text}' is of study B2, which --study leaves out"):
            by_name(text, files, "--frontal", others)
    with pytest.raises(SubjectError, match="no radiograph 'w/9' in the sources"):
        by_name("w/9", files, "--frontal", others)


def test_a_file_is_named_by_the_end_of_its_path(exported):
    found = [exported("a/s1/I1"), exported("a/s2/I1"), exported("b/I10"), exported("I1")]
    names = {
        text: [one.name for one in by_name(text, found, "row 2")] for text in ("s2/I1", "I10", "I1", "b", "s1\\I1")
    }
    assert names == {"s2/I1": ["a/s2/I1"], "I10": ["b/I10"], "I1": ["I1"], "b": ["b/I10"], "s1\\I1": ["a/s1/I1"]}
    with pytest.raises(SubjectError, match=re.escape("row 2: 'I1' is the name of 2 radiographs (a/s1/I1, a/s2/I1)")):
        by_name("I1", found[:3], "row 2")
    with pytest.raises(SubjectError, match=r"^row 2: no radiograph 'I9' in the sources; there are a/s1/I1, "):
        by_name("I9", found, "row 2")


def test_a_file_that_is_left_out_is_told_with_its_reason_where_it_is_named(tmp_path):
    one = export(tmp_path / "in" / "a" / "I1")
    (tmp_path / "in" / "b").mkdir()
    (tmp_path / "in" / "b" / "I2").write_bytes(one.read_bytes())
    (tmp_path / "in" / "b" / "I3").write_bytes(one.read_bytes()[:3000])
    found, refused = collect([tmp_path / "in"])
    twin = "row 2: b/I2 can't be taken: the same image as a/I1; name a/I1"
    damaged = next(left.why for left in refused if left.name == "b/I3")
    for name, words in (("I2", twin), ("b", twin), ("b/I3", f"row 2: b/I3 can't be taken: {damaged}")):
        with pytest.raises(SubjectError, match=re.escape(words)):
            by_name(name, found, "row 2", refused=refused)
