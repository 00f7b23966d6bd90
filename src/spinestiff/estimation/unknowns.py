"""What of a push is not quite known, and how it acts on a radiograph: the nuisance parameters of the weighed fit.

An unknown belongs to a push, a frame, a side or to all frames, and reaches a frame through one of its *acts*: the ways
in which an equilibrium can differ under a given set of ratios. Acts are linear in the unknowns, a = B n, so that e.g. a
frame's obliquity is the side's compliance times force, plus a part of its own.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from spinestiff.anatomy.stiffness import RIB_ROTATION, ParameterGroup, parameter_group
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.arrays import Floats, ShortRepr
from spinestiff.estimation.causes import Cause
from spinestiff.estimation.discrepancy import pushed_side
from spinestiff.estimation.objective import Trial
from spinestiff.estimation.priors import Priors
from spinestiff.mechanics.equilibrium import EquilibriumProblem
from spinestiff.mechanics.places import SupportPlace
from spinestiff.mechanics.supports import SupportKind

ACTS = (
    "force",
    "offset",
    "upward",
    "forward",
    "height",
    "depth",
    "obliquity",
    "shoulder",
    "tissue",
    "ribs",
    "volume",
    "motion",
)
UNITS = ("", "N", "rad", "rad", "mm", "mm", "rad", "mm", "", "", "", "")
"""Of each act. What scales a force or a stiffness acts by its log, motion by the relative size of what is seen."""
LOADING = ACTS[:6]
PLACING = ("obliquity", "shoulder")
# Share of lambda in the energy that tissue stores under a push, median of five bodies and four pushes each (0.12 to
# 0.27): what the act "volume" adds to lambda, it takes from both, so that the tissue stores as much as before.
LAMBDA_SHARE = 0.18
SCALING: Mapping[str, Mapping[str, float]] = {
    "tissue": {"tissue": 1.0},
    "ribs": {RIB_ROTATION: 1.0},
    "volume": {"tissue_lambda": 1.0, "tissue": -LAMBDA_SHARE},
}
"""Acts that scale groups of stiffnesses: of each group, by its name, the power of the act's exponential."""
RATIOS: Mapping[str, Cause] = {"ribs": "rib joints", "volume": "tissue's volume"}
"""Acts that are ratios themselves, and the names of their unknowns: where the fitted ones scale the same stiffnesses,
they are no unknowns beside them. The trunk's size is none of them: it changes what tissue of a given modulus
resists."""
SCALED = tuple(dict.fromkeys(name for groups in SCALING.values() for name in groups))
"""The groups, each once."""
POWERS = np.array([[SCALING.get(act, {}).get(name, 0.0) for act in ACTS] for name in SCALED])
"""(len(SCALED), len(ACTS)) log scale of each group per act."""


@dataclass(frozen=True)
class Unknown:
    """One nuisance parameter, in units of its prior's standard deviation.

    Attributes
    ----------
    name : e.g. "force of push 'main'".
    group : what it is a case of, for the variance budget, e.g. "force scale".
    act : how it acts.
    sizes : (T,) of its act in each trial for one standard deviation; 0 where it does not act.
    """

    name: str
    group: Cause
    act: str
    sizes: tuple[float, ...]


@dataclass(frozen=True, repr=False)
class Unknowns(ShortRepr):
    """All nuisance parameters of a set of trials; each is N(0, 1) before the fit.

    Attributes
    ----------
    each : (M,).
    acts : (T, len(ACTS), M), acts of each trial per unknown.
    """

    each: tuple[Unknown, ...]
    trials: int
    acts: Floats = field(init=False)

    def __post_init__(self) -> None:
        acts = np.zeros((self.trials, len(ACTS), len(self.each)))
        for i, unknown in enumerate(self.each):
            acts[:, ACTS.index(unknown.act), i] = unknown.sizes
        acts.setflags(write=False)
        object.__setattr__(self, "acts", acts)

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(unknown.name for unknown in self.each)

    @property
    def groups(self) -> tuple[Cause, ...]:
        """Groups, each once, in their order."""
        return tuple(dict.fromkeys(unknown.group for unknown in self.each))

    def in_group(self, group: Cause) -> np.ndarray:
        """(M,) bool."""
        return np.array([unknown.group == group for unknown in self.each], dtype=bool)

    def __len__(self) -> int:
        return len(self.each)


def unknowns_of(
    problems: Sequence[EquilibriumProblem],
    trials: Sequence[Trial],
    priors: Priors,
    taped: bool = False,
    fitted: Sequence[ParameterGroup] = (),
) -> Unknowns:
    """The nuisance parameters of these trials; what a prior says is known is none, nor what is fitted as a ratio.

    Parameters
    ----------
    taped : the trunk's size was measured.
    fitted : groups of the ratios that are fitted.
    """
    p = priors
    loaded = np.array([trial.load.size > 0.0 for trial in trials], dtype=bool)
    force = np.array([trial.load.push.size for trial in trials])
    pushes = np.array([trial.push or f"trial {i + 1}" for i, trial in enumerate(trials)])
    sides = np.array([pushed_side(trial.load) for trial in trials])
    held, padded = (np.array([is_placed(act, q) for q in problems], dtype=bool) for act in PLACING)
    on_bones = np.array([len(trial.load.nodes) == 0 for trial in trials], dtype=bool)
    found: list[Unknown] = []

    def add(name: str, group: Cause, act: str, size: float, where: np.ndarray) -> None:
        if size > 0.0 and where.any():
            found.append(Unknown(name, group, act, tuple((size * where).tolist())))

    angle = float(np.deg2rad(p.direction_deg))
    for push in dict.fromkeys(pushes[loaded]):
        mine = loaded & (pushes == push)
        # Several loaded frames of one push share these; of a force that does not grow scale and offset are alike.
        add(f"force of {push}", "force scale", "force", p.force_scale, mine)
        add(f"force offset of {push}", "force offset", "offset", p.force_offset_n, mine)
        add(f"direction upward of {push}", "push direction", "upward", angle, mine)
        add(f"direction forward of {push}", "push direction", "forward", angle, mine)
        add(f"height of {push}", "push height", "height", p.push_height_mm, mine & on_bones)
        add(f"depth of {push}", "push depth", "depth", p.push_depth_mm, mine & on_bones)
    per_newton = force / max(p.support_force_n, 1e-300)
    supports: tuple[tuple[str, Cause, float, float, np.ndarray], ...] = (
        ("obliquity", "obliquity by force", np.deg2rad(p.obliquity_deg), np.deg2rad(p.frame_obliquity_deg), held),
        ("shoulder", "shoulder by force", p.shoulder_mm, p.frame_shoulder_mm, padded),
    )
    for act, cause, total, own, unit in supports:
        elastic = float(np.sqrt(max(total**2 - own**2, 0.0)))
        for side in dict.fromkeys(sides[loaded]):
            mine = loaded & (sides == side) & unit
            add(f"{act} under pushes from the {side}", cause, act, elastic, per_newton * mine)
    for i, trial in enumerate(trials):
        one = (np.arange(len(trials)) == i) & loaded
        label = trial.label or f"trial {i + 1}"
        add(f"breathing in {label}", "breathing", "height", p.breathing_mm, one & on_bones)
        add(
            f"obliquity in {label}",
            "obliquity of a frame",
            "obliquity",
            float(np.deg2rad(p.frame_obliquity_deg)),
            one & held,
        )
        add(f"shoulder in {label}", "shoulder of a frame", "shoulder", p.frame_shoulder_mm, one & padded)
    trunk = p.trunk_taped if taped else p.trunk
    for name, power in zip(("breadth", "depth"), p.trunk_power):
        add(f"trunk {name}", "trunk size", "tissue", trunk * power, loaded)
    ribs = np.array([parameter_group(RIB_ROTATION, q.torso.joints.kinds).joints.any() for q in problems], dtype=bool)
    free = {act: np.array([not is_fitted(act, fitted, q.torso) for q in problems], dtype=bool) for act in RATIOS}
    add(RATIOS["ribs"], RATIOS["ribs"], "ribs", p.rib_joints, loaded & ribs & free["ribs"])
    add(RATIOS["volume"], RATIOS["volume"], "volume", p.tissue_volume, loaded & free["volume"])
    add("tissue mesh", "tissue mesh", "tissue", p.mesh, loaded)
    add("source distance", "source distance", "motion", p.source_distance, loaded)
    return Unknowns(tuple(found), len(trials))


def is_placed(act: str, problem: EquilibriumProblem) -> bool:
    """Whether a problem's supports put a torso where ``act``, of ``PLACING``, says; else forces leave it somewhere."""
    supports = problem.supports
    if act == "obliquity":
        return bool(supports.held[problem.torso.bone("pelvis")].all())
    return SupportKind.SHOULDER in supports.kinds


def is_fitted(act: str, groups: Sequence[ParameterGroup], torso: TorsoModel) -> bool:
    """Whether ratios of these groups can scale all stiffnesses as ``act`` does."""
    if not groups:
        return False
    kinds, count = torso.joints.kinds, len(torso.tissue.elements)
    wanted = sum(
        power * _scaled_by(parameter_group(name, kinds), count) for name, power in SCALING.get(act, {}).items()
    )
    columns = np.column_stack([_scaled_by(group, count) for group in groups])
    return bool(np.allclose(columns @ np.linalg.lstsq(columns, wanted, rcond=None)[0], wanted, atol=1e-9))


def _scaled_by(group: ParameterGroup, count: int) -> Floats:
    """(6J + 2T,) 1 for each stiffness that a group has, of ``count`` tissue elements."""
    inside = group.elements_of(count)
    return np.concatenate([group.joints.reshape(-1), inside & group.mu, inside & group.lambda_]).astype(float)


def acts_by_name(unknowns: Unknowns, known: Mapping[str, float]) -> Floats:
    """(T, len(ACTS)) of trials whose unknowns are known by name, in prior standard deviations; the others are 0."""
    return np.asarray(unknowns.acts @ np.array([known.get(name, 0.0) for name in unknowns.names]))


def with_unknowns(ratios: Mapping[str, float], known: Mapping[str, float]) -> dict[str, float]:
    """``ratios`` by name and those that unknowns are themselves (``RATIOS``), of which ``known`` has logs by name."""
    found = dict(ratios)
    for act, name in RATIOS.items():
        if name in known:
            for group, power in SCALING[act].items():
                found[group] = found.get(group, 1.0) * float(np.exp(power * known[name]))
    return found


def place_of(acts: Floats) -> SupportPlace:
    """Where the supports are by a trial's acts (len(ACTS),)."""
    return SupportPlace(*(float(acts[ACTS.index(name)]) for name in PLACING))
