"""What an estimate lets expect of the frames held out, with intervals (``estimation.forecast``)."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from spinestiff.estimation.fit import forecast_unseen
from spinestiff.estimation.forecast import Forecast
from spinestiff.study.predictions import Prediction, Predictions
from spinestiff.subject.outcomes import ForecastRecord


def forecasts(
    predictions: Predictions,
    ratios: Mapping[str, float],
    nuisances: Mapping[str, float],
    tracking_factor: float,
    population: str | None = None,
) -> dict[tuple[str, int], Forecast]:
    """Of every frame held out that the estimate predicts, by push and frame.

    Parameters
    ----------
    predictions : with those of the model "fit".
    ratios, nuisances, tracking_factor, population : of a weighed fit of the training frames.

    Raises
    ------
    EquilibriumError : there is no equilibrium at the estimate.
    """
    pushes = predictions.pushes
    unseen = [frame for frame in predictions.of_role("validation") if "fit" in frame.solved]
    if not unseen:
        return {}
    seen = list(pushes.fitted)
    # Where the patient stood for a push without training frames is told by its unloaded frame.
    others = {frame.item.push for frame in unseen} - {item.push for item in seen}
    seen += [item for item in pushes.trials if item.force_n == 0.0 and item.push in others]
    items = [*seen, *(frame.item for frame in unseen)]
    states = {(frame.item.push, frame.item.frame): frame.solved.get("fit") for frame in predictions.frames}
    found = forecast_unseen(
        [pushes.problems[item.push] for item in items],
        [item.trial for item in items],
        range(len(seen), len(items)),
        ratios,
        nuisances,
        tracking_factor,
        pushes.orientation,
        pushes.known.priors,
        pushes.known.geometry,
        pushes.known.taped,
        population,
        [
            pushes.torso.rest_pose if known is None else known.state
            for known in (states.get((item.push, item.frame)) for item in items if item.force_n > 0.0)
        ],
    )
    return {(frame.item.push, frame.item.frame): one for frame, one in zip(unseen, found)}


def forecast_record(frame: Prediction, forecast: Forecast, levels: tuple[str, str] | None) -> ForecastRecord:
    """A forecast as it is written. ``levels``: end vertebrae of the measured change of the Cobb angle."""
    error, sd = None, None
    names = frame.item.trial.corners.vertebrae
    if levels is not None and set(levels) <= set(names):
        expected, spread, found = forecast.turn(*(names.index(level) for level in levels))
        error, sd = round(float(np.degrees(found - expected)), 3), round(float(np.degrees(spread)), 3)
    return ForecastRecord(
        rmse_mm=round(float(np.sqrt(np.mean(np.sum(forecast.corner_errors**2, axis=-1)))), 4),
        sd_mm=round(float(np.sqrt(np.mean(np.sum(forecast.corner_sds**2, axis=-1)))), 4),
        inside95=round(forecast.inside95, 4),
        cobb_error_deg=error,
        cobb_sd_deg=sd,
    )
