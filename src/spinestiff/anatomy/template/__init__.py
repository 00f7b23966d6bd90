"""The procedural torso: a generic adolescent from published sizes, with tissue meshes that ship as data.

``tools/build_torso.py`` writes the data; a run only reads and scales it.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from importlib.resources import as_file, files
from typing import Literal

import numpy as np

from spinestiff.anatomy.stiffness import DEFAULT_POISSON, DEFAULT_YOUNG_MPA, joint_stiffness, lame_parameters
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
        stored = read_torso(path)
    # The file's stiffness is that of the day it was built; the default lives in anatomy/stiffness.py alone.
    count = len(stored.tissue.elements)
    mu, lambda_ = (np.full(count, value) for value in lame_parameters(DEFAULT_YOUNG_MPA, DEFAULT_POISSON))
    tissue = replace(stored.tissue, lame_mu=mu, lame_lambda=lambda_)
    return replace(stored, tissue=tissue, joints=replace(stored.joints, stiffness=joint_stiffness()))
