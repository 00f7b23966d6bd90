"""The report's first page, for a clinician: who, what was done, what was found, what to distrust, what next.

It prints on one sheet: lists are short and say how much more the engineer's part has, and the pictures take the height
that the words leave.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from spinestiff.curves.changes import change_words
from spinestiff.curves.pushes import rest_reading
from spinestiff.study.report.estimate_content import BENDING_BAND, bending_line, stale_plan
from spinestiff.study.report.frame_content import comparison_content
from spinestiff.study.visit import Visit
from spinestiff.study.wording.estimate import has_intervals, known_word, told_stiffness
from spinestiff.study.wording.numbers import digits_of, estimated, factor95, fixed, listed, number
from spinestiff.study.wording.plan import NONE_PAYS, TITLES, VIEW_WORDS, now_of, pays, size_of, width
from spinestiff.study.wording.steps import flexibility, force_per_degree
from spinestiff.study.wording.titles import PLAIN, ratio_title, stiffness_title, within_a_sentence
from spinestiff.subject.assessment_outcome import Assessment
from spinestiff.subject.estimate_outcome import Estimate, PlainStiffness
from spinestiff.subject.outcome_parts import Determination, Quantity
from spinestiff.subject.outcomes import Responses
from spinestiff.subject.plan_outcome import Plan
from spinestiff.subject.records import PushRecord
from spinestiff.subject.run_record import is_unchanged, read_outcome
from spinestiff.words import counted

MOST_PUSHES, MOST_STIFFNESSES, MOST_DOUBTS, MOST_NEXT, MOST_FAILED = 4, 3, 5, 3, 2
MOST_BESIDE_FAILED = 3
"""Of doubts, where checks failed."""
LONGEST = 170
"""Characters of an item; of a longer one the engineer's part has the whole."""
MEANINGS = {
    "doubtful": "a check of this result failed: no number of it is safe",
    "determined": "known within a factor of 2 either way, on average",
    "weakly determined": "known within a factor of 10 either way, on average, or closer but open at one end",
    "not determined": "the radiographs leave it open",
    "no interval": "nothing says how far to trust it",
}
"""What the badge of one stiffness says."""
ADVICE = {
    "trunk size": "measure the trunk’s breadth and depth",
    "force scale": "calibrate the gauge",
    "force offset": "zero the gauge before each push",
    "push direction": "measure the direction of the push",
    "push height": "mark the pushed point so that radiographs show it",
    "annotation": "have the vertebrae’s corners marked a second time",
    "source distance": "measure how far the tube is from the detector",
}
"""Unknowns of the variance budget that somebody can do something about, and what."""
WORTH = 0.95
"""Of a standard deviation: what is left of it is worth an effort."""
TICKS = tuple(digit * 10.0**power for power in range(-4, 5) for digit in (1.0, 3.0))


def clinician_content(visit: Visit, estimate: Estimate, assessment: Assessment, responses: Responses) -> dict[str, Any]:
    """Everything on the page but its pictures, in words."""
    record = visit.subject.record
    reading = rest_reading(visit.subject)
    person = [f"{record.age:g} years", record.sex, f"{record.height_cm:g} cm"]
    person += [] if record.mass_kg is None else [f"{record.mass_kg:g} kg"]
    told = told_stiffness(estimate)
    return {
        "id": record.id,
        "person": ", ".join(person),
        "curve": reading.words(),
        "pushes": [push_row(push, responses) for push in visit.subject.pushes[:MOST_PUSHES]],
        "more_pushes": _more(len(visit.subject.pushes) - MOST_PUSHES, "push", "pushes"),
        "beside": _beside(visit),
        "failed": shortened([f"{check.name}: {check.text}" for check in estimate.failed], MOST_FAILED),
        "stiffnesses": [stiffness(estimate, *one) for one in told[:MOST_STIFFNESSES]],
        "more_stiffnesses": _more(len(told) - MOST_STIFFNESSES, "stiffness", "stiffnesses"),
        "doubts": shortened(
            doubts(estimate, assessment, reading.warnings), MOST_BESIDE_FAILED if estimate.failed else MOST_DOUBTS
        ),
        "next": shortened(next_lines(visit, estimate), MOST_NEXT),
    }


def push_row(push: PushRecord, responses: Responses) -> dict[str, str]:
    """A push: where, with which forces, what for, and what the curve did."""
    uses = []
    for role, words in (("training", "for the estimate"), ("validation", "kept as a test")):
        forces = [force for force, own in zip(push.forces_n, push.roles) if own == role and force > 0.0]
        uses += [f"{listed(f'{force:g}' for force in forces)} N {words}"] if forces else []
    row = {
        "what": f"rib {push.level:g} from the {push.side}",
        "use": "; ".join(uses) or "not used",
        "change": "",
        "flexibility": "",
        "per_degree": "",
        "missing": "",
    }
    found = responses.pushes.get(push.id)
    if found is None or found.curve is None or found.flexibility is None:
        return row | {"missing": "not measured" if found is None else found.missing}
    curve = found.curve
    return row | {
        "change": f"{found.force_n:g} N: {change_words(curve.change_deg, curve.change_sd_deg, '–'.join(curve.levels))}",
        "flexibility": flexibility(found.flexibility),
        "per_degree": force_per_degree(curve),
    }


def _beside(visit: Visit) -> str:
    """What was seen beside frontal radiographs."""
    record = visit.subject.record
    views = dict.fromkeys(view.id for push in record.pushes for view in push.views)
    found = [f"radiographs of view “{name}”" for name in views]
    found += ["markers on the skin"] if any(push.markers for push in record.pushes) else []
    found += ["a scan of the skin"] if record.skin_scan else []
    return f"Beside frontal radiographs: {listed(found)}." if found else ""


def _more(count: int, one: str, many: str) -> str:
    return f"{counted(count, one, many)} more in the engineer’s part" if count > 0 else ""


def stiffness(
    estimate: Estimate, name: str, found: Quantity, unit: str, determined: Determination | None
) -> dict[str, Any]:
    """One stiffness: heading, sentence, badge and a picture of its interval."""
    title = stiffness_title(name)
    known = determined or found.determination
    interval = has_intervals(estimate) and found.low is not None
    badge = known_word(estimate, known) if interval or estimate.status == "DOUBTFUL" else "no interval"
    return {
        "title": title,
        "words": in_words(within_a_sentence(title), found, unit, known),
        "badge": badge,
        "meaning": MEANINGS[badge],
        "good": badge == "determined",
        "dot": known != "not determined",
        "strip": _strip(estimate, name, found),
        "unit": unit,
    }


def in_words(what: str, found: Quantity, unit: str, determined: Determination) -> str:
    """What is known of a stiffness, as sentences; a number alone only where the data determine it.

    Parameters
    ----------
    what : as a sentence names it, "lateral bending of a thoracic level".
    """
    low, high, value = found.low, found.high, estimated(found)
    if low is None or high is None:
        return f"{value} {unit}, without an interval."
    digits = digits_of(found)
    ends = f"between {number(low, digits)} and {number(high, digits)} {unit}"
    if found.open_low and found.open_high:
        return f"The radiographs do not fix {what}; anything that was allowed fits them, {ends}."
    if found.open_low:
        return f"At most {number(high, 2)} {unit}; the radiographs give no lower end."
    if found.open_high:
        return f"At least {number(low, 2)} {unit}; the radiographs give no upper end."
    if determined == "determined":
        return f"{value} {unit}, {ends}."
    if determined == "weakly determined":
        return f"{ends[0].upper()}{ends[1:]}; most probably {value}."
    return f"The radiographs do not fix {what}; {ends}."


def _strip(estimate: Estimate, name: str, found: Quantity) -> dict[str, Any] | None:
    """Places on a logarithmic axis over what was allowed, in percent of its width; None where that is not known."""
    scale = 1.0
    if isinstance(found, PlainStiffness):
        if found.ratio is None:
            return None
        scale = found.value / estimate.ratios[found.ratio].value
    if found.low is None or found.high is None:
        return None
    edges = [scale * bound for bound in estimate.bounds]

    def place(value: float) -> float:
        share = (math.log(value) - math.log(edges[0])) / (math.log(edges[1]) - math.log(edges[0]))
        return round(100.0 * min(max(share, 0.0), 1.0), 2)

    band = tuple(float(np.degrees(edge)) for edge in BENDING_BAND) if name == "lateral_bending_thoracic" else None
    return {
        "start": place(found.low),
        "end": place(found.high),
        "value": place(found.value),
        "open": [found.open_low, found.open_high],
        "ticks": [(place(tick), f"{tick:g}") for tick in TICKS if edges[0] <= tick <= edges[1]],
        "band": None if band is None else [place(edge) for edge in band],
        "band_text": "" if band is None else f"{band[0]:.0f} to {band[1]:.0f}",
    }


def doubts(estimate: Estimate, assessment: Assessment, warnings: Sequence[str]) -> list[str]:
    """What to distrust beside checks that failed, the gravest first.

    Parameters
    ----------
    warnings : of the Cobb angles at rest.
    """
    found = [] if estimate.fit_status == "CONVERGED" else [estimate.fit_status_text]
    vague = [
        stiffness_title(name)
        for name, one, _, known in told_stiffness(estimate)
        if has_intervals(estimate) and (known or one.determination) != "determined"
    ]
    if vague:
        found.append(f"take as a range, not as a number: {listed(f'“{title}”' for title in vague)}")
    if not has_intervals(estimate):
        found.append("this estimator has no intervals: nothing says how far its numbers may be off")
    found += [f"Cobb angle at rest: {warning}" for warning in warnings]
    found += _of_prediction(assessment)
    bending = bending_line(estimate)
    if bending is not None and bending["beside"]:
        reaches = "; the interval reaches them" if bending["reaches"] else ""
        found.append(
            f"{PLAIN['lateral_bending_thoracic']} comes out {bending['beside']} cadaver segments "
            f"({bending['band_rad']} N m/rad){reaches}: a standing trunk under small forces is not a segment on a bench"
        )
    return found + list(dict.fromkeys((*estimate.notes, *assessment.notes)))


def _of_prediction(assessment: Assessment) -> list[str]:
    found = comparison_content(assessment)
    if not found["frames"]:
        return ["no radiograph was kept as a test: the prediction is untested"]
    if found["verdict"] in ("worse", "equal"):
        than = "better" if found["verdict"] == "worse" else "as well"
        return [
            f"a simpler predictor does {than} on the test radiographs (“{found['rival']}”, {found['rival_error']} mm; "
            f"the estimate {found['predicted']} mm): this proves no stiffness"
        ]
    return []


def next_lines(visit: Visit, estimate: Estimate) -> list[str]:
    """What to do next: by the plan, if there is one of this estimate, and what is worth measuring."""
    found = []
    if estimate.failed:
        found.append("look for the mistakes named above first, and run again")
    found += _planned(visit)
    found += [advice for name in estimate.parameters if (advice := _worth_measuring(estimate, name))]
    return found


def _worth_measuring(estimate: Estimate, name: str) -> str:
    """What somebody can measure that makes a ratio known clearly better, and how well it would be known if the
    measurement were exact; nothing where it is determined."""
    rows = [row for row in estimate.budget if row.name in ADVICE]
    best = min(rows, key=lambda row: row.without[name], default=None)
    now = estimate.sd_log.get(name, 0.0)
    if best is None or estimate.ratios[name].determined == "determined" or best.without[name] > WORTH * now:
        return ""
    return (
        f"{ADVICE[best.name]}: {within_a_sentence(ratio_title(name))} would be known within a factor of "
        f"{factor95(best.without[name])} at best, in place of {factor95(now)}"
    )


def _planned(visit: Visit) -> list[str]:
    if not visit.file(Plan.FILE).is_file():
        return [
            "no further push was planned: “spinestiff plan” proposes side, rib, force and view, and says when further "
            "radiographs no longer pay"
        ]
    if not is_unchanged(visit.subject, Plan.STEP):
        return [f"the plan that is there is out of date and not shown: {stale_plan(visit)}"]
    plan = read_outcome(visit.subject, Plan)
    worth = pays(plan)
    if not worth:
        return [NONE_PAYS]
    best, now = plan.sequence[0].push, now_of(plan)
    until = "" if now is None else f" instead of {width(plan, now).removeprefix('within ')}"
    lines = [
        f"push rib {best.level:g} from the {best.side} with {best.force_n:g} N, {VIEW_WORDS[best.view]}, and once "
        f"without force: {TITLES[plan.target]} would be known {width(plan, size_of(best))}{until}"
    ]
    if len(worth) < len(plan.sequence):
        lines.append(f"further radiographs hardly narrow it after {counted(worth[-1].exposures, 'exposure')}")
    return lines


def shortened(items: Sequence[str], most: int) -> list[str]:
    """At most so many items as sentences, long ones cut at a word; the last says how many were left out."""
    left = len(items) - most
    shown = items if left <= 0 else items[: most - 1]
    found = [f"{text[0].upper()}{text[1:]}." for text in (_cut(one) for one in shown)]
    return found if left <= 0 else [*found, f"{counted(left + 1, 'more point')} in the engineer’s part."]


def _cut(text: str) -> str:
    """At the end of a sentence or of a part of one, where that leaves most of what there is room for."""
    text = text.rstrip(".")
    if len(text) <= LONGEST:
        return text
    head = text[:LONGEST]
    end = max(head.rfind(mark) for mark in (". ", "; "))
    return f"{head[:end] if end > LONGEST // 4 else head.rsplit(' ', 1)[0]} … (whole in the engineer’s part)"


def other_ends(responses: Responses, push: str, drawn: tuple[str, str]) -> str:
    """What a caption says, after a space, where a push's row of the table is of other end vertebrae than ``drawn``."""
    found = responses.pushes.get(push)
    if found is None or found.curve is None or found.curve.levels == drawn:
        return ""
    whose = "those of the radiograph at rest, " if found.instead_of is None else ""
    return f" The pictures keep these end vertebrae; the table keeps {whose}{'–'.join(found.curve.levels)}."


def picture_words(kind: str, force_n: float, change: str, error_mm: float | None, moved_mm: float | None) -> str:
    """What stands below a picture of the pushed spine: "pushed", or "predicted" or "fitted" by the model."""
    if kind == "pushed":
        return f"Pushed with {force_n:g} N. Cobb angle changed by {change}."
    if kind == "predicted":
        words = f"Drawn: the estimate, which has not seen this radiograph. Expected change: {change}."
    else:
        words = f"Drawn: the estimate, fitted to this radiograph. It changes by {change}."
    if error_mm is None or moved_mm is None:
        return words
    return f"{words} Vertebra corners {fixed(error_mm)} mm off (RMS); the push moved them by {fixed(moved_mm)} mm."
