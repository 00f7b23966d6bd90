"""Numbers as people read them: no more digits than they have, open ends of intervals told from closed ones."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence

from spinestiff.anatomy.regions import AT, is_beside_whole
from spinestiff.imaging.tracking.quality import DOUBTED_QUALITY, FEWEST_CORNERS, LOWEST_QUALITY
from spinestiff.normal import HALF_WIDTH_95
from spinestiff.subject.assessment_outcome import HeldOutFrame
from spinestiff.subject.estimate_outcome import BudgetRecord, CombinationRecord, Estimate, PriorChangeRecord
from spinestiff.subject.geometry_outcome import GeometryRecord
from spinestiff.subject.outcome_parts import Determination, Quantity
from spinestiff.subject.outcomes import AngleResponse, Flexibility, PushResponse, Responses, Tracked, TrackedPush
from spinestiff.words import counted, sentence

MISSING = "not available"
NO_INTERVALS = "no intervals"
AT_AN_END = 1.001
"""Factor within which a value is its interval's end."""
SURE = 0.05
"""Standard deviation of a logarithm below which a number has three significant digits; else it has two."""

OFF_LINE = 2.0
"""Scatter about a straight line, in errors, that is worth a word."""
MOST_TOLD = 2
"""Ratios of which the uncertainty is told in a terminal."""
LEAST_EXPONENT = 0.1
"""Of a ratio in a combination that is worth its name."""

MOST_LOST = 4
"""Vertebrae that tracking lost of which the frames are told."""

LIKELY_MISTAKES = (
    "forces_n (newtons, one for each frame, in the frames' order), side and level of each push, the corners and names "
    "of the vertebrae (spinestiff annotate shows them), pictures of another patient or visit"
)
"""What to look at where no estimate is found, in the order in which it was the reason."""


def number(value: float | None, digits: int = 3) -> str:
    """A number with so many significant digits, without an exponent; "not available" for none."""
    if value is None or not math.isfinite(value):
        return MISSING
    if value == 0.0:
        return "0"
    # Of the rounded number: 9.96 with two digits is 10.
    decimals = digits - 1 - int(f"{value:.{digits - 1}e}".partition("e")[2])
    return f"{round(value, decimals):.{max(decimals, 0)}f}".replace("-", "−")


def fixed(value: float | None, decimals: int = 1, sign: bool = False) -> str:
    """A number with so many decimals; "not available" for none."""
    if value is None or not math.isfinite(value):
        return MISSING
    # Plus zero: no sign before a rounded zero.
    rounded = round(value, decimals) + 0.0
    return f"{rounded:{'+' if sign and rounded else ''}.{decimals}f}".replace("-", "−")


def estimated(quantity: Quantity) -> str:
    """The value of an estimate with the digits that its interval leaves it; at an open end, "≤ 0.005"."""
    if quantity.open_low and quantity.low is not None and quantity.value <= quantity.low * AT_AN_END:
        return "≤ " + _bound(quantity.value)
    if quantity.open_high and quantity.high is not None and quantity.value >= quantity.high / AT_AN_END:
        return "≥ " + _bound(quantity.value)
    return number(quantity.value, digits_of(quantity))


def digits_of(quantity: Quantity) -> int:
    """Significant ones of a value and of its interval's ends, which with fewer may read alike."""
    return 3 if quantity.sd_log < SURE else 2


def interval(quantity: Quantity) -> str:
    """A 95 % interval: "0.06 to 0.34"; an end at the fit's bound is open, "≤ 0.005 to 0.34"."""
    digits = digits_of(quantity)
    if quantity.low is None and quantity.high is None:
        return MISSING
    first = (
        MISSING
        if quantity.low is None
        else "≤ " + _bound(quantity.low)
        if quantity.open_low
        else number(quantity.low, digits)
    )
    last = (
        MISSING
        if quantity.high is None
        else "≥ " + _bound(quantity.high)
        if quantity.open_high
        else number(quantity.high, digits)
    )
    return f"{first} to {last}"


def span_in_words(quantity: Quantity, unit: str, determined: Determination | None = None) -> str:
    """What is known of a quantity as half a sentence: where the radiographs don't fix it a range, never a number alone.

    E.g. "3.8 kPa, between 3.0 and 4.8 kPa (95 %)", "between 1.9 and 6.9 kPa (95 %), most probably 3.8", "at most 5.1
    N m/rad (95 %), no lower end", "not fixed by the radiographs: between 2.6 and 98 N m/rad (95 %)".

    Parameters
    ----------
    determined : how far the data do, where the interval is not theirs alone; default: by the interval.
    """
    value, low, high = estimated(quantity), quantity.low, quantity.high
    if low is None or high is None:
        return f"{value} {unit}, {NO_INTERVALS}"
    if quantity.open_low and quantity.open_high:
        return f"not fixed by the radiographs: anything that the fit allows, {_bound(low)} to {_bound(high)} {unit}"
    if quantity.open_low:
        return f"at most {number(high, 2)} {unit} (95 %), no lower end"
    if quantity.open_high:
        return f"at least {number(low, 2)} {unit} (95 %), no upper end"
    digits = digits_of(quantity)
    ends = f"between {number(low, digits)} and {number(high, digits)} {unit} (95 %)"
    determined = determined or quantity.determination
    if determined == "determined":
        return f"{value} {unit}, {ends}"
    if determined == "weakly determined":
        return f"{ends}, most probably {value}"
    return f"not fixed by the radiographs: {ends}"


def short_span(quantity: Quantity, determined: Determination | None = None) -> str:
    """The value if it is determined or has no interval, else the interval (``determined``: see ``span_in_words``)."""
    alone = (determined or quantity.determination) == "determined" or (quantity.low is None and quantity.high is None)
    return estimated(quantity) if alone else interval(quantity)


PLAIN = {
    "lateral_bending_thoracic": "lateral bending of a thoracic level",
    "lateral_bending_lumbar": "lateral bending of a lumbar level",
    "tissue_young": "Young's modulus of the trunk's soft tissue",
}
"""Stiffness in plain units (``plain``), in words."""
RATIO_TITLES = {
    "lateral_bending": "Lateral bending of the spine",
    "intervertebral_bending": "Lateral bending of the spine, rib cage as it is",
    "tissue": "Soft tissue of the trunk",
    "tissue_mu": "Soft tissue of the trunk, shear",
    "tissue_lambda": "Soft tissue of the trunk, bulk",
    "flexion_extension": "Flexion and extension of the spine",
    "axial_rotation": "Axial rotation of the spine",
    "lateral_shear": "Lateral shear of the spine",
    "sagittal_shear": "Sagittal shear of the spine",
    "separation": "Axial stiffness of the spine",
    "rib_rotation": "Turning of the ribs on their vertebrae",
    "everything": "All stiffnesses together",
}
"""What ratios scale, in words."""
BENDING_RATIOS = ("lateral_bending", "intervertebral_bending", "everything")
"""Ratios that scale a level's lateral bending as a whole."""
IN_PLAIN_UNITS = {
    "lateral_bending_thoracic": BENDING_RATIOS,
    "lateral_bending_lumbar": BENDING_RATIOS,
    "tissue_young": ("tissue", "everything"),
}
"""Ratios, of all or of a part of the torso, that scale these."""
TIMES_DEFAULT, TIMES_WHOLE = "times the default stiffness", "times the ratio of the whole"


def ratio_unit(name: str, parameters: Sequence[str]) -> str:
    """What a ratio, one of ``parameters``, counts in."""
    return TIMES_WHOLE if is_beside_whole(name, parameters) else TIMES_DEFAULT


def ratio_title(name: str) -> str:
    """What a ratio scales, in words."""
    stem, _, part = name.partition(AT)
    title = RATIO_TITLES.get(stem, stem.replace("_", " "))
    return f"{title}, {part}" if part else title


def stiffness_title(name: str) -> str:
    """What ``told_stiffness`` tells of, in words: the same on report, cards and terminal."""
    return sentence(PLAIN[name]) if name in PLAIN else ratio_title(name)


def within_a_sentence(title: str) -> str:
    """A title without its capital letter; that of a name stays."""
    return title if title.startswith("Young") else title[:1].lower() + title[1:]


def headline(estimate: Estimate) -> list[str]:
    """What was found, in plain units and words, a line a stiffness that was estimated."""
    return [
        f"{within_a_sentence(stiffness_title(name))}: {span_in_words(found, unit, determined)}"
        for name, found, unit, determined in told_stiffness(estimate)
    ]


def told_stiffness(estimate: Estimate) -> list[tuple[str, Quantity, str, Determination | None]]:
    """What is told of an estimate first: name in ``plain``, or of a ratio that is no part of one; value with interval,
    unit, and how far the data determine it."""
    lines: list[tuple[str, Quantity, str, Determination | None]] = [
        (key, found, found.unit, determined_of(estimate, found.ratio))
        for key, found in ((key, estimate.plain[key]) for key in PLAIN)
        if found.ratio is not None or found.low is not None
    ]
    told = {found.ratio for found in estimate.plain.values()}
    # Of ratios that scale a stiffness together, what they make is told.
    together = {
        stem
        for key, found in estimate.plain.items()
        if found.ratio is None and found.low is not None
        for stem in IN_PLAIN_UNITS[key]
    }
    alone = [name for name in estimate.parameters if name not in told and name.partition(AT)[0] not in together]
    return lines + [
        (name, estimate.ratios[name], ratio_unit(name, estimate.parameters), determined_of(estimate, name))
        for name in alone
    ]


def determined_of(estimate: Estimate, name: str | None) -> Determination | None:
    """How far the data determine a ratio; None without one."""
    return None if name is None else estimate.ratios[name].determined


def _bound(value: float) -> str:
    """A bound of the fit: two digits, without zeros behind them."""
    text = number(value, 2)
    return text.rstrip("0").rstrip(".") if "." in text else text


def no_estimate(search: str, wrong: Sequence[str]) -> str:
    """Why there is no estimate, the user's likely mistakes first.

    Parameters
    ----------
    search : how the search ended.
    wrong : what the checks of the inputs found wrong, a text for each.
    """
    if wrong:
        found = f"the inputs do not agree: {'; '.join(wrong)}; then look at {LIKELY_MISTAKES}"
    else:
        found = f"no stiffness explains how this spine moved under these forces; look at {LIKELY_MISTAKES}"
    return f"no estimate: {found}; if all of these are right, the search itself: {search}"


def badge(estimate: Estimate) -> str:
    """The word or two that stand above a result: doubtful, or how far it is determined, if its method tells."""
    return known_word(estimate, estimate.determined)


def known_word(estimate: Estimate, determined: Determination) -> str:
    """The word or two for a stiffness that is ``determined`` so far: doubtful as the whole result is, if it is, and no
    intervals by a method that has none."""
    if estimate.status == "DOUBTFUL":
        return "doubtful"
    return determined if has_intervals(estimate) else NO_INTERVALS


def has_intervals(estimate: Estimate) -> bool:
    """Whether the estimate's method gives intervals."""
    return estimate.method != "paper"


UNKNOWNS = {
    "annotation": "corners set by hand",
    "drag of tracking": "what takes tracking along",
    "place in the picture": "the patient's place in each picture",
    "posture": "the spine's posture in each sequence",
    "rest geometry": "the spine's shape at rest",
    "model discrepancy": "what the model lacks",
    "force scale": "the gauge's scale",
    "force offset": "the gauge's zero",
    "push direction": "the push's direction",
    "push height": "the push's height",
    "push depth": "the push's place front to back",
    "obliquity by force": "how far the pelvis gives",
    "shoulder by force": "how far the shoulder gives",
    "breathing": "breath from frame to frame",
    "obliquity of a frame": "the pelvis' obliquity in each frame",
    "shoulder of a frame": "the shoulder's place in each frame",
    "trunk size": "the trunk's size",
    "rib joints": "the stiffness of the ribs' joints",
    "tissue's volume": "the tissue's resistance to a change of volume",
    "tissue mesh": "the tissue's mesh",
    "source distance": "the source's distance",
}
"""What is not quite known, by its name in the variance budget."""
UNMEASURABLE = ("model discrepancy", "rib joints", "tissue's volume", "tissue mesh")


def unknown_title(name: str) -> str:
    """An unknown of the variance budget in words."""
    return UNKNOWNS.get(name, name)


def factor95(sd_log: float) -> str:
    """The factor either way within which a value lies with 95 %, from the standard deviation of its log."""
    factor = math.exp(HALF_WIDTH_95 * sd_log) if sd_log < 20.0 else math.inf
    return number(factor, 3 if factor < 2.0 else 2) if factor < 1000.0 else "more than 1000"


def most_costly(estimate: Estimate, ratio: str, measurable: bool = False) -> BudgetRecord | None:
    """The unknown without which a ratio would be known best; None where knowing none helps or there is no budget."""
    rows = [row for row in estimate.budget if not (measurable and row.name in UNMEASURABLE)]
    best = min(rows, key=lambda row: row.without[ratio], default=None)
    return best if best is not None and best.without[ratio] < estimate.sd_log[ratio] else None


LINEAR = "intervals: to first order at the estimate, as there are too many ratios for a profile of each"


def held_lines(estimate: Estimate) -> list[str]:
    """How intervals of many ratios were found, what was held of ratios before the fit, and what the data say alone."""
    lines = [LINEAR] if estimate.intervals == "linear" else []
    lines += [f"held before the fit, no data: {name}: {text}" for name, text in estimate.held.items()]
    if estimate.data_sd_log:
        least, most = (pick(estimate.data_sd_log.items(), key=lambda item: item[1]) for pick in (min, max))
        told = [f"{name} within a factor of {factor95(sd)}" for name, sd in dict.fromkeys((least, most))]
        lines.append(f"the radiographs without it (95 %, to first order): {listed(told)}")
    return lines


def best_known_text(found: CombinationRecord, title: Callable[[str], str] = str) -> str:
    """The combination of ratios that is known best, "bending^0.4 × tissue = 0.014 within a factor of 1.12"."""
    powers = []
    for name, exponent in found.exponents.items():
        if abs(exponent) >= LEAST_EXPONENT:
            words = title(name)
            words = f"({words})" if " " in words else words
            powers.append(words if round(exponent, 2) == 1.0 else f"{words}^{fixed(exponent, 2)}")
    less = "" if len(powers) == len(found.exponents) else f" (powers below {LEAST_EXPONENT:g} not shown)"
    digits = 3 if found.sd_log < SURE else 2
    return f"{' × '.join(powers)} = {number(found.value, digits)} within a factor of {factor95(found.sd_log)}{less}"


def combination_lines(estimate: Estimate) -> list[str]:
    """The combination of ratios that the data fix best, a line; none where a single ratio is known as well."""
    if estimate.best_known is None:
        return []
    return [f"known best, a combination (95 %, to first order): {best_known_text(estimate.best_known)}"]


def least_known(estimate: Estimate) -> list[str]:
    """The two ratios that are known least, the least first; none without a variance budget."""
    return sorted(estimate.sd_log, key=lambda name: -estimate.sd_log[name])[:MOST_TOLD]


def factor_lines(estimate: Estimate) -> list[str]:
    """How well the ratios that are known least are known, with all unknowns and with tracking's errors alone."""
    return [
        f"{name}: known within a factor of {factor95(estimate.sd_log[name])} (95 %, to first order), of "
        f"{factor95(estimate.sd_log_tracking[name])} if tracking's errors were the only ones"
        for name in least_known(estimate)
    ]


def costly_unknowns(estimate: Estimate) -> list[BudgetRecord]:
    """The variance budget's unknowns by the largest share of a least known ratio's variance that they cost, by
    themselves or beside all others, the largest first."""

    def cost(row: BudgetRecord) -> float:
        return max(
            max(row.alone[name] ** 2 - estimate.sd_log_tracking[name] ** 2, sd**2 - row.without[name] ** 2) / sd**2
            for name, sd in ((name, estimate.sd_log[name]) for name in least_known(estimate))
        )

    return sorted(estimate.budget, key=cost, reverse=True)


def moved_sd(estimate: Estimate, change: PriorChangeRecord) -> float:
    """By how many of its standard deviations another prior moves a ratio's log, the most of any ratio."""
    return max(
        abs(math.log(change.ratios[name] / value)) / estimate.sd_log[name] for name, value in estimate.values.items()
    )


def strongest_priors(estimate: Estimate) -> list[PriorChangeRecord]:
    """Priors halved and doubled by how far they move a ratio or change its standard deviation, the most first."""

    def effect(change: PriorChangeRecord) -> float:
        widened = (abs(change.sd_log[name] / sd - 1.0) for name, sd in estimate.sd_log.items())
        return max(moved_sd(estimate, change), *widened)

    return sorted(estimate.prior_changes, key=effect, reverse=True)


def halved_or_doubled(change: PriorChangeRecord) -> str:
    """What was done to a prior's standard deviation, in a word."""
    return "halved" if change.factor < 1.0 else "doubled"


def pelvis_lines(estimate: Estimate) -> list[str]:
    """How far the pelvis turned in the training frames, a line; none where it was held level."""
    turns = [place.obliquity_deg for place in estimate.supports]
    if not any(turns):
        return []
    return [f"pelvis in the training frames: turned by {fixed(min(turns))}° to {fixed(max(turns), 1)}°"]


def tracking_lines(tracked: Tracked) -> list[str]:
    """What came of following the corners, a line a push: frames, vertebrae that were lost, and corners to look at."""
    return [f"push '{name}': {_tracked_words(push)}" for name, push in tracked.pushes.items()]


def _tracked_words(push: TrackedPush) -> str:
    lost: dict[str, list[int]] = {}
    doubtful = corners = 0
    for number, frame in enumerate(push.frames):
        for vertebra, quality in zip(push.vertebrae, frame.quality):
            corners += len(quality)
            doubtful += sum(LOWEST_QUALITY <= one < DOUBTED_QUALITY for one in quality)
            if sum(one >= LOWEST_QUALITY for one in quality) < FEWEST_CORNERS:
                lost.setdefault(vertebra, []).append(number)
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


def listed(parts: Iterable[str]) -> str:
    """Words as a list: a, b and c."""
    parts = list(parts)
    return ", ".join(parts[:-1]) + " and " + parts[-1] if len(parts) > 1 else "".join(parts)


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
