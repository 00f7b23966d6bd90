"""What annotation.json may hold: its schema, read strictly (docs/subject-folder.md)."""

from __future__ import annotations

from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, field_validator, model_validator

from spinestiff.anatomy.names import VERTEBRAE
from spinestiff.arrays import Floats
from spinestiff.imaging.planar import cross
from spinestiff.imaging.spine_shape import CLEARLY, across, quarter_turns
from spinestiff.subject.image_names import PUSH, PushImage, frame_image
from spinestiff.subject.record_reading import Record, shown_key
from spinestiff.subject.records import Pair, Point, VertebraName
from spinestiff.words import counted

LARGEST_SHARE = 2.0
"""Numbers that are no larger are shares of the picture's width and height: no spine lies in so few pixels."""
FEWEST_VERTEBRAE = 8
MOST_TURNED_DEG = 45.0
"""Of a vertebra between two frames of a push: half of what corners begun at the wrong one make of it."""
FEWEST_OF_VIEW = 3
Quad = Annotated[tuple[Point, Point, Point, Point], Field(strict=False)]


class ImageAnnotation(Record):
    """Corners in one image, in pixels: (column, row), the first pixel's centre at (0, 0).

    Attributes
    ----------
    vertebrae : for each visible vertebra four corners: superior-left, superior-right, inferior-right, inferior-left of
        the patient in a frontal image; superior-anterior, superior-posterior, inferior-posterior, inferior-anterior in
        a lateral one.
    supports : points on the pelvis and on the shoulder that rests against its pad; they show whether these moved.
    pedicles : centres of the left and the right pedicle; they determine axial rotation.
    """

    vertebrae: dict[VertebraName, Quad]
    supports: dict[Literal["pelvis", "shoulder"], Annotated[tuple[Point, ...], Field(min_length=1, strict=False)]] = (
        Field(default_factory=dict)
    )
    pedicles: dict[VertebraName, Pair] = Field(default={})

    @field_validator("vertebrae")
    @classmethod
    def _is_a_spine(cls, vertebrae: dict[VertebraName, Quad]) -> dict[VertebraName, Quad]:
        ordered = dict(sorted(vertebrae.items(), key=lambda item: VERTEBRAE.index(item[0])))
        if ordered:
            if shares := shares_of_size(np.array(list(ordered.values()))):
                raise ValueError(shares)
            _check_quads(tuple(ordered), np.array(list(ordered.values())))
        return ordered

    @model_validator(mode="after")
    def _shows_something(self) -> Self:
        if not self.vertebrae and not self.pedicles:
            raise ValueError("vertebrae: found no vertebra, wanted at least one")
        return self

    def pixels(self) -> Floats:
        """(Nv, 4, 2) column, row, head to foot."""
        return np.array(list(self.vertebrae.values()), dtype=float).reshape(-1, 4, 2)


class Annotation(Record):
    """``annotation.json``: corners in the rest images, in the first frame of each push and, at will, in others of them.

    Attributes
    ----------
    schema_version : 1.
    images : by name (``image_names``).
    """

    schema_version: Literal[1]
    images: dict[str, ImageAnnotation]

    @field_validator("images")
    @classmethod
    def _points_are_where_they_serve(cls, images: dict[str, ImageAnnotation]) -> dict[str, ImageAnnotation]:
        for name, image in images.items():
            of_push = PushImage.named(name)
            aside, later = bool(of_push and of_push.view), bool(of_push and of_push.later)
            first = frame_image(of_push.push) if of_push else ""
            fewest = FEWEST_OF_VIEW if aside else 0 if later else FEWEST_VERTEBRAE
            if len(image.vertebrae) < fewest:
                raise ValueError(
                    f"{shown_key(name)}.vertebrae: found {counted(len(image.vertebrae), 'vertebra', 'vertebrae')}, "
                    f"wanted at least {fewest}"
                )
            if image.supports and (aside or later):
                raise ValueError(f"{shown_key(name)} has supports; wanted them in the push's first frame, {first}")
            if image.supports and not name.startswith(PUSH):
                raise ValueError(
                    f"{shown_key(name)} has supports; wanted them in push images only, where they can move"
                )
            if later and first in images:
                _check_turned(name, image, images[first])
        return images


def shares_of_size(pixels: Floats) -> str:
    """Why corners can't be pixels but are shares of the picture's size; "" where they can."""
    if np.abs(pixels).max() > LARGEST_SHARE:
        return ""
    return (
        f"all corners lie within {np.abs(pixels).max():g} of the first pixel: shares of the image's size, "
        "wanted pixels; multiply x by its columns and y by its rows"
    )


def _check_quads(names: tuple[str, ...], quads: Floats) -> None:
    """Raise ValueError, naming the vertebra, for corners that are out of order in any view.

    What is left and what is up depends on the view, which is not known here; that vertebrae agree with each other and
    run from head to foot can be told without it.
    """
    edges = np.roll(quads, -1, axis=1) - quads
    after = np.roll(edges, -1, axis=1)
    turns = edges[..., 0] * after[..., 1] - edges[..., 1] * after[..., 0]
    sense = np.sign(turns)
    for name, turn in zip(names, sense):
        if not (turn == turn[0]).all() or turn[0] == 0.0:
            raise ValueError(f"{name}: the corners in this order make no convex quadrilateral; {_ORDER}")
    usual = 1.0 if sense[:, 0].sum() >= 0 else -1.0
    for name, turn in zip(names, sense[:, 0]):
        if turn != usual:
            raise ValueError(f"{name}: the corners are mirrored against the other vertebrae; {_ORDER}")
    centres = quads.mean(axis=1)
    # One vertebra alone has no other to lie above: its own corners say where up is, and only the view can tell more.
    up = centres[0] - centres[-1] if len(quads) > 1 else quads[0, :2].mean(axis=0) - quads[0, 2:].mean(axis=0)
    heights = centres @ up
    for i in range(1, len(names)):
        if heights[i] >= heights[i - 1]:
            raise ValueError(f"{names[i]}: does not lie below {names[i - 1]}; wanted the vertebrae from head to foot")
    for name, turns in zip(names, _quarter_turns(names, quads * [usual, 1.0])):
        if turns % 2:
            raise ValueError(f"{name}: the corners begin at the wrong one, a quarter turn off; {_ORDER}")
    for name, quad in zip(names, quads):
        if (quad[0] + quad[1] - quad[2] - quad[3]) @ up <= 0.0:
            raise ValueError(f"{name}: the superior corners lie below the inferior ones; {_ORDER}")


def _quarter_turns(names: tuple[str, ...], clockwise: Floats) -> np.ndarray:
    """(V,) quarter turns by which corners (V, 4, 2) are clearly off; 0 where nothing near tells."""
    if len(names) < 2:
        return np.zeros(len(names), dtype=int)
    found = quarter_turns(clockwise, [VERTEBRAE.index(name) for name in names], [True] * len(names))
    return np.where(found.ahead < CLEARLY, 0, found.turns)


def _check_turned(where: str, image: ImageAnnotation, first: ImageAnnotation) -> None:
    """Raise ValueError for a vertebra that is turned against the push's first frame as no push turns one."""
    for name in image.vertebrae:
        if name in first.vertebrae:
            before, now = (across(np.array(frame.vertebrae[name])) for frame in (first, image))
            degrees = float(np.degrees(np.abs(np.arctan2(cross(before, now), before @ now))))
            if degrees > MOST_TURNED_DEG:
                raise ValueError(
                    f"{where}.vertebrae.{name}: turned by {degrees:.0f} degrees since the push's first frame, wanted "
                    f"at most {MOST_TURNED_DEG:g}; {_ORDER}"
                )


_ORDER = (
    "wanted superior-left, superior-right, inferior-right, inferior-left of the patient "
    "(lateral: superior-anterior, superior-posterior, inferior-posterior, inferior-anterior)"
)
