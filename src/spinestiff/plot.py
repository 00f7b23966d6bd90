"""The pictures of results, as Matplotlib figures: what the report draws, one function a picture.

Each takes a visit (``open_visit``) whose steps have run, or what a function of this package found, and returns a figure
that belongs to no window: a notebook shows it, ``figure.savefig`` writes it. Colours mean the same everywhere: blue is
measured, orange is the estimate, grey is the default.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Literal

from spinestiff.errors import SubjectError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from spinestiff.anatomy.torso import TorsoModel
    from spinestiff.arrays import Floats
    from spinestiff.curves.cobb import CobbReading
    from spinestiff.estimation.fitted import StiffnessFit
    from spinestiff.mechanics.result import Equilibrium
    from spinestiff.mechanics.system import System
    from spinestiff.study.visit import Visit
    from spinestiff.subject.estimate_outcome import Estimate


def torso(model: TorsoModel) -> Figure:
    """A torso at rest from the front, the side and behind, mm."""
    from spinestiff.anatomy.picture import torso_figure

    return torso_figure(model)


def skin_scan(model: TorsoModel, points: Floats) -> Figure:
    """Points (n, 3) mm of a skin scan over a torso."""
    from spinestiff.anatomy.picture import scan_figure

    return scan_figure(model, points)


def problem(system: System) -> Figure:
    """A torso from the front, and where its supports hold it."""
    from spinestiff.mechanics.picture import problem_figure

    return problem_figure(system)


def equilibrium(found: Equilibrium) -> Figure:
    """Bones and free nodes of an equilibrium from the front, and what its supports exert."""
    from spinestiff.mechanics.picture import equilibrium_figure

    return equilibrium_figure(found)


def fit(found: StiffnessFit) -> Figure:
    """Ratios of a fit with their 95 % intervals."""
    from spinestiff.estimation.picture import fit_figure

    return fit_figure(found)


def cobb(readings: Sequence[CobbReading]) -> Figure:
    """Spines with end vertebrae and angles, as ``read_cobb`` reads them; one panel an image."""
    from spinestiff.study.report.cobb_picture import draw_readings

    return draw_readings(readings)


def rest(visit: Visit, view: Literal["frontal", "lateral"] = "frontal") -> Figure:
    """A rest radiograph with the marked vertebrae and the fitted geometry.

    Raises
    ------
    SubjectError : the subject has not been personalised, or has no such radiograph.
    """
    from spinestiff.study.report.pictures import rest_picture
    from spinestiff.subject.geometry_outcome import GeometryRecord
    from spinestiff.subject.run_record import read_outcome

    geometry = read_outcome(visit.subject, GeometryRecord)
    if view not in geometry.views:
        raise SubjectError(f"no rest radiograph '{view}'; there are {', '.join(geometry.views)}")
    return rest_picture(visit, visit.torso(), view, geometry)[1]


def held_out(visit: Visit) -> tuple[Figure, ...]:
    """Each held-out frame with its vertebrae as measured and as the models predict them.

    Raises
    ------
    SubjectError : the visit has not been assessed.
    """
    from spinestiff.study.report.pictures import frame_picture
    from spinestiff.study.steps import stored_predictions
    from spinestiff.subject.folder import read_push

    predictions = stored_predictions(visit)
    frames = predictions.of_role("validation")
    films = {name: read_push(visit.subject, visit.subject.push(name)) for name in {p.item.push for p in frames}}
    return tuple(frame_picture(visit, predictions, p, films[p.item.push])[1] for p in frames)


def first_page(visit: Visit) -> tuple[Figure, ...]:
    """The spine before the push that tells most, pushed, and as the estimate has it: a report's first page.

    No figure where the Cobb angle was not seen both with and without force.

    Raises
    ------
    SubjectError : the visit has not been assessed.
    """
    from spinestiff.study.report.clinician_picture import moments
    from spinestiff.study.steps import stored_predictions
    from spinestiff.subject.assessment_outcome import Assessment
    from spinestiff.subject.folder import read_push
    from spinestiff.subject.outcomes import Responses
    from spinestiff.subject.run_record import read_outcome

    assessment, predictions = read_outcome(visit.subject, Assessment), stored_predictions(visit)
    responses = read_outcome(visit.subject, Responses)
    films = {push.id: read_push(visit.subject, push) for push in visit.subject.pushes}
    return tuple(figure for _, figure, _, _ in moments(visit, predictions, films, assessment, responses))


def views_and_markers(visit: Visit) -> tuple[Figure, ...]:
    """Further views of pushes and motion of skin markers, measured and simulated; none where a push has neither.

    Raises
    ------
    SubjectError : the visit has not been assessed.
    """
    from spinestiff.study.report.beside import beside_pictures, pixels_in
    from spinestiff.study.steps import stored_predictions

    return tuple(figure for _, figure, _, _ in beside_pictures(stored_predictions(visit), pixels_in(visit)))


def force_and_curve(visit: Visit) -> Figure:
    """Change of the Cobb angle against force, measured and simulated; a panel a push.

    Raises
    ------
    SubjectError : the visit has not been assessed, or no push shows a change.
    """
    from spinestiff.study.report.pictures import curve_picture
    from spinestiff.study.steps import stored_predictions

    drawn = curve_picture(stored_predictions(visit))
    if drawn is None:
        raise SubjectError("no push shows vertebrae in two frames, between which the curve could change")
    return drawn[1]


def tilt_by_level(visit: Visit) -> Figure:
    """Change of each vertebra's tilt, degrees, measured and simulated; a panel a frame.

    Raises
    ------
    SubjectError : the visit has not been assessed, or no push shows a change.
    """
    from spinestiff.study.report.pictures import tilt_picture
    from spinestiff.study.steps import stored_predictions

    drawn = tilt_picture(visit, stored_predictions(visit))
    if drawn is None:
        raise SubjectError("no push shows two vertebrae in two frames, between which their tilt could change")
    return drawn[1]


def joint_region(visit: Visit) -> Figure:
    """The 95 % joint region of two ratios, and the way of the fit.

    Raises
    ------
    SubjectError : the visit has no estimate, or one of another number of ratios.
    """
    from spinestiff.study.report.pictures import region_picture

    drawn = region_picture(visit, _estimate(visit))
    if drawn is None:
        raise SubjectError("a joint region is drawn of two ratios; see plot.profiles for each by itself")
    return drawn[1]


def profiles(visit: Visit) -> Figure:
    """How much less likely other values of each ratio are.

    Raises
    ------
    SubjectError : the visit has no estimate, or one without profiles (the paper's method, or many ratios).
    """
    from spinestiff.study.report.pictures import profile_picture

    estimate = _estimate(visit)
    if not estimate.profiles:
        raise SubjectError("this estimate has no profiles; spinestiff estimate --method weighed makes them")
    return profile_picture(visit, estimate)[1]


def variance_budget(visit: Visit) -> Figure:
    """What each unknown does to the variance of the ratios.

    Raises
    ------
    SubjectError : the visit has no estimate, or one without a budget (the paper's method).
    """
    from spinestiff.study.report.pictures import budget_picture

    estimate = _estimate(visit)
    if not estimate.budget:
        raise SubjectError("this estimate has no budget of variance; spinestiff estimate --method weighed makes one")
    return budget_picture(estimate)[1]


def supports(visit: Visit) -> Figure:
    """Where pelvis and shoulder were in each frame.

    Raises
    ------
    SubjectError : the visit has not been assessed, or its method does not ask where supports were.
    """
    from spinestiff.study.report.pictures import support_picture
    from spinestiff.study.steps import stored_predictions

    drawn = support_picture(_estimate(visit), stored_predictions(visit))
    if drawn is None:
        raise SubjectError("this estimate says nothing of the supports' places; --method weighed does")
    return drawn[1]


def sensitivity(visit: Visit) -> Figure:
    """The estimate with one thing changed at a time.

    Raises
    ------
    SubjectError : ``spinestiff sensitivity`` has not run on this visit.
    """
    from spinestiff.study.report.pictures import tornado_picture
    from spinestiff.subject.run_record import read_outcome
    from spinestiff.subject.sensitivity_outcome import Sensitivity

    return tornado_picture(read_outcome(visit.subject, Sensitivity))[1]


def plan(visit: Visit) -> Figure:
    """The next pushes and what they would bring.

    Raises
    ------
    SubjectError : ``spinestiff plan`` has not run on this visit.
    """
    from spinestiff.study.report.pictures import planned_picture
    from spinestiff.subject.plan_outcome import Plan
    from spinestiff.subject.run_record import read_outcome

    return planned_picture(read_outcome(visit.subject, Plan))[1]


def _estimate(visit: Visit) -> Estimate:
    from spinestiff.subject.estimate_outcome import Estimate
    from spinestiff.subject.run_record import read_outcome

    return read_outcome(visit.subject, Estimate)
