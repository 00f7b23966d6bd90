"""Vertebra corners of images in Slicer markups: one list of points an image, one point a corner (docs/cobb.md).

A point's label is "LEVEL corner", e.g. "T5 top_left". Its position says by itself which of two planes it lies in:

- all third coordinates equal: (column, row) of a two-dimensional image, as Slicer places one that has no orientation
  of its own: pixels where the image has no spacing, else mm. The file does not tell which, unless spinestiff wrote it;
- all second coordinates equal: LPS, mm, in a coronal plane. Seen from the front, columns grow with L and rows with -S.

Anything else, points of a bone in space for example, has no one picture and is refused.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from spinestiff.anatomy.export.mrk import document, point_list
from spinestiff.arrays import Floats
from spinestiff.errors import SubjectError

# Of the list's largest extent: what rounding in a file may put a plane out of flat.
FLATNESS = 1e-6
# What Slicer leaves alone and we need to tell pixels from mm.
UNIT_KEY = "spinestiffUnit"
Plane = Literal["image", "coronal"]


@dataclass(frozen=True)
class PointList:
    """One list of points as the file has it.

    Attributes
    ----------
    name : of the list, the image's.
    labels : (n,) of the points.
    points : (n, 2) column and row as seen in the image.
    plane : "image" or "coronal".
    unit : "px" where the list says so, "mm" in a coronal plane, "unstated" else.
    """

    name: str
    labels: tuple[str, ...]
    points: Floats
    plane: Plane
    unit: Literal["px", "mm", "unstated"]


def parse(content: Any, name: str, fallback: str) -> list[PointList | tuple[str, str]]:
    """The lists of a markups file's JSON; a list that can't be read is given as (its name, the reason).

    Parameters
    ----------
    content : the parsed JSON.
    name : of the file, for messages.
    fallback : name of an only list that has none.

    Raises
    ------
    SubjectError : no markups file, or no list in it.
    """
    lists = content.get("markups") if isinstance(content, dict) else None
    if not isinstance(lists, list) or not lists:
        raise SubjectError(f"{name}: markups: wanted a list with at least one point list (Slicer markups JSON)")
    found: list[PointList | tuple[str, str]] = []
    for i, entry in enumerate(lists):
        where = f"markups[{i}]"
        if not isinstance(entry, dict):
            raise SubjectError(f"{name}: {where}: found {type(entry).__name__}, wanted an object")
        title = entry.get("name", "")
        if not isinstance(title, str):
            raise SubjectError(f"{name}: {where}.name: found {type(title).__name__}, wanted text")
        if not title.strip() and len(lists) > 1:
            raise SubjectError(f"{name}: {where}.name: missing; wanted the image's name, as there are several lists")
        title = title.strip() or fallback
        try:
            found.append(_list(entry, where, title))
        except _Unfit as error:
            found.append((title, str(error)))
    return found


class _Unfit(Exception):
    """A list that is well-formed JSON but no picture of corners."""


def _list(entry: dict[str, Any], where: str, title: str) -> PointList:
    if entry.get("type") != "Fiducial":
        raise _Unfit(f"{where}.type: found {_shown(entry.get('type'))}, wanted 'Fiducial' (a list of points)")
    system = entry.get("coordinateSystem")
    if system not in ("LPS", "RAS"):
        raise _Unfit(f"{where}.coordinateSystem: found {_shown(system)}, wanted 'LPS' or 'RAS'")
    units = entry.get("coordinateUnits", "mm")
    if units not in ("mm", ["mm", "UCUM", "millimeter"]):
        raise _Unfit(f"{where}.coordinateUnits: found {_shown(units)}, wanted 'mm'")
    points = entry.get("controlPoints")
    if not isinstance(points, list) or not points:
        raise _Unfit(f"{where}.controlPoints: wanted at least one point")
    labels, places = [], []
    for i, point in enumerate(points):
        label, place = _point(point, f"{where}.controlPoints[{i}]")
        labels.append(label)
        places.append(place)
    lps = np.array(places) * ([1.0, 1.0, 1.0] if system == "LPS" else [-1.0, -1.0, 1.0])
    spread = np.ptp(lps, axis=0)
    flat = spread <= FLATNESS * spread.max()
    if flat[2] and not flat[1]:
        marked = entry.get(UNIT_KEY) == "pixel"
        return PointList(title, tuple(labels), lps[:, :2], "image", "px" if marked else "unstated")
    if flat[1] and not flat[2]:
        return PointList(title, tuple(labels), lps[:, [0, 2]] * [1.0, -1.0], "coronal", "mm")
    raise _Unfit(
        f"{where}: the points lie in no one picture; wanted (column, row, 0), or LPS with one and the same "
        "second coordinate (a coronal plane)"
    )


def _point(point: Any, where: str) -> tuple[str, tuple[float, float, float]]:
    if not isinstance(point, dict):
        raise _Unfit(f"{where}: found {_shown(point)}, wanted an object")
    if point.get("positionStatus", "defined") != "defined":
        raise _Unfit(f"{where}: has no position (positionStatus {_shown(point['positionStatus'])}); place or delete it")
    label, position = point.get("label"), point.get("position")
    if not isinstance(label, str):
        raise _Unfit(f"{where}.label: found {_shown(label)}, wanted e.g. 'T5 top_left'")
    numbers = isinstance(position, list) and [v for v in position if type(v) in (int, float) and _finite(v)]
    if not isinstance(position, list) or not numbers or len(position) != 3 or len(numbers) != 3:
        raise _Unfit(f"{where}.position: found {_shown(position)}, wanted three finite numbers")
    return label, (float(numbers[0]), float(numbers[1]), float(numbers[2]))


def _finite(value: float) -> bool:
    try:
        return math.isfinite(value)
    except OverflowError:
        return False


def content(lists: Sequence[PointList]) -> bytes:
    """A markups file of corners."""
    made = []
    for entry in lists:
        nothing = np.zeros(len(entry.points))
        columns, rows = entry.points.T
        places = (columns, rows, nothing) if entry.plane == "image" else (columns, nothing, -rows)
        made.append(point_list(entry.name, list(entry.labels), np.stack(places, axis=1)))
        if entry.unit == "px":
            made[-1][UNIT_KEY] = "pixel"
    return document(made)


def _shown(value: Any, longest: int = 40) -> str:
    text = repr(value)
    return text if len(text) <= longest else text[: longest - 3] + "..."
