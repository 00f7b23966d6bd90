"""Unit and axes of a file as its owner states them: which of the file's axes run to the body's left, up and front."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

import numpy as np

from spinestiff.arrays import Floats
from spinestiff.errors import SubjectError

Unit = Literal["mm", "cm", "m"]
Axis = Literal["+x", "-x", "+y", "-y", "+z", "-z"]
MM: Mapping[Unit, float] = {"mm": 1.0, "cm": 10.0, "m": 1000.0}
DIRECTIONS = ("left", "up", "front")


def body_axes(left: Axis, up: Axis, front: Axis) -> Floats:
    """(3, 3) body_from_scan: rows are the scan's axes that run to the body's left, up and front.

    Raises
    ------
    SubjectError : an axis twice, or the axes of a mirror image.
    """
    named = dict(zip(DIRECTIONS, (left, up, front)))
    said = ", ".join(f"{what} {axis}" for what, axis in named.items())
    matrix = np.zeros((3, 3))
    for row, axis in enumerate(named.values()):
        matrix[row, "xyz".index(axis[1])] = 1.0 if axis[0] == "+" else -1.0
    determinant = round(float(np.linalg.det(matrix)))
    if determinant == 0:
        raise SubjectError(f"found {said}, wanted each of x, y and z once")
    if determinant < 0:
        raise SubjectError(f"found {said}, which shows the body in a mirror; turn one of the signs round")
    return matrix
