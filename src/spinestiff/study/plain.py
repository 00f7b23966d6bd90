"""Stiffness in plain units: what a ratio to a default means to a reader."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from spinestiff.anatomy.stiffness import NMM_PER_NM, StiffnessRatios
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.subject.outcomes import PlainStiffness, RatioEstimate

BENDING: tuple[str, ...] = ("lateral_bending", "intervertebral_bending", "everything")
"""Ratios that scale a level's lateral bending as a whole."""
TISSUE: tuple[str, ...] = ("tissue", "everything")


def plain_stiffness(
    torso: TorsoModel, ratios: StiffnessRatios, estimates: Mapping[str, RatioEstimate]
) -> dict[str, PlainStiffness]:
    """Lateral bending of a thoracic and of a lumbar level (mean, N m/rad), and the tissue's Young's modulus (kPa).

    Parameters
    ----------
    ratios : all of them.
    estimates : those that were estimated, with their intervals.
    """
    joints = ratios.scale_joints(torso.joints.stiffness)
    kinds = np.array(torso.joints.kinds)
    mu, lam = (values[0] for values in ratios.scale_tissue(torso.tissue.lame_mu, torso.tissue.lame_lambda))
    young = 1e3 * mu * (3.0 * lam + 2.0 * mu) / (lam + mu)
    found = {
        f"lateral_bending_{kind}": (float(joints[kinds == kind, 5].mean() / NMM_PER_NM), "N m/rad", BENDING)
        for kind in ("thoracic", "lumbar")
    }
    found["tissue_young"] = (float(young), "kPa", TISSUE)
    return {name: _plain(value, unit, scaling, estimates) for name, (value, unit, scaling) in found.items()}


def _plain(value: float, unit: str, scaling: tuple[str, ...], estimates: Mapping[str, RatioEstimate]) -> PlainStiffness:
    ratio = next((name for name in estimates if name in scaling), None)
    if ratio is None:
        return PlainStiffness(value=value, low=None, high=None, unit=unit, ratio=None)
    ends = estimates[ratio].scaled(value / estimates[ratio].value)
    return PlainStiffness(**{**ends.model_dump(), "value": value}, unit=unit, ratio=ratio)
