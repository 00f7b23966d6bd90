"""Grey values: the modality transformation, bone made bright, and how the file wants them shown (PS3.3 C.11)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from spinestiff.arrays import ByFields, Floats, read_only
from spinestiff.errors import RadiographError
from spinestiff.imaging.dicom.layout import Layout
from spinestiff.imaging.dicom.tags import Table, Tags

LARGEST_GREY = 1e6
"""Of a pixel after rescaling: modality values of 16 bits, with room."""
_SIGMOID_KNOTS = np.linspace(-2.0, 2.0, 65)


@dataclass(frozen=True)
class DisplayCurve(ByFields):
    """How grey values are shown: a broken line from pixel values to 0 (black) to 1 (white).

    Attributes
    ----------
    greys : (n,) pixel values, ascending.
    shown : (n,) of each, 0 to 1; beyond the ends the end's.
    """

    greys: Floats
    shown: Floats

    def __post_init__(self) -> None:
        for key in ("greys", "shown"):
            object.__setattr__(self, key, read_only(key, getattr(self, key), (None,), RadiographError))
        if len(self.greys) != len(self.shown) or len(self.greys) < 2 or (np.diff(self.greys) <= 0.0).any():
            raise RadiographError("the display window or table: found no width, wanted ascending pixel values")

    def __call__(self, pixels: ArrayLike) -> NDArray[np.float32]:
        """Pixels as they are shown, 0 to 1."""
        return np.interp(np.asarray(pixels, dtype=float), self.greys, self.shown).astype(np.float32)


def bone_bright(
    stored: NDArray[Any], tags: Tags, layout: Layout
) -> tuple[NDArray[np.float32], DisplayCurve | None, str]:
    """Pixels (F, H, W) with bone bright, how the file shows them, and how they came about in words.

    What larger stored values mean is told by PixelIntensityRelationshipSign where there is one (the beam is physics),
    else by the photometric interpretation (the display).

    Raises
    ------
    RadiographError : a slope of 0 or an implausible one, two modality transformations at once, a sign that is none.
    """
    low, high = (-(2 ** (layout.stored - 1)), 2 ** (layout.stored - 1) - 1) if layout.signed else (
        0, 2**layout.stored - 1
    )  # fmt: skip
    pixels, ends, how = _modality(stored, tags, (low, high))
    rising = ends[1] > ends[0]
    if tags.beam_sign is None:
        inverted = tags.photometric == "MONOCHROME1"
        how = tags.photometric + how
    else:
        if tags.beam_sign not in (1.0, -1.0):
            raise RadiographError(
                f"PixelIntensityRelationshipSign: found {tags.beam_sign:g}, wanted 1 or -1; correct it"
            )
        # Sign -1: larger stored values mean less beam, which is bone bright whatever the display makes of it.
        inverted = (tags.beam_sign > 0.0) == rising
        how = f"PixelIntensityRelationshipSign {tags.beam_sign:+.0f}" + how
    curve = _curve(tags)
    if inverted:
        total = ends[0] + ends[1]
        np.subtract(np.float32(total), pixels, out=pixels)
        curve = None if curve is None else DisplayCurve(total - curve.greys[::-1], 1.0 - curve.shown[::-1])
        how += ", inverted"
    return pixels, curve, how


def _modality(
    stored: NDArray[Any], tags: Tags, ends: tuple[int, int]
) -> tuple[NDArray[np.float32], tuple[float, float], str]:
    """Pixels after the modality transformation, what it makes of the smallest and largest stored value, and words."""
    table, slope, intercept = tags.modality_table, tags.slope, tags.intercept
    if table is not None:
        if (slope, intercept) != (1.0, 0.0):
            raise RadiographError("RescaleSlope: found it beside ModalityLUTSequence, wanted one of them; correct it")
        first, last = (float(_looked_up(table, np.array([end]))[0]) for end in ends)
        return _looked_up(table, stored), (first, last), ", by its modality table"
    if not slope:
        raise RadiographError("RescaleSlope: found 0, wanted another number; correct it at the source")
    if (slope, intercept) == (1.0, 0.0):
        return stored.astype(np.float32), (float(ends[0]), float(ends[1])), ""
    first, last = (slope * end + intercept for end in ends)
    if not max(abs(first), abs(last)) <= LARGEST_GREY:
        raise RadiographError(
            f"RescaleSlope, RescaleIntercept: found {slope:g}, {intercept:g}, wanted grey values up to {LARGEST_GREY:g}"
        )
    pixels = np.float32(slope) * stored.astype(np.float32) + np.float32(intercept)
    return pixels, (first, last), f", rescaled by {slope:g} and {intercept:g}"


def _looked_up(table: Table, stored: NDArray[Any]) -> NDArray[np.float32]:
    index = np.clip(stored.astype(np.int32) - table.first, 0, len(table.values) - 1)
    return table.values[index].astype(np.float32)


def _curve(tags: Tags) -> DisplayCurve | None:
    """As the file says for values after the modality transformation; a table goes before a window."""
    table = tags.window_table
    if table is not None and len(table.values) > 1:
        values = table.values.astype(float)
        span = max(float(np.ptp(values)), 1.0)
        return DisplayCurve(table.first + np.arange(len(values), dtype=float), (values - values.min()) / span)
    if tags.window is None:
        return None
    centre, width = tags.window
    if tags.window_function == "SIGMOID" and width > 0.0:
        return DisplayCurve(centre + width * _SIGMOID_KNOTS, 1.0 / (1.0 + np.exp(-4.0 * _SIGMOID_KNOTS)))
    if tags.window_function != "LINEAR_EXACT":
        centre, width = centre - 0.5, width - 1.0
    if width <= 0.0:
        return None  # a matter of display only: nothing is measured by it
    return DisplayCurve(np.array([centre - 0.5 * width, centre + 0.5 * width]), np.array([0.0, 1.0]))
