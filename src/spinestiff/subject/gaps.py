"""What ``subject.json`` does not know yet: ``null`` where a step needs a value, named a line each.

Such a file is no subject for a step. What only looks at radiographs (annotation, inspection) reads it with stand-ins,
and never shows one.
"""

from __future__ import annotations

import copy
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from pydantic import ValidationError

from spinestiff.files import read_text
from spinestiff.formats import parse_json
from spinestiff.subject.record_reading import complaints_of, parse_record
from spinestiff.subject.records import (
    DISTANCES_MM,
    GAUGE_LIMIT_N,
    HEAVIEST_KG,
    HEIGHTS_CM,
    LEVELS,
    OLDEST,
    SUBJECT_FILE,
    SubjectRecord,
)

_MM = f"mm ({DISTANCES_MM[0]:g} to {DISTANCES_MM[1]:g})"
PERSON: Final = {
    "age": f"age in years (above 0, at most {OLDEST:g})",
    "sex": "female or male",
    "height_cm": f"standing height in cm ({HEIGHTS_CM[0]:g} to {HEIGHTS_CM[1]:g})",
}
PUSH: Final = {
    "side": "the patient's side that was pushed (left or right)",
    "level": f"the rib that was pushed ({LEVELS[0]:g} to {LEVELS[1]:g}; 8.5 lies between two)",
    "d21_mm": f"vertical distance from the shoulder support to the pelvis support in {_MM}",
    "d31_mm": f"vertical distance from the shoulder support to the push in {_MM}, below d21_mm",
}
FORCE: Final = f"force on the ribs in N (0 to {GAUGE_LIMIT_N:g})"
FOR_DEAD_LOADS: Final = ("d21_mm", "d31_mm")
"""Of a push, what only a pelvis with "dead-loads" needs."""
OPTIONS: Final = {
    "age": "--age", "sex": "--sex", "height_cm": "--height", "side": "--side", "level": "--level", "d21_mm": "--d21",
    "d31_mm": "--d31", "forces_n": "--log",
}  # fmt: skip
"""Option of ``spinestiff init`` that gives a value."""
# They pass the schema beside any value that can be given; nothing computes with them.
_STAND_INS: Final[dict[str, Any]] = {
    "age": 13.0, "sex": "female", "height_cm": 150.0, "side": "right", "level": 8.0, "d21_mm": DISTANCES_MM[1],
    "d31_mm": DISTANCES_MM[0],
}  # fmt: skip


@dataclass(frozen=True)
class Gap:
    """A value that is not known yet.

    Attributes
    ----------
    field : where it belongs in ``subject.json``.
    key : its name there.
    words : what it is, and what is allowed.
    push : its push, counted from 0; None: the person's.
    frames : for forces, which frames.
    """

    field: str
    key: str
    words: str
    push: int | None = None
    frames: tuple[int, ...] = ()

    @property
    def line(self) -> str:
        """What is missing, and what to do."""
        alike = ", which counts for all pushes that lack it" if self.key in PUSH else ""
        option = f"{OPTIONS[self.key]} to spinestiff init{alike}"
        return f"{self.field} is missing: {self.words}; write it there, or give {option}"

    @property
    def line_by_hand(self) -> str:
        """The same of forces that a log, which tells others, does not."""
        return f"{self.field} is missing: {self.words}; write it there"

    @property
    def line_beside_log(self) -> str:
        """The same of forces for which there is a log that could not be put beside the frames."""
        return (
            f"{self.field} is missing: {self.words}; write it there, or give --log again with --log-offset to "
            "spinestiff init: where the log begins is not determined"
        )


def read_open_record(path: Path) -> tuple[SubjectRecord, tuple[Gap, ...]]:
    """``subject.json``, complete or not, and what is not known yet.

    Where there are gaps, the record has stand-ins in those places, no roles and markers if a force is missing, and no
    mass without a height.

    Raises
    ------
    SubjectError : anything else that the schema does not allow.
    """
    text = read_text(path)
    data = parse_json(text, str(path))
    gaps = gaps_of(data)
    if not gaps:
        return parse_record(text, str(path), SubjectRecord), ()
    return parse_record(json.dumps(_filled(data)), str(path), SubjectRecord), gaps


def gaps_of(data: Any) -> tuple[Gap, ...]:
    """What a subject's JSON does not know yet, in the order of the schema."""
    if not isinstance(data, dict):
        return ()
    found = [Gap(key, key, words) for key, words in PERSON.items() if _open(data, key)]
    for number, push in enumerate(_pushes(data)):
        where = f"pushes[{number}]"
        found += [Gap(f"{where}.{key}", key, words, number) for key, words in PUSH.items() if _lacks(data, push, key)]
        forces = push.get("forces_n")
        if isinstance(forces, list):
            for frames in _runs([i for i, force in enumerate(forces) if force is None]):
                span = str(frames[0]) if len(frames) == 1 else f"{frames[0]} to {frames[-1]}"
                found.append(Gap(f"{where}.forces_n[{span}]", "forces_n", FORCE, number, frames))
    return tuple(found)


def open_frames(gaps: Sequence[Gap], push: int) -> frozenset[int]:
    """Frames of a push, counted from 0, whose force is not known yet."""
    return frozenset(frame for gap in gaps if gap.push == push for frame in gap.frames)


def _open(data: dict[str, Any], key: str) -> bool:
    return key in data and data[key] is None


def _lacks(data: dict[str, Any], push: dict[str, Any], key: str) -> bool:
    """Whether a push of a subject's JSON does not know what a step needs."""
    return _open(push, key) and (key not in FOR_DEAD_LOADS or data.get("pelvis") == "dead-loads")


def _pushes(data: dict[str, Any]) -> list[dict[str, Any]]:
    pushes = data.get("pushes")
    return [push for push in pushes if isinstance(push, dict)] if isinstance(pushes, list) else []


def _runs(numbers: list[int]) -> list[tuple[int, ...]]:
    """Whole numbers in order, those that follow each other together."""
    runs: list[tuple[int, ...]] = []
    for number in numbers:
        if runs and number == runs[-1][-1] + 1:
            runs[-1] += (number,)
        else:
            runs.append((number,))
    return runs


def _filled(data: dict[str, Any]) -> dict[str, Any]:
    filled = copy.deepcopy(data)
    pushes = _pushes(filled)
    for one in (filled, *pushes):
        for key, value in _STAND_INS.items():
            if _lacks(filled, one, key):
                one[key] = value
    mass: Any = filled.get("mass_kg")
    if _open(data, "height_cm") and type(mass) in (int, float) and 0.0 < mass <= HEAVIEST_KG:
        # A mass is judged by the height.
        del filled["mass_kg"]
    lacking = [push for push in pushes if isinstance(push.get("forces_n"), list) and None in push["forces_n"]]
    for push in lacking:
        push["forces_n"] = [0.0 if force is None else force for force in push["forces_n"]]
        push.pop("markers", None)
    for push in pushes if lacking else ():
        # Roles are judged by forces, those of all pushes together.
        push.pop("roles", None)
    return filled


def check_open_record(data: dict[str, Any]) -> None:
    """Raise SubjectError for what the schema allows neither as it is nor for want of a value."""
    parse_record(json.dumps(_filled(data)), SUBJECT_FILE, SubjectRecord)


def open_complaints(data: dict[str, Any]) -> list[tuple[str, str]]:
    """What the schema does not allow in a record with gaps: each field and what is wrong with it."""
    try:
        SubjectRecord.model_validate_json(json.dumps(_filled(data)))
    except ValidationError as error:
        return complaints_of(error, SubjectRecord)
    return []
