"""From tracked corners to trials: the bridge between a subject folder and the estimation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from spinestiff.anatomy.torso import TorsoModel
from spinestiff.arrays import Floats, ShortRepr
from spinestiff.curves.pushes import annotated_frame, frame_forces
from spinestiff.errors import FitError, SubjectError, TrackingError
from spinestiff.estimation.known import Known
from spinestiff.estimation.objective import FEWEST_VERTEBRAE, Picture, SkinMarkers, Trial
from spinestiff.estimation.priors import Priors
from spinestiff.estimation.ratio_priors import check_population
from spinestiff.imaging.features import Orientation, VertebraCorners
from spinestiff.imaging.projection import XRayView
from spinestiff.imaging.tracking.quality import usable_corners
from spinestiff.mechanics.equilibrium import EquilibriumProblem
from spinestiff.mechanics.push import PushSite, Rig, push_heights, push_load, push_problem
from spinestiff.personalise.markers import place_markers
from spinestiff.personalise.pose import ViewPose, align_view
from spinestiff.subject.outcomes import SideView, TrackedPush
from spinestiff.subject.records import PushRecord, SubjectRecord
from spinestiff.words import counted

LEVEL = Rig()
USUAL = Priors()
SUPPORTS: Mapping[str, str] = {"obliquity": "pelvis", "shoulder": "shoulder"}
"""What is measured of supports (``Trial.supports``), and of which."""
ODD_SHARE = 0.2
"""Of the way from shoulder to pelvis by which a push may lie elsewhere than its rib in the torso: two ribs and more."""


def rig_of(record: SubjectRecord) -> Rig:
    """How a subject's pushes are held against: a pelvis whose obliquity is estimated is level where none is given."""
    return Rig("level" if record.pelvis == "estimated" else record.pelvis, record.wall)


def known_of(record: SubjectRecord, geometry: Floats | None, population: str | None = None) -> Known:
    """From ``subject.json``, the geometry's covariance and the population asked for, which may be another one.

    Raises
    ------
    SubjectError : a prior or a population that there is not.
    """
    if record.population is not None:
        try:
            check_population(record.population)
        except FitError as error:
            raise SubjectError(f"population: {error}") from None
    priors = given_priors(record.priors)
    if record.pelvis != "estimated":
        priors = replace(priors, obliquity_deg=0.0, frame_obliquity_deg=0.0)
    if record.pelvis == "dead-loads":
        priors = replace(priors, shoulder_mm=0.0, frame_shoulder_mm=0.0)
    return Known(priors, geometry, bool(record.trunk) or record.skin_scan is not None, population)


def usual_priors() -> dict[str, float]:
    """The priors that ``subject.json`` may set, by name, as they are where it does not."""
    return {name: value for name, value in asdict(Priors()).items() if name != "trunk_power"}


def given_priors(given: Mapping[str, float], usual: Priors = USUAL, where: str = "priors") -> Priors:
    """The usual priors with those that a file gives under the key ``where``.

    Raises
    ------
    SubjectError : one that there is not, or that can't be.
    """
    known = usual_priors()
    for name in given:
        if name not in known:
            raise SubjectError(f"{where}.{name}: unknown prior; wanted one of {', '.join(sorted(known))}")
    try:
        changed: dict[str, Any] = dict(given)
        return replace(usual, **changed)
    except FitError as error:
        raise SubjectError(f"{where}: {error}") from None


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
    known : what is known beside the radiographs.
    """

    torso: TorsoModel
    problems: Mapping[str, EquilibriumProblem]
    trials: tuple[PushTrial, ...]
    poses: Mapping[str, ViewPose]
    warnings: tuple[str, ...]
    orientation: Orientation = "procrustes"
    known: Known = field(default_factory=lambda: Known())

    def of_role(self, role: str) -> tuple[PushTrial, ...]:
        return tuple(trial for trial in self.trials if trial.role == role)

    @property
    def training(self) -> tuple[PushTrial, ...]:
        """The training frames under a force."""
        return tuple(trial for trial in self.of_role("training") if trial.force_n > 0.0)

    @property
    def fitted(self) -> tuple[PushTrial, ...]:
        """What an estimate is made from: the training frames, then all unloaded frames of their pushes."""
        pushes = {trial.push for trial in self.training}
        return (*self.training, *(t for t in self.trials if t.push in pushes and t.force_n == 0.0))

    def posed(self, items: Sequence[PushTrial]) -> tuple[list[EquilibriumProblem], list[Trial]]:
        """The problem of each of these frames, and their trials, as a fit takes them."""
        return [self.problems[item.push] for item in items], [item.trial for item in items]

    def reference(self, push: str) -> PushTrial:
        """The frame of a push with the least force, to which changes are measured."""
        return min((t for t in self.trials if t.push == push), key=lambda t: t.force_n)

    def annotated_frame(self, item: PushTrial) -> int:
        """The frame of its push from whose annotation a frame's corners come, the nearest one."""
        frames = [t.frame for t in self.trials if t.push == item.push and t.trial.annotated]
        return min(frames, key=lambda frame: abs(frame - item.frame), default=0)


def _tracked(corners: VertebraCorners) -> tuple[str, ...]:
    """Vertebrae that a person did not mark: what was marked is without doubt."""
    return tuple(name for name, quality in zip(corners.vertebrae, corners.quality) if quality.min() < 1.0)


def _measured_supports(
    push: PushRecord, found: TrackedPush, forces: Sequence[float]
) -> tuple[list[dict[str, tuple[float, float]]], list[str]]:
    """Pelvis and shoulder in each frame from their place without force, as ``Trial.supports`` has them; warnings.

    Tracking measures them from the first frame. Where that one is under a force, they count from the first frame
    without force that shows them.
    """
    seen = [{"obliquity": frame.obliquity, "shoulder": frame.shoulder_mm} for frame in found.frames]
    tracked = [{name: (one.value, one.sd) for name, one in each.items() if one is not None} for each in seen]
    if forces[0] == 0.0:
        return tracked, []
    places: list[dict[str, tuple[float, float]]] = [{} for _ in tracked]
    lost = []
    for name, support in SUPPORTS.items():
        if not any(name in each for each in tracked):
            continue
        from_first = [(0.0, 0.0), *(each.get(name) for each in tracked[1:])]
        at_rest = next((one for one, force in zip(from_first, forces) if force == 0.0 and one is not None), None)
        if at_rest is None:
            lost.append(support)
            continue
        for own, one, force in zip(places, from_first, forces):
            if one is not None and force > 0.0:
                own[name] = (one[0] - at_rest[0], float(np.hypot(one[1], at_rest[1])))
    warnings = [
        f"push '{push.id}': {' and '.join(lost)} {'are' if len(lost) > 1 else 'is'} measured from its first frame, "
        f"which is under {forces[0]:g} N, and no frame without force shows {'them' if len(lost) > 1 else 'it'}; "
        f"{'their places are' if len(lost) > 1 else 'its place is'} not used"
    ]
    return places, warnings if lost else []


def push_set(
    torso: TorsoModel,
    pushes: Sequence[PushRecord],
    tracked: Mapping[str, TrackedPush],
    orientation: Orientation = "procrustes",
    rig: Rig = LEVEL,
    known: Known | None = None,
) -> PushSet:
    """Trials of all pushes; each push's view is moved to meet its usable frame of least force.

    Parameters
    ----------
    rig : what holds the torso, and what is a load.
    known : beside the radiographs.

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
        warnings += _odd_distances(torso, push)
        forces = frame_forces(push, found)
        tracked_corners = [found.corners(i) for i in range(len(found.frames))]
        corners = [usable_corners(frame) for frame in tracked_corners]
        usable = [i for i, left in enumerate(corners) if len(left) >= FEWEST_VERTEBRAE]
        if not usable:
            raise SubjectError(f"push '{push.id}': no frame is usable after tracking; see the messages of that step")
        least = min(usable, key=lambda i: forces[i])
        if forces[least] > 0.0:
            warnings.append(
                f"push '{push.id}': its least force is {forces[least]:g} N, so that where the patient stood "
                "is read under load; record a frame without force"
            )
            if push.roles[least] == "validation":
                warnings.append(
                    f"push '{push.id}' frame {least}: held out, but the frame of the least force, by which the picture "
                    "is placed and from which changes are measured: no prediction of it is one of the unseen"
                )
        try:
            view, poses[push.id] = align_view(torso, torso.rest_pose, found.view.view(), corners[least])
        except TrackingError as error:
            raise TrackingError(f"push '{push.id}' frame {least}: {error}") from None
        aside, told = _pictures_aside(torso, push, found)
        warnings += told
        markers = _markers(torso, push, found, view, known or Known())
        supports, told = _measured_supports(push, found, forces)
        warnings += told
        for index, (frame, force, role) in enumerate(zip(found.frames, forces, push.roles)):
            label = f"push '{push.id}' frame {index}"
            if frame.support_note and role != "unused":
                warnings.append(f"{label}: {frame.support_note}; the paper leaves such a frame out")
            load = push_load(torso, site, force, rig, label)
            source = annotated_frame(found, index)
            by_hand = source == index
            trial = Trial(
                load,
                corners[index],
                view,
                label,
                push.id,
                by_hand,
                supports[index],
                next((marks.points(view) for marks in found.pedicles if marks.frame == index), None),
                tuple(picture for frame_of, picture in aside if frame_of == index),
                None if markers is None else markers[index],
                "" if by_hand else f"push '{push.id}' frame {source}",
                _tracked(corners[index]) if by_hand else (),
            )
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
    return PushSet(torso, problems, tuple(trials), poses, tuple(warnings), orientation, known or Known())


def _odd_distances(torso: TorsoModel, push: PushRecord) -> list[str]:
    """Whether the push lies elsewhere between its supports than the rib does in the torso, and what explains it."""
    if push.d21_mm is None or push.d31_mm is None:
        return []
    shoulder, pelvis, rib = push_heights(torso, push.side, push.level)
    given, here = push.d31_mm / push.d21_mm, (shoulder - rib) / (shoulder - pelvis)
    off, turned = abs(given - here), abs(1.0 - given - here)
    if off <= ODD_SHARE:
        return []
    what = f"push '{push.id}': d31_mm {push.d31_mm:g} of d21_mm {push.d21_mm:g} puts the push"
    if turned < 0.5 * off:
        left = push.d21_mm - push.d31_mm
        return [f"{what} where its distance from the pelvis would; measured from the shoulder, {left:g} mm fits better"]
    return [
        f"{what} {100.0 * given:.0f} % of the way down, rib {push.level:g} lies at {100.0 * here:.0f} %; check both"
    ]


def _pictures_aside(
    torso: TorsoModel, push: PushRecord, found: TrackedPush
) -> tuple[list[tuple[int, Picture]], list[str]]:
    """Frame and radiograph of all from other sides, each view moved to meet that of the least force; warnings."""
    pictures, warnings = [], []
    for side in found.sides:
        least = min(side.pictures, key=lambda picture: push.forces_n[picture.frame])
        if push.forces_n[least.frame] > 0.0:
            warnings.append(
                f"push '{push.id}' view '{side.id}': its least force is {push.forces_n[least.frame]:g} N, so that "
                "where the patient stood is read under load; take one of a frame without force"
            )
        try:
            view, _ = align_view(torso, torso.rest_pose, side.view.view(), side.corners(least))
        except TrackingError as error:
            raise TrackingError(f"push '{push.id}' frame {least.frame} view '{side.id}': {error}") from None
        for picture in side.pictures:
            label = _side_label(push, side, picture.frame)
            corners, start = side.corners(picture), ""
            if picture.followed_from is not None:
                corners, start = usable_corners(corners), _side_label(push, side, picture.followed_from)
                lost = len(picture.vertebrae) - len(corners)
                if len(corners) < FEWEST_VERTEBRAE:
                    left = counted(len(corners), "vertebra", "vertebrae") if len(corners) else "no vertebrae"
                    warnings.append(f"{label}: dropped, {left} left (wanted {FEWEST_VERTEBRAE}); mark it by hand")
                    continue
                if lost:
                    gone = counted(lost, "vertebra", "vertebrae")
                    warnings.append(f"{label}: {gone} lost in tracking and left out")
            pedicles = None if picture.pedicles is None else picture.pedicles.points(view)
            shown = Picture(corners, view, label, f"{push.id} {side.id}", pedicles, start)
            pictures.append((picture.frame, shown))
    return pictures, warnings


def _side_label(push: PushRecord, side: SideView, frame: int) -> str:
    return f"push '{push.id}' frame {frame} view '{side.id}'"


def _markers(
    torso: TorsoModel, push: PushRecord, found: TrackedPush, view: XRayView, known: Known
) -> list[SkinMarkers] | None:
    """Of each frame, in the torso's place; None where no markers were seen. ``view`` : as it meets the torso.

    Raises
    ------
    SubjectError : they lie on no skin of this torso.
    """
    tracks = found.markers
    if tracks is None:
        return None
    rows, pixels = tracks.shown
    turn_sd = float(np.deg2rad(known.priors.marker_turn_deg))
    positions = tracks.positions
    try:
        placed = place_markers(
            torso,
            tracks.names,
            positions[tracks.reference],
            (rows, view.from_pixels(pixels)),
            view,
            tracks.side,
            turn_sd,
        )
    except SubjectError as error:
        raise SubjectError(f"push '{push.id}': skin markers: {error}") from None
    return [
        SkinMarkers(tracks.names, placed.placed(frame), placed.points, placed.outward, f"{push.id} markers")
        for frame in positions
    ]


def seen_beside(pushes: PushSet) -> tuple[str, ...]:
    """What an estimate is made from beside corners of frontal radiographs, a line each push."""
    found = []
    for push in pushes.poses:
        trials = [item.trial for item in pushes.fitted if item.push == push]
        marked = sum(trial.pedicles is not None for trial in trials)
        sides = [picture.sequence.removeprefix(f"{push} ") for trial in trials for picture in trial.further]
        parts = [f"pedicles in {counted(marked, 'frame')}"] if marked else []
        parts += [f"{counted(sides.count(name), 'radiograph')} of view '{name}'" for name in dict.fromkeys(sides)]
        counts = [int(np.isfinite(t.markers.positions).all(1).sum()) for t in trials if t.markers is not None]
        if counts:
            parts.append(f"up to {counted(max(counts), 'skin marker')} in {counted(len(counts), 'frame')}")
        if parts:
            found.append(f"push '{push}': beside the frontal corners, {' and '.join(parts)}")
    return tuple(found)
