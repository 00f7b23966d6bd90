"""What phantom.json may hold: a bench phantom, measurements of its parts, and its frames (docs/bench-phantom.md)."""

from __future__ import annotations

import itertools
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from spinestiff.anatomy.names import VERTEBRAE
from spinestiff.subject.record_reading import Record
from spinestiff.subject.records import GAUGE_LIMIT_N, VertebraName

PHANTOM_FILE = "phantom.json"
CORNERS_FILE = "corners.csv"
FEWEST_WEIGHTS = 4
Millimetres = Annotated[float, Field(gt=0.0, le=5000.0)]
Pixels = Annotated[int, Field(ge=16, le=100_000)]


class PictureRecord(Record):
    """How pictures were taken; a camera has both distances equal, and millimetres of a pixel in the marks' plane.

    Attributes
    ----------
    source_detector_mm, source_marks_mm : from focal spot or lens.
    pixel_mm : at the detector.
    size_px : columns, rows.
    corner_sd_mm : standard deviation with which a mark is found, along one axis, in the marks' plane.
    """

    source_detector_mm: Annotated[float, Field(ge=300.0, le=100_000.0)]
    source_marks_mm: Annotated[float, Field(ge=300.0, le=100_000.0)]
    pixel_mm: Annotated[float, Field(gt=0.0, le=2.0)]
    size_px: Annotated[tuple[Pixels, Pixels], Field(strict=False)]
    corner_sd_mm: Annotated[float, Field(gt=0.0, le=5.0)] = 0.1


class JointRecord(Record):
    """The bench measurement of the joint below a block: moments that weights on a lever made, and how far it turned.

    Attributes
    ----------
    block : the block above it.
    moments_nmm : weight times lever, N mm. turns_deg : seen from the front, above 0 as the moment.
    """

    block: VertebraName
    moments_nmm: Annotated[tuple[float, ...], Field(strict=False, min_length=FEWEST_WEIGHTS)]
    turns_deg: Annotated[tuple[float, ...], Field(strict=False, min_length=FEWEST_WEIGHTS)]

    @model_validator(mode="after")
    def _one_turn_a_moment(self) -> Self:
        if len(self.moments_nmm) != len(self.turns_deg):
            raise ValueError(
                f"{len(self.moments_nmm)} moments_nmm but {len(self.turns_deg)} turns_deg; wanted one turn a moment"
            )
        if len(set(self.moments_nmm)) < FEWEST_WEIGHTS:
            raise ValueError(f"fewer than {FEWEST_WEIGHTS} different moments_nmm")
        return self


class RubberRecord(Record):
    """The block that the column is cast in, and the modulus of a bar of the same pour.

    Attributes
    ----------
    young_sd_mpa : standard deviation of ``young_mpa``. spacing_mm : of the mesh.
    """

    width_mm: Millimetres
    depth_mm: Millimetres
    young_mpa: Annotated[float, Field(gt=0.0, le=100.0)]
    young_sd_mpa: Annotated[float, Field(gt=0.0, le=100.0)]
    poisson: Annotated[float, Field(ge=0.0, le=0.499)] = 0.49
    spacing_mm: Annotated[float, Field(ge=5.0, le=100.0)] = 14.0


class FrameRecord(Record):
    """A picture.

    Attributes
    ----------
    image : its name in corners.csv.
    force_n : reading of the gauge; 0 without a push, and then neither block nor side.
    side : the phantom's side that the force comes from.
    block, height_mm, aside_mm : the pushed point: mm above the block's middle, and from it towards ``side``; below 0
        where a thread pulls at the far side.
    use : "fit" or "predict".
    """

    image: Annotated[str, Field(min_length=1, max_length=200)]
    force_n: Annotated[float, Field(ge=0.0, le=GAUGE_LIMIT_N)]
    block: VertebraName | None = None
    side: Literal["left", "right"] | None = None
    height_mm: Annotated[float, Field(ge=-500.0, le=500.0)] = 0.0
    aside_mm: Annotated[float, Field(ge=-500.0, le=500.0)] = 0.0
    use: Literal["fit", "predict"] = "fit"

    @model_validator(mode="after")
    def _a_push_has_a_place(self) -> Self:
        given = self.block is not None and self.side is not None
        none = self.block is None and self.side is None
        if not (given if self.force_n > 0.0 else none):
            raise ValueError("wanted block and side with a force_n above 0, and neither with 0")
        return self


class PhantomRecord(Record):
    """``phantom.json``.

    Attributes
    ----------
    levels : blocks, top to bottom, named in the order of a spine's vertebrae.
    block_mm : width, height, depth. gap_mm : free length of the leaf springs.
    marks_mm : between a block's marks, side to side and along. marks_front_mm : before the column's middle.
    joints : one below each block, in any order.
    bench_scale_sd : relative standard deviation that all joints' measurements share: lever, weights.
    rubber : what the column is cast in, if anything.
    errors : standard deviations of what is not quite known that differ from the usual ones of a bench, by name
        (``estimation.priors.Priors``).
    """

    schema_version: Literal[1]
    name: Annotated[str, Field(min_length=1, max_length=200)]
    picture: PictureRecord
    levels: Annotated[tuple[VertebraName, ...], Field(strict=False, min_length=3)]
    block_mm: Annotated[tuple[Millimetres, Millimetres, Millimetres], Field(strict=False)]
    gap_mm: Millimetres
    marks_mm: Annotated[tuple[Millimetres, Millimetres], Field(strict=False)]
    marks_front_mm: Annotated[float, Field(ge=-1000.0, le=1000.0)]
    joints: Annotated[tuple[JointRecord, ...], Field(strict=False)]
    bench_scale_sd: Annotated[float, Field(ge=0.0, le=0.5)] = 0.01
    rubber: RubberRecord | None = None
    errors: dict[str, Annotated[float, Field(ge=0.0, le=1000.0)]] = Field(default={})
    frames: Annotated[tuple[FrameRecord, ...], Field(strict=False, min_length=2)]

    @model_validator(mode="after")
    def _belongs_together(self) -> Self:
        for what, names in (
            ("levels", self.levels),
            ("joints", tuple(joint.block for joint in self.joints)),
            ("frames", tuple(frame.image for frame in self.frames)),
        ):
            twice = [name for name in names if names.count(name) > 1]
            if twice:
                raise ValueError(f"{what}: '{twice[0]}' is given twice; keep one")
        for upper, lower in itertools.pairwise(self.levels):
            if VERTEBRAE.index(upper) > VERTEBRAE.index(lower):
                raise ValueError(
                    f"levels: {upper} is above {lower}; wanted the blocks from top to bottom, named as a spine's are"
                )
        lacking = [level for level in self.levels if level not in {joint.block for joint in self.joints}]
        if lacking or len(self.joints) != len(self.levels):
            raise ValueError(f"joints of {len(self.joints)} blocks; wanted one below each of {', '.join(self.levels)}")
        for i, frame in enumerate(self.frames):
            if frame.block is not None and frame.block not in self.levels:
                raise ValueError(f"frames[{i}].block: {frame.block} is none of the levels")
        fitted = [frame for frame in self.frames if frame.use == "fit"]
        if not any(frame.force_n == 0.0 for frame in fitted) or not any(frame.force_n > 0.0 for frame in fitted):
            raise ValueError("frames: wanted one without force and one with a force to fit")
        return self
