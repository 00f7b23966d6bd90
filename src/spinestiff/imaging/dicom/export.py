"""One file of a hospital's export: the radiograph in it, and what it tells of patient, study, series and view."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from spinestiff.errors import RadiographError
from spinestiff.imaging.dicom.files import declared_modality, one_clear_line, read_tags_only
from spinestiff.imaging.dicom.layout import check_modality
from spinestiff.imaging.dicom.millimetres import Geometry
from spinestiff.imaging.dicom.orientation import BEAMS
from spinestiff.imaging.dicom.person_tags import ExportTags, export_tags
from spinestiff.imaging.dicom.reading import Scan, read_scan
from spinestiff.imaging.dicom.tags import coded_word
from spinestiff.imaging.shown_view import ShownView, shown_view

SERIES_WORDS = "words of the series"
"""What says a view that nothing states."""
EVEN = 1e-3
"""Spread of the grey values over their size below which a picture shows nothing."""


@dataclass(frozen=True)
class Exported:
    """A radiograph of an export.

    Attributes
    ----------
    path : of the file.
    name : its path in the export, with /.
    scan : what it holds, its pixels dropped.
    tags : what it tells beside its picture.
    view, view_source : "frontal" or "lateral", and what says so; None and "" if nothing does.
    looks : what its first frame looks like, a suggestion; None where neither view is clear.
    """

    path: Path
    name: str
    scan: Scan
    tags: ExportTags
    view: str | None
    view_source: str
    looks: ShownView | None

    @property
    def frames(self) -> int:
        return self.scan.layout.frames

    @property
    def size(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.scan.layout.rows, self.scan.layout.columns


def read_exported(path: Path, name: str, within: Path) -> Exported:
    """A radiograph of an export.

    Parameters
    ----------
    name : its path in the export.
    within : folder that the file has to lie in, links followed.

    Raises
    ------
    RadiographError : no radiograph, or one that can't be read, in one line without the file's name.
    """
    try:
        with one_clear_line(path.name):
            # Of what is no radiograph, as the slices of a CT, nothing more is read.
            if modality := declared_modality(path):
                check_modality(coded_word(modality))
        scan = read_scan(path, Geometry(), within)
        with one_clear_line(path.name):
            tags = export_tags(read_tags_only(path))
    except RadiographError as problem:
        raise RadiographError(str(problem).removeprefix(f"{path.name}: ")) from None
    if _even(scan.pixels):
        raise RadiographError("shows nothing: the whole picture has one grey value")
    view, source = _view(scan, tags)
    looks = shown_view(scan.pixels[0])
    return Exported(path, name, replace(scan, pixels=()), tags, view, source, looks)


def _even(frames: Sequence[NDArray[np.float32]]) -> bool:
    """Whether all frames together have one grey value; no more of them are read than it takes to tell."""
    low, high = np.inf, -np.inf
    for frame in frames:
        low, high = min(low, float(frame.min())), max(high, float(frame.max()))
        if high - low > EVEN * max(abs(low), abs(high)):
            return False
    return True


def _view(scan: Scan, tags: ExportTags) -> tuple[str | None, str]:
    if scan.directions is not None:
        return scan.directions.view, scan.directions.source.removeprefix("DICOM ")
    towards = BEAMS.get(scan.tags.view_position)
    if towards is not None:
        return "frontal" if towards in "AP" else "lateral", f"ViewPosition {scan.tags.view_position}"
    return (tags.view, SERIES_WORDS) if tags.view else (None, "")
