"""What the study found of a subject, as a file of its own beside the subject's folder: its schema."""

from __future__ import annotations

from typing import Literal

from spinestiff.anatomy.template import Mesh
from spinestiff.subject.assessment_outcome import CobbChangeRecord
from spinestiff.subject.estimate_outcome import RatioEstimate
from spinestiff.subject.outcome_parts import Outcome


class FrameOutcome(Outcome):
    """A held-out frame.

    Attributes
    ----------
    push : id. told_n, true_n : force as told and as it was.
    rmse_mm : by predictor (``assessment_outcome.PREDICTORS``), of places; None: no prediction.
    motion_mm : the same of what moved since the unloaded frame, by predictor.
    cobb_deg : "measured" and by model.
    inside95 : share of corner coordinates inside the forecast's 95 % intervals.
    """

    push: str
    told_n: float
    true_n: float
    rmse_mm: dict[str, float | None]
    motion_mm: dict[str, float]
    cobb_deg: dict[str, CobbChangeRecord | None]
    inside95: float | None


class SubjectOutcome(Outcome):
    """A subject of the study.

    Attributes
    ----------
    program : that found it (``subject.program_of_numbers``). settings : digest of recipe and settings, so that what is
        there need not be redone.
    date : on which it was found, YYYY-MM-DD (UTC); None: by a program that did not note it.
    mesh : of the estimate.
    name, age, sex, height_cm, curve, force_n : as made, the force above 0 towards left curvature.
    cobb_deg : truth at rest. change_deg : of the largest force, signed.
    truth : ratios. ratios : estimates. inside : the truth lies in the joint 95 % region; None: not known.
    tissue_kpa : true and estimated modulus with its interval.
    status : of the estimate. failed : names of checks that failed.
    initial_mm : corner RMSE in the unloaded frame of the main push. rest_cobb_deg : measured in the frontal rest
        radiograph, with the estimator's torso at rest beside it.
    training_mm : corner RMSE of "default" and "fit" in the training frames.
    gradient : Table 3's, by parameter, at the default, on the coarse mesh.
    force_percent : Table 7's, by ratio, on the coarse mesh.
    missing : what of the tables could not be found, a line each with its reason.
    frames : held out.
    cpu_seconds : processor time by step; without "make" where an earlier run had made the subject.
    """

    program: str
    settings: str
    date: str | None = None
    mesh: Mesh
    name: str
    age: float
    sex: Literal["female", "male"]
    height_cm: float
    curve: str
    force_n: float
    cobb_deg: float
    change_deg: float
    truth: dict[str, float]
    ratios: dict[str, RatioEstimate]
    inside: bool | None
    tissue_kpa: tuple[float, float, float | None, float | None]
    status: str
    failed: tuple[str, ...]
    initial_mm: float
    rest_cobb_deg: tuple[float, float]
    training_mm: dict[str, float | None]
    gradient: dict[str, float]
    force_percent: dict[str, float]
    missing: tuple[str, ...]
    frames: tuple[FrameOutcome, ...]
    cpu_seconds: dict[str, float]

    def frame(self, push: str) -> FrameOutcome | None:
        """The held-out frame of a push, if it could be used."""
        return next((one for one in self.frames if one.push == push), None)
