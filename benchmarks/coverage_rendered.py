"""Subjects of known stiffness for ``coverage.py``, through rendered radiographs, the tracker and every step of a run.

Radiographs are rendered with noise, scatter, breathing and motion blur into a subject folder, which goes through the
steps ``track`` and ``personalise``. ``radiographed_person`` renders the people of ``coverage_subjects``, with all that
is wrong there: body, discs, ribs, tissue, gauge, places of the pushes, stance and posture.

``rendered_subject`` makes people with few errors. A body of 10 to 16 years on a mesh of its own, a procedural curve and
elastic supports, as ``spinestiff synth`` makes them, under three pushes as in ``coverage_subjects``; ratios, forces and
levels are drawn as there. The gauge is told with the errors of ``estimation.priors.Priors``, and so are the rib levels.
All else is just as the estimate expects it: discs, ribs, tissue and trunk are the model's, pushes point sideways, and
nobody sways.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Literal

import numpy as np
from coverage_subjects import (
    ANNOTATION_MM,
    BENDING,
    COBB_DEG,
    FORCE_N,
    LEAST_FORCE_N,
    MOST_TILT,
    PUSHES,
    TISSUE,
    pushed_person,
)
from judgement_subjects import (
    AGES,
    FRAME_ROLL_SD,
    FRAME_SHIFT_SD_MM,
    SWAY_SD_DEG,
    drawn_height,
    projected,
    standing,
)
from numpy.typing import NDArray

from spinestiff.anatomy.names import VERTEBRAE
from spinestiff.anatomy.rotation import exp_so3
from spinestiff.anatomy.state import TorsoState
from spinestiff.anatomy.stiffness import stiffness_ratios
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.arrays import Floats
from spinestiff.curves.tilts import cobb_angle, tilts
from spinestiff.errors import EquilibriumError
from spinestiff.imaging.dicom.writing import write_radiographs
from spinestiff.imaging.features import VertebraCorners, silhouette_shares, state_features
from spinestiff.imaging.projection import XRayView, frontal_view
from spinestiff.imaging.synthetic.acquisition import DEFAULT_ACQUISITION, LATERAL, Acquisition, Gauge, acquire
from spinestiff.mechanics.equilibrium import EquilibriumProblem
from spinestiff.mechanics.loads import rib_push
from spinestiff.mechanics.push import push_heights
from spinestiff.mechanics.supports import held_shoulder, three_point_supports
from spinestiff.study.runner import run_steps
from spinestiff.study.synthetic.spines import CURVES
from spinestiff.study.synthetic.subject import Recipe, SyntheticPush, subject_torso, synthesise
from spinestiff.study.trials import PushSet
from spinestiff.study.visit import load_pushes, load_start, open_visit
from spinestiff.subject.annotation_record import Annotation, ImageAnnotation
from spinestiff.subject.folder import write_annotation, write_subject
from spinestiff.subject.record_reading import parse_record
from spinestiff.subject.records import DISTANCES_MM, SubjectRecord

LEVEL_STEP = 0.1
EDGE_PIXELS = 4.0  # that a mark keeps from the picture's edge
# Of the push that a subject can bear; the supports that give add some degrees to the level pelvis' tilt.
SUPPORTS_TILT = np.deg2rad(5.0)


@dataclass(frozen=True)
class Rendered:
    """A subject's truth and its pushes, on the coarse and on the fine torso, as the steps see them; ``kind``: what else
    the body has that the model lacks; ``true``: (F, V, 4, 2) mm on the detector, of each push, the corners that its
    radiographs show, where they were kept."""

    ratios: dict[str, float]
    cobb_deg: float
    coarse: PushSet | None
    pushes: PushSet
    kind: str = ""
    true: Mapping[str, Floats] = field(default_factory=dict)


def rendered_subject(seed: int, nodes: int, folder: Path) -> Rendered:
    """The subject of a seed, made in an empty folder, tracked and personalised.

    Raises
    ------
    SpinestiffError : this torso can't be bent that far, can't carry even a small push, or can't be tracked.
    """
    random = np.random.default_rng([17, seed])
    bending, tissue = (float(np.exp(random.uniform(*np.log(limits)))) for limits in (BENDING, TISSUE))
    pushes = tuple(
        SyntheticPush(
            name,
            round(push.level + float(random.uniform(-0.7, 0.7)), 1),
            tuple(share for share, _ in push.frames),
            tuple(role for _, role in push.frames),
        )
        for name, push in PUSHES["three pushes"].items()
    )
    sex: Literal["female", "male"] = "female" if random.uniform() < 0.8 else "male"
    age = float(random.uniform(*AGES))
    recipe = Recipe(
        seed=seed,
        age=round(age, 1),
        sex=sex,
        height_cm=round(drawn_height(random, age, sex), 0),
        cobb_deg=round(float(random.uniform(*COBB_DEG)) * float(random.choice([-1.0, 1.0])), 1),
        curve=str(random.choice(list(CURVES))),
        force_n=round(float(random.uniform(*FORCE_N)), 1),
        ratios=(bending, tissue),
        pushes=pushes,
        nodes=nodes,
        misread=True,
    )
    recipe, cobb = bearable(recipe)
    synthesise(folder, recipe)
    visit = open_visit(folder)
    run_steps(visit, ("track", "personalise"))
    seen = load_pushes(visit, visit.manner)
    ratios = {"lateral_bending": bending, "tissue": tissue}
    return Rendered(ratios, cobb, load_start(visit, visit.manner), seen)


def radiographed_person(seed: int, nodes: int, folder: Path) -> Rendered:
    """A person of ``coverage_subjects`` under three pushes, radiographed into an empty folder, tracked, personalised.

    Raises
    ------
    SpinestiffError : as ``rendered_subject``.
    """
    person = pushed_person(seed, "three pushes", nodes)
    random = np.random.default_rng([37, seed])
    images = {f"rest/{name}": _marked(corners, view) for name, (corners, view) in person.rest.items()}
    for name, how in (("frontal", DEFAULT_ACQUISITION), ("lateral", replace(DEFAULT_ACQUISITION, exposure=LATERAL))):
        pixels = _exposed(person.torso, [person.torso.rest_pose], [person.stood[name]], random, seed, how)
        _write(folder / "rest" / f"{name}.dcm", pixels, person.nominal[name], f"rest {name}", seed)
    records, true = [], {}
    for push in person.records:
        view = standing(person.nominal["frontal"], random, lateral=False)
        sway = float(np.radians(SWAY_SD_DEG) * random.normal())
        states = [_swayed(person.torso, state, sway) for state in person.states[push.id]]
        views = [view] + [
            view.moved(random.normal(0.0, FRAME_SHIFT_SD_MM, 2), float(random.normal(0.0, FRAME_ROLL_SD)))
            for _ in states[1:]
        ]
        load = rib_push(person.torso, push.side, push.level, 1.0)
        gauge = Gauge(load.points, load.forces)
        pixels = _exposed(person.torso, states, views, random, seed, gauge=gauge)
        _write(folder / "pushes" / f"{push.id}.dcm", pixels, person.nominal["frontal"], f"push {push.id}", seed)
        seen = [projected(person.torso, at, state) for at, state in zip(views, states, strict=True)]
        true[push.id], corners = np.stack(seen), seen[0]
        corners = corners + random.normal(0.0, ANNOTATION_MM * view.magnification, corners.shape)
        held = {
            "pelvis": person.torso.landmark("pelvis_belt"),
            "shoulder": held_shoulder(person.torso, push.side),
        }
        points = {name: view.project(at.positions(states[0])) for name, at in held.items()}
        images[f"push/{push.id}"] = _marked(VertebraCorners(VERTEBRAE, corners), person.nominal["frontal"], points)
        records.append(push.model_copy(update={"frames": f"pushes/{push.id}.dcm"}))
    record = {
        "schema_version": 1,
        "id": f"person-{seed}",
        "age": round(person.age, 1),
        "sex": person.sex,
        "height_cm": round(person.height_cm, 0),
        "pushes": [push.model_dump(mode="json", exclude_none=True) for push in records],
    }
    write_subject(folder, parse_record(json.dumps(record), f"person {seed}", SubjectRecord))
    write_annotation(folder, Annotation(schema_version=1, images=images))
    visit = open_visit(folder)
    run_steps(visit, ("track", "personalise"))
    found = load_pushes(visit, visit.manner)
    coarse = load_start(visit, visit.manner)
    return Rendered(dict(person.ratios), person.cobb_deg, coarse, found, person.kind, true)


def _exposed(
    torso: TorsoModel,
    states: Sequence[TorsoState],
    views: Sequence[XRayView],
    random: np.random.Generator,
    seed: int,
    how: Acquisition = DEFAULT_ACQUISITION,
    gauge: Gauge | None = None,
) -> NDArray[np.uint16]:
    """(F, H, W), each frame in its own view; ``seed`` of the person."""
    frames = [
        acquire(torso, [state], view, how, person=seed, seed=int(random.integers(2**31)), gauge=gauge)[0]
        for state, view in zip(states, views, strict=True)
    ]
    return np.stack(frames)


def _write(path: Path, pixels: NDArray[np.uint16], view: XRayView, description: str, seed: int) -> None:
    """With the geometry that is told, not the one that was."""
    path.parent.mkdir(parents=True, exist_ok=True)
    shown = pixels if len(pixels) > 1 else pixels[0]
    write_radiographs(path, shown, view, patient_id=f"person-{seed}", description=description)


def _marked(
    corners: VertebraCorners, view: XRayView, points: Mapping[str, Floats] = MappingProxyType({})
) -> ImageAnnotation:
    """What lies in the picture whole."""

    def shown(where: Floats) -> Floats | None:
        pixels = view.pixels(where).round(2)
        inside = (pixels > EDGE_PIXELS) & (pixels < np.array(view.shape[::-1]) - 1.0 - EDGE_PIXELS)
        return pixels if inside.all() else None

    quads = {name: shown(quad) for name, quad in zip(corners.vertebrae, corners.corners)}
    held = {name: shown(where) for name, where in points.items()}
    found = {
        "vertebrae": {name: quad.tolist() for name, quad in quads.items() if quad is not None},
        "supports": {name: where.tolist() for name, where in held.items() if where is not None},
    }
    return ImageAnnotation.model_validate(found)


def _swayed(torso: TorsoModel, state: TorsoState, angle: float) -> TorsoState:
    """A state of whom was placed anew: bent sideways by a whole wave along the spine whose steepest tilts differ by
    ``angle`` (rad), as ``judgement_subjects`` has it of corners."""
    spine = state.bone_positions[torso.vertebra_bones, 1]
    top, height = spine.max(), np.ptp(spine)

    def wave(positions: Floats) -> tuple[Floats, Floats]:
        along = 2.0 * np.pi * np.clip((top - positions[:, 1]) / height, 0.0, 1.0)
        aside = np.zeros_like(positions)
        aside[:, 0] = 0.5 * angle * height / (2.0 * np.pi) * np.sin(along)
        return positions + aside, 0.5 * angle * np.cos(along)

    bones, turns = wave(state.bone_positions)
    axes = np.zeros_like(bones)
    axes[:, 2] = turns
    return TorsoState(bones, exp_so3(axes) @ state.bone_rotations, wave(state.tissue_positions)[0])


def bearable(recipe: Recipe) -> tuple[Recipe, float]:
    """With a force under which no two vertebrae turn by more than ``MOST_TILT``, and pushes as far below the held
    shoulder as a record wants them; the curve at rest, degrees."""
    torso = subject_torso(recipe)
    view, rest = frontal_view(), torso.rest_pose
    shares = silhouette_shares(torso, view, rest)
    before = tilts(VERTEBRAE, state_features(torso, view, rest, shares).corners, view)
    cobb = cobb_angle(before).degrees
    side: Literal["left", "right"] = "left" if cobb > 0.0 else "right"
    recipe = replace(recipe, pushes=tuple(_below_shoulder(torso, side, push) for push in recipe.pushes))
    problem = EquilibriumProblem(torso, three_point_supports(torso, side, "level"))
    assert recipe.ratios is not None
    ratios = stiffness_ratios(dict(zip(("lateral_bending", "tissue"), recipe.ratios)))
    force, most = recipe.force_n, MOST_TILT - SUPPORTS_TILT
    while True:
        bent = 0.0
        try:
            for push in recipe.pushes:
                state = problem.solve(rib_push(torso, side, push.level, force), ratios).require().state
                after = tilts(VERTEBRAE, state_features(torso, view, state, shares).corners, view)
                bent = max(bent, float(np.ptp(after.superior - before.superior)))
        except EquilibriumError:
            bent = 2.0 * most
        if bent <= most:
            return replace(recipe, force_n=round(force, 1)), float(cobb)
        force *= float(np.clip(most / bent, 0.5, 0.9))
        if force < LEAST_FORCE_N:
            raise EquilibriumError(f"subject {recipe.seed}: bends by more than {np.rad2deg(most):.0f} degrees")


def _below_shoulder(torso: TorsoModel, side: Literal["left", "right"], push: SyntheticPush) -> SyntheticPush:
    while True:
        shoulder, _, rib = push_heights(torso, side, push.level)
        if shoulder - rib > DISTANCES_MM[0]:
            return push
        push = replace(push, level=round(push.level + LEVEL_STEP, 1))
