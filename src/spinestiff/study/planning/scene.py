"""What a plan of further pushes knows of a subject: the torso, what was seen of it, and where its ratios may lie."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from spinestiff.anatomy.names import VERTEBRAE
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.arrays import Floats, ShortRepr
from spinestiff.errors import SubjectError
from spinestiff.estimation.known import Known
from spinestiff.imaging.projection import XRayView
from spinestiff.mechanics.push import Rig
from spinestiff.personalise.pose import align_view, posed
from spinestiff.study.draws import DRAWS_FILE, read_draws
from spinestiff.study.trials import PushSet, known_of, rig_of
from spinestiff.study.visit import USUAL, Manner, Visit, load_pushes, load_start, torso_on
from spinestiff.subject.annotated_points import image_corners
from spinestiff.subject.estimate_outcome import Estimate
from spinestiff.subject.folder import Subject, read_rest
from spinestiff.subject.geometry_outcome import GeometryRecord
from spinestiff.subject.image_names import FRONTAL, LATERAL
from spinestiff.subject.run_record import read_outcome, recorded_steps, refuse_changed, result_path

# Lateral bending and tissue: the geometric mean of Table 4, and half a decade or so around it either way.
POPULATION = ((0.07, 0.04), (0.02, 0.04), (0.25, 0.04), (0.07, 0.015), (0.07, 0.15))
PLACES = 5  # along the draws of an estimate


@dataclass(frozen=True, repr=False)
class Scene(ShortRepr):
    """A subject as a plan sees it.

    Attributes
    ----------
    torso : at rest. known : beside the radiographs. rig : how pushes are held against.
    view : from where, moved to where the patient stands. vertebrae : that it shows.
    names : of the ratios. places : (K, P) log ratios, where they may lie.
    taken : what the estimate has been made from; None before any push.
    tracking_factor : of the size of tracking's errors.
    intervals : name -> the factor, either way on average, of the 95 % interval that the estimate has, if it is closed.
    doubts : about the estimate, in words.
    marked_aside : vertebrae that a lateral radiograph shows; None: those that the frontal one does.
    """

    torso: TorsoModel
    known: Known
    rig: Rig
    view: XRayView
    vertebrae: tuple[str, ...]
    names: tuple[str, ...]
    places: Floats
    taken: PushSet | None = None
    tracking_factor: float = 1.0
    intervals: Mapping[str, float] = field(default_factory=dict)
    doubts: tuple[str, ...] = ()
    marked_aside: tuple[str, ...] | None = None

    @property
    def aside(self) -> tuple[str, ...]:
        """Vertebrae that a lateral radiograph shows."""
        return self.vertebrae if self.marked_aside is None else self.marked_aside

    @property
    def lateral(self) -> XRayView:
        """From the side: as ``view``, with the patient turned by a quarter."""
        return posed(self.view, np.zeros(2), 0.0, 0.5 * np.pi)


def population_places() -> Floats:
    """(5, 2) log ratios of lateral bending and tissue, where a patient's may lie before any push."""
    return np.log(POPULATION)


def places_of_draws(log_ratios: Floats, count: int = PLACES) -> Floats:
    """(count, P) places along draws (D, P) of the log ratios, means of as many parts of them from one end to the other.

    They follow the draws where ratios trade against each other.
    """
    about = log_ratios - log_ratios.mean(axis=0)
    order = np.argsort(about @ np.linalg.svd(about, full_matrices=False)[2][0])
    return np.array([log_ratios[part].mean(axis=0) for part in np.array_split(order, min(count, len(order)))])


def scene_of(visit: Visit) -> Scene:
    """A personalised subject: with its estimate if it has one, else as one of the population before any push.

    Raises
    ------
    SubjectError : not personalised; pushes but no estimate, one that is out of date or by the paper's method, which
        knows no uncertainty; ratios that the population says nothing of; a pelvis under dead loads.
    """
    subject = visit.subject
    if subject.record.pelvis == "dead-loads":
        raise SubjectError(
            f"{subject.folder}: pelvis is 'dead-loads', whose distances d21 and d31 are not known of a push that was "
            "not taken; plan with another pelvis"
        )
    estimated = "estimate" in recorded_steps(subject) and visit.file(Estimate.FILE).exists()
    scene = _of_estimate(visit) if estimated else _of_population(visit)
    return replace(scene, marked_aside=_marked_aside(subject))


def _of_population(visit: Visit) -> Scene:
    subject = visit.subject
    if subject.pushes:
        raise SubjectError(
            f"{subject.folder}: pushes were taken, but there is no estimate from them; run spinestiff run first"
        )
    if visit.parameters != USUAL:
        raise SubjectError(
            f"{subject.folder}: before any push a plan knows where {' and '.join(USUAL)} may lie, not "
            f"{', '.join(visit.parameters)}; leave parameters out of subject.json until there is an estimate"
        )
    refuse_changed(subject, "personalise")
    known = known_of(subject.record, read_outcome(subject, GeometryRecord).matrix, visit.population)
    torso = torso_on(visit, "coarse")
    picture = read_rest(subject, "frontal")
    corners = image_corners(subject, FRONTAL, picture.view)
    view, _ = align_view(torso, torso.rest_pose, picture.view, corners)
    return Scene(
        torso,
        known,
        rig_of(subject.record),
        view,
        corners.vertebrae,
        USUAL,
        population_places(),
    )


def _of_estimate(visit: Visit) -> Scene:
    subject = visit.subject
    refuse_changed(subject, "track", "personalise", "estimate")
    estimate = read_outcome(subject, Estimate)
    if estimate.method != "weighed":
        raise SubjectError(
            f"{visit.file(Estimate.FILE)}: is by the paper's method, which knows no uncertainty to narrow; "
            "run spinestiff estimate with --method weighed"
        )
    manner = Manner.of(estimate)
    pushes = load_start(visit, manner) or load_pushes(visit, manner)
    draws = np.log(read_draws(result_path(subject, DRAWS_FILE, "estimate"), estimate.parameters))
    first = pushes.fitted[0].trial
    seen = max((item.trial.corners.vertebrae for item in pushes.fitted), key=len)
    return Scene(
        pushes.torso,
        pushes.known,
        rig_of(subject.record),
        first.view,
        seen,
        estimate.parameters,
        places_of_draws(draws),
        pushes,
        estimate.tracking_factor or 1.0,
        {
            name: float(np.exp(2.0 * ratio.sd_log))
            for name, ratio in estimate.ratios.items()
            if np.isfinite(ratio.sd_log)
        },
        _doubts(estimate),
    )


def _marked_aside(subject: Subject) -> tuple[str, ...] | None:
    """Vertebrae that are marked in the lateral rest radiograph; None: there is none."""
    if LATERAL not in subject.annotation.images:
        return None
    marked = subject.annotation.images[LATERAL].vertebrae
    return tuple(name for name in VERTEBRAE if name in marked)


def _doubts(estimate: Estimate) -> tuple[str, ...]:
    found = [f"the estimate is doubtful: {check.name}" for check in estimate.failed]
    for name, ratio in estimate.ratios.items():
        if ratio.at_bound or ratio.open_low or ratio.open_high:
            found.append(f"{name}: the estimate's interval reaches the fit's bounds; its own width is not known")
    return tuple(found)
