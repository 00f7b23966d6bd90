"""Pairs of the model and of something that differs from it in one respect, pushed alike at equal true ratios.

What ``discrepancy.py`` learns from. A subject is a body of 140 to 175 cm with a curve of 10 to 80 degrees, a bending
ratio of 0.0075 to 0.84 and a tissue modulus of 0.0075 to 0.2 times 0.58 MPa, both log-uniform. A pair is one kind of
variant of one subject:

    body             the truth is a person: of its own age, sex, mass, kyphosis and lordosis, with a spine of its own
                     length and vertebrae of their own sizes. The model is what an estimate makes of that: the template
                     of its height, age and sex, personalised from corners marked in two views (0.3 mm noise) of a
                     person who stands as nobody was told
    other mesh       the truth on a mesh of the coarse one's size, built anew in the curved skin with other points
    finer mesh       the same with as many nodes as truths of the default chain have (15,000)
    disc centres     the truth's discs turn 3 to 12 mm farther behind
    rib joints       the truth's ribs turn 2 to 20 times more easily on their vertebrae (bench values: 11 times,
                     J Biomech 2024 163:111923)
    stiffening       the truth's intervertebral joints have a neutral zone: a moment k (a + (theta / theta0)^2) theta
                     about each axis, a of 0.3 to 0.7, theta0 of 2 to 5 degrees
    layers           the truth's tissue under the skin is 0.4 to 2.5 times as stiff, or that around the spine 1.5 to 3
                     times
    volume           the truth's Poisson ratio is 0.3 to 0.42 or 0.47 to 0.49 (the model's: 0.45)
    one-sided wall   the truth's back may leave the wall, which holds the model's
    push point       the truth is pushed 10 to 20 mm farther to the front or to the rear
    geometry         the model is what personalisation makes of the truth's corners in two views, 0.5 mm noise
    fine to limit    the truth on a mesh of 26,000 nodes, built anew as for "other mesh", the model on the fine mesh
    other fine mesh  the truth on a mesh of the fine one's size, built anew, the model on the fine mesh

What of a difference is as if all tissue were stiffer or softer is an unknown of an estimate where it comes of a body's
size or of a mesh (priors ``trunk`` and ``mesh``): of "body" and of the four meshes it is taken out by the model's
derivative.

Every pair is pushed at ribs 5, 7.5 and 10 of each side, once with half the force, and once at any level from 4 to 11.
The force is 40 to 80 N, a subject's own, and where its vertebrae would turn by more than 45 degrees against each other,
or its torso does not carry that, as much of it as will do.
The pelvis is held level, the opposite shoulder sideways.

Equal true ratios. The ratio of a variant is the energy that its own law stores in the joints of "lateral_bending" (or
in the tissue) over what the standard law at a ratio of 1 stores there in the same state; energies are summed over the
variant's own equilibria under 40 N at rib 8 of either side. Where a variant has the standard law that is the ratio it
is solved with; else that ratio is sought until the true one is the model's to 1 %, and the rest is taken out of the
model's motion by its derivative.

``run`` appends a line of JSON a pair to a file and goes on from what is there.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from judgement_subjects import AGES, KYPHOSIS_DEG, LORDOSIS_DEG, PERSON_SD, SPINE_LENGTH_SD, VERTEBRA_SD, standing
from kept_rows import begun, prepare

from spinestiff.anatomy.names import INTERVERTEBRAL
from spinestiff.anatomy.state import TorsoState
from spinestiff.anatomy.stiffness import (
    DEFAULT_YOUNG_MPA,
    ParameterGroup,
    StiffnessRatios,
    lame_parameters,
    parameter_group,
    stiffness_ratios,
)
from spinestiff.anatomy.template import Mesh, template_torso
from spinestiff.anatomy.template.body import usual_mass
from spinestiff.anatomy.template.options import with_options
from spinestiff.anatomy.torso import TissueMesh, TorsoModel
from spinestiff.arrays import Floats
from spinestiff.errors import EquilibriumError, SpinestiffError
from spinestiff.estimation.discrepancy import CHANNELS as TURNS
from spinestiff.estimation.discrepancy import SIDES, motion_size, plane_motion
from spinestiff.estimation.load_acts import load_changes
from spinestiff.estimation.priors import Priors
from spinestiff.estimation.unknowns import ACTS, POWERS, SCALED
from spinestiff.imaging.features import VertebraCorners, picture_axes, silhouette_shares, state_features
from spinestiff.imaging.projection import frontal_view, lateral_view
from spinestiff.mechanics.contact import OneSidedProblem
from spinestiff.mechanics.equilibrium import EquilibriumProblem
from spinestiff.mechanics.joints import joint_pose
from spinestiff.mechanics.loads import LoadCase, rib_push
from spinestiff.mechanics.neutral_zone import NeutralZone
from spinestiff.mechanics.supports import three_point_supports
from spinestiff.mechanics.tissue import element_energies
from spinestiff.personalise.placing import place_vertebrae
from spinestiff.personalise.shape import personalise
from spinestiff.personalise.sizes import resized
from spinestiff.study.synthetic.spines import CURVES, curved_spine, rest_vertebrae

ROOT = Path(__file__).parent.parent

SEED = 20261122
PELVIS = "level"
HEIGHTS_CM, COBB_DEG = (140.0, 175.0), (10.0, 80.0)
MASS_SD = 0.15  # of the body over the usual one, in log; what an estimate is not told
BENDING = (0.0075, 0.84)
TISSUE_MPA = (0.0075 * 0.58, 0.2 * 0.58)
FORCE_N = (40.0, 80.0)
MOST_TILT = np.deg2rad(45.0)  # change of tilt at which a push ends
LEAST_FORCE_N = 15.0
LEVELS = (5.0, 7.5, 10.0)
GRID = tuple((side, level) for side in SIDES for level in LEVELS)
OFF_GRID = (4.0, 11.0)
ENERGY_LEVEL, ENERGY_FORCE_N = 8.0, 40.0
EQUAL = 0.01  # of log ratios
CORNER_NOISE_MM, MARKED_MM = 0.5, 0.3
UNDER_SKIN_MM, AROUND_SPINE_MM = 25.0, 55.0
# Nodes of a truth's mesh, asked for (it gets a tenth more or less).
MESHES = {"other mesh": 2300, "finer mesh": 15_000, "other fine mesh": 10_000, "fine to limit": 26_000}
# What a subject gets: so many of each of these, and every so many subjects one of the others.
TIMES = {"body": 2, "other mesh": 1, "disc centres": 1, "stiffening": 1, "layers": 1}
TIMES |= {"volume": 1, "rib joints": 1, "push point": 1}
EVERY = {"geometry": 4, "finer mesh": 4, "one-sided wall": 4}
FINE_EVERY = {"other fine mesh": 3, "fine to limit": 8}  # with a model on the fine mesh
AS_TISSUE = ("body", *MESHES)  # of these, what is as if tissue were stiffer or softer is taken out
# Kinds whose cause an estimate has among its own unknowns, and its prior's standard deviation in the unit of a slope;
# the trunk's size is one that acts as the tissue's ratio does.
EXPLICIT = {
    "rib joints": Priors().rib_joints,
    "volume": Priors().tissue_volume,
    "push point": Priors().push_depth_mm,
}
TRUNK = Priors().trunk * float(np.linalg.norm(Priors().trunk_power))
KINDS = (*TIMES, *EVERY)


class Bench:
    """A torso under pushes from both sides.

    Parameters
    ----------
    laws : beside those of its joints and its tissue. one_sided : the wall only pushes. anterior_mm : of the push point.
    """

    def __init__(
        self, torso: TorsoModel, laws: tuple[NeutralZone, ...] = (), one_sided: bool = False, anterior_mm: float = 0.0
    ) -> None:
        self.torso, self.laws, self.anterior_mm = torso, laws, anterior_mm
        problem = OneSidedProblem if one_sided else EquilibriumProblem
        right = problem(torso, three_point_supports(torso, "right", PELVIS), laws=laws)
        left = right.with_supports(three_point_supports(torso, "left", PELVIS))
        self.problems = {"right": right, "left": left}
        spine = rest_vertebrae(torso)[0][:, 1]
        self.view = frontal_view(centre=(0.0, float(0.5 * (spine[0] + spine[-1])), 0.0))
        self.shares = silhouette_shares(torso, self.view, torso.rest_pose)
        self.rest = state_features(torso, self.view, torso.rest_pose, self.shares).z

    def load(self, side: str, level: float, force_n: float) -> LoadCase:
        return rib_push(self.torso, side, level, force_n, self.anterior_mm)

    def solve(self, side: str, load: LoadCase, ratios: StiffnessRatios, start: TorsoState | None = None) -> TorsoState:
        """The equilibrium; raises EquilibriumError where there is none."""
        return self.problems[side].solve(load, ratios, start).require().state

    def motion(self, state: TorsoState) -> Floats:
        """(17, 3), ``plane_motion``."""
        return plane_motion(self.rest, state_features(self.torso, self.view, state, self.shares).z, self.view)

    def linearised(
        self, side: str, load: LoadCase, ratios: StiffnessRatios, start: TorsoState | None
    ) -> tuple[TorsoState, Floats]:
        """The equilibrium, and the derivative of its motion in the log ratios and in what an estimate has among its own
        unknowns (17, 3, P + len(EXPLICIT))."""
        found, tangent = self.problems[side].solve_linearised(load, ratios, start)
        features = state_features(self.torso, self.view, found.state, self.shares)
        scaled = [parameter_group(name, self.torso.joints.kinds) for name in SCALED]
        both = tangent.forward((*ratios.groups, *scaled))
        moves = (both[:, len(ratios.groups) :] @ POWERS)[:, [ACTS.index(act) for act in ("ribs", "volume")]]
        depth = tangent.load_derivative(load_changes(load, self.torso)[ACTS.index("depth")])
        whole = np.column_stack([both[:, : len(ratios.groups)], moves, depth])
        bones = whole[: 6 * len(self.torso.bone_names)]
        moves = bones.reshape(len(self.torso.bone_names), 6, -1)[self.torso.vertebra_bones]
        axes = np.stack(picture_axes(self.view), axis=1)
        corners = np.einsum("vkid,vdp,ij->vkjp", features.jacobian, moves, axes)
        arms = features.z @ axes
        arms = arms - arms.mean(axis=1, keepdims=True)
        across = arms[..., 0, None] * corners[:, :, 1] - arms[..., 1, None] * corners[:, :, 0]
        turn = across.sum(axis=1) / np.sum(arms**2, axis=(1, 2))[:, None]
        return found.state, np.concatenate([corners.mean(axis=1), turn[:, None]], axis=1)

    def true_ratios(self, ratios: StiffnessRatios) -> Floats:
        """(P,) energy over that of the standard law at a ratio of 1 (see the module's text)."""
        own, standard = np.zeros(len(ratios.groups)), np.zeros(len(ratios.groups))
        for side in SIDES:
            state = self.solve(side, self.load(side, ENERGY_LEVEL, ENERGY_FORCE_N), ratios)
            for i, group in enumerate(ratios.groups):
                parts = self._joints(group, state, ratios) if group.joints.any() else self._tissue(state, ratios)
                own[i] += parts[0]
                standard[i] += parts[1]
        return own / standard

    def _joints(self, group: ParameterGroup, state: TorsoState, ratios: StiffnessRatios) -> tuple[float, float]:
        pose = joint_pose(self.torso.joints, state)
        half = 0.5 * np.hstack([pose.translation, pose.rotation]) ** 2
        stiffness = ratios.scale_joints(self.torso.joints.stiffness)
        own = half * stiffness + sum(law.entries(state, stiffness) for law in self.laws)
        standard = template_torso(self.torso.height_cm).joints.stiffness
        return float(own[group.joints].sum()), float((half * standard)[group.joints].sum())

    def _tissue(self, state: TorsoState, ratios: StiffnessRatios) -> tuple[float, float]:
        problem = self.problems["right"]
        data, stiffness = problem.potential.tissue, problem.potential.stiffness(ratios)
        energies = element_energies(problem.potential.nodes(state), data.elements, data.gradients, data.weights)[0]
        mu, lambda_ = lame_parameters(DEFAULT_YOUNG_MPA, 0.45)
        own = stiffness.mu @ energies[:, 0] + stiffness.lambda_ @ energies[:, 1]
        return float(own), float(mu * energies[:, 0].sum() + lambda_ * energies[:, 1].sum())


@dataclass(frozen=True)
class Subject:
    """A body, its curve and its ratios (of bending, and of tissue to the package's default)."""

    number: int
    height_cm: float
    cobb_deg: float
    curve: str
    bending: float
    tissue_mpa: float

    @property
    def ratios(self) -> StiffnessRatios:
        return stiffness_ratios({"lateral_bending": self.bending, "tissue": self.tissue_mpa / DEFAULT_YOUNG_MPA})

    def random(self, kind: str, draw: int = 0) -> np.random.Generator:
        """Of one of the subject's pairs, so that a kind gives the same pair whichever others are made."""
        return np.random.default_rng([SEED, self.number, *kind.encode(), *([draw] if draw else [])])

    def shaped(self, template: TorsoModel, nodes: int | None = None, seed: int = 0) -> TorsoModel:
        """A template with the subject's curve, on its own mesh or on a new one of about so many nodes."""
        return place_vertebrae(template, *curved_spine(template, self.cobb_deg, self.curve), nodes=nodes, seed=seed)


def subject_of(number: int) -> Subject:
    """The subject of a number."""
    random = np.random.default_rng([SEED, number])
    height, cobb = random.uniform(*HEIGHTS_CM), random.uniform(*COBB_DEG)
    cobb *= random.choice([-1.0, 1.0])
    curve = str(random.choice(list(CURVES)))
    bending, tissue = (np.exp(random.uniform(*np.log(ends))) for ends in (BENDING, TISSUE_MPA))
    return Subject(number, float(height), float(cobb), curve, float(bending), float(tissue))


@dataclass(frozen=True)
class Frame:
    """A push: what it is for, where, and how hard, N."""

    use: str
    side: str
    level: float
    force_n: float


@dataclass(frozen=True)
class Modelled:
    """The model's side of a pair: its frames, states and motions (17, 3) with slopes (17, 3, 2 + len(EXPLICIT))."""

    frames: tuple[Frame, ...]
    states: tuple[TorsoState, ...]
    motions: tuple[Floats, ...]
    slopes: tuple[Floats, ...]


def less_force(tilt: float) -> float:
    """The share of a force to try next where it turns vertebrae by ``tilt`` against each other, rad."""
    return float(np.clip(MOST_TILT / tilt, 0.5, 0.9))


def carried(bench: Bench, side: str, level: float, force: float, ratios: StiffnessRatios) -> tuple[float, TorsoState]:
    """As much of a force as bends the torso no farther than ``MOST_TILT``, N, and the state under it.

    EquilibriumError where that is less than ``LEAST_FORCE_N``.
    """
    while force >= LEAST_FORCE_N:
        try:
            state = bench.solve(side, bench.load(side, level, force), ratios)
            tilt = float(np.ptp(bench.motion(state)[:, 2]))
        except EquilibriumError:
            tilt = 2.0 * MOST_TILT
        else:
            if tilt <= MOST_TILT:
                return force, state
        force *= less_force(tilt)
    raise EquilibriumError(f"bends by more than {np.rad2deg(MOST_TILT):.0f} degrees under any push at rib {level:.3g}")


def modelled(bench: Bench, subject: Subject) -> Modelled:
    """The frames of a subject, of forces that its model carries."""
    random, ratios = subject.random("frames"), subject.ratios
    half = int(random.integers(len(GRID)))
    sites = [("grid", side, level) for side, level in GRID]
    sites.append(("off grid", str(random.choice(SIDES)), float(random.uniform(*OFF_GRID))))
    most, frames, states = float(random.uniform(*FORCE_N)), [], []
    for use, side, level in sites:
        force, state = carried(bench, side, level, most, ratios)
        frames.append(Frame(use, side, level, force))
        states.append(state)
    frames.append(replace(frames[half], use="half", force_n=0.5 * frames[half].force_n))
    return at_frames(bench, subject, tuple(frames), (*states, states[half]))


def at_frames(
    bench: Bench, subject: Subject, frames: tuple[Frame, ...], starts: tuple[TorsoState | None, ...]
) -> Modelled:
    """A model's states, motions and slopes in frames."""
    found = [
        bench.linearised(frame.side, bench.load(frame.side, frame.level, frame.force_n), subject.ratios, start)
        for frame, start in zip(frames, starts)
    ]
    states, slopes = zip(*found)
    return Modelled(frames, states, tuple(bench.motion(state) for state in states), slopes)


# Variants


def disc_centres(base: TorsoModel, random: np.random.Generator) -> tuple[Bench, dict[str, Any]]:
    shift = float(random.uniform(3.0, 12.0))
    return Bench(with_options(base, disc_shift_mm=shift)), {"shift_mm": shift}


def rib_joints(base: TorsoModel, random: np.random.Generator) -> tuple[Bench, dict[str, Any]]:
    factor = float(np.exp(random.uniform(np.log(0.05), np.log(0.5))))
    stiffness = np.array(base.joints.stiffness)
    stiffness[[kind == "rib_vertebra" for kind in base.joints.kinds], 3:] *= factor
    return Bench(replace(base, joints=replace(base.joints, stiffness=stiffness))), {"factor": factor}


def stiffening(base: TorsoModel, random: np.random.Generator) -> tuple[Bench, dict[str, Any]]:
    low, theta0 = float(random.uniform(0.3, 0.7)), float(np.radians(random.uniform(2.0, 5.0)))
    columns = np.zeros((len(base.joints), 6), dtype=bool)
    columns[[kind in INTERVERTEBRAL for kind in base.joints.kinds], 3:] = True
    joints = replace(base.joints, stiffness=np.where(columns, low, 1.0) * base.joints.stiffness)
    law = NeutralZone(joints, columns, theta0, 1.0 / low)
    return Bench(replace(base, joints=joints), (law,)), {"low": low, "theta0_deg": float(np.degrees(theta0))}


def layers(base: TorsoModel, random: np.random.Generator) -> tuple[Bench, dict[str, Any]]:
    where = str(random.choice(["skin", "spine"]))
    tissue = base.tissue
    centres = tissue.rest_positions[tissue.elements[:, :4]].mean(axis=1)
    if where == "skin":
        points, reach = tissue.rest_positions[np.unique(tissue.boundary_faces())], UNDER_SKIN_MM
        factor = float(np.exp(random.uniform(np.log(0.4), np.log(2.5))))
    else:
        points, reach = rest_vertebrae(base)[0], AROUND_SPINE_MM
        factor = float(random.uniform(1.5, 3.0))
    inside = np.linalg.norm(centres[:, None] - points[None], axis=2).min(axis=1) < reach
    scale = np.where(inside, factor, 1.0)
    other = replace(tissue, lame_mu=scale * tissue.lame_mu, lame_lambda=scale * tissue.lame_lambda)
    found = {"where": where, "factor": factor, "share": float(inside.mean())}
    return Bench(replace(base, tissue=other)), found


def volume(base: TorsoModel, random: np.random.Generator) -> tuple[Bench, dict[str, Any]]:
    poisson = float(random.choice([random.uniform(0.3, 0.42), random.uniform(0.47, 0.49)]))
    mu, lambda_ = (np.full(len(base.tissue.elements), m) for m in lame_parameters(DEFAULT_YOUNG_MPA, poisson))
    tissue: TissueMesh = replace(base.tissue, lame_mu=mu, lame_lambda=lambda_)
    return Bench(replace(base, tissue=tissue)), {"poisson": poisson}


def one_sided_wall(base: TorsoModel, random: np.random.Generator) -> tuple[Bench, dict[str, Any]]:
    return Bench(base, one_sided=True), {}


def push_point(base: TorsoModel, random: np.random.Generator) -> tuple[Bench, dict[str, Any]]:
    anterior = float(random.choice([-1.0, 1.0]) * random.uniform(10.0, 20.0))
    return Bench(base, anterior_mm=anterior), {"anterior_mm": anterior}


# These keep the standard law where a ratio acts, so that the ratio they are solved with is the true one.
STANDARD_LAW = ("disc centres", "rib joints", "one-sided wall", "push point")
OF_BASE: dict[str, Callable[[TorsoModel, np.random.Generator], tuple[Bench, dict[str, Any]]]] = {
    "disc centres": disc_centres,
    "rib joints": rib_joints,
    "stiffening": stiffening,
    "layers": layers,
    "volume": volume,
    "one-sided wall": one_sided_wall,
    "push point": push_point,
}


def drawn_body(random: np.random.Generator, height_cm: float, age: float, sex: Literal["female", "male"]) -> TorsoModel:
    """A person of a height, an age and a sex, upright: mass, kyphosis, lordosis, length of the spine and sizes of the
    vertebrae are their own."""
    body = template_torso(
        height_cm,
        age_years=age,
        sex=sex,
        mass_kg=usual_mass(height_cm, age, sex) * float(np.exp(np.clip(random.normal(0.0, MASS_SD), -0.3, 0.3))),
        kyphosis_deg=float(random.uniform(*KYPHOSIS_DEG)),
        lordosis_deg=float(random.uniform(*LORDOSIS_DEG)),
    ).scaled(1.0 + float(np.clip(random.normal(0.0, SPINE_LENGTH_SD), -0.07, 0.07)))
    return resized(body, np.exp(random.normal(0.0, PERSON_SD) + random.normal(0.0, VERTEBRA_SD, (17, 3))))


def own_body(subject: Subject, random: np.random.Generator) -> tuple[TorsoModel, TorsoModel, dict[str, Any]]:
    """Truth and model of the kind "body"."""
    age = float(random.uniform(*AGES))
    sex: Literal["female", "male"] = "female" if random.uniform() < 0.8 else "male"
    truth = subject.shaped(drawn_body(random, subject.height_cm, age, sex))
    template = template_torso(float(round(subject.height_cm)), age_years=age, sex=sex)
    model = personalised(truth, random, MARKED_MM, stance=random, template=template)
    return truth, model, {"age_years": age, "sex": sex}


def as_tissue(frames: list[dict[str, Any]]) -> float:
    """The log of the tissue's ratio that explains most of what truth and model differ by, in all frames alike."""
    model, truth, slope = (np.array([frame[key] for frame in frames]) for key in ("model", "truth", "slope"))
    sizes = np.array([motion_size(motion) for motion in model])[:, None, None]
    apart, along = (values * TURNS / sizes for values in (truth - model, slope[..., 1]))
    return float(np.sum(apart * along) / np.sum(along**2))


def personalised(
    truth: TorsoModel,
    random: np.random.Generator,
    noise_mm: float = CORNER_NOISE_MM,
    stance: np.random.Generator | None = None,
    template: TorsoModel | None = None,
) -> TorsoModel:
    """What personalisation makes of the truth's corners in a frontal and a lateral view, from a template or from the
    usual one of the truth's height.

    The person stands as the views say, or otherwise as ``stance`` draws it.
    """
    spine = rest_vertebrae(truth)[0][:, 1]
    pictures = {}
    for name, make in (("frontal", frontal_view), ("lateral", lateral_view)):
        view = make(
            sid=1500.0, source_to_patient=1340.0, shape=(1536, 1024), centre=(0.0, 0.5 * (spine[0] + spine[-1]), 0.0)
        )
        real = view if stance is None else standing(view, stance, lateral=name == "lateral")
        shares = silhouette_shares(truth, real, truth.rest_pose)
        corners = state_features(truth, real, truth.rest_pose, shares).corners
        noisy = corners + random.normal(0.0, noise_mm * view.magnification, corners.shape)
        pictures[name] = (VertebraCorners(truth.vertebrae, noisy), view)
    return personalise(template or template_torso(truth.height_cm), pictures).torso


# Campaign


def equal_ratios(bench: Bench, wanted: StiffnessRatios) -> tuple[StiffnessRatios, Floats]:
    """Ratios at which a variant's true ones are ``wanted``, and the logarithm of what is left between them (P,)."""
    tried, left = wanted, np.zeros(len(wanted.groups))
    for _ in range(8):
        left = np.log(bench.true_ratios(tried) / wanted.values)
        if np.abs(left).max() < EQUAL:
            return tried, left
        tried = tried.with_values(tried.values * np.exp(-left))
    raise EquilibriumError(f"true ratios do not meet the model's: {np.exp(left).round(3).tolist()} of them")


def pair(subject: Subject, kind: str, draw: int, base: tuple[Bench, Modelled]) -> dict[str, Any]:
    """One pair as it is written."""
    random, (bench, model) = subject.random(kind, draw), base
    parameters: dict[str, Any] = {}
    left, ratios, starts = np.zeros(2), subject.ratios, model.states
    if kind in OF_BASE:
        truth, parameters = OF_BASE[kind](bench.torso, random)
        if kind not in STANDARD_LAW:
            ratios, left = equal_ratios(truth, subject.ratios)
    elif kind == "geometry":
        truth = bench
        shaped = Bench(personalised(bench.torso, random))
        model = at_frames(shaped, subject, model.frames, (None,) * len(model.frames))
    elif kind == "body":
        body, found, parameters = own_body(subject, random)
        truth, starts = Bench(body), (None,) * len(model.frames)
        model = at_frames(Bench(found), subject, model.frames, starts)
    else:
        parameters = {"nodes": MESHES[kind], "seed": int(random.integers(1, 10**6))}
        truth = Bench(subject.shaped(template_torso(subject.height_cm), **parameters))
        starts = (None,) * len(model.frames)
    frames = []
    for frame, start, motion, slope in zip(model.frames, starts, model.motions, model.slopes):
        load = truth.load(frame.side, frame.level, frame.force_n)
        true = truth.motion(truth.solve(frame.side, load, ratios, start))
        frames.append(
            {
                **frame.__dict__,
                "model": rounded(motion + slope[:, :, : len(left)] @ left),
                "truth": rounded(true),
                "slope": rounded(slope),
            }
        )
    if kind in AS_TISSUE:
        parameters["as_tissue"] = as_tissue(frames)
        for frame in frames:
            slope = np.array(frame["slope"])
            frame["model"] = rounded(np.array(frame["model"]) + parameters["as_tissue"] * slope[..., 1])
    told = {key: value for key, value in subject.__dict__.items() if key != "number"}
    own = {"kind": kind, "draw": draw, "subject": subject.number}
    return {**own, **told, "parameters": parameters, "frames": frames}


def rounded(values: Floats) -> list[Any]:
    """To a ten thousandth of a mm and a ten millionth of a rad."""
    values = np.array(values)
    values[:, :2], values[:, 2] = values[:, :2].round(4), values[:, 2].round(7)
    return values.tolist()


def tasks(first: int, count: int) -> Iterator[tuple[int, Mesh, tuple[tuple[str, int], ...]]]:
    """Subject, mesh of its model, kinds with the number of their draw."""
    for number in range(first, first + count):
        often = tuple((kind, draw) for kind, times in TIMES.items() for draw in range(times))
        others = tuple((kind, 0) for place, (kind, every) in enumerate(EVERY.items()) if number % every == place)
        yield number, "coarse", (*often, *others)
        yield number, "fine", tuple((kind, 0) for kind, every in FINE_EVERY.items() if number % every == every - 1)


def run(path: Path, first: int, count: int) -> None:
    """Make the pairs of ``count`` subjects; those that are in the file already are left as they are."""
    prepare(path)
    done = {(row["subject"], row["kind"], row["draw"]) for row in read(path)}
    for number, mesh, kinds in tasks(first, count):
        todo = [(kind, draw) for kind, draw in kinds if (number, kind, draw) not in done]
        if not todo:
            continue
        subject, began = subject_of(number), time.process_time()
        try:
            bench = Bench(subject.shaped(template_torso(subject.height_cm, mesh)))
            base = bench, modelled(bench, subject)
        except SpinestiffError as error:
            for kind, draw in todo:
                _append(path, {"kind": kind, "draw": draw, "subject": number, "failed": f"model: {error}"})
            print(f"{number} {mesh}: {error}", flush=True)
            continue
        for kind, draw in todo:
            own = time.process_time()
            try:
                row = pair(subject, kind, draw, base)
            except SpinestiffError as error:
                row = {"kind": kind, "draw": draw, "subject": number, "failed": str(error)}
                print(f"{number} {kind}: {error}", flush=True)
            _append(path, {**row, "cpu_s": round(time.process_time() - own, 2)})
        print(f"{number} {mesh}: {len(todo)} pairs, {time.process_time() - began:.0f} CPU s", flush=True)


def read(path: Path) -> list[dict[str, Any]]:
    """The rows that were written, failed ones with their cause under "failed"."""
    return begun(path)


def _append(path: Path, row: dict[str, Any]) -> None:
    with path.open("a", encoding="utf-8") as file:
        print(json.dumps(row), file=file, flush=True)
