"""What the reader sees in radiographs, before anything is computed from them; nothing of the patient is in it."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from spinestiff.errors import RadiographError, SpinestiffError
from spinestiff.imaging.dicom.millimetres import Geometry
from spinestiff.imaging.dicom.reading import Scan, read_scan
from spinestiff.imaging.radiograph import files_of, in_order, read_scans, times_of
from spinestiff.subject.geometry import image_geometry
from spinestiff.subject.records import (
    ANNOTATION_FILE,
    LATERAL,
    REST_IMAGES,
    SUBJECT_FILE,
    Annotation,
    SubjectRecord,
    read_record,
)


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
    """A file; a subject folder, image by image; or any other folder, as one sequence or file by file.

    Raises
    ------
    RadiographError : no such file or folder, or no files in it.
    SubjectError : a subject folder whose subject.json or annotation.json can't be used.
    """
    if (path / SUBJECT_FILE).is_file():
        return _subject(path)
    if not path.is_dir():
        return (_image(path, path.name, Geometry()),)
    return _folder(path)


def _image(path: Path, name: str, given: Geometry) -> Inspection:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            scans = read_scans(path, given)
        except RadiographError as problem:
            return Inspection(name, str(problem))
    told = tuple(str(warning.message) for warning in caught)
    return Inspection(name, "", _seen(scans), scans[0].missing, told)


def _folder(folder: Path) -> tuple[Inspection, ...]:
    found: list[Inspection] = []
    scans: list[Scan] = []
    for file in files_of(folder):
        try:
            scan = read_scan(file, Geometry())
        except RadiographError as problem:
            found.append(Inspection(file.name, str(problem)))
        else:
            scans.append(replace(scan, pixels=scan.pixels[:0]))  # 128 files of pixels would fill the memory
            found.append(Inspection(file.name, "", _seen((scan,)), scan.missing))
    if len(found) == 1 or len(scans) < len(found) or any(scan.layout.frames > 1 for scan in scans):
        return tuple(found)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            series = in_order(folder.name, scans)
        except RadiographError as problem:
            alone = f"not one sequence: {problem}"
            return tuple(Inspection(one.image, "", one.seen, one.missing, (alone,)) for one in found)
    told = tuple(str(warning.message) for warning in caught)
    return (Inspection(folder.name, "", _seen(series), series[0].missing, told),)


def _subject(folder: Path) -> tuple[Inspection, ...]:
    record = read_record(folder / SUBJECT_FILE, SubjectRecord)
    marked = folder / ANNOTATION_FILE
    annotation = read_record(marked, Annotation) if marked.is_file() else None
    paths = {name: folder / path for name, path in REST_IMAGES.items()}
    forces = {push.image: len(push.forces_n) for push in record.pushes}
    paths |= {push.image: folder / push.frames for push in record.pushes}
    found = []
    for name, path in paths.items():
        if name == LATERAL and not path.exists():
            continue
        if not path.resolve().is_relative_to(folder.resolve()):
            found.append(Inspection(name, f"{path.name}: leads out of the subject folder; copy the radiograph into it"))
            continue
        try:
            geometry = image_geometry(record, annotation, name)
        except SpinestiffError as problem:
            found.append(Inspection(name, str(problem)))
            continue
        one = _image(path, name, geometry)
        found.append(one if one.reason else _fitting(one, name, annotation, forces.get(name, 1)))
    return tuple(found)


def _fitting(one: Inspection, name: str, annotation: Annotation | None, frames: int) -> Inspection:
    """Held against what the subject folder wants of this image."""
    wanted = "lateral" if name == LATERAL else "frontal"
    if one.seen["view"] not in (None, wanted):
        return Inspection(name, f"{one.seen['file']}: a {one.seen['view']} radiograph, wanted a {wanted} one", one.seen)
    if one.seen["frames"] != frames:
        rest = "wanted one rest radiograph" if name in REST_IMAGES else f"but subject.json has {frames} forces_n"
        return Inspection(name, f"{one.seen['file']}: {one.seen['frames']} frames, {rest}", one.seen)
    missing = one.missing
    if annotation is None or name not in annotation.images:
        missing += (f"no corners of {name} in {ANNOTATION_FILE}",)
    return Inspection(name, "", one.seen, missing, one.warnings)


def _seen(scans: Sequence[Scan]) -> dict[str, Any]:
    first = scans[0]
    tags, far, pitch, axes = first.tags, first.distances, first.spacing, first.directions
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
        "source_detector_mm": None if far is None else round(far.detector, 4),
        "source_patient_mm": None if far is None else round(far.patient, 4),
        "view": None if axes is None else axes.view,
        "columns_to": None if axes is None else axes.column,
        "rows_to": None if axes is None else axes.row,
        "beam_to": None if axes is None else axes.beam,
        "times_s": [None if time is None else round(time, 4) for time in times_of(tuple(scans))],
        "sources": first.provenance,
    }
