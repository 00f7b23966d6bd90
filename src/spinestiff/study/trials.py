"""From tracked corners to trials: the bridge between a subject folder and the estimation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from spinestiff.anatomy.torso import TorsoModel
from spinestiff.arrays import ShortRepr
from spinestiff.errors import SubjectError, TrackingError
from spinestiff.estimation.objective import FEWEST_VERTEBRAE, Trial
from spinestiff.imaging.features import Orientation
from spinestiff.imaging.tracking.quality import usable_corners
from spinestiff.mechanics.equilibrium import EquilibriumProblem
from spinestiff.mechanics.push import PushSite, Rig, push_load, push_problem
from spinestiff.personalise.pose import ViewPose, align_view
from spinestiff.subject.outcomes import TrackedPush
from spinestiff.subject.records import PushRecord, SubjectRecord
from spinestiff.words import counted

LEVEL = Rig()


def rig_of(record: SubjectRecord) -> Rig:
    """How a subject's pushes are held against: a pelvis whose obliquity is estimated is level where none is given."""
    return Rig("level" if record.pelvis == "estimated" else record.pelvis, record.wall)


@dataclass(frozen=True)
class PushTrial:
    """A trial with where it comes from.

    Attributes
    ----------
    push : id. frame : index in the push. force_n : magnitude. role : as in ``subject.json``.
    trial : load, usable corners and the view moved to where the patient stood.
    """

    push: str
    frame: int
    force_n: float
    role: str
    trial: Trial


@dataclass(frozen=True, repr=False)
class PushSet(ShortRepr):
    """All trials of a subject on one torso, with the problem of each push.

    Attributes
    ----------
    torso : at rest in the subject's shape.
    problems : push id -> supports for its side.
    trials : every usable frame, the unloaded first ones included.
    poses : push id -> how the patient stood.
    warnings : what was left out, and why; supports that moved.
    orientation : of a vertebra in the picture, for all that is made of the trials.
    """

    torso: TorsoModel
    problems: Mapping[str, EquilibriumProblem]
    trials: tuple[PushTrial, ...]
    poses: Mapping[str, ViewPose]
    warnings: tuple[str, ...]
    orientation: Orientation = "procrustes"

    def of_role(self, role: str) -> tuple[PushTrial, ...]:
        return tuple(trial for trial in self.trials if trial.role == role)

    @property
    def training(self) -> tuple[PushTrial, ...]:
        """The training frames under a force."""
        return tuple(trial for trial in self.of_role("training") if trial.force_n > 0.0)

    def reference(self, push: str) -> PushTrial:
        """The frame of a push with the least force, to which changes are measured."""
        return min((t for t in self.trials if t.push == push), key=lambda t: t.force_n)


def push_set(
    torso: TorsoModel,
    pushes: Sequence[PushRecord],
    tracked: Mapping[str, TrackedPush],
    orientation: Orientation = "procrustes",
    rig: Rig = LEVEL,
) -> PushSet:
    """Trials of all pushes; each push's view is moved to meet its usable frame of least force.

    Parameters
    ----------
    rig : what holds the torso, and what is a load.

    Raises
    ------
    SubjectError : a push without a usable frame, or no training frame is left.
    TrackingError : corners of the frame of least force that are no picture of the torso's vertebrae.
    """
    problems, trials, poses, warnings = {}, [], {}, []
    by_side: dict[str, EquilibriumProblem] = {}
    for push in pushes:
        found = tracked[push.id]
        if push.side not in by_side:
            by_side[push.side] = push_problem(torso, push.side, rig)
        problems[push.id] = by_side[push.side]
        site = PushSite(push.side, push.level, push.d21_mm, push.d31_mm)
        if len(found.frames) != len(push.forces_n):
            raise SubjectError(
                f"push '{push.id}': {len(found.frames)} tracked frames for {len(push.forces_n)} forces_n; "
                "run spinestiff track again"
            )
        tracked_corners = [found.corners(i) for i in range(len(found.frames))]
        corners = [usable_corners(frame) for frame in tracked_corners]
        usable = [i for i, left in enumerate(corners) if len(left) >= FEWEST_VERTEBRAE]
        if not usable:
            raise SubjectError(f"push '{push.id}': no frame is usable after tracking; see the messages of that step")
        least = min(usable, key=lambda i: push.forces_n[i])
        if push.forces_n[least] > 0.0:
            warnings.append(
                f"push '{push.id}': its least force is {push.forces_n[least]:g} N, so that where the patient stood "
                "is read under load; record a frame without force"
            )
        try:
            view, poses[push.id] = align_view(torso, torso.rest_pose, found.view.view(), corners[least])
        except TrackingError as error:
            raise TrackingError(f"push '{push.id}' frame {least}: {error}") from None
        for index, (frame, force, role) in enumerate(zip(found.frames, push.forces_n, push.roles)):
            label = f"push '{push.id}' frame {index}"
            if frame.support_note and role != "unused":
                warnings.append(f"{label}: {frame.support_note}; the paper leaves such a frame out")
            load = push_load(torso, site, force, rig, label)
            # Seen unloaded in the same sequence, vertebrae are compared by how far they moved from there.
            unloaded = corners[least] if push.forces_n[least] == 0.0 and index != least else None
            trial = Trial(load, corners[index], view, label, push.id, unloaded)
            lost = len(found.vertebrae) - len(trial.corners)
            if index not in usable:
                left = len(trial.corners)
                seen = counted(left, "vertebra", "vertebrae") if left else "no vertebrae"
                warnings.append(f"{label}: dropped, {seen} left (wanted {FEWEST_VERTEBRAE})")
                continue
            if lost and role != "unused":
                warnings.append(f"{label}: {counted(lost, 'vertebra', 'vertebrae')} lost in tracking and left out")
            trials.append(PushTrial(push.id, index, force, role, trial))
    if not any(t.role == "training" and t.force_n > 0.0 for t in trials):
        raise SubjectError("no training frame is left after tracking; see the messages of the tracking step")
    return PushSet(torso, problems, tuple(trials), poses, tuple(warnings), orientation)
