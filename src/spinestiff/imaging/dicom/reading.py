"""One DICOM file from its bytes to pixels, millimetres and directions: the reader inside which every tag is touched."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from spinestiff.errors import RadiographError
from spinestiff.files import regular_file
from spinestiff.imaging.dicom.decoding import decoded, whole_bits
from spinestiff.imaging.dicom.files import (
    MOST_BYTES,
    MOST_MAPPED_BYTES,
    declared_modality,
    one_clear_line,
    read_dataset,
    read_header,
)
from spinestiff.imaging.dicom.greys import DisplayCurve, bone_bright
from spinestiff.imaging.dicom.layout import Layout, check_modality, check_native, checked_layout
from spinestiff.imaging.dicom.millimetres import Distances, Geometry, Spacing, distances, spacing
from spinestiff.imaging.dicom.orientation import Directions, directions
from spinestiff.imaging.dicom.tags import MissingValue, Tags, code, coded_word, read_tags
from spinestiff.imaging.projection import XRayView, placed_view

LEAST_BYTES = 16 * 1024**2
"""Smaller files are read whole: that is quick enough."""


@dataclass(frozen=True)
class Scan:
    """What a file holds.

    Attributes
    ----------
    name, sha256 : of the file.
    tags, layout : what it declares, checked.
    pixels : (F, H, W) float32, bone bright.
    display : how the file wants them shown; None if it does not say.
    greys : how the pixels came about, in words.
    distances, spacing, directions : None where something that the user can give is missing.
    missing : what that is, a line each.
    """

    name: str
    sha256: str
    tags: Tags
    layout: Layout
    pixels: NDArray[np.float32]
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


def read_scan(path: Path, given: Geometry, within: Path | None = None) -> Scan:
    """A file, wholly read.

    Parameters
    ----------
    within : folder that the file has to lie in, links followed.

    Raises
    ------
    RadiographError : whatever is wrong with it, in one line with its name.
    """
    status = regular_file(path, RadiographError, within=within, name=path.name)
    with one_clear_line(path.name):
        # What is no radiograph is said to be none, not to be too large for one.
        if status.st_size > MOST_BYTES and (modality := declared_modality(path)):
            check_modality(coded_word(modality))
        dataset, sha256 = read_dataset(path)
        check_modality(code(dataset, "Modality"))
        tags = read_tags(dataset)
        layout = checked_layout(tags)
        far, pitch, axes, missing = _known(tags, given)
        pixels, display, greys = bone_bright(decoded(dataset, tags, layout), tags, layout)
        return Scan(path.name, sha256, tags, layout, pixels, display, greys, far, pitch, axes, missing)


def read_frames(path: Path, given: Geometry, within: Path | None = None) -> FrameFile | None:
    """A file whose frames can be read one by one, or None where it has to be read whole (coded, deflated or small).

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
        header = read_header(path)
        if header is None:
            return None
        dataset, start, length = header
        check_modality(code(dataset, "Modality"))
        tags = read_tags(dataset)
        layout = checked_layout(tags, MOST_MAPPED_BYTES)
        check_native(layout, length)
        far, pitch, axes, missing = _known(tags, given)
        blank = np.zeros((0, layout.rows, layout.columns), np.float32)
        scan = Scan(path.name, "", tags, layout, blank, None, "", far, pitch, axes, missing)
        return FrameFile(path, scan, start)


@dataclass(frozen=True)
class FrameFile:
    """An uncompressed file whose frames are read one by one.

    Attributes
    ----------
    scan : what it declares, without pixels and without a hash of the file, which would have to be read for it.
    start : byte at which the pixels begin.
    """

    path: Path
    scan: Scan
    start: int

    def frame(self, index: int) -> Scan:
        """The scan with the pixels (1, H, W) of one frame. Raises RadiographError."""
        layout = self.scan.layout
        kind = f"<{'i' if layout.signed else 'u'}{layout.allocated // 8}"
        with one_clear_line(self.path.name):
            stored = np.fromfile(
                self.path, kind, layout.rows * layout.columns, offset=self.start + index * layout.frame_bytes
            )
            check_native(replace(layout, frames=1), stored.nbytes)
            pixels, display, greys = bone_bright(whole_bits(stored, replace(layout, frames=1)), self.scan.tags, layout)
        return replace(self.scan, pixels=pixels, display=display, greys=greys)


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
