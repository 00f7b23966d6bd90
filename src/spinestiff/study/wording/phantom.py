"""A bench phantom's estimate beside what was measured of it, in words and as JSON."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict

import numpy as np

from spinestiff.study.phantom import BenchComparison, PhantomResult
from spinestiff.study.wording.numbers import fixed, number


def phantom_lines(found: PhantomResult) -> list[str]:
    """The result in words."""
    lines = []
    for joint in found.joints:
        lines.append(
            f"joint below {joint.block}: {number(joint.stiffness)} N mm/rad on the bench, ± {fixed(100 * joint.sd)} % "
            "by the scatter of its line"
        )
    for one in found.comparisons:
        verdict = {
            "agrees": "agrees with the bench",
            "does not agree": f"does NOT agree with the bench, {_percent(one.ratio)} than measured there",
            "can't be told": "whether it agrees with the bench can't be told from these pictures",
        }[one.verdict]
        lines.append(
            f"{one.part}: {number(one.ratio * one.bench)} {one.unit}, {number(one.ratio)} times the bench value, 95 % "
            f"{_span(one, one.fit_low, one.fit_high)}; with the bench's own ± {fixed(100 * one.bench_sd)} % "
            f"{_span(one, one.low, one.high)}: {verdict}"
        )
    for frame in found.predicted:
        lines.append(
            f"{frame.image}, {number(frame.force_n)} N, not fitted: marks moved by {number(frame.motion_mm)} mm, "
            f"predicted to {number(frame.rmse_mm)} mm (marking alone leaves {number(found.noise_mm, 2)})"
        )
    lines.append(f"residuals: p = {found.p_value:.2g}; fit {found.status}")
    if not found.sound:
        lines.append(
            "the pictures do NOT fit the phantom, so that no ratio counts: look at mm per pixel and distances, at the "
            "sizes of blocks and gaps, at levels and marks, and at the side and block of each push"
        )
    lines += [f"warning: {warning}" for warning in found.warnings]
    if found.sound and any(one.verdict == "does not agree" for one in found.comparisons):
        lines.append(_advice(found.comparisons))
    return lines


def _span(found: BenchComparison, low: float, high: float) -> str:
    """An interval; an end at the fit's bound is open, "≤ 0.0025 to 1.2"."""
    return f"{'≤ ' * found.open_low}{number(low)} to {'≥ ' * found.open_high}{number(high)}"


def _percent(ratio: float) -> str:
    return f"{fixed(100 * abs(ratio - 1.0), 0)} % {'stiffer' if ratio > 1.0 else 'softer'}"


def _advice(comparisons: Sequence[BenchComparison]) -> str:
    ratios = [one.ratio for one in comparisons]
    alike = max(ratios) / min(ratios) < 1.0 + 2.0 * max(one.high / one.ratio - 1.0 for one in comparisons)
    if alike:
        factor = float(np.exp(np.mean(np.log(ratios))))
        return (
            "look at: what is common to all stiffness, above all the force; a gauge that reads "
            f"{fixed(100 * abs(factor - 1.0), 0)} % {'high' if factor > 1.0 else 'low'} does this. Then the bench's "
            "lever and weights, mm per pixel, friction under the blocks"
        )
    return "look at: the part that is off, its own bench measurement and its size; then friction and the pushed point"


def record_of(found: PhantomResult) -> Mapping[str, object]:
    """As JSON."""
    return {**asdict(found), "agrees": found.agrees}
