"""Every frame of a visit as the models make it: equilibria beside what was measured, each solved once and stored."""

from __future__ import annotations

import json
import zlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from zipfile import BadZipFile

import numpy as np

from spinestiff.anatomy.state import TorsoState
from spinestiff.anatomy.stiffness import StiffnessRatios
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.arrays import Floats, ShortRepr
from spinestiff.curves.changes import change_between
from spinestiff.curves.tilts import CobbChange, cobb_change, tilts
from spinestiff.errors import EquilibriumError, SpinestiffError, SubjectError
from spinestiff.estimation.evaluation import FOLDED, acted
from spinestiff.estimation.fitted import StiffnessFit
from spinestiff.estimation.objective import Target, make_target, residuals
from spinestiff.estimation.unknowns import ACTS, PLACING, acts_by_name, unknowns_of
from spinestiff.files import write_bytes
from spinestiff.imaging.features import state_features, vertebra_rows
from spinestiff.mechanics.equilibrium import Equilibrium
from spinestiff.mechanics.places import shoulder_force
from spinestiff.mechanics.sensitivity import Linearisation
from spinestiff.observer import Observer
from spinestiff.parallel import in_parallel
from spinestiff.study.trials import PushSet, PushTrial

REST = "rest"
# Supports fitted to a held-out frame move by less than so many prior standard deviations in the end, or are not told.
FITTED_ROUNDS, FITTED_TO = 6, 0.02
STATES_SCHEMA = "spinestiff-states-1"
_FIELDS = ("bone_positions", "bone_rotations", "tissue_positions")


@dataclass(frozen=True, repr=False)
class Solved(ShortRepr):
    """An equilibrium as later steps need it.

    Attributes
    ----------
    state : where everything is.
    reactions : (R, 3) N, what held bones and then the supports' springs exert, in the order of the solve's reactions.
    """

    state: TorsoState
    reactions: Floats

    @classmethod
    def of(cls, equilibrium: Equilibrium) -> Solved:
        """From what a solve gave."""
        forces = np.array([reaction.force for reaction in equilibrium.reactions]).reshape(-1, 3)
        return cls(equilibrium.state, forces)


Key = tuple[str, int, str]
"""Push, frame and model: "default", "fit", "fitted_supports", "single_ratio" or "truth"."""


@dataclass(frozen=True)
class Model:
    """What predicts a frame.

    Attributes
    ----------
    ratios : of stiffness; None = default.
    known : what a fit found of what is not quite known, by name, in prior standard deviations
        (``estimation.unknowns``). A frame takes what it shares with the fit's frames, e.g. how far the supports give
        under a force from its side, and what was measured of its own supports, never what its vertebrae show.
    """

    ratios: StiffnessRatios | None = None
    known: Mapping[str, float] = field(default_factory=dict)

    @classmethod
    def of(cls, fit: StiffnessFit) -> Model:
        """The model that a fit found."""
        return cls(fit.ratios, fit.standard_nuisances)


def predicted_acts(pushes: PushSet, items: Sequence[PushTrial], model: Model) -> Floats:
    """(T, len(ACTS)) of frames as a model expects them.

    Supports that were measured in a frame are where that and the prediction together put them.
    """
    problems, trials = pushes.posed(items)
    unknowns = unknowns_of(problems, trials, pushes.known.priors, pushes.known.taped)
    acts = np.array(acts_by_name(unknowns, model.known))
    if not model.known:
        return acts
    open_ = np.array([name not in model.known for name in unknowns.names])
    for i, trial in enumerate(trials):
        for name, (value, sd) in trial.supports.items():
            act = ACTS.index(name)
            # What the fit has not seen of this frame; what it has seen counts as known.
            variance = float(np.sum(unknowns.acts[i, act, open_] ** 2))
            acts[i, act] += variance / (variance + sd**2) * (value - acts[i, act])
    return acts


@dataclass(frozen=True)
class Prediction:
    """A frame with what the models make of it.

    Attributes
    ----------
    item : the frame.
    target : its measured features.
    solved : by model, where an equilibrium was found; "rest" is the torso at rest, without reactions.
    """

    item: PushTrial
    target: Target
    solved: Mapping[str, Solved]

    @property
    def states(self) -> dict[str, TorsoState]:
        """State by model, "rest" among them."""
        return {name: found.state for name, found in self.solved.items()}

    def boxes(self, torso: TorsoModel, name: str) -> Floats:
        """(Nv, 4, 2) mm at the patient plane, simulated boxes of the measured vertebrae."""
        target = self.target
        state, view = self.solved[name].state, target.trial.view
        return state_features(torso, view, state, target.shares, target.orientation, target.used).z[target.rows]

    def rmse(self, torso: TorsoModel, name: str) -> float:
        """Corner RMSE of a model, mm at the patient plane."""
        return residuals(torso, self.target, self.solved[name].state).rmse


@dataclass(frozen=True)
class Predictions:
    """What the models make of every frame under force, in the order of the trials."""

    pushes: PushSet
    frames: tuple[Prediction, ...]

    def of_role(self, *roles: str) -> tuple[Prediction, ...]:
        return tuple(frame for frame in self.frames if frame.item.role in roles)

    def before(self, item: PushTrial, name: str) -> TorsoState | None:
        """What a model makes of the frame that changes are measured from: at rest, unless even that one is loaded."""
        reference = self.pushes.reference(item.push)
        if reference.force_n == 0.0:
            return self.pushes.torso.rest_pose
        found = next(p for p in self.frames if p.item.push == item.push and p.item.frame == reference.frame)
        return found.states.get(name)

    def measured_change(self, item: PushTrial) -> CobbChange | None:
        """The measured change of the Cobb angle from the push's least force; None of the frame of that force."""
        reference = self.pushes.reference(item.push)
        if reference.frame == item.frame:
            return None
        alike = self.pushes.annotated_frame(reference) == self.pushes.annotated_frame(item)
        return change_between(item.trial.view, reference.trial.corners, item.trial.corners, same_origin=alike)

    def simulated_change(self, prediction: Prediction, name: str) -> CobbChange | None:
        """The same of a model, of the corners that the picture would show, between the end vertebrae measured."""
        measured, after = self.measured_change(prediction.item), prediction.states.get(name)
        before = self.before(prediction.item, name)
        if measured is None or before is None or after is None:
            return None
        torso, item, target = self.pushes.torso, prediction.item, prediction.target
        reference = self.pushes.reference(item.push)
        common = tuple(v for v in reference.trial.corners.vertebrae if v in item.trial.corners.vertebrae)
        rows = vertebra_rows(torso, item.trial.corners.selected(common))
        rest, pushed = (
            tilts(common, state_features(torso, item.trial.view, state, target.shares).corners[rows], item.trial.view)
            for state in (before, after)
        )
        return cobb_change(rest, pushed, measured.levels)


def predict(
    pushes: PushSet,
    models: Mapping[str, Model],
    known: Mapping[Key, Solved],
    say: Observer,
    everywhere: Sequence[str] = ("default", "fit"),
) -> Predictions:
    """Every frame under force by every model; each push is solved from its least force up.

    Parameters
    ----------
    models : by name.
    known : what is solved already.
    everywhere : models of all frames. The others predict the frames held out only, of each push from what "fit" has in
        the first, to which they are closer than to rest where tissue creases.
    """
    items = sorted((t for t in pushes.trials if t.force_n > 0.0), key=lambda t: (t.push, t.force_n))
    acts = {name: predicted_acts(pushes, items, model) for name, model in models.items()}

    solved = dict(known)

    def of_push(chain: tuple[str, str]) -> dict[Key, Solved]:
        push, name = chain
        found: dict[Key, Solved] = {}
        last: TorsoState | Linearisation | None = None
        for number, item in enumerate(items):
            if item.push != push or (name not in everywhere and item.role != "validation"):
                continue
            key, fit = (push, item.frame, name), solved.get((push, item.frame, "fit"))
            if key in known:
                last = known[key].state
                continue
            if last is None and fit is not None and name not in everywhere:
                last = fit.state
            say(f"push '{push}' frame {item.frame}: {name} at {item.force_n:.0f} N")
            ratios, own = models[name].ratios, acts[name][number]
            try:
                asked, load, ratios = acted(pushes.problems[push], item.trial.load, ratios, own)
                # On the tangent of the frame before, which takes half the factorisations of a start from its state.
                solution, last = asked.solve_linearised(load, ratios, last, largest_turn=FOLDED)
            except EquilibriumError as error:
                say(f"{item.trial.label}: no prediction by '{name}': {error}")
                continue
            found[key] = Solved.of(solution)
        return found

    for of_all in (True, False):
        names = [name for name in models if (name in everywhere) == of_all]
        chains = [(push, name) for push in dict.fromkeys(item.push for item in items) for name in names]
        for found in in_parallel(of_push, chains):
            solved |= found
    return predictions_of(pushes, solved)


def predictions_of(pushes: PushSet, solved: Mapping[Key, Solved]) -> Predictions:
    """Every frame under force with the equilibria that are known for it."""
    frames = []
    for item in (t for t in pushes.trials if t.force_n > 0.0):
        own = {name: found for (push, frame, name), found in solved.items() if (push, frame) == (item.push, item.frame)}
        at_rest = Solved(pushes.torso.rest_pose, np.zeros((0, 3)))
        target = make_target(pushes.torso, item.trial, pushes.orientation)
        frames.append(Prediction(item, target, {REST: at_rest, **own}))
    return Predictions(pushes, tuple(frames))


def stored(predictions: Predictions) -> dict[Key, Solved]:
    """All that was solved, by push, frame and model."""
    return {
        (p.item.push, p.item.frame, name): found
        for p in predictions.frames
        for name, found in p.solved.items()
        if name != REST
    }


def write_solved(path: Path, solved: Mapping[Key, Solved]) -> None:
    """Write equilibria; the same ones give the same bytes. Raises SubjectError if the file can't be written."""
    keys = sorted(solved)
    arrays = {"keys": np.array(json.dumps({"schema": STATES_SCHEMA, "keys": keys}))}
    for number, key in enumerate(keys):
        arrays |= {f"{number}_{name}": getattr(solved[key].state, name) for name in _FIELDS}
        arrays[f"{number}_reactions"] = solved[key].reactions
    content = BytesIO()
    np.savez_compressed(content, **arrays)  # type: ignore[arg-type]
    write_bytes(path, content.getvalue())


def read_solved(path: Path) -> dict[Key, Solved]:
    """Equilibria that ``write_solved`` wrote.

    Raises
    ------
    SubjectError : no such file, or not one of these.
    """
    try:
        # Opened here: np.load leaves a damaged file open.
        with path.open("rb") as stream, np.load(stream, allow_pickle=False) as found:
            header = json.loads(str(found["keys"]))
            if header["schema"] != STATES_SCHEMA:
                raise SubjectError(f"{path}: schema '{header['schema']}', wanted '{STATES_SCHEMA}'; run spinestiff run")
            return {
                (push, frame, model): Solved(
                    TorsoState(**{name: found[f"{number}_{name}"] for name in _FIELDS}), found[f"{number}_reactions"]
                )
                for number, (push, frame, model) in enumerate(header["keys"])
            }
    except SubjectError:
        raise
    except (OSError, BadZipFile, zlib.error, EOFError, KeyError, ValueError, TypeError, SpinestiffError) as error:
        raise SubjectError(
            f"{path}: holds no equilibria ({' '.join(str(error).split())}); run spinestiff run"
        ) from None


def of_equilibria(items: Iterable[PushTrial], equilibria: Iterable[Equilibrium], name: str) -> dict[Key, Solved]:
    """Equilibria of a fit by push, frame and model; none where the fit had none."""
    return {(item.push, item.frame, name): Solved.of(found) for item, found in zip(items, equilibria)}


def with_fitted_supports(predictions: Predictions, model: Model) -> Predictions:
    """Held-out frames with pelvis and shoulder also where their own vertebrae show them best.

    It says how much of a prediction's error the supports may be, and is no prediction. A support that is no unknown
    stays; nothing is added where neither is one, and to no frame in which they do not settle.
    """
    pushes = predictions.pushes
    frames = [f for f in predictions.of_role("validation") if "fit" in f.solved]
    acts = predicted_acts(pushes, [frame.item for frame in frames], model)
    priors = pushes.known.priors
    every = np.array([np.deg2rad(priors.obliquity_deg), priors.shoulder_mm])
    unknown = np.flatnonzero(every)
    places, sds = [ACTS.index(PLACING[i]) for i in unknown], every[unknown]
    if not len(unknown):
        return predictions

    def placed(tangent: Linearisation) -> Floats:
        # A pelvis that is no unknown may be free to turn, and then has no derivative.
        if not every[0]:
            return tangent.forward(changes=[shoulder_force(tangent.system.supports)])
        return tangent.place_derivative()[:, unknown]

    def fitted(which: int) -> Solved | None:
        frame, expected = frames[which], acts[which]
        item, problem = frame.item, pushes.problems[frame.item.push]
        found, state = expected.copy(), frame.solved["fit"].state
        for _ in range(FITTED_ROUNDS):
            try:
                asked, load, ratios = acted(problem, item.trial.load, model.ratios, found)
                equilibrium, tangent = asked.solve_linearised(load, ratios, state, largest_turn=FOLDED)
            except EquilibriumError:
                return None
            state, part = equilibrium.state, residuals(pushes.torso, frame.target, equilibrium.state)
            sure = np.sqrt(np.repeat(part.quality, 8)) / priors.annotation_mm
            columns = part.along(placed(tangent)) * sds
            away = (found[places] - expected[places]) / sds
            # As sure of a corner as of one set by hand, and less sure where tracking was.
            rows = np.vstack([sure[:, None] * columns, np.eye(len(unknown))])
            step = np.linalg.lstsq(rows, -np.concatenate([sure * part.values, away]), rcond=None)[0]
            if np.abs(step).max() < FITTED_TO:
                return Solved.of(equilibrium)
            found[places] += sds * step
        return None

    solved = dict(stored(predictions))
    for frame, found in zip(frames, in_parallel(fitted, range(len(frames)))):
        if found is not None:
            solved[frame.item.push, frame.item.frame, "fitted_supports"] = found
    return predictions_of(pushes, solved)
