"""Files of a sequence are ordered by time and number; where the order is unknown they are refused."""

from __future__ import annotations

import logging
import shutil
import warnings

import numpy as np
import pytest

from spinestiff.errors import RadiographError
from spinestiff.imaging.dicom.files import quiet
from spinestiff.imaging.dicom.ordering import DAY_S, ordered, times_told
from spinestiff.imaging.dicom.tags import clock_of
from spinestiff.imaging.radiograph import read_radiographs
from spinestiff.subject.inspection import inspect

NAMES = ("a", "b", "c")
TODAY = 739_000 * DAY_S


@pytest.mark.parametrize(
    ("clocks", "numbers", "order"),
    [
        ((3.0, 1.0, 2.0), (3, 1, 2), [1, 2, 0]),
        ((1.0, 1.0, 1.0), (3, 1, 2), [1, 2, 0]),
        ((1.0, 2.0, 1.0), (2, 3, 1), [2, 0, 1]),
        ((None, None, None), (3, 1, 2), [1, 2, 0]),
        ((3.0, 1.0, 2.0), (None, 1, 1), [1, 2, 0]),
        # A file without a date among those of one day is of that day.
        ((TODAY + 1.0, 2.0, TODAY + 3.0), (None, None, None), [0, 1, 2]),
        ((TODAY + 3.0, TODAY + DAY_S + 1.0, TODAY + 1.0), (None, None, None), [2, 0, 1]),
    ],
)
def test_by_time_then_number(clocks, numbers, order):
    assert ordered("push", NAMES, clocks, numbers, [None] * 3) == (order, "")


@pytest.mark.parametrize(
    ("clocks", "numbers", "order", "message"),
    [
        ((1.0, 2.0, 3.0), (1, 3, 2), [0, 1, 2], "disagree; ordered by time"),
        ((1.0, 2.0, 3.0), (1, 1, 2), [0, 1, 2], "instance numbers occur twice; ordered by time"),
        ((1.0, None, 3.0), (1, 3, 2), [0, 2, 1], "only some files have an acquisition time"),
    ],
)
def test_what_is_odd_is_told(clocks, numbers, order, message):
    found, odd = ordered("push", NAMES, clocks, numbers, [None] * 3)
    assert found == order and odd.startswith("push: ") and message in odd


def test_names_decide_where_no_file_has_anything_else():
    """Numbers in names count as numbers, in each folder by itself."""
    names = ("b/img10", "b/img2", "a/img11", "b/img2b", "B/IMG1")
    nothing = [None] * 5
    order, odd = ordered("push", names, nothing, nothing, nothing)
    assert odd.startswith("push: no file has an acquisition time or an instance number; ordered by file name")
    assert [names[i] for i in order] == ["a/img11", "B/IMG1", "b/img2", "b/img2b", "b/img10"]


@pytest.mark.parametrize(
    ("clocks", "numbers", "message"),
    [
        ((1.0, 2.0, 1.0), (None, 1, 1), "a and c have the same acquisition time, so"),
        ((1.0, 2.0, 1.0), (1, 2, 1), "a and c have the same acquisition time and instance number"),
        ((None, 2.0, 1.0), (1, 2, 1), "a and c have the same instance number"),
        ((None, 2.0, 1.0), (1, None, 2), "the order is unknown"),
        ((TODAY, 2.0, TODAY + DAY_S), (1, 2, 3), "files of several days among some without a date"),
    ],
)
def test_an_unknown_order_is_refused(clocks, numbers, message):
    with pytest.raises(RadiographError, match=f"push: .*{message}"):
        ordered("push", NAMES, clocks, numbers, [None] * 3)


def test_times_count_from_the_first_frame_where_a_date_is_missing(file, tmp_path):
    for number, date in enumerate(("20260303", "", "20260303")):
        pixels = np.full((1, 40, 36), 7, np.uint16)
        pixels[0, number] = 9
        file(
            pixels, f"{number}.dcm", AcquisitionDate=date, AcquisitionTime=f"1000{5 * number:02d}", InstanceNumber=None
        )
    found = read_radiographs(tmp_path)
    assert [(one.source, one.time_s) for one in found] == [("0.dcm", 0.0), ("1.dcm", 5.0), ("2.dcm", 10.0)]


@pytest.mark.parametrize(
    ("contents", "numbers", "order", "times"),
    [
        ((3.0, 1.0, 2.0), (None, None, None), [1, 2, 0], (3.0, 1.0, 2.0)),
        ((TODAY + 3.0, 1.0, TODAY + 2.0), (None, 1, None), [1, 2, 0], (TODAY + 3.0, TODAY + 1.0, TODAY + 2.0)),
        ((1.0, 2.0, 2.0), (1, 2, 3), [0, 1, 2], (1.0, 2.0, 2.0)),
        # Those of an export, or of a picture computed later: no times of frames.
        ((5.0, 5.0, 5.0), (3, 1, 2), [1, 2, 0], None),
        ((3.0, 2.0, 1.0), (1, 2, 3), [0, 1, 2], None),
        ((3.0, None, 1.0), (1, 2, 3), [0, 1, 2], None),
        ((5.0, 5.0, 5.0), (None, None, None), [0, 1, 2], None),
        ((2.0, 1.0, 1.0), (None, None, None), [0, 1, 2], None),
    ],
)
def test_times_of_content_count_where_they_can_be_those_of_frames(contents, numbers, order, times):
    nothing = [None] * 3
    found, odd = ordered("push", NAMES, nothing, numbers, contents)
    assert found == order
    assert list(times_told(nothing, numbers, contents)) == list(times or nothing)
    by = "the times of their content" if times else "file name"
    assert (odd == "") if None not in numbers else odd.endswith(f"ordered by {by}: check the order")
    # Acquisition times go before them, also where only some files have one.
    assert times_told((None, 2.0, 1.0), numbers, contents) == (None, 2.0, 1.0)


def test_files_with_times_of_content_alone_are_in_their_order(file, tmp_path):
    for name, second in (("a", 9), ("b", 5), ("c", 0)):
        pixels = np.full((1, 40, 36), second, np.uint16)
        file(pixels, f"{name}.dcm", AcquisitionTime="", InstanceNumber=None, ContentTime=f"1000{second:02d}")
    with pytest.warns(UserWarning, match="ordered by the times of their content: check the order"):
        found = read_radiographs(tmp_path)
    assert [(one.source, one.time_s) for one in found] == [("c.dcm", 0.0), ("b.dcm", 5.0), ("a.dcm", 9.0)]


def test_readers_that_overlap_are_quiet_until_the_last_has_left_and_not_longer():
    """As in the threads of a page's server: warnings and loggers are those of all."""
    filters, logger = warnings.filters[:], logging.getLogger("pydicom")
    first, second = quiet(), quiet()
    first.__enter__()
    second.__enter__()
    first.__exit__(None, None, None)
    assert logger.disabled and warnings.filters[0][0] == "ignore"
    second.__exit__(None, None, None)
    assert not logger.disabled and warnings.filters == filters


def test_what_is_odd_about_an_order_is_told_while_another_thread_reads(file, tmp_path, monkeypatch):
    for number in (1, 2):
        file(np.full((1, 40, 36), number, np.uint16), f"{number}.dcm", AcquisitionTime="", InstanceNumber=None)
    other = quiet()
    monkeypatch.setattr("spinestiff.imaging.radiograph._check_series", lambda _: other.__enter__())
    (series,) = inspect(tmp_path)
    other.__exit__(None, None, None)
    assert series.warnings[0].endswith("ordered by file name: check the order")


def test_a_folder_of_too_many_files_is_refused_before_reading(tmp_path):
    for i in range(129):
        (tmp_path / f"{i}.dcm").touch()
    with pytest.raises(RadiographError, match=f"^{tmp_path.name}: found 129 files, wanted at most 128"):
        read_radiographs(tmp_path)


def test_the_same_image_twice_is_refused(file, tmp_path):
    path = file(AcquisitionTime="120000")
    shutil.copy(path, tmp_path / "b.dcm")
    with pytest.raises(RadiographError, match=r"b.dcm: found the same image as a.dcm; remove one"):
        read_radiographs(tmp_path)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"PatientID": "SECRET"}, "found another patient than in a.dcm"),
        ({"PatientOrientation": ["R", "F"]}, "found another orientation than that of a.dcm"),
        ({"PatientOrientation": ["L", "H"]}, "found another orientation than that of a.dcm"),
        ({"ViewPosition": "PA"}, "found another direction of the beam than that of a.dcm"),
        ({"DistanceSourceToDetector": "1600"}, "found another X-ray geometry than that of a.dcm"),
        ({"ImagerPixelSpacing": ["0.5", "0.5"]}, "found another X-ray geometry than that of a.dcm"),
    ],
)
def test_files_of_another_kind_are_no_frame_of_the_sequence(file, tmp_path, values, message):
    file(AcquisitionTime="120000")
    file(np.ones((1, 40, 36), np.uint16), "b.dcm", AcquisitionTime="120001", **values)
    with pytest.raises(RadiographError, match=f"b.dcm: {message}") as refusal:
        read_radiographs(tmp_path)
    assert "SECRET" not in str(refusal.value)


def test_a_series_of_two_persons_without_a_number_is_refused(file, tmp_path):
    named = {"PatientID": "", "PatientBirthDate": "20110203", "PatientIdentityRemoved": ""}
    file(AcquisitionTime="120000", PatientName="Doe^Jane", **named)
    file(np.ones((1, 40, 36), np.uint16), "b.dcm", AcquisitionTime="120001", PatientName="Roe^Ann", **named)
    with pytest.raises(RadiographError, match=r"b\.dcm: found another patient than in a\.dcm; keep them apart$"):
        read_radiographs(tmp_path)


def test_a_moment_that_tells_all_needs_no_other_element():
    """One that is damaged and not needed refuses nothing."""
    told = {"AcquisitionDateTime": "20260102101112"}
    parts = {"AcquisitionDateTime": "20260102", "AcquisitionDate": "20260102", "AcquisitionTime": "101112"}
    assert clock_of(parts.__getitem__, "Acquisition") == clock_of(told.__getitem__, "Acquisition")


@pytest.mark.parametrize("time", ["735194", "246000", "106000", "101061", "240000"])
def test_what_is_no_time_of_day_is_none(time):
    """Its hours would count as days, and the file as one of another year."""
    parts = {"AcquisitionDateTime": f"20260102{time}", "AcquisitionDate": "20260102", "AcquisitionTime": "101112"}
    whole = {"AcquisitionDateTime": "20260102101112"}
    assert clock_of(parts.__getitem__, "Acquisition") == clock_of(whole.__getitem__, "Acquisition")
    assert clock_of({**parts, "AcquisitionTime": time}.__getitem__, "Acquisition") is None
