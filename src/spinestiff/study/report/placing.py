"""Where things lie in a radiograph: pixels of the patient plane, sides, and where a push acts."""

from __future__ import annotations

import numpy as np

from spinestiff.anatomy.torso import TorsoModel
from spinestiff.arrays import Floats
from spinestiff.imaging.features import picture_axes, view_kind
from spinestiff.imaging.projection import XRayView
from spinestiff.study.trials import PushTrial
from spinestiff.subject.records import PushRecord


def pixels_of(view: XRayView, plane_mm: Floats) -> Floats:
    """(..., 2) column and row of points at the patient plane, mm."""
    return np.asarray(view.pixels(view.from_patient_plane(plane_mm)))


def pixel_mm(view: XRayView) -> tuple[float, float]:
    """mm at the patient plane from one column to the next, from one row to the next."""
    column, row = (float(value) for value in view.pixel_spacing / view.magnification)
    return column, row


def sides_of(view: XRayView) -> tuple[str, str]:
    """The letters of a picture's left and right edge: R and L, or P and A."""
    first, _ = picture_axes(view)
    letters = ("L", "R") if view_kind(view) == "frontal" else ("A", "P")
    return letters if first[0] < 0.0 else letters[::-1]  # type: ignore[return-value]


def push_arrow(torso: TorsoModel, view: XRayView, push: PushRecord, item: PushTrial) -> tuple[float, float, str]:
    """Pushed height (row), direction along the columns and force."""
    load = item.trial.load
    share = np.linalg.norm(load.forces, axis=1) / load.size
    place = share @ load.points.positions(torso.rest_pose)
    there, onward = view.pixels(view.project(np.stack([place, place + [10.0 * push.sign, 0.0, 0.0]])))
    return float(there[1]), float(np.sign(onward[0] - there[0])), f"{item.force_n:.0f} N"


def view_of(sequence: str) -> str:
    """The id of a further view; its sequence is named by its push and that, which has no spaces."""
    return sequence.rpartition(" ")[2]
