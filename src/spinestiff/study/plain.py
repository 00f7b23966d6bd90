"""Stiffness in plain units: what a ratio to a default means to a reader."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from spinestiff.anatomy.stiffness import NMM_PER_NM, ParameterGroup, StiffnessRatios
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.arrays import Floats
from spinestiff.estimation.profiles import WIDTH_FACTOR
from spinestiff.normal import HALF_WIDTH_95
from spinestiff.subject.estimate_outcome import PlainStiffness, RatioEstimate
from spinestiff.subject.outcome_parts import Quantity


def plain_stiffness(
    torso: TorsoModel,
    ratios: StiffnessRatios,
    estimates: Mapping[str, RatioEstimate],
    covariance: Floats | None = None,
) -> dict[str, PlainStiffness]:
    """Lateral bending of a thoracic and of a lumbar level (mean, N m/rad), and the tissue's Young's modulus (kPa, mean
    over its volume).

    The interval is that of the one estimated ratio that scales all of it; where several do together, to first order;
    where a part stays at its default, there is none.

    Parameters
    ----------
    ratios : all of them.
    estimates : those that were estimated, with their intervals.
    covariance : (P, P) of the logs of all ``ratios``; None: of several ratios there is no interval.
    """
    joints = ratios.scale_joints(torso.joints.stiffness)[:, 5] / NMM_PER_NM
    kinds = np.array(torso.joints.kinds)
    groups = [group for group in ratios.groups if group.name in estimates]
    spread = None if covariance is None or len(groups) < len(ratios.groups) else covariance
    found = {}
    for kind in ("thoracic", "lumbar"):
        rows = kinds == kind
        total = float(joints[rows].sum())
        shares = {group.name: float(joints[rows & group.joints[:, 5]].sum()) / total for group in groups}
        whole = _all_scaled([group.joints[rows, 5] for group in groups])
        value = float(joints[rows].mean())
        found[f"lateral_bending_{kind}"] = _plain(value, "N m/rad", shares, whole, estimates, spread)
    mu, lam = ratios.scale_tissue(torso.tissue.lame_mu, torso.tissue.lame_lambda)
    weight = torso.tissue.corner_volumes() / torso.tissue.corner_volumes().sum()
    young = 1e3 * weight * mu * (3.0 * lam + 2.0 * mu) / (lam + mu)
    shares = {group.name: _share(group, young) for group in groups}
    whole = _all_scaled([group.elements_of(len(young)) for group in groups if group.mu and group.lambda_])
    found["tissue_young"] = _plain(float(young.sum()), "kPa", shares, whole, estimates, spread)
    return found


def _all_scaled(masks: Sequence[np.ndarray]) -> bool:
    """Whether each part is in one of the masks (n,), which may overlap."""
    return bool(masks) and bool(np.any(masks, axis=0).all())


def _share(group: ParameterGroup, young: Floats) -> float:
    """Of Young's modulus, which goes with mu and lambda together; NaN for one of the two alone."""
    if group.mu != group.lambda_:
        return float("nan")
    return float(young[group.elements_of(len(young))].sum() / young.sum()) if group.mu else 0.0


def _plain(
    value: float,
    unit: str,
    shares: Mapping[str, float],
    whole: bool,
    estimates: Mapping[str, RatioEstimate],
    covariance: Floats | None,
) -> PlainStiffness:
    """``shares`` : ratio -> share of the value that it scales. ``whole`` : together they scale all of it."""
    scaling = [name for name, share in shares.items() if share != 0.0]
    ends, ratio = Quantity(value=value, low=None, high=None), None
    if whole and len(scaling) == 1:
        ratio = scaling[0]
        ends = estimates[ratio].scaled(value / estimates[ratio].value)
    elif whole and covariance is not None:
        # Of those alone that scale it: what others may be is infinite where the data can't part them.
        weights = np.array(list(shares.values()))
        own = np.flatnonzero(weights)
        variance = weights[own] @ covariance[np.ix_(own, own)] @ weights[own]
        factor = float(np.exp(WIDTH_FACTOR * HALF_WIDTH_95 * np.sqrt(variance)))
        if np.isfinite(factor):
            ends = Quantity(value=value, low=value / factor, high=value * factor)
    return PlainStiffness(**{**ends.model_dump(), "value": value}, unit=unit, ratio=ratio)
