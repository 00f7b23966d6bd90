"""Whose something in the trash was: the name of the subject's folder, and the subject's id, by which another subject
that took this name later is told apart."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from spinestiff.errors import SubjectError
from spinestiff.files import read_json
from spinestiff.subject.records import SUBJECT_FILE


@dataclass(frozen=True)
class Owner:
    """A subject: the name of its folder, and its ``id`` in ``subject.json``; None if it had none, or it was not kept.

    Raises
    ------
    SubjectError : no name of a folder.
    """

    subject: str
    id: str | None = None

    def __post_init__(self) -> None:
        if not self.subject or Path(self.subject).name != self.subject:
            raise SubjectError(f"{self.subject!r}: no name of a folder")

    @classmethod
    def of(cls, folder: Path) -> Owner:
        """Raises SubjectError where ``subject.json`` can't be read."""
        record = read_json(folder / SUBJECT_FILE)
        if not isinstance(record, dict):
            raise SubjectError(f"{SUBJECT_FILE}: wanted an object")
        return cls(folder.name, record.get("id"))

    @classmethod
    def of_record(cls, record: Mapping[str, Any]) -> Owner:
        """Raises KeyError, TypeError or SubjectError for a record that is not one of ``record``."""
        return cls(str(record["subject"]), record.get("id"))

    @property
    def record(self) -> dict[str, Any]:
        """As JSON."""
        return asdict(self)

    def require(self, folder: Path) -> None:
        """Raise SubjectError unless the subject in ``folder`` is this one, as far as can be told."""
        standing = Owner.of(folder)
        if self.id is not None and standing.id != self.id:
            raise SubjectError(
                f"the subject {self.subject} that is there has the id '{standing.id}', and this was taken from "
                f"'{self.id}'; put that one back, or give its id back"
            )
