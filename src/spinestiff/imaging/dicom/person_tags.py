"""Tags of whose picture a file holds and what it is of, as plain Python values; the patient's own are hashed."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

from spinestiff.imaging.dicom.ordering import DAY_S
from spinestiff.imaging.dicom.tags import clock_of, hash_of, hashed, ordinal, told

if TYPE_CHECKING:
    from pydicom.dataset import Dataset


def identity_tags(dataset: Dataset) -> tuple[tuple[str, str], int | None, bool]:
    """For ``identity.Identity``: hashes of the patient's number and of name with birth date, the day, whether the
    patient was taken out."""
    name, birth = plain_name(told(dataset, "PatientName")), told(dataset, "PatientBirthDate").replace(".", "")
    person = hash_of(f"{name}\0{birth}") if name and birth else ""
    removed = told(dataset, "PatientIdentityRemoved").upper() == "YES"
    return (hashed(dataset, "PatientID"), person), _day(told(dataset, key) for key in _DAYS), removed


def plain_name(name: str) -> str:
    """A person's name however it was written: Doe ^Jane^^^ is doe^jane (DICOM PS3.5, 6.2.1)."""
    groups = ("^".join(part.strip() for part in group.split("^")).rstrip("^") for group in name.casefold().split("="))
    return "=".join(groups).rstrip("=")


_DAYS = ("AcquisitionDateTime", "AcquisitionDate", "ContentDate", "SeriesDate", "StudyDate")


def _day(dates: Iterable[str]) -> int | None:
    """The first that is one, as days since the year 1."""
    return next((day for date in dates if (day := ordinal(date.replace(".", "").strip()[:8])) is not None), None)


@dataclass(frozen=True)
class ExportTags:
    """What a file of an export tells beside its picture; a value that can't be read counts as not told.

    Attributes
    ----------
    study, series : hashes, only to be compared; "" if not told.
    moment : s of the exposure since the year 1, or since midnight; None if not told.
    view : what the words of the series call it, "frontal" or "lateral"; None if nothing, or both.
    use : the same, "rest", "push" or "bending", a film of the patient bending to a side.
    age, age_source : years and the field that tells them. sex : "female" or "male".
    day : of the exposure, since the year 1; None if not told.
    description : of the study, in one line; to be shown to whoever chooses one, and kept nowhere.
    """

    study: str = ""
    series: str = ""
    moment: float | None = None
    view: str | None = None
    use: str | None = None
    age: float | None = None
    age_source: str = ""
    sex: str | None = None
    day: int | None = None
    description: str = ""


# Words by which series are named, in a few languages; whole words, dots taken out.
_FRONTAL = frozenset({"ap", "pa", "frontal", "front", "coronal", "koronar", "anteroposterior", "posteroanterior"})
_LATERAL = frozenset(
    {"lat", "lateral", "ll", "rl", "sagittal", "seitlich", "seitl", "sag", "profil", "profile", "perfil"}
)
_REST = frozenset({"rest", "standing", "stehend", "neutral", "unloaded", "upright", "ruhe", "repos", "baseline"})
_BENDING = frozenset({"bending", "bend", "seitneigung"})
_PUSH = frozenset({"push", "pushed", "pushing", "force", "load", "loaded", "druck", "kraft", "newton"})
_AGE_UNITS = {"Y": 1.0, "M": 1.0 / 12.0, "W": 7.0 / 365.25, "D": 1.0 / 365.25}


def export_tags(dataset: Dataset) -> ExportTags:
    """What a file of an export tells beside its picture."""
    words = _words(dataset)
    # A lateral bending is a frontal picture.
    sideways = bool(words & _LATERAL) and not words & _BENDING
    view = _either("frontal", bool(words & _FRONTAL), "lateral", sideways)
    use = _either("rest", bool(words & _REST), "push", bool(words & _PUSH))
    if words & _BENDING and not words & _PUSH:
        use = _either("rest", bool(words & _REST), "bending", True)
    age, source = _age(dataset)
    sex = {"F": "female", "M": "male"}.get(told(dataset, "PatientSex").upper())
    study, series = (told(dataset, key) for key in ("StudyInstanceUID", "SeriesInstanceUID"))
    return ExportTags(
        hash_of(study) if study else "",
        hash_of(series) if series else "",
        _moment(dataset),
        view,
        use,
        age,
        source,
        sex,
        _day(told(dataset, key) for key in _DAYS),
        _line(told(dataset, "StudyDescription")),
    )


def _line(text: str) -> str:
    """A free text without what is no letter, at most as long as such a field may be."""
    return " ".join("".join(letter if letter.isprintable() else " " for letter in text).split())[:64]


def _either(one: str, is_one: bool, other: str, is_other: bool) -> str | None:
    """What is told, if it is told alone."""
    if is_one == is_other:
        return None
    return one if is_one else other


def _words(dataset: Dataset) -> set[str]:
    text = " ".join(told(dataset, key) for key in ("SeriesDescription", "ProtocolName", "ViewPosition"))
    return set(re.findall(r"[^\W\d_]+", text.casefold().replace(".", "")))


def _moment(dataset: Dataset) -> float | None:
    clocks = (clock_of(partial(told, dataset), what) for what in ("Acquisition", "Content", "Series"))
    clock = next((clock for clock in clocks if clock is not None), None)
    if clock is None or clock >= DAY_S:
        return clock
    return clock + DAY_S * (_day(told(dataset, key) for key in _DAYS) or 0)


def _age(dataset: Dataset) -> tuple[float | None, str]:
    birth, day = ordinal(told(dataset, "PatientBirthDate")), _day(told(dataset, key) for key in _DAYS)
    if birth is not None and day is not None and 0 < day - birth <= 120 * 365:
        return int(10.0 * (day - birth) / 365.25) / 10.0, "PatientBirthDate and the day of the exposure"
    found = re.fullmatch(r"(\d{1,3})([YMWD])", told(dataset, "PatientAge").upper())
    years = 0.0 if found is None else round(int(found[1]) * _AGE_UNITS[found[2]], 1)
    return (years, "PatientAge") if 0.0 < years <= 120.0 else (None, "")
