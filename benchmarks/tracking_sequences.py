"""Sequences of radiographs in which the place of every vertebra corner is known, for benchmarks/tracking.py.

``modelled``: a torso of known stiffness under a growing push, radiographed four times a second. What is true are the
projected corners of the vertebrae's silhouettes at rest, points of the bone, as a fit compares them.

``warped``: a real radiograph moved by a smooth field in which each vertebra moves as a body.
"""

from __future__ import annotations

import csv
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Literal

import cv2
import numpy as np
from scipy.interpolate import RBFInterpolator

from spinestiff.anatomy.names import VERTEBRAE
from spinestiff.anatomy.rotation import exp_so3
from spinestiff.anatomy.state import TorsoState
from spinestiff.anatomy.stiffness import stiffness_ratios
from spinestiff.anatomy.template import template_torso
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.arrays import Floats
from spinestiff.curves.tilts import cobb_angle, tilts
from spinestiff.imaging.features import VertebraCorners, box_sizes, silhouette_shares, state_features
from spinestiff.imaging.projection import frontal_view
from spinestiff.imaging.radiograph import Radiograph
from spinestiff.imaging.synthetic.acquisition import Acquisition, Gauge, acquire
from spinestiff.imaging.synthetic.collimation import Collimation
from spinestiff.imaging.synthetic.detector import Exposure
from spinestiff.mechanics.equilibrium import EquilibriumProblem
from spinestiff.mechanics.loads import rib_push
from spinestiff.mechanics.supports import three_point_supports
from spinestiff.personalise.placing import place_vertebrae
from spinestiff.study.synthetic.spines import curved_spine

FRAME_TIME_S = 0.25
DETECTOR_PIXEL_MM = 0.417
SHAPE = (1024, 512)  # collimated sideways, as a low-dose sequence is
HEIGHT_CM = 157.0
MARGIN_PX = 6.0  # of a corner that counts as seen


@dataclass(frozen=True)
class Moving:
    """A sequence and its truth.

    Attributes
    ----------
    name : of the case.
    frames : F radiographs.
    vertebrae : names of those seen in the first frame.
    truth : (F, Nv, 4, 2) pixels.
    visible : (F, Nv, 4) bool, whether the truth lies in the open field.
    cobb_change_deg : from first to last frame.
    """

    name: str
    frames: tuple[Radiograph, ...]
    vertebrae: tuple[str, ...]
    truth: Floats
    visible: np.ndarray
    cobb_change_deg: float

    @property
    def first(self) -> VertebraCorners:
        """Annotation of the first frame, without error: what is measured is tracking."""
        return VertebraCorners(self.vertebrae, self.frames[0].view.from_pixels(self.truth[0]))

    @property
    def pixel_mm(self) -> float:
        """A pixel's side at the patient plane."""
        view = self.frames[0].view
        return float((view.pixel_spacing / view.magnification).mean())


@dataclass(frozen=True)
class Case:
    """A push, radiographed ``frames`` times from rest to its force.

    Attributes
    ----------
    yaw_deg : by how much the patient turns in the supports until the last frame, besides what the model does.
    top_mm, covered_mm : what blades hide, mm at the detector: at the head's end in all frames, at the feet's end in the
        second half of them.
    dose : relative to an eighth of a standard exposure.
    """

    name: str
    seed: int
    curve: str
    cobb_deg: float
    ratios: tuple[float, float]
    frames: int
    force_n: float = 60.0
    level: float = 8.0
    yaw_deg: float = 0.0
    top_mm: float = 0.0
    covered_mm: float = 0.0
    dose: float = 1.0


# Four frames a second, so 40 are a ramp of ten seconds; eight in all are single exposures between steps of force.
CASES = (
    Case("thoracic, stiff", 1, "thoracic", 30.0, (0.3, 0.1), 12),
    Case("thoracic, usual", 2, "thoracic", 25.0, (0.06, 0.03), 20, yaw_deg=1.0),
    Case("thoracic, soft", 3, "thoracic", 40.0, (0.05, 0.02), 40),
    Case("lumbar, soft", 4, "lumbar", 30.0, (0.06, 0.02), 20, level=10.0, yaw_deg=-1.0, top_mm=60.0),
    Case("double, usual", 5, "double", 30.0, (0.07, 0.03), 20, top_mm=40.0),
    Case("thoracic, in steps", 6, "thoracic", 35.0, (0.06, 0.02), 8, yaw_deg=1.0),
    Case("double, in steps", 7, "double", 35.0, (0.05, 0.02), 8, yaw_deg=-1.0),
    Case("thoracic, a sixth of the dose", 8, "thoracic", 30.0, (0.06, 0.025), 20, dose=1.0 / 6.0),
    Case("thoracic, turned", 9, "thoracic", 30.0, (0.07, 0.03), 12, yaw_deg=4.0),
    Case("lumbar, partly covered", 10, "lumbar", 25.0, (0.06, 0.03), 12, level=10.0, covered_mm=110.0),
    Case("thoracic, partly covered", 11, "thoracic", 30.0, (0.06, 0.03), 8, covered_mm=90.0),
    Case("lumbar, turned", 12, "lumbar", 30.0, (0.07, 0.03), 8, level=10.0, yaw_deg=-4.0),
)


def modelled(case: Case) -> Moving:
    """Radiographs of a torso pushed from rest to the case's force: ribs in front, breathing, exposure drift, noise."""
    torso = _torso(case.cobb_deg, case.curve)
    spine = torso.rest_pose.bone_positions[torso.vertebra_bones]
    centre = np.array([0.0, 0.5 * (spine[0, 1] + spine[-1, 1]), 0.0])
    view = frontal_view(shape=SHAPE, pixel=DETECTOR_PIXEL_MM, centre=centre)
    shares = silhouette_shares(torso, view, torso.rest_pose)

    def seen(state: TorsoState) -> Floats:
        return state_features(torso, view, state, shares).corners

    rest_tilts = tilts(VERTEBRAE, seen(torso.rest_pose), view)
    side: Literal["left", "right"] = "left" if cobb_angle(rest_tilts).degrees > 0.0 else "right"
    problem = EquilibriumProblem(torso, three_point_supports(torso, side))
    ratios = stiffness_ratios({"lateral_bending": case.ratios[0], "tissue": case.ratios[1]})
    state, states = torso.rest_pose, [torso.rest_pose]
    for share in np.linspace(0.0, 1.0, case.frames)[1:]:
        state = problem.solve(rib_push(torso, side, case.level, case.force_n * share), ratios, state).require().state
        states.append(_turned(state, np.deg2rad(case.yaw_deg) * share))
    push = rib_push(torso, side, case.level, case.force_n)
    gauge = Gauge(push.points, push.forces)
    covered = case.frames // 2 if case.covered_mm else case.frames
    blades = [Collimation(top=case.top_mm), Collimation(top=case.top_mm, bottom=case.covered_mm)]
    pictures: list[np.ndarray] = []
    for collimation, part in zip(blades, (states[:covered], states[covered:])):
        exposure = Exposure(photons=case.dose * Exposure().photons)
        acquisition = Acquisition(exposure=exposure, frame_time=FRAME_TIME_S, collimation=collimation)
        pictures += acquire(torso, part, view, acquisition, person=case.seed, seed=case.seed, gauge=gauge)
    truth = np.stack([view.pixels(seen(state)) for state in states])
    fields = [blades[k >= covered].field(view) for k in range(case.frames)]
    low, high = (np.stack([field[i] for field in fields])[:, None, None] for i in (0, 1))
    visible = ((truth > low + MARGIN_PX) & (truth < high - MARGIN_PX)).all(-1)
    annotated = visible[0].all(-1)
    pushed = cobb_angle(tilts(VERTEBRAE, seen(states[-1]), view)).degrees
    return Moving(
        case.name,
        tuple(Radiograph(np.asarray(picture, dtype=np.float32), view) for picture in pictures),
        tuple(np.array(VERTEBRAE)[annotated]),
        truth[:, annotated],
        visible[:, annotated],
        abs(pushed - cobb_angle(rest_tilts).degrees),
    )


@lru_cache(maxsize=4)
def _torso(cobb_deg: float, curve: str) -> TorsoModel:
    template = template_torso(HEIGHT_CM, "coarse")
    return place_vertebrae(template, *curved_spine(template, cobb_deg, curve))


def _turned(state: TorsoState, angle: float) -> TorsoState:
    """The whole patient turned about the vertical through the origin."""
    turn = exp_so3(np.array([0.0, angle, 0.0]))
    return TorsoState(state.bone_positions @ turn.T, turn @ state.bone_rotations, state.tissue_positions @ turn.T)


# Real radiographs

WARP_FRAMES = 5
WARP_MM = 25.0  # largest sideways motion
NOISE_GREYS = 3.0
MAGNIFICATION = frontal_view().magnification


def warped(folder: Path) -> Iterator[Moving]:
    """The radiographs of ``folder`` (landmarks.csv, images.csv and images/), each moved in steps.

    Nothing says how large a pixel is there: the mean width of the vertebrae is taken to be the template's.
    """
    width_mm = float(box_sizes(template_torso(HEIGHT_CM, "coarse"))[:, 0].mean())
    landmarks = np.loadtxt(folder / "landmarks.csv", delimiter=",")
    with (folder / "images.csv").open(newline="", encoding="utf-8") as lines:
        rows = [row for row in csv.DictReader(lines) if row["file"]]
    for number, row in enumerate(rows, 1):
        image = cv2.imread(str(folder / "images" / row["file"]), cv2.IMREAD_GRAYSCALE)
        size = np.array([float(row["width_px"]), float(row["height_px"])])
        quads = (landmarks[int(row["row"])].reshape(2, 68).T * size).reshape(17, 4, 2)
        # From top-left, top-right, bottom-left, bottom-right as seen: the patient's left is on the right.
        quads = quads[:, [1, 0, 2, 3]]
        ordered = (quads[:, 0, 0] > quads[:, 1, 0]) & (quads[:, 3, 1] > quads[:, 0, 1])
        yield _warped(
            f"radiograph {number}", image.astype(np.float32), quads[ordered], ordered, width_mm, int(row["row"])
        )


def _warped(name: str, image: np.ndarray, quads: Floats, ordered: np.ndarray, width_mm: float, seed: int) -> Moving:
    random = np.random.default_rng(seed)
    spacing = width_mm / float(np.linalg.norm(quads[:, 0] - quads[:, 1], axis=-1).mean())
    view = frontal_view(shape=image.shape, pixel=spacing * MAGNIFICATION)
    centres = quads.mean(axis=1)
    low, high = centres[:, 1].min(), centres[:, 1].max()
    phase, waves = random.uniform(0.0, 0.4), random.uniform(0.8, 1.6)
    frames, truth = [], []
    for k in range(WARP_FRAMES):
        share = k / (WARP_FRAMES - 1)
        bow = share * WARP_MM / spacing
        height = (centres[:, 1] - low) / (high - low)
        angle = np.pi * (waves * height + phase)
        aside = bow * np.sin(angle)
        # A curve's vertebrae turn with its slope.
        turn = -bow * np.pi * waves / (high - low) * np.cos(angle)
        cosine, sine = np.cos(turn), np.sin(turn)
        rotation = np.stack([np.stack([cosine, -sine], -1), np.stack([sine, cosine], -1)], -2)
        moved = np.einsum("nij,nkj->nki", rotation, quads - centres[:, None]) + centres[:, None]
        moved[..., 0] += aside[:, None]
        moved[..., 1] += 0.15 * bow * (1.0 - 2.0 * height[:, None])
        truth.append(moved)
        frames.append(Radiograph(_exposed(_carried(image, quads, moved), random, first=k == 0), view))
    truth = np.stack(truth)
    visible = ((truth > MARGIN_PX) & (truth < np.array(image.shape[::-1]) - 1 - MARGIN_PX)).all(-1)
    return Moving(name, tuple(frames), tuple(np.array(VERTEBRAE)[ordered]), truth, visible, 0.0)


def _carried(image: np.ndarray, before: Floats, after: Floats) -> np.ndarray:
    """The picture with the corners ``before`` carried to ``after`` exactly, smoothly in between, its border at rest."""
    if np.array_equal(before, after):
        return image
    rows, columns = image.shape
    frame = np.array([[x, y] for x in np.linspace(0, columns - 1, 5) for y in np.linspace(0, rows - 1, 9)])
    edge = frame[(frame[:, 0] < 1) | (frame[:, 0] > columns - 2) | (frame[:, 1] < 1) | (frame[:, 1] > rows - 2)]
    knots = np.concatenate([_filled(after), edge])
    sources = np.concatenate([_filled(before), edge])
    spline = RBFInterpolator(knots, sources - knots, kernel="thin_plate_spline")
    # The spline is smooth between its knots: a grid of every fourth pixel holds it to a hundredth of a pixel.
    step = 4
    x, y = np.arange(0, columns + step, step, dtype=float), np.arange(0, rows + step, step, dtype=float)
    grid = np.stack(np.meshgrid(x, y), -1)
    shift = spline(grid.reshape(-1, 2)).reshape(grid.shape).astype(np.float32)
    at = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), -1).astype(np.float32)
    shift = cv2.remap(shift, at[..., 0] / step, at[..., 1] / step, cv2.INTER_LINEAR)
    return cv2.remap(image, at[..., 0] + shift[..., 0], at[..., 1] + shift[..., 1], cv2.INTER_CUBIC)


def _filled(quads: Floats) -> Floats:
    """(9 n, 2) corners (n, 4, 2), their sides' middles and centres: knots by which a spline turns each as a body."""
    steps = np.linspace(0.0, 1.0, 3)
    a, b = (grid.reshape(-1, 1) for grid in np.meshgrid(steps, steps))
    weights = np.hstack([(1 - a) * (1 - b), a * (1 - b), a * b, (1 - a) * b])
    return np.asarray(np.einsum("pk,nki->npi", weights, quads).reshape(-1, 2))


def _exposed(image: np.ndarray, random: np.random.Generator, first: bool) -> np.ndarray:
    """Another exposure of the same picture: contrast, brightness, noise that grows with brightness."""
    contrast, brightness = (1.0, 0.0) if first else (float(np.exp(random.normal(0.0, 0.15))), random.normal(0.0, 10.0))
    noise = random.standard_normal(image.shape) * NOISE_GREYS * np.sqrt(0.3 + np.clip(image, 0, 255) / 255.0)
    return np.asarray(image * contrast + brightness + noise, dtype=np.float32)


def resampled(moving: Moving, every: int) -> Moving:
    """Every ``every``-th frame."""
    chosen = slice(None, None, every)
    return replace(moving, frames=moving.frames[chosen], truth=moving.truth[chosen], visible=moving.visible[chosen])
