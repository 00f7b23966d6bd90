"""Density that varies inside a body and rides on it: value noise in three dimensions, where each ray has its middle.

A ray takes the pattern at the middle of its way through the body, not its mean along that way: what a ray sees of fine
grain is then as strong as the body's pattern, and ``Texture.amplitude`` is what the picture shows.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numba import njit

from spinestiff.arrays import Floats
from spinestiff.imaging.projection import XRayView
from spinestiff.imaging.synthetic.path_length import Shadow, offsets


@dataclass(frozen=True)
class Texture:
    """Density that varies inside a body and rides on it: trabecular clumps, bowel, muscle.

    Attributes
    ----------
    amplitude : standard deviation is about a third of it; relative change of the path length.
    grain : mm, coarsest grain; three octaves down to a quarter of it.
    seed : which pattern.
    position, rotation : (3,) mm and (3, 3), world_from_body.
    """

    amplitude: float
    grain: float
    seed: int
    position: Floats = field(default_factory=lambda: np.zeros(3))
    rotation: Floats = field(default_factory=lambda: np.eye(3))


def pattern(shadow: Shadow, texture: Texture, view: XRayView) -> Floats:
    """The texture as each ray of a shadow sees it, (h, w), about 0 and within -1 to 1."""
    u, v = offsets(view, shadow.rows, shadow.columns)
    axes = texture.rotation.T @ np.column_stack([view.detector_axes.T, view.normal])
    start = texture.rotation.T @ (view.source - texture.position)
    values = np.zeros_like(shadow.length)
    _sample_noise(u, v, shadow.length, shadow.middle, view.source_to_detector, start, axes, texture.grain,
                  np.uint64(texture.seed), values)  # fmt: skip
    return values


@njit(cache=True, nogil=True)
def _lattice(i, j, k, seed):  # type: ignore[no-untyped-def]
    """A number in [-1, 1) that depends on a lattice point only (splitmix64)."""
    h = np.uint64(i) * np.uint64(0x9E3779B97F4A7C15) ^ np.uint64(j) * np.uint64(0xC2B2AE3D27D4EB4F)
    h ^= np.uint64(k) * np.uint64(0x165667B19E3779F9) ^ seed * np.uint64(0xD6E8FEB86659FD93)
    h = (h ^ (h >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    h = (h ^ (h >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    h ^= h >> np.uint64(31)
    return float(h >> np.uint64(11)) / 4503599627370496.0 - 1.0


@njit(cache=True, nogil=True)
def _noise(x, y, z, seed):  # type: ignore[no-untyped-def]
    """Smooth noise with one random value a unit cell."""
    i, j, k = np.floor(x), np.floor(y), np.floor(z)
    fx, fy, fz = x - i, y - j, z - k
    sx, sy, sz = fx * fx * (3.0 - 2.0 * fx), fy * fy * (3.0 - 2.0 * fy), fz * fz * (3.0 - 2.0 * fz)
    value = 0.0
    for a in range(2):
        wa = sx if a else 1.0 - sx
        for b in range(2):
            wb = sy if b else 1.0 - sy
            for c in range(2):
                wc = sz if c else 1.0 - sz
                value += wa * wb * wc * _lattice(np.int64(i) + a, np.int64(j) + b, np.int64(k) + c, seed)
    return value


@njit(cache=True, nogil=True)
def _sample_noise(u, v, length, middle, distance, start, axes, grain, seed, values):  # type: ignore[no-untyped-def]
    """Three octaves of noise where each ray's inside has its middle, in the body's frame."""
    for row in range(length.shape[0]):
        for column in range(length.shape[1]):
            if abs(length[row, column]) < 1e-2:
                continue
            z = middle[row, column]
            x, y = u[column] * z / distance, v[row] * z / distance
            px = start[0] + axes[0, 0] * x + axes[0, 1] * y + axes[0, 2] * z
            py = start[1] + axes[1, 0] * x + axes[1, 1] * y + axes[1, 2] * z
            pz = start[2] + axes[2, 0] * x + axes[2, 1] * y + axes[2, 2] * z
            scale, weight, value = 1.0 / grain, 0.5, 0.0
            for octave in range(3):
                value += weight * _noise(px * scale, py * scale, pz * scale, seed + np.uint64(octave))
                scale *= 2.0
                weight *= 0.7
            values[row, column] = value
