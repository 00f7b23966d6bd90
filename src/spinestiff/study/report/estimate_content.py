"""What the report says of an estimate: numbers as people read them, and the rows of its tables, from the results."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from spinestiff.anatomy.regions import AT, is_beside_whole
from spinestiff.arrays import Floats
from spinestiff.estimation.unknowns import ACTS, PLACING, unknowns_of
from spinestiff.study.predictions import Model, Predictions, predicted_acts
from spinestiff.study.report.certainty_pictures import SupportPlace
from spinestiff.study.truth import read_truth, true_values
from spinestiff.study.visit import Visit
from spinestiff.study.wording.estimate import (
    badge,
    best_known_text,
    determined_of,
    halved_or_doubled,
    has_intervals,
    held_lines,
    most_costly,
    moved_sd,
)
from spinestiff.study.wording.numbers import (
    MISSING,
    estimated,
    factor95,
    fixed,
    interval,
    number,
    short_span,
    span_in_words,
)
from spinestiff.study.wording.sensitivity import (
    estimator_columns,
    force_cells,
    force_rows,
    ratio_cells,
    ratio_rows,
    sensitivity_lines,
)
from spinestiff.study.wording.titles import BENDING_RATIOS, UNMEASURABLE, ratio_title, ratio_unit, unknown_title
from spinestiff.subject.assessment_outcome import Assessment, Comparison
from spinestiff.subject.estimate_outcome import Check, Estimate, PlainStiffness, RatioEstimate, Reactions
from spinestiff.subject.outcome_parts import Determination, Quantity
from spinestiff.subject.plan_outcome import Plan
from spinestiff.subject.run_record import why_stale
from spinestiff.subject.sensitivity_outcome import Sensitivity

# Secant lateral-bending stiffness of cadaver thoracic segments at 7.5 N m (Wilke et al. 2017), N m/degree.
BENDING_BAND = (1.3, 1.8)
# Range of the ratio in the seven subjects of the method's first study. Its tissue ratios are left out: they belong to
# another default tissue. "lateral_bending" takes the sternal joints along and is another ratio.
PUBLISHED = {"intervertebral_bending": (0.01, 0.63)}
PLAIN_TITLES = {
    "lateral_bending_thoracic": "per thoracic level",
    "lateral_bending_lumbar": "per lumbar level",
    "tissue_young": "Young’s modulus",
}
DETERMINATIONS: dict[Determination, str] = {
    "determined": "The radiographs determine every ratio within a factor of 2 either way, on average of both (95 %).",
    "weakly determined": "At least one ratio is known only within a factor of 10 either way, or has an open end.",
    "not determined": "The radiographs do not determine at least one ratio; its interval says what they allow.",
}
NO_INTERVALS_TEXT = (
    "The paper’s estimator, equal weights with the pelvis level, has no intervals: nothing says how far the "
    "radiographs determine the ratios."
)
PROFILES = {
    "bounded": "Less likely to both sides: the radiographs bound it.",
    "one-sided": "Less likely to one side alone: the other end of its interval is the fit’s bound.",
    "flat": "About as likely anywhere within the fit’s bounds: the radiographs say nothing of it.",
    "at a bound": "Most likely at the fit’s bound.",
    "several minima": "Likely in several places with less likely ones between: the value is one of them.",
}

SUPPORT_UNITS = ((180.0 / np.pi, "°"), (1.0, " mm"))
"""By which obliquity and shoulder are shown: factor and unit."""

MOST_BARS = 10
MOST_PANELS = 4  # of the variance budget's picture
NUMBERED = (0.01, 0.1, 1.0, 5.0)  # ticks of a strip
MOVED_SD = 0.2  # of a ratio's log, by other priors: what is worth a row


def subject_content(visit: Visit) -> dict[str, Any]:
    """Whose report it is."""
    return {"id": visit.subject.record.id, "synthetic": visit.truth is not None}


def result_content(visit: Visit, estimate: Estimate, assessment: Assessment) -> dict[str, Any]:
    """Whether the result can be right, ratios with intervals and in plain units, plausibility and notes."""
    truth = true_values(estimate.parameters, read_truth(visit.truth)) if visit.truth else {}
    ratios = []
    for name in estimate.parameters:
        ratio = estimate.ratios[name]
        own = [key for key in PLAIN_TITLES if estimate.plain[key].ratio == name]
        key = own[0] if own else ""
        chief: Quantity = estimate.plain[key] if key else ratio
        unit = estimate.plain[key].unit if key else ratio_unit(name, estimate.parameters)
        ratios.append(
            {
                "title": ratio_title(name),
                "big": short_span(chief, ratio.determined),
                "unit": unit,
                "what": PLAIN_TITLES.get(key, ""),
                "words": span_in_words(chief, unit, ratio.determined),
                "of_whole": is_beside_whole(name, estimate.parameters),
                "value": estimated(ratio),
                "interval": interval(ratio),
                "determined": ratio.determined if has_intervals(estimate) else "",
                "at_bound": ratio.at_bound,
                "truth": number(truth[name]) if name in truth else "",
                "plain": _plain_rows(estimate, own[1:]),
                "strip": _strip(name, ratio, estimate.bounds, truth.get(name)),
                "published": PUBLISHED.get(name),
            }
        )
    return {
        "doubtful": estimate.status == "DOUBTFUL",
        "badge": badge(estimate),
        "good": estimate.status == "CONVERGED" and estimate.determined == "determined",
        "badge_text": DETERMINATIONS[estimate.determined] if has_intervals(estimate) else NO_INTERVALS_TEXT,
        "fit_text": "" if estimate.fit_status == "CONVERGED" else estimate.fit_status_text,
        "failed": [f"{check.name}: {check.text}" for check in estimate.failed],
        "best_known": "" if estimate.best_known is None else best_known_text(estimate.best_known, ratio_title),
        "ratios": ratios,
        "plain": _plain_rows(estimate, [key for key in PLAIN_TITLES if _of_several(estimate.plain[key])]),
        "held": held_lines(estimate),
        "bending": bending_line(estimate),
        "notes": list(dict.fromkeys((*estimate.notes, *assessment.notes))),
    }


def _plain_rows(estimate: Estimate, keys: Sequence[str]) -> list[dict[str, str]]:
    found = [(PLAIN_TITLES[key], estimate.plain[key]) for key in keys]
    return [
        {"title": title, "value": f"{estimated(one)} {one.unit}", "interval": f"{interval(one)} {one.unit}"}
        for title, one in found
    ]


def _of_several(found: PlainStiffness) -> bool:
    """Whether several ratios scale it."""
    return found.ratio is None and found.low is not None


def check_rows(checks: Sequence[Check]) -> list[dict[str, str]]:
    """Every check with its outcome."""
    outcome = {True: "passed", False: "FAILED", None: "not possible"}
    return [{"name": check.name, "outcome": outcome[check.passed], "text": check.text} for check in checks]


def _strip(name: str, ratio: RatioEstimate, bounds: Sequence[float], truth: float | None) -> dict[str, Any]:
    """Places on a logarithmic axis over the fit's bounds, in percent of its width."""
    low, high = np.log(bounds[0]), np.log(bounds[1])

    def place(value: float) -> float:
        return round(float(np.clip((np.log(value) - low) / (high - low), 0.0, 1.0)) * 100.0, 2)

    band = PUBLISHED.get(name)
    ticks = [v for v in (0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0) if bounds[0] <= v <= bounds[1]]
    return {
        "value": place(ratio.value),
        "start": place(bounds[0] if ratio.low is None else ratio.low),
        "end": place(bounds[1] if ratio.high is None else ratio.high),
        # So few numbers that they stand apart on a phone, too.
        "ticks": [(place(v), f"{v:g}" if v in NUMBERED else "") for v in ticks],
        "one": place(1.0),
        "band": None if band is None else (place(band[0]), place(band[1])),
        "truth": None if truth is None else place(truth),
    }


def bending_line(estimate: Estimate) -> dict[str, Any] | None:
    """The bending stiffness of a level beside cadaver segments; of one that is not determined, its interval."""
    found = estimate.plain["lateral_bending_thoracic"]
    if not _of_several(found) and (found.ratio or "").partition(AT)[0] not in BENDING_RATIOS:
        return None
    band = (float(np.degrees(BENDING_BAND[0])), float(np.degrees(BENDING_BAND[1])))
    determined = determined_of(estimate, found.ratio)
    alone = found.low is None or found.high is None or (determined or found.determination) == "determined"
    reaches = found.low is not None and _overlap(found, band)
    beside = ""
    if alone and not band[0] <= found.value <= band[1]:
        beside = _apart(found.value, band, "about")
        sentence = f"The estimate is {beside} the middle of this range"
        sentence += ", but its 95 % interval reaches the range." if reaches else "."
    elif alone:
        sentence = "The estimate lies within this range."
    elif reaches:
        sentence = "Its 95 % interval reaches this range, so that the two are not to be told apart."
    else:
        nearest = found.high if found.high is not None and found.high < band[0] else found.low
        assert nearest is not None
        beside = _apart(nearest, band, "at least")
        sentence = f"By its whole 95 % interval it is {beside} the middle of this range."
    return {
        "value": short_span(found, determined),
        "per_degree": short_span(found.scaled(np.pi / 180.0), determined),
        "band": f"{BENDING_BAND[0]:g} to {BENDING_BAND[1]:g}",
        "band_rad": f"{band[0]:.0f} to {band[1]:.0f}",
        "beside": beside,
        "reaches": alone and reaches,
        "sentence": sentence,
    }


def _overlap(found: Quantity, band: tuple[float, float]) -> bool:
    above = found.low is None or found.open_low or found.low <= band[1]
    return above and (found.high is None or found.open_high or found.high >= band[0])


def _apart(value: float, band: tuple[float, float], size: str) -> str:
    middle = 0.5 * (band[0] + band[1])
    times = max(value / middle, middle / value)
    return f"{size} {number(times, 2)} times {'softer' if value < middle else 'stiffer'} than"


def certainty_content(estimate: Estimate, comparison: Comparison | None) -> dict[str, Any]:
    """How the fit went, and whether the joint region holds the truth where that is known."""
    contains = None if comparison is None else comparison.inside
    return {
        "correlation": fixed(estimate.correlation, 2),
        "region": bool(estimate.region),
        "steps": sum(step.accepted for step in estimate.history),
        "evaluations": len(estimate.history),
        "truth": "" if contains is None else "holds" if contains else "does not hold",
    }


def uncertainty_content(estimate: Estimate, predictions: Predictions) -> dict[str, Any] | None:
    """Where the uncertainty comes from; None for a method that does not tell."""
    if not has_intervals(estimate):
        return None
    return {
        "profiles": [
            {"title": ratio_title(name), "text": PROFILES[kind]}
            for name in estimate.parameters
            for kind in [estimate.ratios[name].profile]
            if kind is not None
        ],
        "gains": [_gain(estimate, name) for name in estimate.parameters if estimate.budget],
        "supports": _support_rows(support_places(predictions, estimate)),
        "changed": bool(estimate.prior_changes),
        "changes": _prior_changes(estimate),
        "changes_limit": f"{MOVED_SD:g}",
        "titles": [ratio_title(name) for name in estimate.parameters],
        "p_value": "" if estimate.p_value is None else number(estimate.p_value, 2),
        "expected": "residuals as expected" not in [check.name for check in estimate.failed],
        "tracking_factor": "" if estimate.tracking_factor is None else number(estimate.tracking_factor, 2),
    }


def budget_bars(estimate: Estimate) -> tuple[tuple[str, ...], dict[str, Floats]]:
    """The unknowns that cost most, the largest first, and of each ratio (n, 2) shares of the variance of its log.

    Of many ratios those that are known least. The first share is what the unknown adds where all others are known, the
    second what knowing it takes away.
    """
    least = sorted(estimate.sd_log, key=lambda name: -estimate.sd_log[name])[:MOST_PANELS]
    share = {
        name: np.array(
            [
                [row.alone[name] ** 2 - estimate.sd_log_tracking[name] ** 2, sd**2 - row.without[name] ** 2]
                for row in estimate.budget
            ]
        ).reshape(-1, 2)
        / sd**2
        for name, sd in estimate.sd_log.items()
        if name in least
    }
    most = np.max([rows.max(axis=1) for rows in share.values()], axis=0)
    shown = np.argsort(-most, kind="stable")[:MOST_BARS]
    titles = tuple(_unknown(estimate.budget[i].name) for i in shown)
    return titles, {name: np.maximum(rows[shown], 0.0) for name, rows in share.items()}


def _unknown(name: str) -> str:
    return unknown_title(name).replace("'", "’")


def sensitivity_content(found: Sensitivity) -> dict[str, Any]:
    """Refits with one thing changed: what they say, and the tables of ratios and of forces by estimator."""
    columns = estimator_columns(found)
    return {
        "lines": sensitivity_lines(found),
        "mesh": found.mesh,
        "columns": tuple(columns),
        "ratios": [{"title": title, "cells": ratio_cells(ratios, columns)} for title, ratios in ratio_rows(found)],
        "rows": [{"title": title, "cells": force_cells(percent, columns)} for title, percent in force_rows(found)],
    }


def stale_plan(visit: Visit) -> str:
    """Why a plan is not shown."""
    why = why_stale(visit.subject, Plan.STEP)
    words = f"was {why}" if why else "is not as spinestiff plan wrote it"
    return f"{visit.subject.results.name}/{Plan.FILE} {words}; run spinestiff plan again"


def _gain(estimate: Estimate, name: str) -> dict[str, str]:
    """What would be gained most for a ratio, by knowing what nobody can measure, if that is more, and by measuring."""
    found = {"title": ratio_title(name), "now": factor95(estimate.sd_log[name])}
    found |= dict.fromkeys(("unmeasurable", "known", "what", "then"), "")
    first, row = most_costly(estimate, name), most_costly(estimate, name, measurable=True)
    if first is not None and first.name in UNMEASURABLE:
        found |= {"unmeasurable": _unknown(first.name), "known": factor95(first.without[name])}
    if row is not None:
        found |= {"what": _unknown(row.name), "then": factor95(row.without[name])}
    return found


def support_places(predictions: Predictions, estimate: Estimate) -> dict[str, dict[str, SupportPlace]]:
    """Obliquity, degrees, and shoulder, mm, by frame: as fitted or, if held out, as predicted; as expected before; as
    tracked. Empty where supports are no unknowns."""
    pushes, known = predictions.pushes, {one.name: one.standard for one in estimate.nuisances}
    items = [p.item for p in predictions.of_role("training", "validation")]
    if not items:
        return {}
    unknowns = unknowns_of(*pushes.posed(items), pushes.known.priors, pushes.known.taped)
    places = [ACTS.index(name) for name in PLACING]
    found = predicted_acts(pushes, items, Model(known=known))[:, places]
    before = np.sqrt(np.sum(unknowns.acts[:, places] ** 2, axis=2))
    frames = {}
    for item, values, sds in zip(items, found, before):
        own = {}
        for name, value, sd, (scale, _) in zip(PLACING, values, sds, SUPPORT_UNITS):
            seen = item.trial.supports.get(name)
            tracked = None if seen is None else (scale * seen[0], scale * seen[1])
            own[name] = SupportPlace(scale * float(value), scale * float(sd), tracked, item.role == "validation")
        frames[f"“{item.push}”, frame {item.frame}, {item.force_n:.0f} N"] = own
    return frames


def _support_rows(frames: Mapping[str, Mapping[str, SupportPlace]]) -> list[dict[str, str]]:
    rows = []
    for title, own in frames.items():
        cells = {"title": title, "role": "predicted" if any(p.predicted for p in own.values()) else "fitted"}
        for (name, place), (_, unit) in zip(own.items(), SUPPORT_UNITS):
            cells[name] = f"{fixed(place.value, 1, True)}{unit}"
            cells[f"{name}_prior"] = f"±{fixed(place.before)}{unit}"
            cells[f"{name}_seen"] = (
                "not seen"
                if place.seen is None
                else f"{fixed(place.seen[0], 1, True)}{unit} ±{fixed(place.seen[1])}{unit}"
            )
        rows.append(cells)
    return rows


def _prior_changes(estimate: Estimate) -> list[dict[str, Any]]:
    """Other priors that move a ratio by more than a part of its standard deviation."""
    return [
        {
            "title": _unknown(change.name),
            "factor": halved_or_doubled(change),
            "cells": [number(change.ratios[name], 2) for name in estimate.parameters],
        }
        for change in estimate.prior_changes
        if moved_sd(estimate, change) > MOVED_SD
    ]


def reaction_rows(found: Reactions) -> list[dict[str, str]]:
    """Forces and moment at the supports in the model beside Eqs. 1-2."""
    return [
        {"title": "Push on the ribs (F3)", "model": fixed(found.f3), "balance": fixed(found.f3)},
        {"title": "Shoulder (F1)", "model": fixed(found.shoulder), "balance": fixed(found.eq2_shoulder)},
        {"title": "Pelvis (F2)", "model": fixed(found.pelvis), "balance": fixed(found.eq1_pelvis)},
        {"title": "Pelvis, moment in N m", "model": fixed(found.pelvis_moment_nm, 2), "balance": fixed(0.0, 2)},
        {"title": "Back wall, largest pull", "model": fixed(found.wall_pull), "balance": MISSING},
    ]
