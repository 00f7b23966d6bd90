"""Synthetic subjects: a torso of known stiffness on a mesh of its own, pushed and radiographed into a subject folder.

The truth is written beside the folder (``DIR.truth.json``), never into it.
"""

from __future__ import annotations

import logging
import os
from dataclasses import asdict
from pathlib import Path

import numpy as np

from spinestiff.anatomy.state import TorsoState
from spinestiff.anatomy.stiffness import stiffness_ratios
from spinestiff.anatomy.template import MESHES
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.errors import SubjectError
from spinestiff.files import check_writable, read_json, write_json
from spinestiff.mechanics.assembly import Law
from spinestiff.mechanics.equilibrium import EquilibriumProblem
from spinestiff.mechanics.loads import rib_push
from spinestiff.mechanics.sensitivity import Linearisation
from spinestiff.observer import Observer, heard
from spinestiff.parallel import in_parallel
from spinestiff.personalise.placing import place_vertebrae
from spinestiff.personalise.quality import mesh_quality
from spinestiff.study.subject_body import template_body
from spinestiff.study.synthetic.elastic_supports import drawn_supports, elastic_supports, support_stiffness
from spinestiff.study.synthetic.recipe import Recipe, SyntheticPush
from spinestiff.study.synthetic.spines import VertebraPoses, curved_spine, real_spine
from spinestiff.study.synthetic.stiffening import disc_bending, solved_with
from spinestiff.study.synthetic.visit import VisitInMaking

# Table 4's range of estimated ratios, where a subject's own are drawn from.
BENDING_RANGE, TISSUE_RANGE = (0.05, 0.63), (0.01, 0.15)
# Nodes of a mesh for whose skin the coarse template's, carried along in a second, is fine enough.
CARRIED_COARSE = 6_000


def synthesise(folder: str | Path, recipe: Recipe, observer: Observer | None = None) -> Path:
    """Make a subject folder and, beside it, its truth.

    Parameters
    ----------
    folder : must not exist or be empty.
    recipe : see ``Recipe``.
    observer : called with a line for each step.

    Returns
    -------
    Path of the truth file.

    Raises
    ------
    SubjectError : the folder is not empty, or the recipe is impossible.
    TorsoError : the template has no body of this age, sex and height; nothing is written.
    EquilibriumError : the torso can't carry the push at these ratios.
    """
    folder = Path(folder)
    if os.path.lexists(folder) and not folder.is_dir():
        raise SubjectError(f"{folder}: is there already and no folder; choose another one, nothing was written")
    if folder.exists() and any(folder.iterdir()):
        raise SubjectError(f"{folder}: is not empty; choose another folder, nothing was written")
    if os.path.lexists(truth_path(folder)):
        raise SubjectError(f"{truth_path(folder)}: is there already; choose another folder, nothing was written")
    check_writable(folder, "radiographs, force log and annotation")
    check_writable(folder.parent, "the subject and its truth")
    say = heard(observer, logging.getLogger(__name__))
    random = np.random.default_rng(recipe.seed)
    say("shaping the torso")
    torso = subject_torso(recipe, say)
    say(f"{mesh_quality(torso)}; {len(torso.tissue.rest_positions)} nodes")
    bending, tissue = recipe.ratios or tuple(
        float(np.exp(random.uniform(*np.log(limits)))) for limits in (BENDING_RANGE, TISSUE_RANGE)
    )
    ratios = stiffness_ratios({"lateral_bending": bending, "tissue": tissue})
    maker = VisitInMaking(folder, torso, recipe, random)
    for mesh in MESHES:
        # What estimates shape by the subject's radiographs.
        template_body(recipe.age, recipe.sex, recipe.height_cm, mesh)
    side = maker.main_side
    # A stream of its own: what else is random is the same whether supports are drawn or given.
    give = recipe.supports or drawn_supports(random.spawn(1)[0])
    say(f"fitting supports that give {give.obliquity_deg:.1f} degrees and {give.shoulder_mm:.1f} mm")
    largest = [rib_push(torso, side, push.level, recipe.force_n) for push in recipe.pushes if not push.other_side]
    stiffness = support_stiffness(torso, side, largest, ratios, give)
    body, laws = torso, tuple[Law, ...]()
    if recipe.stiffening is not None:
        body, law = recipe.stiffening.applied(torso)
        laws = (law,)
    sides = dict.fromkeys(maker.side_of(push) for push in recipe.pushes)
    problems = {at: EquilibriumProblem(body, elastic_supports(torso, at, stiffness), laws=laws) for at in sides}
    solved = ratios
    first = next(number for number, push in enumerate(recipe.pushes) if not push.other_side)
    if recipe.stiffening is not None:
        say("fitting the ratios of stiffening joints")
        load = largest[0].scaled(max(recipe.pushes[first].shares))
        solved = solved_with(problems[side], law, torso, load, ratios)

    # All equilibria before the first file: a push that the torso can't carry leaves nothing behind.
    def pushed(push: SyntheticPush) -> list[TorsoState]:
        states = list[TorsoState]()
        last: TorsoState | Linearisation = torso.rest_pose
        for share in push.shares:
            force = share * recipe.force_n
            if not force:  # at rest nothing is strained
                states.append(torso.rest_pose)
                continue
            say(f"push '{push.id}': equilibrium at {force:.0f} N")
            at = maker.side_of(push)
            found, last = problems[at].solve_linearised(rib_push(torso, at, push.level, force), solved, last)
            states.append(found.state)
        return states

    states = in_parallel(pushed, recipe.pushes)
    discs: dict[str, float] | None = None
    if recipe.stiffening is not None:
        largest_frame = states[first][int(np.argmax(recipe.pushes[first].shares))]
        discs = disc_bending(body, law, torso, largest_frame, solved)
    say("rendering the rest radiographs")
    maker.rest_images()
    for push, own in zip(recipe.pushes, states):
        say(f"push '{push.id}': rendering {len(push.shares)} radiographs")
        maker.push(push, own, problems[maker.side_of(push)].supports)
    maker.write_records()
    write_json(
        truth_path(folder),
        {
            "schema_version": 1,
            "recipe": recipe.as_record(),
            "ratios": {"lateral_bending": bending, "tissue": tissue},
            "supports": {
                **asdict(give),
                "belt_n_mm_per_rad": stiffness.belt,
                "shoulder_n_per_mm": stiffness.shoulder,
            },
            **({} if discs is None else {"disc_bending": discs}),
            **maker.truth(),
        },
    )
    return truth_path(folder)


def truth_path(folder: str | Path) -> Path:
    """Where the truth of a synthetic subject lies: beside its folder."""
    folder = Path(folder)
    if folder.name in ("", ".."):  # "." and the like have a name only once resolved
        folder = folder.resolve()
    return folder.parent / f"{folder.name}.truth.json"


def made_by(folder: str | Path, recipe: Recipe) -> bool:
    """Whether ``folder`` holds just the subject of this recipe; False if there is none yet.

    Raises
    ------
    SubjectError : it holds something else.
    """
    folder = Path(folder)
    if not folder.is_dir() or not any(folder.iterdir()):
        return False
    path = truth_path(folder)
    if path.is_file() and read_json(path).get("recipe") == recipe.as_record():
        return True
    raise SubjectError(f"{folder}: holds another subject; choose another folder, nothing was written")


def subject_torso(recipe: Recipe, observer: Observer | None = None) -> TorsoModel:
    """The recipe's torso at rest, on its own mesh.

    Raises
    ------
    SubjectError : an impossible curve or spine.
    EquilibriumError, TorsoError : no torso of that shape, or it needs a new mesh and the extra [mesh] is missing.
    """
    coarse = recipe.nodes is not None and recipe.nodes <= CARRIED_COARSE
    mesh = "coarse" if coarse else recipe.mesh
    template = template_body(recipe.age, recipe.sex, recipe.height_cm, mesh)
    poses: VertebraPoses
    if recipe.spine:
        poses = real_spine(template, *recipe.spine)
    else:
        poses = curved_spine(template, recipe.cobb_deg, recipe.curve, recipe.secondary)
    return place_vertebrae(template, *poses, nodes=recipe.nodes, seed=recipe.seed, observer=observer)
