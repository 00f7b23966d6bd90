"""``spinestiff repeat``: how repeatable estimates of the same people are, and whether somebody changed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from spinestiff.app import tables
from spinestiff.errors import SubjectError
from spinestiff.files import write_bytes, write_json
from spinestiff.study.repeat_words import repeatability_lines
from spinestiff.study.repeatability import Repeatability, estimate_of, repeatability
from spinestiff.study.visit import open_visit


def compare_visits(folders: Sequence[Path], out: Path | None, annotators: bool = False) -> Repeatability:
    """Read the estimates, of visits or, ``annotators``, of the same radiographs annotated again.

    With ``out`` write ``repeat.json`` and ``repeat.png`` into that folder.

    Raises
    ------
    SpinestiffError : see ``study.repeatability``; a folder is given twice; or something can't be written.
    """
    resolved = [folder.resolve() for folder in folders]
    for i, folder in enumerate(resolved):
        if folder in resolved[:i]:
            raise SubjectError(f"{folders[i]}: given twice; a visit compared with itself never changes")
    if out is not None and any(out.resolve().is_relative_to(folder) for folder in resolved):
        raise SubjectError(f"--out {out}: lies in a folder that is read; choose one beside it")
    visits = [estimate_of(open_visit(folder), annotators) for folder in folders]
    found = repeatability(visits, "annotators" if annotators else "visits")
    if out is not None:
        from spinestiff.study.report.figures import as_png
        from spinestiff.study.report.repeat_picture import draw_repeatability

        picture = as_png(draw_repeatability(found))
        write_json(out / "repeat.json", record_of(found))
        write_bytes(out / "repeat.png", picture)
    return found


def record_of(found: Repeatability) -> dict[str, Any]:
    """As JSON, without the hashes that tell copies."""
    made = asdict(found)
    for visit in made["visits"]:
        for name in ("rest_pictures", "push_pictures", "marks"):
            del visit[name]
    return made


def show_repeatability(found: Repeatability, out: Path | None) -> None:
    """Print it."""
    tables.show(tables.repeatability_table(found))
    for line in repeatability_lines(found):
        print(line)
    if out is not None:
        print(f"picture: {out / 'repeat.png'}")
