"""Every frame of a visit as default and estimated stiffness make it: equilibria beside what was measured."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from spinestiff.anatomy.stiffness import StiffnessRatios
from spinestiff.anatomy.torso import TorsoModel, TorsoState
from spinestiff.arrays import Floats
from spinestiff.estimation.objective import Target, make_target, residuals
from spinestiff.imaging.features import state_features
from spinestiff.mechanics.supports import Reaction
from spinestiff.study.trials import PushSet, PushTrial

Observer = Callable[[str], None]


@dataclass(frozen=True)
class Prediction:
    """A frame with what the models make of it.

    Attributes
    ----------
    item : the frame.
    target : its measured features.
    states : "rest", "default", "fit" where an equilibrium was found.
    reactions : what the supports exert in the "default" and "fit" states.
    """

    item: PushTrial
    target: Target
    states: Mapping[str, TorsoState]
    reactions: Mapping[str, tuple[Reaction, ...]]

    def boxes(self, torso: TorsoModel, name: str) -> Floats:
        """(Nv, 4, 2) mm at the patient plane, simulated boxes of the measured vertebrae."""
        target = self.target
        seen = state_features(torso, target.trial.view, self.states[name], target.shares, used=target.used)
        return seen.z[target.rows]

    def rmse(self, torso: TorsoModel, name: str) -> float:
        """Corner RMSE of a model, mm at the patient plane."""
        return residuals(torso, self.target, self.states[name]).rmse


def predict(pushes: PushSet, ratios: StiffnessRatios, say: Observer) -> tuple[Prediction, ...]:
    """Every frame under force, in the order of the trials; each push is solved from its least force up.

    Parameters
    ----------
    pushes : the trials.
    ratios : the estimate ("fit"); "default" has default stiffness.
    """
    loaded = [t for t in pushes.trials if t.force_n > 0.0]
    done = []
    last: dict[tuple[str, str], TorsoState] = {}
    for item in sorted(loaded, key=lambda t: (t.push, t.force_n)):
        say(f"push '{item.push}' frame {item.frame}: {item.force_n:.0f} N")
        states, reactions = {"rest": pushes.torso.rest_pose}, {}
        for name, model in (("default", None), ("fit", ratios)):
            found = pushes.problems[item.push].solve(item.trial.load, model, last.get((name, item.push)))
            if found.converged:
                states[name] = last[(name, item.push)] = found.state
                reactions[name] = found.reactions
        done.append(Prediction(item, make_target(pushes.torso, item.trial), states, reactions))
    order = {(t.push, t.frame): i for i, t in enumerate(pushes.trials)}
    return tuple(sorted(done, key=lambda p: order[(p.item.push, p.item.frame)]))
