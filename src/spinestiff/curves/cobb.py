"""Cobb angles of an image: its largest one, its curves by region, their signs, and what corner noise makes of them.

The largest angle is that of any two vertebrae (``curves.tilts.cobb_angle``). The other curves hang on it: above it the
curve that ends where it begins and bends the other way, and so on to the head; below it likewise. Each curve belongs to
the region of its apex. docs/cobb.md has the definitions with their sources.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from spinestiff.anatomy.names import VERTEBRAE
from spinestiff.arrays import Floats
from spinestiff.curves.corner_files import ImageCorners, Side, UnreadableImage
from spinestiff.curves.corner_order import in_order
from spinestiff.curves.tilts import CobbAngle, EndplateMethod, SpineTilts, cobb_angle, tilts_from_points
from spinestiff.errors import SpinestiffError
from spinestiff.normal import HALF_WIDTH_95

Definition = Literal["endplate", "midline"]
DEFINITIONS: dict[Definition, EndplateMethod] = {"endplate": "endplates", "midline": "midline"}
Status = Literal["ok", "repaired", "refused"]
Region = Literal["proximal_thoracic", "main_thoracic", "thoracolumbar_lumbar"]
# Lenke et al. 2001 by the apex: T3 to T5, T6 to the disc T11-T12, T12 to L4. Nothing is left between them here: what
# lies above T3 counts with the first, the disc T5-T6 with the second, what lies below L4 with the third.
REGIONS: dict[Region, tuple[float, str]] = {
    "proximal_thoracic": (float(VERTEBRAE.index("T5")), "proximal thoracic"),
    "main_thoracic": (VERTEBRAE.index("T11") + 0.5, "main thoracic"),
    "thoracolumbar_lumbar": (float(VERTEBRAE.index("L5")), "thoracolumbar/lumbar"),
}
SMALLEST_CURVE_DEG = 5.0
"""A curve beside the largest one counts from here: below it, corner noise makes curves of its own."""
NOISE_OF_WIDTH = 0.02
"""Default standard deviation of a corner's coordinate over the vertebrae's width: about 0.5 to 0.9 mm."""
LEAST_NOISE_PX = 0.3
"""Of corners set on whole pixels, 1 / sqrt(12)."""
TRACKED_TURN = 1.32
"""By which a tracked vertebra's turn errs more than the error of its corners, each by itself, makes of its mid-line:
they move as one body, whose turn errs by 1.62 (docs/tracking.md) over the root of its width's and height's squares."""
DOUBTFUL_SD_DEG = 5.0
STRAIGHT_SDS = 3.5
"""Largest of all pairs of a straight spine's seventeen vertebrae, in sds of one pair: 95 % lie below."""


@dataclass(frozen=True)
class Curve:
    """One curve of a spine.

    Attributes
    ----------
    angle : signed, with its end vertebrae.
    apex : vertebra ("T8") or disc ("T11-T12") farthest from the line between the end vertebrae's middles.
    region : that of the apex.
    sd_deg : standard deviation of the angle between these end vertebrae, from the corners' noise to first order.
    """

    angle: CobbAngle
    apex: str
    region: Region
    sd_deg: float

    @property
    def half_width_deg(self) -> float:
        """Half the width of the angle's 95 % interval."""
        return HALF_WIDTH_95 * self.sd_deg


@dataclass(frozen=True)
class CobbReading:
    """What an image's corners say.

    Attributes
    ----------
    image : its name.
    status : "ok", "repaired" (then a warning says what was changed) or "refused".
    warnings : repairs, doubts; of a refused image the reason.
    definition : "endplate" or "midline".
    curves : head to foot; empty if refused.
    largest : the one with the largest angle, whatever its size; None if refused.
    patient_left : the side of the image where the patient's left lies; None = not known. Angles above 0 are convex to
        the patient's left or, where that is not known, to the image's right (where it is in the usual display).
    noise : standard deviation of each corner's coordinates, in the corners' unit; None if refused.
    levels, corners : (V,) and (V, 4, 2) in order from head to foot, as seen in the image; None if refused.
    """

    image: str
    status: Status
    warnings: tuple[str, ...]
    definition: Definition
    curves: tuple[Curve, ...] = ()
    largest: Curve | None = None
    patient_left: Side | None = None
    noise: float | None = None
    levels: tuple[str, ...] = ()
    corners: Floats | None = None

    def by_region(self) -> dict[Region, Curve | None]:
        """The largest curve of each region; None = none there."""
        found: dict[Region, Curve | None] = dict.fromkeys(REGIONS)
        for curve in self.curves:
            known = found[curve.region]
            if known is None or abs(curve.angle.degrees) > abs(known.angle.degrees):
                found[curve.region] = curve
        return found

    def convexity(self, curve: Curve) -> str:
        """In words: "convex to the patient's left", "convex to the image's right", "straight"."""
        if curve.angle.convexity == "none":
            return "straight"
        if self.patient_left is None:
            return f"convex to the image's {'right' if self.bulges_right(curve) else 'left'}"
        return f"convex to the patient's {curve.angle.convexity}"

    def words(self, curve: Curve | None = None, by_what: bool = True) -> str:
        """An angle with all that belongs to it, the same wherever it is told; of the largest curve by default.

        E.g. "13.1° ± 4.7° (T6–T11, endplates, left-convex)"; ± is half the 95 % interval, the sides are the patient's.
        Without ``by_what`` "endplates" is left out, for a table whose title says it.
        """
        found = curve or self.largest
        if found is None:
            return f"not measured: {self.warnings[0]}"
        side = found.angle.convexity
        known = self.patient_left is not None and side != "none"
        bends = f"{side}-convex" if known else self.convexity(found)
        return self.size_words(found, *([DEFINITIONS[self.definition]] if by_what else []), bends)

    @staticmethod
    def size_words(curve: Curve, *further: str) -> str:
        """Size, ± and levels alone, e.g. "13.1° ± 4.7° (T6–T11)", with what is to stand behind the levels."""
        behind = ", ".join((f"{curve.angle.upper}–{curve.angle.lower}", *further))
        return f"{abs(curve.angle.degrees):.1f}° ± {curve.half_width_deg:.1f}° ({behind})"

    def bulges_right(self, curve: Curve) -> bool:
        """Whether the curve's convex side is the image's right."""
        return (curve.angle.degrees > 0.0) == (self.patient_left != "left")

    def as_dict(self) -> dict[str, Any]:
        """JSON of the reading (docs/cobb.md)."""
        largest = self.largest
        return {
            "image": self.image,
            "status": self.status,
            "warnings": list(self.warnings),
            "definition": self.definition,
            "largest_deg": None if largest is None else abs(largest.angle.degrees),
            "upper_level": None if largest is None else largest.angle.upper,
            "lower_level": None if largest is None else largest.angle.lower,
            "signed_deg": None if largest is None else largest.angle.degrees,
            "convexity": None if largest is None else self.convexity(largest),
            "patient_left": self.patient_left,
            "sd_deg": None if largest is None else largest.sd_deg,
            "noise": self.noise,
            "curves": [self._curve_dict(curve) for curve in self.curves],
            "regions": {
                name: None if curve is None else self._curve_dict(curve) for name, curve in self.by_region().items()
            },
        }

    def _curve_dict(self, curve: Curve) -> dict[str, Any]:
        return {
            "deg": abs(curve.angle.degrees),
            "signed_deg": curve.angle.degrees,
            "upper_level": curve.angle.upper,
            "lower_level": curve.angle.lower,
            "apex": curve.apex,
            "region": curve.region,
            "convexity": self.convexity(curve),
            "sd_deg": curve.sd_deg,
        }


def check_reading(definition: str, noise: float | None) -> None:
    """Raise SpinestiffError for an unknown definition, and for a noise of corners that can't be one; None is usual."""
    if definition not in DEFINITIONS:
        raise SpinestiffError(f"unknown definition '{definition}'; wanted {' or '.join(DEFINITIONS)}")
    if noise is not None and not 0.0 <= noise < np.inf:
        raise SpinestiffError(f"noise of corners: found {noise}, wanted a finite number of 0 or more")


def read_cobb(
    image: ImageCorners | UnreadableImage,
    definition: Definition = "endplate",
    noise: float | None = None,
    patient_left: Side | None = None,
) -> CobbReading:
    """The Cobb angles of one image; what can't be measured comes back refused, with the reason.

    Parameters
    ----------
    image : as ``corner_files`` reads it.
    definition : "endplate": superior endplate of the upper against inferior endplate of the lower end vertebra;
        "midline": the line between the middles of left and right side, of both.
    noise : standard deviation of each corner's coordinates in the corners' unit; None = 2 % of the median width.
    patient_left : the side of the image where the patient's left lies, if it is known and the file doesn't tell.

    Raises
    ------
    SpinestiffError : as ``check_reading``.
    """
    check_reading(definition, noise)
    if isinstance(image, UnreadableImage):
        return CobbReading(image.image, "refused", (image.reason,), definition)
    try:
        if image.first_on and patient_left and image.first_on != patient_left:
            raise SpinestiffError(f"the file has the patient's left on the {image.first_on}, not on the {patient_left}")
        ordered = in_order(image)
        left = image.first_on or patient_left
        # As seen columns grow to the patient's left, unless the image is known to be the other way round.
        mirrored = left == "left"
        points = ordered.corners * [-1.0 if mirrored else 1.0, -1.0]
        points = points if mirrored else points[:, [1, 0, 3, 2]]
        if noise is None and image.unit == "px":
            noise = max(usual_noise(points), LEAST_NOISE_PX)
        curves, largest, noise = spine_curves(ordered.levels, points, definition, noise)
    except SpinestiffError as error:
        return CobbReading(image.image, "refused", (str(error),), definition)
    return CobbReading(
        image.image,
        "repaired" if ordered.repairs else "ok",
        (*ordered.repairs, *ordered.warnings, *_noise_warnings(largest)),
        definition,
        curves,
        largest,
        left,
        noise,
        ordered.levels,
        ordered.corners,
    )


def read_cobb_of_view(
    image: str,
    levels: tuple[str, ...],
    points: Floats,
    definition: Definition = "endplate",
    noise: float | None = None,
    tracking: float | Floats = 0.0,
) -> CobbReading:
    """``read_cobb`` of corners that a view has oriented: ``points`` and ``tracking`` as ``spine_curves`` wants them.

    Raises
    ------
    SpinestiffError : as ``spine_curves`` does.
    """
    curves, largest, noise = spine_curves(levels, points, definition, noise, tracking)
    seen = points[:, [1, 0, 3, 2]] * [1.0, -1.0]
    return CobbReading(image, "ok", _noise_warnings(largest), definition, curves, largest, "right", noise, levels, seen)


def spine_curves(
    levels: tuple[str, ...],
    points: Floats,
    definition: Definition,
    noise: float | None = None,
    tracking: float | Floats = 0.0,
) -> tuple[tuple[Curve, ...], Curve, float]:
    """A spine's curves from head to foot, the largest of them, and the corners' noise they were given.

    Parameters
    ----------
    levels : (V,) head to foot.
    points : (V, 4, 2) as (towards the patient's left, upwards): superior-left, superior-right, inferior-right,
        inferior-left.
    definition : "endplate" or "midline".
    noise : standard deviation of each coordinate, in the points' unit; None = 2 % of the median width.
    tracking : (V, 4), or of all, what tracking adds to that.

    Raises
    ------
    SpinestiffError : as ``check_reading`` and ``curves.tilts.tilts_from_points`` do.
    """
    check_reading(definition, noise)
    spine = tilts_from_points(levels, points, DEFINITIONS[definition])
    main = cobb_angle(spine)
    largest = (main.degrees, levels.index(main.upper), levels.index(main.lower))
    ends = [*reversed(_chain(spine, largest, upwards=True)), largest, *_chain(spine, largest, upwards=False)]
    noise = usual_noise(points) if noise is None else noise
    sds = np.hypot(tilt_sds(points, definition, noise), tracked_tilt_sds(points, definition, tracking))
    middles = points.mean(axis=1)
    curves = []
    for degrees, i, j in ends:
        apex = _apex(levels[i : j + 1], middles[i : j + 1])
        region = next(name for name, (last, _) in REGIONS.items() if apex <= last)
        sd = float(np.degrees(np.hypot(sds[0, i], sds[1, j])))
        curves.append(Curve(CobbAngle(degrees, levels[i], levels[j]), _named(apex), region, sd))
    return tuple(curves), curves[ends.index(largest)], noise


_Ends = tuple[float, int, int]
"""Signed degrees of a curve, and the rows of its end vertebrae."""


def _chain(spine: SpineTilts, curve: _Ends, upwards: bool) -> list[_Ends]:
    """The curves beyond one end of a curve: each shares an end vertebra with the last and bends the other way."""
    degrees, upper, lower = curve
    levels = spine.vertebrae
    pairs = [(i, upper) for i in range(upper)] if upwards else [(lower, j) for j in range(lower + 1, len(levels))]
    against = -np.sign(degrees)
    found = [(spine.cobb_degrees(levels[i], levels[j]), i, j) for i, j in pairs]
    # Of equal ones the shortest: straight parts do not belong to a curve.
    best = max(found, key=lambda f: (round(against * f[0], 9), f[1] - f[2]), default=None)
    if best is None or against * best[0] < SMALLEST_CURVE_DEG:
        return []
    return [best, *_chain(spine, best, upwards)]


def _noise_warnings(largest: Curve) -> tuple[str, ...]:
    degrees, sd = abs(largest.angle.degrees), largest.sd_deg
    noise = f"{degrees:.1f} degrees may be corner noise alone: a straight spine reads so"
    small = f"the vertebrae are so small that corner noise makes {sd:.0f} degrees (sd)"
    return (*([noise] if degrees < STRAIGHT_SDS * sd else []), *([small] if sd > DOUBTFUL_SD_DEG else []))


def _widths(points: Floats) -> Floats:
    across = 0.5 * (points[:, 1] + points[:, 2] - points[:, 0] - points[:, 3])
    return np.hypot(*across.T)


def usual_noise(points: Floats) -> float:
    """Standard deviation of a coordinate of annotated corners (V, 4, 2): 2 % of the vertebrae's median width."""
    return NOISE_OF_WIDTH * float(np.median(_widths(points)))


def tilt_sds(points: Floats, definition: Definition, noise: float | Floats) -> Floats:
    """Standard deviation of the tilt of upper and lower endplate, or of the mid-line twice, (2, V) rad.

    A line between two points of noise s turns by s sqrt(2) / length; between the middles of two pairs by s / length.

    Parameters
    ----------
    points : (V, 4, 2) as ``spine_curves`` takes them.
    noise : standard deviation of each coordinate, for all corners or (V, 4) for each, in the points' unit.
    """
    each = np.broadcast_to(np.asarray(noise, dtype=float), points.shape[:2])
    if definition == "midline":
        return np.tile(0.5 * np.linalg.norm(each, axis=1) / _widths(points), (2, 1))
    plates = np.stack([points[:, 1] - points[:, 0], points[:, 2] - points[:, 3]])
    sds = np.stack([np.hypot(each[:, 0], each[:, 1]), np.hypot(each[:, 2], each[:, 3])])
    return np.asarray(sds / np.hypot(plates[..., 0], plates[..., 1]))


def tracked_tilt_sds(points: Floats, definition: Definition, errors: float | Floats) -> Floats:
    """``tilt_sds`` of what tracking adds: a vertebra's four corners are taken along together, so that the mid-line errs
    by more than four errors by themselves make of it (``TRACKED_TURN``). Of an endplate two make more than that turn.
    """
    sds = tilt_sds(points, definition, errors)
    return TRACKED_TURN * sds if definition == "midline" else sds


def _apex(levels: tuple[str, ...], middles: Floats) -> float:
    """Where a curve is farthest from the line between its ends: place in VERTEBRAE, half ones being discs."""
    places = np.array([VERTEBRAE.index(level) for level in levels], dtype=float)
    chord = middles[-1] - middles[0]
    out = middles - middles[0]
    away = np.abs(chord[0] * out[:, 1] - chord[1] * out[:, 0])
    top = int(np.argmax(away))
    if not 0 < top < len(levels) - 1:
        # Two neighbours: what bends is the disc between them.
        return float(np.round(2.0 * places[[0, -1]].mean()) / 2.0)
    # The top of the parabola through the farthest vertebra and its neighbours tells a disc from a vertebra.
    fit = np.polynomial.polynomial.polyfit(places[top - 1 : top + 2] - places[top], away[top - 1 : top + 2], 2)
    shift = -fit[1] / (2.0 * fit[2]) if fit[2] < 0.0 else 0.0
    return float(np.clip(np.round(2.0 * (places[top] + shift)) / 2.0, places[0], places[-1]))


def _named(place: float) -> str:
    whole = int(place)
    return VERTEBRAE[whole] if whole == place else f"{VERTEBRAE[whole]}-{VERTEBRAE[whole + 1]}"
