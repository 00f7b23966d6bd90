"""The measured change of a Cobb angle between two pictures, with what the corners' errors make of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from spinestiff.arrays import Floats
from spinestiff.curves.cobb import DEFINITIONS, Definition, check_reading, tilt_sds, tracked_tilt_sds, usual_noise
from spinestiff.curves.tilts import CobbChange, Forms, cobb_change, tilts_from_points
from spinestiff.imaging.features import VertebraCorners, picture_axes
from spinestiff.imaging.projection import XRayView
from spinestiff.imaging.tracking.quality import LOWEST_QUALITY, error_of
from spinestiff.normal import HALF_WIDTH_95

LEAST_ERROR_MM = 0.004
"""Of a tracked corner: stored qualities have three digits, so that smaller predicted errors read as none."""


def tracked_noise(quality: Floats) -> Floats:
    """Standard deviation of each coordinate of tracked corners, mm at the patient plane, from their quality.

    A predicted error is a distance in the plane, a noise that of one coordinate. Corners without quality count as the
    worst that tracking keeps.
    """
    return np.maximum(error_of(np.maximum(quality, LOWEST_QUALITY)), LEAST_ERROR_MM) / np.sqrt(2.0)


def change_between(
    view: XRayView,
    rest: VertebraCorners,
    pushed: VertebraCorners,
    definition: Definition = "endplate",
    same_origin: bool = True,
    noise: float | None = None,
) -> CobbChange | None:
    """The measured change of the Cobb angle between two pictures of one view, with its standard deviations.

    Each corner errs as its quality says, in each picture anew, and by the annotation. What both pictures share of that
    drops out where an endplate counts in both.

    Parameters
    ----------
    rest, pushed : corners on the detector; the same ones do not change, nor err.
    same_origin : both were tracked from one annotated picture, or one from the other.
    noise : standard deviation of an annotated corner's coordinates, mm at the patient plane; None = 2 % of the
        vertebrae's median width.

    Returns
    -------
    None with fewer than two vertebrae in both.

    Raises
    ------
    SpinestiffError : as ``check_reading``.
    """
    check_reading(definition, noise)
    common = tuple(name for name in rest.vertebrae if name in pushed.vertebrae)
    if len(common) < 2:
        return None
    axes = np.stack(picture_axes(view), axis=1)
    pictures = [corners.selected(common) for corners in (rest, pushed)]
    points = [view.to_patient_plane(picture.corners) @ axes for picture in pictures]
    before, after = (tilts_from_points(common, found, DEFINITIONS[definition]) for found in points)
    change = cobb_change(before, after)
    tracking = [tracked_tilt_sds(p, definition, tracked_noise(q.quality)) for p, q in zip(points, pictures)]
    annotation = [tilt_sds(found, definition, usual_noise(found) if noise is None else noise) for found in points]
    ends = {
        "signed": ((change.rest.upper, change.rest.lower), (change.pushed.upper, change.pushed.lower)),
        "fixed_levels": (change.levels, change.levels),
        "tilt": (change.tilt_levels, change.tilt_levels),
    }
    sds = []
    for first, second in ends.values():
        weights = [-_weights(common, first), _weights(common, second)]
        if definition == "midline":
            # Both endplates of a vertebra have one tilt, and so one error.
            weights = [weight.sum(axis=0) * [[1.0], [0.0]] for weight in weights]
        own = _variance(weights, tracking, shared=pushed is rest)
        marked = _variance(weights, annotation, shared=same_origin)
        sds.append(float(np.degrees(np.sqrt(own + marked))))
    return replace(change, sds=Forms(*sds))


def change_words(degrees: float, sd: float | None, levels: str) -> str:
    """A change of a Cobb angle, e.g. "−10.4° ± 1.2° (T6–T11)"; ± is half the 95 % interval, none of a model's."""
    size = f"{round(degrees, 1) + 0.0:+.1f}".replace("-", "−").replace("+0.0", "0.0")
    around = "" if sd is None else f" ± {HALF_WIDTH_95 * sd:.1f}°"
    return f"{size}°{around}" + (f" ({levels})" if levels else "")


def forms_in_words(change: CobbChange) -> dict[str, str]:
    """The three forms of a change by name, each as ``change_words``."""
    sds = change.sds
    return {
        "signed": change_words(change.signed, sds.signed, signed_levels(change)),
        "fixed_levels": change_words(change.fixed_levels, sds.fixed_levels, "–".join(change.levels)),
        "tilt": change_words(change.tilt, sds.tilt, "–".join(change.tilt_levels)),
    }


def signed_levels(change: CobbChange) -> str:
    """End vertebrae of the largest angle before and after: "T6–T11", or "T6–T11 to T5–T12"."""
    before, after = (f"{angle.upper}–{angle.lower}" for angle in (change.rest, change.pushed))
    return before if before == after else f"{before} to {after}"


def _weights(vertebrae: tuple[str, ...], levels: tuple[str, str]) -> Floats:
    """(2, V) by which the tilts of upper and lower endplates enter the angle between two vertebrae."""
    found = np.zeros((2, len(vertebrae)))
    found[0, vertebrae.index(levels[0])], found[1, vertebrae.index(levels[1])] = 1.0, -1.0
    return found


def _variance(weights: Sequence[Floats], sds: Sequence[Floats], shared: bool) -> float:
    """Of a change to which the tilts of both pictures add with ``weights`` (2, V), rad2; errors are alike if shared."""
    parts = [(weights[0] + weights[1]) * sds[0]] if shared else [weight * sd for weight, sd in zip(weights, sds)]
    return sum(float(np.sum(part**2)) for part in parts)
