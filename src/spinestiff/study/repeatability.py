"""How repeatable estimates are: visits, or annotators, of the same people, and whether a person has changed.

x = log ratio of a visit. Within a person estimates scatter by what is anew at each visit, or in each annotation of the
same radiographs (``estimation.budget.repeated_sds``); what the model lacks of this person stays the same. From n_i
estimates of person i the within-subject standard deviation is

    s_w^2 = sum_i sum_j (x_ij - mean_i)^2 / sum_i (n_i - 1),

and two estimates of one unchanged person differ by less than 1.96 sqrt(2) s_w in 95 %, the smallest detectable change
(Bland and Altman 1996; here of a log, so that it is a factor). Whether estimates scatter as they say, with sd_ij, is
told by Q = sum_ij (x_ij - weighted mean_i)^2 / sd_ij^2, chi-squared with sum_i (n_i - 1) degrees of freedom if they do.

An estimate's 95 % interval reaches farther to one side than to the other where a stiffer spine makes up for softer
tissue: to r times what it would to first order. So sd_ij is that of the side on which the other estimates lie: to
second order 1 + (r - 1) f times that to first order, with f the share of the estimate's whole standard deviation. The
interval of a difference is made of those of its two estimates in this way (Zou and Donner 2008,
https://doi.org/10.1002/sim.3095).

What the model lacks of a person falls out of a difference only where both visits pushed alike. Where they did not, a
change is judged by the estimates' whole standard deviations.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from pathlib import Path
from typing import Literal

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.stats import chi2, norm

from spinestiff.arrays import Floats
from spinestiff.errors import SubjectError
from spinestiff.study.visit import Visit
from spinestiff.subject.estimate_outcome import Estimate
from spinestiff.subject.folder import Subject
from spinestiff.subject.outcome_parts import Quantity
from spinestiff.subject.records import ANNOTATION_FILE, REST_IMAGES
from spinestiff.subject.run_record import PARTS, input_digest, read_outcome, recorded_steps, refuse_changed

TWO_SIDED = float(norm.ppf(0.975))
# Scatter that is as likely as this, or less, is not what the estimates' own errors let expect.
UNLIKELY = 0.01
# Of a change's reach to one side, in log, beyond which nothing is known of it: bounds of ratios are far nearer.
MOST_LOG = 20.0
# Of an interval's reach to one side, over what it is to first order.
LEAST_REACH = 0.5
# Repetitions of other people from which their scatter is believed.
ENOUGH = 5
# Visits that a message names.
FEW_NAMED = 6
# Forces whose ratio is within this, and ribs as near as that, are one protocol.
SAME_FORCE, SAME_RIB = 1.25, 1.0
Verdict = Literal["changed", "no change shown", "can't be told"]
Repeated = Literal["visits", "annotators"]
Push = tuple[str, float, float]  # side, rib, N, of a training frame


@dataclass(frozen=True)
class VisitRatio:
    """A ratio at one visit.

    Attributes
    ----------
    value : the estimate. sd_log : of its log from visit to visit (annotation to annotation), as the visit itself tells,
        to first order.
    whole_sd_log : with what the model lacks of this person.
    known : whether its radiographs determine it, with a closed interval, and the result can be right.
    below, above : what its 95 % interval reaches to this side over what it would to first order, in log.
    """

    value: float
    sd_log: float
    whole_sd_log: float
    known: bool = True
    below: float = 1.0
    above: float = 1.0

    @classmethod
    def of(cls, found: Quantity, sd_log: float, whole_sd_log: float, sound: bool = True) -> VisitRatio:
        """Of an estimate with its 95 % interval; ``sound`` : whether the result can be right."""
        unknown = cls(found.value, sd_log, whole_sd_log, known=False)
        if not sound or found.open_low or found.open_high or found.determination == "not determined":
            return unknown
        if found.low is None or found.high is None:
            return unknown
        reaches = np.log([found.value / found.low, found.high / found.value])
        below, above = np.maximum(reaches / (TWO_SIDED * whole_sd_log), LEAST_REACH).tolist()
        return replace(unknown, known=True, below=below, above=above)

    def sd_on(self, upper: bool) -> float:
        """``sd_log`` on the upper or the lower side, to second order."""
        share = min(self.sd_log / self.whole_sd_log, 1.0)
        return self.sd_log * (1.0 + share * ((self.above if upper else self.below) - 1.0))


@dataclass(frozen=True)
class VisitEstimate:
    """An estimate of a visit.

    Attributes
    ----------
    label : of the visit, unique. subject : whose it is. ratios : by name.
    pushes : of the training frames. settings : what else an estimate depends on, by name, as text.
    held : what was held of the ratios before the fit (``estimation.ratio_priors``), by name.
    rest_pictures, push_pictures : hashes of the radiographs. marks : hash of the annotation. Empty: not known.
    """

    label: str
    subject: str
    ratios: Mapping[str, VisitRatio]
    pushes: tuple[Push, ...] = ()
    settings: Mapping[str, str] = field(default_factory=dict)
    rest_pictures: frozenset[str] = frozenset()
    push_pictures: frozenset[str] = frozenset()
    marks: str = ""
    held: tuple[str, ...] = ()


@dataclass(frozen=True)
class Scatter:
    """How a ratio scatters within people.

    Attributes
    ----------
    within_sd_log : s_w. low, high : its 95 % interval. degrees : of freedom.
    expected_sd_log : s_w as the visits let expect it.
    detectable_factor, expected_factor : smallest detectable change, found and expected.
    p_value : of scatter at least as far from what is expected, either way.
    left_out : estimates that are not known (``VisitRatio.known``), or not of pushes like the person's first ones.
    standardised : root mean square of the scatter, each estimate's over its own error; 1 is expected.
    """

    within_sd_log: float
    low: float
    high: float
    degrees: int
    expected_sd_log: float
    detectable_factor: float
    expected_factor: float
    p_value: float
    left_out: int
    standardised: float

    @property
    def wider(self) -> float:
        """By how much estimates scatter more than they say; 1 where that is not shown."""
        return max(self.standardised, 1.0) if self.p_value < UNLIKELY else 1.0


@dataclass(frozen=True)
class Change:
    """A ratio at a visit over that at the first one of the same person.

    Attributes
    ----------
    factor : the one over the other. low, high : its 95 % interval; None where the radiographs say nothing of the ratio.
    detectable_factor : a change by less would not show; None likewise. alike : whether both visits pushed alike.
    """

    subject: str
    name: str
    first: str
    visit: str
    factor: float
    low: float | None
    high: float | None
    detectable_factor: float | None
    alike: bool
    verdict: Verdict


@dataclass(frozen=True)
class Repeatability:
    """``of`` visits or annotators: ``scatter`` by ratio, ``changes`` of each later estimate over the first of a person.

    A ratio that fewer than two estimates of any person know has no scatter. Those of ``visits`` who have no second one
    are compared with nothing.
    """

    of: Repeated
    scatter: Mapping[str, Scatter]
    changes: tuple[Change, ...]
    visits: tuple[VisitEstimate, ...]

    @property
    def alone(self) -> tuple[VisitEstimate, ...]:
        """The only ones of their person."""
        whose = [visit.subject for visit in self.visits]
        return tuple(visit for visit in self.visits if whose.count(visit.subject) == 1)


def estimate_of(visit: Visit, annotators: bool = False) -> VisitEstimate:
    """What a visit's estimate says; ``annotators`` : of the same radiographs annotated again.

    Raises
    ------
    SubjectError : there is none, or one that is out of date, by the paper's method, or of an earlier version, which
        tell no scatter.
    """
    subject = visit.subject
    estimate = read_outcome(subject, Estimate)
    refuse_changed(subject, "track", "personalise", "estimate")
    sds = estimate.annotation_sd_log if annotators else estimate.visit_sd_log
    if not sds or not estimate.sd_log:
        raise SubjectError(
            f"{visit.file(Estimate.FILE)}: does not say how it would scatter from visit to visit; run spinestiff "
            "estimate --redo with --method weighed"
        )
    ratios = {
        name: VisitRatio.of(
            ratio,
            sds[name],
            estimate.sd_log[name],
            sound=estimate.status != "DOUBTFUL" and ratio.determined != "not determined" and not ratio.at_bound,
        )
        for name, ratio in estimate.ratios.items()
    }
    record = subject.record
    pushes = [
        (push.side, push.level, force)
        for push in record.pushes
        for force, role in zip(push.forces_n, push.roles)
        if role == "training" and force > 0.0
    ]
    shaped = recorded_steps(subject)["personalise"].settings
    settings = {
        "sex": record.sex,
        "mesh": str(shaped.get("mesh")),
        "orientation": estimate.orientation,
        "population": str(estimate.population),
        "pelvis": record.pelvis,
        "wall": record.wall,
        "priors": str(dict(sorted(record.priors.items()))),
        "trunk or skin_scan given": str(bool(record.trunk) or record.skin_scan is not None),
    }
    return VisitEstimate(
        str(subject.folder.resolve()),
        record.id,
        ratios,
        tuple(sorted(pushes)),
        settings,
        _digests(subject, REST_IMAGES.values()),
        _digests(subject, (push.frames for push in record.pushes)),
        " ".join(input_digest(subject, name) for name in PARTS if name.startswith(ANNOTATION_FILE)),
        tuple(estimate.held),
    )


def _digests(subject: Subject, files: Iterable[str]) -> frozenset[str]:
    return frozenset(input_digest(subject, name) for name in files if (subject.folder / name).exists())


def repeatability(visits: Sequence[VisitEstimate], of: Repeated = "visits") -> Repeatability:
    """Scatter and changes of visits, in the order in which they were made.

    Raises
    ------
    SubjectError : no person has two visits; visits are of different ratios or were estimated with other settings; two
        visits of the same radiographs, or two annotations of different ones or with the same marks.
    """
    visits = _shortly_named(visits)
    names = tuple(visits[0].ratios) if visits else ()
    for visit in visits:
        if tuple(visit.ratios) != names:
            raise SubjectError(
                f"{visit.label}: has ratios {', '.join(visit.ratios)}, {visits[0].label} has {', '.join(names)}; "
                "estimate the same ones"
            )
    by_subject: dict[str, list[VisitEstimate]] = {}
    for visit in visits:
        by_subject.setdefault(visit.subject, []).append(visit)
    repeated = [found for found in by_subject.values() if len(found) > 1]
    if not repeated:
        whose = [f"{one.label} is of {one.subject!r}" for one in visits[:FEW_NAMED]]
        more = ", ..." if len(visits) > FEW_NAMED else ""
        raise SubjectError(
            f"no person has two visits ({', '.join(whose)}{more}); repeatability needs two or more of one: give them "
            "the same id in subject.json"
        )
    for found in repeated:
        for later in found[1:]:
            _refuse_unlike(found[0], later)
        for first, later in combinations(found, 2):
            if of == "visits":
                _refuse_copy(first, later)
            else:
                _refuse_other_pictures(first, later)
    sums = {name: np.array([_sums(name, person) for person in repeated]) for name in names}
    scatter = {name: _scatter(each.sum(axis=0)) for name, each in sums.items()}
    changes = []
    for i, found in enumerate(repeated):
        # By the scatter of others: a change of this person's own is no scatter.
        others = {name: _scatter(np.delete(each, i, axis=0).sum(axis=0)) for name, each in sums.items()}
        wider = {name: one.wider if one is not None and one.degrees >= ENOUGH else 1.0 for name, one in others.items()}
        changes += [_change(name, found[0], later, wider[name]) for later in found[1:] for name in names]
    told = {name: one for name, one in scatter.items() if one is not None}
    return Repeatability(of, told, tuple(changes), tuple(visits))


def _shortly_named(visits: Sequence[VisitEstimate]) -> list[VisitEstimate]:
    """With as little of each label, a path, as tells the visits apart."""
    parts = [Path(visit.label).parts for visit in visits]
    count, longest = 1, max(map(len, parts), default=1)
    while count < longest and len({part[-count:] for part in parts}) < len(parts):
        count += 1
    return [replace(visit, label="/".join(part[-count:])) for visit, part in zip(visits, parts)]


def _refuse_unlike(first: VisitEstimate, later: VisitEstimate) -> None:
    for name, value in first.settings.items():
        other = later.settings.get(name)
        if other != value:
            raise SubjectError(
                f"{later.label}: {name} is {other}, in {first.label} of the same id {value}; a difference would not "
                "tell of the person"
            )


def _refuse_copy(first: VisitEstimate, later: VisitEstimate) -> None:
    if first.push_pictures & later.push_pictures:
        raise SubjectError(
            f"{later.label}: a push has the same radiographs as in {first.label}: a copy is no second visit; give each "
            "visit once, or, where the same radiographs were annotated again, --annotators"
        )


def _refuse_other_pictures(first: VisitEstimate, later: VisitEstimate) -> None:
    if (first.rest_pictures, first.push_pictures) != (later.rest_pictures, later.push_pictures):
        raise SubjectError(
            f"{later.label}: other radiographs than in {first.label}; --annotators compares annotations of the same "
            "ones: leave it out where these are visits"
        )
    if first.marks and first.marks == later.marks:
        raise SubjectError(
            f"{later.label}: the annotation is that of {first.label}, corner by corner; a copy tells nothing of "
            "annotators"
        )


def _alike(first: VisitEstimate, later: VisitEstimate) -> bool:
    """Whether two visits pushed about alike: each push of the one has one of its own in the other, in any order."""
    if len(first.pushes) != len(later.pushes):
        return False
    near = [[_near(one, other) for other in later.pushes] for one in first.pushes]
    together = np.array(near, dtype=bool).reshape(len(near), len(near))
    return bool(together[linear_sum_assignment(together, maximize=True)].all())


def _near(one: Push, other: Push) -> bool:
    same_side, apart, times = one[0] == other[0], abs(one[1] - other[1]), one[2] / other[2]
    return same_side and apart <= SAME_RIB and 1.0 / SAME_FORCE <= times <= SAME_FORCE


def _sums(name: str, person: Sequence[VisitEstimate]) -> tuple[float, ...]:
    """What a person adds to the scatter of a ratio: squares about the mean log, as many as the estimates' errors let
    expect, the same in units of these errors, repetitions, and estimates left out.

    Visits that pushed otherwise than the person's first one are left out: they differ by what is the person's own, too.
    """
    alike = [visit.ratios[name] for visit in person if _alike(person[0], visit)]
    known = [ratio for ratio in alike if ratio.known]
    left_out = float(len(person) - len(known))
    if len(known) < 2:
        return 0.0, 0.0, 0.0, 0.0, left_out
    x = np.log([ratio.value for ratio in known])
    sds = np.array([ratio.sd_on(upper=bool(log < x.mean())) for ratio, log in zip(known, x)])
    expected = float(np.sum(sds**2) * (1.0 - 1.0 / len(known)))
    q = float(np.sum(((x - np.average(x, weights=1.0 / sds**2)) / sds) ** 2))
    return float(np.sum((x - x.mean()) ** 2)), expected, q, len(known) - 1.0, left_out


def _scatter(sums: Floats) -> Scatter | None:
    """From the sums of people (``_sums``); None where nobody has two estimates to compare."""
    squares, expected, q, repetitions, left_out = (float(one) for one in sums)
    if not repetitions:
        return None
    degrees = int(repetitions)
    within, wanted = float(np.sqrt(squares / degrees)), float(np.sqrt(expected / degrees))
    # Each end by itself: one minus the other is 0 where it is small.
    rarer = min(float(chi2.cdf(q, degrees)), float(chi2.sf(q, degrees)))
    return Scatter(
        within,
        float(np.sqrt(squares / chi2.ppf(0.975, degrees))),
        float(np.sqrt(squares / chi2.ppf(0.025, degrees))),
        degrees,
        wanted,
        float(np.exp(TWO_SIDED * np.sqrt(2.0) * within)),
        float(np.exp(TWO_SIDED * np.sqrt(2.0) * wanted)),
        2.0 * rarer,
        int(left_out),
        float(np.sqrt(q / degrees)),
    )


def _change(name: str, first: VisitEstimate, later: VisitEstimate, wider: float) -> Change:
    before, after = first.ratios[name], later.ratios[name]
    alike = _alike(first, later)
    log = float(np.log(after.value / before.value))

    # What is told of a visit that pushed otherwise holds what the model lacks, too.
    sds = [wider * one.sd_log if alike else max(wider * one.sd_log, one.whole_sd_log) for one in (before, after)]
    before, after = (replace(one, sd_log=sd) for one, sd in zip((before, after), sds))
    down = TWO_SIDED * float(np.hypot(before.sd_on(upper=True), after.sd_on(upper=False)))
    up = TWO_SIDED * float(np.hypot(before.sd_on(upper=False), after.sd_on(upper=True)))
    least = down if log > 0.0 else up
    verdict: Verdict = "changed" if abs(log) > least else "no change shown"
    if not (before.known and after.known):
        verdict = "can't be told"
    whose, factor = (first.subject, name, first.label, later.label), float(np.exp(log))
    if max(down, up) > MOST_LOG:
        return Change(*whose, factor, None, None, None, alike, "can't be told")
    low, high, detectable = (float(np.exp(value)) for value in (log - down, log + up, least))
    return Change(*whose, factor, low, high, detectable, alike, verdict)
