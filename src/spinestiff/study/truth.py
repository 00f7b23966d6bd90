"""The truth of a synthetic subject, and how far an estimate lies from it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

from spinestiff.anatomy.regions import AT
from spinestiff.anatomy.state import TorsoState
from spinestiff.errors import EquilibriumError, SubjectError
from spinestiff.files import read_json
from spinestiff.study.forecasts import fit_end
from spinestiff.study.trials import PushSet, rise_of
from spinestiff.subject.assessment_outcome import Comparison
from spinestiff.subject.estimate_outcome import Estimate
from spinestiff.subject.folder import Subject
from spinestiff.subject.run_record import read_outcome


def read_truth(path: Path) -> dict[str, float]:
    """True ratios of a synthetic subject's truth file. Raises SubjectError."""
    record = read_json(path)
    try:
        ratios = dict(record["ratios"])
        sound = bool(ratios) and all(type(value) in (int, float) and 0.0 < value < 1e9 for value in ratios.values())
    except (KeyError, TypeError, ValueError):
        sound = False
    if not sound:
        raise SubjectError(f"{path}: holds no true ratios; wanted the truth file of a synthetic subject")
    return {str(name): float(value) for name, value in ratios.items()}


def true_values(parameters: Sequence[str], truth: Mapping[str, float]) -> dict[str, float]:
    """True values of estimated ratios, of those that the true ratios tell.

    A group's true ratio is that of each of its parts, times the part's own if there is one; of a part that is estimated
    beside its whole it is the part's own, or 1.
    """
    found = {}
    for name in parameters:
        stem, at, _ = name.partition(AT)
        own = truth.get(name)
        if not at:
            uneven = any(other.startswith(f"{name}{AT}") and other not in parameters for other in truth)
            value = None if uneven else own
        elif stem in parameters:
            value = 1.0 if own is None and stem in truth else own
        else:
            both = [one for one in (own, truth.get(stem)) if one is not None]
            value = math.prod(both) if both else None
        if value is not None:
            found[name] = value
    return found


def known_comparison(subject: Subject, truth: Path) -> Comparison:
    """What ``assess`` found with this truth.

    Raises
    ------
    SubjectError : it was given none, or another.
    """
    path, again = subject.results / Comparison.FILE, f"run spinestiff assess {subject.folder} --truth {truth}"
    if not path.is_file():
        raise SubjectError(f"{path}: no such file; {again}")
    comparison = read_outcome(subject, Comparison)
    if comparison.truth != read_truth(truth):
        raise SubjectError(f"{path}: compares with other true ratios than those of {truth}; {again}")
    return comparison


def compare_with_truth(
    estimate: Estimate, pushes: PushSet, truth: Path, starts: Sequence[TorsoState] | None = None
) -> Comparison:
    """How far the estimate lies from known true ratios, in the measure of its joint region.

    Parameters
    ----------
    starts : the estimate's states of the training frames under load, in order, to solve from; default rest.

    Raises
    ------
    SubjectError : the truth lacks a ratio that was estimated.
    """
    true_ratios, size = read_truth(truth), estimate.region_size
    wanted = true_values(estimate.parameters, true_ratios)
    lacking = [name for name in estimate.parameters if name not in wanted]
    if lacking:
        raise SubjectError(f"{truth}: holds no true ratio of {lacking[0]}, which was estimated")
    unknown = Comparison(truth=true_ratios, region_size=size, distance2=None, inside=None)
    if size is None:
        return unknown
    try:
        distance2 = rise_of(
            pushes, fit_end(estimate), wanted, estimate.population, estimate.training_rmse_mm.fit, starts
        )
    except EquilibriumError:
        return unknown
    return unknown.model_copy(update={"distance2": distance2, "inside": bool(distance2 <= size)})
