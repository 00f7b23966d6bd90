"""What a fit is asked: its arguments checked, and the weighed problem that trials and priors pose."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal, get_args

import numpy as np

from spinestiff.anatomy.state import TorsoState
from spinestiff.anatomy.stiffness import ParameterGroup
from spinestiff.arrays import Floats, ShortRepr
from spinestiff.errors import FitError
from spinestiff.estimation.evaluation import OnFitStep, TrialSet
from spinestiff.estimation.fitted import METHODS, StiffnessFit
from spinestiff.estimation.known import Known
from spinestiff.estimation.objective import Trial
from spinestiff.estimation.ratio_priors import ratio_prior
from spinestiff.estimation.weighed import WeighedProblem
from spinestiff.imaging.features import Orientation
from spinestiff.mechanics.equilibrium import EquilibriumProblem
from spinestiff.words import counted

# Share by which a ratio from its log may lie beyond a bound.
ROUNDING = 1e-12
Extent = Literal["estimate", "shape", "intervals", "everything"]


@dataclass(frozen=True, repr=False)
class Start(ShortRepr):
    """Where a fit begins.

    Attributes
    ----------
    ratios : by name; default 1, or the bound next to it.
    nuisances : by name, in prior standard deviations; default 0. One that the trials don't have is passed over, as
        where they are fewer than those that it was found with.
    states : of the loaded trials, to solve the start of a weighed fit from, in place of the default ratios' equilibria,
        which are then not solved.
    rough : a fit of the same trials and ratios on a coarser mesh, with the shape of its likelihood.
    """

    ratios: Mapping[str, float] = field(default_factory=dict)
    nuisances: Mapping[str, float] = field(default_factory=dict)
    states: Sequence[TorsoState] | None = None
    rough: StiffnessFit | None = None

    @classmethod
    def at(cls, fit: StiffnessFit) -> Start:
        """Ratios and nuisances where another fit ended."""
        return cls(fit.ratios.as_dict(), fit.standard_nuisances)


def one_a_trial(
    problem: EquilibriumProblem | Sequence[EquilibriumProblem], trials: Sequence[Trial]
) -> tuple[EquilibriumProblem, ...]:
    """The problems, one for each trial. Raises FitError where that can't be."""
    if not len(trials):
        raise FitError("no trials to fit: mark at least one frame as training")
    if not isinstance(problem, Sequence):
        return (problem,) * len(trials)
    if len(problem) != len(trials):
        raise FitError(f"{len(problem)} problems for {len(trials)} trials; wanted one, or one a trial")
    if any(other.torso.joints.kinds != problem[0].torso.joints.kinds for other in problem):
        raise FitError("the problems' torsos differ in their joints")
    return tuple(problem)


def check_asked(
    trials: Sequence[Trial], names: Sequence[str], method: str, bounds: tuple[float, float], extent: str
) -> None:
    """Raise FitError for arguments of a fit that don't make sense."""
    if method not in METHODS:
        raise FitError(f"unknown fit method '{method}'; wanted one of {', '.join(METHODS)}")
    if extent not in get_args(Extent):
        raise FitError(f"unknown extent '{extent}' of a fit; wanted one of {', '.join(get_args(Extent))}")
    if not names or len(set(names)) != len(names):
        raise FitError(f"parameters to fit: {', '.join(names) or 'none'}; wanted at least one, each once")
    if not 0.0 < bounds[0] < bounds[1] < np.inf:
        raise FitError(f"bounds {bounds[0]}..{bounds[1]} of the ratios; wanted 0 < lower < upper")
    if not any(trial.load.size > 0.0 for trial in trials):
        raise FitError("no trial has a force, so that nothing says how stiff the torso is")
    labels = Counter(trial.label for trial in trials if trial.label)
    if (label := next((label for label, times in labels.items() if times > 1), None)) is not None:
        raise FitError(f"{labels[label]} trials have the label '{label}'; wanted one of its own for each")


def check_known(
    problems: Sequence[EquilibriumProblem],
    trials: Sequence[Trial],
    geometry: Floats | None,
    starts: Sequence[TorsoState] | None,
) -> None:
    """Raise FitError for a covariance of the geometry, or states to start from, of another size."""
    size = 6 * len(problems[0].torso.vertebrae)
    if geometry is not None and (np.shape(geometry) != (size, size) or not np.isfinite(geometry).all()):
        raise FitError(f"geometry: wanted a covariance of {size} by {size} finite numbers, six a vertebra")
    loaded = sum(trial.load.size > 0.0 for trial in trials)
    if starts is not None and len(starts) != loaded:
        raise FitError(f"{counted(len(starts), 'state')} to start from, wanted one a loaded trial, {loaded}")


def first_logs(names: Sequence[str], start: Mapping[str, float], bounds: tuple[float, float]) -> Floats:
    """(P,) log ratios to start from: those given, else 1 or the bound next to it. Raises FitError."""
    usual = float(np.clip(1.0, *bounds))
    values = np.array([start.get(name, usual) for name in names])
    for name in start:
        if name not in names:
            raise FitError(f"start names '{name}', which is not fitted; fitted are {', '.join(names)}")
    low, high = bounds[0] * (1.0 - ROUNDING), bounds[1] * (1.0 + ROUNDING)
    if not ((values >= low) & (values <= high)).all():
        raise FitError(
            f"start {', '.join(f'{value:.4g}' for value in values)} lies outside the bounds {bounds[0]}..{bounds[1]}"
        )
    return np.clip(np.log(values), *np.log(bounds))


def weighed_problem(
    problems: Sequence[EquilibriumProblem],
    trials: Sequence[Trial],
    groups: tuple[ParameterGroup, ...],
    orientation: Orientation,
    observer: OnFitStep | None,
    known: Known,
    limits: tuple[float, float] = (-np.inf, np.inf),
) -> WeighedProblem:
    """Trials under load and without, their priors and what is held of the ratios; arguments as of ``fit_stiffness``."""
    both = list(zip(problems, trials))
    loaded = [(p, trial) for p, trial in both if trial.load.size > 0.0]
    still = [(p, trial) for p, trial in both if trial.load.size == 0.0]
    trial_set = TrialSet([p for p, _ in loaded], [trial for _, trial in loaded], groups, orientation, observer)
    held = ratio_prior(groups, problems[0].torso.joints.kinds, known.priors.level_smoothness, known.population)
    return WeighedProblem(trial_set, still, orientation, known, held, limits)
