"""Subjects of known stiffness for ``coverage.py``, through rendered radiographs, the tracker and every step of a run.

A body of 10 to 16 years on a mesh of its own, a procedural curve and elastic supports, as ``spinestiff synth`` makes
them, under three pushes as in ``coverage_subjects``; ratios, forces and levels are drawn as there. Radiographs
are rendered with noise, scatter and motion blur, and the folder goes through the steps ``track`` and ``personalise``.
The gauge is told with the errors of ``estimation.priors.Priors``, and so are the rib levels. Discs, ribs and tissue
are those of the model: what they may be else is a matter of ``coverage_subjects``.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
from coverage_subjects import BENDING, COBB_DEG, FORCE_N, LEAST_FORCE_N, MOST_TILT, PUSHES, TISSUE
from judgement_subjects import AGES, drawn_height

from spinestiff.anatomy.names import VERTEBRAE
from spinestiff.anatomy.stiffness import stiffness_ratios
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.curves.tilts import cobb_angle, tilts
from spinestiff.errors import EquilibriumError
from spinestiff.imaging.features import silhouette_shares, state_features
from spinestiff.imaging.projection import frontal_view
from spinestiff.mechanics.equilibrium import EquilibriumProblem
from spinestiff.mechanics.loads import rib_push
from spinestiff.mechanics.push import push_heights
from spinestiff.mechanics.supports import three_point_supports
from spinestiff.study.runner import run_steps
from spinestiff.study.synthetic.spines import CURVES
from spinestiff.study.synthetic.subject import Recipe, SyntheticPush, subject_torso, synthesise
from spinestiff.study.trials import PushSet
from spinestiff.study.visit import load_pushes, load_start, open_visit
from spinestiff.subject.records import DISTANCES_MM

LEVEL_STEP = 0.1
# Of the push that a subject can bear; the supports that give add some degrees to the level pelvis' tilt.
SUPPORTS_TILT = np.deg2rad(5.0)


@dataclass(frozen=True)
class Rendered:
    """A subject's truth and its pushes, on the coarse and on the fine torso, as the steps see them."""

    ratios: dict[str, float]
    cobb_deg: float
    coarse: PushSet | None
    pushes: PushSet


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
    seen = load_pushes(visit, "procrustes", "weighed")
    ratios = {"lateral_bending": bending, "tissue": tissue}
    return Rendered(ratios, cobb, load_start(visit, "procrustes", "weighed"), seen)


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
