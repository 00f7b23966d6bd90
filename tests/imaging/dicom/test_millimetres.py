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
    with pytest.raises(MissingValue, match="DistanceSourceToPatient is 0; add xray"):
        view_of(file(DistanceSourceToPatient="0", EstimatedRadiographicMagnificationFactor="1"))
    with pytest.raises(MissingValue, match="DistanceSourceToDetector is 0 and no DistanceSourceToPatient; add x"):
        view_of(file(DistanceSourceToPatient=None, DistanceSourceToDetector="0"))


def test_a_digital_radiograph_tells_the_distance_of_its_support_not_of_the_spine(file):
    """PS3.3 C.8.11.5: to the table or bucky; the magnification of such a file is that of the same place."""
    spine = Geometry(source_patient_mm=1280.0)
    view, provenance = view_of(file(EstimatedRadiographicMagnificationFactor=f"{M:.4f}"), spine)
    assert (view.source_to_detector, view.source_to_patient) == (1500.0, 1280.0)
    assert provenance["source to patient"].startswith("given source_patient_mm, since DistanceSourceToPatient 1340 mm")
    view, provenance = view_of(file())
    assert view.source_to_patient == 1340.0
    assert provenance["source to patient"] == (
        "DICOM DistanceSourceToPatient: of such a file that of table or bucky; source_patient_mm takes the spine's"
    )
    # As near as the file's it is the file's; behind the support, or farther before it than a trunk, is no spine.
    view, provenance = view_of(file(), Geometry(source_patient_mm=1330.0))
    assert view.source_to_patient == 1340.0
    assert provenance["source to patient"] == "DICOM DistanceSourceToPatient"
    for wrong in (1400.0, 1000.0):
        with pytest.raises(RadiographError, match=f"found 1340 mm, wanted {wrong:g} mm to 1 %"):
            view_of(file(), Geometry(source_patient_mm=wrong))
    with pytest.raises(RadiographError, match=r"MagnificationFactor: found 1\.2, wanted 1\.119"):
        view_of(file(EstimatedRadiographicMagnificationFactor="1.2"), spine)
    # Of fluoroscopy the standard has no such support.
    series = file(np.zeros((2, 40, 36), np.uint16))
    with pytest.raises(RadiographError, match="found 1340 mm, wanted 1280 mm to 1 %"):
        read_radiographs(series, geometry=spine)


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
        "EstimatedRadiographicMagnificationFactor: found 1.2, wanted 1.119 as the distances say",
    ),
    "spacings against distances": (
        {"PixelSpacing": ["0.3", "0.3"], "PixelSpacingCalibrationType": "GEOMETRY"}, None,
        "ImagerPixelSpacing over calibrated PixelSpacing: found 1.333, wanted 1.119 as the distances",
    ),
    "magnification below one": ({"EstimatedRadiographicMagnificationFactor": "0.8"}, None, "found 0.8, wanted 1 to 3"),
    "calibrated wider than the detector": (
        {"PixelSpacing": ["0.5", "0.5"], "PixelSpacingCalibrationType": "FIDUCIAL"}, None, "found 0.8, wanted 1 to 3",
    ),
    "far magnified": ({"DistanceSourceToPatient": "400"}, None, "magnifies 3.75 times, wanted at most 3"),
    "fine": ({"ImagerPixelSpacing": ["0.01", "0.01"]}, None, r"ImagerPixelSpacing: found 0.01\\0.01 mm, wanted 0.02"),
    "oblong": ({"ImagerPixelSpacing": ["0.4", "0.1"]}, None, r"found 0.4\\0.1 mm, wanted sides of at most 1.5 to 1"),
    "aspect": (
        {"PixelAspectRatio": ["4", "5"]}, None,
        r"ImagerPixelSpacing: found 0.4\\0.4 mm, wanted pixels of the same shape as PixelAspectRatio 0.8",
    ),
    "one pitch for oblong pixels": (
        {"PixelAspectRatio": ["4", "5"], **NO_SPACING}, Geometry(imager_pixel_mm=0.4),
        "PixelAspectRatio: found 0.8, .* wanted square ones for the given imager_pixel_mm 0.4",
    ),
    "three numbers": ({"ImagerPixelSpacing": ["0.4", "0.4", "0.4"]}, None, "ImagerPixelSpacing: found 3 values"),
    "scale against file": ({}, Geometry(scale=Scale(10.0, ENDS)), "found 8.576 mm for the object, wanted 10 mm as"),
    "short scale": (
        NO_SPACING, Geometry(scale=Scale(5.0, ((2.0, 3.0), (20.0, 3.0)))), "found 18 pixels over the object, wanted 20",
    ),
    "scale outside": (
        NO_SPACING, Geometry(scale=Scale(9.0, ((2.0, 3.0), (36.0, 3.0)))), "found an end of the object outside",
    ),
    "scale against pitch": (
        NO_SPACING, Geometry(imager_pixel_mm=0.4, scale=Scale(10.0, ENDS)), "given imager_pixel_mm: found 8.576 mm for",
    ),
    "scanned film": (
        {"NominalScannedPixelSpacing": ["0.2", "0.2"], **NO_SPACING}, None,
        r"found NominalScannedPixelSpacing 0.2\\0.2 mm on the film, wanted ImagerPixelSpacing; add xray.imager",
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
    with pytest.raises(RadiographError, match="found an image of 2600 mm, wanted at most 2500"):
        view_of(path)


# What the file says beside what is given

GIVEN, SCALED = Geometry(imager_pixel_mm=0.4), Geometry(scale=Scale(20.0, ((5.0, 5.0), (5.0, 30.0)), "detector"))
FIDUCIAL = {"PixelSpacingCalibrationType": "FIDUCIAL"}
AT_PATIENT = f"{0.4 / M:.6f}"
ZERO, PLANELESS = ["0", "0"], "of no known plane"
USED = {
    "nothing": ({}, GIVEN, (0.4, 0.4), "given imager_pixel_mm, at the detector"),
    "zero at the detector": (
        {"ImagerPixelSpacing": ZERO}, GIVEN, (0.4, 0.4),
        "given imager_pixel_mm, at the detector; not used: ImagerPixelSpacing 0\\0 mm (zero)",
    ),
    "zero": (
        {"PixelSpacing": ZERO}, GIVEN, (0.4, 0.4),
        "given imager_pixel_mm, at the detector; not used: PixelSpacing 0\\0 mm (zero)",
    ),
    "zero, calibrated": (
        {"PixelSpacing": ZERO, **FIDUCIAL}, GIVEN, (0.4, 0.4),
        "given imager_pixel_mm, at the detector; not used: PixelSpacing 0\\0 mm (zero)",
    ),
    "zeros": (
        {"ImagerPixelSpacing": ZERO, "PixelSpacing": ZERO, "NominalScannedPixelSpacing": ZERO}, GIVEN, (0.4, 0.4),
        "given imager_pixel_mm, at the detector; not used: ImagerPixelSpacing 0\\0 mm (zero), PixelSpacing 0\\0 mm "
        "(zero), NominalScannedPixelSpacing 0\\0 mm (zero)",
    ),
    "of no plane": (
        {"PixelSpacing": ["0.1", "0.1"]}, GIVEN, (0.4, 0.4),
        f"given imager_pixel_mm, at the detector; not used: PixelSpacing 0.1\\0.1 mm {PLANELESS}",
    ),
    "the film's": (
        {"NominalScannedPixelSpacing": ["0.2", "0.2"]}, GIVEN, (0.4, 0.4),
        "given imager_pixel_mm, at the detector; not used: NominalScannedPixelSpacing 0.2\\0.2 mm on the film",
    ),
    "the same": (
        {"ImagerPixelSpacing": ["0.401", "0.4"]}, GIVEN, (0.4, 0.401), "DICOM ImagerPixelSpacing, at the detector",
    ),
    "zero at the detector, calibrated": (
        {"ImagerPixelSpacing": ZERO, "PixelSpacing": [AT_PATIENT, AT_PATIENT], **FIDUCIAL}, None, (0.4, 0.4),
        "DICOM PixelSpacing, calibrated by FIDUCIAL at the patient plane, times the magnification; "
        "not used: ImagerPixelSpacing 0\\0 mm (zero)",
    ),
    "calibrated within 5 %": (
        {"PixelSpacing": [AT_PATIENT, AT_PATIENT], **FIDUCIAL}, Geometry(imager_pixel_mm=0.415), (0.4, 0.4),
        "DICOM PixelSpacing, calibrated by FIDUCIAL at the patient plane, times the magnification",
    ),
    "a scale, oblong pixels of no plane": (
        {"PixelSpacing": ["0.08", "0.1"]}, SCALED, (1.0, 0.8),
        f"object of 20 mm over 20.0 pixels at the detector; not used: PixelSpacing 0.08\\0.1 mm {PLANELESS}",
    ),
    "a scale, zero": (
        {"ImagerPixelSpacing": ZERO}, SCALED, (0.8, 0.8),
        "object of 20 mm over 25.0 pixels at the detector; not used: ImagerPixelSpacing 0\\0 mm (zero)",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", USED)
def test_what_the_file_says_beside_the_spacing_that_is_used_is_told(file, name):
    values, geometry, spacing, source = USED[name]
    view, provenance = view_of(file(**{**NO_SPACING, **values}), geometry)
    np.testing.assert_allclose(view.pixel_spacing, spacing, rtol=1e-5)
    assert provenance["pixel spacing"] == source


OBLONG = ["0.4", "0.5"]
CONTRADICTED = {
    "another pitch": (
        {"ImagerPixelSpacing": ["0.42", "0.42"]}, GIVEN,
        r"DICOM ImagerPixelSpacing: found 0.42 mm, wanted 0.4 mm to 1 % as xray.imager_pixel_mm of subject.json says",
    ),
    "oblong at the detector": (
        {"ImagerPixelSpacing": OBLONG}, GIVEN, r"DICOM ImagerPixelSpacing: found 0.5 mm, wanted 0.4 mm to 1 %",
    ),
    "oblong of no plane": (
        {"PixelSpacing": OBLONG}, GIVEN,
        r"PixelSpacing: found 0.4\\0.5 mm, pixels 0.8 times as high as wide, wanted square ones for the given imager_p",
    ),
    "oblong on the film": (
        {"NominalScannedPixelSpacing": OBLONG}, GIVEN, r"NominalScannedPixelSpacing: found 0.4\\0.5 mm, pixels",
    ),
    "oblong, calibrated": (
        {"PixelSpacing": ["0.357333", "0.446667"], **FIDUCIAL}, GIVEN,
        "DICOM PixelSpacing: found 0.5 mm, wanted 0.4 mm to 5 %",
    ),
    "calibrated otherwise": (
        {"PixelSpacing": ["0.4", "0.4"], **FIDUCIAL}, GIVEN, "DICOM PixelSpacing: found 0.447761 mm, wanted 0.4 mm",
    ),
    "one side zero": (
        {"PixelSpacing": ["0", "0.4"]}, GIVEN, r"PixelSpacing: found 0\\0.4 mm, wanted two lengths above 0 mm",
    ),
    "one side zero at the detector": (
        {"ImagerPixelSpacing": ["0.4", "0"]}, GIVEN, r"ImagerPixelSpacing: found 0.4\\0 mm, wanted two lengths above 0",
    ),
    "below zero": (
        {"ImagerPixelSpacing": ["-0.4", "-0.4"]}, GIVEN, r"ImagerPixelSpacing: found -0.4\\-0.4 mm, wanted two lengths",
    ),
    "implausible": (
        {"ImagerPixelSpacing": ["40", "40"]}, GIVEN, r"ImagerPixelSpacing: found 40\\40 mm, wanted 0.02 to 2 mm",
    ),
    "two shapes": (
        {"ImagerPixelSpacing": ["0.4", "0.4"], "PixelSpacing": OBLONG}, None,
        r"PixelSpacing: found 0.4\\0.5 mm, wanted pixels of the same shape as ImagerPixelSpacing 0.4\\0.4 mm says",
    ),
    "two shapes, calibrated": (
        {"ImagerPixelSpacing": ["0.4", "0.4"], "PixelSpacing": ["0.357", "0.3"], **FIDUCIAL}, None,
        r"PixelSpacing: found 0.357\\0.3 mm, wanted pixels of the same shape as ImagerPixelSpacing",
    ),
    "two shapes beside a scale": (
        {"PixelSpacing": OBLONG, "PixelAspectRatio": ["5", "4"]}, SCALED,
        r"PixelSpacing: found 0.4\\0.5 mm, wanted pixels of the same shape as PixelAspectRatio 1.25 says",
    ),
    "given implausible": ({}, Geometry(imager_pixel_mm=3.0), r"given imager_pixel_mm: found 3\\3 mm, wanted 0.02 to 2"),
    "zero alone": (
        {"ImagerPixelSpacing": ZERO}, None,
        r"found ImagerPixelSpacing 0\\0 mm \(zero\), wanted ImagerPixelSpacing; add xray.imager_pixel_mm \(pixel pitch",
    ),
    "zero of no plane alone": (
        {"PixelSpacing": ZERO}, None, r"found PixelSpacing 0\\0 mm \(zero\), wanted ImagerPixelSpacing; add",
    ),
    "a distance given otherwise": (
        {"ImagerPixelSpacing": ["0.4", "0.4"]}, Geometry(source_detector_mm=1600.0),
        "DistanceSourceToDetector: found 1500 mm, wanted 1600 mm to 1 % as xray.source_detector_mm of",
    ),
    "a distance implausible beside a given one": (
        {"ImagerPixelSpacing": ["0.4", "0.4"], "DistanceSourceToDetector": "-1"}, Geometry(source_detector_mm=1500.0),
        "DistanceSourceToDetector: found -1 mm, wanted 300 to 10000 mm",
    ),
    "a given distance implausible": (
        {"ImagerPixelSpacing": ["0.4", "0.4"], "DistanceSourceToDetector": None}, Geometry(source_detector_mm=150.0),
        "given source_detector_mm: found 150 mm, wanted 300 to 10000 mm",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", CONTRADICTED)
def test_what_contradicts_or_is_no_spacing_is_refused_by_name(file, name):
    values, geometry, message = CONTRADICTED[name]
    with pytest.raises(RadiographError, match=f"^a.dcm: {message}"):
        view_of(file(**{**NO_SPACING, **values}), geometry)


def test_a_zero_distance_beside_a_given_one_is_told(file):
    given = Geometry(source_detector_mm=1500.0)
    _, provenance = view_of(file(DistanceSourceToDetector="0"), given)
    assert provenance["source to detector"] == "given source_detector_mm since DistanceSourceToDetector is 0"
    _, provenance = view_of(file(DistanceSourceToDetector=None), given)
    assert provenance["source to detector"] == "given source_detector_mm"
