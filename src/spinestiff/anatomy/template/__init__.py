"""The procedural torso: bodies from published sizes, with tissue meshes that ship as data.

``tools/build_torso.py`` writes the data of the reference body; a run reads it and scales it, or warps it to a body.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from importlib.resources import as_file, files
from typing import TYPE_CHECKING, Literal, get_args

import numpy as np

from spinestiff.anatomy.stiffness import DEFAULT_POISSON, DEFAULT_YOUNG_MPA, joint_stiffness, lame_parameters
from spinestiff.anatomy.template.body import HEIGHT_RANGE_CM, Body, Sex, body_of, proportions
from spinestiff.anatomy.template.options import Thoracolumbar, with_options
from spinestiff.anatomy.template.proportions import REFERENCE, Proportions
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.errors import TorsoError

if TYPE_CHECKING:
    from spinestiff.anatomy.template.assemble import Skeleton

Mesh = Literal["coarse", "fine"]
MESHES: tuple[Mesh, ...] = get_args(Mesh)
# Of synthetic subjects; no estimate is made on it.
OWN_MESH = "own"


def template_torso(
    height_cm: float,
    mesh: Literal["coarse", "fine", "own"] | str = "coarse",
    *,
    age_years: float | None = None,
    sex: Sex | None = None,
    mass_kg: float | None = None,
    kyphosis_deg: float | None = None,
    lordosis_deg: float | None = None,
    disc_shift_mm: float = 0.0,
    scapulothoracic_n_per_mm: float = 0.0,
    thoracolumbar: Thoracolumbar = "lumbar",
) -> TorsoModel:
    """The template torso of a body.

    With the height alone, the reference body (a girl of 157 cm) scaled uniformly. With any of age, sex, mass, kyphosis
    or lordosis, a body of those sizes (docs/anatomy.md); what is still missing is the usual: female, the age whose mean
    height this is, the mean mass of age and height, kyphosis 38 and lordosis 45 degrees.

    Parameters
    ----------
    height_cm : 120 to 200.
    mesh : "coarse" (about 3,000 tissue nodes) or "fine" (about 10,000); "own" (about 15,000), made in another way and
        sharing no point with those, for synthetic subjects.
    age_years : 8 to 100; from 18 an adult.
    sex : "female" or "male".
    mass_kg : body mass, 12 to 40 kg/m2 over the squared height; changes the skin, not the bones.
    kyphosis_deg, lordosis_deg : 20 to 50 (T1 to T12), 35 to 60 (L1 to S1).
    disc_shift_mm : intervertebral joints lie this far behind the disc's centre, 0 to 15.
    scapulothoracic_n_per_mm : stiffness of a spring between each scapula and the rib under it, normal to the chest
        wall; 0 = none, as in the paper.
    thoracolumbar : row of Table 1 that T12-L1 takes, "lumbar" or "thoracic".

    Raises
    ------
    TorsoError : a value out of range, an unknown mesh, or a body that the tissue mesh cannot follow.
    """
    low, high = HEIGHT_RANGE_CM
    if not low <= height_cm <= high:
        raise TorsoError(f"body height {height_cm:g} cm; wanted {low:g} to {high:g} cm")
    if mesh not in (*MESHES, OWN_MESH):
        raise TorsoError(f"unknown tissue mesh '{mesh}'; known are {', '.join((*MESHES, OWN_MESH))}")
    if all(given is None for given in (age_years, sex, mass_kg, kyphosis_deg, lordosis_deg)):
        reference = _reference(mesh)
        torso = reference.scaled(height_cm / reference.height_cm)
    else:
        torso = _warped(body_of(height_cm, age_years, sex, mass_kg, kyphosis_deg, lordosis_deg), mesh)
    return with_options(torso, disc_shift_mm, scapulothoracic_n_per_mm, thoracolumbar)


@lru_cache(maxsize=8)
def _warped(body: Body, mesh: str) -> TorsoModel:
    from spinestiff.anatomy.template.assemble import assemble
    from spinestiff.anatomy.template.warp import warped_nodes

    tissue, skeleton = _reference(mesh).tissue, _skeleton(proportions(body))
    nodes = warped_nodes(tissue, _skeleton(REFERENCE), skeleton)
    return assemble(skeleton, nodes, tissue.elements, tissue.bone_of_node)


@lru_cache(maxsize=8)
def _skeleton(size: Proportions) -> Skeleton:
    from spinestiff.anatomy.template.assemble import build_skeleton

    return build_skeleton(size)


@lru_cache(maxsize=len(MESHES) + 1)
def _reference(mesh: str) -> TorsoModel:
    from spinestiff.anatomy.files import read_torso

    with as_file(files("spinestiff.anatomy") / "data" / f"torso_{mesh}.npz") as path:
        stored = read_torso(path)
    # The file's stiffness is that of the day it was built; the default lives in anatomy/stiffness.py alone.
    count = len(stored.tissue.elements)
    mu, lambda_ = (np.full(count, value) for value in lame_parameters(DEFAULT_YOUNG_MPA, DEFAULT_POISSON))
    tissue = replace(stored.tissue, lame_mu=mu, lame_lambda=lambda_)
    return replace(stored, tissue=tissue, joints=replace(stored.joints, stiffness=joint_stiffness()))
