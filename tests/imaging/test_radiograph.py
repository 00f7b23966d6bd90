"""DICOM there and back, where millimetres come from, and what is refused; more of each in tests/imaging/dicom."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pydicom
import pytest

from spinestiff.errors import RadiographError
from spinestiff.imaging.projection import XRayView, frontal_view, lateral_view
from spinestiff.imaging.radiograph import (
    Geometry,
    lps_from_world,
    read_radiographs,
    world_from_lps,
    write_radiographs,
)

VIEW = frontal_view(sid=1500.0, source_to_patient=1340.0, shape=(40, 36), pixel=(0.3, 0.4))


def frames(count: int = 3, view: XRayView = VIEW) -> np.ndarray:
    return np.random.default_rng(1).integers(0, 65536, (count, *view.shape), dtype=np.uint16)


@pytest.fixture
def series(tmp_path: Path) -> Path:
    path = tmp_path / "series.dcm"
    write_radiographs(path, frames(), VIEW, frame_time_ms=40.0, description="push")
    return path


def changed(path: Path, change: Callable[[pydicom.Dataset], None]) -> Path:
    dataset = pydicom.dcmread(path)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        change(dataset)
        dataset.save_as(path)
    return path


def without(*keywords: str) -> Callable[[pydicom.Dataset], None]:
    def change(dataset: pydicom.Dataset) -> None:
        for keyword in keywords:
            delattr(dataset, keyword)

    return change


def having(**values: object) -> Callable[[pydicom.Dataset], None]:
    def change(dataset: pydicom.Dataset) -> None:
        for keyword, value in values.items():
            setattr(dataset, keyword, value)

    return change


def assert_same_view(a: XRayView, b: XRayView) -> None:
    assert a.shape == b.shape
    assert a.source_to_patient == pytest.approx(b.source_to_patient, rel=1e-9)
    for key in ("source", "detector_origin", "detector_axes", "pixel_spacing"):
        np.testing.assert_allclose(getattr(a, key), getattr(b, key), atol=1e-6)


def test_lps_turns_world_axes_and_back() -> None:
    np.testing.assert_array_equal(lps_from_world(np.eye(3)), [[1, 0, 0], [0, 0, 1], [0, -1, 0]])
    v = np.random.default_rng(0).normal(size=(5, 3))
    np.testing.assert_array_equal(world_from_lps(lps_from_world(v)), v)


@pytest.mark.parametrize("view", [VIEW, lateral_view(shape=(40, 36), pixel=0.417)])
@pytest.mark.parametrize("count", [1, 3])
def test_a_written_file_reads_as_it_was(tmp_path: Path, view: XRayView, count: int) -> None:
    write_radiographs(tmp_path / "a.dcm", frames(count), view, frame_time_ms=40.0)
    read = read_radiographs(tmp_path / "a.dcm")
    assert len(read) == count
    for i, radiograph in enumerate(read):
        assert radiograph.pixels.dtype == np.float32
        np.testing.assert_array_equal(radiograph.pixels, frames(count)[i])
        assert_same_view(radiograph.view, view)
        assert (radiograph.frame, radiograph.source) == (i, "a.dcm")
        assert radiograph.time_s == pytest.approx(0.04 * i)
        assert radiograph.provenance["pixel spacing"] == "DICOM ImagerPixelSpacing, at the detector"
    assert len(read[0].sha256) == 64


def test_the_same_call_writes_the_same_bytes(tmp_path: Path) -> None:
    for name in ("a.dcm", "b.dcm"):
        write_radiographs(tmp_path / name, frames(), VIEW, description="x")
    assert (tmp_path / "a.dcm").read_bytes() == (tmp_path / "b.dcm").read_bytes()


def test_written_files_are_radiofluoroscopic_or_digital_x_ray_without_a_patient(tmp_path: Path) -> None:
    for count, name in ((3, "X-Ray Radiofluoroscopic Image Storage"),
                        (1, "Digital X-Ray Image Storage - For Presentation")):  # fmt: skip
        write_radiographs(tmp_path / "a.dcm", frames(count), VIEW)
        dataset = pydicom.dcmread(tmp_path / "a.dcm")
        assert dataset.SOPClassUID.name == name
        assert dataset.PatientIdentityRemoved == "YES"
        assert dataset.PatientBirthDate == ""
        assert list(dataset.PatientOrientation) == ["L", "F"]
        assert float(dataset.KVP) == 71.0
        assert list(dataset.ImagerPixelSpacing) == [0.4, 0.3]


def test_frame_times_may_differ(tmp_path: Path) -> None:
    write_radiographs(tmp_path / "a.dcm", frames(), VIEW, frame_time_ms=[0.0, 50.0, 70.0])
    assert [r.time_s for r in read_radiographs(tmp_path / "a.dcm")] == pytest.approx([0.0, 0.05, 0.12])
    changed(tmp_path / "a.dcm", having(FrameTimeVector=["30", "50", "70"]))
    assert [r.time_s for r in read_radiographs(tmp_path / "a.dcm")] == pytest.approx([0.0, 0.05, 0.12])


def folder_of_frames(folder: Path, times: list[str | None], numbers: list[int]) -> Path:
    for i, (time, number) in enumerate(zip(times, numbers)):
        write_radiographs(folder / f"{'cab'[i]}.dcm", frames()[i], VIEW, instance_number=number, acquisition_time=time)
    return folder


def test_a_folder_is_ordered_by_time(tmp_path: Path) -> None:
    read = read_radiographs(folder_of_frames(tmp_path, ["120000.5", "120001", "120003"], [1, 2, 3]))
    assert [r.source for r in read] == ["c.dcm", "a.dcm", "b.dcm"]
    assert [r.time_s for r in read] == pytest.approx([0.0, 0.5, 2.5])
    assert [r.frame for r in read] == [0, 1, 2]
    np.testing.assert_array_equal(read[2].pixels, frames()[2])


def test_a_folder_without_times_is_ordered_by_instance_number(tmp_path: Path) -> None:
    read = read_radiographs(folder_of_frames(tmp_path, [None, None, None], [3, 1, 2]))
    assert [r.source for r in read] == ["a.dcm", "b.dcm", "c.dcm"]
    assert [r.time_s for r in read] == [None, None, None]


def test_times_and_numbers_that_disagree_are_told(tmp_path: Path) -> None:
    with pytest.warns(UserWarning, match="disagree; ordered by time"):
        read = read_radiographs(folder_of_frames(tmp_path, ["120003", "120001", "120002"], [1, 2, 3]))
    assert [r.source for r in read] == ["a.dcm", "b.dcm", "c.dcm"]


def test_folders_that_are_no_series_are_refused(tmp_path: Path, series: Path) -> None:
    (tmp_path / "empty").mkdir()
    with pytest.raises(RadiographError, match="empty: found no radiographs in this folder, wanted some"):
        read_radiographs(tmp_path / "empty")
    assert len(read_radiographs(tmp_path)) == 3
    write_radiographs(tmp_path / "z.dcm", frames(1), VIEW)
    with pytest.raises(RadiographError, match=r"series.dcm: found 3 frames, wanted 1, as it lies among 2 files"):
        read_radiographs(tmp_path)
    series.unlink()
    write_radiographs(tmp_path / "y.dcm", np.zeros((9, 9), np.uint16), frontal_view(shape=(9, 9)))
    with pytest.raises(RadiographError, match=r"z.dcm: found .*, wanted .* like y.dcm"):
        read_radiographs(tmp_path)


def test_monochrome1_and_rescale_are_undone(tmp_path: Path, series: Path) -> None:
    changed(series, without("PixelIntensityRelationshipSign"))
    changed(series, having(PhotometricInterpretation="MONOCHROME1", RescaleSlope="2", RescaleIntercept="-5"))
    read = read_radiographs(series)[1]
    np.testing.assert_array_equal(read.pixels, 2.0 * (65535.0 - frames()[1]) - 5.0)
    assert read.provenance["grey values"] == "MONOCHROME1, rescaled by 2 and -5, inverted"


@pytest.mark.parametrize(("photometric", "sign", "inverted"),
                         [("MONOCHROME1", -1, False), ("MONOCHROME1", 1, True), ("MONOCHROME2", 1, True)])  # fmt: skip
def test_the_sign_of_the_beam_decides_where_bone_is_bright(
    series: Path, photometric: str, sign: int, inverted: bool
) -> None:
    changed(series, having(PhotometricInterpretation=photometric, PixelIntensityRelationshipSign=sign))
    wanted = 65535.0 - frames()[0] if inverted else frames()[0]
    np.testing.assert_array_equal(read_radiographs(series)[0].pixels, wanted)


def test_bits_above_the_stored_ones_are_dropped(series: Path) -> None:
    changed(series, having(BitsStored=12, HighBit=11))
    np.testing.assert_array_equal(read_radiographs(series)[0].pixels, frames()[0] & 4095)


def test_signed_pixels_keep_their_sign(series: Path) -> None:
    changed(series, having(PixelRepresentation=1))
    np.testing.assert_array_equal(read_radiographs(series)[0].pixels, frames()[0].view(np.int16))


def test_a_file_without_geometry_takes_what_is_given(series: Path) -> None:
    changed(series, without("ImagerPixelSpacing", "DistanceSourceToDetector", "DistanceSourceToPatient",
                            "PatientOrientation", "ViewPosition"))  # fmt: skip
    read = read_radiographs(series, geometry=Geometry(1500.0, 1340.0, 0.35, "lateral"))[0]
    assert_same_view(read.view, lateral_view(shape=(40, 36), pixel=0.35))
    assert read.provenance["pixel spacing"] == "given imager_pixel_mm, at the detector"
    assert read.provenance["source to detector"] == "given source_detector_mm"
    assert read.provenance["orientation"].startswith("given as a lateral view")


def test_a_calibrated_spacing_is_that_of_the_patient_plane(series: Path) -> None:
    changed(series, without("ImagerPixelSpacing"))
    changed(series, having(PixelSpacing=["0.4", "0.3"], PixelSpacingCalibrationType="FIDUCIAL"))
    read = read_radiographs(series)[0]
    np.testing.assert_allclose(read.view.pixel_spacing, np.array([0.3, 0.4]) * 1500.0 / 1340.0)
    assert "patient plane" in read.provenance["pixel spacing"]


@pytest.mark.parametrize(
    ("letters", "position", "columns", "beam"),
    [
        (["L", "F"], "AP", [1, 0, 0], [0, 0, -1]),
        (["R", "F"], "PA", [-1, 0, 0], [0, 0, 1]),
        (["A", "F"], "LL", [0, 0, 1], [1, 0, 0]),
        (["PL", "FR"], "RL", [0, 0, -1], [-1, 0, 0]),
        (["L", "F"], "", [1, 0, 0], [0, 0, -1]),
    ],
)
def test_orientation_and_position_decide_columns_and_beam(
    series: Path, letters: list[str], position: str, columns: list[int], beam: list[int]
) -> None:
    changed(series, having(PatientOrientation=letters, ViewPosition=position))
    view = read_radiographs(series)[0].view
    np.testing.assert_array_equal(view.detector_axes, [columns, [0, -1, 0]])
    np.testing.assert_allclose(view.normal, beam, atol=1e-12)


REFUSED = {
    "no spacing": (without("ImagerPixelSpacing"), None, "no ImagerPixelSpacing; add xray.imager_pixel_mm"),
    "spacing of no plane": (
        lambda d: (without("ImagerPixelSpacing")(d), having(PixelSpacing=["0.4", "0.3"])(d)),
        None, r"found PixelSpacing 0.4\\0.3 mm of no known plane, wanted ImagerPixelSpacing; add xray.imager",
    ),
    "spacing nan": (having(ImagerPixelSpacing=[float("nan"), 0.4]), None, "ImagerPixelSpacing: found no number"),
    "spacing zero": (having(ImagerPixelSpacing=[0.0, 0.4]), None, r"ImagerPixelSpacing: found 0\\0.4 mm, wanted two l"),
    "spacing huge": (having(ImagerPixelSpacing=[0.4, 2.5]), None, r"ImagerPixelSpacing: found 0.4\\2.5 mm, wanted"),
    "no distance": (without("DistanceSourceToDetector"), None, "no DistanceSourceToDetector; add xray.source_d"),
    "no patient": (without("DistanceSourceToPatient"), None, "no DistanceSourceToPatient; add xray.source_pat"),
    "metres": (having(DistanceSourceToDetector="1.5"), None, r"DistanceSourceToDetector: found 1.5 mm, wanted 3"),
    "patient behind": (having(DistanceSourceToPatient="1600"), None, "wanted the patient nearer to the source"),
    "other distance": (having(), Geometry(source_detector_mm=1530.0), "found 1500 mm, wanted 1530 mm to 1 %"),
    "other spacing": (having(), Geometry(imager_pixel_mm=0.3), "ImagerPixelSpacing: found 0.4 mm, wanted 0.3"),
    "other view": (having(), Geometry(view="lateral"), r"found L\\F, a frontal view, wanted a lateral"),
    "no orientation": (without("PatientOrientation"), None, "no PatientOrientation; if the image is shown as usual"),
    "lying": (having(PatientOrientation=["F", "L"]), None, r"found F\\L, wanted columns to L, R, A or P"),
    "modality": (having(Modality="CT"), None, r"Modality: found CT, wanted a projection radiograph \(CR"),
    "no picture": (without("PixelData"), None, "PixelData: missing, wanted a picture"),
    "colour": (having(PhotometricInterpretation="RGB", SamplesPerPixel=3), None, "Interpretation: found RGB"),
    "cut": (lambda d: setattr(d, "PixelData", d.PixelData[:-200]), None, "found 8440 bytes, wanted 8640: cut short"),
    "too many": (having(NumberOfFrames=129), None, "found 129, wanted at most 128; export fewer frames"),
    "too wide": (having(Columns=8193), None, "Rows, Columns: found .* x 8193, wanted at most 8192 x 8192; crop it"),
    "too large": (having(Rows=8000, Columns=8000, NumberOfFrames=100), None, "12207 MB, wanted at most 512 MB"),
    "no rows": (having(Rows=0), None, "found 3 frames of 0 x 36, wanted 1 or more"),
    "bits": (having(BitsStored=17), None, "found 17 bits in 16"),
    "slope": (having(RescaleSlope="0"), None, "RescaleSlope: found 0"),
    "back in time": (having(FrameTime="-3"), None, "FrameTime: found -3 ms"),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_what_cannot_be_measured_is_refused_with_the_file_and_the_reason(series: Path, name: str) -> None:
    change, geometry, message = REFUSED[name]
    changed(series, change)
    with pytest.raises(RadiographError, match=message) as refusal:
        read_radiographs(series, geometry=geometry)
    assert str(refusal.value).startswith("series.dcm: ")
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize("content", [b"", b"not DICOM at all", b"\x00" * 5000])
def test_other_files_are_refused(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "x.dcm").write_bytes(content)
    with pytest.raises(RadiographError, match=r"^x.dcm: "):
        read_radiographs(tmp_path / "x.dcm")


def test_a_missing_file_is_told(tmp_path: Path) -> None:
    with pytest.raises(RadiographError, match=r"^none.dcm: no such file"):
        read_radiographs(tmp_path / "none.dcm")


def deflate(path: Path) -> None:
    dataset = pydicom.dcmread(path)
    dataset.file_meta.TransferSyntaxUID = pydicom.uid.DeflatedExplicitVRLittleEndian
    dataset.save_as(path)


def test_a_deflated_file_is_inflated(series: Path) -> None:
    deflate(series)
    np.testing.assert_array_equal(read_radiographs(series)[2].pixels, frames()[2])


def test_a_deflated_file_stops_growing_at_the_cap(series: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("spinestiff.imaging.dicom.files.MOST_BYTES", 1000)
    monkeypatch.setattr("spinestiff.imaging.dicom.files.MOST_HEADER_BYTES", 9000)
    changed(series, having(PixelData=b"\0" * 20000))
    deflate(series)
    with pytest.raises(RadiographError, match="deflated DICOM of more than"):
        read_radiographs(series)


def test_a_deflated_file_that_is_cut_is_refused(series: Path) -> None:
    deflate(series)
    series.write_bytes(series.read_bytes()[:-300])
    with pytest.raises(RadiographError, match="found deflated DICOM that is cut short"):
        read_radiographs(series)


def test_a_close_given_value_agrees_and_the_file_wins(series: Path) -> None:
    read = read_radiographs(series, geometry=Geometry(source_detector_mm=1505.0, view="frontal"))[0]
    assert read.view.source_to_detector == pytest.approx(1500.0)


@pytest.mark.parametrize(
    "pixels", [np.zeros((3, 40, 36)), np.zeros((36, 40), np.uint16), np.zeros((0, 40, 36), np.uint16)]
)
def test_pixels_that_do_not_fit_the_view_are_not_written(tmp_path: Path, pixels: np.ndarray) -> None:
    with pytest.raises(RadiographError, match="pixels are"):
        write_radiographs(tmp_path / "a.dcm", pixels, VIEW)


def test_a_view_off_the_middle_is_not_written(tmp_path: Path) -> None:
    aside = replace(VIEW, source=VIEW.source + [5.0, 0.0, 0.0])
    with pytest.raises(RadiographError, match="principal point"):
        write_radiographs(tmp_path / "a.dcm", frames(), aside)


def test_bad_frame_times_are_not_written(tmp_path: Path) -> None:
    with pytest.raises(RadiographError, match="frame times"):
        write_radiographs(tmp_path / "a.dcm", frames(), VIEW, frame_time_ms=[0.0, 1.0])
