"""How well a shaped torso fits its radiographs, vertebra by vertebra, and whether annotations are usable at all."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from spinestiff.anatomy.torso import TorsoModel
from spinestiff.arrays import Floats
from spinestiff.errors import TrackingError
from spinestiff.imaging.features import (
    FEATURE_SHAPE,
    FEWEST_CORNERS,
    VertebraCorners,
    check_corners,
    place_boxes,
    reference_boxes,
    state_features,
    vertebra_rows,
    view_kind,
)
from spinestiff.imaging.pedicles import PediclePoints
from spinestiff.imaging.projection import XRayView
from spinestiff.personalise.adjustment import WRONG_WEIGHT

# Of a view's vertebrae, how many may have corners that are no picture of a vertebra; the fit sets them aside.
LARGEST_WRONG_SHARE = 0.25


@dataclass(frozen=True)
class VertebraFit:
    """How well a vertebra fits in one view.

    Attributes
    ----------
    rmse_mm : of its corners at the patient plane.
    centre_mm : distance of the simulated from the measured centre, at the patient plane.
    angle_deg : turn of the simulated against the measured box in the picture, size without sign.
    wrong_corners : how many of its corners were set aside.
    """

    rmse_mm: float
    centre_mm: float
    angle_deg: float
    wrong_corners: int


def vertebra_fits(
    torso: TorsoModel, view: XRayView, corners: VertebraCorners, weights: Floats
) -> tuple[dict[str, VertebraFit], float]:
    """The fit of each vertebra seen, and the RMSE over corners not set aside.

    Parameters
    ----------
    weights : (P,) of the usable corners, in their order.
    """
    rows, used = vertebra_rows(torso, corners), corners.usable
    simulated = state_features(torso, view, torso.rest_pose).corners[rows]
    seen, shown = (
        view.to_patient_plane(c.reshape(-1, 2)).reshape(-1, *FEATURE_SHAPE) for c in (corners.corners, simulated)
    )
    error2 = np.sum((shown - seen) ** 2, axis=2)
    trusted = np.zeros(used.shape, dtype=bool)
    trusted[used] = weights >= WRONG_WEIGHT
    boxes, fits = reference_boxes(torso, view)[rows], {}
    for i, name in enumerate(corners.vertebrae):
        one = used[i : i + 1]
        measured, found = (
            place_boxes(c[i : i + 1], boxes[i : i + 1], "procrustes", one, (name,)) for c in (seen, shown)
        )
        turn = float(found.angle[0] - measured.angle[0])
        fits[name] = VertebraFit(
            rmse_mm=float(np.sqrt(error2[i][used[i]].mean())),
            centre_mm=float(np.linalg.norm(found.centre[0] - measured.centre[0])),
            angle_deg=abs(float(np.degrees(np.arctan2(np.sin(turn), np.cos(turn))))),
            wrong_corners=int((used[i] & ~trusted[i]).sum()),
        )
    rmse = float(np.sqrt(error2[trusted].mean())) if trusted.any() else float("nan")
    return fits, rmse


def check_pictures(
    torso: TorsoModel,
    pictures: Mapping[str, tuple[VertebraCorners, XRayView]],
    pedicles: Mapping[str, PediclePoints],
) -> None:
    """Raise TrackingError for pictures that can't be used.

    A vertebra whose corners are no picture of one is left to the fit, which sets it aside, as long as it is one of a
    few.
    """
    if not any(view_kind(view) == "frontal" for _, view in pictures.values()):
        raise TrackingError("no frontal radiograph; wanted one at least")
    for name in pedicles:
        if name not in pictures:
            raise TrackingError(f"pedicles are given in view '{name}', which has no picture")
    for name, (corners, view) in pictures.items():
        if not len(corners):
            raise TrackingError(f"no vertebra is annotated in the {name} radiograph")
        boxes = reference_boxes(torso, view)[vertebra_rows(torso, corners)]
        seen = view.to_patient_plane(corners.corners.reshape(-1, 2)).reshape(-1, *FEATURE_SHAPE)
        bad: list[TrackingError] = []
        for i, vertebra in enumerate(corners.vertebrae):
            usable = int(corners.usable[i].sum())
            if usable < FEWEST_CORNERS:
                raise TrackingError(
                    f"{vertebra} has {usable} usable corners in the {name} radiograph, wanted at least "
                    f"{FEWEST_CORNERS}; leave it out"
                )
            try:
                check_corners(seen[i : i + 1], boxes[i : i + 1], corners.selected((vertebra,)))
            except TrackingError as error:
                bad.append(error)
        if len(bad) > LARGEST_WRONG_SHARE * len(corners):
            raise TrackingError(f"{name} radiograph: {bad[0]}")
