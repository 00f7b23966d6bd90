"""Pictures of a bench phantom by mechanics and optics of their own: a planar chain of hinges before a camera."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
from scipy.optimize import minimize

from spinestiff.curves.corner_files import ImageCorners
from spinestiff.formats import parse_json
from spinestiff.subject.phantom_record import PhantomRecord
from spinestiff.subject.record_reading import parse_record

PAGE = Path(__file__).parents[1] / "docs" / "bench-phantom.md"


def documented(**changes: object) -> PhantomRecord:
    """The record that the page shows, with other values where given."""
    return parse_record(documented_text(**changes), PAGE.name, PhantomRecord)


def documented_text(**changes: object) -> str:
    """The page's ``phantom.json`` with other values where given."""
    (text,) = re.findall(r"^```json\n(.*?)^```$", PAGE.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
    return json.dumps({**parse_json(text, PAGE.name), **changes})


def chain(record: PhantomRecord, stiffness: np.ndarray, frame: int, gauge: float = 1.0) -> np.ndarray:
    """(n, 4, 2) mm, marks of the blocks as they lie under a frame's force, in the order of ``ImageCorners``.

    Parameters
    ----------
    stiffness : (n,) N mm/rad, top to bottom. gauge : what it reads over what it pulls with.
    """
    asked, n = record.frames[frame], len(record.levels)
    height, gap = record.block_mm[1], record.gap_mm
    force = 0.0 if asked.side is None else asked.force_n / gauge * (1.0 if asked.side == "right" else -1.0)

    def places(tilt: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        # Hinges in the middle of the gaps; tilt > 0 leans to the phantom's left (+x). From the base upwards.
        hinge, centres = np.array([0.0, 0.5 * gap]), np.zeros((n, 2))
        up = np.stack([np.sin(tilt), np.cos(tilt)], 1)
        for i in reversed(range(n)):
            centres[i] = hinge + 0.5 * (gap + height) * up[i]
            hinge = hinge + (gap + height) * up[i]
        return centres, up

    def pushed(tilt: np.ndarray) -> float:
        if asked.block is None:
            return 0.0
        centres, up = places(tilt)
        i = record.levels.index(asked.block)
        aside = -np.sign(force) * asked.aside_mm
        return float(centres[i, 0] + asked.height_mm * up[i, 0] + aside * up[i, 1])

    def energy(tilt: np.ndarray) -> float:
        turned = tilt - np.append(tilt[1:], 0.0)
        return float(0.5 * stiffness @ turned**2 - force * pushed(tilt)) / 1e3

    tilt = minimize(energy, np.zeros(n), method="BFGS", options={"gtol": 1e-9}).x if force else np.zeros(n)
    centres, up = places(tilt)
    left = np.stack([up[:, 1], -up[:, 0]], 1)
    w, h = (0.5 * size for size in record.marks_mm)
    # The phantom's right is on the left of the picture.
    order = ((-w, h), (w, h), (w, -h), (-w, -h))
    return np.stack([centres + a * left + b * up for a, b in order], 1)


def pictures(
    record: PhantomRecord, stiffness: np.ndarray, seed: int = 0, sd_mm: float = 0.1, gauge: float = 1.0
) -> tuple[ImageCorners, ...]:
    """Corners of all frames with noise of marking; the camera is a little off the column's middle."""
    random, found = np.random.default_rng(seed), []
    columns, rows = record.picture.size_px
    middle = 0.5 * (record.gap_mm + len(record.levels) * (record.gap_mm + record.block_mm[1]))
    for i, frame in enumerate(record.frames):
        marks = chain(record, stiffness, i, gauge) + random.normal(0.0, sd_mm, (len(record.levels), 4, 2))
        x, y = marks[..., 0] + 3.0, middle - marks[..., 1] - 2.0
        seen = np.stack([x, y], -1) * record.picture.source_detector_mm / record.picture.source_marks_mm
        pixels = seen / record.picture.pixel_mm + 0.5 * (np.array([columns, rows]) - 1.0)
        found.append(ImageCorners(frame.image, record.levels, pixels))
    return tuple(found)
