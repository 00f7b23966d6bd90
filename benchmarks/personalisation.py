"""Personalisation judged on shapes it was not made from: real spines from CT and synthetic scoliosis.

``python benchmarks/personalisation.py --spines CSV [--radiographs FOLDER] [--json] [--write] [--jobs 2] [--all]
[--subjects N] [--log FILE] [--scenario NAME ...]``; a line a fit goes to the log, and a run that was stopped goes on
from it.

The truth is made without the fit. Poses: every complete spine of the table (``study.synthetic.spines.real_spine``:
places and tangents by local parabolas and lines through the body points, since single points lie on a grid of 1 to 3
mm; axial rotation from the pedicle points by a median of five levels, smoothed alike, and interpolated where a level
has none), scaled to a body of 139 to 180 cm whose spine is up to 7 % longer or shorter than the template's at that
height, and curves of 10 to 45 degrees (``study.synthetic.spines.curved_spine``) on a body with another kyphosis.
Vertebrae: boxes with their own width, height and depth each, endplates that differ in size as published, and bodies
wedged front to back. Pedicles: where the table has them in the vertebra's own frame. Both views are of a full-length
detector; a search over each endplate's rim finds how deep the silhouette's corner lies. The fit sees noisy corners,
views and body height, nothing else.
A spine with a point missing or far off the others' line, with bodies that overlap
or with a gap as tall as a body is skipped and named, as ``spinestiff synth --spine-id`` refuses it. ``known`` takes
every subject, the other scenarios every ninth (``EVERY``; ``--all``: every one). Synthetic curves are no spines: they
are summed up by themselves, in ``curves``.

Scenarios:

    known       the views' geometry is known; 0.5 mm noise (standard deviation of each coordinate, patient plane)
    pedicles    the same with pedicle points in the frontal view
    wrong       as known; a corner 15 mm off in the frontal view, T8 and T9 swapped in the lateral one
    nuisance    1.5 mm noise, lateral yaw 5 degrees, 10 mm shift in each view, source distance +-3 %, T1 to T4 hidden in
                the lateral view; nothing of it told. Views fix a torso up to a rigid motion: centres and tilts are
                compared after the best one, and as they are (``_raw``).
    frontal     the frontal view alone, its geometry known
    fresh       as known, on other subjects: the fit was tuned while those of the table were looked at, these were
                drawn afterwards. Coronal shapes of annotated standing radiographs of scoliosis patients, the rows
                ``FRESH_ROWS`` whose corners are in order (``--radiographs``: landmarks.csv and images.csv; of the
                shape of AASCE 2019), on bodies of another height, kyphosis and lordosis each

Baselines, on the views of ``known``: the height-scaled template, moved to the subject's mean place; the same moved and
turned as one body to meet the corners best.
"""

from __future__ import annotations

import argparse
import csv
import datetime
import json
import os
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from kept_rows import begun, prepare
from scipy.optimize import least_squares

from spinestiff.anatomy.names import VERTEBRAE
from spinestiff.anatomy.rotation import exp_so3, log_so3
from spinestiff.anatomy.template import template_torso
from spinestiff.anatomy.template.sizes import VERTEBRA_SIZES
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.arrays import Floats
from spinestiff.errors import SpinestiffError
from spinestiff.imaging.features import VertebraCorners, silhouette_shares, state_features
from spinestiff.imaging.pedicles import PediclePoints
from spinestiff.imaging.projection import XRayView, frontal_view, lateral_view
from spinestiff.personalise.shape import personalise
from spinestiff.study.synthetic.spines import (
    AXIAL_COUPLING,
    CURVES,
    body_heights,
    curved_spine,
    real_spine,
    refuse_spacing,
    rest_vertebrae,
    smoothed,
    torso_from_lps,
)

SCENARIOS = ("known", "pedicles", "wrong", "nuisance", "frontal", "fresh")
BASELINES = ("template", "rigid")
HEIGHTS_CM = (139.0, 180.0)
SPINE_LENGTH_SD, LARGEST_LENGTH = 0.035, 0.07
# Of the log sizes (width, height, depth): of the person, and of each vertebra.
PERSON_SD, VERTEBRA_SD = np.array([0.07, 0.03, 0.07]), np.array([0.035, 0.035, 0.035])
WEDGE_SD = 0.04  # of anterior over posterior height
PLACE_SD_MM = 10.0  # of the pelvis in the room
NOISE_MM, MORE_NOISE_MM = 0.5, 1.5
YAW_DEG, SHIFT_MM, DISTANCE = 5.0, 10.0, 0.03
HIDDEN = ("T1", "T2", "T3", "T4")
WRONG_MM = 15.0
# Rows 0, 16, ... were looked at: they showed that silhouettes have to follow the shape; rows 8, 24, ... too: that round
# bodies hardly tell how they are turned. These were not.
FRESH_ROWS = slice(4, None, 16)
KYPHOSIS_DEG, LORDOSIS_DEG = (20.0, 50.0), (35.0, 60.0)
# Of the subjects, every so manyth is fitted; all without an entry here.
EVERY = {"nuisance": 9, "pedicles": 9, "wrong": 9, "frontal": 9}
# Corners in picture order: superior-first, superior-second, inferior-second, inferior-first.
LEVEL, SIDE = np.array([0, 0, 1, 1]), np.array([0, 1, 1, 0])
RIM_END = np.deg2rad(89.0)


@dataclass(frozen=True)
class Truth:
    """A subject: poses (17, 3), (17, 3, 3), boxes (17, 2, 2, 2, 3) as [level, side, front], pedicles (17, 2, 3)."""

    name: str
    height_cm: float
    positions: Floats
    rotations: Floats
    boxes: Floats
    pedicles: Floats

    def world(self, local: Floats) -> Floats:
        """Points (17, ..., 3) of the vertebrae's frames in the world."""
        turned = np.einsum("vij,v...j->v...i", self.rotations, local)
        return turned + self.positions.reshape(17, *[1] * (local.ndim - 2), 3)


def own_boxes(random: np.random.Generator, scale: float) -> Floats:
    """(17, 2, 2, 2, 3) mm: boxes of vertebrae that are nobody else's."""
    above, depth_above, below, depth_below, height, _ = VERTEBRA_SIZES.T
    factor = scale * np.exp(random.normal(0.0, PERSON_SD) + random.normal(0.0, VERTEBRA_SD, (17, 3)))
    wedge = random.normal(0.0, WEDGE_SD, 17)
    boxes = np.empty((17, 2, 2, 2, 3))
    for level, width, depth in ((0, above, depth_above), (1, below, depth_below)):
        for side in (0, 1):
            for front in (0, 1):
                tall = (1 - 2 * level) * 0.5 * height * (1.0 + 0.5 * (1 - 2 * front) * wedge)
                corner = [(1 - 2 * side) * 0.5 * width, tall, (1 - 2 * front) * 0.5 * depth]
                boxes[:, level, side, front] = np.stack(corner, -1) * factor
    return boxes - boxes.mean((1, 2, 3), keepdims=True)


def own_pedicles(random: np.random.Generator, boxes: Floats, offsets: Floats) -> Floats:
    """(17, 2, 3) mm, left and right: mean ``offsets`` (17, 3) of the table, scattered by 1 mm a point."""
    width = boxes[:, :, 0, :, 0].mean((1, 2)) - boxes[:, :, 1, :, 0].mean((1, 2))
    scale = (width / VERTEBRA_SIZES[:, [0, 2]].mean(1))[:, None, None]
    points = np.stack([offsets, offsets * [-1.0, 1.0, 1.0]], 1)
    return points * scale + random.normal(0.0, 1.0, points.shape)


def pedicle_offsets(table: Path) -> Floats:
    """(17, 3) mm: median of the left pedicle points in the vertebra's frame over the table, for an adolescent's size.

    The frame's sideways direction is taken from the pair itself, so the mean of both lies in the middle plane.
    """
    points: dict[tuple[str, str], dict[str, Floats]] = {}
    with table.open(newline="", encoding="utf-8-sig") as file:
        for row in csv.DictReader(file):
            if row["x_mm"]:
                lps = np.array([float(row[key]) for key in ("x_mm", "y_mm", "z_mm")])
                points.setdefault((row["id"], row["level"]), {})[row["keypoint"]] = torso_from_lps(lps)
    torso = template_torso(157.0)
    frames: dict[str, Floats] = {}
    found: dict[str, list[Floats]] = {level: [] for level in VERTEBRAE}
    for (spine, level), keypoints in points.items():
        if spine not in frames:
            try:
                frames[spine] = real_spine(torso, table, spine)[1]
            except SpinestiffError:
                frames[spine] = np.full((17, 3, 3), np.nan)
        frame = frames[spine][VERTEBRAE.index(level)]
        if {"body", "left", "right"} <= set(keypoints) and np.isfinite(frame).all():
            left, right = (keypoints[side] - keypoints["body"] for side in ("left", "right"))
            middle = frame.T @ (0.5 * (left + right))
            found[level].append(np.array([0.5 * np.linalg.norm(left - right), middle[1], middle[2]]))
    adult = np.array([np.median(found[level], axis=0) for level in VERTEBRAE])
    return np.asarray(adult * 0.87)  # the reference girl's endplates over an adult's (template.sizes)


def ct_subject(table: Path, spine: str, offsets: Floats, number: int) -> Truth:
    """A spine of the table on a body of its own; raises SpinestiffError where a point is missing or implausible."""
    random = np.random.default_rng([1, number])
    height = float(random.uniform(*HEIGHTS_CM))
    torso = template_torso(height)
    positions, rotations = real_spine(torso, table, spine)
    longer = 1.0 + float(np.clip(random.normal(0.0, SPINE_LENGTH_SD), -LARGEST_LENGTH, LARGEST_LENGTH))
    return _subject(spine, height, positions, rotations, longer, offsets, random)


def scoliosis_subject(cobb_deg: float, curve: str, offsets: Floats, number: int) -> Truth:
    """A synthetic curve, with a kyphosis that the template doesn't have."""
    random = np.random.default_rng([2, number])
    height = float(random.uniform(*HEIGHTS_CM))
    torso = template_torso(height)
    positions, rotations = curved_spine(torso, cobb_deg, curve)
    share = (positions[:, 1] - positions[-1, 1]) / (positions[0, 1] - positions[-1, 1])
    flatter = random.normal(0.0, 8.0) * np.sin(np.pi * share)
    pitch = np.arctan(np.gradient(flatter, positions[:, 1]))
    positions = positions + np.outer(flatter, [0.0, 0.0, 1.0])
    rotations = exp_so3(np.outer(pitch, [1.0, 0.0, 0.0])) @ rotations
    longer = 1.0 + float(np.clip(random.normal(0.0, SPINE_LENGTH_SD), -LARGEST_LENGTH, LARGEST_LENGTH))
    name = f"{curve} {cobb_deg:+.0f} deg"
    return _subject(name, height, positions, rotations, longer, offsets, random)


def fresh_subject(name: str, corners: Floats, offsets: Floats, number: int) -> Truth:
    """The coronal shape of an annotated radiograph on a body of its own.

    ``corners`` (17, 4, 2) px: top-left, top-right, bottom-left, bottom-right as seen. Places and tilts of vertebrae are
    smoothed like those of the table, since single corners are annotated to a few pixels.
    """
    random = np.random.default_rng([4, number])
    height = float(random.uniform(*HEIGHTS_CM))
    template = template_torso(
        height, kyphosis_deg=float(random.uniform(*KYPHOSIS_DEG)), lordosis_deg=float(random.uniform(*LORDOSIS_DEG))
    )
    positions, rotations = rest_vertebrae(template)
    centres, across = corners.mean(1), corners[:, [1, 3]].mean(1) - corners[:, [0, 2]].mean(1)
    scale = (positions[0, 1] - positions[-1, 1]) / (centres[-1, 1] - centres[0, 1])
    # A frontal picture has the patient's left on its right, and rows that grow downwards.
    seen = np.stack([scale * (centres[:, 0] - centres[-1, 0]), np.arctan2(-across[:, 1], across[:, 0])], 1)
    side, tilt = smoothed(seen, np.arange(17.0))[0].T
    # The trunk stands over the pelvis, as the radiographs of upright patients nearly do.
    share = (positions[:, 1] - positions[-1, 1]) / (positions[0, 1] - positions[-1, 1])
    side, lean = side - side[-1] - share * (side[0] - side[-1]), side[0] - side[-1]
    tilt = tilt + np.arctan2(lean, positions[0, 1] - positions[-1, 1])
    axial = AXIAL_COUPLING * np.abs(tilt).max() * side / max(np.abs(side).max(), 1.0)
    turned = exp_so3(np.outer(tilt, [0.0, 0.0, 1.0])) @ exp_so3(np.outer(axial, [0.0, 1.0, 0.0])) @ rotations
    longer = 1.0 + float(np.clip(random.normal(0.0, SPINE_LENGTH_SD), -LARGEST_LENGTH, LARGEST_LENGTH))
    placed = positions + np.outer(side, [1.0, 0.0, 0.0])
    return _subject(name, height, placed, turned, longer, offsets, random)


def fresh_cohort(folder: Path, offsets: Floats) -> tuple[list[Truth], dict[str, str]]:
    """Subjects from annotated radiographs, and by row why a radiograph is none."""
    landmarks = np.loadtxt(folder / "landmarks.csv", delimiter=",")
    with (folder / "images.csv").open(newline="", encoding="utf-8-sig") as file:
        sizes = np.array([[float(row["width_px"]), float(row["height_px"])] for row in csv.DictReader(file)])
    subjects, skipped = [], {}
    for row in range(len(landmarks))[FRESH_ROWS]:
        corners = np.stack([landmarks[row, :68], landmarks[row, 68:]], -1).reshape(17, 4, 2) * sizes[row]
        name = f"radiograph {row}"
        if not _in_order(corners):
            skipped[name] = "corners out of order"
            continue
        try:
            subjects.append(fresh_subject(name, corners, offsets, row))
        except SpinestiffError as error:
            skipped[name] = str(error)
    return subjects, skipped


def _in_order(corners: Floats) -> bool:
    """Whether left corners lie left of right ones, top above bottom, and each vertebra below the one before."""
    left, right = corners[:, [0, 2], 0], corners[:, [1, 3], 0]
    top, bottom = corners[:, :2, 1], corners[:, 2:, 1]
    return bool((left < right).all() and (top < bottom).all() and (np.diff(corners.mean(1)[:, 1]) > 0.0).all())


def _subject(
    name: str,
    height: float,
    positions: Floats,
    rotations: Floats,
    longer: float,
    offsets: Floats,
    random: np.random.Generator,
) -> Truth:
    base = positions[-1] + random.normal(0.0, PLACE_SD_MM, 3)
    placed = base + longer * (positions - positions[-1])
    boxes = own_boxes(random, longer * height / 157.0)
    refuse_spacing(placed, body_heights(boxes.reshape(17, 8, 3)))
    return Truth(name, height, placed, rotations, boxes, own_pedicles(random, boxes, offsets))


def projected(truth: Truth, view: XRayView, lateral: bool) -> Floats:
    """(17, 4, 2) mm on the detector: between the two box corners of each pair, as deep as a search over the endplate's
    rim (an ellipse in the box) finds what is seen farthest out, in half widths and half heights together."""
    boxes = truth.boxes if lateral else truth.boxes.swapaxes(2, 3)
    # (17, 4, 3): corner in picture order. Lateral: first = front, the pair is left and right.
    one, other = (np.stack([boxes[:, level, pair, side] for level, side in zip(LEVEL, SIDE)], 1) for pair in (0, 1))
    middle, half = 0.5 * (one + other), 0.5 * (one - other)
    up, across = middle * [0.0, 1.0, 0.0], middle * ([0.0, 0.0, 1.0] if lateral else [1.0, 0.0, 0.0])
    start = view.project(truth.world(middle))
    axes = np.stack([start - view.project(truth.world(middle - side)) for side in (across, up)], -1)
    outer = np.zeros(middle.shape[:2])
    # Nearer and nearer: 10 degrees apart, then 1, then a tenth.
    for step in np.deg2rad([10.0, 1.0, 0.1]):
        angles = np.clip(outer + step * np.arange(-9, 10)[:, None, None], -RIM_END, RIM_END)[..., None]
        rim = middle - across + np.cos(angles) * across + np.sin(angles) * half
        seen = np.stack([view.project(truth.world(points)) for points in rim]) - start
        outwards = np.linalg.solve(np.broadcast_to(axes, (*seen.shape, 2)), seen[..., None])[..., 0].sum(-1)
        outer = np.take_along_axis(angles[..., 0], np.argmax(outwards, axis=0)[None], axis=0)[0]
    return np.asarray(view.project(truth.world(middle + np.sin(outer)[..., None] * half)))


def full_length(make: Any, centre: Floats, distance: float = 1.0) -> XRayView:
    """A view on a detector that holds the whole spine."""
    return make(sid=1500.0 * distance, source_to_patient=1340.0 * distance, shape=(1536, 1024), centre=centre)  # type: ignore[no-any-return]


@dataclass(frozen=True)
class Pictures:
    """What a fit gets, and the noiseless corners (17, 4, 2) mm on the detector behind it."""

    corners: Mapping[str, tuple[VertebraCorners, XRayView]]
    pedicles: Mapping[str, tuple[tuple[str, ...], Floats]]
    exact: Mapping[str, Floats]
    known: bool


def pictures_of(truth: Truth, scenario: str, number: int) -> Pictures:
    """The annotated pictures of a subject in a scenario."""
    random = np.random.default_rng([3, number, SCENARIOS.index(scenario)])
    centre = np.array([0.0, 0.5 * sum(rest_vertebrae(template_torso(truth.height_cm))[0][[0, -1], 1]), 0.0])
    corners, pedicles, exact = {}, {}, {}
    for name, make in (("frontal", frontal_view), ("lateral", lateral_view)):
        if scenario == "frontal" and name == "lateral":
            continue
        nominal = view = full_length(make, centre)
        body, noise, names = truth, NOISE_MM, VERTEBRAE
        if scenario == "nuisance":
            noise = MORE_NOISE_MM
            view = full_length(make, centre, 1.0 + DISTANCE * float(random.choice([-1.0, 1.0])))
            angle = random.uniform(0.0, 2.0 * np.pi)
            view = view.moved(SHIFT_MM * np.array([np.cos(angle), np.sin(angle)]), 0.0)
            if name == "lateral":
                names = tuple(v for v in VERTEBRAE if v not in HIDDEN)
                turn = exp_so3(np.array([0.0, np.deg2rad(YAW_DEG) * float(random.choice([-1.0, 1.0])), 0.0]))
                body = replace(truth, positions=truth.positions @ turn.T, rotations=turn @ truth.rotations)
        exact[name] = projected(body, view, name == "lateral")
        noisy = exact[name] + random.normal(0.0, noise * view.magnification, exact[name].shape)
        if scenario == "wrong" and name == "frontal":
            # Along a diagonal outwards, so that the corners keep their order and no look at them gives it away.
            row = int(random.integers(3, 15))
            away = noisy[row, 1] - noisy[row].mean(0)
            noisy[row, 1] += WRONG_MM * view.magnification * away / np.linalg.norm(away)
        if scenario == "wrong" and name == "lateral":
            noisy[[7, 8]] = noisy[[8, 7]]
        corners[name] = (VertebraCorners(VERTEBRAE, noisy).selected(names), nominal)
        if scenario == "pedicles" and name == "frontal":
            points = view.project(body.world(body.pedicles))
            pedicles[name] = (names, points + random.normal(0.0, noise * view.magnification, points.shape))
    return Pictures(corners, pedicles, exact, scenario != "nuisance")


def tilt_angles(rotations: Floats) -> Floats:
    """(17, 2) degrees: coronal tilt (of the left axis, in the frontal plane), sagittal tilt (of the anterior axis)."""
    coronal = np.arctan2(rotations[:, 1, 0], rotations[:, 0, 0])
    sagittal = np.arctan2(-rotations[:, 1, 2], rotations[:, 2, 2])
    return np.degrees(np.stack([coronal, sagittal], -1))


def largest_cobb(coronal: Floats) -> float:
    """Largest difference of two vertebrae's tilts, degrees; without sign, which jumps where two curves are alike."""
    return float(coronal.max() - coronal.min())


def fixed_cobb(true: Floats, coronal: Floats) -> float:
    """The difference between the true end vertebrae."""
    return float(coronal[np.argmax(true)] - coronal[np.argmin(true)])


def aligned(positions: Floats, rotations: Floats, truth: Truth) -> tuple[Floats, Floats]:
    """The poses after the rigid motion that brings their centres nearest to the true ones (Kabsch 1976)."""
    a, b = positions - positions.mean(0), truth.positions - truth.positions.mean(0)
    u, _, vt = np.linalg.svd(a.T @ b)
    turn = (u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))]) @ vt).T
    return a @ turn.T + truth.positions.mean(0), turn @ rotations


def errors_of(truth: Truth, positions: Floats, rotations: Floats, rigid: bool) -> dict[str, Any]:
    """Errors of one subject; lists are over vertebrae. ``rigid``: compared after the best rigid motion."""
    raw = np.linalg.norm(positions - truth.positions, axis=1)
    wanted, raw_tilt = tilt_angles(truth.rotations), tilt_angles(rotations)
    record: dict[str, Any] = {}
    if rigid:
        record["centre_error_mm_raw"] = raw.tolist()
        record["tilt_error_deg_raw"] = np.abs(raw_tilt - wanted).ravel().tolist()
        positions, rotations = aligned(positions, rotations, truth)
    tilt = tilt_angles(rotations)
    record["centre_error_mm"] = np.linalg.norm(positions - truth.positions, axis=1).tolist()
    record["tilt_error_deg"] = np.abs(tilt - wanted).ravel().tolist()
    record["coronal_tilt_error_deg"], record["sagittal_tilt_error_deg"] = np.abs(tilt - wanted).T.tolist()
    record["cobb_error_deg"] = [abs(largest_cobb(tilt[:, 0]) - largest_cobb(wanted[:, 0]))]
    record["cobb_fixed_levels_error_deg"] = [abs(fixed_cobb(wanted[:, 0], tilt[:, 0]) - largest_cobb(wanted[:, 0]))]
    twist = log_so3(np.swapaxes(truth.rotations, 1, 2) @ rotations)[:, 1]
    record["axial_error_deg"] = np.abs(np.degrees(twist)).tolist()
    none = np.arctan2(-truth.rotations[:, 2, 0], truth.rotations[:, 0, 0])
    record["axial_null_deg"] = np.abs(np.degrees(none)).tolist()
    return record


def exact_rmse(torso: TorsoModel, given: Pictures) -> float:
    """RMSE, at the patient plane, of the fitted against the noiseless corners."""
    squares = []
    for name, exact in given.exact.items():
        view = given.corners[name][1]
        shares = silhouette_shares(torso, view, torso.rest_pose)
        seen = state_features(torso, view, torso.rest_pose, shares).corners
        squares.append(np.sum((seen - exact) ** 2, -1) / view.magnification**2)
    return float(np.sqrt(np.mean(squares)))


def fit_subject(truth: Truth, scenario: str, number: int) -> dict[str, Any]:
    """Fit one subject; the record has "failed" where there is no fit."""
    given = pictures_of(truth, scenario, number)
    template = template_torso(truth.height_cm)
    began, worked = time.perf_counter(), time.process_time()
    try:
        shaped = personalise(
            template,
            given.corners,
            pedicles={name: PediclePoints(*points) for name, points in given.pedicles.items()},
            geometry="known" if given.known else "estimated",
            finer=lambda: template_torso(truth.height_cm, "fine"),
        )
    except SpinestiffError as error:
        return {"subject": truth.name, "failed": str(error)}
    seconds, cpu_seconds = time.perf_counter() - began, time.process_time() - worked
    record = errors_of(truth, *rest_vertebrae(shaped.torso), rigid=not given.known)
    squares = [shaped.rmse_mm[name] ** 2 * len(corners) for name, (corners, _) in given.corners.items()]
    count = sum(len(corners) for corners, _ in given.corners.values())
    record["corner_rmse_mm"] = [float(np.sqrt(sum(squares) / count))]
    record["corner_sd_mm"] = [shaped.corner_sd_mm]
    if given.known:
        record["exact_corner_rmse_mm"] = [exact_rmse(shaped.torso, given)]
    return {"subject": truth.name, "seconds": seconds, "cpu_seconds": cpu_seconds, **record}


def baseline(truth: Truth, which: str, number: int) -> dict[str, Any]:
    """The height-scaled template at the subject's mean place, or turned too, so as to meet the noisy corners."""
    given = pictures_of(truth, "known", number)
    torso = template_torso(truth.height_cm)
    positions, rotations = rest_vertebrae(torso)
    boxes = torso.vertebra_boxes.reshape(17, 2, 2, 2, 3)
    middle = positions.mean(0)

    def moved(x: Floats) -> Truth:
        turn = exp_so3(x[3:])
        places = middle + x[:3] + (positions - middle) @ turn.T
        return Truth("", 0.0, places, turn @ rotations, boxes, truth.pedicles)

    def residual(x: Floats) -> Floats:
        body = moved(np.concatenate([x, np.zeros(6 - len(x))]))
        gaps = []
        for name, (corners, view) in given.corners.items():
            gaps.append((projected(body, view, name == "lateral") - corners.corners) / view.magnification)
        return np.concatenate([gap.ravel() for gap in gaps])

    start = np.zeros(3 if which == "template" else 6)
    best = least_squares(residual, start, x_scale=np.array([10.0, 10.0, 10.0, 0.1, 0.1, 0.1])[: len(start)]).x
    body = moved(np.concatenate([best, np.zeros(6 - len(best))]))
    record = errors_of(truth, body.positions, body.rotations, rigid=False)
    record["corner_rmse_mm"] = [float(np.sqrt(2.0 * np.mean(residual(best) ** 2)))]
    return {"subject": truth.name, **record}


def summary(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Counts, and median and 95th percentile over all subjects (and vertebrae) of each error."""
    done = [row for row in rows if "failed" not in row]
    result: dict[str, Any] = {"subjects": len(rows), "failures": len(rows) - len(done)}
    keys = dict.fromkeys(key for row in done for key, value in row.items() if isinstance(value, list))
    for key in keys:
        values = np.concatenate([row[key] for row in done])
        result[key] = {"median": round(float(np.median(values)), 3), "p95": round(float(np.percentile(values, 95)), 3)}
    for key in ("seconds", "cpu_seconds"):
        spent = [row[key] for row in done if key in row]
        if spent:
            result[key] = {"median": round(float(np.median(spent)), 2), "largest": round(max(spent), 2)}
    failed = {row["subject"]: row["failed"] for row in rows if "failed" in row}
    return {**result, "failed": failed} if failed else result


def cohort(table: Path, limit: int | None) -> tuple[list[Truth], list[Truth], dict[str, str]]:
    """Spines, synthetic curves, and by name why a spine of the table is none."""
    offsets = pedicle_offsets(table)
    with table.open(newline="", encoding="utf-8-sig") as file:
        ids = list(dict.fromkeys(row["id"] for row in csv.DictReader(file)))
    subjects, skipped = [], {}
    for number, spine in enumerate(ids[:limit]):
        try:
            subjects.append(ct_subject(table, spine, offsets, number))
        except SpinestiffError as error:
            skipped[spine] = str(error).removeprefix(f"{table}: ")
    curves = []
    angles = (10.0, -15.0, 20.0, -25.0, 30.0, -35.0, 40.0, -45.0)
    kinds = tuple(CURVES) * 2
    for number, (angle, curve) in enumerate(list(zip(angles, kinds))[: None if limit is None else max(limit // 4, 1)]):
        curves.append(scoliosis_subject(angle, curve, offsets, number))
    return subjects, curves, skipped


def read_log(path: Path | None) -> dict[tuple[str, str], dict[str, Any]]:
    """Records of an earlier run by scenario and subject."""
    if path is None:
        return {}
    prepare(path)
    return {(row.pop("scenario"), row["subject"]): row for row in begun(path)}


def _task(task: tuple[str, Truth, int]) -> dict[str, Any]:
    what, truth, number = task
    return baseline(truth, what, number) if what in BASELINES else fit_subject(truth, what, number)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--spines", type=Path, required=True)
    parser.add_argument("--radiographs", type=Path, help="folder of annotated radiographs, for the scenario fresh")
    parser.add_argument("--json", action="store_true", help="print the summary of the first scenario as JSON")
    parser.add_argument("--write", action="store_true", help="store the result in benchmarks/results/")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--subjects", type=int, help="only the first so many spines of the table")
    parser.add_argument("--scenario", nargs="+", choices=(*SCENARIOS, *BASELINES))
    parser.add_argument("--all", action="store_true", help="every subject in every scenario, not only in known")
    parser.add_argument("--log", type=Path, help="a line a fit; a run that was stopped goes on where it was")
    arguments = parser.parse_args()
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    scenarios = arguments.scenario or [
        name for name in (*SCENARIOS, *BASELINES) if name != "fresh" or arguments.radiographs
    ]
    if "fresh" in scenarios and arguments.radiographs is None:
        parser.error("the scenario fresh needs --radiographs")
    spines, curves, skipped = cohort(arguments.spines, arguments.subjects)
    synthetic = {truth.name for truth in curves}
    fresh: list[Truth] = []
    if "fresh" in scenarios:
        fresh, left_out = fresh_cohort(arguments.radiographs, pedicle_offsets(arguments.spines))
        skipped = {**skipped, **left_out}
    results: dict[str, Any] = {}
    known = read_log(arguments.log)
    with ProcessPoolExecutor(arguments.jobs) as pool:
        for scenario in scenarios:
            step = 1 if arguments.all else EVERY.get(scenario, 1)
            drawn = fresh if scenario == "fresh" else [*spines, *curves]
            tasks = [(scenario, truth, number) for number, truth in enumerate(drawn)][::step]
            todo = [task for task in tasks if (scenario, task[1].name) not in known]
            for row in pool.map(_task, todo) if arguments.jobs > 1 else map(_task, todo):
                known[scenario, row["subject"]] = row
                if arguments.log:
                    with arguments.log.open("a", encoding="utf-8") as log:
                        print(json.dumps({"scenario": scenario, **row}), file=log)
            rows = [known[scenario, truth.name] for _, truth, _ in tasks]
            curved = [row for row in rows if row["subject"] in synthetic]
            results[scenario] = summary([row for row in rows if row["subject"] not in synthetic])
            if curved:
                results[scenario]["curves"] = summary(curved)
            if not arguments.json:
                print(scenario, json.dumps(results[scenario]), flush=True)
    if arguments.json:
        print(json.dumps({**results[scenarios[0]], "skipped": skipped, "scenarios": results}, indent=1))
    else:
        for spine, why in skipped.items():
            print(f"skipped {spine}: {why}")
    if arguments.write:
        path = Path(__file__).parent / "results" / "personalisation.json"
        stored = {"date": datetime.datetime.now(datetime.UTC).date().isoformat(), "skipped": skipped, **results}
        path.write_text(json.dumps(stored, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
