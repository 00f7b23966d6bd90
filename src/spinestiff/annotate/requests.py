"""What the page may send, checked before anything is done with it, and what it is told."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import Field

from spinestiff.annotate.draft import Corners, Draft, DraftImage, Points
from spinestiff.annotate.judging import Judged
from spinestiff.curves.cobb import REGIONS, CobbReading, Curve
from spinestiff.loopback.asking import Sent
from spinestiff.subject.records import VertebraName


class Save(Sent):
    """All marks of the folder, made on revision ``revision``."""

    revision: Annotated[str, Field(max_length=64)]
    draft: Draft


class Judge(Sent):
    """Marks of one image, to be judged but not saved."""

    image: str
    marks: DraftImage


class Propose(Sent):
    """Points along the spine of a frame, head to foot: the first in ``upper``, the last in ``lower``.

    ``kept`` are vertebrae that stay as they are and guide the others.
    """

    image: str
    frame: Annotated[int, Field(ge=0)]
    points: Points
    upper: VertebraName
    lower: VertebraName
    kept: dict[VertebraName, Corners] = Field(default_factory=dict)


class Track(Sent):
    """Follow a push from the annotated frames that the session holds."""

    image: str


class Import(Sent):
    """A file's name, of which its end alone counts, its text, and the image in sight."""

    name: Annotated[str, Field(max_length=1000)]
    text: str
    image: str


def judged_record(judged: Judged) -> dict[str, Any]:
    """As JSON."""
    reading = judged.cobb
    curves = [] if reading is None else [_curve_record(reading, curve) for curve in reading.curves]
    largest = None if reading is None or reading.largest is None else _curve_record(reading, reading.largest)
    return {"vertebrae": judged.vertebrae, "problem": judged.problem, "cobb": largest, "curves": curves}


def _curve_record(reading: CobbReading, curve: Curve) -> dict[str, Any]:
    return {
        "upper": curve.angle.upper,
        "lower": curve.angle.lower,
        "region": REGIONS[curve.region][1],
        "words": reading.words(curve),
    }
