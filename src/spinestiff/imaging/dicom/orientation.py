"""Which way a radiograph shows the patient: PatientOrientation, view position and laterality; contradictions refused.

DICOM's patient axes are LPS: x to the patient's left, y posterior, z superior. The world of this package is x left,
y superior, z anterior; ``lps_from_world`` is the one place where the two meet.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from spinestiff.arrays import Floats
from spinestiff.errors import RadiographError
from spinestiff.imaging.dicom.millimetres import Geometry
from spinestiff.imaging.dicom.tags import MissingValue, Tags

# Signs of LPS directions by letter (PatientOrientation).
_LETTERS = {"L": (1, 0, 0), "R": (-1, 0, 0), "P": (0, 1, 0), "A": (0, -1, 0), "H": (0, 0, 1), "F": (0, 0, -1)}
BEAMS = {"AP": "P", "PA": "A", "LL": "L", "RL": "R"}
"""Where the beam of a ViewPosition goes to."""
BEAM_ASSUMED = "assumed anterior to posterior"
"""What a frontal view's beam comes from that nothing tells."""


@dataclass(frozen=True)
class Directions:
    """Letters of growing columns, growing rows and the beam, and where they came from."""

    column: str
    row: str
    beam: str
    source: str
    beam_source: str

    @property
    def view(self) -> str:
        """Frontal or lateral."""
        return "frontal" if self.column in "LR" else "lateral"

    @property
    def axes(self) -> tuple[Floats, Floats, Floats]:
        """World directions of growing columns, growing rows and the beam, (3,) each."""
        column, row, beam = (world_from_lps(_LETTERS[letter]) + 0.0 for letter in (self.column, self.row, self.beam))
        return column, row, beam


def lps_from_world(vectors: ArrayLike) -> Floats:
    """DICOM patient coordinates (left, posterior, superior) of world vectors (left, superior, anterior), (..., 3)."""
    v = np.asarray(vectors, dtype=float)
    return np.stack([v[..., 0], -v[..., 2], v[..., 1]], axis=-1)


def world_from_lps(vectors: ArrayLike) -> Floats:
    """Inverse of ``lps_from_world``."""
    v = np.asarray(vectors, dtype=float)
    return np.stack([v[..., 0], v[..., 2], -v[..., 1]], axis=-1)


def letter(direction: Floats) -> str:
    """Letter of the anatomical direction nearest to a world vector."""
    lps = lps_from_world(direction)
    return max(_LETTERS, key=lambda name: float(np.dot(_LETTERS[name], lps)))


def directions(tags: Tags, given: Geometry) -> Directions:
    """Which way columns, rows and the beam go.

    Raises
    ------
    MissingValue : no PatientOrientation and no view given.
    RadiographError : an orientation that is not upright, or two statements that contradict each other.
    """
    side = _laterality(tags)
    column, row, source = _image_axes(tags, given)
    frontal = column in "LR"
    shown = "frontal" if frontal else "lateral"
    towards = BEAMS.get(tags.view_position)
    if towards is not None:
        if (towards in "AP") != frontal:
            raise RadiographError(
                f"ViewPosition: found {tags.view_position}, wanted one of a {shown} view ({source}); correct either"
            )
        if towards in "LR" and side and side != towards:
            raise RadiographError(
                f"ViewPosition: found {tags.view_position}, wanted {side}L as the laterality says; correct either"
            )
        return Directions(column, row, towards, source, f"DICOM ViewPosition {tags.view_position}")
    if frontal and given.beam is not None:
        return Directions(column, row, BEAMS[given.beam], source, f"given as {given.beam}")
    if frontal:
        return Directions(column, row, "P", source, BEAM_ASSUMED)
    if side:
        return Directions(column, row, side, source, f"DICOM laterality {side}, that side next to the detector")
    return Directions(column, row, "L", source, "assumed right to left")


def _laterality(tags: Tags) -> str:
    """L, R or nothing; of a frontal view it only says which side of the body was examined."""
    sides = {side for side in (tags.image_laterality, tags.laterality) if side in ("L", "R")}
    if len(sides) > 1:
        raise RadiographError(
            f"ImageLaterality: found {tags.image_laterality}, wanted {tags.laterality} as in Laterality; correct either"
        )
    return sides.pop() if sides else ""


def _image_axes(tags: Tags, given: Geometry) -> tuple[str, str, str]:
    if given.view not in (None, "frontal", "lateral"):
        raise RadiographError(f"the given view: found '{given.view}', wanted frontal or lateral")
    if tags.orientation is None:
        if given.view is None:
            raise MissingValue(
                "no PatientOrientation; if the image is shown as usual, add xray.orientation 'standard' to subject.json"
            )
        assumed = ("L", "F") if given.view == "frontal" else ("A", "F")
        words = f"given as a {given.view} view shown as usual"
        return *assumed, f"{words}, columns taken to grow to {assumed[0]}, rows to {assumed[1]}"
    column, row = tags.orientation
    if column not in tuple("LRAP") or row not in tuple("HF"):
        raise RadiographError(
            f"PatientOrientation: found {column}\\{row}, wanted columns to L, R, A or P and rows to F or H"
        )
    shown = "frontal" if column in "LR" else "lateral"
    if given.view not in (None, shown):
        raise RadiographError(
            f"PatientOrientation: found {column}\\{row}, a {shown} view, wanted a {given.view} one; put the "
            f"{given.view} radiograph in its place"
        )
    return column, row, f"DICOM PatientOrientation {column}\\{row}"
