"""What becomes of a cohort's participants in one run: who is up to date, who is tried again, who is done, who failed.

The same wherever the tries happen: on this machine (``supervisor``) or on others (``cluster``). Each try is noted in
the ledger, where the run has one, and in the participant's ``last.json``, unless another run is at work there.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress

from spinestiff.cohort.asked import Cohort, News, OnNews, Summary
from spinestiff.cohort.ledger import Ledger, Try, write_last
from spinestiff.cohort.marker import examine
from spinestiff.cohort.places import place_of, sweep
from spinestiff.cohort.worker import ended, recover, tidy
from spinestiff.errors import InUseError, SubjectError
from spinestiff.subject.lock import sole_run

MOST_TRIES = 2
"""Of a participant in one run; a refusal of its inputs is not tried again, since they stay the same."""
FINAL = ("refused", "in use")
KEPT = "; results that were finished are kept"


class Account:
    """One run's account of its participants."""

    def __init__(self, cohort: Cohort, ledger: Ledger | None, say: OnNews) -> None:
        self._cohort, self._ledger, self._say = cohort, ledger, say
        self._current: list[str] = []
        self._done: list[str] = []
        self._failed: dict[str, str] = {}
        self._tries: dict[str, list[Try]] = {}

    def survey(self) -> list[str]:
        """Participants that have to be run, in their order; leftovers of killed runs are taken away."""
        waiting: list[str] = []
        for participant in self._cohort.participants:
            place = place_of(self._cohort.source, self._cohort.target, participant)
            recover(place)
            found = examine(place, self._cohort.order)
            # Another run may be at work in what would be taken away.
            with suppress(InUseError, OSError), sole_run(place.target, place.lock):
                sweep(place.target)
                if found.state == "current":
                    tidy(place)
            (self._current if found.state == "current" else waiting).append(participant)
            self._say(News(participant, "up to date" if found.state == "current" else "waiting", found.words))
        return waiting

    def begin(self, participant: str, number: int, host: str) -> None:
        """A try begins. Raises SubjectError if the ledger can't be written."""
        if self._ledger is not None:
            self._ledger.begin_try(participant, number, host)

    def take(self, tried: Try) -> bool:
        """A try has ended; whether the participant is to be tried again.

        Raises
        ------
        SubjectError : there is no room to write, which all others would meet, too; the ledger can't be written.
        """
        if self._ledger is not None:
            self._ledger.end_try(tried)
        tries = self._tries.setdefault(tried.participant, [])
        tries.append(tried)
        if tried.ended == "no room":
            raise SubjectError(f"{tried.words}{KEPT}")
        # Where another run is at this participant, the file is that one's.
        if tried.ended != "in use":
            self._write_last(tried.participant, tries)
        if tried.ended in ("done", "up to date"):
            self._done.append(tried.participant)
            self._say(News(tried.participant, "done", tried.words, tried.seconds))
            return False
        if tried.ended not in FINAL and tried.number < MOST_TRIES:
            self._say(News(tried.participant, "again", tried.words, tried.seconds))
            return True
        self._failed[tried.participant] = tried.words
        self._say(News(tried.participant, "failed", tried.words, tried.seconds))
        return False

    def _write_last(self, participant: str, tries: Sequence[Try]) -> None:
        """Before a further try: whatever ends this run from outside leaves why the first one failed."""
        try:
            write_last(place_of(self._cohort.source, self._cohort.target, participant).last, tries)
        except SubjectError as problem:
            if ended(problem)[0] == "no room":
                raise SubjectError(f"{problem}{KEPT}") from None
            self._say(News(participant, "running", f"warning: {problem}"))

    def summary(self) -> Summary:
        """What became of all."""
        order = {participant: place for place, participant in enumerate(self._cohort.participants)}
        return Summary(
            tuple(self._current),
            tuple(sorted(self._done, key=order.__getitem__)),
            dict(sorted(self._failed.items(), key=lambda one: order[one[0]])),
        )
