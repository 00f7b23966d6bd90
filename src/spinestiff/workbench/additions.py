"""Radiographs, a table of pushes and a skin scan for a subject that is there already: looked at, and added."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from spinestiff.anatomy.axes import body_axes
from spinestiff.anatomy.importing.reading import SUFFIXES
from spinestiff.errors import SubjectError
from spinestiff.personalise.scan import read_scan
from spinestiff.subject.image_names import PushImage, described
from spinestiff.subject.inspection import inspect
from spinestiff.subject.intake.adding import (
    Addition,
    Standing,
    add_scan,
    add_view,
    added_data,
    sort_addition,
    write_addition,
)
from spinestiff.subject.intake.collecting import studies
from spinestiff.subject.intake.making import person_of
from spinestiff.subject.intake.sorting import uses_of
from spinestiff.subject.record_reading import parse_record
from spinestiff.subject.records import REST_IMAGES, ScanRecord
from spinestiff.words import counted, push_named, sentence
from spinestiff.workbench.newcomer import Export, Wish, look_record

SAID = 4
"""Of the files that a subject has already, by name."""


def radiographs_record(standing: Standing) -> dict[str, Any]:
    """The radiographs that a subject has, as JSON: a row an image, with the name by which the annotation page shows it
    and the version of its first file.

    What the subject should have and has not, or what can't be read, is among the missing of its card.
    """
    rows = []
    for image in dict.fromkeys(standing.images.values()):
        files = [one for one in standing.files if standing.images[one.name] == image]
        first = files[0]
        name = first.name if len(files) == 1 else first.name.rpartition("/")[0]
        frames = first.frames if len(files) == 1 else len(files)
        row = {"image": image, "name": name, "frames": frames, "use": _use(image)}
        rows.append({**row, "version": first.scan.sha256[:16]})
    rest = [image for image in REST_IMAGES if standing.has(image)]
    return {"files": rows, "rest": rest, "lacking": _lacking(standing)}


def _lacking(standing: Standing) -> list[str]:
    """What files and values together do not tell of the X-ray geometry, a line each, in words of the page."""
    if not any(one.scan.missing for one in standing.files):
        return []
    lines = [
        f"{_use(one.image)}: {line.partition(';')[0]}"
        for one in inspect(standing.folder)
        for line in one.missing
        if "; add xray." in line
    ]
    return list(dict.fromkeys(lines))


def _use(image: str) -> str:
    """An image in words, all its frames together.

    ``inspect`` calls a further view "push/a, view side", which reads as a push of that id and comes out right.
    """
    found = PushImage.named(image)
    if found is None:
        return described(image)
    return push_named(found.push) + ("" if found.view is None else f", view {found.view}")


def looked_at_beside(standing: Standing, export: Export, wish: Wish) -> dict[str, Any]:
    """What each radiograph of an export, and a table of pushes, becomes in a subject, as JSON."""
    groups = studies(export.found)
    if wish.study is None and len(groups) > 1:
        return {**look_record(export), "study": None, "changes": []}
    addition, data, notes = _added(standing, export, wish)
    chosen, sorting = export.study(wish), addition.sorting
    new = data["pushes"][len(data["pushes"]) - len(sorting.pushes) :]
    uses = uses_of(sorting, [push["id"] for push in new])
    reasons = {one.name: sorting.reasons[one.name] for one in chosen}
    label = wish.study or (groups[0].label if groups else None)
    record = look_record(export, chosen, uses, reasons)
    rows = [{**row, "held": row["name"] in addition.held} for row in record["files"]]
    return {**record, "files": rows, "study": label, "notes": notes, "changes": _changes(standing, addition, data)}


def _changes(standing: Standing, addition: Addition, data: Mapping[str, Any]) -> list[str]:
    """What there will be that was not, a line each."""
    rest = {"frontal": addition.sorting.frontal, "lateral": addition.sorting.lateral}
    lines = [f"A {view} radiograph at rest." for view, one in rest.items() if one is not None]
    for push in data["pushes"][len(standing.data["pushes"]) :]:
        lines.append(f"{sentence(push_named(push['id']))}, {len(push['forces_n'])} frames.")
    for number in addition.fills:
        if data["pushes"][number] != standing.data["pushes"][number]:
            lines.append(f"Values of {push_named(data['pushes'][number]['id'])} that were open.")
    told = [key for key in ("age", "sex") if standing.data.get(key) is None and data.get(key) is not None]
    return lines + [f"{key.capitalize()}, from the radiographs' headers." for key in told]


def add(standing: Standing, export: Export, wish: Wish) -> list[str]:
    """Add what was looked at; returns what there is now that was not, a line each.

    Raises
    ------
    SpinestiffError : nothing is new, or as ``intake.adding``; the subject is as it was then.
    """
    addition, data, _ = _added(standing, export, wish)
    changes = _changes(standing, addition, data)
    if not changes:
        held = [f"{name} is {other}" for name, other in addition.held.items()]
        named = f": {', '.join(held[:SAID])}" + (", ..." if len(held) > SAID else "") if held else ""
        raise SubjectError(f"there is nothing new in it: the subject has all of this already{named}")
    write_addition(standing, data, addition)
    return changes


def _added(standing: Standing, export: Export, wish: Wish) -> tuple[Addition, dict[str, Any], list[str]]:
    chosen = export.study(wish)
    addition = sort_addition(standing, chosen, wish.rows, *wish.rest(chosen), wish.pushes(chosen))
    told, _ = person_of(chosen)
    data, notes = added_data(standing, addition, told)
    return addition, data, notes


def add_skin_scan(standing: Standing, scan: Mapping[str, Any], places: Sequence[Path]) -> None:
    """Add the one surface scan among uploaded files, held against the body first where its height is known.

    Raises
    ------
    SubjectError : none, or several; a unit, axes or a file that can't be one of this trunk's; otherwise as
        ``intake.adding.add_scan``.
    """
    files = [one for place in places for one in sorted(place.rglob("*")) if one.suffix.lower() in SUFFIXES]
    if len(files) != 1:
        raise SubjectError(f"found {counted(len(files), 'scan')} in the upload, wanted one: {', '.join(SUFFIXES)}")
    record = parse_record(json.dumps({**scan, "file": files[0].name}), "the skin scan", ScanRecord)
    height = standing.data.get("height_cm")
    if height is None:
        raise SubjectError("height_cm is not known yet; fill it in first, so that unit and axes can be checked by it")
    read_scan(files[0], record.unit, body_axes(record.axes.left, record.axes.up, record.axes.front), float(height))
    add_scan(standing, scan, files[0])


def add_side(standing: Standing, export: Export, names: Sequence[str], push: int, view: Mapping[str, Any]) -> None:
    """Add radiographs of an export, by their names, as a view of a push from another side. Raises SpinestiffError."""
    by_names = {one.name: one for one in export.found}
    if unknown := next((name for name in names if name not in by_names), None):
        raise SubjectError(f"the request: no radiograph {unknown[:80]!r}")
    add_view(standing, push, view, [by_names[name] for name in names])
