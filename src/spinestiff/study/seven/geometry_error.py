"""A geometry that is off: the spine that personalisation found, bent away smoothly until it misses the radiograph.

The paper's geometry misses the rest radiograph by 2.39 mm (Table 5), ours by a few tenths. What an estimate makes of a
geometry as bad as the paper's is tried by an error of that size, smooth along the spine, after personalisation. Of the
error itself the estimate learns nothing; that there is one of this size the rest radiograph shows, and the covariance
of the geometry is told accordingly.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.optimize import brentq

from spinestiff.anatomy.files import read_torso, write_torso
from spinestiff.anatomy.rotation import exp_so3
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.arrays import Floats
from spinestiff.errors import SubjectError
from spinestiff.files import read_text
from spinestiff.formats import json_text
from spinestiff.imaging.features import VertebraCorners
from spinestiff.imaging.projection import XRayView
from spinestiff.observer import Observer
from spinestiff.personalise.placing import place_vertebrae
from spinestiff.personalise.pose import align_view
from spinestiff.study.runner import ALL_STEPS, Step
from spinestiff.study.starting_torso import left_of_shape
from spinestiff.study.steps import personalise_step
from spinestiff.study.visit import START, Visit
from spinestiff.subject.annotated_points import image_corners
from spinestiff.subject.folder import read_rest
from spinestiff.subject.geometry_outcome import GeometryRecord
from spinestiff.subject.image_names import rest_image
from spinestiff.subject.outcome_parts import nested
from spinestiff.subject.run_record import write_outcome

LENGTH = 0.25  # over which the error is alike, of the spine's length: four vertebrae
UPWARDS, TWIST_RAD_PER_MM = 0.3, 0.01  # of an error along the spine and of axial rotation, over one aside
LARGEST_MM = 30.0


@dataclass(frozen=True)
class GeometryError:
    """An error of the spine's shape that is to be made.

    Attributes
    ----------
    rmse_mm : corner RMSE wanted in the frontal rest radiograph. seed : of its shape.
    """

    rmse_mm: float
    seed: int


def smooth_errors(positions: Floats) -> Floats:
    """(V, 6, 4 V): how vertebrae move, (dt mm, dw rad), with independent standard normal numbers, for 1 mm aside.

    A displacement to the side and one to the front are Gaussian processes along the spine, less their straight lines,
    which are where a patient stands; vertebrae turn as the line through them does. Axial rotation and displacement
    along the spine are further processes.

    Parameters
    ----------
    positions : (V, 3) mm, head to foot.
    """
    height = positions[:, 1]
    reach = LENGTH * float(np.ptp(height))
    likeness = np.exp(-0.5 * ((height[:, None] - height) / reach) ** 2)
    variances, modes = np.linalg.eigh(likeness)
    process = modes * np.sqrt(np.maximum(variances, 0.0))
    line = np.column_stack([np.ones_like(height), height - height.mean()])
    bent = process - line @ np.linalg.lstsq(line, process, rcond=None)[0]
    slope = np.gradient(bent, height, axis=0)
    count = len(height)
    found = np.zeros((count, 6, 4, count))
    found[:, 0, 0], found[:, 5, 0] = bent, -slope
    found[:, 2, 1], found[:, 3, 1] = bent, slope
    found[:, 1, 2] = UPWARDS * (process - process.mean(axis=0))
    found[:, 4, 3] = TWIST_RAD_PER_MM * process
    return found.reshape(count, 6, 4 * count)


def moved_spine(torso: TorsoModel, motion: Floats) -> tuple[Floats, Floats]:
    """Positions and rotations of the vertebrae after (V, 6) (dt mm, dw rad)."""
    rest, bones = torso.rest_pose, torso.vertebra_bones
    return rest.bone_positions[bones] + motion[:, :3], exp_so3(motion[:, 3:]) @ rest.bone_rotations[bones]


def rest_rmse(torso: TorsoModel, view: XRayView, corners: VertebraCorners, motion: Floats) -> float:
    """Corner RMSE of a moved spine in a rest radiograph where the patient is where that fits best, mm."""
    positions, rotations = (np.array(part) for part in (torso.rest_pose.bone_positions, torso.rest_pose.bone_rotations))
    positions[torso.vertebra_bones], rotations[torso.vertebra_bones] = moved_spine(torso, motion)
    state = replace(torso.rest_pose, bone_positions=positions, bone_rotations=rotations)
    return align_view(torso, state, view, corners)[1].rms_mm


def size_of_error(rmse_of: Callable[[float], float], wanted: float) -> float:
    """The size, mm, at which the RMSE is what is wanted; 0 where it is larger without an error.

    Raises
    ------
    SubjectError : no size up to 30 mm.
    """
    if rmse_of(0.0) >= wanted:
        return 0.0
    if rmse_of(LARGEST_MM) <= wanted:
        raise SubjectError(
            f"geometry error: RMSE {wanted:g} mm is not reached by {LARGEST_MM:g} mm aside; ask for less"
        )
    return float(brentq(lambda size: rmse_of(size) - wanted, 0.0, LARGEST_MM, xtol=1e-3))


def off_step(error: GeometryError, visit: Visit, say: Observer) -> None:
    """``personalise``, then the error, on every mesh alike."""
    personalise_step(visit, say)
    path = visit.file(GeometryRecord.FILE)
    record = GeometryRecord.model_validate_json(read_text(path), strict=True)
    torso = read_torso(visit.file("torso.npz"))
    spine = torso.rest_pose.bone_positions[torso.vertebra_bones]
    basis = smooth_errors(spine)
    unit = basis @ np.random.default_rng(error.seed).normal(size=basis.shape[-1])
    pictures = {}
    for which in visit.subject.rest_views:
        view = read_rest(visit.subject, which).view
        pictures[str(which)] = (view, image_corners(visit.subject, rest_image(which), view))
    size = size_of_error(lambda found: rest_rmse(torso, *pictures["frontal"], found * unit), error.rmse_mm)
    views = {name: rest_rmse(torso, *picture, size * unit) for name, picture in pictures.items()}
    say(f"geometry error of {size:.2f} mm: RMSE {views['frontal']:.2f} mm in the frontal radiograph")
    for name in [one for one in ("torso.npz", START) if one not in left_of_shape(visit)]:
        shaped = read_torso(visit.file(name))
        write_torso(visit.file(name), place_vertebrae(shaped, *moved_spine(shaped, size * unit), observer=say))
    count = len(spine)
    told = record.matrix
    rows = size * basis.reshape(6 * count, -1)
    covariance = nested((told + rows @ rows.T).reshape(count, 6, -1))
    found = {**record.model_dump(mode="json"), "rmse_mm": views, "covariance": covariance}
    write_outcome(visit.subject, GeometryRecord.model_validate_json(json_text(found), strict=True))


def steps_with(error: GeometryError) -> dict[str, Step]:
    """All steps, with an error made after personalisation."""
    usual = ALL_STEPS["personalise"]

    def settings(visit: Visit) -> dict[str, object]:
        return {**usual.settings(visit), "geometry_error": [error.rmse_mm, error.seed]}

    return {**ALL_STEPS, "personalise": replace(usual, run=partial(off_step, error), settings=settings)}
