"""The truth of a synthetic subject, and how far an estimate lies from it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from spinestiff.anatomy.regions import AT, check_ratios
from spinestiff.anatomy.state import TorsoState
from spinestiff.errors import EquilibriumError, SubjectError, TorsoError
from spinestiff.files import read_json
from spinestiff.study.fits import rise_of
from spinestiff.study.forecasts import fit_end
from spinestiff.study.trials import PushSet
from spinestiff.subject.assessment_outcome import Comparison
from spinestiff.subject.estimate_outcome import Estimate
from spinestiff.subject.folder import Subject
from spinestiff.subject.run_record import read_outcome


def read_truth(path: Path) -> dict[str, float]:
    """True ratios of a synthetic subject's truth file, each of a group or of a part of one that has none.

    Raises
    ------
    SubjectError : no such file; no ratios in it; a name that no ratio has; a whole's ratio beside a part's.
    """
    record = read_json(path)
    try:
        ratios = dict(record["ratios"])
        sound = bool(ratios) and all(type(value) in (int, float) and 0.0 < value < 1e9 for value in ratios.values())
    except (KeyError, TypeError, ValueError):
        sound = False
    if not sound:
        raise SubjectError(f"{path}: holds no true ratios; wanted the truth file of a synthetic subject")
    try:
        check_ratios(tuple(ratios))
    except TorsoError as error:
        raise SubjectError(f"{path}: true ratios: {error}") from None
    for part in ratios:
        whole = part.partition(AT)[0]
        if part != whole in ratios:
            raise SubjectError(
                f"{path}: holds true ratios of {whole} and of {part}, a part of it; wanted the whole's or its parts'"
            )
    return {name: float(value) for name, value in ratios.items()}


def true_values(parameters: Sequence[str], truth: Mapping[str, float]) -> dict[str, float]:
    """True values of estimated ratios, of those that the true ratios tell.

    A group's true ratio is that of each of its parts. A part that is estimated beside its whole has a ratio relative to
    the whole's: 1 if the whole's is known, else not told.
    """
    found = {}
    for name in parameters:
        whole = name.partition(AT)[0]
        if name != whole and whole in parameters:
            known = 1.0 if whole in truth else None
        else:
            known = truth.get(name, truth.get(whole))
        if known is not None:
            found[name] = known
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
        distance2 = rise_of(pushes, fit_end(estimate), wanted, estimate.training_rmse_mm.fit, starts)
    except EquilibriumError:
        return unknown
    return unknown.model_copy(update={"distance2": distance2, "inside": bool(distance2 <= size)})
