"""One page about a visit for people: what was found, how sure it is, and the pictures to judge it by.

``results/report.html`` is self-contained (it asks nothing of any other file or host); its pictures lie beside it as PNG
in ``results/figures``. The same results give the same bytes.
"""

from __future__ import annotations

import base64
import math
import os
import secrets
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from matplotlib.figure import Figure

from spinestiff import __version__
from spinestiff.anatomy.files import read_torso
from spinestiff.anatomy.stiffness import StiffnessRatios
from spinestiff.anatomy.torso import TorsoModel, TorsoState
from spinestiff.arrays import Floats
from spinestiff.errors import SubjectError
from spinestiff.estimation.objective import Target, make_target, residuals
from spinestiff.imaging.features import picture_axes, silhouette_choice, state_features, target_features, vertebra_rows
from spinestiff.imaging.projection import XRayView
from spinestiff.imaging.radiograph import Radiograph
from spinestiff.study.figures import (
    CurveChange,
    Overlay,
    Panel,
    RatioMap,
    TiltChange,
    as_png,
    as_svg,
    draw_curve_changes,
    draw_overlay,
    draw_ratio_map,
    draw_tilt_changes,
)
from spinestiff.study.metrics import cobb_angle, cobb_change, tilts
from spinestiff.study.results import read_json
from spinestiff.study.subject import PushRecord, image_corners, read_push, read_rest
from spinestiff.study.trials import PushSet, PushTrial
from spinestiff.study.visit import Observer, Visit, estimated_ratios, load_pushes, read_truth, truth_in_region

MISSING = "not available"
# Secant lateral-bending stiffness of cadaver thoracic segments at 7.5 N m (Wilke et al. 2017), N m/degree.
BENDING_BAND = (1.3, 1.8)
# Range of the ratio in the seven subjects of the method's first study. Its tissue ratios are left out: they belong to
# another default tissue.
PUBLISHED = {"lateral_bending": (0.01, 0.63)}
RATIO_TITLES = {
    "lateral_bending": "Lateral bending of the spine",
    "tissue": "Soft tissue of the trunk",
    "tissue_mu": "Soft tissue of the trunk, shear",
    "tissue_lambda": "Soft tissue of the trunk, bulk",
    "flexion_extension": "Flexion and extension of the spine",
    "axial_rotation": "Axial rotation of the spine",
    "lateral_shear": "Lateral shear of the spine",
    "sagittal_shear": "Sagittal shear of the spine",
    "separation": "Axial stiffness of the spine",
    "everything": "All stiffnesses together",
}
# Plain quantity -> the ratios that scale it as a whole, its name and unit.
PLAIN = {
    "lateral_bending_thoracic_nm_per_rad": (("lateral_bending", "everything"), "per thoracic level", "N m/rad"),
    "lateral_bending_lumbar_nm_per_rad": (("lateral_bending", "everything"), "per lumbar level", "N m/rad"),
    "tissue_young_kpa": (("tissue", "everything"), "Young’s modulus", "kPa"),
}
PREDICTORS = {
    "rest": "No motion: the rest pose",
    "default": "Model, default stiffness",
    "single_ratio": "Model, one ratio for all stiffnesses",
    "extrapolation": "No model: training motion scaled by force",
    "fit": "Model, estimated stiffness",
    "truth": "Model, true ratios (known for synthetic subjects only)",
}
ORACLE = "truth"
EQUAL_MM = 0.1  # mean errors that differ by less are called equal
MODELS = {"rest": "Rest pose, no motion", "default": "Default stiffness", "fit": "Estimated stiffness"}
STATUS_TITLES = {"CONVERGED": "converged", "AT_BOUND": "at a bound", "NOT_IDENTIFIABLE": "not identifiable"}


@dataclass(frozen=True)
class Prediction:
    """A frame with what the models make of it.

    Attributes
    ----------
    item : the frame.
    target : its measured features.
    states : "rest", "default", "fit" where an equilibrium was found.
    """

    item: PushTrial
    target: Target
    states: Mapping[str, TorsoState]

    def boxes(self, torso: TorsoModel, name: str) -> Floats:
        """(Nv, 4, 2) mm at the patient plane, simulated boxes of the measured vertebrae."""
        target = self.target
        seen = state_features(torso, target.trial.view, self.states[name], target.choice, used=target.used)
        return seen.z[target.rows]


@dataclass(frozen=True)
class Picture:
    """A figure as it stands in the report and beside it as a file.

    Attributes
    ----------
    file : name of the PNG.
    source : data URI.
    alt, caption : in words.
    """

    file: str
    source: str
    alt: str
    caption: str


def write_report(visit: Visit, say: Observer) -> None:
    """Write ``results/report.html`` and ``results/figures/*.png`` of a visit that has been assessed.

    Raises
    ------
    SubjectError : a result of an earlier step is missing or belongs to another version of it.
    """
    try:
        pictures, page = _compose(visit, say)
    except (KeyError, TypeError, IndexError) as error:
        raise SubjectError(
            f"{visit.subject.results}: results lack what the report needs ({error}); run spinestiff run --force"
        ) from None
    folder = visit.file("figures")
    folder.mkdir(parents=True, exist_ok=True)
    for old in folder.glob("[0-9][0-9]-*.png"):
        if old.name not in pictures:
            old.unlink()
    for name, content in pictures.items():
        _write_whole(folder / name, content)
    _write_whole(visit.file("report.html"), page.encode())
    say(f"{visit.file('report.html')} and {len(pictures)} figures")


def _compose(visit: Visit, say: Observer) -> tuple[dict[str, bytes], str]:
    names = ("estimate", "assessment", "personalised", "tracked")
    estimate, assessment, personalised, tracked = (read_json(visit.file(f"{name}.json")) for name in names)
    # What is quick comes first: results of another version are refused before anything is solved.
    page = {
        "subject": _subject_context(visit),
        "result": _result_context(visit, estimate),
        "comparison": _comparison(assessment),
        "prediction": _prediction_context(assessment),
        "reactions": _reaction_rows(estimate["reactions_n"]),
        "reaction_push": estimate["reactions_n"]["push"],
        "supports": _support_rows(tracked),
        "geometry": _geometry_context(personalised, estimate),
        "millimetres": _millimetre_rows(personalised, tracked),
        "cost": estimate["cost"],
        "training": {key: fixed(value, 2) for key, value in estimate["training_rmse_mm"].items()},
        "version": __version__,
    }
    torso = read_torso(visit.file("torso.npz"))
    pushes = load_pushes(visit, torso)
    predictions = _predict(pushes, estimated_ratios(visit, torso), say)
    say("drawing")
    album = _Album()
    page |= {
        "held_out": [album.add(*_frame_picture(visit, torso, p)) for p in _of_role(predictions, "validation")],
        "rest": [album.add(*_rest_picture(visit, torso, view, personalised)) for view in ("frontal", "lateral")],
        "curves": album.add(*_curve_picture(pushes, predictions)),
        "certainty": _certainty_context(visit, estimate, album),
        "levels": album.add(*_tilt_picture(visit, pushes, predictions)),
    }
    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parent),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return album.files, environment.get_template("report.html.j2").render(page)


class _Album:
    """Collects pictures in the order in which they are drawn."""

    def __init__(self) -> None:
        self.files: dict[str, bytes] = {}

    def add(self, name: str, figure: Figure, alt: str, caption: str) -> Picture:
        file = f"{len(self.files) + 1:02d}-{name}.png"
        content = self.files[file] = as_png(figure)
        kind = "image/png"
        # Lines stay sharp at any zoom; radiographs would only grow.
        if not any(axis.images for axis in figure.axes):
            kind, content = "image/svg+xml", as_svg(figure)
        return Picture(file, f"data:{kind};base64,{base64.b64encode(content).decode()}", alt, caption)


# Numbers and words


def number(value: float | None, digits: int = 3) -> str:
    """A number with so many significant digits, without an exponent; "not available" for none."""
    if value is None or not math.isfinite(value):
        return MISSING
    if value == 0.0:
        return "0"
    decimals = max(digits - 1 - math.floor(math.log10(abs(value))), 0)
    return f"{value:.{decimals}f}".replace("-", "−")


def fixed(value: float | None, decimals: int = 1, sign: bool = False) -> str:
    """A number with so many decimals; "not available" for none."""
    if value is None or not math.isfinite(value):
        return MISSING
    # Plus zero: no sign before a rounded zero.
    rounded = round(value, decimals) + 0.0
    return f"{rounded:{'+' if sign and rounded else ''}.{decimals}f}".replace("-", "−")


def interval(ends: Sequence[float | None], bounds: Sequence[float], scale: float = 1.0) -> str:
    """A 95 % interval; an end that is open or lies at the fit's bound says so."""
    low, high = ends
    below, above = low is None or low <= bounds[0] * 1.001, high is None or high >= bounds[1] * 0.999
    first = f"≤ {number(scale * bounds[0], 1)}" if below or low is None else number(scale * low)
    last = f"≥ {number(scale * bounds[1], 1)}" if above or high is None else number(scale * high)
    return f"{first} to {last}"


def _listed(parts: Iterable[str]) -> str:
    parts = list(parts)
    return ", ".join(parts[:-1]) + " and " + parts[-1] if len(parts) > 1 else "".join(parts)


def _title(name: str) -> str:
    return RATIO_TITLES.get(name, name.replace("_", " "))


# Predictions and pictures


def _predict(pushes: PushSet, ratios: StiffnessRatios, say: Observer) -> tuple[Prediction, ...]:
    """Every frame under force, each push from its least force up, with default and estimated stiffness."""
    loaded = [t for t in pushes.trials if t.force_n > 0.0]
    done = []
    last: dict[tuple[str, str], TorsoState] = {}
    for item in sorted(loaded, key=lambda t: (t.push, t.force_n)):
        say(f"push '{item.push}' frame {item.frame}: {item.force_n:.0f} N")
        states = {"rest": pushes.torso.rest_pose}
        for name, model in (("default", None), ("fit", ratios)):
            found = pushes.problems[item.push].solve(item.trial.load, model, last.get((name, item.push)))
            if found.converged:
                states[name] = last[(name, item.push)] = found.state
        done.append(Prediction(item, make_target(pushes.torso, item.trial), states))
    order = {(t.push, t.frame): i for i, t in enumerate(pushes.trials)}
    return tuple(sorted(done, key=lambda p: order[(p.item.push, p.item.frame)]))


def _of_role(predictions: Sequence[Prediction], *roles: str) -> list[Prediction]:
    return [p for p in predictions if p.item.role in roles]


def _frame_picture(visit: Visit, torso: TorsoModel, prediction: Prediction) -> tuple[str, Figure, str, str]:
    item, target = prediction.item, prediction.target
    view = item.trial.view
    push = visit.subject.push(item.push)
    errors = {name: residuals(torso, target, state).rmse for name, state in prediction.states.items()}
    panels = tuple(
        Panel(title, _pixels(view, prediction.boxes(torso, name)), errors[name])
        for name, title in MODELS.items()
        if name in errors
    )
    frame = next(f for f in read_push(visit.subject, push) if f.frame == item.frame)
    names = item.trial.corners.vertebrae
    overlay = _overlay(frame, view, names, target.z, panels, _arrow(torso, view, push, item))
    found = _listed(f"{MODELS[name].lower()} {error:.1f} mm" for name, error in errors.items())
    where = f"push “{item.push}”, frame {item.frame}, {item.force_n:.0f} N from the patient’s {push.side}"
    alt = f"Radiograph of {where}, with measured and simulated vertebra boxes. RMSE: {found}."
    caption = f"Held-out frame, not used by the estimate: {where}. Vertebrae as measured (blue) and simulated (orange)."
    return f"{item.push}-frame-{item.frame}", draw_overlay(overlay), alt, caption


def _rest_picture(
    visit: Visit, torso: TorsoModel, name: str, personalised: Mapping[str, Any]
) -> tuple[str, Figure, str, str]:
    picture = read_rest(visit.subject, name)  # type: ignore[arg-type]
    corners = image_corners(visit.subject, f"rest/{name}", picture.view)
    entry = personalised["views"][name]
    view = XRayView(**{**entry, "shape": tuple(entry["shape"])})
    choice = silhouette_choice(torso, view, torso.rest_pose)
    seen = state_features(torso, view, torso.rest_pose, choice).z[vertebra_rows(torso, corners)]
    error = float(personalised["rmse_mm"][name])
    panel = Panel(f"Rest, {name}", _pixels(view, seen), error)
    overlay = _overlay(picture, view, corners.vertebrae, target_features(torso, view, corners), (panel,), None)
    alt = f"{name.capitalize()} radiograph at rest with measured and modelled vertebra boxes, RMSE {error:.1f} mm."
    return f"rest-{name}", draw_overlay(overlay), alt, f"{name.capitalize()} view at rest: the fitted geometry."


def _overlay(
    frame: Radiograph,
    view: XRayView,
    names: tuple[str, ...],
    measured: Floats,
    panels: tuple[Panel, ...],
    arrow: tuple[float, float, str] | None,
) -> Overlay:
    first, _ = picture_axes(view)
    letters = ("L", "R") if _is_frontal(view) else ("A", "P")
    sides = letters if first[0] < 0.0 else letters[::-1]
    column, row = (float(v) for v in view.pixel_spacing / view.magnification)
    return Overlay(frame.pixels, names, _pixels(view, measured), panels, (column, row), sides, arrow)


def _is_frontal(view: XRayView) -> bool:
    return bool(abs(view.normal[2]) > abs(view.normal[0]))


def _pixels(view: XRayView, plane_mm: Floats) -> Floats:
    return np.asarray(view.pixels(view.from_patient_plane(plane_mm)))


def _arrow(torso: TorsoModel, view: XRayView, push: PushRecord, item: PushTrial) -> tuple[float, float, str]:
    """Pushed height (row), direction along the columns and force."""
    load = item.trial.load
    share = np.linalg.norm(load.forces, axis=1) / load.size
    place = share @ load.points.positions(torso.rest_pose)
    there, onward = view.pixels(view.project(np.stack([place, place + [10.0 * push.sign, 0.0, 0.0]])))
    return float(there[1]), float(np.sign(onward[0] - there[0])), f"{item.force_n:.0f} N"


def _curve_picture(pushes: PushSet, predictions: Sequence[Prediction]) -> tuple[str, Figure, str, str]:
    changes = []
    for push in pushes.problems:
        measured: dict[str, list[tuple[float, float]]] = {"training": [], "validation": [], "unused": []}
        for item in (t for t in pushes.trials if t.push == push):
            measured[item.role].append((item.force_n, _measured_change(pushes, item)))
        simulated: dict[str, list[tuple[float, float]]] = {"default": [(0.0, 0.0)], "fit": [(0.0, 0.0)]}
        for p in (p for p in predictions if p.item.push == push):
            for name in simulated:
                if name in p.states:
                    simulated[name].append((p.item.force_n, _simulated_change(pushes, p, name)))
        changes.append(CurveChange(push, _sorted_points(measured), _sorted_points(simulated)))
    words = [
        f"push {c.push}: measured {rows[-1, 1]:+.1f} degrees at {rows[-1, 0]:.0f} N"
        for c in changes
        for rows in [np.vstack(list(c.measured.values()))]
        for rows in [rows[np.argsort(rows[:, 0])]]
    ]
    alt = "Change of the Cobb angle against force, measured and simulated; " + _listed(words) + "."
    caption = (
        "Change of the Cobb angle (tilt form) against force. Left-convex counts as positive. "
        "Frames that the estimate did not use test it."
    )
    return "force-and-curve", draw_curve_changes(changes), alt, caption


def _sorted_points(groups: Mapping[str, list[tuple[float, float]]]) -> dict[str, Floats]:
    return {name: np.array(sorted(points)) for name, points in groups.items() if points}


def _measured_change(pushes: PushSet, item: PushTrial) -> float:
    reference = pushes.reference(item.push)
    common = _common(reference, item)
    before, after = (tilts(common, t.trial.corners.selected(common).corners, t.trial.view) for t in (reference, item))
    return cobb_change(before, after).tilt


def _simulated_change(pushes: PushSet, prediction: Prediction, name: str) -> float:
    torso, item, target = pushes.torso, prediction.item, prediction.target
    common = _common(pushes.reference(item.push), item)
    rows = vertebra_rows(torso, item.trial.corners.selected(common))
    view = item.trial.view
    spines = [
        tilts(common, state_features(torso, view, state, target.choice).z[rows], view)
        for state in (torso.rest_pose, prediction.states[name])
    ]
    return cobb_change(*spines).tilt


def _common(reference: PushTrial, item: PushTrial) -> tuple[str, ...]:
    return tuple(v for v in item.trial.corners.vertebrae if v in reference.trial.corners.vertebrae)


def _tilt_picture(visit: Visit, pushes: PushSet, predictions: Sequence[Prediction]) -> tuple[str, Figure, str, str]:
    changes = []
    for p in _of_role(predictions, "training", "validation"):
        torso, item = pushes.torso, p.item
        reference = pushes.reference(item.push)
        common = _common(reference, item)
        view = item.trial.view

        def tilt(z: Floats, names: tuple[str, ...] = common, view: XRayView = view) -> Floats:
            return np.degrees(tilts(names, z, view, "midline").superior)

        before, after = (target_features(torso, view, t.trial.corners.selected(common)) for t in (reference, item))
        rows = vertebra_rows(torso, item.trial.corners.selected(common))
        seen = {name: state_features(torso, view, s, p.target.choice).z[rows] for name, s in p.states.items()}
        start = tilt(seen["rest"])
        role = "held out" if item.role == "validation" else "training"
        title = f"“{item.push}”, {item.force_n:.0f} N ({role})"
        simulated: dict[str, Floats] = {name: tilt(seen[name]) - start for name in ("default", "fit") if name in seen}
        level = _row_of_level(visit.subject.push(item.push).level, common)
        changes.append(TiltChange(title, common, tilt(after) - tilt(before), simulated, level))
    worst = max(changes, key=lambda c: float(np.abs(c.measured).max()))
    most = int(np.argmax(np.abs(worst.measured)))
    alt = (
        f"Change of tilt of each vertebra, measured and simulated, in {len(changes)} frames; the largest measured is "
        f"{worst.measured[most]:+.1f} degrees at {worst.vertebrae[most]} ({worst.title})."
    )
    caption = (
        "Change of each vertebra’s tilt in the frontal plane; above zero the patient’s left side rises. "
        "The grey band marks the vertebra of the pushed rib."
    )
    return "tilt-by-level", draw_tilt_changes(changes), alt, caption


def _row_of_level(level: float, names: tuple[str, ...]) -> float | None:
    lower, upper = f"T{math.floor(level)}", f"T{min(math.ceil(level), 12)}"
    if lower not in names or upper not in names:
        return None
    share = level - math.floor(level)
    return (1.0 - share) * names.index(lower) + share * names.index(upper)


# What the page says


def _subject_context(visit: Visit) -> dict[str, Any]:
    record = visit.subject.record
    rest = read_rest(visit.subject, "frontal")
    corners = image_corners(visit.subject, "rest/frontal", rest.view)
    angle = cobb_angle(tilts(corners.vertebrae, corners.corners, rest.view))
    curve = f"{fixed(abs(angle.degrees))}° between {angle.upper} and {angle.lower}, {angle.convexity}-convex"
    largest = max(max(push.forces_n) for push in visit.subject.pushes)
    return {
        "id": record.id,
        "synthetic": visit.truth is not None,
        "facts": {
            "Age": f"{record.age:g} years",
            "Sex": record.sex,
            "Height": f"{record.height_cm:g} cm",
            "Cobb angle at rest": curve,
            "Largest push": f"{largest:.0f} N",
        },
    }


def _result_context(visit: Visit, estimate: Mapping[str, Any]) -> dict[str, Any]:
    bounds, plain = estimate["bounds"], estimate["plain"]
    truth = read_truth(visit.truth) if visit.truth else {}
    ratios = []
    for name in _parameters(estimate):
        entry = estimate["ratios"][name]
        ratios.append(
            {
                "title": _title(name),
                "value": number(entry["value"]),
                "percent": number(100.0 * entry["value"], 2),
                "interval": interval(entry["interval95"], bounds),
                "at_bound": entry["at_bound"],
                "truth": number(truth[name]) if name in truth else "",
                "plain": [
                    {
                        "title": title,
                        "value": f"{number(plain[key])} {unit}",
                        "interval": interval(entry["interval95"], bounds, plain[key] / entry["value"]) + f" {unit}",
                    }
                    for key, (names, title, unit) in PLAIN.items()
                    if name in names
                ],
                "strip": _strip(name, entry, bounds, truth.get(name)),
                "published": PUBLISHED.get(name),
            }
        )
    return {
        "status": STATUS_TITLES.get(estimate["status"], estimate["status"].lower().replace("_", " ")),
        "good": estimate["status"] == "CONVERGED",
        "identified": estimate["status"] != "NOT_IDENTIFIABLE",
        "status_text": estimate["status_text"],
        "ratios": ratios,
        "bending": _bending_line(estimate),
        "warnings": list(dict.fromkeys(estimate["warnings"])),
    }


def _parameters(estimate: Mapping[str, Any]) -> list[str]:
    # The order of the fit; a file's keys are sorted.
    return list(estimate.get("parameters") or estimate["ratios"])


def _strip(name: str, entry: Mapping[str, Any], bounds: Sequence[float], truth: float | None) -> dict[str, Any]:
    """Places on a logarithmic axis over the fit's bounds, in percent of its width."""
    low, high = np.log(bounds[0]), np.log(bounds[1])

    def place(value: float) -> float:
        return round(float(np.clip((np.log(value) - low) / (high - low), 0.0, 1.0)) * 100.0, 2)

    start, end = entry["interval95"]
    band = PUBLISHED.get(name)
    ticks = [v for v in (0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0) if bounds[0] <= v <= bounds[1]]
    return {
        "value": place(entry["value"]),
        "start": place(bounds[0] if start is None else start),
        "end": place(bounds[1] if end is None else end),
        "ticks": [(place(v), f"{v:g}") for v in ticks],
        "one": place(1.0),
        "band": None if band is None else (place(band[0]), place(band[1])),
        "truth": None if truth is None else place(truth),
    }


def _bending_line(estimate: Mapping[str, Any]) -> dict[str, Any] | None:
    """The bending stiffness of a level beside cadaver segments."""
    value = estimate["plain"].get("lateral_bending_thoracic_nm_per_rad")
    if value is None or not {"lateral_bending", "everything"} & set(estimate["ratios"]):
        return None
    low, high = (float(np.degrees(edge)) for edge in BENDING_BAND)
    name = "lateral_bending" if "lateral_bending" in estimate["ratios"] else "everything"
    entry = estimate["ratios"][name]
    first, last = (
        bound if end is None else end for end, bound in zip(entry["interval95"], estimate["bounds"])
    )
    overlap = first * value / entry["value"] <= high and last * value / entry["value"] >= low
    if value < low:
        verdict = f"about {number(0.5 * (low + high) / value, 2)} times softer than"
    elif value > high:
        verdict = f"about {number(value / (0.5 * (low + high)), 2)} times stiffer than"
    else:
        verdict = "within the range of"
    return {
        "value": number(value),
        "per_degree": number(value * np.pi / 180.0, 2),
        "band": f"{BENDING_BAND[0]:g} to {BENDING_BAND[1]:g}",
        "band_rad": f"{low:.0f} to {high:.0f}",
        "verdict": verdict,
        "overlap": overlap and not low <= value <= high,
    }


def _certainty_context(visit: Visit, estimate: Mapping[str, Any], album: _Album) -> dict[str, Any]:
    names = _parameters(estimate)
    contains = truth_in_region(visit) if visit.truth else None
    context: dict[str, Any] = {
        "correlation": fixed(estimate["correlation"], 2),
        "condition": number(estimate["condition"], 2),
        "picture": None,
        "steps": sum(bool(step["accepted"]) for step in estimate["history"]),
        "evaluations": len(estimate["history"]),
        "truth": "" if contains is None else "holds" if contains else "does not hold",
    }
    if len(names) != 2:
        return context
    values = [estimate["ratios"][name]["value"] for name in names]
    path = [[step["ratios"][name] for name in names] for step in estimate["history"] if step["accepted"]]
    truth = read_truth(visit.truth) if visit.truth else {}
    region = np.array(estimate["joint_region"] or np.empty((0, 2)))
    known = np.array([truth[name] for name in names]) if all(name in truth for name in names) else None
    low, high = estimate["bounds"]
    shown = (names[0].replace("_", " "), names[1].replace("_", " "))
    figure = draw_ratio_map(
        RatioMap(shown, np.array(values), region, np.array(path).reshape(-1, 2), (low, high), known)
    )
    alt = (
        f"Joint 95 % region of the two ratios around the estimate {number(values[0])} and {number(values[1])}, "
        f"and the fit’s {len(path)} accepted steps from the start."
    )
    caption = "Both ratios on logarithmic axes: the fit’s accepted steps (left) and the joint 95 % region (right)."
    context["picture"] = album.add("joint-region", figure, alt, caption)
    return context


def _comparison(assessment: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Mean errors over the held-out frames, and what the estimate is worth beside the best simpler predictor."""
    means = {}
    for name in PREDICTORS:
        values = [frame["rmse_mm"].get(name) for frame in assessment]
        if values and all(value is not None for value in values):
            means[name] = float(np.mean([value for value in values if value is not None]))
    rivals = {name: value for name, value in means.items() if name not in ("fit", ORACLE)}
    best = min(rivals, key=lambda name: rivals[name]) if rivals else ""
    verdict = ""
    if best and "fit" in means:
        difference = means["fit"] - rivals[best]
        verdict = "equal" if abs(difference) < EQUAL_MM else "worse" if difference > 0.0 else "better"
    return {
        "frames": len(assessment),
        "fit": fixed(means["fit"], 2) if "fit" in means else "",
        "default": fixed(means["default"], 2) if "default" in means else "",
        "verdict": verdict,
        "rival": PREDICTORS.get(best, ""),
        "rival_error": fixed(rivals[best], 2) if best else "",
    }


def _prediction_context(assessment: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    shown = [name for name in PREDICTORS if any(frame["rmse_mm"].get(name) is not None for frame in assessment)]
    rows = [
        {
            "title": PREDICTORS[name],
            "fit": name == "fit",
            "cells": [
                {"text": fixed(frame["rmse_mm"].get(name), 2), "best": name in _best(frame["rmse_mm"])}
                for frame in assessment
            ],
        }
        for name in shown
    ]
    return {
        "frames": [f"“{f['push']}”, frame {f['frame']}, {f['force_n']:.0f} N" for f in assessment],
        "rows": rows,
        "cobb": [_cobb_rows(frame) for frame in assessment],
    }


def _best(errors: Mapping[str, float | None]) -> list[str]:
    """The predictors with the least error as printed; the oracle doesn't compete."""
    known = {name: round(value, 2) for name, value in errors.items() if value is not None and name != ORACLE}
    return [name for name, value in known.items() if value == min(known.values())]


def _cobb_rows(frame: Mapping[str, Any]) -> dict[str, Any]:
    rows = []
    for name, title in {"measured": "Measured", **MODELS, "truth": "True ratios"}.items():
        if name not in frame["cobb_change_deg"]:
            continue
        change = frame["cobb_change_deg"][name]
        if change is None:
            rows.append({"title": title, "cells": [MISSING] * 3})
            continue
        cells = [
            f"{fixed(change['signed'], 1, True)}°",
            f"{fixed(change['fixed_levels'], 1, True)}° ({'–'.join(change['levels'])})",
            f"{fixed(change['tilt'], 1, True)}° ({'–'.join(change['tilt_levels'])})",
        ]
        rows.append({"title": title, "cells": cells})
    return {"title": f"“{frame['push']}”, frame {frame['frame']}, {frame['force_n']:.0f} N", "rows": rows}


def _reaction_rows(found: Mapping[str, Any]) -> list[dict[str, str]]:
    return [
        {"title": "Push on the ribs (F3)", "model": fixed(found["f3"]), "balance": fixed(found["f3"])},
        {"title": "Shoulder (F1)", "model": fixed(found["shoulder"]), "balance": fixed(found["eq2_shoulder"])},
        {"title": "Pelvis (F2)", "model": fixed(found["pelvis"]), "balance": fixed(found["eq1_pelvis"])},
    ]


def _support_rows(tracked: Mapping[str, Any]) -> list[dict[str, str]]:
    """Largest motion of each support, and what was dropped, by push."""
    rows = []
    for name, push in tracked["pushes"].items():
        frames = push["frames"]
        largest = {}
        for support in ("pelvis", "shoulder"):
            seen = [f["support_motion_mm"][support] for f in frames if support in f["support_motion_mm"]]
            largest[support] = f"{fixed(max(seen))} mm" if seen else "not marked"
        dropped = [f"frame {i}" for i, frame in enumerate(frames) if frame["dropped"]]
        rows.append({"push": name, **largest, "dropped": _listed(dropped) or "none", "frames": str(len(frames))})
    return rows


def _geometry_context(personalised: Mapping[str, Any], estimate: Mapping[str, Any]) -> dict[str, Any]:
    rows = []
    for view, error in personalised["rmse_mm"].items():
        pose, each = personalised["poses"][view], personalised["vertebra_rmse_mm"][view]
        worst = max(each, key=lambda name: each[name]) if each else ""
        largest = f"{worst}, {fixed(each[worst])} mm" if worst else MISSING
        rows.append({"title": f"Rest, {view}", "rmse": fixed(error, 2), "worst": largest, **_pose(pose)})
    for push, pose in estimate["poses"].items():
        title = f"Push “{push}”, least force"
        rows.append({"title": title, "rmse": fixed(pose["rms_mm"], 2), "worst": "", **_pose(pose)})
    return {"rows": rows, "prior_only": _listed(personalised["prior_only"])}


def _pose(pose: Mapping[str, Any]) -> dict[str, str]:
    across, along = pose["shift_mm"]
    return {
        "shift": f"{fixed(across, 1, True)} / {fixed(along, 1, True)}",
        "roll": f"{fixed(pose['roll_deg'], 2, True)}°",
    }


def _millimetre_rows(personalised: Mapping[str, Any], tracked: Mapping[str, Any]) -> dict[str, Any]:
    """Where scale and directions came from; images that say the same share a column."""
    images = {f"rest, {view}": found for view, found in personalised["millimetres"].items()}
    images |= {f"push “{push}”": entry["millimetres"] for push, entry in tracked["pushes"].items()}
    groups: dict[tuple[tuple[str, str], ...], list[str]] = {}
    for image, found in images.items():
        groups.setdefault(tuple(sorted(found.items())), []).append(image)
    keys = sorted({key for found in groups for key, _ in found})
    return {
        "images": [_listed(names) for names in groups.values()],
        "rows": [(key, [dict(found).get(key, MISSING) for found in groups]) for key in keys],
    }


def _write_whole(path: Path, content: bytes) -> None:
    """Whole or not at all, so that an interrupted run leaves the old file."""
    temporary = path.with_name(f".{path.name}.{secrets.token_hex(4)}.tmp")
    try:
        temporary.write_bytes(content)
        os.replace(temporary, path)
    except OSError as error:
        raise SubjectError(f"{path}: can't be written ({error.strerror})") from None
    finally:
        temporary.unlink(missing_ok=True)
