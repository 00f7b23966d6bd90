"""``spinestiff phantom``: the stiffness of a bench phantom by its pictures, beside what was measured of its parts."""

from __future__ import annotations

from pathlib import Path

from spinestiff.app import tables
from spinestiff.study.phantom import analyse, read_phantom
from spinestiff.study.wording.phantom import phantom_lines, record_of

DISAGREES = 1


def compare_phantom(folder: Path, as_json: bool) -> int:
    """Analyse a phantom's folder and print what was found; the exit status: 0, or 1 unless bench and estimate agree.

    Raises
    ------
    SpinestiffError : see ``study.phantom``.
    """
    found = analyse(*read_phantom(folder))
    if as_json:
        tables.show_json(record_of(found))
    else:
        print(f"phantom {found.name}")
        for line in phantom_lines(found):
            print(line)
    return 0 if found.agrees else DISAGREES
