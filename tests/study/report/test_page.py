"""The report: complete, self-contained, safe against names from files, and the same each time."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from collections.abc import Iterator, Sequence
from html.parser import HTMLParser
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from canaries import infest, traces
from chromium import WEBGL, Tab, browser
from results import altered, register
from spinestiff.anatomy.files import write_torso
from spinestiff.anatomy.state import TorsoState
from spinestiff.anatomy.stiffness import stiffness_ratios
from spinestiff.anatomy.template import template_torso
from spinestiff.curves.pushes import push_responses
from spinestiff.errors import SubjectError
from spinestiff.files import write_json
from spinestiff.imaging.features import VertebraCorners, silhouette_shares, state_features
from spinestiff.imaging.projection import XRayView, frontal_view, lateral_view
from spinestiff.imaging.radiograph import write_radiographs
from spinestiff.imaging.tracking import SupportMotion
from spinestiff.mechanics.equilibrium import EquilibriumProblem
from spinestiff.mechanics.loads import rib_push
from spinestiff.mechanics.supports import three_point_supports
from spinestiff.study.predictions import Model, predict, stored, write_solved
from spinestiff.study.report import page as report
from spinestiff.study.report import pictures as drawing
from spinestiff.study.report.estimate_content import _strip, budget_bars, certainty_content, result_content
from spinestiff.study.report.page import write_report
from spinestiff.study.report.viewer.page import script_hash
from spinestiff.study.sensitivity import force_percent
from spinestiff.study.steps import stored_predictions
from spinestiff.study.truth import read_truth
from spinestiff.study.visit import Visit, load_pushes, open_visit
from spinestiff.study.wording.steps import response_texts
from spinestiff.subject.annotation_record import Annotation, ImageAnnotation
from spinestiff.subject.assessment_outcome import Assessment, Comparison
from spinestiff.subject.estimate_outcome import BudgetRecord, Estimate, PlainStiffness, RatioEstimate
from spinestiff.subject.folder import write_annotation, write_subject
from spinestiff.subject.geometry_outcome import GeometryRecord
from spinestiff.subject.outcome_parts import OutcomeFile, ViewRecord
from spinestiff.subject.outcomes import Responses, Tracked, TrackedPush
from spinestiff.subject.plan_outcome import Plan, PlannedPush, PlanStep
from spinestiff.subject.records import PushRecord, SubjectRecord
from spinestiff.subject.run_record import read_outcome, record_step, step_record, write_outcome
from spinestiff.subject.sensitivity_outcome import Refit, Sensitivity

TRUE = {"lateral_bending": 0.22, "tissue": 0.045}
ESTIMATE = {"lateral_bending": 0.2, "tissue": 0.05}
SEEN = slice(2, 16)
PAPERS_MM = {"a4": (210.0, 297.0), "letter": (215.9, 279.4)}
VIEWER = Path(report.__file__).with_name("viewer").joinpath("viewer.js").read_text(encoding="utf-8")
PUSHES = {
    "main": (8.0, (0.0, 30.0, 60.0), ("unused", "training", "validation")),
    "second": (5.5, (0.0, 50.0), ("unused", "validation")),
}
SECTIONS = (
    "summary",
    "result",
    "pictures",
    "torso",
    "force",
    "certainty",
    "uncertainty",
    "prediction",
    "levels",
    "supports",
    "geometry",
    "computation",
)


def make_visit(folder: Path, side: int = 256, seed: int = 1) -> Visit:
    """A subject folder as the steps before the report leave it, from the engine itself and noise for radiographs."""
    random = np.random.default_rng(seed)
    torso = template_torso(157.0, "coarse")
    middle = torso.rest_pose.bone_positions[torso.vertebra_bones][[0, -1]].mean(0) * [0.0, 1.0, 0.0]
    size = {"shape": (side, side), "pixel": 0.417 * 1024 / side, "centre": middle}
    views = {"frontal": frontal_view(**size), "lateral": lateral_view(**size)}
    problem = EquilibriumProblem(torso, three_point_supports(torso, "left"))
    ratios = stiffness_ratios(TRUE, torso.joints.kinds)
    images, records, tracked = {}, [], {}

    def corners(view: XRayView, state: TorsoState) -> np.ndarray:
        shares = silhouette_shares(torso, view, torso.rest_pose)
        seen = state_features(torso, view, state, shares).corners[SEEN]
        return view.pixels(seen + random.normal(0.0, 0.4, seen.shape))

    def annotated(found: np.ndarray) -> ImageAnnotation:
        return ImageAnnotation.model_validate({"vertebrae": dict(zip(torso.vertebrae[SEEN], found.round(3).tolist()))})

    def radiographs(path: Path, view: XRayView, count: int) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        smooth = np.cumsum(np.cumsum(random.standard_normal((count, side, side)), 1), 2)
        grey = (smooth - smooth.min()) / np.ptp(smooth) * 6e4
        write_radiographs(path, grey.astype(np.uint16), view, description=path.stem)

    for name, view in views.items():
        radiographs(folder / "rest" / f"{name}.dcm", view, 1)
        images[f"rest/{name}"] = annotated(corners(view, torso.rest_pose))
    for name, (level, forces, roles) in PUSHES.items():
        radiographs(folder / "pushes" / f"{name}.dcm", views["frontal"], len(forces))
        frames, state, view = [], torso.rest_pose, views["frontal"]
        for force in forces:
            state = problem.solve(rib_push(torso, "left", level, force), ratios, state).require().state
            frames.append(corners(view, state))
        images[f"push/{name}"] = annotated(frames[0])
        records.append(
            PushRecord(
                id=name, side="left", level=level, d21_mm=400.0, d31_mm=200.0, frames=f"pushes/{name}.dcm",
                forces_n=forces, roles=roles,
            )
        )  # fmt: skip
        quality = np.full((14, 4), 0.9)
        tracked[name] = TrackedPush.of(
            view,
            [VertebraCorners(torso.vertebrae[SEEN], view.from_pixels(found), quality) for found in frames],
            moved(forces),
            millimetres={"pixel spacing": "DICOM ImagerPixelSpacing, at the detector", "orientation": "DICOM L\\F"},
        )
    subject = SubjectRecord(schema_version=1, id="made-up-1", age=13.0, sex="female", height_cm=157.0, pushes=records)
    write_subject(folder, subject)
    write_annotation(folder, Annotation(schema_version=1, images=images))
    made = open_visit(folder)
    (folder / "results").mkdir()
    write_torso(made.file("torso.npz"), torso)
    register(made.subject, "personalise", "torso.npz")
    for outcome in (Tracked(pushes=tracked), geometry_record(views, torso.vertebrae), estimate_record()):
        write_outcome(made.subject, outcome)
        register(made.subject, outcome.STEP, outcome.FILE)
    write_outcome(made.subject, push_responses(made.subject))
    register(made.subject, "response", Responses.FILE)
    pushes = load_pushes(made, made.manner)
    models = {"default": Model(), "fit": Model(stiffness_ratios(ESTIMATE, torso.joints.kinds))}
    write_solved(made.file("predictions.npz"), stored(predict(pushes, models, {}, lambda line: None)))
    write_outcome(made.subject, assessment_record())
    register(made.subject, "assess", "predictions.npz", Assessment.FILE)
    return made


def geometry_record(views: dict[str, XRayView], names: tuple[str, ...]) -> GeometryRecord:
    source = {"pixel spacing": "DICOM ImagerPixelSpacing, at the detector", "orientation": "DICOM"}
    fit = {"rmse_mm": 1.2, "centre_mm": 0.8, "angle_deg": 1.0, "wrong_corners": 0}
    pose = {"shift_mm": [1.2, -3.4], "roll_deg": 0.51, "yaw_deg": 0.0, "rms_mm": 1.3}
    return GeometryRecord.model_validate(
        {
            "rmse_mm": {"frontal": 1.31, "lateral": 1.64},
            "fits": {view: dict.fromkeys(names[SEEN], fit) | {"T7": {**fit, "rmse_mm": 2.5}} for view in views},
            "prior_only": ["T1", "T2", "L5"],
            "carried": {},
            "length_scale": 1.0,
            "size_scale": dict.fromkeys(names, (1.0, 1.0, 1.0)),
            "corner_sd_mm": 0.4,
            "covariance": (1e-6 * np.eye(6 * len(names))).reshape(len(names), 6, -1).tolist(),
            "mesh": {"path": "rebuilt", "nodes": 6115, "smallest_j": 1.0, "smallest_dihedral_deg": 7.4},
            "poses": dict.fromkeys(views, pose),
            "views": {name: ViewRecord.of(view) for name, view in views.items()},
            "millimetres": dict.fromkeys(views, source),
            "skin_scan": None,
            "warnings": [],
        }
    )


def moved(forces: Sequence[float]) -> tuple[SupportMotion, ...]:
    """A pelvis that moves by 0.09 mm and turns by 0.08 degrees a newton; a shoulder that lies still."""
    force, every = np.array(forces), np.ones(len(forces), bool)
    still = np.zeros((len(forces), 2))
    sd = np.full(len(forces), 0.3)
    pelvis = SupportMotion(
        "pelvis",
        still + [[0.09 * f, 0.0] for f in forces],
        sd,
        every,
        np.radians(0.08 * force),
        np.radians(sd),
        every,
        0.1,
    )
    return pelvis, SupportMotion("shoulder", still, sd, every, 0.0 * force, sd, ~every, 0.1)


def estimate_record() -> Estimate:
    angle = np.linspace(0.0, 2.0 * np.pi, 60)
    region = np.exp(np.log(list(ESTIMATE.values())) + np.stack([0.15 * np.cos(angle), 0.4 * np.sin(angle - 0.5)], 1))
    steps = ([1.0, 1.0], [0.4, 0.3], [0.22, 0.08], [0.9, 0.9], [0.2, 0.05])
    bending, tissue = (
        RatioEstimate.of(value, ends, (False, False), False)
        for value, ends in ((0.2, (0.173, 0.231)), (0.05, (0.034, 0.074)))
    )
    bending, tissue = (
        one.model_copy(update={"profile": kind}) for one, kind in ((bending, "bounded"), (tissue, "flat"))
    )

    def plain(value: float, of: RatioEstimate, unit: str) -> dict:
        return {
            "value": value, "low": value * of.low / of.value, "high": value * of.high / of.value, "unit": unit,
            "ratio": "tissue" if of is tissue else "lateral_bending",
        }  # fmt: skip

    return Estimate.model_validate({
        "status": "CONVERGED",
        "fit_status": "CONVERGED",
        "fit_status_text": "converged",
        "determined": "determined",
        "checks": [],
        "ratios": {"lateral_bending": bending, "tissue": tissue},
        "plain": {
            "lateral_bending_thoracic": plain(30.8, bending, "N m/rad"),
            "lateral_bending_lumbar": plain(29.8, bending, "N m/rad"),
            "tissue_young": plain(50.0, tissue, "kPa"),
        },
        "covariance_log": [[0.005, -0.002], [-0.002, 0.03]],
        "correlation": -0.42,
        "parameters": ["lateral_bending", "tissue"],
        "region_size": 6.5,
        "region": region.tolist(),
        "interval_rise": 1.92,
        "profiles": {
            "lateral_bending": {"ratio": [0.16, 0.2, 0.25], "rise": [4.0, 0.0, 4.0]},
            "tissue": {"ratio": [0.03, 0.05, 0.08], "rise": [3.0, 0.0, 3.0]},
        },
        "training_rmse_mm": {"default": 7.31, "fit": 1.12},
        "reactions_n": {
            "push": "push 'main' frame 1", "f3": 30.0, "shoulder": 14.6, "pelvis": 15.4,
            "pelvis_moment_nm": 2.35, "wall_pull": 1.2, "eq2_shoulder": 15.0, "eq1_pelvis": 15.0,
        },
        "history": [
            {"ratios": dict(zip(ESTIMATE, step)), "loss": 10.0 / (i + 1), "rmse_mm": 5.0 / (i + 1), "accepted": i != 3}
            for i, step in enumerate(steps)
        ],
        "nuisances": [
            {
                "name": "obliquity under pushes from the left", "group": "obliquity by force", "unit": "rad",
                "value": 0.02, "sd": 0.01, "prior_sd": 0.025, "standard": 0.5,
            },
            {
                "name": "obliquity in push 'main' frame 1", "group": "obliquity of a frame", "unit": "rad",
                "value": 0.007, "sd": 0.01, "prior_sd": 0.017, "standard": 0.4,
            },
        ],
        "supports": [{"push": "main", "frame": 1, "obliquity_deg": 0.7, "shoulder_mm": 0.0}],
        "sd_log": {"lateral_bending": 0.4, "tissue": 0.2},
        "sd_log_tracking": {"lateral_bending": 0.1, "tissue": 0.05},
        "budget": [
            budget_row("model discrepancy", (0.3, 0.10), (0.25, 0.19)),
            budget_row("trunk size", (0.1, 0.18), (0.4, 0.10)),
            budget_row("push height", (0.2, 0.06), (0.3, 0.2)),
        ],
        "prior_changes": [
            prior_change("push height", 0.5, (0.21, 0.05), (0.35, 0.2)),
            prior_change("push height", 2.0, (0.18, 0.05), (0.5, 0.2)),
            prior_change("trunk size", 2.0, (0.2, 0.06), (0.4, 0.35)),
        ],
        "best_known": {"exponents": {"lateral_bending": 0.4, "tissue": 1.0}, "value": 0.0262, "sd_log": 0.06},
        "p_value": 0.42,
        "tracking_factor": 1.13,
        "method": "weighed",
        "mesh": "fine",
        "orientation": "procrustes",
        "bounds": [0.005, 5.0],
        "poses": {key: {"shift_mm": [0.4, 1.0], "roll_deg": -0.3, "yaw_deg": 0.0, "rms_mm": 1.0} for key in PUSHES},
        "cost": {"equilibria": 9, "newton_iterations": 40, "factorisations": 61, "seconds": 12.3},
        "notes": ["push 'main' frame 1: 1 vertebra lost"],
    })  # fmt: skip


def budget_row(name: str, alone: tuple[float, float], without: tuple[float, float]) -> dict:
    return {"name": name, "alone": dict(zip(ESTIMATE, alone)), "without": dict(zip(ESTIMATE, without))}


def prior_change(name: str, factor: float, ratios: tuple[float, float], sd: tuple[float, float]) -> dict:
    return {"name": name, "factor": factor, "ratios": dict(zip(ESTIMATE, ratios)), "sd_log": dict(zip(ESTIMATE, sd))}


def assessment_record() -> Assessment:
    def change(size: float) -> dict:
        levels = {"levels": ["T5", "T11"], "tilt_levels": ["T6", "T12"]}
        return {"signed": size, "fixed_levels": 0.9 * size, "tilt": 1.1 * size, **levels}

    errors = {"rest": 14.0, "default": 9.0, "fit": 1.5, "extrapolation": 2.0, "single_ratio": 1.9, "truth": None}
    cobb = {"measured": change(-14.2), "default": change(-3.0), "fit": change(-13.1)}
    frames = [
        {"push": "main", "frame": 2, "force_n": 60.0, "rmse_mm": errors, "cobb_change_deg": cobb},
        {"push": "second", "frame": 1, "force_n": 50.0, "rmse_mm": {**errors, "fit": None}, "cobb_change_deg": cobb},
    ]
    notes = ["push 'main' frame 2: the back wall pulls at 2 points"]
    return Assessment.model_validate({"frames": frames, "notes": notes})


class Page(HTMLParser):
    """What a page holds: tags, ids, headings, addresses, texts; complains about tags that don't close."""

    VOID = frozenset({"meta", "link", "img", "br", "input"})

    def __init__(self, text: str) -> None:
        super().__init__(convert_charrefs=True)
        self.open: list[str] = []
        self.tags: list[str] = []
        self.attributes: list[tuple[str, str, str]] = []
        self.headings: list[str] = []
        self.text: list[str] = []
        self.feed(text)
        self.close()
        assert not self.open, f"left open: {self.open}"

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.attributes += [(tag, name, value or "") for name, value in attrs]
        if tag not in self.VOID:
            self.open.append(tag)
        if re.fullmatch("h[1-6]", tag):
            self.headings.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open, f"</{tag}> closes nothing"
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self.open and self.open[-1] not in ("style", "script"):
            self.text.append(data)

    def all(self, tag: str, name: str) -> list[str]:
        return [value for t, n, value in self.attributes if t == tag and n == name]

    @property
    def words(self) -> str:
        return " ".join(" ".join(self.text).split())


def pictures(page: Page) -> list[str]:
    """What pictures show, in words."""
    return [value for tag, name, value in page.attributes if (tag, name) == ("div", "aria-label") and len(value) > 60]


def written(visit: Visit) -> str:
    write_report(visit, stored_predictions(visit), lambda line: None)
    return visit.file("report.html").read_text(encoding="utf-8")


def told(visit: Visit, drawn: int = 0) -> str:
    """The report with empty pictures but the first few, for what it says: most of the time goes into drawing."""
    real, left = report.as_png_and_svg, iter(range(drawn))
    with pytest.MonkeyPatch.context() as patch:
        empty = (b"", b"<svg></svg>")
        patch.setattr(report, "as_png_and_svg", lambda figure: empty if next(left, None) is None else real(figure))
        return written(visit)


def changed(visit: Visit, folder: Path, kind: type[OutcomeFile], change) -> Visit:
    """A copy of the visit with one result changed by ``change(content)``."""
    shutil.copytree(visit.subject.folder, folder)
    altered(folder, kind, change)
    return open_visit(folder)


@pytest.fixture(scope="module")
def visit(tmp_path_factory: pytest.TempPathFactory) -> Visit:
    made = make_visit(tmp_path_factory.mktemp("visit"))
    for seed, path in enumerate(sorted(made.subject.folder.rglob("*.dcm"))):
        infest(path, np.random.default_rng(seed), 60)
    return made


@pytest.fixture(scope="module")
def drawn() -> dict[str, list]:
    """What the figures were asked to show while ``html`` was made, by drawing function."""
    return {}


@pytest.fixture(scope="module")
def html(visit: Visit, drawn: dict[str, list]) -> str:
    with pytest.MonkeyPatch.context() as patch:
        for name in ("draw_overlay", "draw_curve_changes", "draw_tilt_changes", "draw_ratio_map", "draw_profiles"):
            real = getattr(drawing, name)

            def noted(content, name=name, real=real):
                drawn.setdefault(name, []).append(content)
                return real(content)

            patch.setattr(drawing, name, noted)
        # Everything that is shown was solved by earlier steps.
        patch.setattr(EquilibriumProblem, "solve", None)
        return written(visit)


@pytest.fixture(scope="module")
def page(html: str) -> Page:
    return Page(html)


def test_nothing_of_a_patient_is_in_it(visit: Visit, html: str) -> None:
    """The radiographs are full of canaries; the report, its pictures and the view show the radiographs."""
    assert (visit.subject.results / "view.html").is_file()
    # Letters of a picture's bytes may spell anything; pictures are looked at as files.
    assert set(traces(visit.subject.results)) <= {"report.html"}
    assert not traces(re.sub(r"data:image/png;base64,[^\"]*", "", html))
    assert traces(visit.subject.folder / "rest")


def test_refits_are_shown_where_they_are_of_this_estimate(visit: Visit, html: str, tmp_path: Path) -> None:
    assert "If something had been otherwise" not in html
    shutil.copytree(visit.subject.folder, tmp_path / "girl")
    again = open_visit(tmp_path / "girl")

    def refit(series: str, what: str, by: str, bending: float, tissue: float) -> Refit:
        percent = dict(zip(ESTIMATE, (bending, tissue)))
        return Refit(
            series=series, what=what, by=by, ratios=ESTIMATE, percent=percent, stiffness_percent=percent
        )  # fmt: skip

    refits = (
        refit("weighed", "nothing", "", 0.0, 0.0),
        refit("weighed", "force", "−10 %", -9.0, -12.0),
        refit("weighed", "force", "+10 %", 9.0, 13.0),
        refit("weighed", "push level", "one rib lower", 11.0, -26.0),
    )
    found = Sensitivity(
        basis="", mesh="coarse", parameters=tuple(ESTIMATE), estimate=ESTIMATE, interval95=dict.fromkeys(ESTIMATE),
        refits=refits, force_percent=force_percent(refits), complete=True,
    )  # fmt: skip
    write_outcome(again.subject, found)
    register(again.subject, "sensitivity", Sensitivity.FILE)
    shown = told(again)
    page = Page(shown)
    assert tuple(page.all("section", "id")) == (*SECTIONS[:7], "sensitivity", *SECTIONS[7:])
    assert set(page.all("a", "href")) >= {"#sensitivity"}
    assert "push level ±1 rib: at most 26 %" in " ".join(pictures(page))
    assert "Koutras et al. 2025, mean of seven subjects" in page.words
    assert "7.6" in page.words and "28.6" in page.words
    assert "Largest change of each stiffness: lateral_bending +11 % (push level one rib lower)" in page.words
    names = [path.name for path in sorted(again.file("figures").glob("*.png"))]
    assert names[-1].endswith("-sensitivity.png")
    # Of another estimate it is none.
    register(again.subject, "estimate", Estimate.FILE)
    path = again.file(Sensitivity.FILE)
    path.write_text(path.read_text(encoding="utf-8") + " ", encoding="utf-8")
    assert "If something had been otherwise" not in told(again)
    assert not list(again.file("figures").glob("*-sensitivity.png"))


def test_a_plan_is_shown_where_it_is_of_this_estimate_and_named_where_it_is_not(
    visit: Visit, html: str, tmp_path: Path
) -> None:
    assert "Which push next" not in html
    shutil.copytree(visit.subject.folder, tmp_path / "girl")
    again = open_visit(tmp_path / "girl")

    def push(level: float, factor: float, view: str, radiographs: int) -> PlannedPush:
        return PlannedPush(
            side="left", level=level, force_n=60.0, view=view, radiographs=radiographs, expected_factor=factor,
            factors={"lateral_bending": factor, "tissue": 1.5},
        )  # fmt: skip

    near, far, aside = push(6.0, 1.4, "frontal", 2), push(8.0, 1.6, "frontal", 2), push(6.0, 1.39, "frontal+lateral", 4)
    plan = Plan(
        target="bending", limit_n=60.0, basis="estimate", taken=3, now={"lateral_bending": 2.1, "tissue": 1.9},
        now_deg=None, estimated={}, next=(aside, near, far), taped=None,
        sequence=(PlanStep(push=near, exposures=2, pays=True), PlanStep(push=far, exposures=4, pays=False)),
    )  # fmt: skip
    write_outcome(again.subject, plan)
    made_from = step_record(again.subject, [f"results/{Estimate.FILE}"], {})
    record_step(again.subject, Plan.STEP, made_from, [again.file(Plan.FILE)])
    shown = Page(told(again))
    assert tuple(shown.all("section", "id")) == (*SECTIONS[:7], "plan", *SECTIONS[7:])
    assert set(shown.all("a", "href")) >= {"#plan"}
    assert "rib 6 left, 60 N: within a factor of 1.4" in " ".join(pictures(shown))
    assert "Best next: rib 6 left, 60 N, frontal, expected within a factor of 1.4" in shown.words
    assert "Further radiographs hardly narrow it after 2 exposures" in shown.words
    assert [path.name for path in sorted(again.file("figures").glob("*.png"))][-1].endswith("-plan.png")
    path = again.file(Estimate.FILE)
    path.write_text(path.read_text(encoding="utf-8") + " ", encoding="utf-8")
    register(again.subject, "estimate", Estimate.FILE)
    stale = Page(told(again))
    assert "A plan is not shown: results/plan.json was made before results/estimate.json changed" in stale.words
    assert "Best next" not in stale.words
    assert not list(again.file("figures").glob("*-plan.png"))
    write_outcome(again.subject, plan.model_copy(update={"limit_n": 50.0}))
    record_step(again.subject, Plan.STEP, step_record(again.subject, [], {}), [again.file(Plan.FILE)])
    again.file(Plan.FILE).write_text("{}", encoding="utf-8")
    assert "results/plan.json is not as spinestiff plan wrote it; run spinestiff plan again" in told(again)


def test_every_section_is_there_and_linked(page: Page) -> None:
    assert tuple(page.all("section", "id")) == SECTIONS
    assert tuple(link.removeprefix("#") for link in page.all("a", "href")) == SECTIONS
    assert page.headings[0] == "h1" and page.headings.count("h1") == 1
    # No level is jumped over.
    levels = [int(tag[1]) for tag in page.headings]
    assert all(b <= a + 1 for a, b in zip(levels, levels[1:]))


def test_nothing_is_asked_of_another_host(html: str, page: Page) -> None:
    # The viewer's script has a test of its own; the policy names it by its hash.
    assert html.count(VIEWER) == 1
    rest = html.replace(VIEWER, "")
    # A drawing refers to its own clips and marks, by names that are there.
    assert not re.search(r"https?://|@import|url\((?!#)|javascript:", rest, re.IGNORECASE)
    assert set(re.findall(r"url\(#([^)]*)\)", rest)) <= set(re.findall(r' id="([^"]*)"', rest))
    assert len(set(re.findall(r' id="([^"]*)"', rest))) == len(re.findall(r' id="([^"]*)"', rest))
    assert re.findall(r"<script[^>]*>", html) == ['<script type="application/json" data-role="scene">', "<script>"]
    assert all(source.startswith("data:image/png;base64,") for source in page.all("image", "href"))
    assert len(page.all("image", "href")) > 5 and "img" not in page.tags
    assert all(link.startswith("#") for tag in ("a", "use") for link in page.all(tag, "href"))
    assert page.all("link", "href") == ["data:,"]
    assert not {"iframe", "object", "embed", "form", "base"} & set(page.tags)
    policy = page.all("meta", "content")[0]
    assert policy.startswith(
        f"default-src 'none'; script-src {script_hash()}; img-src data:; style-src 'unsafe-inline'; "
    )
    assert not [name for _, name, _ in page.attributes if name.startswith("on")]


def test_every_picture_is_described_and_lies_beside_the_page(visit: Visit, page: Page) -> None:
    alts = pictures(page)
    assert len(alts) == page.tags.count("svg") == 13
    assert all(len(alt) > 40 for alt in alts)
    # The first picture is of the frame before the push, which is another one than that of the other two.
    assert [re.findall(r"push “main”, frame \d, \d+ N[^.]*\.", alt) for alt in alts[:3]] == [
        ["push “main”, frame 0, 0 N."],
        *[["push “main”, frame 2, 60 N from the patient’s left."]] * 2,
    ]
    files = sorted(path.name for path in visit.file("figures").iterdir())
    assert len(files) == 13
    # Those of the first page stand there without their names.
    assert [name for name in files if f"figures/{name}" not in page.words] == files[:3]
    for path in visit.file("figures").iterdir():
        assert path.read_bytes().startswith(b"\x89PNG")


def test_boxes_lie_on_the_corners_that_were_tracked(visit: Visit, html: str, drawn: dict[str, list]) -> None:
    assert html
    overlay = drawn["draw_overlay"][0]
    tracked = read_outcome(visit.subject, Tracked).pushes["main"]
    corners = np.array(tracked.frames[2].corners_px)
    assert overlay.vertebrae == tracked.vertebrae
    # A box has the model's size and stands on the middle of its corners.
    np.testing.assert_allclose(overlay.measured.mean(1), corners.mean(1), atol=1e-6)
    np.testing.assert_allclose(overlay.measured, corners, atol=4.0)
    rest, default, fit = overlay.panels
    assert rest.rmse_mm > default.rmse_mm > 3.0 * fit.rmse_mm
    for panel in overlay.panels:
        apart = (panel.boxes - overlay.measured) * overlay.mm_per_pixel
        assert np.sqrt(np.mean(np.sum(apart**2, axis=-1))) == pytest.approx(panel.rmse_mm, rel=1e-6)
    # A push from the patient's left, who faces the tube: from the picture's right edge to its left.
    assert overlay.sides == ("R", "L") and overlay.arrow[1] == -1.0 and overlay.arrow[2] == "60 N"
    frontal, lateral = drawn["draw_overlay"][2:]
    assert frontal.sides == ("R", "L") and lateral.sides == ("P", "A") and lateral.arrow is None


def test_curves_and_tilts_agree_with_the_pushes(html: str, drawn: dict[str, list]) -> None:
    assert html
    main, second = drawn["draw_curve_changes"][0]
    assert (main.push, second.push) == ("main", "second")
    assert main.measured["training"][:, 0].tolist() == [30.0] and main.measured["validation"][:, 0].tolist() == [60.0]
    # Pushed from the left the spine becomes right-convex, and the measured spine follows the estimate.
    measured = main.measured["validation"][0, 1]
    fit, default = (main.simulated[name][-1, 1] for name in ("fit", "default"))
    assert measured < 0.0 and fit < 0.0 and abs(fit - measured) < abs(default - measured)
    assert main.simulated["fit"][0].tolist() == [0.0, 0.0] and len(main.simulated["fit"]) == 3
    tilts = drawn["draw_tilt_changes"][0]
    titles = ["“main”, 30 N (training)", "“main”, 60 N (held out)", "“second”, 50 N (held out)"]
    assert [t.title for t in tilts] == titles
    # T8 is the sixth of T3 to L4; above the push the left side sinks, below it rises.
    assert tilts[1].level == 5.0 and tilts[2].level == 2.5
    assert tilts[1].simulated["fit"][0] < 0.0 < tilts[1].simulated["fit"][-1]
    np.testing.assert_allclose(tilts[1].measured, tilts[1].simulated["fit"], atol=3.0)
    bending, tissue = drawn["draw_profiles"][0]
    assert (bending.estimate, bending.ends, bending.limit) == (0.2, (0.173, 0.231), 1.92)
    assert bending.curve[:, 1].tolist() == [4.0, 0.0, 4.0] and tissue.curve[1].tolist() == [0.05, 0.0]
    path = drawn["draw_ratio_map"][0].path
    assert path.tolist() == [[1.0, 1.0], [0.4, 0.3], [0.22, 0.08], [0.2, 0.05]]


def test_without_a_joint_region_none_is_told() -> None:
    """As by the paper's method."""
    estimate = estimate_record().model_copy(update={"region": None})
    _, figure, alt, caption = drawing.region_picture(SimpleNamespace(truth=None), estimate)
    said = " ".join([alt, *(axis.get_title() for axis in figure.axes)])
    assert "region" not in said and caption.endswith("There is no joint region of it.")
    assert not certainty_content(estimate, None)["region"] and certainty_content(estimate_record(), None)["region"]


def test_numbers_stand_in_the_text(page: Page) -> None:
    words = page.words
    for expected in (
        "made-up-1", "0.20, 95 % interval 0.17 to 0.23: determined", "31 N m/rad, between 27 and 36 N m/rad (95 %).",
        "0.050, 95 % interval 0.034 to 0.074: determined", "50 kPa, between 34 and 74 kPa (95 %).",
        "Estimate: determined",
        "1 vertebra lost", "incremental about the standing posture, net of gravity and muscle tone",
        "Not for diagnosis", "the back wall pulls at 2 points", "1.3 to 1.8 N m per degree", "T1, T2 and L5", "−0.42",
        "−14.2° ", "−15.6° (T6–T12)", "9 equilibria", "Pelvis, moment in N m 2.35 0.00",
        "Back wall, largest pull 1.2", "5.4 mm 0.0 mm +4.8° ± 0.3° frame 2",
    ):  # fmt: skip
        assert expected in words, expected
    assert not re.search(r"\b([nN]a[nN]|None|inf|Infinity|[uU]ndefined)\b", words)


def test_what_needs_no_model_stands_before_the_estimate(visit: Visit, page: Page) -> None:
    responses = read_outcome(visit.subject, Responses)
    texts = [text for push in responses.pushes.values() for text in response_texts(push)]
    assert len(texts) >= 6
    places = [page.words.index(text[0].upper() + text[1:]) for text in texts]
    assert places == sorted(places)
    assert places[-1] < page.words.index("Estimate: determined")
    # Then the combination that the data fix best, then each ratio.
    best = page.words.index(
        "Known best is a combination: (Lateral bending of the spine)^0.40 × (Soft tissue of the trunk) = 0.026 within "
        "a factor of 1.12 (95 %, to first order)."
    )
    assert page.words.count("Known best is a combination") == 1
    assert page.words.index("Estimate: determined") < best < page.words.index("0.20, 95 % interval 0.17 to 0.23")
    assert "a gauge known to 2 % and 1.5 N" in page.words


def test_missing_values_say_so(page: Page) -> None:
    # The second push has no prediction by the fit.
    row = page.words.split("Model, estimated stiffness")[1]
    assert row.split()[:4] == ["1.50", "not", "available", "Training"]


def test_what_would_be_gained_is_told(page: Page) -> None:
    """Factors are exp(1.96 sd); what the model lacks is nothing that anybody can measure."""
    assert (
        "Lateral bending of the spine is known within a factor of 2.2 (95 %, to first order). Knowing what the "
        "model lacks, which nobody can measure, would make it 1.63. Most would be gained by measuring the push’s "
        "height: known exactly, the factor would be 1.80."
    ) in page.words
    assert (
        "Soft tissue of the trunk is known within a factor of 1.48 (95 %, to first order). Most would be gained by "
        "measuring the trunk’s size: known exactly, the factor would be 1.22."
    ) in page.words
    assert "Lateral bending of the spine. Less likely to both sides: the radiographs bound it." in page.words
    assert "Soft tissue of the trunk. About as likely anywhere within the fit’s bounds" in page.words


def test_bars_are_shares_of_the_variance(visit: Visit) -> None:
    titles, shares = budget_bars(read_outcome(visit.subject, Estimate))
    assert titles == ("the trunk’s size", "what the model lacks", "the push’s height")
    bending = [[0.0, 0.0], [(0.3**2 - 0.1**2) / 0.16, (0.16 - 0.25**2) / 0.16], [0.03 / 0.16, (0.16 - 0.09) / 0.16]]
    np.testing.assert_allclose(shares["lateral_bending"], bending, atol=1e-12)
    assert shares["tissue"][0] == pytest.approx([(0.18**2 - 0.05**2) / 0.04, 0.75])


def test_only_the_largest_unknowns_are_drawn(visit: Visit) -> None:
    estimate = read_outcome(visit.subject, Estimate)
    rows = tuple(
        BudgetRecord(
            name=f"unknown {i}", alone=dict.fromkeys(ESTIMATE, 0.1), without=dict.fromkeys(ESTIMATE, 0.199 - 0.01 * i)
        )
        for i in range(12)
    )
    many = estimate.model_copy(update={"budget": rows, "sd_log": dict.fromkeys(ESTIMATE, 0.2)})
    assert budget_bars(many)[0] == tuple(f"unknown {i}" for i in range(11, 1, -1))


def test_of_many_ratios_those_known_least_are_drawn(visit: Visit) -> None:
    estimate = read_outcome(visit.subject, Estimate)
    sds = {f"ratio {i}": 0.1 + 0.01 * (i % 4) + 0.001 * i for i in range(8)}
    row = BudgetRecord(name="unknown", alone=dict.fromkeys(sds, 0.05), without=dict.fromkeys(sds, 0.05))
    changes = {"budget": (row,), "sd_log": sds, "sd_log_tracking": dict.fromkeys(sds, 0.01)}
    assert list(budget_bars(estimate.model_copy(update=changes))[1]) == ["ratio 2", "ratio 3", "ratio 6", "ratio 7"]


def test_supports_are_told_by_frame(page: Page) -> None:
    """Compliance of 2.83 degrees under 60 N times 0.5, and in the training frame 0.4 degrees of its own.

    In held-out frames the rest of the way to what tracking saw is taken as far as its error allows: 1 / 1.09.
    """
    start = page.words.index("“main”, frame 1, 30 N fitted")
    assert page.words[start:].startswith(
        "“main”, frame 1, 30 N fitted +1.1° ±1.7° +2.4° ±0.3° 0.0 mm ±1.7 mm 0.0 mm ±0.3 mm "
        "“main”, frame 2, 60 N predicted +4.5° ±3.0° +4.8° ±0.3° 0.0 mm ±3.0 mm 0.0 mm ±0.3 mm "
        "“second”, frame 1, 50 N predicted +3.8° ±2.6° +4.0° ±0.3°"
    )


def test_other_priors_are_told_where_they_matter(page: Page, visit: Visit, tmp_path: Path) -> None:
    rows = "The push’s height doubled 0.18 0.050 The trunk’s size doubled 0.20 0.060"
    assert rows in page.words and "halved" not in page.words.split("moves a ratio")[1].split("Residuals")[0]
    assert "p = 0.42 if all errors are as expected. Tracking’s errors were 1.1 times" in page.words

    def steady(content: dict) -> None:
        content["prior_changes"] = content["prior_changes"][:1]
        content["checks"] = [
            {"name": "residuals as expected", "value": 1e-9, "limit": 1e-3, "passed": False, "text": "too large"}
        ]

    words = Page(told(changed(visit, tmp_path / "steady", Estimate, steady))).words
    assert "moves no ratio by more than 0.2 of its standard deviation" in words
    assert "if all errors are as expected: they are not" in words


def test_what_is_held_of_ratios_and_what_many_of_them_leave_out(visit: Visit, page: Page, tmp_path: Path) -> None:
    """What several ratios scale has an interval of its own; other priors, not asked for, are not said to do nothing."""
    assert "what is not from the radiographs" not in page.words
    assert "where several ratios scale one stiffness" not in page.words

    def held(content: dict) -> None:
        content |= {"intervals": "linear", "held": {"population x": "so much"}, "prior_changes": []}
        content["data_sd_log"] = {"lateral_bending": 9.0, "tissue": 0.2}
        content["plain"]["lateral_bending_lumbar"]["ratio"] = None

    words = Page(told(changed(visit, tmp_path / "held", Estimate, held))).words
    assert "How intervals were found, and what is not from the radiographs Intervals: to first order" in words
    assert "Held before the fit, no data: population x: so much." in words
    assert "tissue within a factor of 1.48 and lateral_bending within a factor of more than 1000." in words
    assert re.search(r"where several ratios scale one stiffness .*Per lumbar level 30 N m/rad", words)
    assert "moves no ratio by more than" not in words


def test_the_paper_s_estimator_has_no_intervals(visit: Visit, tmp_path: Path) -> None:
    def paper(content: dict) -> None:
        content["method"], content["region"], content["region_size"] = "paper", None, None
        content["sd_log"] = content["sd_log_tracking"] = {}
        for name in ("nuisances", "supports", "budget", "prior_changes"):
            content[name] = []
        content["p_value"] = content["tracking_factor"] = content["interval_rise"] = None
        content["profiles"] = {}
        for found in (*content["ratios"].values(), *content["plain"].values()):
            found |= {"low": None, "high": None}
        for ratio in content["ratios"].values():
            ratio |= {"profile": None, "determined": "not determined"}
        content["determined"] = "not determined"

    page = Page(told(changed(visit, tmp_path / "paper", Estimate, paper)))
    assert "Estimate: no intervals The paper’s estimator, equal weights with the pelvis level" in page.words
    assert page.words.count("no intervals: the paper’s estimator has none.") == 2
    assert "The paper’s estimator weighs all residuals alike and does not tell." in page.words
    assert "95 % interval" not in page.words.replace("in brackets the 95 % interval", "").split("Joint")[0]
    assert "not determined" not in page.words
    assert tuple(page.all("section", "id")) == SECTIONS


HOSTILE = "<script>alert('x')</script><img src=x onerror=alert(1)>\" onmouseover=\"x"


@pytest.fixture(scope="module")
def odd_html(visit: Visit, tmp_path_factory: pytest.TempPathFactory) -> str:
    """A report of results that are doubtful, beaten by a simpler predictor, beside a truth, and full of bad names."""
    folder = tmp_path_factory.mktemp("odd")

    def doubtful(content: dict) -> None:
        content["status"], content["fit_status"] = "DOUBTFUL", "NOT_IDENTIFIABLE"
        content["fit_status_text"] = "these radiographs can't tell " + HOSTILE
        text = "rest and push do not agree: look for " + HOSTILE
        content["checks"] = [{"name": HOSTILE, "value": 8.0, "limit": 1.0, "passed": False, "text": text}]
        content["ratios"]["lateral_bending"] |= {"high": 5.0, "open_high": True, "determined": "weakly determined"}
        content["ratios"]["tissue"] |= {"low": 0.005, "open_low": True, "high": None, "determined": "not determined"}
        content["determined"] = "not determined"
        content["region"] = content["correlation"] = None
        content["notes"] = [HOSTILE]
        content["reactions_n"]["push"] = HOSTILE
        content["training_rmse_mm"]["default"] = None

    def beaten(content: dict) -> None:
        for frame in content["frames"]:
            simple = {"truth": 0.5, "fitted_supports": 0.6, "extrapolation": 1.0}
            frame["rmse_mm"] |= simple | {"fit": 2.5, "forecast": 2.0}
        content["frames"][0]["rmse_mm"]["single_ratio"] = 1.0004

    def named(content: dict) -> None:
        content["pushes"]["main"]["millimetres"] = {HOSTILE: HOSTILE}

    found = changed(visit, folder / "one", Estimate, doubtful)
    found = changed(found, folder / "two", Assessment, beaten)
    found = changed(found, folder / "three", Tracked, named)
    truth = folder / "truth.json"
    write_json(truth, {"ratios": TRUE})
    write_outcome(found.subject, Comparison(truth=read_truth(truth), region_size=6.5, distance2=1.0, inside=True))
    register(found.subject, "assess", Comparison.FILE)
    return told(Visit(found.subject, found.settings, truth))


def test_best_predictor_is_marked_and_an_oracle_never_is(odd_html: str) -> None:
    assert re.findall(r'class="best">([^<]*)<', odd_html) == ["1.00", "1.00", "1.00"]
    assert "0.50" in Page(odd_html).words and "0.60" in Page(odd_html).words


def test_a_better_simple_predictor_is_owned_up_to(odd_html: str, page: Page) -> None:
    simple = "A simpler predictor does better: “No model: training motion scaled by force”, 1.00 mm."
    assert simple in Page(odd_html).words
    corrected = "corner error is 2.00 mm (2.50 mm without the errors that the training frames show)"
    assert corrected in Page(odd_html).words
    assert "A simpler predictor" not in page.words


def test_open_intervals_and_doubt_are_shown(odd_html: str) -> None:
    words = Page(odd_html).words
    assert "0.17 to ≥ 5: weakly determined" in words and "≤ 0.005 to not available: not determined" in words
    assert "Estimate: doubtful" in words and "These radiographs can't tell" in words
    # What failed stands before any number.
    first, engineer = words.split("The engineer’s part", 1)
    for part, number in ((first, "N m/rad"), (engineer, "Ratio to the default stiffness")):
        doubt = part.index("rest and push do not agree")
        assert part.index("This result is doubtful") < doubt < part.index(number)


def test_no_equilibrium_with_default_stiffness_is_told(odd_html: str) -> None:
    assert "mm with the estimate; with default stiffness there is no equilibrium" in Page(odd_html).words
    assert "not available mm" not in odd_html


def test_a_result_that_passed_says_no_doubt(page: Page, html: str) -> None:
    assert "doubtful" not in page.words and '<span class="status">determined</span>' in html


def test_names_from_files_are_escaped(odd_html: str) -> None:
    found = Page(odd_html)
    assert found.tags.count("script") == odd_html.count("<script") == 2
    first, engineer = found.words.split("The engineer’s part", 1)
    # On the first page long ones are cut.
    assert first.count(HOSTILE) >= 2 and engineer.count(HOSTILE) == 9
    assert not [name for _, name, _ in found.attributes if name.startswith("on")]
    assert found.tags.count("svg") == 13 and "img" not in found.tags


def test_truth_is_compared_when_known(odd_html: str, page: Page) -> None:
    words = Page(odd_html).words
    assert "Synthetic subject with known truth" in words and "truth 0.220" in words and "truth 0.0450" in words
    assert "The 95 % joint region holds the true ratios" in words
    assert "truth" not in page.words.replace("knows neither the truth nor the frame", "")


def test_same_results_give_the_same_bytes(visit: Visit, html: str, tmp_path: Path) -> None:
    pictures = {path.name: path.read_bytes() for path in visit.file("figures").iterdir()}
    shutil.copytree(visit.subject.folder, tmp_path / "copy")
    again = open_visit(tmp_path / "copy")
    stale = again.file("figures") / "11-of-an-earlier-run.png"
    stale.write_bytes(b"old")
    assert written(again) == html
    assert {path.name: path.read_bytes() for path in again.file("figures").iterdir()} == pictures
    assert not list(again.subject.results.glob(".*"))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda content: content.pop("plain"), "plain: missing"),
        (lambda content: content.update(schema_version=99), "found schema_version 99, wanted 3"),
    ],
)
def test_results_of_another_version_are_refused(visit: Visit, html: str, tmp_path: Path, change, words: str) -> None:
    copy = changed(visit, tmp_path / "copy", Estimate, change)
    before = copy.file("report.html").read_bytes()
    with pytest.raises(SubjectError, match=rf"estimate\.json: {words}; run spinestiff estimate .* again"):
        write_report(copy, stored_predictions(visit), lambda line: None)
    assert copy.file("report.html").read_bytes() == before


@pytest.mark.skipif(browser() is None, reason="no Chromium to open the report in")
def test_a_browser_shows_it_without_complaint(visit: Visit, html: str, tmp_path: Path) -> None:
    flags = [
        "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-sync",
        "--disable-background-networking", "--disable-component-update", "--enable-logging=stderr", "--v=0",
    ]  # fmt: skip

    def shown(page: Path) -> tuple[str, str]:
        command = [str(browser()), *flags, f"--user-data-dir={tmp_path / page.stem}", "--dump-dom", page.as_uri()]
        done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True)
        return done.stdout, "\n".join(line for line in done.stderr.splitlines() if "CONSOLE" in line)

    dom, complaints = shown(visit.file("report.html"))
    assert complaints == ""
    assert dom.count("<section") == len(SECTIONS)
    # The policy is in force: what it forbids is complained about.
    bad = tmp_path / "bad.html"
    bad.write_text(html.replace("</main>", "<script>document.title = 'ran'</script></main>"), encoding="utf-8")
    dom, complaints = shown(bad)
    assert "Content Security Policy" in complaints and "<title>ran" not in dom


@pytest.fixture(scope="module")
def tab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Tab]:
    """One browser for what needs no WebGL."""
    with Tab(tmp_path_factory.mktemp("profile")) as opened:
        yield opened


def printed_first_page(tab: Tab, html: str, path: Path, paper: str) -> tuple[int, list[str]]:
    """How many sheets the first page takes, and which of its parts stand out of it; px at 96 an inch."""
    path.write_text(html.replace("</head>", "<style>body > :not(.sheet) { display: none }</style></head>"), "utf-8")
    width, _ = PAPERS_MM[paper]
    tab.call("Emulation.setEmulatedMedia", media="print")
    tab.size(round((width - 24.0) / 25.4 * 96.0), 900)
    tab.open(path)
    out = tab.run(
        "(sheet => [...sheet.querySelectorAll('*')].filter(one => !one.closest('svg') && one.getClientRects().length"
        " && one.getBoundingClientRect().bottom > sheet.getBoundingClientRect().bottom + 1)"
        ".map(one => one.tagName + ' ' + one.textContent.slice(0, 40)))(document.querySelector('.sheet'))"
    )
    tab.call("Emulation.setEmulatedMedia", media="")
    return pages_of(tab.pdf(paper)), out


def pages_of(pdf: bytes) -> int:
    return len(re.findall(rb"/Type\s*/Page\b", pdf))


def crowded(content: dict) -> None:
    """An estimate with as much to say on the first page as there can be."""
    text = "the spine without force lies 8 mm from that of the rest pictures: look for exchanged pictures, " * 4
    content["status"], content["fit_status"] = "DOUBTFUL", "NOT_IDENTIFIABLE"
    content["fit_status_text"] = text
    content["checks"] = [
        {"name": f"rest and push {i}", "value": 8.0, "limit": 1.0, "passed": False, "text": text} for i in range(4)
    ]
    for name in content["ratios"]:
        content["ratios"][name] |= {"low": 0.005, "high": 5.0, "open_low": True, "open_high": True}
        content["ratios"][name]["determined"] = "not determined"
    for found in content["plain"].values():
        found |= {"low": 1.0, "high": 500.0, "open_low": True, "open_high": True}
    content["notes"] = [f"{i}: {text}" for i in range(8)]


@pytest.mark.skipif(browser() is None or sys.platform == "win32", reason="no Chromium to drive by a pipe")
def test_the_first_page_is_one_sheet_whatever_it_has_to_say(tab: Tab, visit: Visit, html: str, tmp_path: Path) -> None:
    on_the_sheet = html.partition('<header class="top">')[0].count('class="drawing"')
    assert on_the_sheet == 3
    full = told(changed(visit, tmp_path / "crowded", Estimate, crowded), on_the_sheet)
    for name, text in (("usual", html), ("crowded", full)):
        for paper in PAPERS_MM:
            pages, out = printed_first_page(tab, text, tmp_path / f"{name}-{paper}.html", paper)
            assert (pages, out) == (1, []), f"{name}, {paper}"
    # What would not fit would be seen: twice the words are two sheets.
    twice = html.replace('class="sheet"', 'class="sheet" style="height: 400mm"')
    assert printed_first_page(tab, twice, tmp_path / "twice.html", "letter")[0] == 2


@pytest.mark.skipif(browser() is None or sys.platform == "win32", reason="no Chromium to drive by a pipe")
def test_on_a_phone_in_the_dark_and_on_paper(tab: Tab, html: str, tmp_path: Path) -> None:
    """Nothing sticks out of the page, figures take the theme's colours, no card is larger than a sheet."""
    page = tmp_path / "report.html"
    page.write_text(html, encoding="utf-8")
    ink = "getComputedStyle(document.querySelector('#certainty .drawing g[style*=\"var(--f-18202a\"]')).fill"
    tab.size(390, 844)
    tab.open(page)
    assert tab.run("document.documentElement.scrollWidth") == 390
    light = tab.run(ink)
    tab.theme("dark")
    assert (light, tab.run(ink)) == ("rgb(24, 32, 42)", "rgb(232, 236, 241)")
    near = tab.run(
        "[...document.querySelectorAll('.strip, .s-strip')].flatMap(strip => [...strip.querySelectorAll('span')]"
        ".filter(one => !one.classList.contains('true')).map(one => one.getBoundingClientRect())"
        ".map((box, i, all) => i ? box.left - all[i - 1].right : 99))"
    )
    assert len(near) > 12 and min(near) > 2.0
    tab.theme("light")
    tab.call("Emulation.setEmulatedMedia", media="print")
    tab.size(703, 960)
    assert tab.run("document.documentElement.scrollWidth") == 703
    cards = tab.run(
        "[...document.querySelectorAll('main .card, main .number, main .box')]"
        ".map(one => [getComputedStyle(one).breakInside, one.getBoundingClientRect().height])"
    )
    assert len(cards) > 10 and {inside for inside, _ in cards} == {"avoid"}
    assert max(height for _, height in cards) < 253.0 / 25.4 * 96.0
    tab.run("(document.querySelectorAll('.v-table').forEach(one => { one.open = true; }), 1)")
    assert tab.run("[...document.querySelectorAll('.v-scroll')].map(one => one.scrollWidth - one.clientWidth)") == [0]


@pytest.mark.skipif(browser() is None or sys.platform == "win32", reason="no Chromium to drive by a pipe")
def test_the_torso_is_drawn_where_it_is_reached_and_on_paper(visit: Visit, html: str, tmp_path: Path) -> None:
    page, viewer = visit.file("report.html"), "document.querySelector('[data-viewer]')"
    assert html
    with Tab(tmp_path / "profile", flags=WEBGL) as tab:
        tab.open(page)
        # Not before it is near: a report is read from its top.
        assert tab.run(f"{viewer}.dataset.state ?? 'waiting'") == "waiting"
        assert tab.pdf().startswith(b"%PDF")
        assert tab.run(f"{viewer}.dataset.state") == "drawn"
        printed = tab.run(f"{viewer}.querySelector('[data-role=printed]').textContent")
        assert printed.startswith("Push main, 60 N; frame 2, held out; Estimated stiffness.")
        tab.open(page)
        tab.run("document.querySelector('#torso').scrollIntoView()")
        tab.until(f"{viewer}.dataset.state === 'drawn'", 60.0)
        assert tab.complaints == []
        assert {address for address in tab.requests if not address.startswith("data:")} == {page.as_uri()}
    # The same picture as a page of its own.
    assert f"Torso of {visit.subject.record.id}" in visit.file("view.html").read_text(encoding="utf-8")


def test_a_ratio_of_a_part_beside_its_whole_is_no_ratio_to_the_default():
    names = ("lateral_bending", "lateral_bending@lumbar")
    entry = RatioEstimate.of(1.8, (1.1, 2.9), (False, False), False)
    scaled = {"lateral_bending_thoracic": names[0], "lateral_bending_lumbar": None, "tissue_young": None}
    plain = {
        key: PlainStiffness(value=20.0, low=12.0, high=33.0, unit="N m/rad", ratio=ratio)
        for key, ratio in scaled.items()
    }
    estimate = SimpleNamespace(
        parameters=names, ratios=dict.fromkeys(names, entry), plain=plain, bounds=(0.0025, 5.0), method="weighed",
        status="CONVERGED", fit_status="CONVERGED", determined="determined", failed=(), best_known=None, notes=(),
        intervals="linear", held={}, data_sd_log={},
    )  # fmt: skip
    whole, part = result_content(SimpleNamespace(truth=None), estimate, SimpleNamespace(notes=()))["ratios"]
    assert (whole["unit"], whole["of_whole"]) == ("N m/rad", False)
    assert (part["unit"], part["of_whole"]) == ("times the ratio of the whole", True)
    assert part["words"] == "1.8 {0}, between 1.1 and 2.9 {0} (95 %)".format(part["unit"])


def test_published_ratios_stand_only_beside_the_ratio_they_are_of():
    """The group that takes the sternal joints along is no group of the published subjects."""
    entry = RatioEstimate.of(0.1, (0.05, 0.2), (False, False), False)
    own, published = (_strip(name, entry, (0.005, 5.0), None) for name in ("lateral_bending", "intervertebral_bending"))
    assert own["band"] is None
    # 0.01 to 0.63 on a logarithmic axis of three decades.
    assert published["band"] == pytest.approx((10.03, 70.01), abs=0.01)
    assert own["value"] == published["value"]
