"""How much work seventeen vertebrae are on the annotation page: clicks, drags and an estimated time.

Six clicks along the spine, a proposal, then what a careful person does: the corner that lies farthest off is dragged
where it belongs, one after the other, until all lie within the tolerance. Where a whole vertebra lies off it is dragged
first, if that leaves fewer corners to drag. "Propose the others", after some vertebrae were put right, is used
where that saves time.

Synthetic radiographs (known corners): ``SUBJECTS``, made anew, which the proposal's weights were not set with. Real
ones: ``--images``, a folder with ``landmarks.csv`` and ``images/``, no part of the project. Their labels lie
millimetres off the corners that can be seen, so their tolerance is wider, and the counts are upper bounds.

Errors are of three draws of the clicks, the work of the first. The file keeps a run under each label.

    python benchmarks/annotation.py [--images FOLDER] [--label TEXT] [--out FILE] [--subjects FOLDER]
"""

from __future__ import annotations

import argparse
import csv
import datetime
import tempfile
import time
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path

import cv2
import numpy as np
from scipy.interpolate import CubicSpline

from spinestiff.anatomy.names import VERTEBRAE
from spinestiff.anatomy.template.sizes import VERTEBRA_SIZES
from spinestiff.files import read_json, write_json
from spinestiff.imaging.features import view_kind
from spinestiff.imaging.projection import frontal_view
from spinestiff.imaging.proposal import leans_of, propose_boxes
from spinestiff.imaging.radiograph import Radiograph
from spinestiff.study.synthetic.recipe import Recipe, SyntheticPush
from spinestiff.study.synthetic.subject import synthesise
from spinestiff.subject.folder import read_push, read_rest, read_subject

CLICKS = 6
# How far from the middle of the spine people click, standard deviation, mm of the person.
CLICK_SD_MM = 1.5
# Seconds an action takes: a point and a drag after the keystroke-level model (Card, Moran and Newell 1980: pointing
# 1.1 s, pressing or releasing a button 0.1 s, getting ready 1.35 s); looking at a vertebra and deciding is ours.
POINT_S = 1.1 + 0.2
DRAG_S = 1.35 + 1.1 + 0.1 + 1.1 + 0.1
LOOK_S = 2.0
BUTTON_S = 1.35 + 1.1 + 0.2
# The key that shows the next vertebra; 0 on a page that does not ask for it.
KEY_S = 0.28
DRAWS = 3
PUSH = (SyntheticPush("main", level=8.0, shares=(0.0, 0.3), roles=("unused", "training")),)
SUBJECTS = tuple(
    Recipe(seed=seed, height_cm=height, cobb_deg=cobb, curve=curve, pushes=PUSH, mesh="coarse")
    for seed, height, cobb, curve in (
        (21, 150.0, 20.0, "thoracic"),
        (22, 162.0, 30.0, "double"),
        (23, 140.0, 12.0, "thoracolumbar"),
        (24, 168.0, 35.0, "lumbar"),
        (25, 155.0, 45.0, "thoracic"),
    )
)
TOLERANCES_MM = {"synthetic": (1.5, 2.0, 3.0), "real": (2.0, 3.0, 4.0)}
# Those with 17 bodies labelled in order (docs/annotate.md says which labels are not).
REAL_ROWS = (0, 60, 240, 300, 360)


@dataclass(frozen=True)
class Case:
    """A radiograph, the corners (n, 4, 2) in pixels that are wanted, and mm of the person a pixel.

    ``leans`` : of a lateral one, how vertebrae lean to the side, as a frontal one that was marked before tells.
    """

    name: str
    kind: str
    radiograph: Radiograph
    vertebrae: tuple[str, ...]
    corners: np.ndarray
    mm: float
    leans: Mapping[str, float] = field(default_factory=dict)

    def proposed(self, clicks: np.ndarray, kept: Mapping[str, np.ndarray] | None = None) -> np.ndarray:
        """Boxes as the page proposes them."""
        return propose_boxes(self.radiograph, clicks, self.vertebrae, kept, self.leans)

    @property
    def group(self) -> str:
        """What errors are pooled over."""
        return self.kind if self.kind == "real" else f"{self.kind}, {view_kind(self.radiograph.view)}"


@dataclass(frozen=True)
class Work:
    """What it took. ``whole`` and ``single`` are drags of vertebrae and of corners."""

    tolerance_mm: float
    clicks: int
    proposals: int
    whole: int
    single: int
    seconds: float


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--images", type=Path, help="folder of labelled real radiographs")
    parser.add_argument("--label", default=datetime.date.today().isoformat(), help="of this run; default the date")
    parser.add_argument("--out", type=Path, default=Path(__file__).parent / "results" / "annotation.json")
    parser.add_argument("--subjects", type=Path, help="where the synthetic subjects are kept; default nowhere")
    given = parser.parse_args()
    cases: list[Case] = []
    with tempfile.TemporaryDirectory() as temporary:
        for recipe in SUBJECTS:
            folder = (given.subjects or Path(temporary)) / f"s{recipe.seed}"
            if not folder.exists():
                synthesise(folder, recipe)
            cases += synthetic_cases(folder, f"{recipe.curve} {recipe.cobb_deg:.0f} degrees, ")
    cases += real_cases(given.images) if given.images else []
    rows, errors = [], {}
    for case in cases:
        row, away = measured(case)
        rows.append(row)
        errors.setdefault(case.group, []).append(away)
        for work in row["work"]:  # type: ignore[attr-defined]
            drags = f"{work['whole']} vertebrae and {work['single']} corners dragged, {work['proposals']} proposals"
            print(f"{row['name']:40s} within {work['tolerance_mm']:g} mm: {drags}, about {work['seconds']:.0f} s")
    pooled = {group: spread(np.concatenate(away)) for group, away in errors.items()}
    for group, found in pooled.items():
        print(f"{group}: median {found['50']} mm, 95 % within {found['95']} mm")
    kept = read_json(given.out)["runs"] if given.out.is_file() else {}
    settings = {
        "clicks": CLICKS,
        "click_sd_mm": CLICK_SD_MM,
        "draws": DRAWS,
        "seconds": {
            "point": POINT_S, "drag": DRAG_S, "look_at_a_vertebra": LOOK_S, "key": KEY_S, "button": BUTTON_S,
        },
    }  # fmt: skip
    run = {"settings": settings, "corner_error_mm": pooled, "radiographs": rows}
    write_json(given.out, {"runs": {**kept, given.label: run}})


def spread(away: np.ndarray) -> dict[str, float]:
    """Percentiles of errors, mm, and the share above 3 mm."""
    found = {str(q): round(float(np.percentile(away, q)), 2) for q in (50, 75, 95, 100)}
    return {**found, "share above 3 mm": round(float(np.mean(away > 3.0)), 3)}


def measured(case: Case) -> tuple[dict[str, object], np.ndarray]:
    """Errors of the first proposal, also in mm one by one, and the work at each tolerance."""
    clicks = clicked(case)
    began = time.perf_counter()
    first = case.proposed(clicks)
    seconds = time.perf_counter() - began
    others = [case.proposed(clicked(case, draw)) for draw in range(1, DRAWS)]
    away = np.linalg.norm(np.array([first, *others]) - case.corners, axis=3) * case.mm
    limits = TOLERANCES_MM[case.kind]
    row = {
        "name": case.name,
        "kind": case.kind,
        "vertebrae": len(case.vertebrae),
        "corner_error_mm": spread(away),
        "share_of_vertebrae_without_a_drag": {
            str(limit): float(np.mean(away.max(axis=2) <= limit)) for limit in limits
        },
        "proposal_seconds": round(seconds, 2),
        "work": [asdict(least_work(case, clicks, first, limit)) for limit in limits],
    }
    return row, away.ravel()


def clicked(case: Case, draw: int = 0) -> np.ndarray:
    """Points along the true middle line, evenly spread, each off by what a hand is off."""
    middle = case.corners.mean(axis=1)
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(middle, axis=0), axis=1))])
    rng = np.random.default_rng(draw)
    exact = CubicSpline(along, middle)(np.linspace(0.0, along[-1], CLICKS))
    return exact + rng.normal(0.0, CLICK_SD_MM / case.mm, exact.shape)


def least_work(case: Case, clicks: np.ndarray, first: np.ndarray, limit: float) -> Work:
    """The least of: all put right by hand; some vertebrae put right, then the others proposed again, and put right.

    Some: one to four of the worst, as far as the tolerance asks; or two or three all over the spine, with four corners.
    """
    ways = [counted(case, first, limit, proposals=1)]
    for chosen, put_right, whole, single in guides(case, first, limit):
        kept = {case.vertebrae[i]: put_right[i] for i in chosen}
        again = counted(case, case.proposed(clicks, kept), limit, proposals=2)
        ways.append(total(limit, 2, whole + again.whole, single + again.single, len(case.vertebrae)))
    return min(ways, key=lambda work: work.seconds)


def guides(case: Case, first: np.ndarray, limit: float) -> Iterator[tuple[np.ndarray, np.ndarray, int, int]]:
    """Vertebrae to put right before the second proposal, their boxes then, and the drags that takes."""
    order = np.argsort(-np.linalg.norm(first - case.corners, axis=2).max(axis=1))
    for n in range(1, 5):
        yield order[:n], *corrected(case, first, limit, order[:n])
    for n in (2, 3):
        spread = np.linspace(0, len(first) - 1, n + 2)[1:-1].round().astype(int)
        yield spread, case.corners, 0, 4 * n


def counted(case: Case, boxes: np.ndarray, limit: float, proposals: int, only: np.ndarray | None = None) -> Work:
    _, whole, single = corrected(case, boxes, limit, only)
    return total(limit, proposals, whole, single, len(case.vertebrae))


def total(limit: float, proposals: int, whole: int, single: int, vertebrae: int) -> Work:
    seconds = CLICKS * POINT_S + proposals * BUTTON_S + (whole + single) * DRAG_S + vertebrae * (LOOK_S + KEY_S)
    return Work(limit, CLICKS, proposals, whole, single, round(seconds, 1))


def corrected(
    case: Case, boxes: np.ndarray, limit: float, only: np.ndarray | None = None
) -> tuple[np.ndarray, int, int]:
    """Boxes put right, and how many whole vertebrae and single corners were dragged for it."""
    found, whole, single = boxes.copy(), 0, 0
    for i in range(len(boxes)) if only is None else only:
        off = boxes[i] - case.corners[i]
        plain = int((np.linalg.norm(off, axis=1) * case.mm > limit).sum())
        shifted = off - off.mean(axis=0)
        moved = int((np.linalg.norm(shifted, axis=1) * case.mm > limit).sum())
        if 1 + moved < plain:
            whole, single, off = whole + 1, single + moved, shifted
        else:
            single += plain
        off = np.where(np.linalg.norm(off, axis=1, keepdims=True) * case.mm > limit, 0.0, off)
        found[i] = case.corners[i] + off
    return found, whole, single


def synthetic_cases(folder: Path, name: str = "") -> list[Case]:
    """The rest radiographs and the first frame of a push; mm at the patient plane."""
    subject = read_subject(folder)
    push = subject.pushes[0]
    pictures = {
        "rest/frontal": read_rest(subject, "frontal"),
        "rest/lateral": read_rest(subject, "lateral"),
        push.image: read_push(subject, push)[0],
    }
    cases = []
    front = subject.annotation.images["rest/frontal"].vertebrae
    for image, radiograph in pictures.items():
        marks = subject.annotation.images[image]
        mm = float((radiograph.view.pixel_spacing / radiograph.view.magnification).mean())
        leans = {} if view_kind(radiograph.view) == "frontal" else leans_of(pictures["rest/frontal"].view, front)
        cases.append(Case(f"{name}{image}", "synthetic", radiograph, tuple(marks.vertebrae), marks.pixels(), mm, leans))
    return cases


def real_cases(folder: Path) -> list[Case]:
    """Labelled radiographs without millimetres: the spine is taken for as long as the template's."""
    with (folder / "landmarks.csv").open() as file:
        rows = list(csv.reader(file))
    sizes = VERTEBRA_SIZES[:, 4:6].ravel()
    length = sizes[:-1].sum() - 0.5 * (sizes[0] + sizes[-2])
    cases = []
    for row in REAL_ROWS:
        pixels = cv2.imread(str(folder / "images" / f"row{row:03d}.jpg"), cv2.IMREAD_GRAYSCALE)
        values = np.array([float(x) for x in rows[row]])
        points = np.stack([values[:68] * pixels.shape[1], values[68:] * pixels.shape[0]], axis=1).reshape(17, 4, 2)
        corners = points[:, [1, 0, 2, 3]]
        mm = length / np.linalg.norm(np.diff(corners.mean(axis=1), axis=0), axis=1).sum()
        radiograph = Radiograph(pixels.astype(np.float32), frontal_view(shape=pixels.shape))
        cases.append(Case(f"real, row {row}", "real", radiograph, VERTEBRAE, corners, float(mm)))
    return cases


if __name__ == "__main__":
    main()
