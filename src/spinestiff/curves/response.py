"""How a spine answers a push, without a model: N per degree of tilt and of the Cobb angle, and flexibility in percent.

An angle between two fixed vertebrae is followed from the frame without force through the loaded ones. Its slope over
the force, by generalised least squares, is the compliance; what is said is its inverse. The errors: each corner's, as
its quality predicts it; the annotation's, shared by all frames that were tracked from one annotated frame, so that it
drops out of a change and stays in the angle at rest; the gauge's scale and zero, shared by the frames of a push.
docs/cobb.md has the definitions and what the intervals cover.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from spinestiff.arrays import Floats
from spinestiff.curves.changes import LEAST_ERROR_MM
from spinestiff.curves.cobb import check_reading, tilt_sds, usual_noise
from spinestiff.curves.tilts import SpineTilts, cobb_angle, cobb_change, tilts_from_points
from spinestiff.errors import SpinestiffError
from spinestiff.estimation.priors import Priors
from spinestiff.imaging.tracking.quality import LOWEST_QUALITY, error_of
from spinestiff.normal import HALF_WIDTH_95
from spinestiff.subject.outcomes import AngleResponse, Flexibility, ForcePerDegree, PushResponse

LEAST_SHARE = 0.5
"""Of a push's largest force: below it a frame tells too little of the push to be its last one."""
CHOSEN_95 = 3.5
"""As ``HALF_WIDTH_95`` for the largest of a spine's 136 pairs: which pair is largest is chosen by noise, too."""


@dataclass(frozen=True)
class GaugeError:
    """Standard deviations of a gauge's errors, each shared by all frames of a push.

    Attributes
    ----------
    scale : relative. zero_n : of every force above 0, N; without contact there is no force, whatever the gauge reads.
    """

    scale: float = Priors.force_scale
    zero_n: float = Priors.force_offset_n

    def __post_init__(self) -> None:
        if not (self.scale >= 0.0 and self.zero_n >= 0.0):
            raise SpinestiffError(f"gauge errors: wanted >= 0, found {self.scale} (scale) and {self.zero_n} N (zero)")


GAUGE = GaugeError()


@dataclass(frozen=True)
class FrameCorners:
    """A frame of a push.

    Attributes
    ----------
    frame : index. force_n : as read.
    vertebrae : (n,) head to foot.
    points : (n, 4, 2) mm at the patient plane, as (towards the patient's left, upwards).
    quality : (n, 4) of tracking.
    origin : the annotated frame from which the corners come; frames of one origin share the annotation's errors.
    """

    frame: int
    force_n: float
    vertebrae: tuple[str, ...]
    points: Floats
    quality: Floats
    origin: int = 0

    @property
    def whole(self) -> tuple[str, ...]:
        """The vertebrae of which every corner was followed."""
        return tuple(name for name, q in zip(self.vertebrae, self.quality) if q.min() >= LOWEST_QUALITY)

    def of(self, names: tuple[str, ...]) -> tuple[Floats, Floats]:
        """Points (k, 4, 2) and predicted errors (k, 4), mm, of vertebrae that are there."""
        rows = [self.vertebrae.index(name) for name in names]
        return self.points[rows], np.maximum(error_of(self.quality[rows]), LEAST_ERROR_MM)

    def tilts(self, names: tuple[str, ...]) -> SpineTilts:
        return tilts_from_points(names, self.of(names)[0])


@dataclass(frozen=True)
class _Followed:
    """An angle between two fixed vertebrae through the frames that show both; degrees.

    Attributes
    ----------
    levels : upper and lower.
    frames : (n,) in order; one without force is among them.
    angle : (n,) signed. annotation, tracking : (n,) standard deviations; the first shared by frames of one origin.
    """

    levels: tuple[str, str]
    frames: tuple[FrameCorners, ...]
    angle: Floats
    annotation: Floats
    tracking: Floats

    @property
    def covariance(self) -> Floats:
        """(n, n) of ``angle``."""
        origin = np.array([frame.origin for frame in self.frames])
        shared = np.outer(self.annotation, self.annotation) * (origin[:, None] == origin)
        return np.asarray(shared + np.diag(self.tracking**2))

    @property
    def forces(self) -> Floats:
        return np.array([frame.force_n for frame in self.frames])

    @property
    def unloaded(self) -> int:
        """Index of the first frame without force; forces may fall from frame to frame."""
        return int(np.flatnonzero(self.forces == 0.0)[0])


def push_response(
    frames: Sequence[FrameCorners], rest: SpineTilts, gauge: GaugeError = GAUGE, noise: float | None = None
) -> PushResponse:
    """What the frames of one push say without a model.

    Parameters
    ----------
    frames : in order; those that show fewer than two whole vertebrae do not count. Without one of no force, or without
        a loaded one, ``missing`` says so.
    rest : of the whole rest picture, which chooses the Cobb angle's end vertebrae. Chosen in the frame that is
        measured, the largest angle of many would be too large by its own noise. Where no frame without force or none
        under ``LEAST_SHARE`` of the largest one shows both, ``instead_of`` has them, and the curve is the rest
        picture's largest angle of the vertebrae that were followed.
    gauge : its errors.
    noise : standard deviation of an annotated corner's coordinates, mm at the patient plane; None = 2 % of the
        vertebrae's median width.

    Raises
    ------
    SpinestiffError : as ``curves.cobb.check_reading`` for the noise.
    """
    check_reading("endplate", noise)
    frames = [frame for frame in frames if len(frame.whole) > 1]
    measured = _first_and_most(frames)
    if measured is None:
        force = max((frame.force_n for frame in frames), default=0.0)
        without = "under a force" if any(frame.force_n == 0.0 for frame in frames) else "without force"
        return PushResponse(force_n=force, missing=f"no usable frame {without}")
    end = cobb_angle(rest)
    shown = _first_and_most([frame for frame in frames if {end.upper, end.lower} <= set(frame.whole)])
    if shown is not None and shown[1].force_n < LEAST_SHARE * measured[1].force_n:
        shown = None
    start, most = shown or measured
    common = _in_both(start, most)
    instead_of = None
    if shown is None:
        named = tuple(name for name in common if name in rest.vertebrae)
        if len(named) < 2:
            few = f"frames {start.frame} and {most.frame} show fewer than two vertebrae in common"
            return PushResponse(force_n=most.force_n, missing=few)
        instead_of, end = (end.upper, end.lower), cobb_angle(rest.selected(named))
    # Which two turned most is asked of the largest force of all, where that frame shows any two.
    first, last = measured if len(_in_both(*measured)) > 1 else (start, most)
    turned = _in_both(first, last)
    tilt_levels = cobb_change(first.tilts(turned), last.tilts(turned)).tilt_levels
    curve = _followed(frames, (end.upper, end.lower), noise)
    return PushResponse(
        force_n=most.force_n,
        tilt=_response(_followed(frames, tilt_levels, noise), last, gauge, CHOSEN_95),
        curve=_response(curve, most, gauge, HALF_WIDTH_95),
        flexibility=_flexibility(curve, most),
        instead_of=instead_of,
    )


def _in_both(one: FrameCorners, other: FrameCorners) -> tuple[str, ...]:
    return tuple(name for name in one.whole if name in other.whole)


def _first_and_most(frames: Sequence[FrameCorners]) -> tuple[FrameCorners, FrameCorners] | None:
    """The first frame without force and that of the largest; None where there is no such or no loaded one."""
    start = next((frame for frame in frames if frame.force_n == 0.0), None)
    most = max(frames, key=lambda frame: frame.force_n, default=None)
    return None if start is None or most is None or most.force_n == 0.0 else (start, most)


def _followed(frames: Sequence[FrameCorners], levels: tuple[str, str], noise: float | None) -> _Followed:
    seen = tuple(frame for frame in frames if set(levels) <= set(frame.whole))
    angle, annotation, tracking = [], [], []
    for frame in seen:
        points, errors = frame.of(levels)
        angle.append(frame.tilts(levels).cobb_degrees(*levels))
        annotation.append(_pair_sd(points, usual_noise(frame.of(frame.whole)[0]) if noise is None else noise))
        # A predicted error is a distance in the plane, a noise that of one coordinate.
        tracking.append(_pair_sd(points, errors / np.sqrt(2.0)))
    return _Followed(levels, seen, np.array(angle), np.array(annotation), np.array(tracking))


def _pair_sd(points: Floats, noise: float | Floats) -> float:
    """Degrees, of the angle between upper endplate of the first and lower endplate of the last vertebra."""
    sds = tilt_sds(points, "endplate", noise)
    return float(np.degrees(np.hypot(sds[0, 0], sds[1, -1])))


def _response(found: _Followed, most: FrameCorners, gauge: GaugeError, chosen: float) -> AngleResponse:
    forces, covariance, loaded = found.forces, found.covariance, (found.forces > 0.0).astype(float)
    design = np.stack([np.ones_like(forces), forces], axis=1)
    slope = 0.0
    # The gauge's zero moves the loaded frames alike, by the slope that is sought; a third round changes nothing.
    for _ in range(3):
        inverse = np.linalg.inv(covariance + (slope * gauge.zero_n) ** 2 * np.outer(loaded, loaded))
        weights = np.linalg.solve(design.T @ inverse @ design, design.T @ inverse)
        start, slope = weights @ found.angle
    left = found.angle - design @ [start, slope]
    free = len(forces) - 2
    scatter = float(np.sqrt(left @ inverse @ left / free)) if free else None
    of_corners = float(np.sqrt(weights[1] @ covariance @ weights[1])) * max(1.0, scatter or 0.0)
    of_gauge = abs(slope) * float(np.hypot(gauge.zero_n * (weights[1] @ loaded), gauge.scale))
    change, change_sd = _change(found, most)
    return AngleResponse(
        levels=found.levels,
        frames=tuple(frame.frame for frame in found.frames),
        rest_deg=float(found.angle[found.unloaded]),
        change_deg=change,
        change_sd_deg=change_sd,
        n_per_degree=_inverse(abs(float(slope)), of_corners, of_gauge, chosen),
        scatter=scatter,
    )


def _inverse(slope: float, of_corners: float, of_gauge: float, chosen: float) -> ForcePerDegree:
    """Of a slope of 0 or more with its standard deviations, degrees per N.

    ``chosen`` counts the first of them by which the slope may lie below: noise that chose the angle has raised it.
    """
    up, down = (float(np.hypot(times * of_corners, HALF_WIDTH_95 * of_gauge)) for times in (HALF_WIDTH_95, chosen))
    low = 1.0 / (slope + up)
    if slope <= down:
        return ForcePerDegree(value=None, low=low, high=None)
    return ForcePerDegree(value=1.0 / slope, low=low, high=1.0 / (slope - down))


def _change(found: _Followed, most: FrameCorners) -> tuple[float, float]:
    """Degrees, from the first frame without force to that of the largest force, and its standard deviation."""
    first, last, c = found.unloaded, found.frames.index(most), found.covariance
    change_sd = np.sqrt(c[first, first] + c[last, last] - 2.0 * c[first, last])
    return float(found.angle[last] - found.angle[first]), float(change_sd)


def _flexibility(found: _Followed, most: FrameCorners) -> Flexibility:
    """One minus the angle under force over that at rest, with Fieller's interval of a ratio."""
    first, last = found.unloaded, found.frames.index(most)
    rest, pushed = float(found.angle[first]), float(found.angle[last])
    c = HALF_WIDTH_95**2 * found.covariance
    # The ratios q at which pushed - q rest lies within its error: a q^2 - 2 b q + d <= 0.
    a, b, d = rest**2 - c[first, first], rest * pushed - c[first, last], pushed**2 - c[last, last]
    if a <= 0.0:
        return Flexibility(percent=None, low=None, high=None)
    half = np.sqrt(max(b**2 - a * d, 0.0))
    return Flexibility(
        percent=100.0 * (1.0 - pushed / rest), low=100.0 * (1.0 - (b + half) / a), high=100.0 * (1.0 - (b - half) / a)
    )
