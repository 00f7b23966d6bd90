"""What a subject's results show: pages and pictures by name, never by path, and what stands in them as numbers."""

from __future__ import annotations

import secrets
import threading
import time
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from spinestiff.errors import NotThere, SpinestiffError, SubjectError
from spinestiff.files import regular_file
from spinestiff.study.runner import ROLES
from spinestiff.study.wording.parameters import parameter_lines
from spinestiff.study.wording.plan import plan_lines
from spinestiff.subject.folder import Subject, read_annotation, read_unannotated
from spinestiff.subject.parameters_outcome import ParameterStudy
from spinestiff.subject.plan_outcome import Plan
from spinestiff.subject.records import ANNOTATION_FILE, RESULTS
from spinestiff.subject.run_record import changed_inputs, changed_outputs, read_outcome, recorded_steps
from spinestiff.words import sentence
from spinestiff.workbench.cards import in_words, result, stale

PAGES = {
    "report.html": "Report",
    "view.html": "Torso in 3D",
    "protocol.html": "Sheet for the next push",
}
PICTURES = {
    "plan.png": ("plan", "The next push"),
    "sensitivity.png": ("sensitivity", "If something had been otherwise"),
    "frames.png": ("frames", "Quality of the frames"),
}
"""Each with the step that draws it."""
NOT_SHOWN = {"frames": {ROLES}}
"""What a step is made from and its picture does not show: proposed roles hold when they are taken, too."""
TYPES = {".html": "text/html; charset=utf-8", ".png": "image/png"}
LARGEST = 200 * 2**20
TICKET_S, MOST_TICKETS = 12 * 3600.0, 500


def result_file(folder: Path, name: str) -> Path:
    """A page or picture of a subject.

    Raises
    ------
    NotThere : no such name, or the subject has none. SubjectError : it leads out of the folder, or is no file.
    """
    if name not in PAGES and name not in PICTURES:
        raise NotThere("there is no such page")
    path = folder / RESULTS / name
    if not path.exists():
        raise NotThere("this page is not there yet; run the step that makes it")
    regular_file(path, SubjectError, within=folder, cap_bytes=LARGEST, name=name)
    return path


def results_record(folder: Path) -> dict[str, Any]:
    """What a subject's results are, as JSON; without what has changed since of pictures and parameters."""
    subject = read_unannotated(folder)
    pictures = [
        {"name": name, "title": title}
        for name, (step, title) in PICTURES.items()
        if _is_there(folder, name) and _is_current(subject, step)
    ]
    return {
        "pages": [{"name": name, "title": title} for name, title in PAGES.items() if _is_there(folder, name)],
        "pictures": pictures,
        "result": result(subject),
        "plan": _plan(subject),
        "plan_stale": _plan_stale(subject),
        "parameters": _parameters(subject),
        "stale": _stale(subject),
    }


def _is_there(folder: Path, name: str) -> bool:
    try:
        result_file(folder, name)
    except SpinestiffError:
        return False
    return True


def _is_current(subject: Subject, step: str) -> bool:
    """Whether what is shown of a step is of what is there now."""
    annotated = _as_annotated(subject)
    try:
        changed = {*changed_inputs(annotated, step), *changed_outputs(annotated, step)} - NOT_SHOWN.get(step, set())
    except SpinestiffError:
        return False
    return step in recorded_steps(annotated) and not changed


def _as_annotated(subject: Subject) -> Subject:
    """With the annotation as it is now, where it can be read."""
    with suppress(SpinestiffError):
        return replace(subject, annotation=read_annotation(subject.folder / ANNOTATION_FILE))
    return subject


def _plan(subject: Subject) -> list[str]:
    if Plan.STEP not in recorded_steps(subject):
        return []
    try:
        return [sentence(line) for line in plan_lines(read_outcome(subject, Plan))]
    except SpinestiffError:
        return []


def _parameters(subject: Subject) -> list[str]:
    if not _is_current(subject, ParameterStudy.STEP):
        return []
    try:
        return [sentence(line) for line in parameter_lines(read_outcome(subject, ParameterStudy))]
    except SpinestiffError:
        return []


def _plan_stale(subject: Subject) -> list[str]:
    """What has changed since the plan was made, in words: the estimate, or what it came from."""
    if Plan.STEP not in recorded_steps(subject):
        return []
    try:
        names = changed_inputs(_as_annotated(subject), Plan.STEP)
    except SpinestiffError as error:
        return [" ".join(str(error).replace(f"{subject.folder}/", "").split())]
    words = ["the estimate" if name.startswith(f"{RESULTS}/") else in_words(name) for name in names]
    return sorted(dict.fromkeys(words))


def _stale(subject: Subject) -> list[str]:
    try:
        return stale(subject, changed_inputs)
    except SpinestiffError as error:
        return [" ".join(str(error).replace(f"{subject.folder}/", "").split())]


@dataclass(frozen=True)
class _Ticket:
    place: Path
    until: float


class Tickets:
    """Addresses that open something for a while: frames and downloads can't send the token, but nobody can guess these.

    They say nothing of what they open, and end with the server.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._tickets: dict[str, _Ticket] = {}

    def issue(self, place: Path, seconds: float = TICKET_S) -> str:
        """A ticket for a folder or file."""
        with self._lock:
            now = time.monotonic()
            kept = {key: one for key, one in self._tickets.items() if one.until > now}
            self._tickets = dict(list(kept.items())[-MOST_TICKETS + 1 :])
            ticket = secrets.token_urlsafe(24)
            self._tickets[ticket] = _Ticket(place, now + seconds)
            return ticket

    def place(self, ticket: str, once: bool = False) -> Path:
        """What it opens. Raises NotThere."""
        with self._lock:
            found = self._tickets.pop(ticket, None) if once else self._tickets.get(ticket)
        if found is None or found.until < time.monotonic():
            raise NotThere("this address is no longer; open it again from the workbench")
        return found.place
