"""The subject's geometry as a file in ``results/``: its schema. ``run_record`` writes and reads it."""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np

from spinestiff.arrays import Floats
from spinestiff.subject.outcome_parts import Outcome, OutcomeFile, Pair, PoseRecord, Vector, ViewRecord
from spinestiff.subject.records import VertebraName


class VertebraFitRecord(Outcome):
    """How well a vertebra fits a rest radiograph (``personalise.fitness.VertebraFit``)."""

    rmse_mm: float
    centre_mm: float
    angle_deg: float
    wrong_corners: int


class MeshRecord(Outcome):
    """The subject's tissue mesh: how it came about, its size and its worst element."""

    path: Literal["kept", "rebuilt", "finer"]
    nodes: int
    smallest_j: float
    smallest_dihedral_deg: float


class ScanFitRecord(Outcome):
    """How the skin fits its scan (``personalise.scanned_skin.ScanFit``); distances as median and 95th percentile."""

    covered: float
    used: float
    before_mm: Pair
    after_mm: Pair
    left_to_template: tuple[str, ...]
    held_mm: float
    yaw_deg: float
    tilt_deg: float
    turned_round: bool


class GeometryRecord(OutcomeFile):
    """``personalised.json``: how the subject's geometry was found and how well it fits; the torso is ``torso.npz``.

    Attributes
    ----------
    rmse_mm, poses, views, millimetres, fits : by view, "frontal" and "lateral"; ``fits`` by vertebra.
    prior_only : vertebrae that no radiograph shows. carried : vertebra -> motions that the prior determines more.
    length_scale : the spine's length over that of the template of the subject's sizes.
    size_scale : vertebra -> width, height and depth over the same template's.
    corner_sd_mm : of annotated corners along one axis.
    covariance : (V, 6, 6V) rows of the covariance of (dt mm, dw rad), vertebra by vertebra.
    """

    FILE: ClassVar[str] = "personalised.json"
    STEP: ClassVar[str] = "personalise"
    rmse_mm: dict[str, float]
    poses: dict[str, PoseRecord]
    views: dict[str, ViewRecord]
    millimetres: dict[str, dict[str, str]]
    fits: dict[str, dict[VertebraName, VertebraFitRecord]]
    prior_only: tuple[str, ...]
    carried: dict[str, tuple[str, ...]]
    length_scale: float
    size_scale: dict[str, Vector]
    corner_sd_mm: float
    covariance: tuple[tuple[tuple[float, ...], ...], ...]
    mesh: MeshRecord
    skin_scan: ScanFitRecord | None
    warnings: tuple[str, ...]

    @property
    def matrix(self) -> Floats:
        """(6V, 6V) ``covariance``."""
        return np.array(self.covariance).reshape(6 * len(self.covariance), -1)
