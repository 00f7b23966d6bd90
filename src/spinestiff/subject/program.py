"""Which program makes a result: its version, and a hash of the sources that results come from.

The version alone is not enough: an editable install, a checkout on the path and an install from a branch keep it while
their code changes. So the sources count wherever they lie; in a released wheel they say what the version says, and
reading them takes some hundredths of a second. What counts for what:

    ABOVE       never: rooms that no step imports, so that another option of the command line has nothing made again
    TOLD        for pages and pictures alone: it says, prints and draws what was found, and no number comes from it
    BESIDE      for pages and pictures alone, too: it makes subject folders and files for others
    all else    for every result
"""

from __future__ import annotations

import hashlib
from collections.abc import Collection, Iterator
from functools import cache
from pathlib import Path

import spinestiff
from spinestiff import __version__

ABOVE = (
    "app",
    "__main__.py",
    "annotate",
    "cohort",
    "interop",
    "loopback",
    "plot.py",
    "run_log.py",
    "verification",
    "versions.py",
    "workbench",
)
"""Rooms from which no result comes: imports point away from them."""
TOLD = (
    "study/report",
    "study/seven/account.py",
    "study/seven/discussion.py",
    "study/seven/goals.py",
    "study/seven/page.py",
    "study/seven/tables.py",
    "study/wording",
    "words.py",
)
"""What makes words, pages and pictures of what was found. Whatever counts for a number takes nothing from it but words
(``tests/test_architecture.py``)."""
BESIDE = (
    "anatomy/export/feb.py",
    "anatomy/export/glb.py",
    "anatomy/export/mjcf.py",
    "anatomy/export/osim.py",
    "anatomy/export/vtu.py",
    "curves/angle_csv.py",
    "imaging/deidentification",
    "imaging/proposal.py",
    "study/drawn.py",
    "study/imported.py",
    "subject/intake",
)
"""What makes subject folders, or files for others: nothing that counts for a number imports it
(``tests/test_architecture.py``), so that no estimate is made again for it."""
_MADE = {"__pycache__"}


@cache
def program() -> str:
    """Version and hash of the sources of results, words and pages among them, e.g. "0.1.0+5f0b8e4c1d2a".

    The sources are those that lie there when this is first asked.
    """
    return _named(ABOVE)


@cache
def program_of_numbers() -> str:
    """The same of the sources that a result's numbers come from: another sentence on a page does not change it."""
    return _named((*ABOVE, *TOLD, *BESIDE))


def _named(without: Collection[str]) -> str:
    return f"{__version__}+{sources_digest(Path(spinestiff.__file__).parent, without)[:12]}"


def sources_digest(package: Path, without: Collection[str] = ABOVE) -> str:
    """SHA-256 of the files of a package's folder, code and data, by name.

    Parameters
    ----------
    without : files and folders that do not count, by their path in the package with "/".
    """
    found = hashlib.sha256()
    for path in _sources(package, without):
        found.update(f"{path.relative_to(package).as_posix()}\0".encode())
        found.update(hashlib.sha256(path.read_bytes()).digest())
    return found.hexdigest()


def _sources(package: Path, without: Collection[str]) -> Iterator[Path]:
    for path in sorted(package.rglob("*")):
        inside = path.relative_to(package)
        left_out = any(one.as_posix() in without for one in (inside, *inside.parents))
        if not left_out and not _MADE & set(inside.parts) and not path.name.startswith(".") and path.is_file():
            yield path
