"""``spinestiff repeat``: how repeatable estimates of the same people are, and whether somebody changed."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

from spinestiff.app import tables
from spinestiff.errors import SpinestiffError, SubjectError
from spinestiff.files import read_json, write_bytes, write_json
from spinestiff.study.repeatability import Repeatability, estimate_of, repeatability
from spinestiff.study.visit import open_visit
from spinestiff.study.wording.repeat import repeatability_lines
from spinestiff.subject.output_places import check_output_apart

RECORD, PICTURE = "repeat.json", "repeat.png"


def compare_visits(folders: Sequence[Path], out: Path | None, annotators: bool = False) -> Repeatability:
    """Read the estimates, of visits or, ``annotators``, of the same radiographs annotated again.

    With ``out`` write ``repeat.json`` and ``repeat.png`` into that folder, over those of an earlier comparison.

    Raises
    ------
    SpinestiffError : see ``study.repeatability``; a folder is given twice; something can't be written, or lies there.
    """
    resolved = [folder.resolve() for folder in folders]
    for i, folder in enumerate(resolved):
        if folder in resolved[:i]:
            raise SubjectError(f"{folders[i]}: given twice; a visit compared with itself never changes")
    if out is not None and any(out.resolve().is_relative_to(folder) for folder in resolved):
        raise SubjectError(f"--out {out}: lies in a folder that is read; choose one beside it")
    if out is not None:
        ours = _is_ours(out / RECORD)
        for name in (RECORD, PICTURE):
            check_output_apart(out / name, "--out", force=True)
            if os.path.lexists(out / name) and not ours:
                raise SubjectError(f"--out {out}: has another {name}, which repeat would replace; name another")
    visits = [estimate_of(open_visit(folder), annotators) for folder in folders]
    found = repeatability(visits, "annotators" if annotators else "visits")
    if out is not None:
        from spinestiff.study.report.figures import as_png
        from spinestiff.study.report.repeat_picture import draw_repeatability

        picture = as_png(draw_repeatability(found))
        write_json(out / RECORD, record_of(found))
        write_bytes(out / PICTURE, picture)
    return found


def _is_ours(path: Path) -> bool:
    """Whether a file is as ``compare_visits`` writes it."""
    try:
        record = read_json(path)
    except SpinestiffError:
        return False
    return isinstance(record, dict) and {field.name for field in fields(Repeatability)} <= set(record)


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
        print(f"picture: {out / PICTURE}")
