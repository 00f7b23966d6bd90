"""The subject folder: what is in it, read, written and checked (format: docs/subject-folder.md).

``read_subject`` checks everything that can be told without opening a radiograph; the functions that open one check the
rest (``check_frames``, ``annotated_points.image_corners``). Each refusal is one line: file, field, found, wanted.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from spinestiff.errors import SubjectError, SubjectGaps
from spinestiff.files import no_folder, regular_file, regular_files, trouble, write_json
from spinestiff.imaging.dicom.files import MOST_HEADER_BYTES, MOST_MAPPED_BYTES
from spinestiff.imaging.features import view_kind
from spinestiff.mechanics.loads import USUAL_LIMIT_N
from spinestiff.subject.annotation_record import Annotation
from spinestiff.subject.gaps import Gap, open_frames, read_open_record
from spinestiff.subject.image_names import LATERAL, PushImage, frame_image, rest_image
from spinestiff.subject.record_reading import read_record, shown_key
from spinestiff.subject.records import (
    ANNOTATION_FILE,
    REST_IMAGES,
    RESULTS,
    SCHEMA_VERSION,
    SUBJECT_FILE,
    USUAL_FORCES_N,
    FurtherViewRecord,
    PushRecord,
    SubjectRecord,
)
from spinestiff.words import counted

if TYPE_CHECKING:
    from spinestiff.imaging.dicom.identity import Identity
    from spinestiff.imaging.radiograph import Radiograph

MOST_INPUT_BYTES = MOST_MAPPED_BYTES + MOST_HEADER_BYTES
"""Of a file: the largest are radiographs."""


@dataclass(frozen=True)
class Subject:
    """A subject folder, checked. Radiographs are read by ``read_rest`` and ``read_push``.

    Attributes
    ----------
    folder : the subject folder.
    record : ``subject.json``.
    annotation : ``annotation.json``.
    warnings : what is allowed but unusual, a line each.
    gaps : what ``subject.json`` does not know yet; ``record`` has stand-ins there, and no step takes it.
    """

    folder: Path
    record: SubjectRecord
    annotation: Annotation
    warnings: tuple[str, ...] = ()
    gaps: tuple[Gap, ...] = ()

    @property
    def results(self) -> Path:
        """Where results go."""
        return self.folder / RESULTS

    @property
    def pushes(self) -> tuple[PushRecord, ...]:
        return self.record.pushes

    def push(self, push_id: str) -> PushRecord:
        """The push of that id."""
        for push in self.pushes:
            if push.id == push_id:
                return push
        known = ", ".join(push.id for push in self.pushes)
        raise SubjectError(f"{self.folder / SUBJECT_FILE}: no push '{push_id}'; there are {known}")

    def image_path(self, image: str) -> Path:
        """File (or folder of frames) of an image by its name in the annotation."""
        if image in REST_IMAGES:
            return self.folder / REST_IMAGES[image]
        of_push = PushImage.named(image)
        if of_push is None or of_push.view:
            return self.folder / self.view(image)[1].files
        return self.folder / self.push(of_push.push).frames

    def view(self, image: str) -> tuple[int, FurtherViewRecord]:
        """Frame and record of a radiograph from another side, by its name in the annotation.

        Raises
        ------
        SubjectError : no such radiograph of this subject.
        """
        for push in self.pushes:
            for view in push.views:
                for frame in view.frames:
                    if push.view_image(frame, view.id) == image:
                        return frame, view
        raise SubjectError(
            f"{self.folder / ANNOTATION_FILE}: images.{shown_key(image)}: no such view of this frame in {SUBJECT_FILE}"
        )

    @property
    def rest_views(self) -> tuple[Literal["frontal", "lateral"], ...]:
        """The rest radiographs there are; a lateral one may be missing."""
        return ("frontal", "lateral") if LATERAL in self.annotation.images else ("frontal",)

    @property
    def torso_path(self) -> Path | None:
        """The torso of the subject's own bones, if there is one."""
        return None if self.record.torso is None else self.folder / self.record.torso

    @property
    def scan_path(self) -> Path | None:
        """The surface scan of the trunk, if there is one."""
        return None if self.record.skin_scan is None else self.folder / self.record.skin_scan.file

    @property
    def marker_paths(self) -> tuple[Path, ...]:
        """Tables of skin markers, of the pushes that have one."""
        return tuple(self.folder / push.markers.file for push in self.pushes if push.markers is not None)


def read_subject(folder: str | Path) -> Subject:
    """Read and check a subject folder; radiographs only for being there.

    Raises
    ------
    SubjectGaps : values that are not known yet, a line each, and the radiographs that are missing besides.
    SubjectError : anything missing, unknown, out of range or contradictory.
    """
    bare = read_unannotated(folder)
    if bare.gaps:
        raise SubjectGaps(
            *(f"{bare.folder / SUBJECT_FILE}: {gap.line}" for gap in bare.gaps),
            *(
                f"{bare.image_path(image)}: no such file; wanted the radiograph of {image}"
                for image in annotatable(bare.record)
                if image != LATERAL and not os.path.lexists(bare.image_path(image))
            ),
        )
    subject = replace(bare, annotation=read_annotation(bare.folder / ANNOTATION_FILE))
    folder = subject.folder
    _check_images(subject)
    for image in subject.annotation.images:
        check_radiograph_path(subject, image)
    own = (
        (subject.torso_path, "the torso.npz of spinestiff torso import"),
        (subject.scan_path, "the skin scan that subject.json names"),
    )
    for file, what in own:
        if file is not None:
            _check_input(subject, file, what)
    for path in subject.marker_paths:
        _check_input(subject, path, "the table of skin markers that subject.json names")
    return subject


def read_unannotated(folder: str | Path) -> Subject:
    """A subject as far as ``subject.json`` tells, complete or not, its annotation still empty: what annotation starts
    from.

    Raises
    ------
    SubjectError : no such folder, or ``subject.json`` is missing or wrong.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise SubjectError(f"{folder}: {no_folder(folder)}; wanted a subject folder with {SUBJECT_FILE}")
    if not os.path.lexists(folder / SUBJECT_FILE):
        raise SubjectError(
            f"{folder / SUBJECT_FILE}: no such file; write one with the person, the pushes and their forces, as "
            "docs/subject-folder.md shows, or have spinestiff init make the folder from DICOM files"
        )
    record, gaps = read_open_record(folder / SUBJECT_FILE)
    bare = Annotation(schema_version=SCHEMA_VERSION, images={})
    return Subject(folder, record, bare, tuple(_unusual(record, gaps)), gaps)


def check_radiograph_path(subject: Subject, image: str) -> None:
    """Raise SubjectError unless the radiograph of an image is there: files inside the subject folder, none too large.

    A file is told from a pipe, a device and a link that leads elsewhere; it is not opened.
    """
    _check_input(subject, subject.image_path(image), f"the radiograph of {image}")


def write_subject(folder: str | Path, record: SubjectRecord) -> None:
    """Write ``subject.json``."""
    write_json(
        Path(folder) / SUBJECT_FILE,
        record.model_dump(mode="json", exclude_none=True, exclude={"trunk"} if not record.trunk else None),
    )


def read_annotation(path: str | Path) -> Annotation:
    """Read and check ``annotation.json``.

    Raises
    ------
    SubjectError : no annotation, fewer than 8 vertebrae in an image, corners out of order (image and vertebra named).
    """
    path = Path(path)
    if not os.path.lexists(path):
        raise SubjectError(f"{path}: no annotation; mark the vertebra corners with spinestiff annotate")
    return read_record(path, Annotation)


def write_annotation(folder: str | Path, annotation: Annotation) -> None:
    """Write ``annotation.json``."""
    images = {name: image.model_dump(mode="json", exclude_defaults=True) for name, image in annotation.images.items()}
    write_json(Path(folder) / ANNOTATION_FILE, {"schema_version": SCHEMA_VERSION, "images": images})


def read_rest(subject: Subject, which: Literal["frontal", "lateral"]) -> Radiograph:
    """The rest radiograph of one view.

    Raises
    ------
    SubjectError : the file holds more than one frame.
    RadiographError : see ``read_radiographs``.
    """
    path = subject.image_path(rest_image(which))
    frames = _read_images(subject, rest_image(which), which)
    if len(frames) != 1:
        raise SubjectError(f"{path}: found {len(frames)} frames, wanted one rest radiograph")
    return frames[0]


def read_push(subject: Subject, push: PushRecord) -> Sequence[Radiograph]:
    """The radiographs of a push, one a frame in the order of its forces; those of a sequence of more than 512 MB are
    read when they are asked for.

    Raises
    ------
    SubjectError : the number of frames is not that of the forces.
    RadiographError : see ``read_radiographs``.
    """
    frames = _read_images(subject, push.image, "frontal")
    check_frames(subject, push, len(frames))
    return frames


def open_push(subject: Subject, push: PushRecord) -> Sequence[Radiograph]:
    """Like ``read_push``, but of an uncompressed file of 16 MB or more each frame is read when it is asked for.

    Raises
    ------
    SubjectError, RadiographError : as ``read_push``; of single frames when they are read.
    """
    from spinestiff.imaging.radiograph import open_radiographs

    frames = _read_images(subject, push.image, "frontal", open_radiographs)
    check_frames(subject, push, len(frames))
    return frames


def read_view(subject: Subject, push: PushRecord, view: FurtherViewRecord) -> Sequence[Radiograph]:
    """The radiographs of a push's frames from another side, one for each of the view's frames.

    Raises
    ------
    SubjectError : another number of radiographs, or they are of another kind.
    RadiographError : see ``read_radiographs``.
    """
    frames = _read_images(subject, push.view_image(view.frames[0], view.id), view.kind)
    if len(frames) != len(view.frames):
        raise SubjectError(
            f"{subject.folder / SUBJECT_FILE}: view '{view.id}' of push '{push.id}' names "
            f"{counted(len(view.frames), 'frame')}, but {view.files} holds {len(frames)}; wanted one radiograph a frame"
        )
    return frames


def read_identities(subject: Subject) -> dict[str, Identity]:
    """Whose radiographs the rest images and the pushes' first files are, by image; to be compared, never written.

    Raises
    ------
    RadiographError : a file that can't be read.
    """
    from spinestiff.imaging.dicom.identity import read_identity
    from spinestiff.imaging.radiograph import candidates

    paths = {image: subject.image_path(image) for image in annotatable(subject.record)}
    if LATERAL not in subject.annotation.images and not os.path.lexists(paths[LATERAL]):
        del paths[LATERAL]
    paths |= {
        push.view_image(view.frames[0], view.id): subject.folder / view.files
        for push in subject.pushes
        for view in push.views
    }
    return {image: read_identity(candidates(path)[0] if path.is_dir() else path) for image, path in paths.items()}


def check_frames(subject: Subject, push: PushRecord, found: int) -> None:
    """Raise SubjectError unless a push has as many frames as forces."""
    if found != len(push.forces_n):
        raise SubjectError(
            f"{subject.folder / SUBJECT_FILE}: push '{push.id}' has {len(push.forces_n)} forces_n, but "
            f"{push.frames} holds {found} frames; wanted one force a frame"
        )


def _read_images(
    subject: Subject,
    image: str,
    which: Literal["frontal", "lateral"],
    reader: Callable[..., Sequence[Radiograph]] | None = None,
) -> Sequence[Radiograph]:
    from spinestiff.imaging.radiograph import read_radiographs
    from spinestiff.subject.geometry import image_geometry

    path = subject.image_path(image)
    try:
        geometry = image_geometry(subject.record, subject.annotation, image, which)
    except SubjectError as problem:
        raise SubjectError(f"{subject.folder / SUBJECT_FILE}: {problem}") from None
    frames = (reader or read_radiographs)(path, geometry=geometry, within=subject.folder)
    # Files of a folder have one orientation, or they would not be a sequence.
    if (found := view_kind(frames[0].view)) != which:
        raise SubjectError(f"{path}: a {found} radiograph, wanted a {which} one")
    return frames


def annotatable(record: SubjectRecord) -> tuple[str, ...]:
    """Names of the images that an annotation needs: the rest radiographs and the first frame of each push."""
    return (*REST_IMAGES, *(push.image for push in record.pushes))


def annotatable_views(subject: Subject) -> dict[str, bool]:
    """Names of all radiographs from other sides, and whether an annotation needs them: of each view the one with the
    least force that is known.
    """
    return {
        push.view_image(frame, view.id): frame == push.least_of(view, open_frames(subject.gaps, number))
        for number, push in enumerate(subject.pushes)
        for view in push.views
        for frame in view.frames
    }


def check_image_name(subject: Subject, name: str, file: str = "") -> None:
    """Raise SubjectError unless an annotation of this subject may have an image, or a push's frame, of that name.

    Parameters
    ----------
    file : that has the image, for the message; the annotation if left out.
    """
    path, needed = file or subject.folder / ANNOTATION_FILE, annotatable(subject.record)
    found = PushImage.named(name)
    if found and found.later and frame_image(found.push) in needed:
        count = len(subject.push(found.push).forces_n)
        if found.frame >= count:
            raise SubjectError(f"{path}: images.{name}: the push has {counted(count, 'frame')}, counted from 0")
    elif found and found.view:
        subject.view(name)
    elif name not in needed:
        raise SubjectError(
            f"{path}: images.{shown_key(name)}: unknown image; wanted {', '.join(needed)} (push/<id>/<frame> for "
            "frames after the first, push/<id>/<frame>/<view> for those from other sides)"
        )


def _check_images(subject: Subject) -> None:
    path, images = subject.folder / ANNOTATION_FILE, subject.annotation.images
    for name in images:
        check_image_name(subject, name)
    for name in annotatable(subject.record):
        # Without a lateral radiograph the sagittal shape is the template's; one that is there has to be annotated.
        picture = subject.image_path(name)
        if name == LATERAL and not picture.exists() and not picture.is_symlink():
            continue
        if name not in images:
            raise SubjectError(f"{path}: images.{name}: missing; wanted the vertebra corners of this image")
    for name, needed in annotatable_views(subject).items():
        if needed and name not in images:
            raise SubjectError(f"{path}: images.{name}: missing; wanted the vertebra corners of this image")


def _check_input(subject: Subject, path: Path, what: str) -> None:
    """Raise SubjectError unless a file, or each file of a folder, may be read and no step writes there."""
    folder, results = subject.folder, subject.results
    try:
        path.lstat()
    except (FileNotFoundError, NotADirectoryError):
        raise SubjectError(f"{path}: no such file; wanted {what}") from None
    except OSError as problem:
        raise SubjectError(f"{path}: can't be read ({trouble(problem)}); wanted {what}") from None
    if path.is_dir():
        files = list(regular_files(path, SubjectError, within=folder, cap_bytes=MOST_INPUT_BYTES))
        if not files:
            raise SubjectError(f"{path}: found an empty folder, wanted {what}")
    else:
        regular_file(path, SubjectError, within=folder, cap_bytes=MOST_INPUT_BYTES)
    if path.resolve().is_relative_to(results.resolve()) or results.resolve().is_relative_to(path.resolve()):
        raise SubjectError(f"{path}: lies where results are written ({results}); move it elsewhere in the folder")


def odd_forces(push: PushRecord, unknown: Collection[int] = ()) -> str:
    """What is odd about a push's forces, which may be in another unit; "" if nothing. ``unknown``: frames whose forces
    are not known yet.
    """
    most = max(push.forces_n)
    low, high = USUAL_FORCES_N
    if most == 0.0 and not unknown:
        return "all forces are 0 N: look whether the gauge was on, and whether they are its forces"
    if most == 0.0 or low <= most <= high:
        return ""
    return f"forces up to {most:g} N, where pushes on the ribs have {low:g} to {high:g} N: look whether they are in N"


def _unusual(record: SubjectRecord, gaps: Sequence[Gap]) -> Iterator[str]:
    for number, push in enumerate(record.pushes):
        most = max(push.forces_n)
        if odd := odd_forces(push, open_frames(gaps, number)):
            yield f"push '{push.id}': {odd}"
        elif most > USUAL_LIMIT_N:
            yield f"push '{push.id}' reaches {most:g} N; above {USUAL_LIMIT_N:g} N nobody was measured so far"
