"""Cobb angles as a CSV, one row a curve: what ``spinestiff cobb --csv`` writes."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence

from spinestiff.curves.changes import forms_in_words
from spinestiff.curves.cobb import REGIONS, Curve
from spinestiff.curves.corner_csv import guarded
from spinestiff.curves.pushes import CobbFrame
from spinestiff.curves.tilts import Forms
from spinestiff.normal import HALF_WIDTH_95

COLUMNS = (
    "image", "status", "definition", "largest", "degrees", "half_width95", "upper_level", "lower_level", "apex",
    "region", "convexity", "words",
)  # fmt: skip
"""``half_width95``: half the width of the angle's 95 % interval. ``words``: as every table and the report say it."""
CHANGES = tuple(f"{form}_{what}" for form in Forms._fields for what in ("change", "half_width95", "words"))
"""Of a push's frames: each form of the change from the least force, degrees, left-convex above 0."""


def angles_csv(frames: Sequence[CobbFrame]) -> str:
    """All curves of all images, the largest of each with the image's change; of a refused image its reason."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow((*COLUMNS, *CHANGES))
    for frame in frames:
        reading = frame.reading
        head = (guarded(reading.image), reading.status, reading.definition)
        if reading.largest is None:
            writer.writerow((*head, *[""] * (len(COLUMNS) - 4), reading.words(), *[""] * len(CHANGES)))
        for curve in reading.curves:
            largest = curve is reading.largest
            changes = _changes(frame) if largest else [""] * len(CHANGES)
            writer.writerow((*head, "yes" if largest else "no", *_curve(frame, curve), *changes))
    return stream.getvalue()


def _curve(frame: CobbFrame, curve: Curve) -> tuple[str, ...]:
    angle, reading = curve.angle, frame.reading
    sizes = (f"{abs(angle.degrees):.2f}", f"{curve.half_width_deg:.2f}")
    region = REGIONS[curve.region][1]
    return (*sizes, angle.upper, angle.lower, curve.apex, region, reading.convexity(curve), reading.words(curve))


def _changes(frame: CobbFrame) -> list[str]:
    change = frame.change
    if change is None:
        return [""] * len(CHANGES)
    cells = []
    for form, sd, words in zip(Forms._fields, change.sds, forms_in_words(change).values()):
        cells += [f"{getattr(change, form):.2f}", "" if sd is None else f"{HALF_WIDTH_95 * sd:.2f}", words]
    return cells
