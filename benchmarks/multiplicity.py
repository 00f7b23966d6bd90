"""More than one equilibrium: whether a load's equilibrium is the only one, and how far a branch of them goes.

A torso that turns far can have several states of least energy under one load (it may buckle or snap over). Newton's
method ends in one of them, by its start. ``equilibria`` looks for others; ``follow_load`` tells which of them the
unloaded torso comes to when the load is raised slowly, or at what share of the load that path ends (a limit point: the
least eigenvalue of the tangent falls to zero there, and the torso jumps).
"""

from __future__ import annotations

import enum
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.sparse.linalg as spla

from spinestiff.anatomy.points import PointsOnBones
from spinestiff.anatomy.state import TorsoState
from spinestiff.anatomy.stiffness import StiffnessRatios
from spinestiff.arrays import Floats
from spinestiff.errors import EquilibriumError
from spinestiff.mechanics.assembly import ROTATION_LENGTH
from spinestiff.mechanics.equilibrium import Equilibrium, EquilibriumProblem
from spinestiff.mechanics.loads import LoadCase
from spinestiff.mechanics.newton import Run
from spinestiff.mechanics.result import SolveStatus
from spinestiff.mechanics.sensitivity import Linearisation

# Two states are one equilibrium if no bone is farther apart (mm, turns at 30 mm). A residual of 1e-8 N leaves less.
SAME_MM = 1e-3
# Steps in the load: the first, the largest and the one at which a branch has ended, as shares of the load.
FIRST_STEP, LARGEST_STEP, LEAST_STEP = 0.1, 0.25, 1e-5
# At a share d below a limit point the least eigenvalue goes as sqrt(d); at 1e-4 it was still 0.11 in a soft torso.
LOST_STIFFNESS = 0.1
LOST_VOLUME = 0.05
_NEWTON_STEPS = 15


class BranchEnd(enum.Enum):
    """Where a branch of equilibria ended; the text says what was seen."""

    REACHED = "the whole load is reached"
    LIMIT_POINT = "limit point: the tangent's least eigenvalue falls to zero, the branch goes no farther"
    INVERSION = "inversion: an element loses its volume"
    LOST = "lost: Newton's method fails although neither the tangent nor an element gives way"


@dataclass(frozen=True)
class Branch:
    """The equilibria under a load that is raised from zero.

    Attributes
    ----------
    end : how it ended.
    share : of the load, the last at which there was an equilibrium.
    equilibrium : the one there.
    stiffness : least eigenvalue of the tangent there over that at rest, turns measured at 30 mm.
    steps : Newton steps taken, failed ones included.
    """

    end: BranchEnd
    share: float
    equilibrium: Equilibrium
    stiffness: float
    steps: int


def apart(state: TorsoState, other: TorsoState) -> float:
    """Largest distance of a bone between two states, mm; a turn counts as what it moves at 30 mm."""
    moved = np.linalg.norm(state.bone_positions - other.bone_positions, axis=1).max(initial=0.0)
    turned = np.linalg.norm(state.bone_rotations - other.bone_rotations, axis=(1, 2)).max(initial=0.0) / np.sqrt(2.0)
    return float(max(moved, ROTATION_LENGTH * turned))


def follow_load(problem: EquilibriumProblem, load: LoadCase, ratios: StiffnessRatios | None = None) -> Branch:
    """The equilibrium to which the unloaded torso comes as ``load`` grows, in steps that are halved where one fails.

    A step counts if Newton's method ends where a tangent to the branch predicts, to within its length: steps do not
    jump to another branch.

    Raises
    ------
    EquilibriumError : a part of the torso can move freely, or the unloaded torso has no stable equilibrium.
    """
    run = Run(problem, ratios, None, _NEWTON_STEPS, None)
    at = problem.solve(load.scaled(0.0), ratios).require()
    linear = problem.linearise(at, load.scaled(0.0), ratios)
    at_rest = least_eigenvalue(problem, linear)
    share, step = 0.0, FIRST_STEP
    while share < 1.0:
        to = min(1.0, share + step)
        try:
            slope = linear.load_derivative(load)
        except EquilibriumError:  # singular to working precision: the limit point itself
            break
        frame = problem.kinematics.at(at.state)
        predicted = frame.move((to - share) * frame.from_world(slope))
        found = run.newton(load.scaled(to), predicted)
        strayed = apart(found.state, predicted) > apart(predicted, at.state) + SAME_MM
        if found.status is SolveStatus.CONVERGED and not strayed:
            try:
                linear = problem.linearise(found, load.scaled(to), ratios)
            except EquilibriumError:  # a minimum by its Ritz values, not by its own inertia: too near to tell
                pass
            else:
                at, share, step = found, to, min(LARGEST_STEP, 2.0 * step)
                continue
        step *= 0.5
        if step < LEAST_STEP:
            break
    try:
        stiffness = least_eigenvalue(problem, linear) / at_rest
    except EquilibriumError:
        stiffness = 0.0
    if share >= 1.0:
        end = BranchEnd.REACHED
    elif stiffness < LOST_STIFFNESS:
        end = BranchEnd.LIMIT_POINT
    else:
        end = BranchEnd.INVERSION if at.smallest_j < LOST_VOLUME else BranchEnd.LOST
    return Branch(end, share, at, stiffness, sum(step.step > 0.0 for step in run.history))


def equilibria(
    problem: EquilibriumProblem,
    load: LoadCase,
    ratios: StiffnessRatios | None = None,
    known: Sequence[Equilibrium] = (),
    pushes: int = 4,
    push_n: float | None = None,
    seed: int = 0,
) -> tuple[Equilibrium, ...]:
    """Different stable equilibria under one load, least energy first.

    Looked for from the rest pose, along the growing load, and from where other loads lead once they are taken away:
    three times the load, its reverse, and random forces at 30 mm from every bone's origin. That only one is found is no
    proof that there is no other.

    Parameters
    ----------
    known : equilibria under the same load and ratios, found by the caller.
    pushes : how often random forces are tried.
    push_n : their size in sum, N; default: the load's.

    Raises
    ------
    EquilibriumError : a part of the torso can move freely, or the unloaded torso has no stable equilibrium.
    """
    found = [one for one in known if one.converged]

    def add(one: Equilibrium) -> None:
        if one.converged and all(apart(one.state, other.state) > SAME_MM for other in found):
            found.append(one)

    add(problem.solve(load, ratios))
    branch = follow_load(problem, load, ratios)
    if branch.end is BranchEnd.REACHED:
        add(branch.equilibrium)
    size = load.size if push_n is None else push_n
    random = np.random.default_rng(seed)
    others = [load.scaled(3.0), load.scaled(-1.0)]
    others += [_pushed(problem, load, size, random) for _ in range(pushes)]
    for number, other in enumerate(others):
        start = found[number % len(found)].state if found else None
        away = problem.solve(other, ratios, start)
        if away.converged:
            add(problem.solve(load, ratios, away.state))
    return tuple(sorted(found, key=lambda one: one.energy))


def _pushed(problem: EquilibriumProblem, load: LoadCase, size: float, random: np.random.Generator) -> LoadCase:
    """``load`` and random forces of ``size`` N in sum, one on every bone."""
    bones = len(problem.torso.bone_names)
    forces, offsets = random.normal(size=(2, bones, 3))
    forces *= size / np.linalg.norm(forces, axis=1).sum()
    offsets *= ROTATION_LENGTH / np.linalg.norm(offsets, axis=1, keepdims=True)
    bone = np.concatenate([load.points.bone, np.arange(bones)])
    points = PointsOnBones(bone, np.concatenate([load.points.offset, offsets]))
    return LoadCase(points, np.concatenate([load.forces, forces]))


def least_eigenvalue(problem: EquilibriumProblem, linear: Linearisation) -> float:
    """The tangent's least eigenvalue, N/mm, in units in which a turn counts as what it moves at 30 mm."""
    free = np.ones(problem.potential.dofs, dtype=bool)
    free[problem.held] = False
    size = np.ones(problem.potential.dofs)
    size[: 6 * problem.potential.bones].reshape(-1, 6)[:, 3:] = ROTATION_LENGTH
    size, count = size[free], int(free.sum())

    def inverse(x: Floats) -> Floats:
        full = np.zeros(problem.potential.dofs)
        full[free] = size * x.ravel()
        return size * linear.solve(full)[free]

    if count < 8:
        return float(1.0 / np.linalg.eigvalsh(np.column_stack([inverse(e) for e in np.eye(count)])).max())
    operator = spla.LinearOperator((count, count), matvec=inverse, dtype=np.float64)
    largest = spla.eigsh(operator, k=1, which="LA", return_eigenvectors=False, tol=1e-3, v0=np.ones(count))
    return float(1.0 / largest[0])
