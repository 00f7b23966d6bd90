"""Drawn radiographs of spines whose corners are known exactly, for tests that need no torso."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from spinestiff.anatomy.names import VERTEBRAE
from spinestiff.anatomy.template.sizes import VERTEBRA_SIZES

SCALE = 4
# How hollow endplates and walls ("first" side, other side) are midway between two corners, mm.
ENDPLATE = 0.6
WALLS = {"frontal": (0.9, 0.9), "lateral": (1.5, 2.9)}


@dataclass(frozen=True)
class Phantom:
    """A drawn spine.

    Attributes
    ----------
    pixels : (H, W) float32, bone bright.
    quads : (17, 4, 2) column and row, in the corner order of the annotation.
    """

    pixels: np.ndarray
    quads: np.ndarray

    def named(self, *levels: str) -> dict[str, list]:
        return {name: self.quads[VERTEBRAE.index(name)].round(2).tolist() for name in levels or VERTEBRAE}

    def clicks(self, *levels: str) -> np.ndarray:
        return np.array([self.quads[VERTEBRAE.index(name)].mean(axis=0) for name in levels])


def phantom(
    shape: tuple[int, int] = (640, 448),
    mm: float = 0.72,
    bend: float = 16.0,
    kind: str = "frontal",
    seed: int = 0,
    noise: float = 0.03,
    size: float = 1.0,
) -> Phantom:
    """A spine from the template's sizes along an S of amplitude ``bend`` mm, with soft tissue, ribs and noise.

    The "first" side (the patient's left, in front in a lateral view) is on the right of the picture. ``size`` widens
    the bodies against the template.
    """
    rng = np.random.default_rng(seed)
    edges = np.concatenate([[0.0], np.cumsum(VERTEBRA_SIZES[:, 4:6].ravel())[:-1]])
    widths = 0.5 * size * VERTEBRA_SIZES[:, [0, 2] if kind == "frontal" else [1, 3]].ravel()
    length = edges[-1]
    aside = bend * np.sin(2.0 * np.pi * edges / length)
    # Endplates stand across the curve, each with a little tilt of its own.
    tilt = np.arctan(np.gradient(aside, edges)) + np.radians(2.0) * rng.standard_normal(len(edges))
    across = np.stack([np.cos(tilt), -np.sin(tilt)], axis=1)
    middle = np.stack([aside, edges - 0.5 * length], axis=1)
    ends = np.stack([middle + widths[:, None] * across, middle - widths[:, None] * across], axis=1)
    rows, columns = shape
    ends = ends / mm + [0.5 * columns, 0.5 * rows]
    quads = np.stack([ends[0::2, 0], ends[0::2, 1], ends[1::2, 1], ends[1::2, 0]], axis=1)
    picture = np.zeros(shape, np.float32)
    y, x = np.mgrid[:rows, :columns]
    picture += 0.5 * np.exp(-(((x - 0.5 * columns) / (0.33 * columns)) ** 2)).astype(np.float32) + 0.15 * (y / rows)
    ribs = np.zeros(shape, np.float32)
    for k in range(11):
        for side in (-1, 1):
            start = quads[k].mean(axis=0)
            bow = np.array([start + [side * 9 * t, 2.0 * t - 0.06 * t * t] for t in range(16)])
            cv2.polylines(ribs, [np.round(bow).astype(np.int32)], False, 0.22, 4, cv2.LINE_AA)
    bodies = np.zeros(shape, np.float32)
    for quad in quads:
        shifted = np.round((outline(quad, kind, mm) + 0.5) * 2**SCALE - 2 ** (SCALE - 1)).astype(np.int32)
        body, wall = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
        cv2.fillPoly(body, [shifted], 0.35, cv2.LINE_AA, SCALE)
        cv2.polylines(wall, [shifted], True, 0.12, 1, cv2.LINE_AA, SCALE)
        bodies += body + wall
    whole = cv2.GaussianBlur(picture + ribs + bodies, (0, 0), 0.7)
    whole += noise * cv2.GaussianBlur(rng.standard_normal(shape).astype(np.float32), (0, 0), 0.6)
    return Phantom(whole, quads)


def outline(quad: np.ndarray, kind: str, mm: float) -> np.ndarray:
    """(40, 2) pixels around a vertebral body whose sides are hollow between its corners (4, 2)."""
    share = np.linspace(0.0, 1.0, 10, endpoint=False)[:, None]
    sides = []
    for i, depth in enumerate((ENDPLATE, WALLS[kind][1], ENDPLATE, WALLS[kind][0])):
        start, end = quad[i], quad[(i + 1) % 4]
        along = (end - start) / np.linalg.norm(end - start)
        inward = np.array([along[1], -along[0]])
        inward *= np.sign((quad.mean(axis=0) - start) @ inward)
        sides.append(start + share * (end - start) + 4.0 * share * (1.0 - share) * depth / mm * inward)
    return np.concatenate(sides)


def sixteen_bit(pixels: np.ndarray) -> np.ndarray:
    """As DICOM takes it."""
    return np.clip(np.rint(20000.0 * pixels + 5000.0), 0, 65535).astype(np.uint16)
