"""Stiffness of spine and torso from radiographs taken under measured pushes.

The public names, as docs/public-names.md lists them. Each is imported from its module at first use, so that
``import spinestiff`` and ``spinestiff --help`` stay quick.
"""

from __future__ import annotations

import logging
from importlib import import_module
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

# What the modules log is for whoever asks: logging.basicConfig(level=logging.INFO), or a handler of one's own.
logging.getLogger(__name__).addHandler(logging.NullHandler())

if TYPE_CHECKING:  # the same list for editors and type checkers; a test compares the two
    from spinestiff import plot as plot
    from spinestiff.anatomy.export import export_torso as export_torso
    from spinestiff.anatomy.importing import import_torso as import_torso
    from spinestiff.anatomy.points import PointsOnBones as PointsOnBones
    from spinestiff.anatomy.state import TorsoState as TorsoState
    from spinestiff.anatomy.stiffness import ParameterGroup as ParameterGroup
    from spinestiff.anatomy.stiffness import lame_parameters as lame_parameters
    from spinestiff.anatomy.stiffness import stiffness_ratios as stiffness_ratios
    from spinestiff.anatomy.template import template_torso as template_torso
    from spinestiff.anatomy.torso import JointTable as JointTable
    from spinestiff.anatomy.torso import TissueMesh as TissueMesh
    from spinestiff.anatomy.torso import TorsoModel as TorsoModel
    from spinestiff.anatomy.torso import joint_frames as joint_frames
    from spinestiff.curves.cobb import read_cobb as read_cobb
    from spinestiff.curves.corner_files import read_corner_file as read_corner_file
    from spinestiff.curves.corner_files import read_corners as read_corners
    from spinestiff.curves.corner_files import write_corners as write_corners
    from spinestiff.errors import OutsideWarning as OutsideWarning
    from spinestiff.errors import SpinestiffError as SpinestiffError
    from spinestiff.estimation.asked import Start as Start
    from spinestiff.estimation.fit import fit_stiffness as fit_stiffness
    from spinestiff.estimation.known import Known as Known
    from spinestiff.estimation.objective import Trial as Trial
    from spinestiff.estimation.priors import Priors as Priors
    from spinestiff.imaging.features import VertebraCorners as VertebraCorners
    from spinestiff.imaging.features import rmse as rmse
    from spinestiff.imaging.features import silhouette_shares as silhouette_shares
    from spinestiff.imaging.features import state_features as state_features
    from spinestiff.imaging.projection import frontal_view as frontal_view
    from spinestiff.imaging.projection import lateral_view as lateral_view
    from spinestiff.imaging.radiograph import read_radiographs as read_radiographs
    from spinestiff.imaging.synthetic.acquisition import Acquisition as Acquisition
    from spinestiff.imaging.synthetic.acquisition import acquire as acquire
    from spinestiff.imaging.synthetic.breathing import Breathing as Breathing
    from spinestiff.imaging.synthetic.collimation import Collimation as Collimation
    from spinestiff.imaging.synthetic.detector import Exposure as Exposure
    from spinestiff.imaging.tracking import track as track
    from spinestiff.interop.jax import jax_equilibrium as jax_equilibrium
    from spinestiff.interop.torch import torch_equilibrium as torch_equilibrium
    from spinestiff.mechanics.differentiable import DifferentiableEquilibrium as DifferentiableEquilibrium
    from spinestiff.mechanics.differentiable import Pose as Pose
    from spinestiff.mechanics.equilibrium import EquilibriumProblem as EquilibriumProblem
    from spinestiff.mechanics.loads import LoadCase as LoadCase
    from spinestiff.mechanics.loads import no_load as no_load
    from spinestiff.mechanics.loads import rib_push as rib_push
    from spinestiff.mechanics.loads import three_point_reactions as three_point_reactions
    from spinestiff.mechanics.loads import tissue_load as tissue_load
    from spinestiff.mechanics.mechanisms import require_no_mechanism as require_no_mechanism
    from spinestiff.mechanics.places import SupportPlace as SupportPlace
    from spinestiff.mechanics.supports import Supports as Supports
    from spinestiff.mechanics.supports import three_point_supports as three_point_supports
    from spinestiff.mechanics.terms import PointSprings as PointSprings
    from spinestiff.personalise.shape import personalise as personalise_torso  # noqa: F401 (typed as the others)
    from spinestiff.study.assessment import assess as assess
    from spinestiff.study.runner import run_steps as run_steps
    from spinestiff.study.steps import stored_predictions as stored_predictions
    from spinestiff.study.synthetic.elastic_supports import SyntheticSupports as SyntheticSupports
    from spinestiff.study.synthetic.recipe import Recipe as Recipe
    from spinestiff.study.synthetic.recipe import SyntheticPush as SyntheticPush
    from spinestiff.study.synthetic.subject import synthesise as synthesise
    from spinestiff.study.visit import Settings as Settings
    from spinestiff.study.visit import open_visit as open_visit
    from spinestiff.subject.annotated_points import image_corners as image_corners
    from spinestiff.subject.annotated_points import image_supports as image_supports
    from spinestiff.subject.assessment_outcome import Assessment as Assessment
    from spinestiff.subject.estimate_outcome import Estimate as Estimate
    from spinestiff.subject.folder import read_push as read_push
    from spinestiff.subject.folder import read_subject as read_subject
    from spinestiff.subject.geometry_outcome import GeometryRecord as GeometryRecord
    from spinestiff.subject.outcomes import Responses as Responses
    from spinestiff.subject.outcomes import Tracked as Tracked
    from spinestiff.subject.run_record import read_outcome as read_outcome

_MODULES = {
    "anatomy.template": ("template_torso",),
    "anatomy.importing": ("import_torso",),
    "anatomy.export": ("export_torso",),
    "anatomy.state": ("TorsoState",),
    "anatomy.torso": ("TorsoModel", "JointTable", "joint_frames", "TissueMesh"),
    "anatomy.points": ("PointsOnBones",),
    "anatomy.stiffness": ("stiffness_ratios", "ParameterGroup", "lame_parameters"),
    "mechanics.equilibrium": ("EquilibriumProblem",),
    "mechanics.loads": ("LoadCase", "rib_push", "no_load", "tissue_load", "three_point_reactions"),
    "mechanics.supports": ("Supports", "three_point_supports"),
    "mechanics.places": ("SupportPlace",),
    "mechanics.terms": ("PointSprings",),
    "mechanics.mechanisms": ("require_no_mechanism",),
    "mechanics.differentiable": ("DifferentiableEquilibrium", "Pose"),
    # Each needs the extra of its name.
    "interop.torch": ("torch_equilibrium",),
    "interop.jax": ("jax_equilibrium",),
    "imaging.radiograph": ("read_radiographs",),
    "imaging.tracking": ("track",),
    "imaging.projection": ("frontal_view", "lateral_view"),
    "imaging.features": ("VertebraCorners", "silhouette_shares", "state_features", "rmse"),
    "imaging.synthetic.acquisition": ("acquire", "Acquisition"),
    "imaging.synthetic.detector": ("Exposure",),
    "imaging.synthetic.breathing": ("Breathing",),
    "imaging.synthetic.collimation": ("Collimation",),
    "estimation.objective": ("Trial",),
    "estimation.fit": ("fit_stiffness",),
    "estimation.asked": ("Start",),
    "estimation.known": ("Known",),
    "estimation.priors": ("Priors",),
    "curves.cobb": ("read_cobb",),
    "curves.corner_files": ("read_corner_file", "read_corners", "write_corners"),
    "subject.folder": ("read_subject", "read_push"),
    "subject.annotated_points": ("image_corners", "image_supports"),
    "study.visit": ("open_visit", "Settings"),
    "study.runner": ("run_steps",),
    "study.steps": ("stored_predictions",),
    "study.assessment": ("assess",),
    "subject.run_record": ("read_outcome",),
    "subject.outcomes": ("Tracked", "Responses"),
    "subject.geometry_outcome": ("GeometryRecord",),
    "subject.estimate_outcome": ("Estimate",),
    "subject.assessment_outcome": ("Assessment",),
    "study.synthetic.elastic_supports": ("SyntheticSupports",),
    "study.synthetic.recipe": ("Recipe", "SyntheticPush"),
    "study.synthetic.subject": ("synthesise",),
    "errors": ("SpinestiffError", "OutsideWarning"),
}
_HOMES = {name: f"spinestiff.{module}" for module, names in _MODULES.items() for name in names}
# The function has the name of its room, which is an attribute of the package already.
_HOMES["personalise_torso"] = "spinestiff.personalise.shape"
_OWN_NAMES = {"personalise_torso": "personalise"}
_SUBMODULES = ("plot",)


def __getattr__(name: str) -> Any:
    if name in _SUBMODULES:
        return import_module(f"spinestiff.{name}")
    if name not in _HOMES:
        raise AttributeError(f"spinestiff has no public name '{name}'; there are {', '.join((*_HOMES, *_SUBMODULES))}")
    value = getattr(import_module(_HOMES[name]), _OWN_NAMES.get(name, name))
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return ["__version__", *_HOMES, *_SUBMODULES]
