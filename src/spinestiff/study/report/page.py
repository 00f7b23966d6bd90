"""One page about a visit for people: what was found, how sure it is, and the pictures to judge it by.

``results/report.html`` is self-contained (it asks nothing of any other file or host); its pictures lie beside it as PNG
in ``results/figures``, its 3D torso as a page of its own, ``results/view.html``. The same results give the same bytes.
"""

from __future__ import annotations

from dataclasses import dataclass

from matplotlib.figure import Figure

from spinestiff import __version__
from spinestiff.files import write_bytes, write_text
from spinestiff.observer import Observer
from spinestiff.study.predictions import Predictions
from spinestiff.study.report.beside import beside_pictures, beside_rows, pixels_in
from spinestiff.study.report.clinician import clinician_content
from spinestiff.study.report.clinician_picture import moments
from spinestiff.study.report.estimate_content import (
    certainty_content,
    check_rows,
    reaction_rows,
    result_content,
    sensitivity_content,
    stale_plan,
    subject_content,
    uncertainty_content,
)
from spinestiff.study.report.figures import as_png_and_svg
from spinestiff.study.report.frame_content import (
    comparison_content,
    geometry_content,
    millimetre_rows,
    prediction_content,
    response_content,
    support_rows,
)
from spinestiff.study.report.pdf import PDF_FILE
from spinestiff.study.report.pictures import (
    Drawn,
    budget_picture,
    curve_picture,
    frame_picture,
    planned_picture,
    profile_picture,
    region_picture,
    rest_picture,
    support_picture,
    tilt_picture,
    tornado_picture,
)
from spinestiff.study.report.theme import dark_style, for_page
from spinestiff.study.report.viewer.files import scene_of
from spinestiff.study.report.viewer.page import component, page_environment, script_hash, view_page
from spinestiff.study.truth import known_comparison
from spinestiff.study.visit import Visit
from spinestiff.study.wording.numbers import fixed
from spinestiff.study.wording.plan import plan_lines
from spinestiff.subject.assessment_outcome import Assessment
from spinestiff.subject.estimate_outcome import Estimate
from spinestiff.subject.folder import read_push
from spinestiff.subject.geometry_outcome import GeometryRecord
from spinestiff.subject.outcomes import Responses, Tracked
from spinestiff.subject.plan_outcome import Plan
from spinestiff.subject.run_record import is_unchanged, read_outcome
from spinestiff.subject.sensitivity_outcome import Sensitivity
from spinestiff.words import counted


@dataclass(frozen=True)
class Picture:
    """A figure as it stands in the report and beside it as a file.

    Attributes
    ----------
    file : name of the PNG.
    drawing : the same as an element of the page; not to be escaped.
    alt, caption : in words.
    """

    file: str
    drawing: str
    alt: str
    caption: str


def write_report(visit: Visit, predictions: Predictions, say: Observer) -> None:
    """Write ``report.html``, ``view.html`` and ``figures/*.png`` into ``results/`` of a visit that has been assessed.

    Raises
    ------
    SubjectError : a result of an earlier step is missing, or is not as it was written.
    """
    pictures, page, view = _compose(visit, predictions, say)
    folder = visit.file("figures")
    folder.mkdir(parents=True, exist_ok=True)
    for old in folder.glob("[0-9][0-9]-*.png"):
        if old.name not in pictures:
            old.unlink()
    for name, content in pictures.items():
        write_bytes(folder / name, content)
    # A PDF of an earlier report would be none of this one.
    visit.file(PDF_FILE).unlink(missing_ok=True)
    write_text(visit.file("view.html"), view)
    write_text(visit.file("report.html"), page)
    say(f"{visit.file('report.html')} and {counted(len(pictures), 'figure')}")


def _compose(visit: Visit, predictions: Predictions, say: Observer) -> tuple[dict[str, bytes], str, str]:
    """Pictures by file name, the report's page and the viewer's."""
    subject, torso = visit.subject, predictions.pushes.torso
    estimate, assessment = read_outcome(subject, Estimate), read_outcome(subject, Assessment)
    geometry, tracked = read_outcome(subject, GeometryRecord), read_outcome(subject, Tracked)
    say("drawing")
    comparison = None if visit.truth is None else known_comparison(subject, visit.truth)
    region = region_picture(visit, estimate)
    scene = scene_of(visit, predictions)
    album, films = _Album(), {push.id: read_push(subject, push) for push in subject.pushes}
    responses = read_outcome(subject, Responses)
    page = {
        "first": clinician_content(visit, estimate, assessment, responses),
        "moments": [album.add(*picture) for picture in moments(visit, predictions, films, assessment, responses)],
        "subject": subject_content(visit),
        "response": response_content(responses),
        "result": result_content(visit, estimate, assessment),
        "checks": check_rows(estimate.checks),
        "comparison": comparison_content(assessment),
        "prediction": prediction_content(assessment),
        "certainty": certainty_content(estimate, comparison),
        "uncertainty": uncertainty_content(estimate, predictions),
        "reactions": reaction_rows(estimate.reactions_n),
        "reaction_push": estimate.reactions_n.push,
        "supports": support_rows(tracked),
        "geometry": geometry_content(geometry, estimate),
        "millimetres": millimetre_rows(geometry, tracked),
        "cost": estimate.cost,
        "training": {
            "default": "" if (default := estimate.training_rmse_mm.default) is None else fixed(default, 2),
            "fit": fixed(estimate.training_rmse_mm.fit, 2),
        },
        "version": __version__,
        "held_out": [
            album.add(*frame_picture(visit, predictions, p, films[p.item.push]))
            for p in predictions.of_role("validation")
        ],
        "rest": [album.add(*rest_picture(visit, torso, view, geometry)) for view in geometry.views],
        "curves": _added(album, curve_picture(predictions)),
        "region": _added(album, region),
        "profiles": album.add(*profile_picture(visit, estimate)) if estimate.profiles else None,
        "budget": album.add(*budget_picture(estimate)) if estimate.budget else None,
        "support_places": _added(album, support_picture(estimate, predictions)),
        "levels": _added(album, tilt_picture(visit, predictions)),
        "beside": beside_rows(predictions),
        "beside_pictures": [album.add(*picture) for picture in beside_pictures(predictions, pixels_in(visit))],
        "sensitivity": _sensitivity(visit, album),
        "plan": _plan(visit, album),
        "scene": component(scene),
        "script_hash": script_hash(),
        "dark_figures": dark_style(),
    }  # fmt: skip
    return album.files, page_environment().get_template("report.html.j2").render(page), view_page(scene)


class _Album:
    """Collects pictures in the order in which they are drawn."""

    def __init__(self) -> None:
        self.files: dict[str, bytes] = {}

    def add(self, name: str, figure: Figure, alt: str, caption: str) -> Picture:
        number = f"{len(self.files) + 1:02d}"
        file = f"{number}-{name}.png"
        self.files[file], drawing = as_png_and_svg(figure)
        return Picture(file, for_page(drawing, f"figure-{number}"), alt, caption)


def _added(album: _Album, picture: Drawn | None) -> Picture | None:
    return None if picture is None else album.add(*picture)


def _sensitivity(visit: Visit, album: _Album) -> dict[str, object] | None:
    """Refits with one thing changed, where they were made from what is there now."""
    if not is_unchanged(visit.subject, Sensitivity.STEP):
        return None
    found = read_outcome(visit.subject, Sensitivity)
    return {**sensitivity_content(found), "picture": album.add(*tornado_picture(found))}


def _plan(visit: Visit, album: _Album) -> dict[str, object] | None:
    """The next pushes, where they were planned from what is there now; of a plan that wasn't, why it is not shown."""
    if not visit.file(Plan.FILE).is_file():
        return None
    if not is_unchanged(visit.subject, Plan.STEP):
        return {"stale": stale_plan(visit), "lines": [], "picture": None}
    plan = read_outcome(visit.subject, Plan)
    return {"stale": "", "lines": plan_lines(plan), "picture": album.add(*planned_picture(plan))}
