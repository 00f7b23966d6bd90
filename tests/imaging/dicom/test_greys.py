"""Modality tables and slopes, bone bright, and the display that a file asks for."""

from __future__ import annotations

import numpy as np
import pydicom
import pytest
from pydicom.dataset import Dataset
from pydicom.sequence import Sequence
from pydicom.uid import ExplicitVRBigEndian

from spinestiff.errors import RadiographError
from spinestiff.imaging.radiograph import read_radiographs

STORED = (np.arange(40 * 36) % 256).astype(np.uint16).reshape(40, 36)
BYTES = {"BitsStored": 8, "HighBit": 7}


def table(keyword: str, entries: np.ndarray, first: int = 0, bits: int = 16, count: int | None = None):
    def change(dataset: Dataset) -> None:
        item = Dataset()
        item.add_new("LUTDescriptor", "US", [len(entries) if count is None else count, first, bits])
        item.add_new("LUTData", "OW", entries.astype("<u2" if bits > 8 else "u1").tobytes())
        setattr(dataset, keyword, Sequence([item]))
        if keyword == "ModalityLUTSequence":
            del dataset.RescaleSlope, dataset.RescaleIntercept, dataset.RescaleType

    return change


def read(file, **values):
    (radiograph,) = read_radiographs(file(STORED[None], **{**BYTES, **values}))
    return radiograph


@pytest.mark.parametrize("bits", [8, 16])
def test_a_modality_table_is_looked_up(file, bits):
    entries = (np.arange(200) ** 2 // 160).astype(np.uint16)
    radiograph = read(file, change=table("ModalityLUTSequence", entries, first=20, bits=bits))
    np.testing.assert_array_equal(radiograph.pixels, entries[np.clip(STORED.astype(int) - 20, 0, 199)])
    assert "by its modality table" in radiograph.provenance["grey values"]


@pytest.mark.parametrize("bits", [8, 16])
def test_a_table_of_a_big_endian_file_has_its_bytes_in_that_order(file, bits):
    entries = (np.arange(200) ** 2 // 160).astype(np.uint16)
    path = file(STORED[None], **BYTES, change=table("ModalityLUTSequence", entries, first=20, bits=bits))
    dataset = pydicom.dcmread(path)
    for holder, keyword in ((dataset, "PixelData"), (dataset.ModalityLUTSequence[0], "LUTData")):
        holder[keyword].value = np.frombuffer(holder[keyword].value, "<u2").astype(">u2").tobytes()
    dataset.file_meta.TransferSyntaxUID = ExplicitVRBigEndian
    pydicom.dcmwrite(path, dataset, implicit_vr=False, little_endian=False, force_encoding=True)
    (radiograph,) = read_radiographs(path)
    np.testing.assert_array_equal(radiograph.pixels, entries[np.clip(STORED.astype(int) - 20, 0, 199)])


def test_a_falling_table_turns_what_the_sign_of_the_beam_means(file):
    entries = np.arange(256)[::-1] * 2
    # Sign -1: larger stored values are bone; the table turns them, so they are turned back.
    radiograph = read(file, change=table("ModalityLUTSequence", entries))
    np.testing.assert_array_equal(radiograph.pixels, 2.0 * STORED)
    assert radiograph.provenance["grey values"].endswith("inverted")


def test_a_falling_slope_turns_what_the_sign_of_the_beam_means(file):
    radiograph = read(file, RescaleSlope="-1", RescaleIntercept="255")
    np.testing.assert_array_equal(radiograph.pixels, STORED)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (table("ModalityLUTSequence", np.arange(200), count=100), "found 200 entries, wanted 100 as declared"),
        (table("VOILUTSequence", np.arange(200), bits=7), "entries of 7 bits"),
        (lambda d: setattr(d, "ModalityLUTSequence", Sequence([Dataset()])), "found no table"),
        (
            lambda d: (table("ModalityLUTSequence", np.arange(256))(d), setattr(d, "RescaleSlope", "2")),
            "found it beside Mod",
        ),
        (lambda d: setattr(d, "PixelIntensityRelationshipSign", 3), "Sign: found 3, wanted 1 or -1"),
        (lambda d: setattr(d, "RescaleSlope", "65535"), "found 65535, 0, wanted grey values up to 1e"),
        (lambda d: setattr(d, "RescaleIntercept", "1e300"), r"found 1, 1e\+300, wanted grey values up to"),
    ],
)
def test_tables_that_do_not_hold_what_they_say_are_refused(file, change, message):
    with pytest.raises(RadiographError, match=message):
        read(file, change=change)


@pytest.mark.parametrize(
    ("function", "black", "middle", "white"),
    [("LINEAR", 50.0, 99.5, 149.0), ("LINEAR_EXACT", 50.0, 100.0, 150.0)],
)
def test_a_linear_window_is_that_of_the_standard(file, function, black, middle, white):
    radiograph = read(file, WindowCenter="100", WindowWidth="100", VOILUTFunction=function)
    np.testing.assert_allclose(radiograph.display([0.0, black, middle, white, 255.0]), [0, 0, 0.5, 1, 1], atol=1e-6)


def test_a_sigmoid_window_is_that_of_the_standard(file):
    radiograph = read(file, WindowCenter="100", WindowWidth="80", VOILUTFunction="SIGMOID")
    greys = np.linspace(0.0, 200.0, 9)
    wanted = 1.0 / (1.0 + np.exp(-4.0 * (greys - 100.0) / 80.0))
    np.testing.assert_allclose(radiograph.display(greys), wanted, atol=5e-4)


def test_a_display_table_goes_before_a_window(file):
    entries = np.sqrt(np.arange(100)) * 100.0
    radiograph = read(file, change=table("VOILUTSequence", entries, first=50), WindowCenter="3", WindowWidth="9")
    wanted = entries.astype(int)[np.clip(STORED.astype(int) - 50, 0, 99)]
    np.testing.assert_allclose(radiograph.shown(), wanted / wanted.max(), atol=1e-6)


def test_bone_is_shown_bright_where_the_file_shows_it_dark(file):
    radiograph = read(file, PixelIntensityRelationshipSign=1, WindowCenter="100.5", WindowWidth="101")
    np.testing.assert_array_equal(radiograph.pixels, 255.0 - STORED)
    np.testing.assert_allclose(radiograph.shown(), 1.0 - np.clip((STORED - 50.0) / 100.0, 0.0, 1.0), atol=1e-6)


def test_a_display_table_turns_with_the_pixels(file):
    entries = np.arange(256) ** 2
    radiograph = read(file, PixelIntensityRelationshipSign=1, change=table("VOILUTSequence", entries))
    np.testing.assert_allclose(radiograph.shown(), 1.0 - entries[STORED] / 255.0**2, atol=1e-6)


def test_a_file_without_a_window_is_shown_by_its_spread(file):
    radiograph = read(file, WindowCenter=None)
    assert radiograph.display is None
    shown = radiograph.shown()
    assert shown.min() == 0.0 and shown.max() == 1.0 and 0.45 < np.median(shown) < 0.55


def by_frame(keyword, *values):
    """Values of an enhanced file, a frame each."""

    keywords = (keyword, "WindowWidth") if keyword == "WindowCenter" else (keyword,)

    def change(dataset: Dataset) -> None:
        groups = []
        for one in keywords:
            dataset.pop(one, None)
        for value in values:
            inner, group = Dataset(), Dataset()
            for one in keywords:
                setattr(inner, one, value)
            group.FrameVOILUTSequence = Sequence([inner])
            groups.append(group)
        dataset.PerFrameFunctionalGroupsSequence = Sequence(groups)

    return change


def test_a_window_that_differs_from_frame_to_frame_is_the_first_ones(file):
    """It changes nothing that is measured; what does is refused."""
    two = np.stack([STORED, STORED])
    first, second = read_radiographs(file(two, **BYTES, change=by_frame("WindowCenter", 100, 200)))
    np.testing.assert_array_equal(first.display.greys, [50.0, 149.0])
    np.testing.assert_array_equal(second.display.greys, first.display.greys)
    with pytest.raises(RadiographError, match="RescaleSlope: found values that differ from frame to frame"):
        read_radiographs(file(two, **BYTES, change=by_frame("RescaleSlope", 1, 2)))
