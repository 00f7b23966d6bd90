"""PatientOrientation, view position and laterality decide left and right; what contradicts is refused."""

from __future__ import annotations

import numpy as np
import pytest
from pydicom.dataset import Dataset
from pydicom.sequence import Sequence

from spinestiff.errors import RadiographError
from spinestiff.imaging.radiograph import Geometry, read_radiographs

LEFT_LATERAL, RIGHT_LATERAL, AP = "399173006", "399198007", "399348003"


def viewed(code: str):
    def change(dataset: Dataset) -> None:
        item = Dataset()
        item.CodeValue, item.CodingSchemeDesignator, item.CodeMeaning = code, "SCT", "view"
        dataset.ViewCodeSequence = Sequence([item])

    return change


@pytest.mark.parametrize(
    ("values", "change", "beam", "source"),
    [
        ({"ViewPosition": "RL"}, None, [-1, 0, 0], "DICOM ViewPosition RL"),
        ({"ViewPosition": ""}, viewed(RIGHT_LATERAL), [-1, 0, 0], "DICOM ViewPosition RL"),
        # What is no view position of DICOM says nothing, and hides no code.
        ({"ViewPosition": "RLAT"}, viewed(RIGHT_LATERAL), [-1, 0, 0], "DICOM ViewPosition RL"),
        ({"ViewPosition": "RLAT"}, None, [1, 0, 0], "assumed right to left"),
        ({"ViewPosition": "", "ImageLaterality": "R"}, None, [-1, 0, 0], "DICOM laterality R"),
        ({"ViewPosition": "", "Laterality": "L"}, None, [1, 0, 0], "DICOM laterality L"),
        ({"ViewPosition": "", "ImageLaterality": "U"}, None, [1, 0, 0], "assumed right to left"),
        ({"ViewPosition": "LL", "ImageLaterality": "L"}, viewed(LEFT_LATERAL), [1, 0, 0], "DICOM ViewPosition LL"),
    ],
)
def test_the_beam_of_a_lateral_view(file, values, change, beam, source):
    (radiograph,) = read_radiographs(file(change=change, PatientOrientation=["A", "F"], **values))
    np.testing.assert_allclose(radiograph.view.normal, beam, atol=1e-12)
    assert radiograph.provenance["beam"].startswith(source)


@pytest.mark.parametrize(
    ("position", "given", "beam", "source"),
    [
        ("", None, [0, 0, -1], "assumed anterior to posterior"),
        ("", "PA", [0, 0, 1], "given as PA"),
        ("", "AP", [0, 0, -1], "given as AP"),
        ("PA", "PA", [0, 0, 1], "DICOM ViewPosition PA"),
        ("AP", "PA", [0, 0, -1], "DICOM ViewPosition AP"),  # one picture of several that tells
    ],
)
def test_the_beam_of_a_frontal_view(file, position, given, beam, source):
    (radiograph,) = read_radiographs(file(ViewPosition=position), geometry=Geometry(beam=given))
    np.testing.assert_allclose(radiograph.view.normal, beam, atol=1e-12)
    assert radiograph.provenance["beam"] == source


def test_the_laterality_of_a_frontal_view_turns_nothing(file):
    (radiograph,) = read_radiographs(file(ImageLaterality="R"))
    np.testing.assert_array_equal(radiograph.view.detector_axes[0], [1, 0, 0])


@pytest.mark.parametrize(
    ("values", "change", "given", "message"),
    [
        ({"ViewPosition": "LL"}, None, None, r"ViewPosition: found LL, wanted one of a frontal view \(DICOM Pat"),
        ({"PatientOrientation": ["A", "F"]}, None, None, "found AP, wanted one of a lateral view"),
        ({"PatientOrientation": None}, None, "lateral", r"found AP, wanted one of a lateral view \(given as a"),
        ({}, viewed(LEFT_LATERAL), None, "found AP, wanted LL as ViewCodeSequence says"),
        ({"ImageLaterality": "L", "Laterality": "R"}, None, None, "found L, wanted R as in Laterality"),
        (
            {"PatientOrientation": ["A", "F"], "ViewPosition": "LL", "ImageLaterality": "R"}, None, None,
            "ViewPosition: found LL, wanted RL as the laterality says",
        ),
        ({"PatientOrientation": ["L", "A"]}, None, None, r"found L\\A, wanted columns to L, R, A or P"),
    ],
)  # fmt: skip
def test_contradictions_are_refused(file, values, change, given, message):
    with pytest.raises(RadiographError, match=message):
        read_radiographs(file(change=change, **values), geometry=Geometry(view=given))
