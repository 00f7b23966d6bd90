"""Which program makes a result: its version, and a hash of the sources that results come from.

The version alone is not enough: an editable install, a checkout on the path and an install from a branch keep it while
their code changes. So the sources count wherever they lie; in a released wheel they say what the version says, and
reading them takes some hundredths of a second. Rooms that no step imports (``ABOVE``) are left out, so that another
option of the command line has nothing estimated again.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import spinestiff
from spinestiff import __version__

ABOVE = ("app", "annotate", "cohort", "interop", "plot.py", "run_log.py", "verification", "versions.py", "workbench")
"""Rooms from which no result comes: imports point away from them."""
_MADE = {"__pycache__"}


@cache
def program() -> str:
    """Version and hash of the sources as they lie when this is first asked, e.g. "0.1.0+5f0b8e4c1d2a"."""
    return f"{__version__}+{sources_digest(Path(spinestiff.__file__).parent)[:12]}"


def sources_digest(package: Path, above: tuple[str, ...] = ABOVE) -> str:
    """SHA-256 of the files of a package's folder, code and data, by name; without its rooms ``above``."""
    found = hashlib.sha256()
    for path in _sources(package, above):
        found.update(f"{path.relative_to(package).as_posix()}\0".encode())
        found.update(hashlib.sha256(path.read_bytes()).digest())
    return found.hexdigest()


def _sources(package: Path, above: tuple[str, ...]) -> Iterator[Path]:
    for path in sorted(package.rglob("*")):
        inside = path.relative_to(package).parts
        if inside[0] not in above and not _MADE & set(inside) and not inside[-1].startswith(".") and path.is_file():
            yield path
