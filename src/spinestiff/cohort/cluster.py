"""A cohort's participants run by the workers of a Dask cluster, whose machines share a file system with this one.

A task of the cluster is one try at one participant: a process with limits on the worker's machine, as ``supervisor``
starts it here (``cluster_task``). Results go through files alone. This side decides who is tried where: a worker is
first asked what it is, and gets a participant for each of its threads. A try whose worker has ended is lost: it counts.
"""

from __future__ import annotations

import json
import logging
import queue
import time
import uuid
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from typing import Any

from spinestiff.cohort.account import KEPT, MOST_TRIES, Account
from spinestiff.cohort.asked import Cohort, Limits, News, OnNews, Summary, silent
from spinestiff.cohort.cluster_task import Errand, Traits, attempt, traits
from spinestiff.cohort.ledger import Try, now, open_ledger
from spinestiff.cohort.lock import cohort_lock
from spinestiff.cohort.places import CLUSTER_FILE
from spinestiff.cohort.processes import told_to_end
from spinestiff.errors import OptionError, SubjectError
from spinestiff.files import write_text
from spinestiff.subject.program import program

NO_DASK = "--scheduler: needs the extra: pip install 'spinestiff[cluster]'"
CONNECT_S = 20.0
"""For the scheduler to answer."""
LOOK_S = 1.0
"""Between two looks at which workers there are."""
ENOUGH = 1.2
"""A worker gets a participant only if what is left of its lifetime is so many times what a participant takes."""
_END_S = 5.0


@dataclass
class _Worker:
    """A worker of the cluster. ``told`` : what it is, once it has said so. ``unfit`` : why it gets nobody."""

    address: str
    threads: int
    asked: Any
    told: Traits | None = None
    ends: float | None = None
    unfit: str = ""
    busy: int = 0


@dataclass
class _Away:
    """A try that was handed out. ``host`` : where it has begun; empty until then."""

    participant: str
    number: int
    worker: _Worker
    future: Any
    started: str = ""
    host: str = ""
    began: float = field(default_factory=time.monotonic)


def run_on_cluster(
    cohort: Cohort,
    scheduler: str,
    jobs: int | None = None,
    limits: Limits | None = None,
    news: OnNews | None = None,
    expect: Callable[[float | None], None] | None = None,
    room: Callable[[int], None] | None = None,
    remark: Callable[[str], None] | None = None,
) -> Summary:
    """As ``supervisor.run_participants``, by the workers of the Dask scheduler at an address.

    Parameters
    ----------
    jobs : participants at a time at most; as many as fit workers have threads if left out.
    room : is told how many participants the workers there can have at a time, whenever that changes.
    remark : is told of workers that get nobody, in a line each.

    Raises
    ------
    OptionError : no Dask here, or no scheduler at the address.
    SubjectError : as ``run_participants``; the scheduler is gone.
    """
    shared = Cohort(cohort.source.resolve(), cohort.target.resolve(), cohort.participants, cohort.order)
    run = uuid.uuid4().hex
    with (
        _connected(scheduler) as client,
        cohort_lock(cohort.target),
        open_ledger(cohort.target, run, cohort.order) as ledger,
    ):
        usual = ledger.usual_seconds()
        if expect is not None:
            expect(usual)
        say = silent if news is None else news
        account = Account(shared, ledger, say)
        at_work = _Cluster(client, scheduler, shared, run, limits or Limits(), account, usual)
        at_work.say, at_work.room, at_work.remark = say, room or _unheard, remark or _unheard
        with told_to_end(), at_work.opened():
            at_work.finish(account.survey(), jobs)
        return account.summary()


def _unheard(what: object) -> None:
    pass


@contextmanager
def _connected(scheduler: str) -> Iterator[Any]:
    """A client of the scheduler; what goes wrong with the connection is told by this module alone."""
    try:
        import distributed
        from distributed.comm import resolve_address
    except ImportError:
        raise OptionError(NO_DASK) from None
    with _hushed():
        try:
            # A client of what is no address takes 40 s to end, and says so.
            resolve_address(scheduler)
            client = distributed.Client(scheduler, timeout=CONNECT_S, set_as_default=False)
        except (OSError, ValueError, TimeoutError) as problem:
            words = " ".join(str(problem).split())[:160]
            raise OptionError(
                f"--scheduler {scheduler}: no Dask scheduler answers there ({words}); wanted e.g. tcp://host:8786"
            ) from None
        try:
            yield client
        finally:
            with suppress(Exception):
                client.close(_END_S)


@contextmanager
def _hushed() -> Iterator[None]:
    names = [name for name in logging.root.manager.loggerDict if name.split(".")[0] in ("distributed", "tornado")]
    before = {name: logging.getLogger(name).level for name in names}
    for name in names:
        logging.getLogger(name).setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        for name, level in before.items():
            logging.getLogger(name).setLevel(level)


class _Cluster:
    """One run on a cluster."""

    say: OnNews
    room: Callable[[int], None]
    remark: Callable[[str], None]

    def __init__(
        self,
        client: Any,
        scheduler: str,
        cohort: Cohort,
        run: str,
        limits: Limits,
        account: Account,
        usual: float | None,
    ) -> None:
        self._client, self._scheduler, self._cohort, self._run = client, scheduler, cohort, run
        self._limits, self._account, self._usual = limits, account, usual
        self._topic = f"spinestiff-{run}"
        self._note = cohort.target / CLUSTER_FILE
        self._heard: queue.Queue[dict[str, Any]] = queue.Queue()
        self._workers: dict[str, _Worker] = {}
        self._asked: dict[str, _Worker] = {}
        self._away: dict[str, _Away] = {}
        self._waiting: deque[tuple[str, int]] = deque()
        self._handed = 0
        self._shown = -1
        self._looked = -LOOK_S

    @contextmanager
    def opened(self) -> Iterator[None]:
        """However this run ends, what it has asked of the cluster ends with it."""
        with ExitStack() as ends:
            write_text(self._note, f"{self._run}\n")
            ends.callback(self._note.unlink, missing_ok=True)
            self._client.subscribe_topic(self._topic, lambda event: self._heard.put(json.loads(event[1])))
            ends.callback(self._call_off)
            yield

    def _call_off(self) -> None:
        with suppress(Exception):
            self._client.unsubscribe_topic(self._topic)
        futures = [one.future for one in self._away.values()] + [one.asked for one in self._workers.values()]
        with suppress(Exception):
            self._client.cancel(futures, force=True)

    def finish(self, participants: list[str], jobs: int | None) -> None:
        """Have all of them tried."""
        self._waiting.extend((participant, 1) for participant in participants)
        while self._waiting or self._away:
            if time.monotonic() - self._looked >= LOOK_S:
                self._look()
            self._hand_out(jobs)
            self._listen()

    def _look(self) -> None:
        """Which workers there are now; tries of those that have ended are lost."""
        there = self._ask(self._client.nthreads)
        self._looked = time.monotonic()
        for address in self._workers.keys() - there.keys():
            self._lose(self._workers.pop(address))
        for address in there.keys() - self._workers.keys():
            asked = self._submit(address, traits, str(self._cohort.source), str(self._note), self._run)
            self._workers[address] = self._asked[asked.key] = _Worker(address, there[address], asked)
        room = sum(one.threads for one in self._workers.values() if one.told is not None and not one.unfit)
        if room != self._shown:
            self._shown = room
            self.room(room)

    def _ask(self, call: Callable[[], Any]) -> Any:
        if self._client.status == "running":
            with suppress(OSError, TimeoutError):
                return call()
        raise SubjectError(f"--scheduler {self._scheduler}: the scheduler has gone{KEPT}; give the command again")

    def _submit(self, address: str, function: Callable[..., str], *given: str) -> Any:
        self._handed += 1
        future = self._client.submit(
            function, *given, key=f"{self._topic}-{self._handed}", workers=[address], allow_other_workers=False,
            retries=0, pure=False,
        )  # fmt: skip
        future.add_done_callback(lambda done: self._heard.put({"key": done.key}))
        return future

    def _lose(self, worker: _Worker) -> None:
        self._asked.pop(worker.asked.key, None)
        self._client.cancel([worker.asked], force=True)
        for one in [one for one in self._away.values() if one.worker is worker]:
            self._client.cancel([one.future], force=True)
            self._lost(one)

    def _lost(self, one: _Away) -> None:
        """A try whose worker ended; one that had not begun counts for nothing."""
        del self._away[one.future.key]
        if not one.host:
            self._waiting.appendleft((one.participant, one.number))
            return
        words = f"its worker {one.worker.address} on {one.host} ended"
        seconds = round(time.monotonic() - one.began, 3)
        self._take(
            Try(
                run=self._run, participant=one.participant, number=one.number, started=one.started, seconds=seconds,
                ended="lost", words=words, host=one.host,
            )
        )  # fmt: skip

    def _take(self, tried: Try) -> None:
        if tried.ended == "done":
            self._usual = tried.seconds if self._usual is None else 0.9 * self._usual + 0.1 * tried.seconds
        if self._account.take(tried):
            # At once: where there is no room, no other participant has to find that out.
            self._waiting.appendleft((tried.participant, MOST_TRIES))

    def _hand_out(self, jobs: int | None) -> None:
        for worker in self._workers.values():
            while self._waiting and self._free(worker) and (jobs is None or len(self._away) < jobs):
                participant, number = self._waiting.popleft()
                assert worker.told is not None
                errand = Errand(
                    task=self._cohort.task(participant), worker=worker.told.identity, run=self._run, number=number,
                    seconds=self._limits.seconds, memory_mb=self._limits.memory_mb, topic=self._topic,
                )  # fmt: skip
                future = self._submit(worker.address, attempt, errand.model_dump_json())
                self._away[future.key] = _Away(participant, number, worker, future)
                worker.busy += 1

    def _free(self, worker: _Worker) -> bool:
        if worker.told is None or worker.unfit or worker.busy >= worker.threads:
            return False
        if worker.ends is None or self._usual is None or worker.told.lifetime is None:
            return True
        needed = ENOUGH * self._usual
        # Where no lifetime is long enough, tries go on where the one before was cut off.
        return worker.ends - time.monotonic() > needed or worker.told.lifetime < 2.0 * needed

    def _listen(self) -> None:
        """Wait for news until the next look, then take all that there are."""
        wait = max(LOOK_S - (time.monotonic() - self._looked), 0.01)
        with suppress(queue.Empty):
            self._hear(self._heard.get(timeout=wait))
            while True:
                self._hear(self._heard.get_nowait())

    def _hear(self, told: dict[str, Any]) -> None:
        one = self._away.get(told["key"])
        if one is None:
            if told["key"] in self._asked:
                self._meet(self._asked.pop(told["key"]))
            return
        if "say" not in told:
            self._settle(one)
            return
        if not one.host:
            self._begun(one, told["host"])
        self.say(News(one.participant, "running", told["say"]))

    def _begun(self, one: _Away, host: str) -> None:
        one.host, one.started, one.began = host, now(), time.monotonic()
        self._account.begin(one.participant, one.number, host)

    def _settle(self, one: _Away) -> None:
        """A task has ended."""
        if one.future.status not in ("finished", "error"):
            return  # cancelled or out of reach: the next look finds worker or scheduler gone
        if one.future.status == "error":
            error = " ".join(str(one.future.exception(timeout=_END_S)).split())
            tried = Try(
                run=self._run, participant=one.participant, number=one.number, started=one.started or now(),
                seconds=round(time.monotonic() - one.began, 3), ended="crashed",
                words=f"crashed: worker {one.worker.address}: {error}", host=one.host or one.worker.address,
            )  # fmt: skip
        else:
            try:
                text = one.future.result(timeout=_END_S)
            except Exception:  # the worker ended with the answer: the next look finds it gone
                return
            if not text:
                # Another process has taken the worker's address: it is a new worker.
                self._workers.pop(one.worker.address, None)
                self._lose(one.worker)
                return
            tried = Try.model_validate_json(text, strict=True)
        if not one.host:
            self._begun(one, tried.host)
        del self._away[one.future.key]
        one.worker.busy -= 1
        self._take(tried)

    def _meet(self, worker: _Worker) -> None:
        """A worker has told what it is."""
        if worker.asked.status not in ("finished", "error"):
            return  # cancelled or out of reach: the next look finds worker or scheduler gone
        try:
            worker.told = told = Traits.model_validate_json(worker.asked.result(timeout=_END_S), strict=True)
        except Exception as error:
            worker.unfit = f"can't run spinestiff ({type(error).__name__}: {' '.join(str(error).split())[:160]})"
        else:
            if told.program != program():
                worker.unfit = f"runs spinestiff {told.program}, this is {program()}"
            elif not told.sees:
                worker.unfit = f"does not see {self._cohort.source} and {self._cohort.target} as this machine does"
            elif told.seconds_left is not None:
                worker.ends = time.monotonic() + told.seconds_left
        if worker.unfit:
            at = worker.address if worker.told is None else f"{worker.address} on {worker.told.host}"
            self.remark(f"warning: worker {at} {worker.unfit}; it gets no participant")
        self._looked = -LOOK_S
