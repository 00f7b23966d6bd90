"""Draws docs/images/synthetic_radiographs.png: a rendered girl at rest from the front and the side, and pushed.

Run: python tools/draw_synthetic_radiographs.py [FILE]
"""

from __future__ import annotations

import sys
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from spinestiff.anatomy.stiffness import stiffness_ratios
from spinestiff.anatomy.template import template_torso
from spinestiff.imaging.projection import frontal_view, lateral_view
from spinestiff.imaging.synthetic.acquisition import LATERAL, Acquisition, Gauge, acquire
from spinestiff.imaging.synthetic.collimation import Collimation
from spinestiff.mechanics.equilibrium import EquilibriumProblem
from spinestiff.mechanics.loads import rib_push
from spinestiff.mechanics.supports import three_point_supports
from spinestiff.personalise.placing import place_vertebrae
from spinestiff.study.synthetic.spines import curved_spine

BLADES = Collimation(top=45.0, bottom=20.0, left=25.0, right=5.0)
HEIGHT = 700


def shown(image: NDArray[np.uint16], densest: float) -> NDArray[np.uint8]:
    """8 bits, windowed to what lies behind the body."""
    body = image[(image > 9000) & (image < densest)]
    black, white = np.percentile(body, [3.0, 99.7])
    eight = np.clip(255.0 * (image - black) / (white - black), 0, 255).astype(np.uint8)
    return np.asarray(cv2.resize(eight, (HEIGHT, HEIGHT), interpolation=cv2.INTER_AREA), dtype=np.uint8)


def main(path: Path) -> None:
    torso = template_torso(157.0)
    torso = place_vertebrae(torso, *curved_spine(torso, 35.0, "thoracic"))
    rest = torso.rest_pose
    spine = rest.bone_positions[torso.vertebra_bones]
    centre = (0.0, 0.5 * (spine[0, 1] + spine[-1, 1]), 0.0)
    load = rib_push(torso, "left", 8.5, 60.0)
    ratios = stiffness_ratios({"lateral_bending": 0.1, "tissue": 0.02})
    pushed = EquilibriumProblem(torso, three_point_supports(torso, "left")).solve(load, ratios, rest).require().state
    gauge = Gauge(load.points, load.forces)
    person, collimated = 2, Acquisition(collimation=BLADES)
    frontal, lateral = frontal_view(centre=centre), lateral_view(centre=centre)
    (front,) = acquire(torso, [rest], frontal, person=person, seed=1)
    (side,) = acquire(torso, [rest], lateral, Acquisition(exposure=LATERAL), person=person, seed=2)
    (under_load,) = acquire(torso, [pushed], frontal, collimated, person=person, seed=3, gauge=gauge)
    pictures = [shown(front, 44000), shown(side, 58000), shown(under_load, 44000)]
    edge = np.full((HEIGHT, 8), 255, np.uint8)
    row = np.hstack([part for picture in pictures for part in (picture, edge)][:-1])
    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path), row, [cv2.IMWRITE_PNG_COMPRESSION, 9])


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "docs/images/synthetic_radiographs.png"))
