"""One DICOM file from its bytes to pixels, millimetres and directions: the reader inside which every tag is touched."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from spinestiff.errors import RadiographError
from spinestiff.files import file_digest, regular_file
from spinestiff.imaging.dicom.decoding import decoded, whole_bits
from spinestiff.imaging.dicom.files import (
    MOST_BYTES,
    MOST_HEADER_BYTES,
    MOST_MAPPED_BYTES,
    declared_modality,
    one_clear_line,
    read_dataset,
    read_header,
    read_tags_only,
)
from spinestiff.imaging.dicom.greys import DisplayCurve, bone_bright
from spinestiff.imaging.dicom.identity import Identity, identity_of
from spinestiff.imaging.dicom.layout import Layout, check_modality, check_native, checked_layout
from spinestiff.imaging.dicom.millimetres import Distances, Geometry, Spacing, distances, pixel_shape, spacing
from spinestiff.imaging.dicom.orientation import Directions, directions
from spinestiff.imaging.dicom.tags import MissingValue, Tags, code, coded_word, read_tags
from spinestiff.imaging.projection import XRayView, placed_view

LEAST_BYTES = 16 * 1024**2
"""Smaller files are read whole: that is quick enough."""

SLOT_WORDS = (
    "comes from a slot scanner (EOS or the like), whose pictures grow across the body only; it is read as if it came "
    "from one point, so that lengths along the body are off"
)


@dataclass(frozen=True)
class Scan:
    """What a file holds.

    Attributes
    ----------
    name, sha256 : of the file.
    whose : the patient and the day, to be compared only.
    tags, layout : what it declares, checked.
    pixels : F of (H, W) float32, bone bright; of a large uncompressed file each is read when it is asked for.
    display : how the file wants them shown; None if it does not say.
    greys : how the pixels came about, in words.
    distances, spacing, directions : None where something that the user can give is missing.
    missing : what that is, a line each.
    """

    name: str
    sha256: str
    whose: Identity
    tags: Tags
    layout: Layout
    pixels: Sequence[NDArray[np.float32]]
    display: DisplayCurve | None
    greys: str
    distances: Distances | None
    spacing: Spacing | None
    directions: Directions | None
    missing: tuple[str, ...]

    @property
    def provenance(self) -> dict[str, str]:
        """Where millimetres, directions and grey values came from, as far as they are known."""
        found = {}
        if self.distances is not None:
            found["source to detector"], found["source to patient"] = self.distances.sources
        if self.spacing is not None:
            found["pixel spacing"] = self.spacing.source
        if self.directions is not None:
            found["orientation"], found["beam"] = self.directions.source, self.directions.beam_source
        return {**found, "grey values": self.greys}

    @property
    def doubt(self) -> str:
        """What makes its millimetres doubtful, in words; empty if nothing."""
        return SLOT_WORDS if self.tags.slot_scanner else ""

    @property
    def aspect(self) -> float:
        """Height of a pixel over its width, 1 where nothing says it. Raises RadiographError as ``pixel_shape``."""
        if self.spacing is not None:
            return self.spacing.row / self.spacing.column
        shape = pixel_shape(self.tags)
        return 1.0 if shape is None else shape[0]

    def view(self, centre: ArrayLike) -> XRayView:
        """The X-ray view whose principal ray passes ``centre`` (3,) mm in the patient plane.

        Raises
        ------
        MissingValue : the first thing that is missing.
        """
        if self.distances is None or self.spacing is None or self.directions is None:
            raise MissingValue(f"{self.name}: {self.missing[0]}")
        columns, rows, beam = self.directions.axes
        return placed_view(
            columns, rows, beam,
            sid=self.distances.detector, source_to_patient=self.distances.patient,
            shape=(self.layout.rows, self.layout.columns), pixel=(self.spacing.column, self.spacing.row),
            centre=centre,
        )  # fmt: skip


class FramesOnDisk(Sequence[NDArray[np.float32]]):
    """The frames of an uncompressed file, each read when it is asked for; none stays in memory.

    Raises RadiographError where the file has become shorter.
    """

    def __init__(self, path: Path, start: int, layout: Layout, tags: Tags) -> None:
        self.path, self.start, self.layout, self.tags = path, start, layout, tags

    def __len__(self) -> int:
        return self.layout.frames

    @overload
    def __getitem__(self, index: int) -> NDArray[np.float32]: ...
    @overload
    def __getitem__(self, index: slice) -> tuple[NDArray[np.float32], ...]: ...
    def __getitem__(self, index: int | slice) -> NDArray[np.float32] | tuple[NDArray[np.float32], ...]:
        if isinstance(index, slice):
            return tuple(self[i] for i in range(*index.indices(len(self))))
        index, one = range(len(self))[index], replace(self.layout, frames=1)
        kind = f"<{'i' if one.signed else 'u'}{one.allocated // 8}"
        with one_clear_line(self.path.name):
            stored = np.fromfile(self.path, kind, one.rows * one.columns, offset=self.start + index * one.frame_bytes)
            check_native(one, stored.nbytes)
            pixels: NDArray[np.float32] = bone_bright(whole_bits(stored, one), self.tags, one)[0][0]
        return pixels


def read_scan(path: Path, given: Geometry, within: Path | None = None, one_by_one: bool = False) -> Scan:
    """A file, wholly read; frames of an uncompressed one that is too large for that are left on the disk.

    Parameters
    ----------
    within : folder that the file has to lie in, links followed.
    one_by_one : whether to leave those of a smaller uncompressed file there, too, as many files together may be large.

    Raises
    ------
    RadiographError : whatever is wrong with it, in one line with its name.
    """
    status = regular_file(path, RadiographError, within=within, name=path.name)
    large = status.st_size > MOST_BYTES
    if large or one_by_one:
        with one_clear_line(path.name):
            # What is no radiograph is said to be none, not to be too large for one.
            if modality := declared_modality(path):
                check_modality(coded_word(modality))
            if (scan := _on_disk(path, given)) is not None:
                return replace(scan, sha256=file_digest(path))
    with one_clear_line(path.name):
        dataset, sha256 = read_dataset(path)
        check_modality(code(dataset, "Modality"))
        tags = read_tags(dataset)
        layout = checked_layout(tags)
        far, pitch, axes, missing = _known(tags, given)
        pixels, display, greys = bone_bright(decoded(dataset, tags, layout), tags, layout)
        whose = identity_of(dataset)
        return Scan(path.name, sha256, whose, tags, layout, tuple(pixels), display, greys, far, pitch, axes, missing)


def read_frames(path: Path, given: Geometry, within: Path | None = None) -> Scan | None:
    """A file whose frames can be read one by one, or None where it has to be read whole (coded, deflated or small).

    The scan has no hash of the file, which would have to be read for it.

    Parameters
    ----------
    within : folder that the file has to lie in, links followed.

    Raises
    ------
    RadiographError : whatever is wrong with it, in one line with its name.
    """
    status = regular_file(path, RadiographError, within=within, name=path.name)
    if status.st_size < LEAST_BYTES:
        return None
    with one_clear_line(path.name):
        return _on_disk(path, given)


def _on_disk(path: Path, given: Geometry) -> Scan | None:
    """An uncompressed file, its frames left where they are; None where it is none."""
    header = read_header(path)
    if header is None:
        return None
    dataset, start, length = header
    check_modality(code(dataset, "Modality"))
    tags = read_tags(dataset)
    layout = checked_layout(tags, MOST_MAPPED_BYTES)
    check_native(layout, length)
    behind = path.stat().st_size - start - length
    if behind > MOST_HEADER_BYTES:
        raise RadiographError(f"found {behind / 2**20:.0f} MB behind the pixels, wanted none; copy the file again")
    far, pitch, axes, missing = _known(tags, given)
    nothing = np.zeros((0, layout.rows, layout.columns), np.uint16)
    _, display, greys = bone_bright(nothing, tags, layout)
    frames = FramesOnDisk(path, start, layout, tags)
    whose = identity_of(dataset)
    return Scan(path.name, "", whose, tags, layout, frames, display, greys, far, pitch, axes, missing)


def check_given(path: Path, given: Geometry) -> None:
    """Raise RadiographError, in one line with the file's name, where a file contradicts the geometry that is given."""
    with one_clear_line(path.name):
        _known(read_tags(read_tags_only(path)), given)


def _known(tags: Tags, given: Geometry) -> tuple[Distances | None, Spacing | None, Directions | None, tuple[str, ...]]:
    """Distances, spacing and directions of a file as far as they are known, and what is missing, a line each."""
    missing: list[str] = []
    far = pitch = axes = None
    try:
        far = distances(tags, given)
    except MissingValue as lack:
        missing.append(str(lack))
    try:
        pitch = spacing(tags, given, None if far is None else far.magnification)
    except MissingValue as lack:
        missing.append(str(lack))
    try:
        axes = directions(tags, given)
    except MissingValue as lack:
        missing.append(str(lack))
    return far, pitch, axes, tuple(missing)
