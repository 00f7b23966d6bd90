"""Sound subjects for ``judgement.py``, by corners alone: bodies, curves, stances, annotators and tracks that scatter.

The truth is a torso of its own: a body of 10 to 16 years with its own kyphosis and lordosis, a curve of 5 to 45
degrees, a spine up to 7 % longer or shorter than usual at that height, and vertebrae of their own widths, heights and
depths. Its equilibria under two pushes are solved at ratios drawn from the range of the paper's Table 4 and projected.
The estimator starts from the template and is told height, forces, level and nominal views only; it gets corners as an
annotator marks them and as the tracker follows them. What it is not told:

    stance      each exposure: shift, roll and yaw; distance to the source; between the rest pictures and a push
                also a change of posture (the spine sways by a smooth curve)
    annotation  0.25 to 1 mm, a standard deviation for each annotator; a lateral view without T1 to T4 in half of them
    tracking    vertebrae err as bodies, in shifts and turns, as the tracker's do (docs/tracking.md), by an error that
                is predicted within a fifth; one vertebra in a hundred is lost
    gauge       2 % a push and half a newton a frame; the pushed point lies 5 mm off

Both torsos have the coarse mesh.
"""

from __future__ import annotations

import copyreg
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Literal

import numpy as np

from spinestiff.anatomy.names import VERTEBRAE
from spinestiff.anatomy.state import TorsoState
from spinestiff.anatomy.stiffness import stiffness_ratios
from spinestiff.anatomy.template import template_torso
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.arrays import Floats
from spinestiff.curves.tilts import cobb_angle, tilts
from spinestiff.estimation.fitted import StiffnessFit
from spinestiff.estimation.known import Known
from spinestiff.imaging.features import VertebraCorners, silhouette_shares, state_features
from spinestiff.imaging.projection import XRayView, frontal_view, lateral_view
from spinestiff.imaging.tracking.quality import quality_of
from spinestiff.mechanics.equilibrium import EquilibriumProblem
from spinestiff.mechanics.loads import rib_push
from spinestiff.mechanics.supports import three_point_supports
from spinestiff.personalise.placing import place_vertebrae
from spinestiff.personalise.pose import posed
from spinestiff.personalise.shape import Personalised, personalise
from spinestiff.personalise.sizes import resized
from spinestiff.study.fits import fit_pushes
from spinestiff.study.synthetic.spines import CURVES, curved_spine
from spinestiff.study.synthetic.subject import BENDING_RANGE, TISSUE_RANGE
from spinestiff.study.trials import PushSet, push_set
from spinestiff.subject.outcomes import TrackedPush
from spinestiff.subject.records import PushRecord, Role


def _proxy(content: dict[Any, Any]) -> MappingProxyType[Any, Any]:
    return MappingProxyType(content)


# Python pickles no read-only mapping by itself, and fits are kept as pickles.
copyreg.pickle(MappingProxyType, lambda mapping: (_proxy, (dict(mapping),)))
AGES, HEIGHT_SD_CM, LARGEST_HEIGHT_CM = (10.0, 16.0), 6.0, 15.0
MEAN_HEIGHT_CM = {"female": (138.0, 163.0), "male": (138.0, 174.0)}  # at the first and at the last of the ages
KYPHOSIS_DEG, LORDOSIS_DEG, COBB_DEG = (22.0, 48.0), (37.0, 58.0), (5.0, 45.0)
# As in personalisation.py: lengths and sizes of spines and vertebrae over those usual at a height.
SPINE_LENGTH_SD, LARGEST_LENGTH = 0.035, 0.07
PERSON_SD, VERTEBRA_SD = np.array([0.07, 0.03, 0.07]), np.array([0.035, 0.035, 0.035])
ANNOTATION_MM = (0.25, 1.0)
SHIFT_SD_MM, ROLL_SD, YAW_SD, DISTANCE_SD = 4.0, 0.012, 0.026, 0.007
SWAY_SD_DEG = 1.5  # change of the coronal angle from one exposure to another in which the patient was placed anew
FRAME_SHIFT_SD_MM, FRAME_ROLL_SD = 0.5, 0.002  # within a push
# Predicted error of a corner along one axis; errors of a vertebra's shifts along columns and rows and of its turn (as
# channels) over it, where drag is small (tracking_drag.py); correlated with neighbours as estimation.priors has it.
TRACK_MM, TRACK_SPREAD, PREDICTED_WITHIN, LOST = 0.108, 0.35, 0.2, 0.01
TRACK_CHANNELS = np.array([1.4, 1.0, 1.67])
TRACK_SHARED, TRACK_LENGTH = 0.3, 2.0  # of the variance
# As tracking_drag.py has it, relative to the motion: shifts of all vertebrae alike, of neighbours over so many, of each
# by itself; turns.
DRAG_MEAN, DRAG_SMOOTH, DRAG_LENGTH, DRAG_OWN, DRAG_TURN = -0.004, 0.005, 3.5, 0.005, 0.007
FORCE_SD, READING_SD_N, HEIGHT_SD_LEVELS = 0.02, 0.5, 0.2
FORCE_N = (30.0, 90.0)
PULLS = (30.0, 1000.0)  # N/mm, that bring the vertebrae of the truth to their places
PUSHES: Mapping[str, tuple[tuple[float, Role], ...]] = {
    "main": ((0.0, "unused"), (1 / 3, "training"), (2 / 3, "training"), (1.0, "validation")),
    "second": ((0.0, "unused"), (0.5, "unused"), (1.0, "validation")),
}


@dataclass(frozen=True)
class Subject:
    """A subject as the steps get it, and what it was made of.

    Attributes
    ----------
    seed : of everything random.
    height_cm : as told.
    cobb_deg : of the truth at rest.
    annotation_mm : the annotator's standard deviation.
    ratios : true ones.
    rest : view name -> annotated corners and nominal view.
    records, tracked : the pushes as told and as tracked.
    """

    seed: int
    height_cm: float
    cobb_deg: float
    annotation_mm: float
    ratios: Mapping[str, float]
    rest: Mapping[str, tuple[VertebraCorners, XRayView]]
    records: tuple[PushRecord, ...]
    tracked: Mapping[str, TrackedPush]


@dataclass(frozen=True)
class Estimated:
    """What the steps make of a subject."""

    shaped: Personalised
    fit: StiffnessFit


def make_subject(seed: int) -> Subject:
    """The subject of a seed.

    Raises
    ------
    SpinestiffError : this torso can't be bent that far, or can't carry the push.
    """
    random = np.random.default_rng([12, seed])
    sex: Literal["female", "male"] = "female" if random.uniform() < 0.8 else "male"
    age = float(random.uniform(*AGES))
    height = drawn_height(random, age, sex)
    torso = _true_torso(random, height, age, sex)
    ratios = {
        name: float(np.exp(random.uniform(*np.log(limits))))
        for name, limits in (("lateral_bending", BENDING_RANGE), ("tissue", TISSUE_RANGE))
    }
    nominal = {
        name: nominal_view(make, height) for name, make in (("frontal", frontal_view), ("lateral", lateral_view))
    }
    shares = silhouette_shares(torso, nominal["frontal"], torso.rest_pose)
    seen = state_features(torso, nominal["frontal"], torso.rest_pose, shares).corners
    cobb = cobb_angle(tilts(VERTEBRAE, seen, nominal["frontal"])).degrees
    annotation = float(np.exp(random.uniform(*np.log(ANNOTATION_MM))))
    rest = {}
    for name, view in nominal.items():
        corners = projected(torso, standing(view, random, lateral=name == "lateral"), torso.rest_pose)
        corners = corners + random.normal(0.0, annotation * view.magnification, corners.shape)
        names = VERTEBRAE[4:] if name == "lateral" and random.uniform() < 0.5 else VERTEBRAE
        rest[name] = (VertebraCorners(VERTEBRAE, corners).selected(names), view)
    side: Literal["left", "right"] = "left" if cobb > 0.0 else "right"
    problem = EquilibriumProblem(torso, three_point_supports(torso, side))
    stiffness = stiffness_ratios(ratios, torso.joints.kinds)
    force = float(random.uniform(*FORCE_N))
    drag = drawn_drag(np.random.default_rng([23, seed]))
    records, tracked = [], {}
    for push, level in (("main", float(random.uniform(7.0, 9.0))), ("second", float(random.uniform(5.0, 7.0)))):
        true_level = level + HEIGHT_SD_LEVELS * float(random.normal())
        wrong = 1.0 + FORCE_SD * float(random.normal())
        states, told, state = [], [], torso.rest_pose
        for share, _ in PUSHES[push]:
            state = problem.solve(rib_push(torso, side, true_level, share * force), stiffness, state).require().state
            states.append(state)
            reading = share * force * wrong + READING_SD_N * float(random.normal())
            told.append(round(max(reading, 0.0), 1) if share else 0.0)
        tracked[push] = tracked_push(torso, nominal["frontal"], states, told, annotation, drag, random)
        records.append(
            PushRecord(
                id=push,
                side=side,
                level=round(level, 1),
                d21_mm=400.0,
                d31_mm=200.0,
                frames=push,
                forces_n=tuple(told),
                roles=tuple(role for _, role in PUSHES[push]),
            )
        )
    return Subject(seed, round(height, 0), float(cobb), annotation, ratios, rest, tuple(records), tracked)


def estimate(subject: Subject) -> Estimated:
    """Personalised and fitted as the steps do it, but for the intervals."""
    shaped = personalise(template_torso(subject.height_cm), subject.rest)
    pushes = push_set(shaped.torso, subject.records, subject.tracked, known=Known(geometry=shaped.covariance))
    return Estimated(shaped, fitted(pushes, subject.ratios))


def fitted(pushes: PushSet, start: Mapping[str, float]) -> StiffnessFit:
    """The fit of the training frames, begun at the truth."""
    return fit_pushes(pushes, ("lateral_bending", "tissue"), start, extent="estimate")


def _true_torso(random: np.random.Generator, height: float, age: float, sex: Literal["female", "male"]) -> TorsoModel:
    longer = 1.0 + float(np.clip(random.normal(0.0, SPINE_LENGTH_SD), -LARGEST_LENGTH, LARGEST_LENGTH))
    body = template_torso(
        height,
        age_years=age,
        sex=sex,
        kyphosis_deg=float(random.uniform(*KYPHOSIS_DEG)),
        lordosis_deg=float(random.uniform(*LORDOSIS_DEG)),
    ).scaled(longer)
    body = resized(body, np.exp(random.normal(0.0, PERSON_SD) + random.normal(0.0, VERTEBRA_SD, (17, 3))))
    cobb = float(random.uniform(*COBB_DEG)) * float(random.choice([-1.0, 1.0]))
    return place_vertebrae(body, *curved_spine(body, cobb, str(random.choice(list(CURVES)))), PULLS)


def nominal_view(make, height: float) -> XRayView:  # type: ignore[no-untyped-def]
    spine = template_torso(height).rest_pose.bone_positions[template_torso(height).vertebra_bones]
    centre = np.array([0.0, 0.5 * (spine[0, 1] + spine[-1, 1]), 0.0])
    return make(shape=(1536, 1024), centre=centre)  # type: ignore[no-any-return]


def standing(nominal: XRayView, random: np.random.Generator, lateral: bool) -> XRayView:
    """Where source and detector really are about a patient who was placed anew."""
    nearer = 1.0 + DISTANCE_SD * float(random.normal())
    # Nearer to the source, as far from the detector.
    make = lateral_view if lateral else frontal_view
    centre = nominal.source + nominal.source_to_patient * nominal.normal
    view = make(
        sid=nominal.source_to_detector,
        source_to_patient=nearer * nominal.source_to_patient,
        shape=nominal.shape,
        centre=centre,
    )
    shift, roll, yaw = (random.normal(0.0, sd, size) for sd, size in ((SHIFT_SD_MM, 2), (ROLL_SD, 1), (YAW_SD, 1)))
    return posed(view, shift, float(roll[0]), float(yaw[0]))


def projected(torso: TorsoModel, view: XRayView, state: TorsoState) -> Floats:
    """(V, 4, 2) mm on the detector: the silhouette's corners as they lie on the bones at rest."""
    return state_features(torso, view, state, silhouette_shares(torso, view, torso.rest_pose)).corners


def tracked_push(
    torso: TorsoModel,
    nominal: XRayView,
    states: list[TorsoState],
    told: list[float],
    annotation: float,
    drag: Floats,
    random: np.random.Generator,
    hand: np.random.Generator | None = None,
) -> TrackedPush:
    """All errors but ``drag`` (``drawn_drag``) are drawn from ``random``; with ``hand``, another annotator's, those of
    the annotation from it."""
    placed = standing(nominal, random, lateral=False)
    sway = float(np.radians(SWAY_SD_DEG) * random.normal())
    wrong = random.normal(0.0, annotation, (17, 4, 2))
    if hand is not None:
        wrong = hand.normal(0.0, annotation, (17, 4, 2))
    frames = []
    first = projected(torso, placed, states[0]) / placed.magnification
    for number, state in enumerate(states):
        dragged = _dragged(first, projected(torso, placed, state) / placed.magnification, drag)
        view = placed
        if number:
            view = placed.moved(random.normal(0.0, FRAME_SHIFT_SD_MM, 2), float(random.normal(0.0, FRAME_ROLL_SD)))
        corners = _swayed(projected(torso, view, state), sway)
        predicted = TRACK_MM * np.exp(TRACK_SPREAD * random.normal(size=(17, 1))) * (number > 0)
        followed = random.uniform(size=(17, 1)) > LOST * (number > 0)
        quality = np.repeat(quality_of(np.sqrt(2.0) * predicted) * followed, 4, axis=1)
        error = _tracking_errors(corners / view.magnification, predicted, random)
        corners = corners + (wrong + error + dragged) * view.magnification
        frames.append(VertebraCorners(VERTEBRAE, corners, quality))
    return TrackedPush.of(nominal, frames)


def _tracking_errors(corners: Floats, predicted: Floats, random: np.random.Generator) -> Floats:
    """(V, 4, 2) mm, a frame's errors of following ``corners`` (V, 4, 2), for predicted ones (V, 1) along one axis."""
    apart = np.abs(np.subtract.outer(np.arange(17), np.arange(17)))
    root = np.linalg.cholesky((1.0 - TRACK_SHARED) * np.eye(17) + TRACK_SHARED * np.exp(-apart / TRACK_LENGTH))
    size = predicted * np.exp(PREDICTED_WITHIN * random.normal(size=(17, 1)))
    along, down, turned = (size * TRACK_CHANNELS * (root @ random.normal(size=(17, 3)))).T
    return _as_corners(np.stack([along, down]), turned, corners)


def drawn_height(random: np.random.Generator, age: float, sex: str) -> float:
    """Standing height of a child, cm."""
    mean = float(np.interp(age, AGES, MEAN_HEIGHT_CM[sex]))
    return mean + float(np.clip(random.normal(0.0, HEIGHT_SD_CM), -LARGEST_HEIGHT_CM, LARGEST_HEIGHT_CM))


def drawn_drag(random: np.random.Generator) -> Floats:
    """(2, 17) how far tracking is taken along, shifts and turns, relative to the motion; a person's own."""
    apart = np.abs(np.subtract.outer(np.arange(17), np.arange(17)))
    root = np.linalg.cholesky(np.exp(-((apart / DRAG_LENGTH) ** 2)) + 1e-9 * np.eye(17))
    shift = DRAG_MEAN + DRAG_SMOOTH * root @ random.normal(size=17) + DRAG_OWN * random.normal(size=17)
    return np.stack([shift, DRAG_TURN * random.normal(size=17)])


def _dragged(first: Floats, now: Floats, drag: Floats) -> Floats:
    """(V, 4, 2) mm, errors of corners that moved from ``first`` to ``now``: along columns, and turns."""
    along = (now - first).mean(1)[:, 0]
    # A channel's shift is twice the corners' mean.
    size = 2.0 * np.sign(along.sum()) * np.sqrt(np.mean(along**2))
    return _as_corners(size * np.stack([drag[0], np.zeros(17)]), size * drag[1], now)


def _as_corners(shifts: Floats, turns: Floats, corners: Floats) -> Floats:
    """(V, 4, 2) errors of ``corners`` (V, 4, 2) of shifts (2, V) and turns (V,), channels as ``estimation.noise`` has
    them."""
    arms = corners - corners.mean(1, keepdims=True)
    turn = np.stack([-arms[..., 1], arms[..., 0]], -1)
    turn /= np.linalg.norm(arms, axis=(1, 2))[:, None, None]
    return np.asarray(0.5 * shifts.T[:, None] + turns[:, None, None] * turn)


def _swayed(corners: Floats, angle: float) -> Floats:
    """Corners (V, 4, 2) of a spine bent sideways by a whole wave whose steepest tilts differ by ``angle`` (rad)."""
    middle = corners.mean(1)
    height = middle[-1, 1] - middle[0, 1]
    along = np.clip((middle[:, 1] - middle[0, 1]) / height, 0.0, 1.0)
    slope = 0.5 * angle * np.cos(2.0 * np.pi * along)
    aside = 0.5 * angle * height / (2.0 * np.pi) * np.sin(2.0 * np.pi * along)
    arms = corners - middle[:, None]
    turned = arms + slope[:, None, None] * np.stack([arms[..., 1], -arms[..., 0]], -1)
    return np.asarray(middle[:, None] + turned + np.stack([aside, np.zeros(17)], -1)[:, None])
