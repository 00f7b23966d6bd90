"""What corner noise does to the largest Cobb angle of a spine: how far it reads too large, and from which vertebrae.

The template's seventeen vertebrae stand straight, or in a curve of 20 or 40 degrees of each of four kinds
(``study.synthetic.spines.curved_spine``), seen exactly from the front and without magnification. Each corner gets
Gaussian noise of the default standard deviation, 2 % of the median width, in both coordinates, ``--draws`` times,
seeded. Counted of what ``read_cobb`` makes of the draws, by both definitions: mean and 95th percentile of the largest
angle beside what is read without noise, how often the end vertebrae are those, and half the 95 % interval that is
stated. ``docs/cobb.md`` quotes it.

    python benchmarks/cobb_noise.py [--draws 600] [--seed 0] [--write]
    python benchmarks/cobb_noise.py --json
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from kept_rows import measure_once

from spinestiff.anatomy.names import VERTEBRAE
from spinestiff.anatomy.template import template_torso
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.curves.cobb import DEFINITIONS, CobbReading, Curve, Definition, read_cobb
from spinestiff.curves.corner_files import ImageCorners
from spinestiff.study.synthetic.spines import CURVES, curved_spine

RESULTS = Path(__file__).parent / "results" / "cobb_noise.json"
ANGLES_DEG = (20.0, 40.0)
PX_MM = 0.2
MARGIN_MM = 150.0


def seen_from_the_front(torso: TorsoModel, cobb_deg: float, curve: str) -> ImageCorners:
    """Corners of the bent spine, pixels; the patient's left is the image's right."""
    places, turns = curved_spine(torso, cobb_deg, curve)
    corners = places[:, None, :] + np.einsum("vij,vcj->vci", turns, torso.vertebra_boxes)
    # Superior and inferior, left and right; the middle between front and back.
    (upper_left, upper_right), (lower_left, lower_right) = (
        side.transpose(1, 0, 2) for side in corners.reshape(-1, 2, 2, 2, 3).mean(axis=3)[..., :2].transpose(1, 0, 2, 3)
    )
    at = np.stack([upper_right, upper_left, lower_left, lower_right], axis=1)
    top, least = at[..., 1].max(), at[..., 0].min()
    pixels = np.stack([at[..., 0] - least + MARGIN_MM, top - at[..., 1] + MARGIN_MM], axis=-1) / PX_MM
    return ImageCorners(f"{curve}, {cobb_deg:g} degrees", VERTEBRAE, pixels)


def largest(reading: CobbReading) -> Curve:
    """The largest curve of an image that is read."""
    assert reading.largest is not None, reading.warnings
    return reading.largest


def of_image(image: ImageCorners, definition: Definition, draws: int, rng: np.random.Generator) -> dict[str, Any]:
    """What is read with noise, beside what is read without."""
    exact = read_cobb(image, definition)
    truth = largest(exact)
    angles, kept, repaired = [], 0, 0
    for _ in range(draws):
        noisy = image.corners + rng.normal(0.0, exact.noise, image.corners.shape)
        reading = read_cobb(replace(image, corners=noisy), definition)
        found = largest(reading)
        angles.append(abs(found.angle.degrees))
        kept += (found.angle.upper, found.angle.lower) == (truth.angle.upper, truth.angle.lower)
        repaired += reading.status == "repaired"
    return {
        "without_noise_deg": round(abs(truth.angle.degrees), 2),
        "mean_deg": round(float(np.mean(angles)), 2),
        "below_95_deg": round(float(np.quantile(angles, 0.95)), 2),
        "same_end_vertebrae": round(kept / draws, 3),
        "stated_half_width_deg": round(truth.half_width_deg, 2),
        "repaired": repaired,
    }


def measured(draws: int, seed: int) -> dict[str, Any]:
    """By definition: the straight spine, and all curves."""
    torso = template_torso(157.0, mesh="coarse")
    found: dict[str, Any] = {}
    for definition in DEFINITIONS:
        rng = np.random.default_rng(seed)
        straight = of_image(seen_from_the_front(torso, 0.0, "thoracic"), definition, draws, rng)
        curved = {
            f"{curve}, {angle:g} degrees": of_image(seen_from_the_front(torso, angle, curve), definition, draws, rng)
            for angle in ANGLES_DEG
            for curve in CURVES
        }
        found[definition] = {"straight": straight, **curved}
    return found


if __name__ == "__main__":
    measure_once(__doc__, RESULTS, measured, draws=600, seed=0)
