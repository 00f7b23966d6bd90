"""What the reader sees in radiographs, before anything is computed from them; nothing of the patient is in it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from spinestiff.errors import RadiographError, SpinestiffError, SubjectError
from spinestiff.files import listed, regular_file
from spinestiff.imaging.dicom.millimetres import Geometry
from spinestiff.imaging.dicom.orientation import BEAM_ASSUMED
from spinestiff.imaging.dicom.reading import Scan, read_scan
from spinestiff.imaging.projection import XRayView
from spinestiff.imaging.radiograph import candidates, check_files, in_order, read_scans, times_of
from spinestiff.imaging.shown_view import shown_view
from spinestiff.subject.annotation_record import Annotation
from spinestiff.subject.folder import Subject, check_image_name, odd_forces
from spinestiff.subject.gaps import open_frames, read_open_record
from spinestiff.subject.geometry import image_geometry
from spinestiff.subject.image_names import LATERAL
from spinestiff.subject.marks import check_marks_in, frame_names
from spinestiff.subject.record_reading import read_record
from spinestiff.subject.records import ANNOTATION_FILE, REST_IMAGES, SUBJECT_FILE
from spinestiff.words import counted

SPINE_MM = 100.0
"""At the detector; eight vertebrae of a child of 120 cm are longer."""
MOST_FOLDERS = 256
"""In a folder that is inspected, itself among them."""
MOST_DEPTH = 8


@dataclass(frozen=True)
class Inspection:
    """What is known of one image.

    Attributes
    ----------
    image : its name in a subject folder, else the name of its file or folder.
    reason : why it is refused, one line; empty if it is not.
    seen : what the reader sees; lengths in mm, times in s since the first frame.
    missing : what a fit needs besides.
    warnings : what is odd.
    """

    image: str
    reason: str = ""
    seen: dict[str, Any] = field(default_factory=dict)
    missing: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()

    @property
    def status(self) -> str:
        """One of ok, incomplete (a fit lacks something) and refused."""
        return "refused" if self.reason else "incomplete" if self.missing else "ok"

    def record(self) -> dict[str, Any]:
        """For JSON."""
        return {"status": self.status, **asdict(self)}


def inspect(path: Path) -> tuple[Inspection, ...]:
    """A file; a subject folder, image by image; or any other folder and those in it, in the order of their paths, each
    as one sequence or file by file.

    Links to folders, and links that lead out of the folder, are named and not followed.

    Raises
    ------
    RadiographError : no such file or folder, no files in it, or more folders than are inspected.
    SubjectError : a subject folder whose subject.json or annotation.json can't be used.
    """
    if path.name in ("", ".."):  # the folder one is in, or above it
        path = path.resolve()
    if (path / SUBJECT_FILE).is_file():
        return _subject(path)
    if not path.is_dir():
        return (_image(path, path.name, Geometry())[0],)
    found: list[Inspection] = []
    for folder in _folders(path):
        name = folder.relative_to(path).as_posix()
        if folder != path and folder.is_symlink():
            reason = f"{folder.name}: found a link to a folder, which is not followed; name that folder itself"
            found.append(Inspection(name, reason))
        elif (folder / SUBJECT_FILE).is_file():
            found += _subject_inside(folder, name)
        elif any(not inner.is_dir() for inner in _visible(folder)):
            found += _folder(folder, path)
    if not found:
        raise RadiographError(f"{path.name}: found no radiographs in this folder or those in it, wanted some")
    return tuple(found)


def _visible(folder: Path) -> list[Path]:
    return [path for path in listed(folder, RadiographError, name=folder.name) if not path.name.startswith(".")]


def _folders(top: Path) -> list[Path]:
    """A folder and those in it, links to folders among them but not what they lead to, in the order of their paths;
    nothing of what is in subject folders.
    """
    found, todo = [top], [(top, 0)]
    while todo:
        folder, depth = todo.pop()
        inner = [] if (folder / SUBJECT_FILE).is_file() else [path for path in _visible(folder) if path.is_dir()]
        found += inner
        todo += [(path, depth + 1) for path in inner if not path.is_symlink()]
        many = f"more than {MOST_FOLDERS} folders" if len(found) > MOST_FOLDERS else ""
        if many or (inner and depth == MOST_DEPTH):
            words = many or f"folders more than {MOST_DEPTH} deep"
            raise RadiographError(f"{top.name}: found {words} in it, wanted fewer; name one of those inside")
    return sorted(found)


def _subject_inside(folder: Path, name: str) -> tuple[Inspection, ...]:
    try:
        return tuple(replace(one, image=f"{name}/{one.image}") for one in _subject(folder))
    except SubjectError as problem:
        return (Inspection(name, str(problem)),)


def _image(path: Path, name: str, given: Geometry, within: Path | None = None) -> tuple[Inspection, Scan | None]:
    """What is in a picture's files, and the first of them; None where they are refused."""
    try:
        scans, odd = read_scans(path, given, within)
    except RadiographError as problem:
        return Inspection(name, str(problem)), None
    told = (*filter(None, [odd, scans[0].doubt]), *_looks_otherwise(scans[0]), *_too_small(scans[0]))
    return Inspection(name, "", _seen(scans), scans[0].missing, told), scans[0]


def _with_beam_told_of(found: Sequence[Inspection]) -> list[Inspection]:
    """With a warning at the first frontal picture whose beam is taken to go as nothing says, for all of them."""
    untold = [i for i, one in enumerate(found) if one.seen and one.seen["sources"].get("beam") == BEAM_ASSUMED]
    if not untold:
        return list(found)
    more = f" here and in {counted(len(untold) - 1, 'further picture')}" if len(untold) > 1 else ""
    warning = (
        f"nothing tells which way the beam goes{more}, which is taken as anterior to posterior; if the patient faced "
        f"the detector, write xray.beam 'PA' into {SUBJECT_FILE}, or make the subject with --beam PA"
    )
    first = replace(found[untold[0]], warnings=(*found[untold[0]].warnings, warning))
    return [first if i == untold[0] else one for i, one in enumerate(found)]


def _looks_otherwise(scan: Scan) -> Iterator[str]:
    """A picture that looks like the other view than the one stated."""
    stated = None if scan.directions is None else scan.directions.view
    looks = None if stated is None else shown_view(scan.pixels[0])
    if looks is not None and looks.view != stated:
        yield f"stated as {stated}, but it {looks.words}; check that it is the {stated} radiograph"


def _too_small(scan: Scan) -> Iterator[str]:
    """A picture in which no spine has room: a pixel pitch in another unit."""
    if scan.spacing is None:
        return
    high, wide = scan.spacing.row * scan.layout.rows, scan.spacing.column * scan.layout.columns
    if max(high, wide) < SPINE_MM:
        size = f"{wide:.0f} mm wide and {high:.0f} mm high"
        yield f"is {size}, where no spine has room: look whether its pixel pitch is in mm"


def _folder(folder: Path, top: Path) -> tuple[Inspection, ...]:
    """The files of one folder in the folder that is inspected."""
    inside = folder.relative_to(top)
    name = folder.name if folder == top else inside.as_posix()
    found: list[Inspection] = []
    scans: list[Scan] = []
    files: list[Path] = []
    for file in candidates(folder):
        try:
            regular_file(file, RadiographError, within=top, name=file.name)
            files.append(file)
        except RadiographError as problem:
            found.append(Inspection((inside / file.name).as_posix(), str(problem)))
    try:
        check_files(folder.name, files)
    except RadiographError as problem:
        return (*found, Inspection(name, str(problem)))
    for file in files:
        one = (inside / file.name).as_posix()
        try:
            scan = read_scan(file, Geometry(), top)
        except RadiographError as problem:
            found.append(Inspection(one, str(problem)))
        else:
            scans.append(replace(scan, pixels=()))  # 128 files of pixels would fill the memory
            found.append(
                Inspection(one, "", _seen((scan,)), scan.missing, (*filter(None, [scan.doubt]), *_too_small(scan)))
            )
    if len(found) == 1 or len(scans) < len(found) or any(scan.layout.frames > 1 for scan in scans):
        return tuple(found)
    try:
        series, odd = in_order(folder.name, scans)
    except RadiographError as problem:
        alone = f"not one sequence: {problem}"
        return tuple(Inspection(one.image, "", one.seen, one.missing, (alone, *one.warnings)) for one in found)
    return (
        Inspection(
            name, "", _seen(series), series[0].missing, (*filter(None, [odd, series[0].doubt]), *_too_small(series[0]))
        ),
    )


def _subject(folder: Path) -> tuple[Inspection, ...]:
    record, gaps = read_open_record(folder / SUBJECT_FILE)
    marked = folder / ANNOTATION_FILE
    annotation = read_record(marked, Annotation) if marked.is_file() else None
    paths = {name: folder / path for name, path in REST_IMAGES.items()}
    forces = {push.image: len(push.forces_n) for push in record.pushes}
    marks: dict[str, tuple[str, ...]] = {}
    needed: dict[str, str | None] = {}
    paths |= {push.image: folder / push.frames for push in record.pushes}
    # Frames beside the first may be annotated, too.
    later = {push.image: frame_names(push)[1:] for push in record.pushes}
    kinds: dict[str, Literal["frontal", "lateral"]] = {LATERAL: "lateral"}
    for number, push in enumerate(record.pushes):
        for view in push.views:
            name = f"{push.image}, view {view.id}"
            paths[name], forces[name], kinds[name] = folder / view.files, len(view.frames), view.kind
            marks[name] = tuple(push.view_image(frame, view.id) for frame in view.frames)
            # In the others corners are followed from there.
            least = push.least_of(view, open_frames(gaps, number))
            needed[name] = None if least is None else push.view_image(least, view.id)
    odd = {push.image: odd_forces(push, open_frames(gaps, number)) for number, push in enumerate(record.pushes)}
    found: list[Inspection] = []
    if annotation is not None:
        found += _unknown_images(Subject(folder, record, annotation))
    if gaps:
        found.append(Inspection(SUBJECT_FILE, missing=tuple(f"{gap.field}: {gap.words}" for gap in gaps)))
    for name, path in paths.items():
        marked_lateral = annotation is not None and LATERAL in annotation.images
        if name == LATERAL and not (marked_lateral or path.exists() or path.is_symlink()):
            continue
        try:
            geometry = image_geometry(record, annotation, marks.get(name, (name,))[0], kinds.get(name, "frontal"))
        except SpinestiffError as problem:
            found.append(Inspection(name, str(problem)))
            continue
        one, scan = _image(path, name, geometry, folder)
        kind, frames, wanted = kinds.get(name, "frontal"), forces.get(name, 1), marks.get(name, (name,))
        if scan is not None:
            one = _fitting(one, name, annotation, frames, kind, needed.get(name, name))
        if scan is not None and annotation is not None and not (one.reason or scan.missing):
            seen_from, subject = scan.view(np.zeros(3)), Subject(folder, record, annotation)
            one = replace(one, reason=_odd_marks(subject, (*wanted, *later.get(name, ())), seen_from))
        found.append(replace(one, warnings=(*one.warnings, *filter(None, [odd.get(name)]))))
    return tuple(_with_beam_told_of(found))


def _odd_marks(subject: Subject, names: Sequence[str], view: XRayView) -> str:
    """Why a step would refuse what is marked in these images, which lie as ``view`` says; empty if none would."""
    try:
        check_marks_in(subject, names, view)
    except SubjectError as problem:
        return str(problem)
    return ""


def _unknown_images(subject: Subject) -> Iterator[Inspection]:
    """Of the first image of the annotation that the subject has not, why each step would refuse it."""
    for name in subject.annotation.images:
        try:
            check_image_name(subject, name)
        except SubjectError as problem:
            yield Inspection(ANNOTATION_FILE, str(problem))
            return


def _fitting(
    one: Inspection, name: str, annotation: Annotation | None, frames: int, wanted: str, mark: str | None
) -> Inspection:
    """Held against what the subject folder wants of this image; ``mark``: what of it has to be annotated, if known."""
    if one.seen["view"] not in (None, wanted):
        reason = f"{one.seen['file']}: found a {one.seen['view']} radiograph, wanted a {wanted} one"
        return Inspection(name, reason, one.seen)
    if one.seen["frames"] != frames:
        each = "forces_n" if mark == name else "the view's frames"
        rest = "1, at rest" if name in REST_IMAGES else f"{frames}, one for each of {each} in subject.json"
        return Inspection(name, f"{one.seen['file']}: found {one.seen['frames']} frames, wanted {rest}", one.seen)
    missing = one.missing
    if mark is not None and (annotation is None or mark not in annotation.images):
        missing += (f"no corners of {mark} in {ANNOTATION_FILE}",)
    return Inspection(name, "", one.seen, missing, one.warnings)


def _seen(scans: Sequence[Scan]) -> dict[str, Any]:
    first = scans[0]
    tags, far, pitch, axes = first.tags, first.distances, first.spacing, first.directions
    sources = first.provenance
    # Where they are not both known, one of them may be; 0 counts as unknown.
    detector, patient = tags.source_detector or None, tags.source_patient or None
    if far is not None:
        detector, patient = round(far.detector, 4), round(far.patient, 4)
    else:
        told = {"Detector": detector, "Patient": patient}
        sources |= {f"source to {to.lower()}": f"DICOM DistanceSourceTo{to}" for to, mm in told.items() if mm}
    return {
        "file": first.name,
        "files": len(scans),
        "modality": tags.modality,
        "kind": tags.image_type,
        "transfer_syntax": tags.syntax_name,
        "frames": len(scans) if len(scans) > 1 else first.layout.frames,
        "rows": first.layout.rows,
        "columns": first.layout.columns,
        "bits": first.layout.stored,
        "signed": first.layout.signed,
        "pixel_mm_at_detector": None if pitch is None else [round(pitch.row, 6), round(pitch.column, 6)],
        "pixel_mm_at_patient": None
        if pitch is None or far is None
        else [round(pitch.row / far.magnification, 6), round(pitch.column / far.magnification, 6)],
        "source_detector_mm": detector,
        "source_patient_mm": patient,
        "view": None if axes is None else axes.view,
        "columns_to": None if axes is None else axes.column,
        "rows_to": None if axes is None else axes.row,
        "beam_to": None if axes is None else axes.beam,
        "times_s": [None if time is None else round(time, 4) for time in times_of(tuple(scans))],
        "sources": sources,
    }
