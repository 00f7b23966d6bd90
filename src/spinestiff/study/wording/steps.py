"""What the other steps found in words: tracking, geometry, the response without a model, frames held out."""

from __future__ import annotations

import math
from collections.abc import Sequence

from spinestiff.imaging.tracking.quality import DOUBTED_QUALITY, FEWEST_CORNERS, LOWEST_QUALITY
from spinestiff.normal import HALF_WIDTH_95
from spinestiff.study.wording.numbers import SURE, fixed, listed, number
from spinestiff.subject.assessment_outcome import HeldOutFrame
from spinestiff.subject.geometry_outcome import GeometryRecord
from spinestiff.subject.outcomes import AngleResponse, Flexibility, PushResponse, Responses, Tracked, TrackedPush
from spinestiff.words import counted

OFF_LINE = 2.0
"""Scatter about a straight line, in errors, that is worth a word."""
MOST_LOST = 4
"""Vertebrae that tracking lost of which the frames are told."""


def tracking_lines(tracked: Tracked) -> list[str]:
    """What came of following the corners, a line a push: frames, vertebrae that were lost, and corners to look at."""
    return [f"push '{name}': {_tracked_words(push)}" for name, push in tracked.pushes.items()]


def _tracked_words(push: TrackedPush) -> str:
    lost: dict[str, list[int]] = {}
    doubtful = corners = 0
    for index, frame in enumerate(push.frames):
        for vertebra, quality in zip(push.vertebrae, frame.quality):
            corners += len(quality)
            doubtful += sum(LOWEST_QUALITY <= one < DOUBTED_QUALITY for one in quality)
            if sum(one >= LOWEST_QUALITY for one in quality) < FEWEST_CORNERS:
                lost.setdefault(vertebra, []).append(index)
    frames, vertebrae = counted(len(push.frames), "frame"), counted(len(push.vertebrae), "vertebra", "vertebrae")
    if not lost:
        found = f"{frames}, {vertebrae} followed in all of them"
    else:
        where = ", ".join(
            f"{name} in frame{'s' if len(numbers) > 1 else ''} {', '.join(map(str, numbers))}"
            for name, numbers in list(lost.items())[:MOST_LOST]
        )
        more = f" and {len(lost) - MOST_LOST} more" if len(lost) > MOST_LOST else ""
        found = f"{frames}, {len(push.vertebrae) - len(lost)} of {vertebrae} followed in all; lost: {where}{more}"
    return f"{found}; {doubtful} of {corners} corners are doubtful"


def geometry_lines(geometry: GeometryRecord) -> list[str]:
    """How well the torso fits the radiographs at rest, and what was odd."""
    views = ", ".join(f"{view} {fixed(rmse, 2)} mm" for view, rmse in geometry.rmse_mm.items())
    prior = ""
    if geometry.prior_only:
        prior = f"; no radiograph shows {listed(geometry.prior_only)}, whose places are the prior's"
    fit = (
        f"torso against the radiographs at rest, RMSE: {views}; corners scatter by {fixed(geometry.corner_sd_mm, 2)} mm"
    )
    return [f"{fit}{prior}", *(f"note: {warning}" for warning in geometry.warnings)]


def response_lines(responses: Responses) -> list[str]:
    """What each push says without a model, one or several lines a push."""
    return [f"push '{name}': {text}" for name, push in responses.pushes.items() for text in response_texts(push)]


def response_texts(push: PushResponse) -> list[str]:
    """N per degree of the curve and of tilt, and flexibility; of a push without numbers the reason."""
    if push.tilt is None or push.curve is None or push.flexibility is None:
        return [f"no N per degree: {push.missing}"]
    tilt = "tilt between {} and {}".format(*push.tilt.levels)
    texts = [
        f"{force_per_degree(push.curve)} N per degree of the curve {_levels(push.curve)}, up to {push.force_n:g} N",
        f"{force_per_degree(push.tilt)} N per degree of {tilt}, the most that any two turned",
        f"flexibility at {push.force_n:g} N: {flexibility(push.flexibility)}; {changed(push.curve)}",
    ]
    if push.instead_of is not None:
        texts.append(
            f"the curve is {_levels(push.curve)}, not the rest picture's {'–'.join(push.instead_of)}, of which no "
            "frame without force or none under half of the largest force shows both end vertebrae"
        )
    wide = [(what, one.scatter) for what, one in (("the curve", push.curve), (tilt, push.tilt)) if one.scatter]
    texts += [
        f"{what} is off a straight line over the force by {number(scatter, 2)} times its errors; its interval allows "
        "for that"
        for what, scatter in wide
        if scatter > OFF_LINE
    ]
    return texts


def force_per_degree(found: AngleResponse) -> str:
    """The value with its 95 % interval, "3.4 (2.9 to 4.1)", or "at least 12"."""
    force = found.n_per_degree
    if force.value is None or force.high is None:
        return f"at least {number(force.low, 2)}"
    # An interval as narrow as 2 % either way is read with a digit more.
    digits = 3 if math.log(force.high / force.low) < 4.0 * SURE else 2
    return f"{number(force.value, digits)} ({number(force.low, digits)} to {number(force.high, digits)})"


def flexibility(found: Flexibility) -> str:
    """E.g. "34 % (28 to 41 %)"."""
    if found.percent is None:
        return "not known, the curve does not stand out from its errors"
    return f"{fixed(found.percent, 0)} % ({fixed(found.low, 0)} to {fixed(found.high, 0)} %)"


def changed(found: AngleResponse) -> str:
    """What the push did to the curve, e.g. "25.0° without force, 8.5° ± 0.9° less under it"; of one that it turns over,
    what is there then."""
    less = found.change_deg * found.rest_deg < 0.0
    pushed, error = found.rest_deg + found.change_deg, fixed(HALF_WIDTH_95 * found.change_sd_deg)
    past = f", past straight to {fixed(abs(pushed))}° the other way" if less and pushed * found.rest_deg < 0.0 else ""
    return (
        f"{fixed(abs(found.rest_deg))}° without force, {fixed(abs(found.change_deg))}° ± {error}° "
        f"{'less' if less else 'more'} under it{past}"
    )


def _levels(found: AngleResponse) -> str:
    return "–".join(found.levels)


def forecast_lines(frames: Sequence[HeldOutFrame]) -> list[str]:
    """How the intervals of held-out frames were met, a line a frame that has any."""
    lines = []
    for frame in frames:
        found = frame.forecast
        if found is None:
            continue
        line = (
            f"push '{frame.push}' frame {frame.frame}: expected within {fixed(found.sd_mm)} mm (one sd), found "
            f"{fixed(found.rmse_mm)} mm off, {100.0 * found.inside95:.0f} % of corners inside their 95 % intervals"
        )
        if found.cobb_error_deg is not None and found.cobb_sd_deg is not None:
            limit = HALF_WIDTH_95 * found.cobb_sd_deg
            seen = frame.cobb_change_deg.get("measured")
            between = "" if seen is None else f" between {seen.levels[0]} and {seen.levels[1]}"
            off = fixed(abs(found.cobb_error_deg), 1)
            line += f"; change of the Cobb angle{between} off by {off}° (95 %: at most {fixed(limit, 1)}°)"
        lines.append(line)
    return lines
