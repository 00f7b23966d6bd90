"""Fits of the trials of pushes, also begun on a coarse torso, and how likely other ratios are."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from spinestiff.anatomy.state import TorsoState
from spinestiff.errors import NoMinimum
from spinestiff.estimation.asked import Extent
from spinestiff.estimation.ended import likelihood_rise
from spinestiff.estimation.evaluation import OnFitStep
from spinestiff.estimation.fit import fit_stiffness
from spinestiff.estimation.fitted import FitEnd, Method, StiffnessFit
from spinestiff.estimation.mode import CLOSE_SD, ROUGHLY_SD
from spinestiff.observer import Observer
from spinestiff.study.trials import PushSet


def fit_from_coarse(
    coarse: PushSet | None,
    pushes: PushSet,
    names: Sequence[str],
    start: Mapping[str, float],
    method: Method = "weighed",
    observer: OnFitStep | None = None,
    say: Observer = lambda line: None,
    extent: Extent = "everything",
    population: str | None = None,
) -> StiffnessFit:
    """The fit of the training frames, begun where the same trials on a coarse torso end; see ``fit_pushes``."""
    known: Mapping[str, float] = {}
    rough: StiffnessFit | None = None
    if coarse is not None:
        say("on the coarse mesh first")
        try:
            rough = fit_pushes(
                coarse, names, start, method, observer, "shape", population=population, close_sd=ROUGHLY_SD
            )
        except NoMinimum as error:
            say(f"no fit on the coarse mesh ({error})")
        else:
            start, known = rough.ratios.as_dict(), rough.standard_nuisances
        say("on the fine mesh")
    return fit_pushes(pushes, names, start, method, observer, extent, known, population, rough)


def rise_of(
    pushes: PushSet,
    estimate: FitEnd,
    others: Mapping[str, float],
    population: str | None = None,
    rmse_mm: float | None = None,
    starts: Sequence[TorsoState] | None = None,
) -> float:
    """By how much less likely other ratios are than an estimate (``estimation.ended.likelihood_rise``)."""
    return likelihood_rise(
        [pushes.problems[t.push] for t in pushes.fitted],
        [t.trial for t in pushes.fitted],
        estimate,
        others,
        pushes.orientation,
        pushes.known.priors,
        pushes.known.geometry,
        pushes.known.taped,
        population,
        rmse_mm,
        starts,
    )


def fit_pushes(
    pushes: PushSet,
    names: Sequence[str],
    start: Mapping[str, float] | None = None,
    method: Method = "weighed",
    observer: OnFitStep | None = None,
    extent: Extent = "everything",
    start_nuisances: Mapping[str, float] | None = None,
    population: str | None = None,
    rough: StiffnessFit | None = None,
    close_sd: float = CLOSE_SD,
    starts: Sequence[TorsoState] | None = None,
) -> StiffnessFit:
    """The fit of the training frames; arguments and errors are those of ``estimation.fit.fit_stiffness``."""
    return fit_stiffness(
        [pushes.problems[t.push] for t in pushes.fitted],
        [t.trial for t in pushes.fitted],
        names,
        method,
        start=start,
        orientation=pushes.orientation,
        observer=observer,
        priors=pushes.known.priors,
        geometry=pushes.known.geometry,
        taped=pushes.known.taped,
        extent=extent,
        start_nuisances=start_nuisances,
        population=population,
        rough=rough,
        close_sd=close_sd,
        starts=starts,
    )
