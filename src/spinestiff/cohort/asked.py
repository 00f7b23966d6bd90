"""What is asked of a cohort's run, and what it tells: the cohort, limits, news of a participant, what came of all."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from spinestiff.cohort.marker import Order
from spinestiff.cohort.worker import Task
from spinestiff.errors import OptionError, SubjectError
from spinestiff.formats import encodable

STATM = Path("/proc/self/statm")
"""There where the system tells how much memory a process takes."""
Stage = Literal["up to date", "waiting", "running", "again", "done", "failed"]


@dataclass(frozen=True)
class Limits:
    """What one participant may take: wall-clock seconds and resident memory, MB (2^20 bytes); None = no limit."""

    seconds: float | None = None
    memory_mb: float | None = None

    def __post_init__(self) -> None:
        if self.memory_mb is not None and not STATM.exists():
            raise OptionError("--memory: the memory of a process is not told by this system; leave the option out")


@dataclass(frozen=True)
class News:
    """What has become of a participant.

    Attributes
    ----------
    words : the step that it is at, or why it failed. seconds : that its try took.
    """

    participant: str
    stage: Stage
    words: str = ""
    seconds: float = 0.0


@dataclass(frozen=True)
class Summary:
    """What became of the participants, by name, in their order; of those that failed with the reason."""

    up_to_date: tuple[str, ...]
    done: tuple[str, ...]
    failed: dict[str, str]


OnNews = Callable[[News], None]


def silent(one: News) -> None:
    """Tells nobody."""


@dataclass(frozen=True)
class Cohort:
    """A cohort to run.

    Attributes
    ----------
    source : folder with ``participants.tsv`` and a subject folder each. target : where all results go.
    participants : in order. order : what is asked for each.
    """

    source: Path
    target: Path
    participants: tuple[str, ...]
    order: Order

    def __post_init__(self) -> None:
        inside = self.target.resolve().is_relative_to(self.source.resolve())
        if inside or self.source.resolve().is_relative_to(self.target.resolve()):
            raise SubjectError(f"{self.target}: lies in {self.source}, or around it; wanted two folders apart")
        for folder in (self.source, self.target):
            # Both are told to processes and to workers as JSON.
            if encodable(str(folder)) != str(folder):
                raise SubjectError(f"{folder}: a name that is no UTF-8; rename the folder")

    def task(self, participant: str) -> Task:
        """What is asked for one of them."""
        return Task(participant=participant, source=str(self.source), target=str(self.target), order=self.order)
