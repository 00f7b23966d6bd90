"""Whose radiographs: compared by hashes in this process, never said."""

from __future__ import annotations

import numpy as np
import pytest

from canaries import CANARY, infest, traces
from spinestiff.errors import RadiographError
from spinestiff.imaging.dicom.identity import read_identity

GIRL = {
    "PatientID": "12",
    "PatientName": "Doe^Jane",
    "PatientBirthDate": "20110203",
    "AcquisitionDate": "20240501",
    "PatientIdentityRemoved": "NO",
}


@pytest.fixture
def identity(file):
    """The identity of a file with the girl's tags and others."""
    made = []

    def make(**tags):
        made.append(file(name=f"{len(made)}.dcm", **{**GIRL, **tags}))
        return read_identity(made[-1])

    return make


def test_one_patient_in_two_files(identity):
    assert identity().is_of(identity()) is True


@pytest.mark.parametrize(
    ("tags", "same"),
    [
        # Another hospital's number, the same person.
        ({"PatientID": "77"}, True),
        ({"PatientID": "77", "PatientName": "DOE^JANE "}, True),
        # Married, or spelt otherwise: the number says it.
        ({"PatientName": "Roe^Jane"}, True),
        ({"PatientID": "77", "PatientName": "Roe^Jane"}, False),
        ({"PatientID": "77", "PatientBirthDate": "20100203"}, False),
        ({"PatientID": "77", "PatientName": ""}, False),
        # A name alone is many people's.
        ({"PatientID": "", "PatientBirthDate": ""}, None),
        ({"PatientID": "", "PatientName": ""}, None),
    ],
)
def test_what_makes_two_files_one_patients(identity, tags, same):
    assert identity().is_of(identity(**tags)) is same
    assert identity(**tags).is_of(identity()) is same


def test_a_file_whose_patient_was_taken_out_tells_nothing(identity):
    """Every patient of a study may be called the same there, and dates may be moved."""
    out = identity(PatientIdentityRemoved="YES")
    assert out.is_of(identity()) is None
    assert identity().is_of(out) is None
    assert out.days_from(identity()) is None
    assert identity().days_from(out) is None


@pytest.mark.parametrize(
    ("tags", "days"),
    [
        ({}, 0),
        ({"AcquisitionDate": "20240601"}, 31),
        ({"AcquisitionDate": "20230501"}, 366),
        ({"AcquisitionDate": "", "StudyDate": "20240502"}, 1),
        ({"AcquisitionDateTime": "20240503120000.5"}, 2),
        ({"AcquisitionDate": "", "StudyDate": ""}, None),
    ],
)
def test_days_between_exposures(identity, tags, days):
    assert identity().days_from(identity(**tags)) == days
    assert identity(**tags).days_from(identity()) == days


def test_nothing_of_the_patient_can_be_read_off(file):
    path = file(np.zeros((1, 40, 36), np.uint16))
    infest(path, np.random.default_rng(0), 60)
    found = read_identity(path)
    assert not traces(repr(found), str(found), f"{found.marks}")
    assert found.marks[0]
    assert "marks" not in repr(found)


def test_a_file_that_is_no_radiograph_is_named(tmp_path):
    path = tmp_path / "a.dcm"
    path.write_bytes(f"{CANARY}".encode() * 100)
    with pytest.raises(RadiographError, match=r"^a\.dcm: no DICOM file"):
        read_identity(path)


@pytest.mark.parametrize(
    ("beginning", "words"),
    [
        (b"\x89PNG\r\n", "a PNG picture, which has no millimetres; export the radiograph as DICOM Part 10"),
        (b"\xff\xd8\xff\xe0", "a JPEG picture"),
        (b"II*\0", "a TIFF picture"),
        (b"PK\x03\x04", "a zip archive; unpack it, and name the folder with what was in it"),
        (b"\x1f\x8b\x08", "a gzip archive; unpack it"),
    ],
)
def test_what_people_have_in_place_of_dicom_is_named(tmp_path, beginning, words):
    path = tmp_path / "a"
    path.write_bytes(beginning + bytes(300))
    with pytest.raises(RadiographError) as caught:
        read_identity(path)
    assert str(caught.value).startswith(f"a: no DICOM file but {words}")
