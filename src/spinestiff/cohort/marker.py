"""What vouches for a participant's results: the marker, and what is found where results should be.

The marker holds the hashes of all that the results were made from (inputs, settings, runner, version), and their own.
It is the last file that is written into them, before they are published as a whole.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, ValidationError

from spinestiff.cohort.places import DONE_FILE, Place, digests_of, input_files
from spinestiff.errors import SubjectError
from spinestiff.files import read_text, regular_files, trouble
from spinestiff.formats import json_text, parse_json

State = Literal["missing", "damaged", "out of date", "current"]


class CohortRecord(BaseModel):
    """What every record of a cohort is: frozen, without unknown keys, without NaN."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Order(CohortRecord):
    """What is asked for each participant.

    Attributes
    ----------
    runner : the function that makes results, "module:name".
    settings : what it is asked, as JSON.
    version : of this program, with a hash of its sources.
    """

    runner: str
    settings: dict[str, Any]
    version: str


class Marker(CohortRecord):
    """``done.json``.

    Attributes
    ----------
    digest : of order and inputs. inputs, outputs : SHA-256 by path in the subject folder, in the results.
    """

    schema_version: Literal[1] = 1
    participant: str
    digest: str
    order: Order
    inputs: dict[str, str]
    outputs: dict[str, str]


@dataclass(frozen=True)
class Found:
    """What lies where a participant's results should be.

    Attributes
    ----------
    marker : of results that are whole; None of what is missing or damaged.
    words : what is wrong with them, half a sentence.
    """

    state: State
    marker: Marker | None = None
    words: str = ""


def digest_of(participant: str, order: Order, inputs: Mapping[str, str]) -> str:
    """One hash of all that a participant's results depend on."""
    parts = {"participant": participant, "order": order.model_dump(mode="json"), "inputs": dict(inputs)}
    return hashlib.sha256(json_text(parts).encode()).hexdigest()


def whole_results(place: Place) -> Found:
    """Whether the published results are as their run left them, file by file; what they were made from is not asked.

    A state "current" only says that they are whole.
    """
    try:
        if not place.results.exists() and not place.results.is_symlink():
            return Found("missing", words="has no results")
    except OSError as problem:
        return Found("damaged", words=f"{place.results} can't be read ({trouble(problem)})")
    if place.results.is_symlink() or not place.results.is_dir():
        return Found("damaged", words=f"{place.results} is no folder")
    try:
        text = read_text(place.marker)
        parse_json(text, DONE_FILE)
        marker = Marker.model_validate_json(text, strict=True)
        there = {
            path.relative_to(place.results).as_posix(): path for path in regular_files(place.results, SubjectError)
        }
        there.pop(DONE_FILE, None)
        found = digests_of(there)
    except (SubjectError, ValidationError):
        return Found(
            "damaged", words=f"{place.results} has no readable {DONE_FILE}, or holds something that is no file"
        )
    if marker.participant != place.participant:
        return Found("damaged", words=f"{place.results} are results of '{marker.participant}'")
    for name in sorted(found.keys() | marker.outputs.keys()):
        if found.get(name) != marker.outputs.get(name):
            return Found("damaged", words=f"{place.results / name} is not as its run left it")
    return Found("current", marker)


def examine(place: Place, order: Order) -> Found:
    """What lies where a participant's results should be, and whether it is what would be made now.

    Inputs that can't be read count as changed: the run that follows says what is wrong with them.
    """
    found = whole_results(place)
    if found.marker is None:
        return found
    if found.marker.order != order:
        return Found("out of date", found.marker, "was made with other settings or by another version")
    return found if _same_inputs(place, found.marker) else _changed(found.marker)


def examine_inputs(place: Place) -> Found:
    """As ``examine``, whatever was asked of the run."""
    found = whole_results(place)
    if found.marker is None or _same_inputs(place, found.marker):
        return found
    return _changed(found.marker)


def _changed(marker: Marker) -> Found:
    return Found("out of date", marker, "was made before its inputs changed")


def _same_inputs(place: Place, marker: Marker) -> bool:
    try:
        return digests_of(input_files(place.source)) == marker.inputs
    except SubjectError:
        return False
