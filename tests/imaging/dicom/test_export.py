"""What a file of an export tells beside its picture: view, use, patient, age; as hashes and categories alone."""

from __future__ import annotations

import numpy as np
import pydicom
import pytest
from pydicom.dataelem import RawDataElement
from pydicom.tag import Tag

from hospital import CANARY, export
from spinestiff.errors import RadiographError
from spinestiff.imaging.dicom.export import read_exported
from spinestiff.imaging.dicom.person_tags import export_tags


@pytest.fixture
def read(tmp_path):
    def make(*args, **kwargs):
        return read_exported(export(tmp_path / "a", *args, **kwargs), "a", tmp_path)

    return make


def test_the_orientation_tells_the_view_before_anything_else(read):
    one = read("lateral", SeriesDescription="AP standing")
    assert (one.view, one.view_source) == ("lateral", "PatientOrientation A\\F")


def test_the_view_position_tells_it_without_an_orientation(read):
    one = read(without=("PatientOrientation",), SeriesDescription="LAT")
    assert (one.view, one.view_source) == ("frontal", "ViewPosition AP")


@pytest.mark.parametrize(
    ("words", "view", "use"),
    [
        ("WS ap stehend", "frontal", "rest"),
        ("Spine A.P.", "frontal", None),
        ("wirbelsaeule LAT", "lateral", None),
        ("seitlich", "lateral", None),
        ("AP + LAT", None, None),
        ("lateral bending left", None, "bending"),
        ("Seitneigung links", None, "bending"),
        ("bending push 40 N", None, "push"),
        ("WS Bending neutral", None, None),
        ("WS seitl. stehend", "lateral", "rest"),
        ("push standing", None, None),
        ("scapula flat", None, None),
        ("", None, None),
    ],
)
def test_words_of_the_series_are_a_hint_where_nothing_else_tells(read, words, view, use):
    one = read(without=("PatientOrientation", "ViewPosition"), SeriesDescription=words)
    assert (one.view, one.tags.use) == (view, use)
    assert one.view_source == ("words of the series" if view else "")


@pytest.mark.parametrize(
    ("tags", "age"),
    [
        ({"PatientAge": "013Y"}, 13.0),
        ({"PatientAge": "156M"}, 13.0),
        ({"PatientAge": "13"}, None),
        ({"PatientAge": "000Y"}, None),
        ({"PatientBirthDate": "20120504"}, 13.1),
        ({"PatientBirthDate": "20120504", "PatientAge": "099Y"}, 13.1),
        ({"PatientBirthDate": "18000101", "PatientAge": "013Y"}, 13.0),
        ({}, None),
    ],
)
def test_the_age_comes_from_the_birth_date_or_the_age(read, tags, age):
    assert read(**tags).tags.age == age


def test_sex_and_hashes_and_nothing_in_plain(read):
    # No text that a hash could hold by chance.
    one = read(PatientSex="F", patient="no. 4711", study="1.2.77.88.99")
    assert one.tags.sex == "female"
    assert read(PatientSex="O").tags.sex is None
    assert len({one.scan.whose.marks[0], one.tags.study, one.tags.series}) == 3
    assert not any(plain in repr(one) for plain in (CANARY, "no. 4711", "1.2.77.88.99"))


def test_the_time_is_that_of_the_exposure_else_of_its_content(read):
    first, second = read(time="101500").tags.moment, read(time="101520").tags.moment
    assert second - first == 20.0
    later = read(time=None, ContentDate="20250612", ContentTime="101530.5").tags.moment
    assert later - first == 30.5
    assert read(time=None).tags.moment is None


@pytest.mark.parametrize("keyword", ["PatientBirthDate", "StudyDate", "SeriesDescription", "ContentTime", "PatientSex"])
def test_a_value_that_cannot_be_parsed_tells_nothing(tmp_path, keyword):
    dataset = pydicom.dcmread(export(tmp_path / "a", PatientAge="012Y", without=("AcquisitionDate",)))
    tag = Tag(keyword)
    dataset.pop(tag, None)
    dataset._dict[tag] = RawDataElement(tag, "US", 3, b"\x01\x02\x03", 0, False, True)
    found = export_tags(dataset)
    assert (found.age, found.sex, found.view) == (12.0, None, "frontal")
    assert found.moment == 10 * 3600 + 15 * 60


def test_a_picture_of_one_grey_value_is_no_radiograph(read):
    with pytest.raises(RadiographError, match=r"^shows nothing: the whole picture has one grey value$"):
        read(pixels=np.full((1, 32, 32), 700, np.uint16))


def test_other_modalities_are_told_before_they_are_read(tmp_path):
    with pytest.raises(RadiographError, match=r"^Modality: found CT, wanted a projection radiograph"):
        read_exported(export(tmp_path / "a", Modality="CT", without=("PixelData",)), "a", tmp_path)
