"""Whether one person changed between two visits that lie in folders of their own, as ``spinestiff repeat`` tells it."""

from __future__ import annotations

import os
from dataclasses import asdict
from pathlib import Path
from typing import Any

from spinestiff.errors import SpinestiffError
from spinestiff.study.repeatability import estimate_of, repeatability
from spinestiff.study.visit import open_visit
from spinestiff.study.wording.repeat import repeatability_lines
from spinestiff.study.wording.titles import ratio_title
from spinestiff.subject.folder import read_unannotated
from spinestiff.workbench.page_words import page_words


def visits_record(first: Path, second: Path) -> dict[str, Any]:
    """Scatter and changes of two visits, the earlier one first, as JSON.

    ``same``: whether both are of one person, by ``id``, and two folders; without it nothing else is told.
    ``problem``: why nothing can be told of them; "" where it can. A change without an interval is in ``lines`` alone.
    """
    folders = (first, second)
    one, other = (read_unannotated(folder).record.id for folder in folders)
    told: dict[str, Any] = {"same": one == other and first != second, "problem": "", "lines": []}
    told |= {"scatter": {}, "changes": []}
    if not told["same"]:
        return told
    try:
        found = repeatability([estimate_of(open_visit(folder)) for folder in folders])
    except SpinestiffError as error:
        return {**told, "problem": _without(str(error), folders)}
    record = asdict(found)
    known = [one for one in record["changes"] if one["detectable_factor"] is not None]
    changes = [{**one, "title": ratio_title(one["name"])} for one in known]
    return {**told, "lines": repeatability_lines(found), "scatter": record["scatter"], "changes": changes}


def _without(words: str, folders: tuple[Path, ...]) -> str:
    """Words that name folders by their names alone."""
    for folder in folders:
        words = words.replace(f"{folder.resolve().parent}{os.sep}", "").replace(f"{folder.parent}{os.sep}", "")
    return page_words(words)
