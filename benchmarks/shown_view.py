"""How often the view that a radiograph looks like is the one that it shows.

Synthetic radiographs of ``BODIES``, frontal and lateral, in three framings each: the trunk on a square detector, all
from neck to thigh on one twice as high, and the trunk between black shutters, which may cut it. The thresholds of
``imaging.shown_view`` were set with other subjects. ``--images``: a folder of real frontal radiographs (JPEG or PNG,
bone bright), no part of the project.

    python benchmarks/shown_view.py [--images FOLDER] [--write]
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np

from spinestiff.anatomy.template import template_torso
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.arrays import Floats
from spinestiff.files import read_json, write_json
from spinestiff.imaging.projection import frontal_view, lateral_view
from spinestiff.imaging.shown_view import shown_view
from spinestiff.imaging.synthetic.acquisition import LATERAL, Acquisition, acquire
from spinestiff.study.synthetic.recipe import Recipe
from spinestiff.study.synthetic.subject import subject_torso

RESULTS = Path(__file__).parent / "results" / "shown_view.json"
DETECTOR_MM = 427.0
STANDING_SD_MM = 8.0
SHUTTERS_MM = (20.0, 60.0)
CURVES = ("thoracic", "lumbar", "double", "thoracolumbar")
# Age, sex, height (cm), mass (kg), kyphosis and lordosis (degrees) of bodies without a curve.
BODIES = (
    (8, "male", 125, 24, 30, 40),
    (11, "female", 140, 50, 45, 55),
    (13, "female", 150, 35, 25, 40),
    (14, "male", 160, 75, 40, 45),
    (16, "male", 170, 50, 48, 58),
    (30, "female", 165, 95, 38, 45),
    (40, "male", 180, 110, 45, 50),
    (20, "male", 185, 62, 22, 36),
    (60, "female", 155, 60, 50, 40),
    (17, "female", 172, 55, 35, 60),
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--images", type=Path, help="folder of real frontal radiographs")
    parser.add_argument("--write", action="store_true", help="store it in benchmarks/results/")
    given = parser.parse_args()
    found: dict[str, Counter[str]] = {}
    for group, view, pixels in [*synthetic(), *real(given.images)]:
        seen = shown_view(pixels)
        said = "undecided" if seen is None else "right" if seen.view == view else "WRONG"
        found.setdefault(f"{group}, {view}", Counter())[said] += 1
    for name, counts in found.items():
        print(f"{name:40s} {', '.join(f'{count} {said}' for said, count in sorted(counts.items()))}")
    if given.write:
        # Rows of files that were not at hand stay.
        counted = {name: dict(sorted(counts.items())) for name, counts in found.items()}
        write_json(RESULTS, {**(read_json(RESULTS) if RESULTS.is_file() else {}), **counted})


def torsos(random: np.random.Generator) -> Iterator[tuple[str, TorsoModel]]:
    """As many with a curve as without, by what they are."""
    for number in range(len(BODIES)):
        recipe = Recipe(
            seed=100 + number,
            height_cm=float(random.uniform(135.0, 180.0)),
            cobb_deg=float(random.uniform(5.0, 60.0)),
            curve=CURVES[number % len(CURVES)],
            mesh="coarse",
        )
        yield "curves of 5 to 60 degrees", subject_torso(recipe)
    for age, sex, height, mass, kyphosis, lordosis in BODIES:
        yield (
            "bodies of 8 to 60 years",
            template_torso(
                height, age_years=age, sex=sex, mass_kg=mass, kyphosis_deg=kyphosis, lordosis_deg=lordosis,
            ),
        )  # fmt: skip


def synthetic() -> Iterator[tuple[str, str, Floats]]:
    """Group, view and grey values."""
    random = np.random.default_rng(77)
    for number, (what, torso) in enumerate(torsos(random)):
        spine = torso.rest_pose.bone_positions[torso.vertebra_bones]
        middle = np.array([0.0, 0.5 * (spine[0, 1] + spine[-1, 1]), 0.0])
        for view, of, how in (
            ("frontal", frontal_view, Acquisition()),
            ("lateral", lateral_view, Acquisition(exposure=LATERAL)),
        ):
            for framing, (rows, columns) in {"trunk": (320, 320), "neck to thigh": (560, 280)}.items():
                standing = middle + STANDING_SD_MM * random.standard_normal(3)
                sight = of(shape=(rows, columns), pixel=DETECTOR_MM / columns, centre=standing)
                pixels = acquire(torso, [torso.rest_pose], sight, how, person=200 + number, seed=300 + number)[0]
                yield f"{what}, {framing}", view, pixels
                if framing == "trunk":
                    sides = (random.uniform(*SHUTTERS_MM, 2) * columns / DETECTOR_MM).astype(int)
                    shut = pixels.copy()
                    shut[:, : sides[0]] = shut[:, columns - sides[1] :] = 0
                    yield f"{what}, shutters", view, shut


def real(folder: Path | None) -> Iterator[tuple[str, str, Floats]]:
    """The same of files."""
    for path in sorted(folder.iterdir()) if folder else ():
        pixels = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        if pixels is not None:
            yield "real", "frontal", pixels


if __name__ == "__main__":
    main()
