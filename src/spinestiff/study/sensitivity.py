"""How an estimate changes with what it was made from (paper 5.4 and Table 7): refits with one thing changed at a time.

Refits look for the mode alone, without intervals, and begin at the estimate. They are written one by one, so that a run
that was stopped goes on where it was.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from spinestiff.anatomy.regions import AT, is_beside_whole
from spinestiff.anatomy.rotation import exp_so3
from spinestiff.anatomy.stiffness import INTERVERTEBRAL_BENDING as BENDING
from spinestiff.anatomy.stiffness import RATIO_BOUNDS, TISSUE_PARAMETERS
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.arrays import Floats
from spinestiff.errors import SpinestiffError
from spinestiff.estimation.fitted import StiffnessFit
from spinestiff.files import read_text
from spinestiff.formats import json_text
from spinestiff.imaging.features import ORIENTATIONS
from spinestiff.observer import Observer
from spinestiff.personalise.placing import place_vertebrae
from spinestiff.study.fits import fit_pushes
from spinestiff.study.refits import Basis, basis_of, converged
from spinestiff.study.visit import Manner, Visit, has_start, pushes_on, torso_on
from spinestiff.subject.geometry_outcome import GeometryRecord
from spinestiff.subject.program import program_of_numbers
from spinestiff.subject.records import LEVELS, PushRecord
from spinestiff.subject.run_record import read_outcome, recorded_steps, write_outcome
from spinestiff.subject.sensitivity_outcome import Change, Refit, Sensitivity, Series

FORCE, MODULUS = 0.1, 0.2
"""Relative changes of force and of the default modulus."""
SIGNS = (-1, 1)
Ratios = Mapping[str, float]
LEVER_MM = 20.0
"""Half a vertebra: by how much a turn counts beside a shift where the leading mode of a geometry is looked for."""
ELSEWHERE = (1.2, 0.7)
"""Of bending and tissue, over where they are: along the valley in which they trade against each other."""
PAPER_SERIES: Mapping[Series, tuple[str, ...]] = {
    "tied": (BENDING, "tissue"),
    "kept": (BENDING, "tissue_mu"),
    "everything": ("everything",),
}


@dataclass(frozen=True)
class Case:
    """A refit that is to be made.

    Attributes
    ----------
    fit : makes it, from the ratios with nothing changed if they are known.
    scale : name -> by what the default that it is a ratio to was scaled.
    """

    series: Series
    what: Change
    by: str
    fit: Callable[[Ratios | None], Ratios | StiffnessFit]
    scale: Mapping[str, float]


def sensitivity_study(
    visit: Visit, say: Observer, refits: Callable[[Basis], Iterable[Case]] = lambda basis: all_cases(basis)
) -> Sensitivity:
    """All refits, on the mesh of the visit's settings; writes ``sensitivity.json`` after each.

    Parameters
    ----------
    refits : which ones; of a series the one with nothing changed comes first.

    Raises
    ------
    SubjectError : see ``refits.basis_of``.
    """
    basis = basis_of(visit)
    digest = _digest(visit)
    cases, notes = list(refits(basis)), _notes(basis)
    known = {(one.series, one.what, one.by): one for one in _earlier(visit, digest)}
    found: list[Refit] = []
    record = _record(basis, digest, found, notes, complete=False)
    for number, case in enumerate(cases):
        done = known.get((case.series, case.what, case.by))
        if done is None:
            say(f"refit {number + 1} of {len(cases)}: {_shown(case)}")
            done = _made(case, found)
        found.append(done)
        record = _record(basis, digest, found, notes, complete=number + 1 == len(cases))
        write_outcome(visit.subject, record)
    return record


def _shown(case: Case) -> str:
    names = {"weighed": "", **{series: f", equal weights, {', '.join(own)}" for series, own in PAPER_SERIES.items()}}
    return f"{case.what} {case.by}".strip() + names[case.series]


def _digest(visit: Visit) -> str:
    """Of the estimate, the mesh and the program: refits of another estimate, or by other code, are none of this one."""
    made = recorded_steps(visit.subject)["estimate"]
    return hashlib.sha256(
        json_text([made.digest, made.outputs, visit.settings.mesh, program_of_numbers()]).encode()
    ).hexdigest()


def _earlier(visit: Visit, digest: str) -> tuple[Refit, ...]:
    """Refits of a run that was stopped; none if it wasn't, or of another estimate or mesh, or there is no such file, or
    all are to be made anew."""
    path = visit.file(Sensitivity.FILE)
    if visit.settings.redo or not path.is_file():
        return ()
    try:
        found = Sensitivity.model_validate_json(read_text(path), strict=True)
    except (SpinestiffError, ValueError):
        return ()
    if found.basis != digest or found.complete:
        return ()
    # What failed is tried again, and what had no refit with nothing changed to be compared with.
    return tuple(one for one in found.refits if one.percent)


def _made(case: Case, before: Sequence[Refit]) -> Refit:
    reference = next((one.ratios for one in before if (one.series, one.what) == (case.series, "nothing")), None)
    note, at_bound = "", tuple[str, ...]()
    ratios: dict[str, float] = {}
    try:
        fit = case.fit(reference)
    except SpinestiffError as error:
        note = str(error)
    else:
        ratios = dict(fit.ratios.as_dict() if isinstance(fit, StiffnessFit) else fit)
        if isinstance(fit, StiffnessFit):
            at_bound = tuple(name for name, there in fit.at_bound.items() if there)
    against = ratios if reference is None else reference
    changes = {name: value / against[name] for name, value in ratios.items() if name in against}
    return Refit(
        series=case.series,
        what=case.what,
        by=case.by,
        ratios=ratios,
        percent={name: 100.0 * (change - 1.0) for name, change in changes.items()},
        stiffness_percent={
            name: 100.0 * (change * case.scale.get(name, 1.0) - 1.0) for name, change in changes.items()
        },
        at_bound=at_bound,
        note=note,
    )


def _record(basis: Basis, digest: str, found: Sequence[Refit], notes: Sequence[str], complete: bool) -> Sensitivity:
    estimate = basis.estimate
    ends = {name: (ratio.low, ratio.high) for name, ratio in estimate.ratios.items()}
    return Sensitivity(
        basis=digest,
        mesh=basis.visit.settings.mesh,
        parameters=basis.names,
        estimate=dict(estimate.values),
        interval95={name: None if None in both else both for name, both in ends.items()},  # type: ignore[misc]
        open_ends={
            name: (ratio.open_low, ratio.open_high)
            for name, ratio in estimate.ratios.items()
            if ratio.open_low or ratio.open_high
        },
        refits=tuple(found),
        force_percent=force_percent(found),
        complete=complete,
        notes=tuple(notes),
    )


def force_percent(refits: Sequence[Refit]) -> dict[Series, dict[str, float]]:
    """Series -> ratio -> mean of the absolute changes with more and with less force (Table 7)."""
    result: dict[Series, dict[str, float]] = {}
    for series in dict.fromkeys(one.series for one in refits):
        both = [one for one in refits if one.series == series and one.what == "force" and one.percent]
        if len(both) == len(SIGNS):
            names = [name for name in both[0].percent if name in both[1].percent]
            result[series] = {name: float(np.mean([abs(one.percent[name]) for one in both])) for name in names}
    return result


def _notes(basis: Basis) -> list[str]:
    found = []
    if not has_start(basis.visit):
        found.append("mesh: the torso is on one mesh alone, so that there is no other one to compare with")
    for sign in SIGNS:
        movable = _movable(basis.visit, sign)
        for push in _trained(basis.visit):
            if push.id not in movable:
                then = f"it stays at rib {push.level:g} while others are pushed" if movable else "no refit is"
                found.append(
                    f"push level: there is no rib {push.level + sign:g} to push at ('{push.id}'): {then} "
                    f"{_rib_words(sign)}"
                )
    return found


def _rib_words(sign: int) -> str:
    return f"one rib {'lower' if sign > 0 else 'higher'}"


def _movable(visit: Visit, sign: int) -> set[str]:
    """Ids of the training pushes that have a rib lower, or higher with -1, to push at."""
    return {push.id for push in _trained(visit) if LEVELS[0] <= push.level + sign <= LEVELS[1]}


def _trained(visit: Visit) -> list[PushRecord]:
    return [push for push in visit.subject.pushes if push.frames_of("training")]


def all_cases(basis: Basis) -> Iterator[Case]:
    """Those of the weighed fit, then those of the paper's."""
    yield from weighed_cases(basis)
    yield from paper_cases(basis)


def weighed_cases(basis: Basis) -> Iterator[Case]:
    """The estimate's ratios with one thing changed at a time."""
    visit, torso, estimate = basis.visit, basis.torso, basis.estimate
    own = Manner.of(estimate)

    def on(changed: Visit, shaped: Callable[[], TorsoModel], manner: Manner, start: Ratios | None) -> StiffnessFit:
        return basis.refit(pushes_on(changed, shaped(), manner), start)

    def case(
        what: Change,
        by: str,
        changed: Visit = visit,
        shaped: Callable[[], TorsoModel] = lambda: torso,
        manner: Manner = own,
        scale: Mapping[str, float] | None = None,
    ) -> Case:
        return Case("weighed", what, by, partial(on, changed, shaped, manner), scale or {})

    yield case("nothing", "")
    for sign in SIGNS:
        yield case("force", _percent(sign * FORCE), with_force(visit, 1.0 + sign * FORCE))
    for sign in SIGNS:
        if _movable(visit, sign):
            yield case("push level", _rib_words(sign), _with_level(visit, sign))
    for other in ORIENTATIONS:
        if other != own.orientation:
            yield case("corners", other, manner=replace(own, orientation=other))
    if has_start(visit) and visit.settings.mesh == "coarse":
        # The estimate itself, made from the same frames in the same way.
        yield Case("weighed", "mesh", "fine", lambda start: estimate.values, {})
    elif has_start(visit):
        yield case("mesh", "coarse", shaped=partial(torso_on, visit, "coarse"))
    for sign in SIGNS:
        factor = 1.0 + sign * MODULUS
        # A part beside its whole is relative to that, so the default does not touch its ratio.
        scale = {
            name: factor
            for name in basis.names
            if name.partition(AT)[0] in TISSUE_PARAMETERS and not is_beside_whole(name, basis.names)
        }
        stiffer = partial(_with_modulus, torso, factor)
        yield case("default modulus", _percent(sign * MODULUS), shaped=stiffer, scale=scale)
    for sign in SIGNS:
        by = f"{'+' if sign > 0 else '−'}1 sd of its leading mode"
        yield case("geometry", by, shaped=partial(_with_shape, visit, torso, sign))


def paper_cases(basis: Basis) -> Iterator[Case]:
    """Table 7: equal weights.

    Their loss may be flat along a valley, or have several minima. So one refit of each pair of ratios has nothing
    changed but where it begins: what the others tell is known no better than where that one ends.
    """
    visit, estimate = basis.visit, basis.estimate
    manner = replace(Manner.of(estimate), method="paper")
    middle = float(np.exp(np.mean(np.log(list(estimate.values.values())))))
    usual = {"everything": middle, BENDING: estimate.values.get("lateral_bending", middle)}
    usual |= dict.fromkeys(("tissue", "tissue_mu"), estimate.values.get("tissue", middle))

    def fit(names: tuple[str, ...], factor: float, apart: Sequence[float], start: Ratios | None) -> StiffnessFit:
        pushes = pushes_on(with_force(visit, factor), basis.torso, manner)
        begun = [float(np.clip((start or usual)[name] * share, *RATIO_BOUNDS)) for name, share in zip(names, apart)]
        return converged(fit_pushes(pushes, names, dict(zip(names, begun)), "paper"))

    for series, names in PAPER_SERIES.items():
        there = (1.0,) * len(names)
        yield Case(series, "nothing", "", partial(fit, names, 1.0, there), {})
        if len(names) == len(ELSEWHERE):
            yield Case(series, "start", "other ratios", partial(fit, names, 1.0, ELSEWHERE), {})
        for sign in SIGNS:
            yield Case(series, "force", _percent(sign * FORCE), partial(fit, names, 1.0 + sign * FORCE, there), {})


def _percent(share: float) -> str:
    return f"{'+' if share > 0.0 else '−'}{abs(100.0 * share):g} %"


def _with_pushes(visit: Visit, change: Callable[[PushRecord], PushRecord]) -> Visit:
    subject = visit.subject
    pushes = tuple(change(push) for push in subject.pushes)
    return replace(visit, subject=replace(subject, record=subject.record.model_copy(update={"pushes": pushes})))


def with_force(visit: Visit, factor: float) -> Visit:
    """Every force of every push scaled."""
    return _with_pushes(
        visit, lambda push: push.model_copy(update={"forces_n": tuple(factor * force for force in push.forces_n)})
    )


def _with_level(visit: Visit, ribs: int) -> Visit:
    """Every training push that has such a rib one lower, or higher with -1."""
    moved = _movable(visit, ribs)
    return _with_pushes(
        visit, lambda push: push.model_copy(update={"level": push.level + ribs}) if push.id in moved else push
    )


def _with_modulus(torso: TorsoModel, factor: float) -> TorsoModel:
    tissue = torso.tissue
    return replace(
        torso, tissue=replace(tissue, lame_mu=factor * tissue.lame_mu, lame_lambda=factor * tissue.lame_lambda)
    )


def _with_shape(visit: Visit, torso: TorsoModel, sign: int) -> TorsoModel:
    """The vertebrae one standard deviation along the leading mode of what is not known of them, the rest carried."""
    covariance = read_outcome(visit.subject, GeometryRecord).matrix
    positions = torso.rest_pose.bone_positions[torso.vertebra_bones]
    rotations = torso.rest_pose.bone_rotations[torso.vertebra_bones]
    moved = sign * leading_mode(covariance, positions)
    return place_vertebrae(torso, positions + moved[:, :3], exp_so3(moved[:, 3:]) @ rotations)


def leading_mode(covariance: Floats, positions: Floats) -> Floats:
    """(V, 6) one standard deviation (dt mm, dw rad) along the largest mode of a spine's shape.

    What moves the spine as one body is left out: it is where a person stands, which every picture tells anew.

    Parameters
    ----------
    covariance : (6V, 6V) of the vertebrae's (dt mm, dw rad). positions : (V, 3) mm.
    """
    count = len(positions)
    about = positions - positions.mean(axis=0)
    rigid = np.zeros((count, 6, 6))
    for axis in range(3):
        unit = np.eye(3)[axis]
        rigid[:, axis, axis] = 1.0
        rigid[:, :3, 3 + axis] = np.cross(unit, about)
        rigid[:, 3 + axis, 3 + axis] = LEVER_MM
    units = np.tile([1.0] * 3 + [LEVER_MM] * 3, count)
    basis = np.linalg.qr(rigid.reshape(6 * count, 6))[0]
    apart = np.eye(6 * count) - basis @ basis.T
    variances, modes = np.linalg.eigh(apart @ (covariance * np.outer(units, units)) @ apart)
    mode = modes[:, -1] * np.sqrt(max(variances[-1], 0.0))
    # A mode and its opposite are the same: the largest entry counts as positive, so that reruns agree.
    mode = mode * np.sign(mode[np.argmax(np.abs(mode))])
    return np.asarray((mode / units).reshape(count, 6))
