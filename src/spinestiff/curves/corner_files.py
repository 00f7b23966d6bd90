"""Vertebra corners of images from and to files: CSV, Slicer markups and our own annotation.json (docs/cobb.md).

Whatever the file, corners come out as seen in the image: top left, top right, bottom right, bottom left, as (column,
row) with the first pixel's centre at (0, 0). What belongs to one image only (an unknown level, a corner twice) makes
that image unreadable, with the reason; what concerns the whole file is refused.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
from pydantic import ValidationError

from spinestiff.anatomy.names import VERTEBRAE
from spinestiff.arrays import Floats, read_only
from spinestiff.curves import corner_csv, corner_markups
from spinestiff.errors import SubjectError
from spinestiff.files import read_exported_text, read_text, write_json, write_text
from spinestiff.formats import parse_json, plain_number
from spinestiff.subject.annotation_record import Annotation, shares_of_size
from spinestiff.subject.image_names import LATERAL, PushImage
from spinestiff.subject.record_reading import complaint_of
from spinestiff.subject.records import ANNOTATION_FILE, SCHEMA_VERSION, SUBJECT_FILE
from spinestiff.words import printable

CORNERS = ("top_left", "top_right", "bottom_right", "bottom_left")
MARKUPS_SUFFIX = ".mrk.json"
LARGEST_CSV = 50 * 2**20
"""Bytes: ten thousand images of seventeen vertebrae take about 20 MB."""
MOST_IMAGES = 20_000
FARTHEST = 100_000.0
"""Pixels (or mm) from the first pixel. No detector is that large; a larger number is another quantity."""
LONGEST_NAME = 200
# Our annotation's corners -> as seen, by (superior is up in the image, the first corner is on its left).
_AS_SEEN = {
    (True, True): (0, 1, 2, 3),
    (True, False): (1, 0, 3, 2),
    (False, True): (3, 2, 1, 0),
    (False, False): (2, 3, 0, 1),
}

# Keys at the top of other programs' annotations.
_FOREIGN = {
    "COCO annotations": {"images", "annotations"},
    "Labelme annotations": {"shapes", "imagePath"},
    "VGG Image Annotator": {"_via_img_metadata"},
    "GeoJSON": {"type", "features"},
}

Side = Literal["left", "right"]
Unit = Literal["px", "mm", "unstated"]


@dataclass(frozen=True)
class ImageCorners:
    """The corners of one image's vertebrae.

    Attributes
    ----------
    image : its name. "rest/lateral" is a lateral image, all others are frontal ones.
    levels : (V,) vertebrae in the file's order, each once.
    corners : (V, 4, 2) column and row of top left, top right, bottom right and bottom left, as seen in the image.
    source : file and format, for messages.
    unit : of the corners: "px"; "mm" of LPS in a coronal plane, where "first" is on the right; "unstated" = px or mm,
        the file doesn't tell.
    first_on : the side of the image where "first" is (docs/conventions.md): the patient's left in frontal images, the
        front in lateral ones. None = the file doesn't tell.

    Raises
    ------
    SubjectError : an empty name, no vertebra, unknown or repeated levels, wrong shape, values that are not finite,
        corners in mm on another side.
    """

    image: str
    levels: tuple[str, ...]
    corners: Floats
    source: str = ""
    unit: Unit = "px"
    first_on: Side | None = None

    def __post_init__(self) -> None:
        levels = tuple(self.levels)
        object.__setattr__(self, "levels", levels)
        problem = _name_problem(self.image)
        if problem:
            raise SubjectError(f"image name {problem}")
        if not levels:
            raise SubjectError(f"{self.image}: no vertebra; wanted at least one")
        for level in levels:
            if level not in VERTEBRAE:
                raise SubjectError(f"{self.image}: unknown level '{level}'; wanted T1 to T12, L1 to L5")
            if levels.count(level) > 1:
                raise SubjectError(f"{self.image}: {level} is given twice; keep one")
        corners = read_only(f"{self.image}: corners", self.corners, (len(levels), 4, 2), SubjectError)
        if np.abs(corners).max() > FARTHEST:
            raise SubjectError(f"{self.image}: a corner is more than {FARTHEST:g} from the first pixel")
        object.__setattr__(self, "corners", corners)
        if self.unit == "mm" and self.first_on != "right":
            raise SubjectError(f"{self.image}: corners in mm are of LPS, with the patient's left on the right")

    @property
    def lateral(self) -> bool:
        """Whether this is a lateral image."""
        return self.image == LATERAL

    def annotation_quads(self) -> Floats:
        """(V, 4, 2) in annotation.json's order: superior-first, superior-second, inferior-second, inferior-first.

        Raises
        ------
        SubjectError : the side of "first" is not known, or the corners are not in pixels.
        """
        if self.first_on is None:
            what = "the front" if self.lateral else "the patient's left"
            raise SubjectError(
                f"{self.image}: on which side of the image {what} lies is not known; state it "
                '(dataclasses.replace with first_on="left" or "right")'
            )
        if self.unit != "px":
            raise SubjectError(f"{self.image}: the corners are not known to be in pixels (unit: {self.unit})")
        return self.corners[:, _AS_SEEN[True, self.first_on == "left"]]


@dataclass(frozen=True)
class UnreadableImage:
    """An image of a file whose corners can't be used, and why (where, what, wanted)."""

    image: str
    reason: str


@dataclass(frozen=True)
class CornerFile:
    """What a file of corners holds, image by image in the file's order."""

    path: Path
    kind: Literal["CSV", "Slicer markups", "annotation"]
    images: tuple[ImageCorners | UnreadableImage, ...]


class _Row(NamedTuple):
    """One corner as a file gives it; ``place`` is its text or its numbers."""

    where: str
    image: str
    level: str
    corner: str
    place: tuple[str | float, str | float]


class _ImageProblem(Exception):
    """A reason why one image, not the file, can't be read."""


def read_corner_file(path: str | Path) -> CornerFile:
    """Corners from a .csv, a .mrk.json or an annotation.json; what the file is follows from its name and content.

    Raises
    ------
    SubjectError : no such file, too large, not that format, or a fault that concerns the whole file (row or field,
        what was found, what is wanted).
    """
    path = Path(path)
    if path.suffix.lower() == ".csv":
        return CornerFile(path, "CSV", _read_csv(path))
    if path.suffix.lower() != ".json":
        raise SubjectError(f"{path}: wanted a .csv, a {MARKUPS_SUFFIX} or an {ANNOTATION_FILE}")
    if path.name == SUBJECT_FILE:
        raise SubjectError(f"{path}: has the person and the pushes, but no corners; name its folder, {path.parent}")
    text = read_text(path)
    content = parse_json(text, str(path))
    if isinstance(content, dict) and "markups" in content:
        return CornerFile(path, "Slicer markups", _read_markups(path, content))
    if foreign := _foreign(content):
        raise SubjectError(
            f"{path}: is a file of {foreign}, which is not read; wanted a CSV ({','.join(corner_csv.COLUMNS)}), Slicer "
            f"markups or an {ANNOTATION_FILE} of this program: write the corners as CSV"
        )
    return CornerFile(path, "annotation", _read_annotation(path, text))


def _foreign(content: object) -> str:
    """Which other program's annotation a JSON is; "" for what is not known."""
    keys = set(content) if isinstance(content, dict) else set()
    return next((name for name, wanted in _FOREIGN.items() if wanted <= keys), "")


def read_corners(path: str | Path) -> tuple[ImageCorners, ...]:
    """``read_corner_file`` where every image must be readable. Raises SubjectError for the first that is not."""
    found = []
    for image in read_corner_file(path).images:
        if isinstance(image, UnreadableImage):
            raise SubjectError(f"{path}: {image.image}: {image.reason}")
        found.append(image)
    return tuple(found)


def write_corners(path: str | Path, images: Sequence[ImageCorners]) -> None:
    """Write a .csv, a .mrk.json or an annotation.json (by the name's end), whole or not at all.

    An annotation.json that exists keeps its other images, and of these images supports and pedicles.

    Raises
    ------
    SubjectError : no image, one name twice, another file name, what the format can't hold, or no permission.
    """
    path = Path(path)
    names = [image.image for image in images]
    if not names:
        raise SubjectError(f"{path}: no image to write")
    if len(set(names)) < len(names):
        raise SubjectError(f"{path}: two images have the same name; give each its own")
    if path.name.lower().endswith(MARKUPS_SUFFIX):
        write_text(path, markups_text(images))
    elif path.suffix.lower() == ".csv":
        write_text(path, csv_text(images))
    elif path.suffix.lower() == ".json":
        _write_annotation(path, images)
    else:
        raise SubjectError(f"{path}: wanted a name that ends in .csv, {MARKUPS_SUFFIX} or .json")


def csv_text(images: Sequence[ImageCorners]) -> str:
    """The CSV of these images. Raises SubjectError for corners that are not known to be in pixels, as a CSV's are."""
    for image in images:
        if image.unit != "px":
            raise SubjectError(
                f"{image.image}: corners in pixels are wanted for a CSV (unit: {image.unit}); write a {MARKUPS_SUFFIX}"
            )
    return corner_csv.text(
        (image.image, level, corner, x, y)
        for image in images
        for level, quad in zip(image.levels, image.corners.tolist())
        for corner, (x, y) in zip(CORNERS, quad)
    )


def markups_text(images: Sequence[ImageCorners]) -> str:
    """The Slicer markups of these images."""
    return corner_markups.content([_as_point_list(image) for image in images]).decode()


def _read_csv(path: Path) -> tuple[ImageCorners | UnreadableImage, ...]:
    rows = corner_csv.parse(read_exported_text(path, LARGEST_CSV), str(path))
    return _gathered((_Row(f"row {r.line}", r.image, r.level, r.corner, (r.x, r.y)) for r in rows), path, "CSV")


def _read_markups(path: Path, content: object) -> tuple[ImageCorners | UnreadableImage, ...]:
    fallback = path.name[: -len(MARKUPS_SUFFIX)] if path.name.lower().endswith(MARKUPS_SUFFIX) else path.stem
    found: list[ImageCorners | UnreadableImage] = []
    names: set[str] = set()
    for entry in corner_markups.parse(content, str(path), fallback):
        name, reason = entry if isinstance(entry, tuple) else (entry.name, "")
        problem = _name_problem(name)
        if problem:
            raise SubjectError(f"{path}: the name of a list {problem}")
        if name in names:
            raise SubjectError(f"{path}: two lists are named '{name}'; give each image its own name")
        names.add(name)
        if len(names) > MOST_IMAGES:
            raise SubjectError(f"{path}: more than {MOST_IMAGES} images; split the file")
        if isinstance(entry, tuple):
            found.append(UnreadableImage(name, reason))
            continue
        rows = []
        for i, (label, (x, y)) in enumerate(zip(entry.labels, entry.points.tolist())):
            level, _, corner = label.strip().partition(" ")
            rows.append(_Row(f"point {i + 1} '{printable(label)}'", name, level, corner.strip(), (x, y)))
        side: Side | None = "right" if entry.plane == "coronal" else None
        found += _gathered(rows, path, "Slicer markups", entry.unit, side)
    return tuple(found)


def _gathered(
    rows: Iterable[_Row], path: Path, kind: str, unit: Unit = "px", first_on: Side | None = None
) -> tuple[ImageCorners | UnreadableImage, ...]:
    """Rows by image. The first fault in an image's rows is the reason why it can't be used."""
    images: dict[str, dict[str, dict[str, tuple[float, float]]]] = {}
    reasons: dict[str, str] = {}
    for row in rows:
        problem = _name_problem(row.image)
        if problem:
            raise SubjectError(f"{path}: {row.where}: image name {problem}")
        levels = images.setdefault(row.image, {})
        if len(images) > MOST_IMAGES:
            raise SubjectError(f"{path}: {row.where}: more than {MOST_IMAGES} images; split the file")
        try:
            level, corner, place = _checked(row)
            if corner in levels.setdefault(level, {}):
                raise _ImageProblem(f"{row.where}: {level} {corner} is given twice; keep one")
            levels[level][corner] = place
        except _ImageProblem as error:
            reasons.setdefault(row.image, str(error))
    if not images:
        raise SubjectError(f"{path}: no corner in it; wanted a row for each corner")
    found: list[ImageCorners | UnreadableImage] = []
    for image, levels in images.items():
        lacking = [f"{level} {corner}" for level, corner in product(levels, CORNERS) if corner not in levels[level]]
        if image not in reasons and lacking:
            reasons[image] = f"no {lacking[0]}; wanted all four corners of each vertebra"
        if image in reasons:
            found.append(UnreadableImage(image, reasons[image]))
            continue
        corners = np.array([[levels[level][corner] for corner in CORNERS] for level in levels])
        if unit != "mm" and (shares := shares_of_size(corners)):
            found.append(UnreadableImage(image, shares))
            continue
        found.append(ImageCorners(image, tuple(levels), corners, f"{path.name} ({kind})", unit, first_on))
    return tuple(found)


def _checked(row: _Row) -> tuple[str, str, tuple[float, float]]:
    level, corner = row.level.upper(), row.corner.lower()
    if level not in VERTEBRAE:
        raise _ImageProblem(f"{row.where}: unknown level '{printable(row.level)}', wanted T1 to T12, L1 to L5")
    if corner not in CORNERS:
        raise _ImageProblem(
            f"{row.where}: unknown corner '{printable(row.corner)}', wanted one of {', '.join(CORNERS)}"
        )
    place = []
    for column, value in zip(("x", "y"), row.place):
        if isinstance(value, str) and math.isnan(plain_number(value)):
            raise _ImageProblem(f"{row.where}: {column} is '{printable(value)}', wanted a number (decimal point)")
        if abs(float(value)) > FARTHEST:
            found = printable(str(value))
            raise _ImageProblem(f"{row.where}: {column} is {found}, wanted at most {FARTHEST:g} either way")
        place.append(float(value))
    return level, corner, (place[0], place[1])


def _read_annotation(path: Path, text: str) -> tuple[ImageCorners, ...]:
    try:
        annotation = Annotation.model_validate_json(text)
    except ValidationError as error:
        raise SubjectError(f"{path}: {complaint_of(error, kind=Annotation)}") from None
    found = []
    for name, image in annotation.images.items():
        of_push = PushImage.named(name)
        # Only subject.json tells what a radiograph from another side is; a frame may hold pedicles alone.
        if (of_push and of_push.view) or not image.vertebrae:
            continue
        quads = image.pixels()
        # All vertebrae of a readable annotation agree in both, as ``records`` checks.
        across, down = quads[:, [1, 2]] - quads[:, [0, 3]], quads[:, [3, 2]] - quads[:, [0, 1]]
        seen = bool(down[..., 1].sum() > 0.0), bool(across[..., 0].sum() > 0.0)
        side: Side = "left" if seen[1] else "right"
        source = f"{path.name} (annotation)"
        found.append(ImageCorners(name, tuple(image.vertebrae), quads[:, _AS_SEEN[seen]], source, "px", side))
    if not found:
        raise SubjectError(f"{path}: images: none; wanted at least one")
    return tuple(found)


def _write_annotation(path: Path, images: Sequence[ImageCorners]) -> None:
    content = parse_json(read_text(path), str(path)) if path.exists() else None
    if content is None:
        content = {"schema_version": SCHEMA_VERSION, "images": {}}
    elif not isinstance(content, dict) or not isinstance(content.get("images"), dict):
        raise SubjectError(f"{path}: holds no annotation; it is left as it is")
    for image in images:
        quads = image.annotation_quads()
        entry = content["images"].setdefault(image.image, {})
        if not isinstance(entry, dict):
            raise SubjectError(f"{path}: images.{image.image}: holds no annotation; it is left as it is")
        entry["vertebrae"] = {level: quad.tolist() for level, quad in zip(image.levels, quads)}
    try:
        Annotation.model_validate(content)
    except ValidationError as error:
        raise SubjectError(f"{path}: not written: {complaint_of(error)}") from None
    write_json(path, content)


def _as_point_list(image: ImageCorners) -> corner_markups.PointList:
    labels = tuple(f"{level} {corner}" for level, corner in product(image.levels, CORNERS))
    plane: corner_markups.Plane = "coronal" if image.unit == "mm" else "image"
    return corner_markups.PointList(image.image, labels, image.corners.reshape(-1, 2), plane, image.unit)


def _name_problem(name: str) -> str:
    if not name.strip():
        return "is empty"
    if len(name) > LONGEST_NAME:
        return f"has {len(name)} characters, wanted at most {LONGEST_NAME}"
    return "" if name.isprintable() else "holds characters that can't be printed"
