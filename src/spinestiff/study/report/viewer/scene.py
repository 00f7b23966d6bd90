"""What the 3D viewer shows: bones, skin, joints, pushes, supports, and what was seen.

Lengths are mm in the world frame (docs/conventions.md), forces N.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from spinestiff.anatomy.state import TorsoState
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.arrays import Floats
from spinestiff.curves.pushes import reading_of
from spinestiff.estimation.objective import make_target
from spinestiff.estimation.sights import MarkerTarget, PedicleTarget, Sight, further_sights, sight_residuals
from spinestiff.imaging.projection import XRayView
from spinestiff.mechanics.loads import LoadCase
from spinestiff.mechanics.supports import SupportKind, Supports
from spinestiff.study.predictions import REST, Prediction, Predictions, Solved
from spinestiff.study.report.placing import view_of
from spinestiff.study.trials import PushSet, PushTrial

MODELS = ("fit", "default")


@dataclass(frozen=True)
class Outlines:
    """Vertebrae in a radiograph from another side, mm at the patient plane of its view.

    Attributes
    ----------
    vertebrae : (Nv,) names. boxes : (Nv, 4, 2).
    pedicles : (2,) by name, as "T8 left".
    """

    vertebrae: tuple[str, ...]
    boxes: Floats
    pedicles: Mapping[str, Floats] = field(default_factory=dict)


@dataclass(frozen=True)
class Beside:
    """What a frame shows beside its frontal corners, as measured or as a model has it.

    Attributes
    ----------
    pedicles : (2,) mm at the patient plane by name, as "T8 left", in the frontal radiograph.
    outlines : of vertebrae in further views, by the view's id.
    markers : (3,) mm by name, on the skin; measured ones from where the model has them under the push's least force,
        since only their motion is known.
    """

    pedicles: Mapping[str, Floats] = field(default_factory=dict)
    outlines: Mapping[str, Outlines] = field(default_factory=dict)
    markers: Mapping[str, Floats] = field(default_factory=dict)


@dataclass(frozen=True)
class Frame:
    """A measured frame of a push.

    Attributes
    ----------
    frame, force_n, role : as in ``subject.json``.
    vertebrae : (Nv,) names. measured : (Nv, 4, 2) mm at the patient plane.
    rmse_mm : by model, where it found an equilibrium.
    cobb : the Cobb angle measured in it, in words.
    beside : what else it shows, measured.
    """

    frame: int
    force_n: float
    role: str
    vertebrae: tuple[str, ...]
    measured: Floats
    rmse_mm: Mapping[str, float]
    cobb: str = ""
    beside: Beside = Beside()


@dataclass(frozen=True)
class Step:
    """A model's equilibrium under one force.

    Attributes
    ----------
    force_n : magnitude. frame : the measured frame it belongs to, or None.
    state : where everything is.
    vertebrae : (Nv,) names. boxes : (Nv, 4, 2) mm at the patient plane, as they are compared with the measured ones.
    reactions : (S, 3) N, in the order of ``PushScene.supports``.
    beside : the same of what else the frame shows.
    """

    force_n: float
    frame: int | None
    state: TorsoState
    vertebrae: tuple[str, ...]
    boxes: Floats
    reactions: Floats
    beside: Beside = Beside()


@dataclass(frozen=True)
class Support:
    """Where the torso is held: a point on a bone, and the direction it is held along (None: the bone as a whole)."""

    name: str
    kind: SupportKind
    bone: int
    offset: Floats
    direction: Floats | None


@dataclass(frozen=True)
class PushScene:
    """One push: its frames, and each model's way from rest to full load.

    Attributes
    ----------
    push, side, level : as in ``subject.json``.
    view : of its radiographs, moved to where the patient stood. further : those from other sides, by id.
    load : points and forces per N of push.
    supports : see ``Support``.
    frames : by force.
    models : "fit", "default" -> steps by force, the first at rest.
    """

    push: str
    side: str
    level: float
    view: XRayView
    load: LoadCase
    supports: tuple[Support, ...]
    frames: tuple[Frame, ...]
    models: Mapping[str, tuple[Step, ...]]
    further: Mapping[str, XRayView] = field(default_factory=dict)


@dataclass(frozen=True)
class Scene:
    """A torso, and what was done to it.

    Attributes
    ----------
    title : of whom or what, in words. note : what is missing, or empty.
    torso : at rest.
    pushes : none for a torso alone.
    """

    title: str
    torso: TorsoModel
    pushes: tuple[PushScene, ...] = ()
    note: str = ""


def visit_scene(title: str, predictions: Predictions, levels: Mapping[str, tuple[str, float]]) -> Scene:
    """The scene of a visit with an estimate.

    Parameters
    ----------
    predictions : what the models make of the frames under force.
    levels : push id -> pushed side and rib level.
    """
    pushes = predictions.pushes
    made = {(p.item.push, p.item.frame): p for p in predictions.frames}
    scenes = []
    for push, problem in pushes.problems.items():
        trials = sorted((t for t in pushes.trials if t.push == push), key=lambda t: (t.force_n, t.frame))
        supports = _supports(pushes.torso, problem.supports)
        frames, steps = [], {name: [] for name in MODELS}  # type: ignore[var-annotated]
        if trials[0].force_n > 0.0:
            start = _at_rest(pushes, trials[0], len(supports))
            for name in MODELS:
                steps[name].append(Step(0.0, None, start.state, start.vertebrae, start.boxes, start.reactions))
        for trial in trials:
            prediction = made.get((push, trial.frame))
            if prediction is None:
                found = {name: _at_rest(pushes, trial, len(supports)) for name in MODELS}
                frames.append(_frame(predictions, _resting(pushes, trial), dict.fromkeys(MODELS, REST)))
            else:
                known = [name for name in MODELS if name in prediction.solved]
                found = {name: _step(pushes, prediction, name, supports) for name in known}
                frames.append(_frame(predictions, prediction, {name: name for name in known}))
            for name, step in found.items():
                steps[name].append(step)
        largest = max(trials, key=lambda t: t.force_n)
        load = largest.trial.load
        unit = load.scaled(1.0 / load.push.size) if load.size else load
        side, level = levels[push]
        models = {name: tuple(found) for name, found in steps.items() if len(found) > 1}
        further = {view_of(one.sequence): one.view for trial in trials for one in trial.trial.further}
        scenes.append(
            PushScene(push, side, level, trials[0].trial.view, unit, supports, tuple(frames), models, further)
        )
    return Scene(title, pushes.torso, tuple(scene for scene in scenes if scene.models))


def _supports(torso: TorsoModel, supports: Supports) -> tuple[Support, ...]:
    springs = supports.springs
    held = [
        Support(torso.bone_names[bone], SupportKind.HELD, int(bone), np.zeros(3), None)
        for bone in np.flatnonzero(supports.held.any(1))
    ]
    points = springs.points
    return (
        *held,
        *(
            Support(name, kind, int(points.bone[i]), points.offset[i], springs.directions[i])
            for i, (name, kind) in enumerate(zip(supports.names, supports.kinds))
        ),
    )


def _resting(pushes: PushSet, trial: PushTrial) -> Prediction:
    """A frame without force, as the torso at rest makes it."""
    at_rest = Solved(pushes.torso.rest_pose, np.zeros((0, 3)))
    return Prediction(trial, make_target(pushes.torso, trial.trial, pushes.orientation), {REST: at_rest})


def _at_rest(pushes: PushSet, trial: PushTrial, supports: int) -> Step:
    torso, names = pushes.torso, trial.trial.corners.vertebrae
    resting = _resting(pushes, trial)
    beside = _simulated_beside(pushes, resting, torso.rest_pose)
    return Step(0.0, trial.frame, torso.rest_pose, names, resting.boxes(torso, REST), np.zeros((supports, 3)), beside)


def _step(pushes: PushSet, prediction: Prediction, name: str, supports: Sequence[Support]) -> Step:
    item, torso = prediction.item, pushes.torso
    solved, names = prediction.solved[name], item.trial.corners.vertebrae
    # Both lists: held bones, then springs.
    assert len(solved.reactions) == len(supports)
    boxes = prediction.boxes(torso, name)
    beside = _simulated_beside(pushes, prediction, solved.state)
    return Step(item.force_n, item.frame, solved.state, names, boxes, solved.reactions, beside)


def _beside(pushes: PushSet, prediction: Prediction, places: Callable[[Sight], Floats]) -> Beside:
    """What a frame shows beside its frontal corners.

    Parameters
    ----------
    places : of a sight's points: (P, 4, 2) or (P, 2) mm at the patient plane, markers (P, 3) mm, NaN where unknown.
    """
    boxes: dict[str, tuple[tuple[str, ...], Floats]] = {}
    pedicles: dict[str, Mapping[str, Floats]] = {}
    markers: dict[str, Floats] = {}
    for sight in further_sights([pushes.torso], [prediction.target], pushes.orientation):
        target, found = sight.target, places(sight.target)
        if isinstance(target, MarkerTarget):
            markers = _markers_by_name(target, found)
        elif isinstance(target, PedicleTarget):
            pedicles[sight.sequence] = _pedicles_by_name(pushes.torso, target, found)
        else:
            boxes[sight.sequence] = target.trial.corners.vertebrae, found
    outlines = {
        view_of(sequence): Outlines(names, quads, pedicles.get(sequence, {}))
        for sequence, (names, quads) in boxes.items()
    }
    return Beside(pedicles.get(prediction.target.trial.push, {}), outlines, markers)


def _simulated_beside(pushes: PushSet, prediction: Prediction, state: TorsoState) -> Beside:
    return _beside(
        pushes, prediction, lambda target: target.z + sight_residuals(pushes.torso, target, state).difference
    )


def _measured_beside(predictions: Predictions, prediction: Prediction) -> Beside:
    pushes, item = predictions.pushes, prediction.item
    first, start = pushes.reference(item.push).trial.markers, predictions.before(item, MODELS[0])

    def places(target: Sight) -> Floats:
        if not isinstance(target, MarkerTarget):
            return np.asarray(target.z)
        if first is None or start is None:
            return np.full_like(target.z, np.nan)
        moved = target.z - first.positions[target.rows]
        return np.asarray(target.points.positions(pushes.torso, start) + moved)

    return _beside(pushes, prediction, places)


def _markers_by_name(target: MarkerTarget, places: Floats) -> dict[str, Floats]:
    seen = target.trial.markers
    assert seen is not None
    return {seen.names[row]: place for row, place in zip(target.rows, places) if np.isfinite(place).all()}


def _pedicles_by_name(torso: TorsoModel, target: PedicleTarget, places: Floats) -> dict[str, Floats]:
    sides = np.where(target.outward > 0.0, "left", "right")
    return {f"{torso.vertebrae[row]} {side}": place for row, side, place in zip(target.rows, sides, places)}


def _frame(predictions: Predictions, prediction: Prediction, states: Mapping[str, str]) -> Frame:
    item, torso = prediction.item, predictions.pushes.torso
    errors = {name: prediction.rmse(torso, state) for name, state in states.items()}
    return Frame(
        item.frame,
        item.force_n,
        item.role,
        item.trial.corners.vertebrae,
        np.asarray(prediction.target.z),
        errors,
        reading_of(item.trial.label, item.trial.corners, item.trial.view).words(),
        _measured_beside(predictions, prediction),
    )
