"""The pictures of a visit as its report has them, each with what it shows in words."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure

from spinestiff.anatomy.regions import is_beside_whole
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.arrays import Floats
from spinestiff.curves.tilts import tilts
from spinestiff.estimation.unknowns import PLACING
from spinestiff.imaging.features import (
    state_features,
    target_features,
    used_corners,
    vertebra_rows,
)
from spinestiff.imaging.projection import XRayView
from spinestiff.imaging.radiograph import Radiograph
from spinestiff.normal import HALF_WIDTH_95
from spinestiff.study.predictions import Prediction, Predictions
from spinestiff.study.report.beside import pedicles_in
from spinestiff.study.report.certainty_pictures import (
    BudgetBars,
    ProfileCurve,
    RatioMap,
    draw_budget,
    draw_profiles,
    draw_ratio_map,
    draw_support_places,
)
from spinestiff.study.report.curve_pictures import CurveChange, TiltChange, draw_curve_changes, draw_tilt_changes
from spinestiff.study.report.estimate_content import budget_bars, support_places
from spinestiff.study.report.frame_content import MODELS
from spinestiff.study.report.overlay import NO_POINTS, Overlay, Panel, draw_overlay
from spinestiff.study.report.placing import pixel_mm, pixels_of, push_arrow, sides_of
from spinestiff.study.report.plan_picture import draw_plan
from spinestiff.study.report.tornado_picture import draw_tornado
from spinestiff.study.truth import read_truth, true_values
from spinestiff.study.visit import Visit
from spinestiff.study.wording.numbers import listed, number
from spinestiff.study.wording.plan import TITLES, push_words, size_of, width
from spinestiff.study.wording.sensitivity import largest, tornado_rows
from spinestiff.study.wording.titles import ratio_title, within_a_sentence
from spinestiff.subject.annotated_points import image_corners
from spinestiff.subject.estimate_outcome import Estimate
from spinestiff.subject.folder import read_rest
from spinestiff.subject.geometry_outcome import GeometryRecord
from spinestiff.subject.image_names import rest_image
from spinestiff.subject.plan_outcome import Plan
from spinestiff.subject.sensitivity_outcome import Sensitivity
from spinestiff.words import counted

Drawn = tuple[str, Figure, str, str]
"""Name, figure, what it shows for who can't see it, and caption."""


def frame_picture(visit: Visit, predictions: Predictions, prediction: Prediction, film: Sequence[Radiograph]) -> Drawn:
    """A held-out frame: vertebrae, and pedicles that are marked, as measured and as the models have them."""
    item, target, torso = prediction.item, prediction.target, predictions.pushes.torso
    view = item.trial.view
    push = visit.subject.push(item.push)
    errors = {name: prediction.rmse(torso, name) for name in MODELS if name in prediction.solved}
    pedicles = pedicles_in(predictions, prediction, item.push)
    panels = tuple(
        Panel(
            title,
            pixels_of(view, prediction.boxes(torso, name)),
            errors[name],
            pixels_of(view, pedicles.of(name)),
        )
        for name, title in MODELS.items()
        if name in errors
    )
    frame = next(f for f in film if f.frame == item.frame)
    names = item.trial.corners.vertebrae
    arrow = push_arrow(torso, view, push, item)
    overlay = _overlay(frame, view, names, target.z, panels, arrow, pedicles.measured)
    found = listed(f"{MODELS[name].lower()} {error:.1f} mm" for name, error in errors.items())
    where = f"push “{item.push}”, frame {item.frame}, {item.force_n:.0f} N from the patient’s {push.side}"
    alt = f"Radiograph of {where}, with measured and simulated vertebra boxes. RMSE: {found}.{pedicles.words()}"
    caption = f"Held-out frame, not used by the estimate: {where}. Vertebrae as measured (blue) and simulated (orange)."
    return f"{item.push}-frame-{item.frame}", draw_overlay(overlay), alt, caption


def rest_picture(visit: Visit, torso: TorsoModel, name: str, geometry: GeometryRecord) -> Drawn:
    """A rest radiograph with the fitted geometry."""
    picture = read_rest(visit.subject, name)  # type: ignore[arg-type]
    corners = image_corners(visit.subject, rest_image(name), picture.view)
    view = geometry.views[name].view()
    seen = state_features(torso, view, torso.rest_pose).z[vertebra_rows(torso, corners)]
    error = geometry.rmse_mm[name]
    panel = Panel(f"Rest, {name}", pixels_of(view, seen), error)
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
    pedicles: Floats = NO_POINTS,
) -> Overlay:
    seen, marked = pixels_of(view, measured), pixels_of(view, pedicles)
    return Overlay(frame.pixels, names, seen, panels, pixel_mm(view), sides_of(view), arrow, marked)


def curve_changes(predictions: Predictions) -> list[CurveChange]:
    """Change of the Cobb angle against force, of every push: measured by role, and as the models make it."""
    pushes, changes = predictions.pushes, []
    for push in pushes.problems:
        measured: dict[str, list[tuple[float, ...]]] = {"training": [], "validation": [], "unused": []}
        for item in (t for t in pushes.trials if t.push == push):
            change = predictions.measured_change(item)
            if change is not None and change.sds.tilt is not None:
                measured[item.role].append((item.force_n, change.tilt, HALF_WIDTH_95 * change.sds.tilt))
        start = pushes.reference(push).force_n
        simulated: dict[str, list[tuple[float, ...]]] = {"default": [(start, 0.0)], "fit": [(start, 0.0)]}
        for p in (p for p in predictions.frames if p.item.push == push and p.item.force_n > start):
            for name, points in simulated.items():
                change = predictions.simulated_change(p, name)
                if change is not None:
                    points.append((p.item.force_n, change.tilt))
        changes.append(CurveChange(push, _sorted_points(measured), _sorted_points(simulated)))
    return changes


def curve_picture(predictions: Predictions) -> Drawn | None:
    """Change of the Cobb angle against force, of the pushes that show one; None where none does."""
    changes = [change for change in curve_changes(predictions) if change.measured]
    if not changes:
        return None
    words = [
        f"push {c.push}: measured {rows[-1, 1]:+.1f} ± {rows[-1, 2]:.1f} degrees at {rows[-1, 0]:.0f} N"
        for c in changes
        for rows in [np.vstack(list(c.measured.values()))]
        for rows in [rows[np.argsort(rows[:, 0])]]
    ]
    alt = "Change of the Cobb angle against force, measured and simulated; " + listed(words) + "."
    caption = (
        "Change of the Cobb angle (tilt form, by endplates) against force, bars: 95 %. Left-convex counts as positive. "
        "Frames that the estimate did not use test it."
    )
    return "force-and-curve", draw_curve_changes(changes), alt, caption


def _sorted_points(groups: Mapping[str, list[tuple[float, ...]]]) -> dict[str, Floats]:
    return {name: np.array(sorted(points)) for name, points in groups.items() if points}


def tilt_picture(visit: Visit, predictions: Predictions) -> Drawn | None:
    """Change of tilt by level in frames that show two vertebrae of their push's least force; None without any."""
    changes, pushes = [], predictions.pushes
    torso, orientation = pushes.torso, pushes.orientation
    for p in predictions.of_role("training", "validation"):
        item, view = p.item, p.item.trial.view
        reference = pushes.reference(item.push).trial.corners
        common = tuple(v for v in item.trial.corners.vertebrae if v in reference.vertebrae)
        if len(common) < 2:
            continue

        def tilt(z: Floats, names: tuple[str, ...] = common, view: XRayView = view) -> Floats:
            return np.degrees(tilts(names, z, view, "midline").superior)

        both = tuple(corners.selected(common) for corners in (reference, item.trial.corners))
        before, after = (target_features(torso, view, corners, orientation) for corners in both)
        used, rows = [used_corners(torso, corners) for corners in both], vertebra_rows(torso, both[0])
        simulated: dict[str, Floats] = {}
        for name in ("default", "fit"):
            start, state = predictions.before(item, name), p.states.get(name)
            if start is not None and state is not None:
                placed = [
                    state_features(torso, view, s, p.target.shares, orientation, places).z[rows]
                    for s, places in zip((start, state), used)
                ]
                simulated[name] = tilt(placed[1]) - tilt(placed[0])
        role = "held out" if item.role == "validation" else "training"
        title = f"“{item.push}”, {item.force_n:.0f} N ({role})"
        level = _row_of_level(visit.subject.push(item.push).level, common)
        changes.append(TiltChange(title, common, tilt(after) - tilt(before), simulated, level))
    if not changes:
        return None
    worst = max(changes, key=lambda c: float(np.abs(c.measured).max()))
    most = int(np.argmax(np.abs(worst.measured)))
    alt = (
        "Change of tilt of each vertebra, measured and simulated, in "
        f"{counted(len(changes), 'frame')}; the largest measured is "
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


def region_picture(visit: Visit, estimate: Estimate) -> Drawn | None:
    """The joint region of two ratios, or where there is none the way to them; None of one, or of more."""
    names = estimate.parameters
    if len(names) != 2:
        return None
    values = list(estimate.values.values())
    path = [[step.ratios[name] for name in names] for step in estimate.history if step.accepted]
    truth = true_values(names, read_truth(visit.truth)) if visit.truth else {}
    region = np.array(estimate.region or np.empty((0, 2)))
    known = np.array([truth[name] for name in names]) if all(name in truth for name in names) else None
    shown = (names[0].replace("_", " "), names[1].replace("_", " "))
    ends = tuple((estimate.ratios[name].low, estimate.ratios[name].high) for name in names)
    figure = draw_ratio_map(
        RatioMap(shown, np.array(values), region, np.array(path).reshape(-1, 2), estimate.bounds, ends, known)
    )
    estimate_words = f"estimate {number(values[0], 2)} and {number(values[1], 2)}"
    steps = f"the fit’s {len(path)} accepted steps from the start"
    if not len(region):
        caption = (
            "Both ratios on logarithmic axes: the fit’s accepted steps (left) and the estimate from near (right). "
            "There is no joint region of it."
        )
        return "joint-region", figure, f"The {estimate_words} of the two ratios, and {steps}.", caption
    alt = (
        f"Joint 95 % region of the two ratios around the {estimate_words}, with the 95 % interval of each, and {steps}."
    )
    caption = (
        "Both ratios on logarithmic axes: the fit’s accepted steps (left) and the joint 95 % region (right). The bars "
        "are the 95 % intervals of each ratio alone; the region holds both at once and is wider. It ends where the "
        "axes end: these are the bounds of the fit."
    )
    return "joint-region", figure, alt, caption


def profile_picture(visit: Visit, estimate: Estimate) -> Drawn:
    """How much less likely other values of each ratio are."""
    truth = true_values(estimate.parameters, read_truth(visit.truth)) if visit.truth else {}
    curves = []
    for name in estimate.parameters:
        ratio, found = estimate.ratios[name], estimate.profiles[name]
        curve = np.column_stack([found.ratio, found.rise])
        ends = (ratio.low, ratio.high)
        limit = estimate.interval_rise or 0.0
        to = "that of the whole" if is_beside_whole(name, estimate.parameters) else "the default"
        curves.append(ProfileCurve(ratio_title(name), curve, limit, ends, ratio.value, truth.get(name), to))
    alt = "Profile of the likelihood along " + listed(within_a_sentence(curve.title) for curve in curves) + "."
    caption = (
        "How much less likely other values of a ratio are, with the other ratios at their likeliest there. The 95 % "
        "interval holds what lies below the dashed line. A flat stretch is a range that the radiographs don’t tell "
        "apart."
    )
    return "profiles", draw_profiles(curves), alt, caption


def support_picture(estimate: Estimate, predictions: Predictions) -> Drawn | None:
    """Where pelvis and shoulder were in each frame; None where nothing says so."""
    frames = support_places(predictions, estimate)
    if not estimate.nuisances or not frames:
        return None
    shown = {
        title: [own[name] for own in frames.values()]
        for name, title in zip(
            PLACING, ("pelvis’ obliquity, degrees (above 0: left side up)", "shoulder, mm to the left")
        )
    }
    turns = [place.value for place in next(iter(shown.values()))]
    alt = f"Pelvis’ obliquity and shoulder’s place by frame; pelvis {min(turns):+.1f}° to {max(turns):+.1f}°."
    caption = (
        "Where pelvis and opposite shoulder were: orange as the estimate has them (hollow: predicted, never fitted to "
        "the frame), blue as tracking saw them, grey what was known before."
    )
    return "supports", draw_support_places(list(frames), shown), alt, caption


def tornado_picture(found: Sensitivity) -> Drawn:
    """Refits with one thing changed."""
    rows = tornado_rows(found)
    words = [f"{title}: at most {largest(refits):.0f} %" for title, refits in rows]
    alt = f"Change of each stiffness by what was changed, {listed(words)}."
    caption = (
        f"Change of each stiffness, in percent, where the estimate is made again (weighed fit, {found.mesh} mesh) with "
        "one thing changed; the largest change first. A push +1 rib acts a rib lower."
    )
    return "sensitivity", draw_tornado(found), alt, caption


def planned_picture(plan: Plan) -> Drawn:
    """The next pushes."""
    title = TITLES[plan.target]
    steps = [f"{push_words(step.push)}: {width(plan, size_of(step.push))}" for step in plan.sequence]
    alt = f"Expected 95 % width of {title} with further radiographs, {listed(steps)}."
    caption = (
        f"Expected 95 % width of {title} with one more push, by rib (left), and with one push after the other, by "
        "further radiographs (right). To first order: it ranks pushes and says about how much another one brings."
    )
    return "plan", draw_plan(plan), alt, caption


def budget_picture(estimate: Estimate) -> Drawn:
    """What each unknown does to the variance of the ratios."""
    titles, shares = budget_bars(estimate)
    figure = draw_budget(BudgetBars(titles, {ratio_title(name): rows for name, rows in shares.items()}))
    words = [
        f"{within_a_sentence(ratio_title(name))}: {titles[int(np.argmax(rows[:, 1]))]}, {gained:.0f} %"
        for name, rows in shares.items()
        for gained in [100.0 * rows[:, 1].max()]
    ]
    alt = f"Share of each ratio’s variance by unknown. Most would be gained by knowing, for {listed(words)}."
    caption = (
        "What each unknown does to the variance of a ratio’s logarithm, in percent of all of it, to first order: what "
        "it adds where all others are known (grey), and what would go away if it were known (orange). Tracking’s "
        "errors are always there. Unknowns share what they spoil, so that neither column adds up to 100."
    )
    if len(shares) < len(estimate.parameters):
        caption += f" Of {len(estimate.parameters)} ratios the {len(shares)} that are known least."
    return "variance-budget", figure, alt, caption
