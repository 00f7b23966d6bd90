"""A study of parameters as its step would have found it."""

from __future__ import annotations

from spinestiff.study.parameters import SIX
from spinestiff.subject.parameters_outcome import GradientRow, ModelScore, ParameterEffect, ParameterStudy

NAMES = ("lateral_bending", "tissue")


def score(names, error):
    return ModelScore(
        parameters=names, ratios={name: 0.01 * (i + 1) for i, name in enumerate(names)}, sd_log={}, extreme=(),
        training_rmse_mm=0.5, left_out_rmse_mm=error, held_out_rmse_mm=1.5, aic=100.0,
    )  # fmt: skip


STUDY = ParameterStudy(
    mesh="coarse",
    effects=[
        ParameterEffect(name=name, default_mm=0.123, estimate_mm=6.0 - i, share=0.1) for i, name in enumerate(SIX)
    ],
    gradient=[GradientRow(name=name, default=12.0 + i, optimum=-0.25) for i, name in enumerate(SIX)],
    optimum={"intervertebral_bending": 0.11, "tissue": 0.02},
    models=(score(NAMES, 1.0), score(("lateral_bending", "tissue_mu", "tissue_lambda"), 0.99)),
    left_out="frame",
    lambda_prior_sd=1.0,
    lambda_sd=0.98,
)
