"""What subject.json and annotation.json may hold: their schemas, read strictly (docs/subject-folder.md).

Each refusal is one line: file, field, found, wanted. What the folder holds beside the two files is read by ``subject``.
"""

from __future__ import annotations

import json
import re
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Annotated, Any, Final, Literal, Self, TypeVar

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator, model_validator
from pydantic_core import ErrorDetails

from spinestiff.anatomy.axes import Axis, Unit, body_axes
from spinestiff.anatomy.names import VERTEBRAE
from spinestiff.anatomy.regions import check_parameters
from spinestiff.arrays import Floats
from spinestiff.errors import SubjectError, TorsoError
from spinestiff.files import parse_json, read_text
from spinestiff.imaging.spine_shape import CLEARLY, across, cross, quarter_turns
from spinestiff.words import counted

SCHEMA_VERSION: Final = 1
SUBJECT_FILE = "subject.json"
ANNOTATION_FILE = "annotation.json"
SUBJECT_PAGE = "docs/subject-folder.md"
RESULTS = "results"
"""Folder of what is made from the others."""
REST_IMAGES = {"rest/frontal": "rest/frontal.dcm", "rest/lateral": "rest/lateral.dcm"}
LATERAL = "rest/lateral"
FEWEST_VERTEBRAE = 8
GAUGE_LIMIT_N = 500.0
"""What the force gauge of the set-up measures accurately (paper 2.1)."""
MOST_TURNED_DEG = 45.0
"""Of a vertebra between two frames of a push: half of what corners begun at the wrong one make of it."""
DISTANCES_MM = (30.0, 1000.0)
LEVELS = (1.0, 12.0)
"""Ribs."""
HEIGHTS_CM = (120.0, 200.0)
OLDEST = 120.0
"""Years; an age is above 0."""
FARTHEST_SOURCE_MM, LARGEST_PIXEL_MM = 10_000.0, 5.0
FURTHER_FRAME = r"(?P<push>push/[^/]+)/(?P<frame>[1-9][0-9]{0,3})"
"""Name of an annotated frame of a push after its first, which is push/<id>."""
FURTHER_VIEW = r"(?P<push>push/[^/]+)/(?P<frame>0|[1-9][0-9]{0,3})/(?P<view>[^/]+)"
"""Name of a radiograph of a push's frame from another side."""
FEWEST_OF_VIEW = 3
MARKER_NAME = r"[A-Za-z0-9][A-Za-z0-9._-]{0,31}"
MOST_TURNED_VIEW_DEG = 40.0
"""Of an oblique radiograph, against the frontal or lateral one; beyond, it is nearer to the other of the two."""
IDENTIFIER = r"^[A-Za-z0-9][A-Za-z0-9._-]{0,63}$"
WANTED_ID = "1 to 64 letters (A to Z), digits, '.', '_' or '-', the first a letter or digit"
LONGEST_PATH = 250

Role = Literal["training", "validation", "unused"]
VertebraName = Literal[
    "T1", "T2", "T3", "T4", "T5", "T6", "T7", "T8", "T9", "T10", "T11", "T12", "L1", "L2", "L3", "L4", "L5"
]  # fmt: skip
# Lists pass for tuples here (JSON has nothing else); what is in them is checked strictly.
Point = Annotated[tuple[float, float], Field(strict=False)]
Quad = Annotated[tuple[Point, Point, Point, Point], Field(strict=False)]
Pair = Annotated[tuple[Point, Point], Field(strict=False)]
Identifier = Annotated[str, Field(pattern=IDENTIFIER)]
Distance = Annotated[float, Field(ge=DISTANCES_MM[0], le=DISTANCES_MM[1])]


class _Record(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False)


def _inside(path: str) -> str:
    absolute = PurePosixPath(path).is_absolute() or PureWindowsPath(path).drive or path.startswith("\\")
    if absolute or "\\" in path or ".." in PurePosixPath(path).parts or not path.strip() or "\0" in path:
        raise ValueError(f"found {_shown(path)}, wanted a path inside the subject folder, with / and without ..")
    if len(path) > LONGEST_PATH or not path.isprintable():
        raise ValueError(f"found {_shown(path)}, wanted at most {LONGEST_PATH} characters that can be printed")
    return path


class ScaleRecord(_Record):
    """A known length in one image, which sets its millimetres where the file has no pixel spacing.

    Either an object or a vertebra that is annotated in that image.

    Attributes
    ----------
    object_mm, object_px : length of an object, mm, and its two ends, (column, row).
    plane : where the object lay: at the patient plane (the default) or on the detector.
    vertebra, width_mm : size of a vertebral body across the image, mm: its breadth in frontal views, its depth in
        lateral ones, halfway between its endplates.
    """

    object_mm: Annotated[float, Field(ge=5.0, le=1000.0)] | None = None
    object_px: Pair | None = None
    plane: Literal["patient", "detector"] | None = None
    vertebra: VertebraName | None = None
    width_mm: Annotated[float, Field(ge=10.0, le=80.0)] | None = None

    @model_validator(mode="after")
    def _is_one_of_two(self) -> Self:
        object_given = [self.object_mm is not None, self.object_px is not None]
        vertebra_given = [self.vertebra is not None, self.width_mm is not None]
        whole = (all(object_given) and not any(vertebra_given)) or (
            all(vertebra_given) and not any(object_given) and self.plane is None
        )
        if not whole:
            raise ValueError("wanted object_mm, object_px and perhaps plane; or vertebra and width_mm")
        return self


class XRayRecord(_Record):
    """X-ray geometry where the DICOM files lack it; a value that contradicts a file is refused.

    Attributes
    ----------
    source_detector_mm, source_patient_mm : mm, along the detector's normal.
    imager_pixel_mm : pixel pitch at the detector, mm.
    orientation : "standard" = in files without an orientation of their own columns grow to the patient's left (in
        lateral views to anterior) and rows to the feet.
    scale : known lengths, by the image in which they were marked.
    """

    source_detector_mm: Annotated[float, Field(gt=0.0, le=FARTHEST_SOURCE_MM)] | None = None
    source_patient_mm: Annotated[float, Field(gt=0.0, le=FARTHEST_SOURCE_MM)] | None = None
    imager_pixel_mm: Annotated[float, Field(gt=0.0, le=LARGEST_PIXEL_MM)] | None = None
    orientation: Literal["standard"] | None = None
    scale: dict[str, ScaleRecord] | None = None


class FurtherViewRecord(_Record):
    """Radiographs of a push's frames from another side.

    Attributes
    ----------
    id : name, unique in the push, also in ``annotation.json`` as push/<id>/<frame>/<view>.
    kind : what it is, or what it is turned from: "lateral" or "frontal".
    files : file or folder of the radiographs, relative to the subject folder.
    frames : the push's frame (0-based) that each of them belongs to, in their order: it has that frame's force.
    turned_deg : how far the patient was turned to the left about the vertical, against ``kind``.
    """

    id: Identifier
    kind: Literal["frontal", "lateral"]
    files: str
    frames: Annotated[tuple[Annotated[int, Field(ge=0)], ...], Field(min_length=1, strict=False)]
    turned_deg: Annotated[float, Field(ge=-MOST_TURNED_VIEW_DEG, le=MOST_TURNED_VIEW_DEG)] = 0.0

    @field_validator("files")
    @classmethod
    def _stay_inside(cls, path: str) -> str:
        return _inside(path)

    @field_validator("frames")
    @classmethod
    def _are_different(cls, frames: tuple[int, ...]) -> tuple[int, ...]:
        for i, frame in enumerate(frames):
            if frame in frames[:i]:
                raise ValueError(f"found frame {frame} twice, wanted each once")
        return frames


class ScanAxes(_Record):
    """Which axes of a scan, or of cameras, run to the body's left, up and to the front."""

    left: Axis
    up: Axis
    front: Axis

    @model_validator(mode="after")
    def _are_a_frame(self) -> Self:
        try:
            body_axes(self.left, self.up, self.front)
        except SubjectError as error:
            raise ValueError(str(error)) from None
        return self


class MarkersRecord(_Record):
    """Markers on the skin of the trunk, seen by cameras or a surface scanner in each frame of a push.

    Attributes
    ----------
    file : CSV table of their places, relative to the subject folder (``marker_table``).
    unit : of its coordinates. axes : its axes.
    side : of the trunk, that all of them lie on.
    shown : where the frontal radiograph without force shows some of them, (column, row), by name.
    """

    file: str
    unit: Unit
    axes: ScanAxes
    side: Literal["front", "back", "both"]
    shown: Annotated[dict[Annotated[str, Field(pattern=f"^{MARKER_NAME}$")], Point], Field(min_length=1, max_length=60)]

    @field_validator("file")
    @classmethod
    def _stays_inside(cls, path: str) -> str:
        return _inside(path)


class PushRecord(_Record):
    """One series of radiographs under a growing rib force.

    Attributes
    ----------
    id : name, unique in the subject.
    side : the side that is pushed, the patient's.
    level : rib level of the push point, 1 to 12; 8.5 = between ribs 8 and 9.
    d21_mm, d31_mm : vertical distances shoulder to pelvis and shoulder to push point (Eqs. 1-2), mm.
    frames : file or folder of the radiographs, relative to the subject folder.
    forces_n : magnitude for each frame, N.
    roles : for each frame; left out = not chosen yet, all "unused".
    views : radiographs of some of the frames from other sides.
    markers : on the skin, seen in each frame.
    """

    id: Identifier
    side: Literal["left", "right"]
    level: Annotated[float, Field(ge=LEVELS[0], le=LEVELS[1])]
    d21_mm: Distance
    d31_mm: Distance
    frames: str
    forces_n: Annotated[tuple[float, ...], Field(min_length=1, strict=False)]
    roles: Annotated[tuple[Role, ...], Field(strict=False)]
    views: Annotated[tuple[FurtherViewRecord, ...], Field(strict=False)] = ()
    markers: MarkersRecord | None = None

    @model_validator(mode="before")
    @classmethod
    def _may_be_chosen_later(cls, data: Any) -> Any:
        if isinstance(data, dict) and "roles" not in data and isinstance(data.get("forces_n"), (list, tuple)):
            return {**data, "roles": ["unused"] * len(data["forces_n"])}
        return data

    @field_validator("frames")
    @classmethod
    def _stays_inside(cls, path: str) -> str:
        return _inside(path)

    @field_validator("forces_n")
    @classmethod
    def _are_magnitudes(cls, forces: tuple[float, ...]) -> tuple[float, ...]:
        for i, force in enumerate(forces):
            if force < 0.0:
                raise ValueError(f"frame {i} has {force:g} N; forces are magnitudes, the sign comes from the side")
            if force > GAUGE_LIMIT_N:
                raise ValueError(f"frame {i} has {force:g} N, wanted at most {GAUGE_LIMIT_N:g} N (the gauge's limit)")
        return forces

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        if len(self.roles) != len(self.forces_n):
            raise ValueError(
                f"found {len(self.forces_n)} forces_n and {len(self.roles)} roles, wanted one of each a frame"
            )
        if self.d31_mm >= self.d21_mm:
            raise ValueError(
                f"d31_mm {self.d31_mm:g} is not below d21_mm {self.d21_mm:g}; "
                "wanted the push between shoulder and pelvis (Eqs. 1-2)"
            )
        names = [view.id.casefold() for view in self.views]
        for i, view in enumerate(self.views):
            if names[i] in names[:i]:
                raise ValueError(f"views[{i}].id: '{view.id}' is used twice; give each view its own id")
            if max(view.frames) >= len(self.forces_n):
                raise ValueError(
                    f"views[{i}].frames: found frame {max(view.frames)}, but the push has "
                    f"{counted(len(self.forces_n), 'frame')}, counted from 0"
                )
        if self.markers is not None and min(self.forces_n) > 0.0:
            raise ValueError(
                f"markers: no frame is without force, the least is {min(self.forces_n):g} N; wanted one, from which "
                "the markers' motion counts"
            )
        used = [force for force, role in zip(self.forces_n, self.roles) if role != "unused"]
        if used and not any(used):
            raise ValueError("all forces are zero, so there is nothing to identify; check the force log")
        return self

    @property
    def image(self) -> str:
        """Name of the push's first frame in the annotation."""
        return f"push/{self.id}"

    def frame_image(self, frame: int) -> str:
        """Name of a frame (0-based) in the annotation: push/<id> for the first, push/<id>/<frame> for others."""
        return self.image if frame == 0 else f"{self.image}/{frame}"

    def view_image(self, frame: int, view: str) -> str:
        """Name of a frame's radiograph from another side in the annotation."""
        return f"{self.image}/{frame}/{view}"

    def least_of(self, view: FurtherViewRecord) -> int:
        """The first of a view's frames with the least force among them: it has to be marked by hand."""
        return min(sorted(view.frames), key=lambda frame: self.forces_n[frame])

    @property
    def unloaded(self) -> int:
        """The first of the frames with the least force."""
        return self.forces_n.index(min(self.forces_n))

    @property
    def sign(self) -> int:
        """+1 for a push from the patient's right, -1 from the left (towards a left or a right curve, Table 2)."""
        return 1 if self.side == "right" else -1

    def frames_of(self, role: Role) -> tuple[int, ...]:
        """Indices of the frames with a role."""
        return tuple(i for i, given in enumerate(self.roles) if given == role)


class TrunkRecord(_Record):
    """Horizontal extents of the trunk at a level, by tape or caliper, mm: side to side and front to back."""

    breadth_mm: Annotated[float, Field(ge=100.0, le=600.0)]
    depth_mm: Annotated[float, Field(ge=80.0, le=500.0)]


class ScanRecord(_Record):
    """A surface scan of the trunk.

    Attributes
    ----------
    file : STL, OBJ, PLY or VTP, relative to the subject folder.
    unit : of its coordinates.
    axes : its axes.
    """

    file: str
    unit: Unit
    axes: ScanAxes

    @field_validator("file")
    @classmethod
    def _stays_inside(cls, path: str) -> str:
        return _inside(path)


Pelvis = Literal["estimated", "level", "hinge", "dead-loads"]
Wall = Literal["bilateral", "one-sided"]


class SubjectRecord(_Record):
    """``subject.json``: the person, the X-ray geometry and the pushes.

    Attributes
    ----------
    schema_version : 1.
    id : name without spaces.
    age : years.
    sex : "female" or "male".
    height_cm : standing height.
    mass_kg : body mass; with it the template takes the sizes of this age, sex, height and mass.
    xray : geometry where DICOM lacks it.
    torso : a torso file of the subject's own bones (``spinestiff torso import``) instead of the template, relative to
        the subject folder.
    pushes : none before the first was recorded; where roles are chosen, with at least one training frame under a force.
    trunk : optional extents of the trunk, by the vertebra at whose height they were taken.
    skin_scan : optional surface scan of the trunk.
    pelvis : how it is held in the model: "estimated", at an obliquity that is not known, "level", on a "hinge", or with
        "dead-loads" at shoulder and pelvis (Eqs. 1-2).
    priors : standard deviations of what is not quite known that differ from the usual ones, by name
        (``estimation.priors.Priors``).
    wall : whether the back wall holds both ways ("bilateral") or only pushes ("one-sided").
    parameters : ratios to estimate, by name (``anatomy.regions``); None: lateral bending and tissue.
    population : whose ratios are held as a prior (``estimation.ratio_priors``); None: nobody's.
    """

    schema_version: Literal[1]
    id: Identifier
    age: Annotated[float, Field(gt=0.0, le=OLDEST)]
    sex: Literal["female", "male"]
    height_cm: Annotated[float, Field(ge=HEIGHTS_CM[0], le=HEIGHTS_CM[1])]
    mass_kg: Annotated[float, Field(gt=0.0, le=300.0)] | None = None
    xray: XRayRecord = XRayRecord()
    torso: str | None = None
    pushes: Annotated[tuple[PushRecord, ...], Field(strict=False)]
    trunk: dict[VertebraName, TrunkRecord] = {}
    skin_scan: ScanRecord | None = None
    pelvis: Pelvis = "estimated"
    wall: Wall = "bilateral"
    priors: dict[str, Annotated[float, Field(ge=0.0, le=1000.0)]] = {}
    parameters: Annotated[tuple[str, ...], Field(min_length=1, max_length=40, strict=False)] | None = None
    population: str | None = None

    @field_validator("parameters")
    @classmethod
    def _are_parameters(cls, names: tuple[str, ...] | None) -> tuple[str, ...] | None:
        if names is not None:
            try:
                check_parameters(names)
            except TorsoError as error:
                raise ValueError(str(error)) from None
        return names

    @field_validator("torso")
    @classmethod
    def _torso_stays_inside(cls, path: str | None) -> str | None:
        return None if path is None else _inside(path)

    @model_validator(mode="after")
    def _can_be_estimated(self) -> Self:
        names = [push.id.casefold() for push in self.pushes]
        for i, name in enumerate(names):
            if name in names[:i]:
                raise ValueError(f"pushes[{i}].id: '{self.pushes[i].id}' is used twice; give each push its own id")
        known = (*REST_IMAGES, *(push.image for push in self.pushes))
        for image in self.xray.scale or {}:
            if image not in known:
                raise ValueError(f"xray.scale.{_shown(image)}: unknown image; wanted one of {', '.join(known)}")
        training = [push.forces_n[i] for push in self.pushes for i in push.frames_of("training")]
        if not training and any(push.frames_of("validation") for push in self.pushes):
            raise ValueError("pushes: no frame has the role training, wanted at least one")
        if training and not any(training):
            raise ValueError("pushes: all training forces are zero, so there is nothing to identify")
        if self.pelvis == "dead-loads" and self.wall == "one-sided":
            raise ValueError(
                "wall: found 'one-sided' beside pelvis 'dead-loads', which leave the wall out, wanted 'bilateral'"
            )
        return self


class ImageAnnotation(_Record):
    """Corners in one image, in pixels: (column, row), the first pixel's centre at (0, 0).

    Attributes
    ----------
    vertebrae : for each visible vertebra four corners: superior-left, superior-right, inferior-right, inferior-left of
        the patient in a frontal image; superior-anterior, superior-posterior, inferior-posterior, inferior-anterior in
        a lateral one.
    supports : points on the pelvis and on the shoulder that rests on the wall; they show whether the supports moved.
    pedicles : centres of the left and the right pedicle; they determine axial rotation.
    """

    vertebrae: dict[VertebraName, Quad]
    supports: dict[Literal["pelvis", "shoulder"], Annotated[tuple[Point, ...], Field(min_length=1, strict=False)]] = {}
    pedicles: dict[VertebraName, Pair] = {}

    @field_validator("vertebrae")
    @classmethod
    def _is_a_spine(cls, vertebrae: dict[VertebraName, Quad]) -> dict[VertebraName, Quad]:
        ordered = dict(sorted(vertebrae.items(), key=lambda item: VERTEBRAE.index(item[0])))
        if ordered:
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


class Annotation(_Record):
    """``annotation.json``: corners in the rest images, in the first frame of each push and, at will, in others of them.

    Attributes
    ----------
    schema_version : 1.
    images : by name: "rest/frontal", "rest/lateral", "push/<id>" (frame 0), "push/<id>/<frame>", and, from other
        sides, "push/<id>/<frame>/<view>".
    """

    schema_version: Literal[1]
    images: dict[str, ImageAnnotation]

    @field_validator("images")
    @classmethod
    def _points_are_where_they_serve(cls, images: dict[str, ImageAnnotation]) -> dict[str, ImageAnnotation]:
        for name, image in images.items():
            further, aside = re.fullmatch(FURTHER_FRAME, name), re.fullmatch(FURTHER_VIEW, name)
            fewest = FEWEST_OF_VIEW if aside else FEWEST_VERTEBRAE if further is None else 0
            if len(image.vertebrae) < fewest:
                raise ValueError(
                    f"{shown_key(name)}.vertebrae: found {counted(len(image.vertebrae), 'vertebra', 'vertebrae')}, "
                    f"wanted at least {fewest}"
                )
            if aside is not None and image.supports:
                raise ValueError(
                    f"{shown_key(name)} has supports; wanted them in the push's first frame, {aside['push']}"
                )
            if further is not None and image.supports:
                raise ValueError(
                    f"{shown_key(name)} has supports; wanted them in the push's first frame, {further['push']}"
                )
            if image.supports and not name.startswith("push/"):
                raise ValueError(
                    f"{shown_key(name)} has supports; wanted them in push images only, where they can move"
                )
            if further is not None and further["push"] in images:
                _check_turned(name, image, images[further["push"]])
        return images


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


R = TypeVar("R", bound=BaseModel)


def read_record(path: Path, kind: type[R], page: str = SUBJECT_PAGE) -> R:
    """A record from a JSON file that ``page`` of the documents describes.

    Raises
    ------
    SubjectError : no such file, no JSON, or anything the record does not allow (field, found, wanted).
    """
    return parse_record(read_text(path), str(path), kind, page)


def parse_record(text: str, name: str, kind: type[R], page: str = SUBJECT_PAGE) -> R:
    """A record from the text of a JSON file of that name. Raises SubjectError as ``read_record`` does."""
    parse_json(text, name)
    try:
        return kind.model_validate_json(text)
    except ValidationError as error:
        raise SubjectError(f"{name}: {complaint_of(error, page)}") from None


def complaint_of(error: ValidationError, page: str = SUBJECT_PAGE) -> str:
    """The most telling of pydantic's complaints as "field: found, wanted"."""
    # A misspelled key shows up twice, as unknown and as missing: the first says more.
    complaints = sorted(error.errors(include_url=False), key=lambda e: e["type"] != "extra_forbidden")
    first = complaints[0]
    field = _field_path(first)
    more = f" (and {len(complaints) - 1} more)" if len(complaints) > 1 else ""
    told = _complaint(first, page)
    return f"{field}: {told}{more}" if field else f"{told}{more}"


def complaints_of(error: ValidationError, page: str = SUBJECT_PAGE) -> list[tuple[str, str]]:
    """All of pydantic's complaints, each as the field and what is wrong with it."""
    return [(_field_path(one), _complaint(one, page)) for one in error.errors(include_url=False)]


def _field_path(complaint: ErrorDetails) -> str:
    path = ""
    for part in complaint["loc"]:
        # pydantic adds this to the path when a key of a dictionary is wrong.
        if part == "[key]":
            continue
        path += f"[{part}]" if isinstance(part, int) else f".{shown_key(part)}"
    return path.removeprefix(".")


def shown_key(key: str) -> str:
    """A key as it stands in the file, if it can be printed in one line; else quoted and shortened."""
    return key if key.isprintable() and 0 < len(key) <= 40 else _shown(key, 30)


def _complaint(complaint: ErrorDetails, page: str) -> str:
    kind, message = complaint["type"], complaint["msg"]
    if kind == "extra_forbidden":
        return f"unknown key; check its spelling against {page}"
    if kind == "missing":
        return "missing"
    if kind == "value_error":
        return message.removeprefix("Value error, ")
    if kind == "string_pattern_mismatch":
        return f"found {_shown(complaint['input'])}, wanted {WANTED_ID}"
    wanted = re.sub(r"^(Input|String|Tuple|Dictionary) should (be |have |match )?", "", message)
    return f"found {_shown(complaint['input'])}, wanted {wanted}"


def _shown(value: Any, longest: int = 60) -> str:
    # As JSON writes them.
    text = json.dumps(value) if value is None or isinstance(value, bool) else repr(value)
    return text if len(text) <= longest else text[: longest - 3] + "..."
