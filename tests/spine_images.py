"""Images of spines whose tilts are known, and the labelled radiographs as a file of corners."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

from spinestiff.anatomy.names import VERTEBRAE
from spinestiff.curves.corner_files import ImageCorners, write_corners

LABELLED = Path(__file__).parents[2] / "shared/data/scoliosis_radiographs"


def boxes(degrees, width=120.0, height=70.0, wedge=0.0):
    """Corners (n, 4, 2) as seen of a stack of boxes; a tilt above 0 has its right side higher.

    ``wedge`` turns each upper endplate by so much more and each lower one by so much less.
    """
    turn = np.radians(np.asarray(degrees, dtype=float))
    quads, middle = [], np.array([500.0, 150.0])
    for i, angle in enumerate(turn):
        if i:
            half = 0.5 * (turn[i - 1] + angle)
            middle = middle + 1.4 * height * np.array([np.sin(half), np.cos(half)])
        down = 0.5 * height * np.array([np.sin(angle), np.cos(angle)])
        plates = []
        for sign in (1.0, -1.0):
            plate = angle + sign * np.radians(wedge)
            along = 0.5 * width * np.array([np.cos(plate), -np.sin(plate)])
            plates.append((middle - sign * down - along, middle - sign * down + along))
        (tl, tr), (bl, br) = plates
        quads.append([tl, tr, br, bl])
    return np.array(quads)


def image(degrees, start=0, name="spine", unit="px", first_on=None, **shape):
    """One image; the first vertebra is VERTEBRAE[start]."""
    levels = VERTEBRAE[start : start + len(degrees)]
    return ImageCorners(name, levels, boxes(degrees, **shape), "", unit, first_on)


def labelled_images():
    """The 481 labelled radiographs and the largest angle of each, as the data set gives it."""
    with (LABELLED / "images.csv").open() as file:
        size = np.array([[float(row["width_px"]), float(row["height_px"])] for row in csv.DictReader(file)])
    table = np.loadtxt(LABELLED / "landmarks.csv", delimiter=",").reshape(-1, 2, 17, 4)
    pixels = table.transpose(0, 2, 3, 1) * size[:, None, None, :]
    # The data set has bottom left before bottom right.
    pixels = pixels[:, :, [0, 1, 3, 2]]
    angles = np.loadtxt(LABELLED / "angles.csv", delimiter=",")[:, 0]
    return [ImageCorners(f"row {i}", VERTEBRAE, quads) for i, quads in enumerate(pixels)], angles


def labelled_csv(path):
    """The labelled radiographs as a CSV of corners, and their largest angles."""
    images, angles = labelled_images()
    write_corners(path, images)
    return angles
