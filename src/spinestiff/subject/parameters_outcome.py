"""Which stiffness parameters the radiographs tell of, as a file in ``results/``: its schema."""

from __future__ import annotations

from typing import ClassVar, Literal

from spinestiff.anatomy.template import Mesh
from spinestiff.subject.outcome_parts import Outcome, OutcomeFile


class ParameterEffect(Outcome):
    """What a parameter does to the deformation, at the training frames and to first order.

    Attributes
    ----------
    default_mm, estimate_mm : root mean square motion of the vertebrae's corners, mm at the patient plane, per e-fold of
        the parameter, at the default stiffness (None: no equilibrium there) and at the estimate.
    share : of what all stiffnesses together do at the estimate; shares of all parts of the torso add up to 1.
    """

    name: str
    default_mm: float | None
    estimate_mm: float
    share: float


class GradientRow(Outcome):
    """Gradient of the paper's objective (Eq. 10) in one ratio's log, mm^2; at the default that in the ratio itself.

    Attributes
    ----------
    default, optimum : with all ratios 1 (None: no equilibrium there), and where the objective is least.
    """

    name: str
    default: float | None
    optimum: float


class ModelScore(Outcome):
    """A set of ratios, fitted by the weighed estimator.

    Attributes
    ----------
    ratios : name -> estimate; empty where there is none, ``note`` says why.
    sd_log : name -> standard deviation of its log, to first order; None: the data don't tell.
    extreme : names within 5 % of a bound, in log.
    training_rmse_mm, left_out_rmse_mm, held_out_rmse_mm : corner RMSE of the frames that it was fitted to, of training
        frames left out and forecast from the others, of the frames held out from all; None: no such frame.
    aic : Akaike's criterion, -2 log likelihood + 2 per ratio.
    """

    parameters: tuple[str, ...]
    ratios: dict[str, float]
    sd_log: dict[str, float | None]
    extreme: tuple[str, ...]
    training_rmse_mm: float | None
    left_out_rmse_mm: float | None
    held_out_rmse_mm: float | None
    aic: float | None
    note: str = ""


class ParameterStudy(OutcomeFile):
    """``parameters.json``: what the six parameters of the paper's Table 3 do, and whether a third ratio pays.

    Attributes
    ----------
    mesh : of all that was computed.
    effects : largest first, of the six.
    gradient : in the order of Table 3. optimum : ratios where the paper's objective is least.
    models : the estimate's ratios, and those with lambda on its own.
    left_out : what was left out at a time; "nothing" where there is but one training frame.
    lambda_prior_sd, lambda_sd : of the log of lambda at a given mu, before and after the fit of the first of the
        models, to which it is an unknown; None: it is none.
    """

    FILE: ClassVar[str] = "parameters.json"
    STEP: ClassVar[str] = "parameters"
    mesh: Mesh
    effects: tuple[ParameterEffect, ...]
    gradient: tuple[GradientRow, ...]
    optimum: dict[str, float]
    models: tuple[ModelScore, ...]
    left_out: Literal["push", "frame", "nothing"]
    lambda_prior_sd: float | None
    lambda_sd: float | None
