"""What the report says: numbers as people read them, and the rows of its tables, from the files of results."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from spinestiff.curves.tilts import cobb_angle, tilts
from spinestiff.study.visit import Visit, read_truth, truth_in_region
from spinestiff.subject.folder import image_corners, read_rest

MISSING = "not available"
# Secant lateral-bending stiffness of cadaver thoracic segments at 7.5 N m (Wilke et al. 2017), N m/degree.
BENDING_BAND = (1.3, 1.8)
# Range of the ratio in the seven subjects of the method's first study. Its tissue ratios are left out: they belong to
# another default tissue. "lateral_bending" takes the sternal joints along and is another ratio.
PUBLISHED = {"intervertebral_bending": (0.01, 0.63)}
RATIO_TITLES = {
    "lateral_bending": "Lateral bending of the spine",
    "intervertebral_bending": "Lateral bending of the spine, rib cage as it is",
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
BENDING = ("lateral_bending", "intervertebral_bending", "everything")  # ratios that scale a level's lateral bending
# Plain quantity -> the ratios that scale it as a whole, its name and unit.
PLAIN = {
    "lateral_bending_thoracic_nm_per_rad": (BENDING, "per thoracic level", "N m/rad"),
    "lateral_bending_lumbar_nm_per_rad": (BENDING, "per lumbar level", "N m/rad"),
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


def listed(parts: Iterable[str]) -> str:
    """Words as a list: a, b and c."""
    parts = list(parts)
    return ", ".join(parts[:-1]) + " and " + parts[-1] if len(parts) > 1 else "".join(parts)


def ratio_title(name: str) -> str:
    """What a ratio scales, in words."""
    return RATIO_TITLES.get(name, name.replace("_", " "))


def subject_content(visit: Visit) -> dict[str, Any]:
    """Who was radiographed, and the curve at rest."""
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


def result_content(visit: Visit, estimate: Mapping[str, Any]) -> dict[str, Any]:
    """Status, ratios with intervals and in plain units, plausibility and warnings."""
    bounds, plain = estimate["bounds"], estimate["plain"]
    truth = read_truth(visit.truth) if visit.truth else {}
    ratios = []
    for name in fitted_names(estimate):
        entry = estimate["ratios"][name]
        ratios.append(
            {
                "title": ratio_title(name),
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


def fitted_names(estimate: Mapping[str, Any]) -> list[str]:
    """The fitted ratios in the order of the fit."""
    # A file's keys are sorted.
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
    name = next((name for name in BENDING if name in estimate["ratios"]), None)
    if value is None or name is None:
        return None
    low, high = (float(np.degrees(edge)) for edge in BENDING_BAND)
    entry = estimate["ratios"][name]
    first, last = (bound if end is None else end for end, bound in zip(entry["interval95"], estimate["bounds"]))
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


def certainty_content(visit: Visit, estimate: Mapping[str, Any]) -> dict[str, Any]:
    """How the fit went, and whether the joint region holds the truth where that is known."""
    contains = truth_in_region(visit) if visit.truth else None
    return {
        "correlation": fixed(estimate["correlation"], 2),
        "condition": number(estimate["condition"], 2),
        "steps": sum(bool(step["accepted"]) for step in estimate["history"]),
        "evaluations": len(estimate["history"]),
        "truth": "" if contains is None else "holds" if contains else "does not hold",
    }


def comparison_content(assessment: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
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


def prediction_content(assessment: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Tables of the held-out frames: corner errors by predictor, and Cobb angles."""
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


def reaction_rows(found: Mapping[str, Any]) -> list[dict[str, str]]:
    """Forces at the supports in the model beside Eqs. 1-2."""
    return [
        {"title": "Push on the ribs (F3)", "model": fixed(found["f3"]), "balance": fixed(found["f3"])},
        {"title": "Shoulder (F1)", "model": fixed(found["shoulder"]), "balance": fixed(found["eq2_shoulder"])},
        {"title": "Pelvis (F2)", "model": fixed(found["pelvis"]), "balance": fixed(found["eq1_pelvis"])},
    ]


def support_rows(tracked: Mapping[str, Any]) -> list[dict[str, str]]:
    """Largest motion of each support, and what was dropped, by push."""
    rows = []
    for name, push in tracked["pushes"].items():
        frames = push["frames"]
        largest = {}
        for support in ("pelvis", "shoulder"):
            seen = [f["support_motion_mm"][support] for f in frames if support in f["support_motion_mm"]]
            largest[support] = f"{fixed(max(seen))} mm" if seen else "not marked"
        dropped = [f"frame {i}" for i, frame in enumerate(frames) if frame["dropped"]]
        rows.append({"push": name, **largest, "dropped": listed(dropped) or "none", "frames": str(len(frames))})
    return rows


MESH_PATHS = {
    "kept": "carried to the subject’s shape",
    "rebuilt": "built anew in the subject’s skin, since the carried one was too distorted",
    "finer": "the fine one carried to the subject’s shape, since the coarse one was too distorted",
}


def geometry_content(personalised: Mapping[str, Any], estimate: Mapping[str, Any]) -> dict[str, Any]:
    """How well the rest shape meets each picture, where the patient stood, and what no picture shows."""
    rows = []
    for view, error in personalised["rmse_mm"].items():
        pose, each = personalised["poses"][view], personalised["vertebra_rmse_mm"][view]
        worst = max(each, key=lambda name: each[name]) if each else ""
        largest = f"{worst}, {fixed(each[worst])} mm" if worst else MISSING
        rows.append({"title": f"Rest, {view}", "rmse": fixed(error, 2), "worst": largest, **_pose(pose)})
    for push, pose in estimate["poses"].items():
        title = f"Push “{push}”, least force"
        rows.append({"title": title, "rmse": fixed(pose["rms_mm"], 2), "worst": "", **_pose(pose)})
    mesh = personalised["mesh"]
    return {
        "rows": rows,
        "prior_only": listed(personalised["prior_only"]),
        "mesh": f"{MESH_PATHS[mesh['path']]}, {mesh['nodes']} nodes",
    }


def _pose(pose: Mapping[str, Any]) -> dict[str, str]:
    across, along = pose["shift_mm"]
    return {
        "shift": f"{fixed(across, 1, True)} / {fixed(along, 1, True)}",
        "roll": f"{fixed(pose['roll_deg'], 2, True)}°",
    }


def millimetre_rows(personalised: Mapping[str, Any], tracked: Mapping[str, Any]) -> dict[str, Any]:
    """Where scale and directions came from; images that say the same share a column."""
    images = {f"rest, {view}": found for view, found in personalised["millimetres"].items()}
    images |= {f"push “{push}”": entry["millimetres"] for push, entry in tracked["pushes"].items()}
    groups: dict[tuple[tuple[str, str], ...], list[str]] = {}
    for image, found in images.items():
        groups.setdefault(tuple(sorted(found.items())), []).append(image)
    keys = sorted({key for found in groups for key, _ in found})
    return {
        "images": [listed(names) for names in groups.values()],
        "rows": [(key, [dict(found).get(key, MISSING) for found in groups]) for key in keys],
    }
