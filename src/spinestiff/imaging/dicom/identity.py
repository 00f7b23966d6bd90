"""Whose radiograph a file holds and on which day it was taken: hashes and day numbers that stay in this process."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from spinestiff.imaging.dicom.files import one_clear_line, read_tags_only
from spinestiff.imaging.dicom.person_tags import identity_tags

if TYPE_CHECKING:
    from pydicom.dataset import Dataset


@dataclass(frozen=True)
class Identity:
    """A file's patient and day, only to be compared with another file's; never written and never shown.

    Attributes
    ----------
    marks : hash of the patient's number, hash of name and date of birth; "" for what the file does not tell.
    day : of the exposure, counted from the year 1; None if the file does not tell.
    removed : the file says that its patient was taken out, so that marks and days may be anybody's.
    """

    marks: tuple[str, str]
    day: int | None
    removed: bool

    def __repr__(self) -> str:
        return "Identity(...)"

    def is_of(self, other: Identity) -> bool | None:
        """Whether both are of one patient; None if they don't tell."""
        if self.removed or other.removed:
            return None
        pairs = [(a, b) for a, b in zip(self.marks, other.marks) if a and b]
        return any(a == b for a, b in pairs) if pairs else None

    def may_be_of(self, other: Identity) -> bool:
        """Whether both may be put together: they are of one patient, or don't tell and have the same number, or none.
        Where patients were taken out, pseudonyms stand for numbers.
        """
        same = self.is_of(other)
        return self.marks[0] == other.marks[0] if same is None else same

    def days_from(self, other: Identity) -> int | None:
        """Days between both exposures; None if they don't tell."""
        if self.removed or other.removed or self.day is None or other.day is None:
            return None
        return abs(self.day - other.day)


def identity_of(dataset: Dataset) -> Identity:
    """The identity in a dataset; what can't be read tells nothing, but for PatientID. Raises RadiographError."""
    return Identity(*identity_tags(dataset))


def read_identity(path: Path) -> Identity:
    """The identity in a file.

    Raises
    ------
    RadiographError : the file can't be read; the line holds its name and nothing of the patient.
    """
    with one_clear_line(path.name):
        return identity_of(read_tags_only(path))
