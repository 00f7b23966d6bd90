"""Fits of the trials of pushes, also begun on a coarse torso, and how likely other ratios are."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from spinestiff.anatomy.state import TorsoState
from spinestiff.errors import NoMinimum
from spinestiff.estimation.asked import Extent, Start
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
) -> StiffnessFit:
    """The fit of the training frames, begun where the same trials on a coarse torso end; see ``fit_pushes``."""
    begin = Start(start)
    if coarse is not None:
        say("on the coarse mesh first")
        try:
            rough = fit_pushes(coarse, names, begin, method, observer, "shape", ROUGHLY_SD)
        except NoMinimum as error:
            say(f"no fit on the coarse mesh ({error})")
        else:
            begin = replace(Start.at(rough), rough=rough)
        say("on the fine mesh")
    return fit_pushes(pushes, names, begin, method, observer, extent)


def rise_of(
    pushes: PushSet,
    estimate: FitEnd,
    others: Mapping[str, float],
    rmse_mm: float | None = None,
    starts: Sequence[TorsoState] | None = None,
) -> float:
    """By how much less likely other ratios are than an estimate (``estimation.ended.likelihood_rise``)."""
    return likelihood_rise(
        *pushes.posed(pushes.fitted),
        estimate,
        others,
        pushes.orientation,
        pushes.known,
        rmse_mm,
        starts,
    )


def fit_pushes(
    pushes: PushSet,
    names: Sequence[str],
    start: Start | Mapping[str, float] | None = None,
    method: Method = "weighed",
    observer: OnFitStep | None = None,
    extent: Extent = "everything",
    close_sd: float = CLOSE_SD,
) -> StiffnessFit:
    """The fit of the training frames; arguments and errors are those of ``estimation.fit.fit_stiffness``."""
    return fit_stiffness(
        *pushes.posed(pushes.fitted),
        names,
        method,
        start,
        known=pushes.known,
        orientation=pushes.orientation,
        extent=extent,
        observer=observer,
        close_sd=close_sd,
    )
