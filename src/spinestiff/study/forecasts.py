"""What an estimate lets expect of the frames held out, with intervals (``estimation.forecast``)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from spinestiff.anatomy.state import TorsoState
from spinestiff.curves.tilts import CobbChange, SpineTilts, cobb_change, tilts
from spinestiff.estimation.ended import forecast_unseen
from spinestiff.estimation.fitted import FitEnd
from spinestiff.estimation.forecast import Forecast
from spinestiff.imaging.features import picture_axes, target_features
from spinestiff.imaging.planar import turns
from spinestiff.study.predictions import Prediction, Predictions
from spinestiff.study.trials import PushSet, PushTrial
from spinestiff.subject.assessment_outcome import ForecastRecord
from spinestiff.subject.estimate_outcome import Estimate


def forecasts(predictions: Predictions, estimate: FitEnd) -> dict[tuple[str, int], Forecast]:
    """Of every frame held out that the estimate predicts, by push and frame.

    Parameters
    ----------
    predictions : with those of the model "fit".
    estimate : of a weighed fit of the training frames.

    Raises
    ------
    EquilibriumError : there is no equilibrium at the estimate.
    """
    unseen = [frame for frame in predictions.of_role("validation") if "fit" in frame.solved]
    solved = {(frame.item.push, frame.item.frame): frame.solved.get("fit") for frame in predictions.frames}
    states = {key: found.state for key, found in solved.items() if found is not None}
    items = [frame.item for frame in unseen]
    found = forecast_frames(predictions.pushes, items, estimate, states)
    return {(item.push, item.frame): one for item, one in zip(items, found)}


def forecast_frames(
    pushes: PushSet,
    unseen: Sequence[PushTrial],
    estimate: FitEnd,
    states: Mapping[tuple[str, int], TorsoState] | None = None,
) -> tuple[Forecast, ...]:
    """Of the ``unseen`` frames, which are under load, from a weighed fit of the training frames.

    Parameters
    ----------
    states : to solve from, by push and frame; default the torso at rest.

    Raises
    ------
    EquilibriumError : there is no equilibrium at the estimate.
    """
    if not unseen:
        return ()
    seen = list(pushes.fitted)
    # Where the patient stood for a push without training frames is told by its unloaded frame.
    others = {item.push for item in unseen} - {item.push for item in seen}
    seen += [item for item in pushes.trials if item.force_n == 0.0 and item.push in others]
    items = [*seen, *unseen]
    known = states or {}
    return forecast_unseen(
        *pushes.posed(items),
        range(len(seen), len(items)),
        estimate,
        pushes.orientation,
        pushes.known,
        [known.get((item.push, item.frame), pushes.torso.rest_pose) for item in items if item.force_n > 0.0],
    )


def fit_end(estimate: Estimate) -> FitEnd:
    """Where the weighed fit of a written estimate ended."""
    nuisances = {one.name: one.standard for one in estimate.nuisances}
    return FitEnd(estimate.values, nuisances, estimate.tracking_factor or 1.0, estimate.outlying_vertebrae)


def forecast_change(predictions: Predictions, frame: Prediction, forecast: Forecast) -> CobbChange | None:
    """The change of the Cobb angle from the push's least force that a forecast expects, between the measured levels.

    Each vertebra is rigid: both its endplates turn, from the measured picture of the least force, as its four corners
    turn from there to where they are expected.

    Returns
    -------
    None of the frame of the least force, and with fewer than two vertebrae in both pictures.
    """
    item, pushes = frame.item, predictions.pushes
    measured, reference = predictions.measured_change(item), pushes.reference(item.push).trial
    if measured is None:
        return None
    names, before, view = item.trial.corners.vertebrae, reference.corners, item.trial.view
    common = tuple(name for name in before.vertebrae if name in names)
    rows = [[of.index(name) for name in common] for of in (before.vertebrae, names)]
    axes = np.stack(picture_axes(view), axis=1)
    start = target_features(pushes.torso, reference.view, before, pushes.orientation)[rows[0]]
    expected = (frame.target.z + forecast.corner_errors)[rows[1]]
    turned = turns(start @ axes, expected @ axes)
    rest = tilts(before.vertebrae, before.corners, reference.view).selected(common)
    return cobb_change(rest, SpineTilts(common, rest.superior + turned, rest.inferior + turned), measured.levels)


def forecast_record(frame: Prediction, forecast: Forecast, levels: tuple[str, str] | None) -> ForecastRecord:
    """A forecast as it is written. ``levels``: end vertebrae of the measured change of the Cobb angle."""
    error, sd = None, None
    names = frame.item.trial.corners.vertebrae
    if levels is not None and set(levels) <= set(names):
        expected, spread, found = forecast.turn(*(names.index(level) for level in levels))
        # A turn is from the picture's first axis to its second one, a tilt from the patient's left upwards.
        sense = np.sign(np.linalg.det(np.stack(picture_axes(frame.item.trial.view))))
        error, sd = round(float(np.degrees(sense * (found - expected))), 3), round(float(np.degrees(spread)), 3)
    return ForecastRecord(
        rmse_mm=round(float(np.sqrt(np.mean(np.sum(forecast.corner_errors**2, axis=-1)))), 4),
        sd_mm=round(float(np.sqrt(np.mean(np.sum(forecast.corner_sds**2, axis=-1)))), 4),
        inside95=round(forecast.inside95, 4),
        cobb_error_deg=error,
        cobb_sd_deg=sd,
    )
