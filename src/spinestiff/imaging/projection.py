"""Perspective X-ray views: world points to the detector, to the patient plane and to pixels (paper 4.1).

A point at height ``h`` above the detector, seen from a source at distance ``D`` from it, lands at
``a + (a - p) h / (D - h)``, with ``a`` the point's foot on the detector and ``p`` the source's foot (the principal
point). Written so, nothing large cancels however far the source is: at infinity it is the orthographic view.

Detector coordinates (u, v) are mm from the centre of pixel row 0, column 0; u grows with the column, v with the row.
A pixel's centre has whole coordinates: pixel (column, row) covers [column - 0.5, column + 0.5).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from spinestiff.arrays import ByFields, Floats, read_only
from spinestiff.errors import RadiographError

LEFT, UP, FRONT = np.eye(3)
"""World axes by anatomy: patient left (x), superior (y), anterior (z)."""


@dataclass(frozen=True)
class XRayView(ByFields):
    """Where the source and the detector are.

    Attributes
    ----------
    source : (3,) mm, the focal spot.
    detector_origin : (3,) mm, centre of the pixel in row 0, column 0.
    detector_axes : (2, 3) unit and perpendicular, direction of growing column, of growing row.
    pixel_spacing : (2,) mm on the detector, from one column to the next, from one row to the next.
    shape : rows, columns.
    source_to_patient : mm from the source to the patient plane, along the detector's normal.

    Raises
    ------
    RadiographError : a field has the wrong shape, or the geometry is impossible.
    """

    source: Floats
    detector_origin: Floats
    detector_axes: Floats
    pixel_spacing: Floats
    shape: tuple[int, int]
    source_to_patient: float

    def __post_init__(self) -> None:
        shapes = {"source": (3,), "detector_origin": (3,), "detector_axes": (2, 3), "pixel_spacing": (2,)}
        for key, shape in shapes.items():
            object.__setattr__(self, key, read_only(key, getattr(self, key), shape, RadiographError))
        rows, columns = (int(n) for n in self.shape)
        object.__setattr__(self, "shape", (rows, columns))
        object.__setattr__(self, "source_to_patient", float(self.source_to_patient))
        if min(rows, columns) < 1:
            raise RadiographError(f"view has {rows} x {columns} pixels; wanted at least 1 x 1")
        if self.pixel_spacing.min() <= 0.0:
            raise RadiographError(f"pixel spacing {self.pixel_spacing.tolist()} mm; wanted > 0")
        if np.abs(self.detector_axes @ self.detector_axes.T - np.eye(2)).max() > 1e-9:
            raise RadiographError("detector axes are no perpendicular unit vectors")
        if not self.source_to_detector > 0.0:
            raise RadiographError("the X-ray source lies in the plane of the detector")
        if not 0.0 < self.source_to_patient <= self.source_to_detector:
            raise RadiographError(
                f"distance source to patient {self.source_to_patient:g} mm; wanted > 0 and at most the distance "
                f"source to detector, {self.source_to_detector:g} mm"
            )

    @cached_property
    def normal(self) -> Floats:
        """(3,) unit, from the source towards the detector."""
        normal = np.cross(self.detector_axes[0], self.detector_axes[1])
        return normal if normal @ (self.detector_origin - self.source) >= 0.0 else -normal

    @cached_property
    def source_to_detector(self) -> float:
        """Distance of the source from the detector's plane, mm."""
        return float(self.normal @ (self.detector_origin - self.source))

    @cached_property
    def principal_point(self) -> Floats:
        """(2,) mm on the detector, foot of the source."""
        foot: Floats = self.detector_axes @ (self.source - self.detector_origin)
        return foot

    @property
    def magnification(self) -> float:
        """Of the patient plane: source to detector / source to patient."""
        return self.source_to_detector / self.source_to_patient

    def project(self, points: ArrayLike) -> Floats:
        """World points (..., 3) mm to the detector (..., 2) mm.

        Raises
        ------
        RadiographError : a point lies at or behind the source.
        """
        foot, height, ahead = self._foot_and_height(points)
        uv: Floats = foot + (foot - self.principal_point) * (height / ahead)[..., None]
        return uv

    def project_with_jacobian(self, points: ArrayLike) -> tuple[Floats, Floats]:
        """``project`` and its derivative: (..., 2) mm and (..., 2, 3) mm/mm."""
        foot, height, ahead = self._foot_and_height(points)
        away = foot - self.principal_point
        uv = foot + away * (height / ahead)[..., None]
        slope = away / ahead[..., None]
        scale = (self.source_to_detector / ahead)[..., None, None]
        return uv, scale * (self.detector_axes - slope[..., :, None] * self.normal)

    def to_patient_plane(self, detector_mm: ArrayLike) -> Floats:
        """Detector (..., 2) mm to mm at the patient plane (..., 2), from the principal point."""
        return (np.asarray(detector_mm) - self.principal_point) / self.magnification

    def from_patient_plane(self, plane_mm: ArrayLike) -> Floats:
        """Inverse of ``to_patient_plane``."""
        return np.asarray(plane_mm) * self.magnification + self.principal_point

    def pixels(self, detector_mm: ArrayLike) -> Floats:
        """Detector (..., 2) mm to (column, row), whole numbers at pixel centres."""
        return np.asarray(detector_mm) / self.pixel_spacing

    def from_pixels(self, pixels: ArrayLike) -> Floats:
        """Inverse of ``pixels``: (column, row) to detector mm."""
        return np.asarray(pixels) * self.pixel_spacing

    def detector_point(self, detector_mm: ArrayLike) -> Floats:
        """World position (..., 3) mm of a point of the detector (..., 2) mm."""
        return self.detector_origin + np.asarray(detector_mm) @ self.detector_axes

    def moved(self, shift: ArrayLike = (0.0, 0.0), roll: float = 0.0) -> XRayView:
        """The view in which the patient stands elsewhere in the patient plane.

        The patient is rolled about the principal ray, then shifted: a point of the patient plane seen before at
        ``q`` (``to_patient_plane``) is seen at ``Q(roll) q + shift``; points before and behind that plane follow
        with their own magnification, as in a real second exposure. The anatomy keeps its world coordinates: source
        and detector take the opposite motion together.

        Parameters
        ----------
        shift : (2,) mm at the patient plane, along growing columns and growing rows.
        roll : rad, from growing columns towards growing rows.
        """
        shift = read_only("shift", shift, (2,), RadiographError)
        cosine, sine = np.cos(roll), np.sin(roll)
        axes = np.array([[cosine, -sine], [sine, cosine]]) @ self.detector_axes
        # Along the detector only: the source may be far, so its distance must not enter the origin.
        foot = self.detector_origin + self.principal_point @ self.detector_axes
        origin = foot - (self.principal_point + shift) @ axes
        return replace(self, source=self.source - shift @ axes, detector_origin=origin, detector_axes=axes)

    def _foot_and_height(self, points: ArrayLike) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
        # Foot on the detector, height above it, distance ahead of the source.
        relative = np.asarray(points) - self.detector_origin
        height = -(relative @ self.normal)
        ahead = self.source_to_detector - height
        if np.any(np.real(ahead) <= 0.0):
            raise RadiographError("a point lies at or behind the X-ray source; check the distance source to patient")
        return relative @ self.detector_axes.T, height, ahead


def placed_view(
    columns: Floats,
    rows: Floats,
    beam: Floats,
    *,
    sid: float,
    source_to_patient: float,
    shape: tuple[int, int],
    pixel: float | tuple[float, float],
    centre: ArrayLike,
) -> XRayView:
    """A view whose principal ray passes through ``centre`` in the patient plane and hits the image's centre.

    Parameters
    ----------
    columns, rows, beam : (3,) unit world vectors: growing columns, growing rows, source towards detector.
    sid : mm, source to detector.
    source_to_patient : mm.
    shape : rows, columns.
    pixel : mm at the detector; one number, or (from column to column, from row to row).
    centre : (3,) mm in the world.
    """
    middle = read_only("centre", centre, (3,), RadiographError)
    spacing = np.broadcast_to(np.asarray(pixel, dtype=float), (2,))
    half = 0.5 * (np.array(shape[::-1]) - 1) * spacing
    source = middle - source_to_patient * beam
    origin = middle + (sid - source_to_patient) * beam - half[0] * columns - half[1] * rows
    return XRayView(source, origin, np.stack([columns, rows]), spacing, shape, source_to_patient)


def frontal_view(
    sid: float = 1500.0,
    source_to_patient: float = 1340.0,
    shape: tuple[int, int] = (1024, 1024),
    pixel: float | tuple[float, float] = 0.417,
    centre: ArrayLike = (0.0, 200.0, 0.0),
) -> XRayView:
    """Anterior to posterior: source in front, detector behind; the patient's left at growing columns (``L\\F``)."""
    return placed_view(
        LEFT, -UP, -FRONT,
        sid=sid, source_to_patient=source_to_patient, shape=shape, pixel=pixel, centre=centre,
    )  # fmt: skip


def lateral_view(
    sid: float = 1500.0,
    source_to_patient: float = 1340.0,
    shape: tuple[int, int] = (1024, 1024),
    pixel: float | tuple[float, float] = 0.417,
    centre: ArrayLike = (0.0, 200.0, 0.0),
) -> XRayView:
    """Source at the patient's right, detector at the left; anterior at growing columns (``A\\F``)."""
    return placed_view(
        FRONT, -UP, LEFT,
        sid=sid, source_to_patient=source_to_patient, shape=shape, pixel=pixel, centre=centre,
    )  # fmt: skip
