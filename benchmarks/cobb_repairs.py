"""What spoiled corners do to Cobb angles: read right, repaired right, refused, or taken for something else.

Labelled radiographs (``landmarks.csv``, ``images.csv`` and ``angles.csv`` in a folder, no part of the project) are read
as they are. Those whose corners are in order are then spoiled in one known way at a time, seeded, and read again: once
a kind and radiograph, with the vertebra, direction and size drawn anew. A reading counts as right within 1 degree of
what the same definition reads from the unspoiled corners, and a repaired one as right but for noise within its own 95 %
interval. Also found: how often the angles are the data set's, and what reading all takes; the measures by which a
vertebra is called odd (``imaging.spine_shape``), over all sound spines, which is where their limits come from; and how
many of the even rows exceed limits that the odd rows alone would have given. Of further seeds it is only told how many
readings went wrong. ``docs/cobb.md`` quotes it.

    python benchmarks/cobb_repairs.py FOLDER [--seeds 0 1 2] [--write]
    python benchmarks/cobb_repairs.py --json
"""

from __future__ import annotations

import argparse
import csv
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from kept_rows import tell

from spinestiff.anatomy.names import VERTEBRAE
from spinestiff.curves.cobb import CobbReading, Definition, read_cobb
from spinestiff.curves.corner_files import ImageCorners
from spinestiff.curves.corner_order import BEYOND, STOPPING
from spinestiff.imaging.planar import cross
from spinestiff.imaging.spine_shape import ODDEST, Measure, across, oddities

RESULTS = Path(__file__).parent / "results" / "cobb_repairs.json"
FILES = ("images.csv", "landmarks.csv", "angles.csv")
RIGHT_DEG = 1.0
# Angles of the data set that are compared, and how far apart the same ones may be, degrees.
COUNTS_DEG, SAME_DEG = 5.0, 0.05
# Of the median distance between neighbours' middles: nearer ones are one vertebra labelled twice.
NEAREST = 0.2
KINDS_OF_END = ("right", "repaired", "repaired_noise", "refused", "warned", "silent", "repaired_wrong")
# Missing levels a spine is tried with, one draw a spine and number.
GAPS = (1, 2, 3)
Spoil = Callable[[ImageCorners, np.random.Generator], ImageCorners]


@dataclass(frozen=True)
class Kind:
    """A way of spoiling an image."""

    name: str
    spoil: Spoil


def labelled(folder: Path) -> tuple[list[ImageCorners], np.ndarray]:
    """Corners in pixels, and the three angles that the data set gives, largest first; degrees.

    Raises
    ------
    SystemExit : a file is missing.
    """
    for name in FILES:
        if not (folder / name).is_file():
            raise SystemExit(f"{folder / name}: no such file; wanted a folder with {', '.join(FILES)}")
    with (folder / "images.csv").open() as file:
        size = np.array([[float(row["width_px"]), float(row["height_px"])] for row in csv.DictReader(file)])
    table = np.loadtxt(folder / "landmarks.csv", delimiter=",").reshape(-1, 2, 17, 4)
    # The data set has bottom left before bottom right.
    pixels = (table.transpose(0, 2, 3, 1) * size[:, None, None, :])[:, :, [0, 1, 3, 2]]
    angles = np.loadtxt(folder / "angles.csv", delimiter=",", ndmin=2)
    return [ImageCorners(f"row {i}", VERTEBRAE, quads) for i, quads in enumerate(pixels)], angles


def sound(image: ImageCorners) -> bool:
    """Whether corners are in order, told without the functions that are judged here."""
    quads, middles = image.corners, image.corners.mean(axis=1)
    edges = np.roll(quads, -1, axis=1) - quads
    convex = (cross(edges, np.roll(edges, -1, axis=1)) > 0.0).all()
    gaps = np.hypot(*np.diff(middles, axis=0).T)
    return bool(convex and (np.diff(middles[:, 1]) > 0.0).all() and gaps.min() > NEAREST * np.median(gaps))


def with_row(image: ImageCorners, row: int, quad: np.ndarray) -> ImageCorners:
    corners = image.corners.copy()
    corners[row] = quad
    return replace(image, corners=corners)


def width(image: ImageCorners, row: int) -> float:
    return float(np.hypot(*across(image.corners[row])))


def displaced(least: float, most: float, of_width: bool) -> Spoil:
    """One vertebra moved in a random direction, by pixels or by its own width."""

    def spoil(image: ImageCorners, rng: np.random.Generator) -> ImageCorners:
        row, direction = rng.integers(17), rng.uniform(0.0, 2.0 * np.pi)
        far = rng.uniform(least, most) * (width(image, row) if of_width else 1.0)
        return with_row(image, row, image.corners[row] + far * np.array([np.cos(direction), np.sin(direction)]))

    return spoil


def turned(least: float, most: float) -> Spoil:
    """One vertebra turned about its middle, its corners' names with it; either way."""

    def spoil(image: ImageCorners, rng: np.random.Generator) -> ImageCorners:
        row, angle = rng.integers(17), np.radians(rng.uniform(least, most)) * rng.choice([-1.0, 1.0])
        rotation = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        middle = image.corners[row].mean(axis=0)
        return with_row(image, row, middle + (image.corners[row] - middle) @ rotation.T)

    return spoil


def reordered(orders: Sequence[Sequence[int]], vertebrae: int = 1) -> Spoil:
    """Corners of so many vertebrae named in another order."""

    def spoil(image: ImageCorners, rng: np.random.Generator) -> ImageCorners:
        for row in rng.choice(17, vertebrae, replace=False):
            image = with_row(image, row, image.corners[row][list(orders[rng.integers(len(orders))])])
        return image

    return spoil


def exchanged(image: ImageCorners, rng: np.random.Generator) -> ImageCorners:
    pair = rng.choice(17, 2, replace=False)
    corners = image.corners.copy()
    corners[pair] = corners[pair[::-1]]
    return replace(image, corners=corners)


def misplaced(image: ImageCorners, rng: np.random.Generator) -> ImageCorners:
    """One vertebra at another place of the list: those between take its neighbours' names."""
    source, target = rng.choice(17, 2, replace=False)
    return replace(image, corners=np.insert(np.delete(image.corners, source, axis=0), target, image.corners[source], 0))


def duplicated(image: ImageCorners, rng: np.random.Generator) -> ImageCorners:
    """A neighbour marked once more under this level's name, by hand: 1 % of its width off."""
    row = int(rng.integers(17))
    other = row + (1 if row == 0 or (row < 16 and rng.integers(2)) else -1)
    off = rng.normal(0.0, 0.01 * width(image, other), (4, 2))
    return with_row(image, row, image.corners[other] + off)


def without_one(image: ImageCorners, rng: np.random.Generator) -> ImageCorners:
    row = rng.integers(17)
    levels = tuple(level for i, level in enumerate(image.levels) if i != row)
    return replace(image, levels=levels, corners=np.delete(image.corners, row, axis=0))


def reversed_list(image: ImageCorners, rng: np.random.Generator) -> ImageCorners:
    return replace(image, corners=image.corners[::-1])


def in_other_unit(image: ImageCorners, rng: np.random.Generator) -> ImageCorners:
    """One vertebra in millimetres, in pixels of another binning, in centimetres, or in inches."""
    row = rng.integers(17)
    return with_row(image, row, image.corners[row] * rng.choice([0.139, 0.417, 0.5, 2.0, 0.1, 10.0, 1 / 2.54]))


def of_other_size(image: ImageCorners, rng: np.random.Generator) -> ImageCorners:
    row = rng.integers(17)
    middle = image.corners[row].mean(axis=0)
    return with_row(image, row, middle + (image.corners[row] - middle) * rng.choice([0.3, 0.5, 2.0, 3.0]))


SHIFTS = ((1, 2, 3, 0), (2, 3, 0, 1), (3, 0, 1, 2))
MIRRORED = ((1, 0, 3, 2), (3, 2, 1, 0), (0, 3, 2, 1), (2, 1, 0, 3))
CROSSED = ((0, 1, 3, 2), (1, 0, 2, 3), (0, 2, 1, 3), (3, 1, 2, 0))
KINDS = (
    Kind("displaced by 5 to 60 px", displaced(5.0, 60.0, of_width=False)),
    Kind("displaced by 0.3 to 1.5 widths", displaced(0.3, 1.5, of_width=True)),
    Kind("turned by 90 degrees", turned(90.0, 90.0)),
    Kind("turned by 180 degrees", turned(180.0, 180.0)),
    Kind("turned by 30 to 70 degrees", turned(30.0, 70.0)),
    Kind("two exchanged", exchanged),
    Kind("one misplaced in the list", misplaced),
    Kind("a neighbour marked twice", duplicated),
    Kind("corners begun at another", reordered(SHIFTS)),
    Kind("corners begun at another, three vertebrae", reordered(SHIFTS, 3)),
    Kind("corners mirrored", reordered(MIRRORED)),
    Kind("corners crossed", reordered(CROSSED)),
    Kind("list reversed", reversed_list),
    Kind("one level missing", without_one),
    Kind("in another unit", in_other_unit),
    Kind("of another size", of_other_size),
)


def largest(reading: CobbReading) -> float:
    assert reading.largest is not None
    return abs(reading.largest.angle.degrees)


def end_of(reading: CobbReading, truth: float) -> str:
    """How a spoiled image's reading ends, one of ``KINDS_OF_END``."""
    if reading.status == "refused":
        return "refused"
    off = abs(largest(reading) - truth)
    right = off <= RIGHT_DEG
    if reading.status == "repaired":
        assert reading.largest is not None
        within = off <= reading.largest.half_width_deg
        return "repaired" if right else "repaired_noise" if within else "repaired_wrong"
    if right:
        return "right"
    return "warned" if reading.warnings else "silent"


def unnoticed(image: ImageCorners, spoiled: ImageCorners, off: float) -> dict[str, Any]:
    """What a reading that is wrong without a word was spoiled by: levels, how far their top sides turned, deviation."""
    gone = [level for level in image.levels if level not in spoiled.levels]
    if gone:
        return {"levels": gone, "off_deg": round(off, 2)}
    rows = np.flatnonzero((image.corners != spoiled.corners).any(axis=(1, 2)))
    sides = [np.arctan2(*(one[rows, 1] - one[rows, 0]).T[::-1]) for one in (image.corners, spoiled.corners)]
    turned = np.degrees(np.abs((sides[1] - sides[0] + np.pi) % (2.0 * np.pi) - np.pi))
    return {
        "levels": [image.levels[row] for row in rows],
        "turned_deg": np.round(turned, 1).tolist(),
        "off_deg": round(off, 2),
    }


def campaign(images: Sequence[ImageCorners], definition: Definition, seed: int) -> list[dict[str, Any]]:
    """For each kind how its images end; of the wrong ones the largest deviation, degrees, and all without a word."""
    truths = [largest(read_cobb(image, definition)) for image in images]
    rows = []
    for number, kind in enumerate(KINDS):
        rng = np.random.default_rng([seed, number])
        ends: Counter[str] = Counter()
        worst = dict.fromkeys(KINDS_OF_END, 0.0)
        silent = []
        for image, truth in zip(images, truths):
            spoiled = kind.spoil(image, rng)
            reading = read_cobb(spoiled, definition)
            end = end_of(reading, truth)
            ends[end] += 1
            if reading.largest is not None:
                deviation = abs(largest(reading) - truth)
                worst[end] = max(worst[end], deviation)
                if end == "silent":
                    silent.append(unnoticed(image, spoiled, deviation))
        off = {end: round(worst[end], 2) for end in ("repaired_noise", "warned", "silent", "repaired_wrong")}
        counted = {end: ends[end] for end in KINDS_OF_END}
        rows.append({"kind": kind.name, **counted, "largest_deviation_deg": off, "without_a_word": silent})
    return rows


def values_of(corners: np.ndarray, places: Sequence[int]) -> dict[Measure, list[float]]:
    """Every vertebra's measures, in their own units."""
    found: dict[Measure, list[float]] = {name: [] for name in ODDEST}
    for odd in oddities(corners, places):
        found[odd.measure].append(odd.ratio * ODDEST[odd.measure])
    return found


def measures(images: Sequence[ImageCorners], seed: int) -> dict[str, object]:
    """What sound spines do: whole, with levels missing, and beyond limits that half of them give."""
    every = [values_of(image.corners, range(17)) for image in images]
    rng = np.random.default_rng([seed, 1000])
    gappy = []
    for image in images:
        for gap in GAPS:
            first = int(rng.integers(1, 17 - gap))
            places = [i for i in range(17) if not first <= i < first + gap]
            gappy.append(values_of(image.corners[places], places))
    table = []
    for name, limit in ODDEST.items():
        values = np.sort(np.concatenate([found[name] for found in every]))
        with_gaps = np.sort(np.concatenate([found[name] for found in gappy]))
        table.append(
            {
                "measure": name,
                "median": round(float(np.median(values)), 4),
                "99": round(float(np.quantile(values, 0.99)), 4),
                "99.9": round(float(np.quantile(values, 0.999)), 4),
                "largest_three": [round(float(v), 4) for v in values[:-4:-1]],
                "largest_three_with_gaps": [round(float(v), 4) for v in with_gaps[:-4:-1]],
                "limit": limit,
            }
        )
    half = {name: max(max(found[name]) for found in every[1::2]) for name in ODDEST}

    def exceed(spines: Sequence[dict[Measure, list[float]]], over: dict[Measure, float], factor: float) -> int:
        names = STOPPING if factor > 1.0 else tuple(ODDEST)
        return sum(any(max(found[name]) > factor * over[name] for name in names) for found in spines)

    return {
        "table": table,
        "even_rows": len(every[::2]),
        "even_rows_warned_of_by_the_odd_rows": exceed(every[::2], half, 1.0),
        "even_rows_refused_by_the_odd_rows": exceed(every[::2], half, BEYOND),
        "with_gaps": len(gappy),
        "with_gaps_warned_of": exceed(gappy, ODDEST, 1.0),
        "with_gaps_refused": exceed(gappy, ODDEST, BEYOND),
    }


def has_all(reading: CobbReading, angles: np.ndarray) -> bool:
    """Whether each of a data set's angles is one of a reading's curves."""
    found = np.array([abs(curve.angle.degrees) for curve in reading.curves])
    return all(np.abs(found - angle).min() < SAME_DEG for angle in angles if angle > COUNTS_DEG)


def as_they_are(images: Sequence[ImageCorners], angles: np.ndarray) -> dict[str, Any]:
    """How all radiographs read by mid-lines, as the data set's angles are defined."""
    begun = time.process_time()
    readings = [read_cobb(image, "midline") for image in images]
    took = time.process_time() - begun
    off = {
        status: max((abs(largest(r) - a[0]) for r, a in zip(readings, angles) if r.status == status), default=0.0)
        for status in ("ok", "repaired")
    }
    return {
        **Counter(reading.status for reading in readings),
        "largest_deviation_deg": {status: round(float(value), 4) for status, value in off.items()},
        "ok_with_all_angles": sum(has_all(r, a) for r, a in zip(readings, angles) if r.status == "ok"),
        "largest_refused_deg": max((float(a[0]) for r, a in zip(readings, angles) if r.status == "refused"), default=0),
        "cpu_s": round(took, 1),
    }


def gone_wrong(rows: Sequence[dict[str, Any]]) -> dict[str, int]:
    """How many of a campaign's readings are wrong and not refused."""
    return {end: sum(row[end] for row in rows) for end in ("repaired_noise", "warned", "silent", "repaired_wrong")}


def measured(folder: Path, seeds: Sequence[int]) -> dict[str, Any]:
    """All of it."""
    images, angles = labelled(folder)
    in_order = [image for image in images if sound(image)]
    definitions: tuple[Definition, ...] = ("midline", "endplate")
    first, *further = seeds
    return {
        "radiographs": len(images),
        "as_they_are": as_they_are(images, angles),
        "sound": len(in_order),
        "seed": first,
        "measures": measures(in_order, first),
        "campaign": {name: campaign(in_order, name, first) for name in definitions},
        "further_seeds": {
            str(seed): {name: gone_wrong(campaign(in_order, name, seed)) for name in definitions} for seed in further
        },
    }


def main() -> None:
    """Measure, store or print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, nargs="?", help=f"folder of {', '.join(FILES)}")
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2])
    parser.add_argument("--write", action="store_true", help="store it in benchmarks/results/")
    parser.add_argument("--json", action="store_true", help="print what is stored")
    asked = parser.parse_args()
    if asked.json:
        print(RESULTS.read_text(encoding="utf-8") if RESULTS.is_file() else "{}")
    elif asked.folder:
        tell(measured(asked.folder, asked.seeds), RESULTS if asked.write else None)
    else:
        parser.error("wanted FOLDER or --json")


if __name__ == "__main__":
    main()
