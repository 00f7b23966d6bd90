"""What subject.json may hold: its schema, read strictly (docs/subject-folder.md).

What the folder holds beside it and annotation.json is read by ``folder``.
"""

from __future__ import annotations

import re
from collections.abc import Collection
from pathlib import PurePosixPath, PureWindowsPath
from typing import Annotated, Any, Final, Literal, Self

from pydantic import Field, field_validator, model_validator

from spinestiff.anatomy.axes import Axis, Unit, body_axes
from spinestiff.anatomy.regions import check_parameters
from spinestiff.errors import SubjectError, TorsoError
from spinestiff.imaging.dicom.millimetres import PIXEL_MM, SOURCE_MM
from spinestiff.mechanics.loads import PUSH_DIRECTION
from spinestiff.subject.image_names import FRONTAL, LATERAL, frame_image, view_image
from spinestiff.subject.record_reading import IDENTIFIER, WANTED_MARKER, Record, shown_value
from spinestiff.words import counted

SCHEMA_VERSION: Final = 1
SUBJECT_FILE = "subject.json"
ANNOTATION_FILE = "annotation.json"
RESULTS = "results"
"""Folder of what is made from the others."""
REST_IMAGES = {FRONTAL: "rest/frontal.dcm", LATERAL: "rest/lateral.dcm"}
"""Their files, by their names in the annotation."""
GAUGE_LIMIT_N = 500.0
"""What the force gauge of the set-up measures accurately (paper 2.1)."""
USUAL_FORCES_N = (15.0, 150.0)
"""Of a push, the largest: below or above, it may be in another unit (docs/judgement.md)."""
DISTANCES_MM = (30.0, 1000.0)
LEVELS = (1.0, 12.0)
"""Ribs."""
HEIGHTS_CM = (120.0, 200.0)
HEAVIEST_KG = 300.0
BREADTHS_MM, DEPTHS_MM = (100.0, 600.0), (80.0, 500.0)
"""Of a trunk."""
OLDEST = 120.0
"""Years; an age is above 0."""
MARKER_NAME = r"[A-Za-z0-9][A-Za-z0-9._-]{0,31}"
MOST_TURNED_VIEW_DEG = 40.0
"""Of an oblique radiograph, against the frontal or lateral one; beyond, it is nearer to the other of the two."""
LONGEST_PATH = 250
Role = Literal["training", "validation", "unused"]
VertebraName = Literal[
    "T1", "T2", "T3", "T4", "T5", "T6", "T7", "T8", "T9", "T10", "T11", "T12", "L1", "L2", "L3", "L4", "L5"
]  # fmt: skip
# Lists pass for tuples here (JSON has nothing else); what is in them is checked strictly.
Point = Annotated[tuple[float, float], Field(strict=False)]
Pair = Annotated[tuple[Point, Point], Field(strict=False)]
Identifier = Annotated[str, Field(pattern=IDENTIFIER)]
SourceDistance = Annotated[float, Field(ge=SOURCE_MM[0], le=SOURCE_MM[1])]
DetectorPitch = Annotated[float, Field(ge=PIXEL_MM[0], le=PIXEL_MM[1])]
Distance = Annotated[float, Field(ge=DISTANCES_MM[0], le=DISTANCES_MM[1])]


def _inside(path: str) -> str:
    absolute = PurePosixPath(path).is_absolute() or PureWindowsPath(path).drive or path.startswith("\\")
    if absolute or "\\" in path or ".." in PurePosixPath(path).parts or not path.strip() or "\0" in path:
        raise ValueError(f"found {shown_value(path)}, wanted a path inside the subject folder, with / and without ..")
    if len(path) > LONGEST_PATH or not path.isprintable():
        raise ValueError(f"found {shown_value(path)}, wanted at most {LONGEST_PATH} characters that can be printed")
    return path


class ScaleRecord(Record):
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


class ImageXRayRecord(Record):
    """X-ray geometry of one image where its file lacks it and that of the others does not hold for it.

    Attributes
    ----------
    source_detector_mm, source_patient_mm, imager_pixel_mm, beam : as in ``XRayRecord``; None: what is given there.
    """

    source_detector_mm: SourceDistance | None = None
    source_patient_mm: SourceDistance | None = None
    imager_pixel_mm: DetectorPitch | None = None
    beam: Literal["AP", "PA"] | None = None


class XRayRecord(Record):
    """X-ray geometry where the DICOM files lack it; a value that contradicts a file is refused.

    Attributes
    ----------
    source_detector_mm, source_patient_mm : mm, along the detector's normal.
    imager_pixel_mm : pixel pitch at the detector, mm.
    orientation : "standard" = in files without an orientation of their own columns grow to the patient's left (in
        lateral views to anterior) and rows to the feet.
    beam : "AP" or "PA", which way it goes through the patient in frontal radiographs that don't tell.
    scale : known lengths, by the image in which they were marked.
    images : what differs from the above in single images, by their names (``PushRecord.geometry_images``).
    """

    source_detector_mm: SourceDistance | None = None
    source_patient_mm: SourceDistance | None = None
    imager_pixel_mm: DetectorPitch | None = None
    orientation: Literal["standard"] | None = None
    beam: Literal["AP", "PA"] | None = None
    scale: dict[str, ScaleRecord] | None = None
    images: dict[str, ImageXRayRecord] | None = None

    def of(self, image: str) -> ImageXRayRecord:
        """The geometry given for an image."""
        own = (self.images or {}).get(image, ImageXRayRecord())
        names = ImageXRayRecord.model_fields
        return ImageXRayRecord(
            **{name: mine if (mine := getattr(own, name)) is not None else getattr(self, name) for name in names}
        )


class FurtherViewRecord(Record):
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


class ScanAxes(Record):
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


class MarkersRecord(Record):
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
    shown: Annotated[dict[str, Point], Field(min_length=1, max_length=60)]

    @field_validator("file")
    @classmethod
    def _stays_inside(cls, path: str) -> str:
        return _inside(path)

    @field_validator("shown")
    @classmethod
    def _are_names(cls, shown: dict[str, Point]) -> dict[str, Point]:
        for name in shown:
            if not re.fullmatch(MARKER_NAME, name):
                raise ValueError(f"found marker {shown_value(name)}, wanted {WANTED_MARKER}")
        return shown


class PushRecord(Record):
    """One series of radiographs under a growing rib force.

    Attributes
    ----------
    id : name, unique in the subject.
    side : the side that is pushed, the patient's.
    level : rib level of the push point, 1 to 12; 8.5 = between ribs 8 and 9.
    d21_mm, d31_mm : vertical distances shoulder to pelvis and shoulder to push point (Eqs. 1-2), mm; only a pelvis with
        "dead-loads" needs them. None: not measured.
    frames : file or folder of the radiographs, relative to the subject folder.
    forces_n : magnitude for each frame, N.
    roles : for each frame; left out = not chosen yet, all "unused".
    views : radiographs of some of the frames from other sides.
    markers : on the skin, seen in each frame.
    """

    id: Identifier
    side: Literal["left", "right"]
    level: Annotated[float, Field(ge=LEVELS[0], le=LEVELS[1])]
    d21_mm: Distance | None = None
    d31_mm: Distance | None = None
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
        if self.d21_mm is not None and self.d31_mm is not None and self.d31_mm >= self.d21_mm:
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
            raise ValueError(
                "all forces are zero, so there is nothing to identify; check forces_n, and of a force log whether its "
                "offset puts the frames beside the push"
            )
        return self

    @property
    def image(self) -> str:
        """Name of the push's first frame in the annotation."""
        return frame_image(self.id)

    @property
    def geometry_images(self) -> tuple[str, ...]:
        """Names by which its radiographs may have an X-ray geometry of their own: the push's, and that of the first
        radiograph of each further view."""
        return self.image, *(self.view_image(view.frames[0], view.id) for view in self.views)

    def frame_image(self, frame: int) -> str:
        """Name of a frame (0-based) in the annotation."""
        return frame_image(self.id, frame)

    def view_image(self, frame: int, view: str) -> str:
        """Name of a frame's radiograph from another side in the annotation."""
        return view_image(self.id, frame, view)

    def least_of(self, view: FurtherViewRecord, unknown: Collection[int] = ()) -> int | None:
        """The first of a view's frames with the least force among them: it has to be marked by hand.

        ``unknown`` : frames whose force is not known yet, and so is passed by; None: that of none is known.
        """
        known = [frame for frame in sorted(view.frames) if frame not in unknown]
        return min(known, key=lambda frame: self.forces_n[frame], default=None)

    @property
    def unloaded(self) -> int:
        """The first of the frames with the least force."""
        return self.forces_n.index(min(self.forces_n))

    @property
    def sign(self) -> int:
        """+1 for a push from the patient's right, -1 from the left (towards a left or a right curve, Table 2)."""
        return int(PUSH_DIRECTION[self.side])

    def frames_of(self, role: Role) -> tuple[int, ...]:
        """Indices of the frames with a role."""
        return tuple(i for i, given in enumerate(self.roles) if given == role)


class TrunkRecord(Record):
    """Horizontal extents of the trunk at a level, by tape or caliper, mm: side to side and front to back."""

    breadth_mm: Annotated[float, Field(ge=BREADTHS_MM[0], le=BREADTHS_MM[1])]
    depth_mm: Annotated[float, Field(ge=DEPTHS_MM[0], le=DEPTHS_MM[1])]


class ScanRecord(Record):
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


class SubjectRecord(Record):
    """``subject.json``: the person, the X-ray geometry and the pushes.

    Attributes
    ----------
    schema_version : 1.
    id : name without spaces.
    age : years.
    sex : "female" or "male".
    height_cm : standing height.
    mass_kg : body mass; the template takes the sizes of this age, sex, height and mass, or the usual mass.
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
    mass_kg: Annotated[float, Field(gt=0.0, le=HEAVIEST_KG)] | None = None
    xray: XRayRecord = XRayRecord()
    torso: str | None = None
    pushes: Annotated[tuple[PushRecord, ...], Field(strict=False)]
    trunk: dict[VertebraName, TrunkRecord] = Field(default={})
    skin_scan: ScanRecord | None = None
    pelvis: Pelvis = "estimated"
    wall: Wall = "bilateral"
    priors: dict[str, Annotated[float, Field(ge=0.0, le=1000.0)]] = Field(default={})
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
    def _has_a_body(self) -> Self:
        if self.mass_kg is not None:
            from spinestiff.anatomy.template.body import check_mass  # brings the template's builder

            try:
                check_mass(self.mass_kg, self.height_cm)
            except TorsoError as error:
                raise ValueError(f"mass_kg: {error}") from None
        return self

    @model_validator(mode="after")
    def _can_be_estimated(self) -> Self:
        names = [push.id.casefold() for push in self.pushes]
        for i, name in enumerate(names):
            if name in names[:i]:
                raise ValueError(f"pushes[{i}].id: '{self.pushes[i].id}' is used twice; give each push its own id")
        self._refuse_same_files()
        scaled = (*REST_IMAGES, *(push.image for push in self.pushes))
        apart = (*REST_IMAGES, *(image for push in self.pushes for image in push.geometry_images))
        for key, given, known in (("scale", self.xray.scale, scaled), ("images", self.xray.images, apart)):
            for image in given or {}:
                if image not in known:
                    raise ValueError(
                        f"xray.{key}.{shown_value(image)}: unknown image; wanted one of {', '.join(known)}"
                    )
        training = [push.forces_n[i] for push in self.pushes for i in push.frames_of("training")]
        if not training and any(push.frames_of("validation") for push in self.pushes):
            raise ValueError("pushes: no frame has the role training, wanted at least one")
        if training and not any(training):
            raise ValueError("pushes: all training forces are zero, so there is nothing to identify")
        lacking = (
            f"pushes[{i}].{name}"
            for i, push in enumerate(self.pushes)
            for name in ("d21_mm", "d31_mm")
            if getattr(push, name) is None
        )
        if self.pelvis == "dead-loads" and (field := next(lacking, "")):
            raise ValueError(f"{field}: missing; pelvis 'dead-loads' needs it, other ways of holding the pelvis do not")
        if self.pelvis == "dead-loads" and self.wall == "one-sided":
            raise ValueError(
                "wall: found 'one-sided' beside pelvis 'dead-loads', which leave the wall out, wanted 'bilateral'"
            )
        return self

    def _refuse_same_files(self) -> None:
        """Raise ValueError where a file of what was seen under a push is named twice: it would count as two."""
        named = [
            one
            for i, push in enumerate(self.pushes)
            for one in (
                (f"pushes[{i}].frames", push.frames),
                *((f"pushes[{i}].views[{j}].files", view.files) for j, view in enumerate(push.views)),
                *(() if push.markers is None else ((f"pushes[{i}].markers.file", push.markers.file),)),
            )
        ]
        first: dict[PurePosixPath, str] = {}
        for field, path in named:
            if (other := first.setdefault(PurePosixPath(path), field)) != field:
                raise ValueError(
                    f"{field}: found {shown_value(path)}, which {other} has already; wanted each in one place, or it "
                    "counts twice"
                )
