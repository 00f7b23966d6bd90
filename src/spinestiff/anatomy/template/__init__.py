"""The procedural torso: a generic adolescent from published sizes, with tissue meshes that ship as data.

``tools/build_torso.py`` writes the data; a run only reads and scales it.
"""

from __future__ import annotations

from functools import lru_cache
from importlib.resources import as_file, files
from typing import Literal

from spinestiff.anatomy.torso import TorsoModel
from spinestiff.errors import TorsoError

HEIGHT_RANGE_CM = (120.0, 200.0)
MESHES = ("coarse", "fine")


def template_torso(height_cm: float, mesh: Literal["coarse", "fine"] | str = "coarse") -> TorsoModel:
    """The template torso, scaled uniformly to a body height.

    Parameters
    ----------
    height_cm : 120 to 200.
    mesh : "coarse" (about 3,000 tissue nodes) or "fine" (about 10,000).

    Raises
    ------
    TorsoError : height out of range or unknown mesh.
    """
    low, high = HEIGHT_RANGE_CM
    if not low <= height_cm <= high:
        raise TorsoError(f"body height {height_cm:g} cm; wanted {low:g} to {high:g} cm")
    if mesh not in MESHES:
        raise TorsoError(f"unknown tissue mesh '{mesh}'; known are {', '.join(MESHES)}")
    reference = _reference(mesh)
    return reference.scaled(height_cm / reference.height_cm)


@lru_cache(maxsize=len(MESHES))
def _reference(mesh: str) -> TorsoModel:
    from spinestiff.anatomy.files import read_torso

    with as_file(files("spinestiff.anatomy") / "data" / f"torso_{mesh}.npz") as path:
        return read_torso(path)
