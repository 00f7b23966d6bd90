"""Whose pictures, and when: the patients and days of all files agree."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import combinations

from spinestiff.imaging.dicom.identity import Identity
from spinestiff.study.judgement.limits import Limits
from spinestiff.study.judgement.verdict import check, impossible
from spinestiff.subject.estimate_outcome import Check


def identity(identities: Mapping[str, Identity], limits: Limits) -> Iterator[Check]:
    """Files are compared pair by pair; nothing that stands in them is said."""
    pairs = list(combinations(identities, 2))
    same = {pair: identities[pair[0]].is_of(identities[pair[1]]) for pair in pairs}
    yield _by_files(
        "same patient",
        {pair: not found for pair, found in same.items() if found is not None},
        len(pairs),
        ("the files name the same patient", "name different patients"),
        "a radiograph in the wrong folder, then for a patient registered twice",
        "a file names no patient, or its patient was taken out",
    )
    days = {pair: identities[pair[0]].days_from(identities[pair[1]]) for pair in pairs}
    most = limits.days_apart
    yield _by_files(
        "same visit",
        {pair: apart > most for pair, apart in days.items() if apart is not None},
        len(pairs),
        (f"the pictures were taken within {most} days", f"were taken more than {most} days apart"),
        "pictures of another visit, then for a wrong date in the X-ray system",
        "a file has no date, or its patient was taken out",
    )


def _by_files(
    name: str, differ: Mapping[tuple[str, str], bool], pairs: int, said: tuple[str, str], look_for: str, missing: str
) -> Check:
    """``differ`` holds the pairs that could be compared; ``said`` is for pairs that agree, and for one that differs."""
    wrong = next((pair for pair, different in differ.items() if different), None)
    if wrong is not None:
        return check(name, f"{wrong[0]} and {wrong[1]} {said[1]}", None, None, False, look_for)
    if not pairs or len(differ) < pairs:
        return impossible(name, missing)
    return check(name, said[0], None, None, True, look_for)
