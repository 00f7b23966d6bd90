"""Where things lie in a cohort's folders: inputs and outputs of a participant, and the files of the cohort itself.

``OUT/<participant>/`` holds ``results`` (published whole, with the marker ``done.json`` inside), ``work`` (the private
folder of a run, there only until its results are published), ``logs`` (a log of each run in which a step ran; beside
the results, since the same inputs give the same results), ``last.json`` and ``log.txt`` (how the last run went),
``participant.lock`` (empty, locked by the run at work) and ``aside-<n>`` (what was found in the place of results and is
none).
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from spinestiff.errors import SubjectError
from spinestiff.files import file_digest, no_folder, regular_files
from spinestiff.formats import encodable

RESULTS = "results"
DONE_FILE = "done.json"
ROW_FILE = "row.json"
LOGS = "logs"
LOCK_FILE = "cohort.lock"
LEDGER_FILE = "ledger.sqlite"
CACHE = "cohort.cache"
CLUSTER_FILE = "cohort.cluster"
"""There while a cluster is at work, which has to see it (``cluster``)."""


@dataclass(frozen=True)
class Place:
    """The folders of one participant.

    Attributes
    ----------
    source : the subject folder as given; only read. target : what is made of it.
    """

    participant: str
    source: Path
    target: Path

    @property
    def results(self) -> Path:
        """The published results."""
        return self.target / RESULTS

    @property
    def marker(self) -> Path:
        """The marker that vouches for them."""
        return self.results / DONE_FILE

    @property
    def before(self) -> Path:
        """Results that are just being replaced."""
        return self.target / "results-before"

    @property
    def work(self) -> Path:
        """The subject folder in which a run works."""
        return self.target / "work"

    @property
    def task(self) -> Path:
        """What the run in ``work`` is asked."""
        return self.target / "work.json"

    @property
    def last(self) -> Path:
        """How the last run went."""
        return self.target / "last.json"

    @property
    def lock(self) -> Path:
        """The file that a run at work holds."""
        return self.target / "participant.lock"

    @property
    def logs(self) -> Path:
        """The folder of the runs' logs."""
        return self.target / LOGS

    @property
    def log(self) -> Path:
        """What the last run's process wrote besides."""
        return self.target / "log.txt"


def place_of(source: Path, target: Path, participant: str) -> Place:
    """The folders of a participant of the cohort ``source``, whose results go to ``target``."""
    return Place(participant, source / participant, target / participant)


def input_files(folder: Path) -> dict[str, Path]:
    """The files of a subject folder that are inputs, by their paths in it: all but results and hidden ones.

    Raises
    ------
    SubjectError : no such folder; something that is no file, or a link that leads out of the folder.
    """
    if not folder.is_dir():
        raise SubjectError(f"{folder}: {no_folder(folder)}; wanted the subject folder of this participant")
    found = regular_files(folder, SubjectError, within=folder, but=folder / RESULTS)
    return {path.relative_to(folder).as_posix(): path for path in found}


def digests_of(files: dict[str, Path]) -> dict[str, str]:
    """SHA-256 of each file, by the same names as a marker can hold them (``formats.encodable``).

    Raises SubjectError if one can't be read.
    """
    return {encodable(name): file_digest(path) for name, path in sorted(files.items())}


def sweep(folder: Path) -> None:
    """Take away what a process that was killed while it wrote a file here has left; folders in it are left alone.

    What can't be taken away stays.
    """
    for litter in folder.glob(".*.tmp"):
        with suppress(OSError):
            if litter.is_file():
                litter.unlink(missing_ok=True)
