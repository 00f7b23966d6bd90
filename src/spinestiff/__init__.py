"""Stiffness of spine and torso from radiographs taken under measured pushes.

The public names. Each is imported from its module at first use, so that ``import spinestiff`` and
``spinestiff --help`` stay quick.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

if TYPE_CHECKING:  # the same list for editors and type checkers; a test compares the two
    from spinestiff.anatomy.stiffness import stiffness_ratios as stiffness_ratios
    from spinestiff.anatomy.template import template_torso as template_torso
    from spinestiff.anatomy.torso import TorsoModel as TorsoModel
    from spinestiff.anatomy.torso import TorsoState as TorsoState
    from spinestiff.curves.tilts import cobb_angle as cobb_angle
    from spinestiff.curves.tilts import cobb_change as cobb_change
    from spinestiff.errors import SpinestiffError as SpinestiffError
    from spinestiff.estimation.fit import fit_stiffness as fit_stiffness
    from spinestiff.estimation.objective import Trial as Trial
    from spinestiff.imaging.features import VertebraCorners as VertebraCorners
    from spinestiff.imaging.features import rmse as rmse
    from spinestiff.imaging.features import silhouette_shares as silhouette_shares
    from spinestiff.imaging.features import state_features as state_features
    from spinestiff.imaging.projection import frontal_view as frontal_view
    from spinestiff.imaging.projection import lateral_view as lateral_view
    from spinestiff.mechanics.equilibrium import EquilibriumProblem as EquilibriumProblem
    from spinestiff.mechanics.loads import rib_push as rib_push
    from spinestiff.mechanics.supports import three_point_supports as three_point_supports
    from spinestiff.study.runner import run_steps as run_steps
    from spinestiff.study.synthetic import Recipe as Recipe
    from spinestiff.study.synthetic import synthesise as synthesise
    from spinestiff.study.visit import open_visit as open_visit
    from spinestiff.subject.folder import read_subject as read_subject

_MODULES = {
    "anatomy.stiffness": ("stiffness_ratios",),
    "anatomy.template": ("template_torso",),
    "anatomy.torso": ("TorsoModel", "TorsoState"),
    "errors": ("SpinestiffError",),
    "estimation.fit": ("fit_stiffness",),
    "estimation.objective": ("Trial",),
    "imaging.features": ("VertebraCorners", "rmse", "silhouette_shares", "state_features"),
    "imaging.projection": ("frontal_view", "lateral_view"),
    "mechanics.equilibrium": ("EquilibriumProblem",),
    "mechanics.loads": ("rib_push",),
    "mechanics.supports": ("three_point_supports",),
    "curves.tilts": ("cobb_angle", "cobb_change"),
    "study.runner": ("run_steps",),
    "study.visit": ("open_visit",),
    "subject.folder": ("read_subject",),
    "study.synthetic": ("Recipe", "synthesise"),
}
_HOMES = {name: f"spinestiff.{module}" for module, names in _MODULES.items() for name in names}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"spinestiff has no public name '{name}'; there are {', '.join(_HOMES)}")
    value = getattr(import_module(_HOMES[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return ["__version__", *_HOMES]
