"""How well an estimate predicts radiographs it has not seen, beside baselines that need less (paper 5.3)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from spinestiff.anatomy.state import TorsoState
from spinestiff.arrays import Floats
from spinestiff.curves.changes import signed_levels
from spinestiff.curves.tilts import CobbChange
from spinestiff.errors import EquilibriumError, FitError
from spinestiff.estimation.asked import Start
from spinestiff.estimation.fitted import Method
from spinestiff.estimation.forecast import Forecast
from spinestiff.imaging.features import picture_axes, rmse, target_features
from spinestiff.study.fits import fit_pushes
from spinestiff.study.forecasts import forecast_change, forecast_record
from spinestiff.study.predictions import Model, Prediction, Predictions
from spinestiff.study.trials import PushSet, PushTrial
from spinestiff.subject.assessment_outcome import PREDICTORS, CobbChangeRecord, HeldOutFrame

COBB_MODELS = ("default", "fit", "truth")
# The single ratio is found to so much of its standard deviation: what is compared are tenths of a millimetre.
SINGLE_SD = 0.1


def assess(
    predictions: Predictions, forecasts: Mapping[tuple[str, int], Forecast] | None = None
) -> tuple[HeldOutFrame, ...]:
    """Every held-out frame's error by predictor, and its change of the Cobb angle, measured and simulated.

    ``forecasts`` : by push and frame (``study.forecasts``).

    Raises
    ------
    EquilibriumError : the estimate has no equilibrium in a held-out frame.
    """
    known = forecasts or {}
    return tuple(
        _held_out(predictions, found, known.get((found.item.push, found.item.frame)))
        for found in predictions.of_role("validation")
    )


def _held_out(predictions: Predictions, found: Prediction, forecast: Forecast | None) -> HeldOutFrame:
    torso, item = predictions.pushes.torso, found.item
    if "fit" not in found.solved:
        raise EquilibriumError(f"{item.trial.label}: no prediction by the estimate; see the messages of this step")
    errors: dict[str, float | None] = dict.fromkeys(PREDICTORS)
    errors |= {name: round(found.rmse(torso, name), 4) for name in found.solved}
    outside = extrapolated(predictions.pushes, item)
    if outside is not None:
        names, features = outside
        rows = [item.trial.corners.vertebrae.index(n) for n in names]
        errors["extrapolation"] = round(rmse(features, found.target.z[rows]), 4)
    changes = {"measured": predictions.measured_change(item)}
    changes |= {name: predictions.simulated_change(found, name) for name in COBB_MODELS if name in found.solved}
    measured = changes["measured"]
    record = (
        None if forecast is None else forecast_record(found, forecast, None if measured is None else measured.levels)
    )
    errors["forecast"] = None if record is None else record.rmse_mm
    if forecast is not None:
        changes["forecast"] = forecast_change(predictions, found, forecast)
    return HeldOutFrame(
        push=item.push,
        frame=item.frame,
        force_n=item.force_n,
        rmse_mm=errors,
        cobb_change_deg={name: None if change is None else change_record(change) for name, change in changes.items()},
        forecast=record,
    )


def change_record(change: CobbChange) -> CobbChangeRecord:
    """A change of the Cobb angle as it is written."""
    return CobbChangeRecord(
        signed=round(change.signed, 3),
        fixed_levels=round(change.fixed_levels, 3),
        tilt=round(change.tilt, 3),
        levels=change.levels,
        tilt_levels=change.tilt_levels,
        signed_levels=signed_levels(change),
        sds=None if None in change.sds else tuple(round(sd, 3) for sd in change.sds),  # type: ignore[arg-type]
    )


def single_ratio(
    pushes: PushSet,
    start: float = 1.0,
    method: Method = "weighed",
    nuisances: Mapping[str, float] | None = None,
    states: Sequence[TorsoState] | None = None,
) -> Model | None:
    """One common ratio for all stiffnesses, fitted to the training frames from ``start``; None if that fit fails.

    Parameters
    ----------
    nuisances : of an estimate by other ratios, in prior standard deviations, to begin at.
    states : of that estimate in the training frames under load, to solve the start from. With both no fit on a coarse
        torso is needed.
    """
    try:
        fit = fit_pushes(
            replace(pushes, known=replace(pushes.known, population=None)),
            ("everything",),
            Start({"everything": start}, nuisances or {}, states),
            method,
            extent="estimate",
            close_sd=SINGLE_SD,
        )
    except (FitError, EquilibriumError):
        return None
    return Model.of(fit) if fit.status.usable else None


def extrapolated(pushes: PushSet, item: PushTrial) -> tuple[tuple[str, ...], Floats] | None:
    """Features of ``item`` from the training frames alone: each feature moves in proportion to the force.

    The training frames of the same push are taken; without any those of pushes from the same side; without these, those
    from the other side with their motion reversed.

    Returns
    -------
    Vertebra names and (n, 4, 2) mm at the patient plane; None without a training frame under force, and of the frame
    of a push's least force, from which motions are measured.
    """
    numerator: dict[str, Floats] = {}
    squares: dict[str, float] = {}
    for other in _alike(pushes, item):
        start, now = _measured(pushes, pushes.reference(other.push)), _measured(pushes, other)
        force, axes = _signed(other, pushes.reference(other.push)), _axes(other)
        for name in now.keys() & start.keys():
            numerator[name] = numerator.get(name, np.zeros((4, 2))) + force * (now[name] - start[name]) @ axes
            squares[name] = squares.get(name, 0.0) + force**2
    reference = pushes.reference(item.push)
    if reference.frame == item.frame:
        return None
    base, force = _measured(pushes, reference), _signed(item, reference)
    names = tuple(n for n in item.trial.corners.vertebrae if n in base and squares.get(n, 0.0) > 0.0)
    if not names:
        return None
    return names, np.stack([base[n] + force * numerator[n] / squares[n] @ _axes(item).T for n in names])


def _alike(pushes: PushSet, item: PushTrial) -> Sequence[PushTrial]:
    """The training frames that show a motion and are most like a frame: of its push, of its side, or all."""
    training = [other for other in pushes.training if other.frame != pushes.reference(other.push).frame]
    same_push = [other for other in training if other.push == item.push]
    same_side = [other for other in training if _side(other) == _side(item)]
    return same_push or same_side or training


def _side(item: PushTrial) -> float:
    """Above 0 for a push from the right; 0 without a force."""
    return float(np.sign(item.trial.load.push.total[0]))


def _axes(item: PushTrial) -> Floats:
    """(2, 2) columns: the patient's left and up in the picture; two pushes' pictures may be mirrored or turned."""
    return np.stack(picture_axes(item.trial.view), axis=1)


def _signed(item: PushTrial, reference: PushTrial) -> float:
    """Force over the reference's, N, above 0 for a push from the right."""
    return _side(item) * (item.force_n - reference.force_n)


def _measured(pushes: PushSet, item: PushTrial) -> dict[str, Floats]:
    features = target_features(pushes.torso, item.trial.view, item.trial.corners, pushes.orientation)
    return dict(zip(item.trial.corners.vertebrae, features))
