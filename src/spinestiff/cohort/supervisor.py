"""A cohort's participants run side by side, each in a process of its own, watched and tried once more where one fails.

What is there already is left as it is (``marker.examine``). A participant that crashes, hangs or takes too much memory
ends alone. Where there is no room to write, the run stops: every further participant would meet the same.
"""

from __future__ import annotations

import socket
import uuid
from collections import deque
from collections.abc import Callable

from spinestiff.cohort.account import MOST_TRIES, Account
from spinestiff.cohort.asked import Cohort, Limits, OnNews, Summary, silent
from spinestiff.cohort.ledger import Ledger, open_ledger
from spinestiff.cohort.lock import cohort_lock
from spinestiff.cohort.processes import Processes, told_to_end
from spinestiff.errors import OptionError


def run_participants(
    cohort: Cohort,
    jobs: int = 1,
    limits: Limits | None = None,
    news: OnNews | None = None,
    expect: Callable[[float | None], None] | None = None,
) -> Summary:
    """Run every participant whose results are missing, damaged or out of date.

    Parameters
    ----------
    jobs : processes side by side. limits : of each.
    news : is told what becomes of each participant.
    expect : is told once how long a participant took so far, by the ledger, in seconds.

    Raises
    ------
    InUseError : another run is at work on the same output.
    SubjectError : no room to write, in which case all that was finished stays; or the output or its ledger can't be
        written.
    """
    run = uuid.uuid4().hex
    with cohort_lock(cohort.target), open_ledger(cohort.target, run, cohort.order) as ledger:
        if expect is not None:
            expect(ledger.usual_seconds())
        return _run(cohort, run, ledger, jobs, limits or Limits(), news or silent)


def run_one(cohort: Cohort, index: int, limits: Limits | None = None, news: OnNews | None = None) -> Summary:
    """Run the one participant in row ``index`` of the table, from 1, beside other such runs; there is no ledger.

    Raises
    ------
    OptionError : no such row. InUseError, SubjectError : as ``run_participants``.
    """
    if not 1 <= index <= len(cohort.participants):
        raise OptionError(f"--index {index}: wanted a row of participants.tsv, 1 to {len(cohort.participants)}")
    alone = Cohort(cohort.source, cohort.target, (cohort.participants[index - 1],), cohort.order)
    with cohort_lock(cohort.target, shared=True):
        return _run(alone, uuid.uuid4().hex, None, 1, limits or Limits(), news or silent)


def _run(cohort: Cohort, run: str, ledger: Ledger | None, jobs: int, limits: Limits, say: OnNews) -> Summary:
    account = Account(cohort, ledger, say)
    waiting = deque((participant, 1) for participant in account.survey())
    processes = Processes(run, cohort.target, limits, say)
    with told_to_end():
        try:
            while waiting or processes.running:
                while waiting and len(processes.running) < jobs:
                    participant, number = waiting.popleft()
                    account.begin(participant, number, socket.gethostname())
                    processes.start(cohort.task(participant), number)
                # At once: where there is no room, no other participant has to find that out.
                waiting.extendleft((one.participant, MOST_TRIES) for one in processes.ended() if account.take(one))
        finally:
            # However this run ends, its processes end with it.
            processes.end_all()
    return account.summary()
