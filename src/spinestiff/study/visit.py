"""A subject folder with its results, as later steps, tables and the report read them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from spinestiff.anatomy.files import read_torso
from spinestiff.anatomy.stiffness import NMM_PER_NM, StiffnessRatios, stiffness_ratios
from spinestiff.anatomy.template import MESHES
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.curves.cobb import DEFINITIONS, CobbReading, Definition, read_cobb_of_view
from spinestiff.curves.tilts import CobbChange, cobb_change, tilts
from spinestiff.errors import EquilibriumError, SubjectError
from spinestiff.estimation.fit import METHODS
from spinestiff.estimation.intervals import offset_from
from spinestiff.files import read_json
from spinestiff.imaging.features import ORIENTATIONS, VertebraCorners, picture_axes
from spinestiff.imaging.projection import XRayView
from spinestiff.mechanics.equilibrium import Equilibrium
from spinestiff.study.assessment import FrameAssessment, assess
from spinestiff.study.trials import PushSet, TrackedFrame, TrackedPush, push_set, usable_corners
from spinestiff.subject.folder import Subject, image_corners, read_rest, read_subject

Observer = Callable[[str], None]
# A reaction that pulls on its support by more than this, N, says that the person would have left it.
PULLING_LIMIT_N = 2.0
OBLIQUITY_LIMIT_DEG = 3.0


@dataclass(frozen=True)
class Settings:
    """What the steps are asked.

    Attributes
    ----------
    mesh : of the estimator, "coarse" or "fine".
    method : "lm" or "lbfgsb". orientation : "procrustes" or "covariance".
    parameters : ratios to estimate.
    """

    mesh: str = "coarse"
    method: str = "lm"
    orientation: str = "procrustes"
    parameters: tuple[str, ...] = ("lateral_bending", "tissue")

    def __post_init__(self) -> None:
        for what, found, known in (
            ("mesh", self.mesh, MESHES),
            ("method", self.method, METHODS),
            ("orientation", self.orientation, ORIENTATIONS),
        ):
            if found not in known:
                raise SubjectError(f"unknown {what} '{found}'; wanted one of {', '.join(known)}")


@dataclass(frozen=True)
class Visit:
    """A subject with what the earlier steps found, as later steps need it."""

    subject: Subject
    settings: Settings
    truth: Path | None = None

    def file(self, name: str) -> Path:
        return self.subject.results / name


def open_visit(folder: str | Path, settings: Settings | None = None, truth: Path | None = None) -> Visit:
    """Read and check a subject folder (and the truth file) for the steps below. Raises SubjectError."""
    if truth is not None:
        read_truth(truth)
    return Visit(read_subject(folder), settings or Settings(), truth)


def assess_visit(visit: Visit, say: Observer) -> tuple[tuple[FrameAssessment, ...], PushSet]:
    """The held-out frames' predictions, and the trials they belong to."""
    torso = read_torso(visit.file("torso.npz"))
    pushes = load_pushes(visit, torso)
    truth = read_truth(visit.truth) if visit.truth else None
    return assess(pushes, estimated_ratios(visit, torso), truth, say), pushes


def load_pushes(visit: Visit, torso: TorsoModel) -> PushSet:
    """Trials from ``tracked.json`` on a torso."""
    return push_set(torso, visit.subject.pushes, load_tracked(visit))


def load_tracked(visit: Visit) -> dict[str, TrackedPush]:
    """``tracked.json`` by push. Raises SubjectError if the file belongs to another subject."""
    record = read_json(visit.file("tracked.json"))
    tracked = {}
    for push in visit.subject.pushes:
        try:
            entry = record["pushes"][push.id]
            if len(entry["frames"]) != len(push.forces_n):
                raise ValueError(f"{len(entry['frames'])} frames for {len(push.forces_n)} forces_n")
            view = XRayView(**{**entry["view"], "shape": tuple(entry["view"]["shape"])})
            names = tuple(entry["vertebrae"])
            frames = tuple(
                TrackedFrame(
                    VertebraCorners(names, view.from_pixels(np.array(f["corners_px"])), np.array(f["quality"])),
                    f["dropped"],
                )
                for f in entry["frames"]
            )
        except (KeyError, TypeError, ValueError) as error:
            raise SubjectError(
                f"{visit.file('tracked.json')}: does not fit push '{push.id}' ({error}); run spinestiff track again"
            ) from None
        tracked[push.id] = TrackedPush(view, frames)
    return tracked


def estimated_ratios(visit: Visit, torso: TorsoModel) -> StiffnessRatios:
    """The ratios of ``estimate.json``."""
    record = read_json(visit.file("estimate.json"))
    return stiffness_ratios({name: entry["value"] for name, entry in record["ratios"].items()}, torso.joints.kinds)


def read_truth(path: Path) -> dict[str, float]:
    """True ratios of a synthetic subject's truth file. Raises SubjectError."""
    record = read_json(path)
    try:
        return {str(name): float(value) for name, value in record["ratios"].items()}
    except (KeyError, TypeError, AttributeError, ValueError):
        raise SubjectError(f"{path}: holds no true ratios; wanted the truth file of a synthetic subject") from None


def plain_stiffness(torso: TorsoModel, ratios: StiffnessRatios) -> dict[str, float]:
    """The ratios in plain units: N m/rad of lateral bending a level (thoracic, lumbar) and kPa of Young's modulus."""
    joints = ratios.scale_joints(torso.joints.stiffness)
    kinds = np.array(torso.joints.kinds)
    mu, lam = torso.tissue.lame_mu[0] * ratios.tissue[0], torso.tissue.lame_lambda[0] * ratios.tissue[1]
    return {
        "lateral_bending_thoracic_nm_per_rad": float(joints[kinds == "thoracic", 5].mean() / NMM_PER_NM),
        "lateral_bending_lumbar_nm_per_rad": float(joints[kinds == "lumbar", 5].mean() / NMM_PER_NM),
        "tissue_young_kpa": float(1e3 * mu * (3.0 * lam + 2.0 * mu) / (lam + mu)),
    }


def support_warnings(equilibrium: Equilibrium, torso: TorsoModel, side: str) -> list[str]:
    """What the reactions and the pelvis say against the supports as modelled."""
    found = []
    push = 1.0 if side == "right" else -1.0
    # The shoulder's wall pushes back against the force; a support can't pull.
    shoulder = -push * float(equilibrium.reaction("shoulder")[0])
    if shoulder < -PULLING_LIMIT_N:
        found.append(f"the shoulder's support pulls with {-shoulder:.1f} N")
    pulling = [r for r in equilibrium.reactions if r.name.startswith("wall") and r.force[2] < -PULLING_LIMIT_N]
    if pulling:
        worst = min(pulling, key=lambda r: r.force[2])
        found.append(
            f"the back wall pulls at {len(pulling)} points (most at {worst.name.removeprefix('wall_')}, "
            f"{-worst.force[2]:.1f} N): the back would have left the wall there"
        )
    pelvis = torso.bone("pelvis")
    turn = equilibrium.state.bone_rotations[pelvis] @ torso.rest_pose.bone_rotations[pelvis].T
    obliquity = float(np.degrees(np.arctan2(turn[1, 0], turn[0, 0])))
    if abs(obliquity) > OBLIQUITY_LIMIT_DEG:
        found.append(f"the pelvis tilts by {obliquity:+.1f} degrees (limit {OBLIQUITY_LIMIT_DEG:g})")
    return found


@dataclass(frozen=True)
class CobbFrame:
    """One frontal image of a visit with its Cobb angles; of a push's frames the change from its least force."""

    reading: CobbReading
    change: CobbChange | None = None

    def as_dict(self) -> dict[str, object]:
        """JSON of the frame: that of the reading and "change_deg" with the three forms of the change."""
        c = self.change
        forms = None if c is None else {"signed": c.signed, "fixed_levels": c.fixed_levels, "tilt": c.tilt}
        return {**self.reading.as_dict(), "change_deg": forms}


def cobb_frames(visit: Visit, definition: Definition = "endplate", noise_px: float | None = None) -> list[CobbFrame]:
    """The annotated rest image and, once they are tracked, all frames of the pushes.

    Parameters
    ----------
    visit : a subject folder.
    definition : "endplate" or "midline".
    noise_px : standard deviation of each corner's coordinates; None = 2 % of the vertebrae's width.
    """
    subject = visit.subject
    rest = read_rest(subject, "frontal")
    corners = image_corners(subject, "rest/frontal", rest.view)
    frames = [CobbFrame(_reading("rest/frontal", corners, rest.view, definition, noise_px))]
    if not visit.file("tracked.json").exists():
        return frames
    for push, found in load_tracked(visit).items():
        forces = subject.push(push).forces_n
        usable = [usable_corners(frame.corners) for frame in found.frames]
        spines = [tilts(c.vertebrae, c.corners, found.view, DEFINITIONS[definition]) for c in usable]
        for index, force in enumerate(forces):
            change = cobb_change(spines[int(np.argmin(forces))], spines[index])
            name = f"{push} frame {index}, {force:.0f} N"
            frames.append(CobbFrame(_reading(name, usable[index], found.view, definition, noise_px), change))
    return frames


def cobb_rows(frames: Sequence[CobbFrame]) -> list[tuple[str, str, str, str, str]]:
    """Image, Cobb angle with its levels, and the three forms of its change from the push's least force."""
    rows = []
    for frame in frames:
        largest, c = frame.reading.largest, frame.change
        forms = ["", "", ""] if c is None else [f"{value:+.1f}" for value in (c.signed, c.fixed_levels, c.tilt)]
        rows.append((frame.reading.image, str(largest.angle if largest else "-"), forms[0], forms[1], forms[2]))
    return rows


def _reading(
    image: str, corners: VertebraCorners, view: XRayView, definition: Definition, noise_px: float | None
) -> CobbReading:
    left, up = picture_axes(view)
    noise = None if noise_px is None else noise_px * float(view.pixel_spacing.mean())
    return read_cobb_of_view(
        image, corners.vertebrae, corners.corners @ np.stack([left, up], axis=1), definition, noise
    )


def compare_with_truth(visit: Visit, pushes: PushSet) -> dict[str, object] | None:
    """How far the estimate lies from known true ratios, in the measure of its joint region; None without a truth.

    The offset is found on the model, as the intervals' ends are (estimation/intervals.py).

    Raises
    ------
    SubjectError : the truth lacks a ratio that was estimated.
    """
    if visit.truth is None:
        return None
    record, truth = read_json(visit.file("estimate.json")), read_truth(visit.truth)
    lacking = [name for name in record["parameters"] if name not in truth]
    if lacking:
        raise SubjectError(f"{visit.truth}: holds no true ratio of {lacking[0]}, which was estimated")
    covariance, size = record["covariance_log"], record["joint_region_size"]
    result: dict[str, object] = {"truth": truth, "region_size": size, "distance2": None, "inside": None}
    if size is None or any(v is None for row in covariance for v in row):
        return result
    values = {name: record["ratios"][name]["value"] for name in record["parameters"]}
    estimate = stiffness_ratios(values, pushes.torso.joints.kinds)
    training = pushes.training
    try:
        offset = offset_from(
            [pushes.problems[t.push] for t in training],
            [t.trial for t in training],
            estimate,
            truth,
            record["orientation"],
        )
    except EquilibriumError:
        return result
    distance2 = float(offset @ np.linalg.solve(np.array(covariance), offset))
    return {**result, "distance2": distance2, "inside": bool(distance2 <= size)}


def truth_in_region(visit: Visit) -> bool | None:
    """Whether the 95 % joint region holds the true ratios, as ``assess`` found; None where that is not known."""
    if visit.truth is None or not visit.file("comparison.json").exists():
        return None
    record = read_json(visit.file("comparison.json"))
    return record["inside"] if record["truth"] == read_truth(visit.truth) else None
