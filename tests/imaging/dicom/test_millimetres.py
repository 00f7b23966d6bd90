"""Millimetres come from what a file or subject.json states, agree with each other, and are never guessed."""

from __future__ import annotations

import numpy as np
import pytest

from spinestiff.errors import RadiographError
from spinestiff.imaging.dicom.tags import MissingValue
from spinestiff.imaging.radiograph import Geometry, Scale, read_radiographs

M = 1500.0 / 1340.0
NO_SPACING = {"ImagerPixelSpacing": None}


def view_of(path, geometry=None):
    (radiograph,) = read_radiographs(path, geometry=geometry)
    return radiograph.view, radiograph.provenance


@pytest.mark.parametrize(
    ("values", "distances", "source"),
    [
        ({"DistanceSourceToPatient": None}, (1500.0, 1250.0), "source to detector over EstimatedRadiographicMag"),
        ({"DistanceSourceToDetector": None}, (1608.0, 1340.0), "source to patient times EstimatedRadiographicMag"),
    ],
)
def test_a_magnification_gives_the_missing_distance(file, values, distances, source):
    view, provenance = view_of(file(EstimatedRadiographicMagnificationFactor="1.2", **values))
    assert (view.source_to_detector, view.source_to_patient) == pytest.approx(distances)
    assert any(text.startswith(source) for text in provenance.values())


def test_two_spacings_give_the_missing_distance(file):
    view, provenance = view_of(
        file(DistanceSourceToPatient=None, PixelSpacing=["0.32", "0.32"], PixelSpacingCalibrationType="FIDUCIAL")
    )
    assert view.source_to_patient == pytest.approx(1500.0 * 0.32 / 0.4)
    assert "ImagerPixelSpacing over calibrated PixelSpacing 1.25" in provenance["source to patient"]


def test_zero_distances_and_a_magnification_of_one_mean_unknown(file):
    with pytest.raises(MissingValue, match="no DistanceSourceToPatient; add source_patient_mm"):
        view_of(file(DistanceSourceToPatient="0", EstimatedRadiographicMagnificationFactor="1"))
    with pytest.raises(MissingValue, match="no DistanceSourceToDetector and no DistanceSourceToPatient; add source_d"):
        view_of(file(DistanceSourceToPatient=None, DistanceSourceToDetector="0"))


def test_spacing_without_a_plane_is_not_used_but_does_no_harm(file):
    view, provenance = view_of(file(PixelSpacing=["0.1", "0.1"]))
    np.testing.assert_array_equal(view.pixel_spacing, [0.4, 0.4])
    assert provenance["pixel spacing"] == "DICOM ImagerPixelSpacing, at the detector"


def test_pixels_that_are_not_square_stay_so(file):
    view, _ = view_of(file(ImagerPixelSpacing=["1.2", "1.201199999999"]))
    np.testing.assert_allclose(view.pixel_spacing, [1.2012, 1.2])
    assert view.from_pixels([10.0, 20.0]) == pytest.approx([12.012, 24.0])


def test_a_given_scale_knows_pixels_that_are_not_square(file):
    path = file(PixelAspectRatio=["4", "5"], **NO_SPACING)
    scale = Scale(20.0, ((5.0, 5.0), (5.0, 30.0)), "detector")  # 25 rows of 20 mm: 0.8 mm a row
    view, provenance = view_of(path, Geometry(scale=scale))
    np.testing.assert_allclose(view.pixel_spacing, [1.0, 0.8])
    assert provenance["pixel spacing"] == "object of 20 mm over 20.0 pixels at the detector"


def test_a_scale_at_the_patient_is_magnified(file):
    scale = Scale(10.0, ((2.0, 3.0), (26.0, 10.0)), what="calibration object")
    view, provenance = view_of(file(**NO_SPACING), Geometry(scale=scale))
    np.testing.assert_allclose(view.pixel_spacing, 10.0 / 25.0 * M)
    assert view.to_patient_plane(view.from_pixels([26.0, 10.0])) - view.to_patient_plane(
        view.from_pixels([2.0, 3.0])
    ) == pytest.approx([9.6, 2.8])
    assert provenance["pixel spacing"].startswith("calibration object of 10 mm over 25.0 pixels at the patient plane")


def test_a_scale_that_agrees_leaves_the_file_its_word(file):
    scale = Scale(24 * 0.4 / M * 1.04, ((2.0, 3.0), (26.0, 3.0)))
    view, provenance = view_of(file(), Geometry(scale=scale))
    np.testing.assert_array_equal(view.pixel_spacing, [0.4, 0.4])
    assert provenance["pixel spacing"] == "DICOM ImagerPixelSpacing, at the detector"


ENDS = ((2.0, 3.0), (26.0, 3.0))
REFUSED = {
    "magnification against distances": (
        {"EstimatedRadiographicMagnificationFactor": "1.2"}, None,
        "EstimatedRadiographicMagnificationFactor is 1.2, but the distances magnify 1.119 times",
    ),
    "spacings against distances": (
        {"PixelSpacing": ["0.3", "0.3"], "PixelSpacingCalibrationType": "GEOMETRY"}, None,
        "ImagerPixelSpacing over calibrated PixelSpacing is 1.333, but the distances magnify 1.119",
    ),
    "magnification below one": ({"EstimatedRadiographicMagnificationFactor": "0.8"}, None, "is 0.8; wanted 1 to 3"),
    "calibrated wider than the detector": (
        {"PixelSpacing": ["0.5", "0.5"], "PixelSpacingCalibrationType": "FIDUCIAL"}, None, "is 0.8; wanted 1 to 3",
    ),
    "far magnified": ({"DistanceSourceToPatient": "400"}, None, "magnifies 3.75 times; wanted at most 3"),
    "fine": ({"ImagerPixelSpacing": ["0.01", "0.01"]}, None, "ImagerPixelSpacing 0.01 mm; wanted 0.02 to 2"),
    "oblong": ({"ImagerPixelSpacing": ["0.4", "0.1"]}, None, "0.4 x 0.1 mm: no detector has pixels so far from square"),
    "aspect": (
        {"PixelAspectRatio": ["4", "5"]}, None, "ImagerPixelSpacing 0.4 x 0.4 mm, but PixelAspectRatio is 0.8",
    ),
    "one pitch for oblong pixels": (
        {"PixelAspectRatio": ["4", "5"], **NO_SPACING}, Geometry(imager_pixel_mm=0.4), "imager_pixel_mm can't hold",
    ),
    "three numbers": ({"ImagerPixelSpacing": ["0.4", "0.4", "0.4"]}, None, "ImagerPixelSpacing isn't two numbers"),
    "scale against file": ({}, Geometry(scale=Scale(10.0, ENDS)), "makes the object 8.576 mm long, but subject.json"),
    "short scale": (
        NO_SPACING, Geometry(scale=Scale(5.0, ((2.0, 3.0), (20.0, 3.0)))), "spans 18 pixels; wanted 20 or more",
    ),
    "scale outside": (
        NO_SPACING, Geometry(scale=Scale(9.0, ((2.0, 3.0), (36.0, 3.0)))), "lies outside the image",
    ),
    "scale against pitch": (
        NO_SPACING, Geometry(imager_pixel_mm=0.4, scale=Scale(10.0, ENDS)), "given imager_pixel_mm makes the object",
    ),
    "scanned film": (
        {"NominalScannedPixelSpacing": ["0.2", "0.2"], **NO_SPACING}, None,
        r"NominalScannedPixelSpacing 0.2 mm is on the film\); add imager_pixel_mm",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_contradictions_and_the_implausible_are_refused(file, name):
    values, geometry, message = REFUSED[name]
    with pytest.raises(RadiographError, match=message) as refusal:
        view_of(file(**values), geometry)
    assert str(refusal.value).startswith("a.dcm: ")


def test_a_wall_of_pixels_is_no_detector(file):
    pixels = np.zeros((1, 40, 36), np.uint16)
    path = file(pixels, Rows=1300, Columns=1, ImagerPixelSpacing=["2", "2"], PixelData=b"\0" * 2600)
    with pytest.raises(RadiographError, match="an image of 2600 mm; wanted at most 2500"):
        view_of(path)
