"""What the report says of pushes and frames: response, predictions, supports as tracked, geometry and millimetres."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from spinestiff.curves.changes import change_words
from spinestiff.study.wording.numbers import MISSING, fixed, listed
from spinestiff.study.wording.steps import forecast_lines, response_texts
from spinestiff.subject.assessment_outcome import Assessment, HeldOutFrame
from spinestiff.subject.estimate_outcome import Estimate
from spinestiff.subject.geometry_outcome import GeometryRecord
from spinestiff.subject.outcome_parts import PoseRecord
from spinestiff.subject.outcomes import Responses, Tracked

PREDICTORS = {
    "rest": "No motion: the rest pose",
    "default": "Model, default stiffness",
    "single_ratio": "Model, one ratio for all stiffnesses",
    "extrapolation": "No model: training motion scaled by force",
    "fit": "Model, estimated stiffness",
    "forecast": "The same, with the errors that the training frames show",
    "fitted_supports": "The same, supports fitted to the frame’s own vertebrae: no prediction",
    "truth": "Model, true ratios (known for synthetic subjects only)",
}
# Neither competes: one knows the truth, the other the frame.
INFORMED = ("truth", "fitted_supports")
EQUAL_MM = 0.1  # mean errors that differ by less are called equal
MODELS = {"rest": "Rest pose, no motion", "default": "Default stiffness", "fit": "Estimated stiffness"}


def response_content(responses: Responses) -> dict[str, Any]:
    """What each push says without a model, and the gauge's errors that were assumed."""
    return {
        "pushes": [{"name": name, "texts": response_texts(push)} for name, push in responses.pushes.items()],
        "gauge": f"{100.0 * responses.gauge_scale_sd:g} % and {responses.gauge_zero_sd_n:g} N",
    }


def comparison_content(assessment: Assessment) -> dict[str, Any]:
    """Mean errors over the held-out frames, and what the estimate is worth beside the best simpler predictor.

    The estimate's prediction is the forecast; where no forecast could be made, the model's state alone.
    """
    means = {}
    for name in PREDICTORS:
        values = [frame.rmse_mm.get(name) for frame in assessment.frames]
        if values and all(value is not None for value in values):
            means[name] = float(np.mean([value for value in values if value is not None]))
    rivals = {name: value for name, value in means.items() if name not in ("fit", "forecast", *INFORMED)}
    best = min(rivals, key=lambda name: rivals[name]) if rivals else ""
    predicted = means.get("forecast", means.get("fit"))
    verdict = ""
    if best and predicted is not None:
        difference = predicted - rivals[best]
        verdict = "equal" if abs(difference) < EQUAL_MM else "worse" if difference > 0.0 else "better"
    return {
        "frames": len(assessment.frames),
        "predicted": "" if predicted is None else fixed(predicted, 2),
        "uncorrected": fixed(means["fit"], 2) if {"fit", "forecast"} <= means.keys() else "",
        "default": fixed(means["default"], 2) if "default" in means else "",
        "verdict": verdict,
        "rival": PREDICTORS.get(best, ""),
        "rival_error": fixed(rivals[best], 2) if best else "",
    }


def prediction_content(assessment: Assessment) -> dict[str, Any]:
    """Tables of the held-out frames: corner errors by predictor, and Cobb angles."""
    frames = assessment.frames
    shown = [name for name in PREDICTORS if any(frame.rmse_mm.get(name) is not None for frame in frames)]
    rows = [
        {
            "title": PREDICTORS[name],
            "fit": name == "fit",
            "cells": [
                {"text": fixed(frame.rmse_mm.get(name), 2), "best": name in _best(frame.rmse_mm)} for frame in frames
            ],
        }
        for name in shown
    ]
    return {
        "frames": [_frame_title(frame) for frame in frames],
        "rows": rows,
        "expected": forecast_lines(frames),
        "cobb": [_cobb_rows(frame) for frame in frames],
    }


def _frame_title(frame: HeldOutFrame) -> str:
    return f"“{frame.push}”, frame {frame.frame}, {frame.force_n:.0f} N"


def _best(errors: Mapping[str, float | None]) -> list[str]:
    """The predictors with the least error as printed; those that know more don't compete."""
    known = {name: round(value, 2) for name, value in errors.items() if value is not None and name not in INFORMED}
    return [name for name, value in known.items() if value == min(known.values())]


def _cobb_rows(frame: HeldOutFrame) -> dict[str, Any]:
    rows = []
    titles = {"measured": "Measured", **MODELS, "forecast": "Forecast", "truth": "True ratios"}
    for name, title in titles.items():
        if name not in frame.cobb_change_deg:
            continue
        change = frame.cobb_change_deg[name]
        if change is None:
            rows.append({"title": title, "cells": [MISSING] * 3})
            continue
        levels = (change.signed_levels, "–".join(change.levels), "–".join(change.tilt_levels))
        sizes = (change.signed, change.fixed_levels, change.tilt)
        rows.append({"title": title, "cells": [change_words(*one) for one in zip(sizes, frame.cobb_sds(name), levels)]})
    return {"title": _frame_title(frame), "rows": rows}


def expected_change(frame: HeldOutFrame) -> str:
    """The change of the Cobb angle between fixed levels that the training frames let expect, with its ±; or nothing."""
    expected = frame.cobb_change_deg.get("forecast")
    if expected is None:
        return ""
    return change_words(expected.fixed_levels, frame.cobb_sds("forecast")[1], "–".join(expected.levels))


def support_rows(tracked: Tracked) -> list[dict[str, str]]:
    """Largest motion of each support, largest obliquity, and the frames that the paper would leave out, by push."""
    rows = []
    for name, push in tracked.pushes.items():
        largest = {}
        for support in ("pelvis", "shoulder"):
            seen = [f.support_motion_mm[support] for f in push.frames if support in f.support_motion_mm]
            largest[support] = f"{fixed(max(seen))} mm" if seen else "not marked"
        turns = [f.obliquity_deg for f in push.frames if f.obliquity_deg is not None]
        most = max(turns, key=lambda turn: abs(turn.value), default=None)
        turned = "not seen" if most is None else f"{fixed(most.value, 1, True)}° ± {fixed(most.sd, 1)}°"
        moved = [f"frame {i}" for i, frame in enumerate(push.frames) if frame.support_note]
        unmoved = "none seen" if turns or any(f.support_motion_mm for f in push.frames) else "not seen"
        rows.append(
            {
                "push": name, **largest, "obliquity": turned, "moved": listed(moved) or unmoved,
                "frames": str(len(push.frames)),
            }
        )  # fmt: skip
    return rows


MESH_PATHS = {
    "kept": "carried to the subject’s shape",
    "rebuilt": "built anew in the subject’s skin, since the carried one was too distorted",
    "finer": "the fine one carried to the subject’s shape, since the coarse one was too distorted",
}


def geometry_content(geometry: GeometryRecord, estimate: Estimate) -> dict[str, Any]:
    """How well the rest shape meets each picture, where the patient stood, and what no picture shows."""
    rows = []
    for view, error in geometry.rmse_mm.items():
        each = geometry.fits[view]
        worst = max(each.items(), key=lambda entry: entry[1].rmse_mm, default=None)
        largest = MISSING if worst is None else f"{worst[0]}, {fixed(worst[1].rmse_mm)} mm"
        rows.append(
            {"title": f"Rest, {view}", "rmse": fixed(error, 2), "worst": largest, **_pose(geometry.poses[view])}
        )
    for push, pose in estimate.poses.items():
        title = f"Push “{push}”, least force"
        rows.append({"title": title, "rmse": fixed(pose.rms_mm, 2), "worst": "", **_pose(pose)})
    return {
        "rows": rows,
        "prior_only": listed(geometry.prior_only),
        "mesh": f"{MESH_PATHS[geometry.mesh.path]}, {geometry.mesh.nodes} nodes",
    }


def _pose(pose: PoseRecord) -> dict[str, str]:
    across, along = pose.shift_mm
    return {"shift": f"{fixed(across, 1, True)} / {fixed(along, 1, True)}", "roll": f"{fixed(pose.roll_deg, 2, True)}°"}


def millimetre_rows(geometry: GeometryRecord, tracked: Tracked) -> dict[str, Any]:
    """Where scale and directions came from; images that say the same share a column."""
    images = {f"rest, {view}": found for view, found in geometry.millimetres.items()}
    images |= {f"push “{push}”": entry.millimetres for push, entry in tracked.pushes.items()}
    groups: dict[tuple[tuple[str, str], ...], list[str]] = {}
    for image, found in images.items():
        groups.setdefault(tuple(sorted(found.items())), []).append(image)
    keys = sorted({key for found in groups for key, _ in found})
    return {
        "images": [listed(names) for names in groups.values()],
        "rows": [(key, [dict(found).get(key, MISSING) for found in groups]) for key in keys],
    }
