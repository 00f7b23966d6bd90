"""How far are synthetic radiographs from real ones at the places a tracker looks at?

``OMP_NUM_THREADS=1 python benchmarks/radiograph_realism.py --images FOLDER [--json] [--write]``. FOLDER holds
``images/``, ``images.csv`` and ``landmarks.csv`` of standing frontal radiographs with four corners a vertebra (17
vertebrae from T1; x of all corners, then y, as shares of width and height; top left, top right, bottom left, bottom
right). Only figures of them are kept.

Real images there are 8-bit JPEGs after a vendor's processing, without millimetres. So everything is measured in units
that survive: lengths by the vertebra's width (w), grey by the spread of grey along the image's own spine column, or by
its own noise. Synthetic images (frontal, at rest) go the same way: cut to the same field, windowed to 8 bits, stored as
JPEG, read back.

    gradient    steepest slope across an edge at the scale 0.03 w: spreads of grey a vertebra's width
    contrast    mean grey just inside the vertebra minus just outside: spreads
    rim         the edge's own bright line above the mean of both sides: spreads
    noise       robust standard deviation between scales 0.012 w and 0.024 w beside the spine: spreads
    edge CNR    |contrast| / noise
    slope/noise gradient times 0.03 w / noise
    spectrum    power of grey (spreads^2 w^2) beside the lumbar spine against frequency in periods a vertebra's width
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from scipy.ndimage import gaussian_filter, map_coordinates

from spinestiff.anatomy.template import template_torso
from spinestiff.imaging.features import silhouette_shares, state_features
from spinestiff.imaging.projection import frontal_view
from spinestiff.imaging.synthetic.acquisition import DEFAULT_ACQUISITION, Acquisition, acquire
from spinestiff.personalise.placing import place_vertebrae
from spinestiff.study.synthetic.spines import curved_spine

RESULT = Path(__file__).parent / "results" / "radiograph_realism.json"
SYNTHETIC = ((12.0, "thoracic", 1), (30.0, "thoracic", 2), (40.0, "double", 3), (25.0, "lumbar", 4))
DECILES = (10, 25, 50, 75, 90)
BANDS = (1.0, 2.0, 3.0, 4.5, 6.5, 9.5, 14.0, 20.0)  # periods a vertebra's width
SCALE = 0.03
JPEG_QUALITY = 92
REGIONS = {"thoracic": slice(1, 12), "lumbar": slice(12, 17)}


@dataclass(frozen=True)
class Picture:
    """Grey (H, W) and corners (17, 4, 2) pixels: top left, top right, bottom left, bottom right."""

    name: str
    grey: np.ndarray
    corners: np.ndarray


def real_pictures(folder: Path) -> Iterator[Picture]:
    """The images of a folder with their corners."""
    table = np.loadtxt(folder / "landmarks.csv", delimiter=",")
    for line in (folder / "images.csv").read_text(encoding="utf-8").splitlines()[1:]:
        row, name, *_ = line.split(",")
        if not name:
            continue
        grey = cv2.imread(str(folder / "images" / name), cv2.IMREAD_GRAYSCALE).astype(float)
        x, y = table[int(row)].reshape(2, 17, 4)
        yield Picture(name, grey, np.stack([x * grey.shape[1], y * grey.shape[0]], -1))


def synthetic_pictures(acquisition: Acquisition = DEFAULT_ACQUISITION) -> Iterator[Picture]:
    """Frontal rest radiographs of four bodies, as they would look when published."""
    for cobb, curve, person in SYNTHETIC:
        torso = template_torso(157.0)
        torso = place_vertebrae(torso, *curved_spine(torso, cobb, curve))
        spine = torso.rest_pose.bone_positions[torso.vertebra_bones]
        view = frontal_view(centre=(0.0, 0.5 * (spine[0, 1] + spine[-1, 1]), 0.0))
        (image,) = acquire(torso, [torso.rest_pose], view, acquisition, person=person, seed=person)
        shares = silhouette_shares(torso, view, torso.rest_pose)
        corners = view.pixels(state_features(torso, view, torso.rest_pose, shares).corners)[:, [1, 0, 2, 3]]
        yield published(Picture(f"synthetic {person}", image.astype(float), corners))


def published(picture: Picture) -> Picture:
    """Cut to the spine with some 3 widths on both sides, windowed to 8 bits by its own grey values, stored as JPEG."""
    width = np.linalg.norm(picture.corners[:, 1] - picture.corners[:, 0], axis=-1).max()
    low = np.maximum(picture.corners.min(axis=(0, 1)) - [3.0 * width, width], 0).astype(int)
    high = (picture.corners.max(axis=(0, 1)) + [3.0 * width, width]).astype(int)
    cut = picture.grey[low[1] : high[1], low[0] : high[0]]
    black, white = np.percentile(cut, [2.0, 99.8])
    eight = np.clip(np.rint(255.0 * (cut - black) / (white - black)), 0, 255).astype(np.uint8)
    _, code = cv2.imencode(".jpg", eight, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    return Picture(picture.name, cv2.imdecode(code, cv2.IMREAD_GRAYSCALE).astype(float), picture.corners - low)


def spread(picture: Picture) -> float:
    """5th to 95th percentile of grey over the spine column, a vertebra's width to both sides: the unit of grey."""
    left, right = picture.corners[:, [0, 2]].mean(axis=1), picture.corners[:, [1, 3]].mean(axis=1)
    side = right - left
    outline = np.vstack([left - side, (right + side)[::-1]]).astype(np.int32)
    mask = np.zeros(picture.grey.shape, np.uint8)
    cv2.fillPoly(mask, [outline], 1)
    return float(np.ptp(np.percentile(picture.grey[mask > 0], [5.0, 95.0])))


def edge_figures(picture: Picture, unit: float) -> dict[str, dict[str, list[float]]]:
    """Gradient, contrast and rim at the edges of every vertebra, by region and kind of edge."""
    found: dict[str, dict[str, list[float]]] = {}
    for region, levels in REGIONS.items():
        for tl, tr, bl, br in picture.corners[levels]:
            width = 0.5 * (np.linalg.norm(tr - tl) + np.linalg.norm(br - bl))
            height = 0.5 * (np.linalg.norm(bl - tl) + np.linalg.norm(br - tr))
            middle = 0.25 * (tl + tr + bl + br)
            smooth = gaussian_filter(picture.grey, SCALE * width)
            for kind, ends in (("endplate", (tl, tr)), ("endplate", (bl, br)), ("wall", (tl, bl)), ("wall", (tr, br))):
                kept = found.setdefault(f"{region} {kind}", {"gradient": [], "contrast": [], "rim": []})
                depth = height if kind == "endplate" else width
                for name, value in _across(smooth, *ends, middle, width, depth).items():
                    kept[name] += list(value / unit)
    return found


def _across(grey: np.ndarray, start: np.ndarray, end: np.ndarray, middle: np.ndarray, width: float, depth: float):
    """Figures of profiles across the inner part of one edge, pointing into the vertebra."""
    along = np.linspace(0.2, 0.8, 13)[:, None]
    points = start + along * (end - start)
    inward = np.array([-(end - start)[1], (end - start)[0]])
    inward = inward / np.linalg.norm(inward)
    inward = inward if inward @ (middle - points.mean(axis=0)) > 0 else -inward
    t = np.linspace(-0.3, 0.3, 61)
    places = points[:, None] + (t * depth)[:, None] * inward
    values = map_coordinates(grey, [places[..., 1], places[..., 0]], order=1, mode="nearest")
    near = np.abs(t) < 0.14
    slope = np.abs(np.diff(values, axis=1)) / (t[1] - t[0]) / depth * width
    inside, outside = values[:, (t > 0.14) & (t < 0.26)].mean(axis=1), values[:, (t < -0.1) & (t > -0.22)].mean(axis=1)
    return {
        "gradient": slope[:, near[:-1]].max(axis=1),
        "contrast": inside - outside,
        "rim": values[:, near].max(axis=1) - 0.5 * (inside + outside),
    }


def patches(picture: Picture) -> Iterator[tuple[np.ndarray, float]]:
    """Squares of soft tissue beside lumbar vertebrae, one vertebra's width large, and that width."""
    for tl, tr, bl, br in picture.corners[12:16]:
        width = 0.5 * (np.linalg.norm(tr - tl) + np.linalg.norm(br - bl))
        middle = 0.25 * (tl + tr + bl + br)
        across = (tr - tl + br - bl) / np.linalg.norm(tr - tl + br - bl)
        for side in (-1.0, 1.0):
            low = np.rint(middle + side * 1.25 * width * across - 0.5 * width).astype(int)
            size = int(width)
            patch = picture.grey[max(low[1], 0) : low[1] + size, max(low[0], 0) : low[0] + size]
            if patch.shape == (size, size) and np.ptp(patch) > 0 and patch.min() > 0 and patch.max() < 255:
                yield patch, width


def noise(picture: Picture, unit: float) -> float:
    """Robust standard deviation between two scales beside the spine, in spreads."""
    bands = [gaussian_filter(p, 0.012 * w) - gaussian_filter(p, 0.024 * w) for p, w in patches(picture)]
    return float(np.median([1.4826 * np.median(np.abs(b - np.median(b))) for b in bands])) / unit


def spectrum(picture: Picture, unit: float) -> list[float]:
    """Median power over the patches in each band of frequency, spreads^2 w^2; NaN above the image's own limit."""
    powers = []
    for patch, width in patches(picture):
        size = len(patch)
        x = np.linspace(-1.0, 1.0, size)
        terms = [np.outer(a, b).ravel() for a in (x**0, x, x * x) for b in (x**0, x, x * x)]
        fit, *_ = np.linalg.lstsq(np.stack(terms, -1), patch.ravel(), rcond=None)
        window = np.outer(np.hanning(size), np.hanning(size))
        rest = (patch - (np.stack(terms, -1) @ fit).reshape(patch.shape)) * window
        power = np.abs(np.fft.fft2(rest)) ** 2 / (window**2).sum() / width**2 / unit**2
        f = np.hypot(*np.meshgrid(*[np.fft.fftfreq(size, 1.0 / width)] * 2))
        inside = [(f >= a) & (f < b) for a, b in zip(BANDS, BANDS[1:])]
        limit = 0.5 * width
        powers.append([power[i].mean() if b <= limit else np.nan for i, b in zip(inside, BANDS[1:])])
    return [float(v) for v in np.nanmedian(np.array(powers), axis=0)] if powers else []


def measure(pictures: Iterator[Picture]) -> dict[str, object]:
    """All figures of a set of pictures."""
    edges: dict[str, dict[str, list[float]]] = {}
    noises, spectra = [], []
    for picture in pictures:
        unit = spread(picture)
        level = noise(picture, unit)
        noises.append(level)
        spectra.append(spectrum(picture, unit))
        for edge, kept in edge_figures(picture, unit).items():
            kept["edge CNR"] = [abs(c) / level for c in kept["contrast"]]
            kept["slope/noise"] = [SCALE * g / level for g in kept["gradient"]]
            for name, values in kept.items():
                edges.setdefault(edge, {}).setdefault(name, []).extend(values)
    return {
        "images": len(noises),
        "noise": _deciles(noises),
        "edges": {edge: {name: _deciles(v) for name, v in kept.items()} for edge, kept in edges.items()},
        "spectrum": [float(f"{v:.3g}") for v in np.nanmedian(np.array(spectra), axis=0)],
    }


def _deciles(values: list[float]) -> list[float]:
    return [float(f"{v:.3g}") for v in np.nanpercentile(values, DECILES)]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--images", type=Path, required=True, help="folder of real radiographs")
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--write", action="store_true", help=f"keep the figures in {RESULT.name}")
    options = parser.parse_args()
    result = {
        "percentiles": DECILES,
        "bands_periods_a_width": BANDS,
        "real": measure(real_pictures(options.images)),
        "synthetic": measure(synthetic_pictures()),
    }
    if options.write:
        RESULT.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    if options.json:
        print(json.dumps(result))
        return
    real, made = result["real"], result["synthetic"]
    print(f"{'':34}{'real':>34}   {'synthetic':>34}   (10, 25, 50, 75, 90 %)")
    print(f"{'noise':34}{_row(real['noise']):>34}   {_row(made['noise']):>34}")
    for edge, kept in real["edges"].items():
        for name, values in kept.items():
            print(f"{edge + ' ' + name:34}{_row(values):>34}   {_row(made['edges'][edge][name]):>34}")
    print("spectrum  real     ", *(f"{v:9.2e}" for v in real["spectrum"]))
    print("          synthetic", *(f"{v:9.2e}" for v in made["spectrum"]))


def _row(values: list[float]) -> str:
    return " ".join(f"{v:6.3f}" if abs(v) < 10 else f"{v:6.1f}" for v in values)


if __name__ == "__main__":
    main()
