"""How well an estimate predicts radiographs it has not seen, beside baselines that need less (paper 5.3)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from spinestiff.anatomy.stiffness import StiffnessRatios, stiffness_ratios
from spinestiff.anatomy.torso import TorsoState
from spinestiff.arrays import Floats
from spinestiff.curves.tilts import CobbChange, SpineTilts, cobb_change, tilts
from spinestiff.errors import EquilibriumError, FitError
from spinestiff.estimation.fit import fit_stiffness
from spinestiff.estimation.objective import Target, make_target, residuals
from spinestiff.imaging.features import rmse, state_features, target_features, vertebra_rows
from spinestiff.mechanics.equilibrium import Equilibrium
from spinestiff.study.trials import PushSet, PushTrial

Observer = Callable[[str], None]
BASELINES = ("rest", "default", "fit", "extrapolation", "single_ratio", "truth")


@dataclass(frozen=True)
class FrameAssessment:
    """One held-out frame.

    Attributes
    ----------
    push, frame, force_n : which.
    rmse_mm : by predictor (``BASELINES``), corner RMSE at the patient plane; None where it makes no prediction.
    cobb_change_deg : "measured", "default", "fit" (and "truth" where known): change from the unloaded frame.
    states : simulated states by predictor, for pictures.
    """

    push: str
    frame: int
    force_n: float
    rmse_mm: Mapping[str, float | None]
    cobb_change_deg: Mapping[str, CobbChange | None]
    states: Mapping[str, TorsoState]

    def as_record(self) -> dict[str, object]:
        """As written to ``assessment.json``."""
        cobb = {
            name: None
            if change is None
            else {
                "signed": round(change.signed, 3),
                "fixed_levels": round(change.fixed_levels, 3),
                "tilt": round(change.tilt, 3),
                "levels": [change.rest.upper, change.rest.lower],
                "tilt_levels": list(change.tilt_levels),
            }
            for name, change in self.cobb_change_deg.items()
        }
        errors = {name: None if value is None else round(value, 4) for name, value in self.rmse_mm.items()}
        return {
            "push": self.push,
            "frame": self.frame,
            "force_n": self.force_n,
            "rmse_mm": errors,
            "cobb_change_deg": cobb,
        }


def assess(
    pushes: PushSet,
    ratios: StiffnessRatios,
    truth: Mapping[str, float] | None = None,
    observer: Observer | None = None,
) -> tuple[FrameAssessment, ...]:
    """Predict every validation frame and compare with what was measured.

    Parameters
    ----------
    pushes : all trials of the subject.
    ratios : the estimate.
    truth : true ratios of a synthetic subject (the "oracle": truth on the estimator's own mesh and geometry).
    """
    say = observer or (lambda line: None)
    kinds = pushes.torso.joints.kinds
    models: dict[str, StiffnessRatios | None] = {"default": None, "fit": ratios}
    say("fitting the one-ratio baseline")
    single = single_ratio(pushes, float(np.exp(np.mean(np.log(ratios.values)))))
    if single is not None:
        models["single_ratio"] = single
    if truth is not None:
        models["truth"] = stiffness_ratios(truth, kinds)
    frames = []
    last: dict[tuple[str, str], TorsoState] = {}
    for item in pushes.of_role("validation"):
        say(f"push '{item.push}' frame {item.frame}: predicting {item.force_n:.0f} N")
        states = {"rest": pushes.torso.rest_pose}
        starts = {}
        for name, model in models.items():
            found = _predict(pushes, item, model, last.get((name, item.push)))
            if found.converged:
                states[name] = last[(name, item.push)] = found.state
                starts[name] = _start(pushes, item.push, model)
            elif name == "fit":
                raise EquilibriumError(f"{item.trial.label}: no prediction by the estimate: {found.status.value}")
            else:
                say(f"{item.trial.label}: no prediction by '{name}': {found.status.value}")
        frames.append(_compare(pushes, item, states, starts))
    return tuple(frames)


def single_ratio(pushes: PushSet, start: float = 1.0) -> StiffnessRatios | None:
    """One common ratio for all stiffnesses, fitted to the training frames from ``start``; None if that fit fails."""
    training = pushes.training
    try:
        fit = fit_stiffness(
            [pushes.problems[t.push] for t in training],
            [t.trial for t in training],
            ("everything",),
            start={"everything": start},
            intervals="linear",
        )
    except (FitError, EquilibriumError):
        return None
    return fit.ratios if fit.status.usable else None


def extrapolated(pushes: PushSet, item: PushTrial) -> tuple[tuple[str, ...], Floats] | None:
    """Features of ``item`` from the training frames alone: each feature moves in proportion to the force.

    The training frames of the same push are taken; without any those of pushes from the same side; without these, those
    from the other side with their motion reversed.

    Returns
    -------
    Vertebra names and (n, 4, 2) mm at the patient plane; None without a training frame under force.
    """
    numerator: dict[str, Floats] = {}
    squares: dict[str, float] = {}
    for other in _alike(pushes, item):
        start, now = _measured(pushes, pushes.reference(other.push)), _measured(pushes, other)
        force = _signed(other, pushes.reference(other.push))
        for name in now.keys() & start.keys():
            numerator[name] = numerator.get(name, np.zeros((4, 2))) + force * (now[name] - start[name])
            squares[name] = squares.get(name, 0.0) + force**2
    reference = pushes.reference(item.push)
    base, force = _measured(pushes, reference), _signed(item, reference)
    names = tuple(n for n in item.trial.corners.vertebrae if n in base and squares.get(n, 0.0) > 0.0)
    if not names:
        return None
    return names, np.stack([base[n] + force * numerator[n] / squares[n] for n in names])


def _alike(pushes: PushSet, item: PushTrial) -> Sequence[PushTrial]:
    """The training frames under force that are most like a frame: of its push, of its side, or all."""
    training = pushes.training
    same_push = [other for other in training if other.push == item.push]
    same_side = [other for other in training if _side(other) == _side(item)]
    return same_push or same_side or training


def _side(item: PushTrial) -> float:
    """Above 0 for a push from the right; 0 without a force."""
    return float(np.sign(item.trial.load.forces[:, 0].sum()))


def _signed(item: PushTrial, reference: PushTrial) -> float:
    """Force over the reference's, N, above 0 for a push from the right."""
    return _side(item) * (item.force_n - reference.force_n)


def _measured(pushes: PushSet, item: PushTrial) -> dict[str, Floats]:
    features = target_features(pushes.torso, item.trial.view, item.trial.corners)
    return dict(zip(item.trial.corners.vertebrae, features))


def _predict(pushes: PushSet, item: PushTrial, model: StiffnessRatios | None, start: TorsoState | None) -> Equilibrium:
    return pushes.problems[item.push].solve(item.trial.load, model, start)


def _start(pushes: PushSet, push: str, model: StiffnessRatios | None) -> TorsoState:
    """What a model makes of the frame that changes are measured from: at rest, unless even that one is loaded."""
    reference = pushes.reference(push)
    if reference.force_n == 0.0:
        return pushes.torso.rest_pose
    return _predict(pushes, reference, model, None).require().state


def _compare(
    pushes: PushSet, item: PushTrial, states: Mapping[str, TorsoState], starts: Mapping[str, TorsoState]
) -> FrameAssessment:
    target = make_target(pushes.torso, item.trial)
    errors: dict[str, float | None] = dict.fromkeys(BASELINES)
    for name, state in states.items():
        errors[name] = residuals(pushes.torso, target, state).rmse
    outside = extrapolated(pushes, item)
    if outside is not None:
        names, features = outside
        rows = [item.trial.corners.vertebrae.index(n) for n in names]
        errors["extrapolation"] = rmse(features, target.z[rows])
    reference = pushes.reference(item.push)
    common = tuple(v for v in item.trial.corners.vertebrae if v in reference.trial.corners.vertebrae)
    changes: dict[str, CobbChange | None] = {"measured": _measured_change(pushes, reference, item, common)}
    for name in ("default", "fit", "truth"):
        if name in states:
            before = _simulated_tilts(pushes, target, starts[name], common)
            changes[name] = cobb_change(before, _simulated_tilts(pushes, target, states[name], common))
        elif name != "truth":
            changes[name] = None
    return FrameAssessment(item.push, item.frame, item.force_n, errors, changes, dict(states))


def _measured_change(
    pushes: PushSet, reference: PushTrial, item: PushTrial, common: tuple[str, ...]
) -> CobbChange | None:
    """From placed boxes, as the simulated change is: the corners' own endplates carry the annotation's noise twice."""
    if len(common) < 2:
        return None
    view = item.trial.view
    before, after = (
        tilts(common, target_features(pushes.torso, view, t.trial.corners.selected(common)), view)
        for t in (reference, item)
    )
    return cobb_change(before, after)


def _simulated_tilts(pushes: PushSet, target: Target, state: TorsoState, common: tuple[str, ...]) -> SpineTilts:
    view = target.trial.view
    seen = state_features(pushes.torso, view, state, target.shares)
    rows = vertebra_rows(pushes.torso, target.trial.corners.selected(common))
    return tilts(common, seen.z[rows], view)
