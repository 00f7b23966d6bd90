"""The report: complete, self-contained, safe against names from files, and the same each time."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from spinestiff.anatomy.files import write_torso
from spinestiff.anatomy.stiffness import stiffness_ratios
from spinestiff.anatomy.template import template_torso
from spinestiff.anatomy.torso import TorsoState
from spinestiff.errors import SubjectError
from spinestiff.imaging.features import silhouette_choice, state_features
from spinestiff.imaging.projection import XRayView, frontal_view, lateral_view
from spinestiff.imaging.radiograph import write_radiographs
from spinestiff.mechanics.equilibrium import EquilibriumProblem
from spinestiff.mechanics.loads import rib_push
from spinestiff.mechanics.supports import three_point_supports
from spinestiff.study.pipeline import Visit, open_visit
from spinestiff.study.report import write_report
from spinestiff.study.results import write_json
from spinestiff.study.subject import (
    Annotation,
    ImageAnnotation,
    PushRecord,
    SubjectRecord,
    write_annotation,
    write_subject,
)

TRUE = {"lateral_bending": 0.22, "tissue": 0.045}
ESTIMATE = {"lateral_bending": 0.2, "tissue": 0.05}
SEEN = slice(2, 16)
PUSHES = {
    "main": (8.0, (0.0, 30.0, 60.0), ("unused", "training", "validation")),
    "second": (5.5, (0.0, 50.0), ("unused", "validation")),
}
SECTIONS = ("result", "pictures", "force", "certainty", "prediction", "levels", "supports", "geometry", "computation")


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
        choice = silhouette_choice(torso, view, torso.rest_pose)
        seen = state_features(torso, view, state, choice).corners[SEEN]
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
        frames, state = [], torso.rest_pose
        for force in forces:
            state = problem.solve(rib_push(torso, "left", level, force), ratios, state).require().state
            frames.append(
                {
                    "force_n": force,
                    "corners_px": corners(views["frontal"], state),
                    "quality": np.full((14, 4), 0.9),
                    "dropped": "",
                    "support_motion_mm": {"pelvis": 0.1 + 0.01 * force, "shoulder": 0.2},
                }
            )
        images[f"push/{name}"] = annotated(frames[0]["corners_px"])
        records.append(
            PushRecord(
                id=name, side="left", level=level, d21_mm=400.0, d31_mm=200.0, frames=f"pushes/{name}.dcm",
                forces_n=forces, roles=roles,
            )
        )  # fmt: skip
        tracked[name] = {
            "view": view_record(views["frontal"]),
            "millimetres": {"pixel spacing": "DICOM ImagerPixelSpacing, at the detector", "orientation": "DICOM L\\F"},
            "vertebrae": list(torso.vertebrae[SEEN]),
            "frames": frames,
        }
    subject = SubjectRecord(schema_version=1, id="made-up-1", age=13.0, sex="female", height_cm=157.0, pushes=records)
    write_subject(folder, subject)
    write_annotation(folder, Annotation(schema_version=1, images=images))
    results = folder / "results"
    write_json(results / "tracked.json", {"schema_version": 1, "pushes": tracked})
    write_torso(results / "torso.npz", torso)
    write_json(results / "personalised.json", personalised_record(views, torso.vertebrae))
    write_json(results / "estimate.json", estimate_record())
    write_json(results / "assessment.json", assessment_record())
    return open_visit(folder)


def view_record(view: XRayView) -> dict:
    keys = ("source", "detector_origin", "detector_axes", "pixel_spacing", "source_to_patient")
    return {"shape": list(view.shape), **{key: getattr(view, key) for key in keys}}


def personalised_record(views: dict[str, XRayView], names: tuple[str, ...]) -> dict:
    source = {"pixel spacing": "DICOM ImagerPixelSpacing, at the detector", "orientation": "DICOM"}
    return {
        "schema_version": 1,
        "rmse_mm": {"frontal": 1.31, "lateral": 1.64},
        "vertebra_rmse_mm": {view: dict.fromkeys(names[SEEN], 1.2) | {"T7": 2.5} for view in views},
        "prior_only": ["T1", "T2", "L5"],
        "poses": {view: {"shift_mm": [1.2, -3.4], "roll_deg": 0.51} for view in views},
        "views": {name: view_record(view) for name, view in views.items()},
        "millimetres": {view: source for view in views},
    }


def estimate_record() -> dict:
    angle = np.linspace(0.0, 2.0 * np.pi, 60)
    region = np.exp(np.log(list(ESTIMATE.values())) + np.stack([0.15 * np.cos(angle), 0.4 * np.sin(angle - 0.5)], 1))
    steps = ([1.0, 1.0], [0.4, 0.3], [0.22, 0.08], [0.9, 0.9], [0.2, 0.05])
    return {
        "schema_version": 1,
        "status": "CONVERGED",
        "status_text": "converged",
        "ratios": {
            "lateral_bending": {"value": 0.2, "interval95": [0.173, 0.231], "at_bound": False},
            "tissue": {"value": 0.05, "interval95": [0.034, 0.074], "at_bound": False},
        },
        "plain": {
            "lateral_bending_thoracic_nm_per_rad": 30.8,
            "lateral_bending_lumbar_nm_per_rad": 29.8,
            "tissue_young_kpa": 50.0,
        },
        "covariance_log": [[0.005, -0.002], [-0.002, 0.03]],
        "correlation": -0.42,
        "condition": 18.0,
        "joint_region": region,
        "training_rmse_mm": {"default": 7.31, "fit": 1.12},
        "reactions_n": {
            "push": "push 'main' frame 1", "f3": 30.0, "shoulder": 14.6, "pelvis": 15.4, "eq2_shoulder": 15.0,
            "eq1_pelvis": 15.0,
        },
        "history": [
            {"ratios": dict(zip(ESTIMATE, step)), "loss": 10.0 / (i + 1), "rmse_mm": 5.0 / (i + 1), "accepted": i != 3}
            for i, step in enumerate(steps)
        ],
        "method": "lm",
        "orientation": "procrustes",
        "bounds": [0.005, 5.0],
        "poses": {name: {"shift_mm": [0.4, 1.0], "roll_deg": -0.3, "rms_mm": 1.0} for name in PUSHES},
        "cost": {"equilibria": 9, "newton_iterations": 40, "factorisations": 61, "seconds": 12.3},
        "warnings": ["push 'main' frame 1: the back wall pulls at 2 points"],
    }  # fmt: skip


def assessment_record() -> list[dict]:
    def change(size: float) -> dict:
        levels = {"levels": ["T5", "T11"], "tilt_levels": ["T6", "T12"]}
        return {"signed": size, "fixed_levels": 0.9 * size, "tilt": 1.1 * size, **levels}

    errors = {"rest": 14.0, "default": 9.0, "fit": 1.5, "extrapolation": 2.0, "single_ratio": 1.9, "truth": None}
    cobb = {"measured": change(-14.2), "default": change(-3.0), "fit": change(-13.1)}
    return [
        {"push": "main", "frame": 2, "force_n": 60.0, "rmse_mm": errors, "cobb_change_deg": cobb},
        {"push": "second", "frame": 1, "force_n": 50.0, "rmse_mm": {**errors, "fit": None}, "cobb_change_deg": cobb},
    ]
