"""A small planar spine of springs with the interface of an equilibrium problem, so that fits run in milliseconds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from spinestiff.anatomy.names import VERTEBRAE
from spinestiff.anatomy.points import PointsOnBones, rotation_second_derivative
from spinestiff.anatomy.state import TorsoState, retract
from spinestiff.anatomy.stiffness import StiffnessRatios, stiffness_ratios
from spinestiff.anatomy.torso import JointTable, TissueMesh, TorsoModel, joint_frames
from spinestiff.estimation.objective import Trial
from spinestiff.imaging.features import VertebraCorners, silhouette_shares, state_features
from spinestiff.imaging.projection import frontal_view
from spinestiff.mechanics.equilibrium import Equilibrium, SolveStatus
from spinestiff.mechanics.loads import LoadCase

NAMES = VERTEBRAE[4:]
LINK, BEND, WALL, HARDENING = 500.0, 4e5, 3.0, 4e-3
PLANAR = np.array([0, 1, 5])
SOFT = {"lateral_bending": 0.1, "tissue": 0.03}


def planar_torso(count: int = len(NAMES)) -> TorsoModel:
    """A column of vertebrae, 25 mm apart; the last one is held."""
    names = NAMES[:count]
    positions = np.stack([np.zeros(count), 300.0 - 25.0 * np.arange(count), np.zeros(count)], 1)
    rest = TorsoState(positions, np.tile(np.eye(3), (count, 1, 1)), np.empty((0, 3)))
    parent, child = np.arange(1, count), np.arange(count - 1)
    centre = 0.5 * (positions[1:] + positions[:-1])
    frames = joint_frames(rest, parent, child, centre, np.tile(np.eye(3), (count - 1, 1, 1)))
    joints = JointTable(
        tuple(f"{b}-{a}" for a, b in zip(names, names[1:])),
        ("thoracic",) * (count - 1),
        parent,
        child,
        frames["parent_position"],
        frames["parent_axes"],
        frames["child_position"],
        frames["child_axes"],
        np.ones((count - 1, 6)),
    )
    tissue = TissueMesh(np.empty((0, 3)), np.empty((0, 4)), np.empty(0), np.empty(0), np.empty(0))
    corners = np.array([[x, y, z] for y in (9, -9) for x in (16, -16) for z in (13, -13)], dtype=float)
    return TorsoModel(names, rest, joints, tissue, np.tile(corners, (count, 1, 1)), (), {}, 160.0, names)


@dataclass
class PlanarLinearisation:
    """K and the ratios' gradients, dense."""

    problem: PlanarSpine
    state: TorsoState
    load: LoadCase
    ratios: StiffnessRatios | None

    def __post_init__(self) -> None:
        self.hessian = self.problem.derivatives(self.state, self.load, self.ratios)[1]

    def solve(self, rhs: np.ndarray) -> np.ndarray:
        out = np.zeros(rhs.shape)
        out[self.problem.free] = np.linalg.solve(self.hessian, rhs[self.problem.free])
        return out

    def shares(self, groups) -> np.ndarray:
        return np.stack([self.problem.share(self.state, g, self.ratios) for g in groups], 1)

    def forward(self, groups) -> np.ndarray:
        return -self.solve(self.shares(groups))

    def adjoint(self, gradient: np.ndarray, groups) -> np.ndarray:
        return -self.shares(groups).T @ self.solve(gradient)

    def load_derivative(self, change) -> np.ndarray:
        blocks = change.blocks(self.state)
        rhs = np.zeros(self.state.dofs)
        np.add.at(rhs.reshape(-1, 6), blocks.bone, -blocks.gradient)
        return self.solve(rhs)


class PlanarSpine:
    """Links, bending springs between vertebrae and a hardening foundation ("tissue") under each."""

    def __init__(self, torso: TorsoModel, fails_below: float = 0.0) -> None:
        self.torso, self.fails_below, self.solves = torso, fails_below, 0
        joints = torso.joints
        self.upper = PointsOnBones(joints.child, joints.child_position)
        self.lower = PointsOnBones(joints.parent, joints.parent_position)
        bones = np.arange(len(torso.bone_names) - 1)
        self.free = (6 * bones[:, None] + PLANAR).reshape(-1)

    def factors(self, ratios: StiffnessRatios | None) -> tuple[np.ndarray, float]:
        ones = np.ones((len(self.torso.joints), 6))
        if ratios is None:
            return ones, 1.0
        mu, _ = ratios.scale_tissue(np.ones(1), np.ones(1))
        return ratios.scale_joints(ones), float(mu[0])

    def parts(self, state: TorsoState):
        """Energy, gradient and Hessian of links and bending, per joint, and of the tissue."""
        turn = np.arctan2(state.bone_rotations[:, 1, 0], state.bone_rotations[:, 0, 0])
        n, joints = state.dofs, self.torso.joints
        gap = self.upper.positions(state) - self.lower.positions(state)
        up, low = self.upper.jacobian(state), self.lower.jacobian(state)
        result = []
        for j, (a, b) in enumerate(zip(joints.child, joints.parent)):
            rows = np.concatenate([6 * a + np.arange(6), 6 * b + np.arange(6)])
            slope = np.hstack([up[j], -low[j]])
            hessian = LINK * slope.T @ slope
            second = LINK * rotation_second_derivative(
                np.stack([gap[j], -gap[j]]), np.stack([self.upper.arms(state)[j], self.lower.arms(state)[j]])
            )
            hessian[3:6, 3:6] += second[0]
            hessian[9:, 9:] += second[1]
            link = (0.5 * LINK * gap[j] @ gap[j], rows, LINK * slope.T @ gap[j], hessian)
            d = np.zeros(12)
            d[5], d[11] = 1.0, -1.0
            angle = turn[a] - turn[b]
            bend = (0.5 * BEND * angle**2, rows, BEND * angle * d, BEND * np.outer(d, d))
            result.append((link, bend))
        x = state.bone_positions[:, 0] - self.torso.rest_pose.bone_positions[:, 0]
        tissue = np.zeros(n)
        tissue[::6] = WALL * x + HARDENING * x**3
        stiff = np.zeros(n)
        stiff[::6] = WALL + 3.0 * HARDENING * x**2
        energy = float(np.sum(0.5 * WALL * x**2 + 0.25 * HARDENING * x**4))
        return result, (energy, tissue, stiff)

    def energy(self, state, load, ratios) -> float:
        scale, tissue = self.factors(ratios)
        joints, (e, _, _) = self.parts(state)
        own = sum(link[0] * s[1] + bend[0] * s[5] for (link, bend), s in zip(joints, scale))
        return own + tissue * e + load.energy(state)

    def derivatives(self, state, load, ratios) -> tuple[np.ndarray, np.ndarray]:
        scale, tissue = self.factors(ratios)
        joints, (_, g, h) = self.parts(state)
        gradient, hessian = tissue * g, np.diag(tissue * h)
        for (link, bend), s in zip(joints, scale):
            for part, factor in ((link, s[1]), (bend, s[5])):
                gradient[part[1]] += factor * part[2]
                hessian[np.ix_(part[1], part[1])] += factor * part[3]
        blocks = load.blocks(state)
        for bone, bg, bh in zip(blocks.bone, blocks.gradient, blocks.hessian):
            rows = 6 * bone + np.arange(6)
            gradient[rows] += bg
            hessian[np.ix_(rows, rows)] += bh
        return gradient[self.free], hessian[np.ix_(self.free, self.free)]

    def share(self, state, group, ratios) -> np.ndarray:
        scale, tissue = self.factors(ratios)
        joints, (_, g, _) = self.parts(state)
        total = tissue * g * float(group.mu)
        for (link, bend), s, mask in zip(joints, scale, group.joints):
            total[link[1]] += s[1] * link[2] * mask[1]
            total[bend[1]] += s[5] * bend[2] * mask[5]
        return total

    def solve(self, load, ratios=None, start=None) -> Equilibrium:
        self.solves += 1
        state = start.state if isinstance(start, PlanarLinearisation) else start or self.torso.rest_pose
        status, steps, norm = SolveStatus.ITERATION_LIMIT, 0, np.inf
        if ratios is not None and ratios.values.min() < self.fails_below:
            return Equilibrium(state, SolveStatus.STALLED, 0.0, 1.0, 0.0, (), (), 0, 1.0)
        for steps in range(100):  # noqa: B007
            gradient, hessian = self.derivatives(state, load, ratios)
            norm = np.abs(gradient).max()
            if norm < 1e-8:
                status = SolveStatus.CONVERGED
                break
            dx = np.zeros(state.dofs)
            dx[self.free] = -np.linalg.solve(hessian, gradient)
            dx *= min(1.0, 0.3 / np.abs(dx[5::6]).max())
            energy, step = self.energy(state, load, ratios), 1.0
            while step > 1e-3 and self.energy(retract(state, step * dx), load, ratios) > energy + 1e-9 * abs(energy):
                step *= 0.5
            state = retract(state, step * dx)
        return Equilibrium(state, status, 0.0, float(norm), 1e-8, (), (), steps, 1.0)

    def linearise(self, equilibrium, load, ratios=None) -> PlanarLinearisation:
        equilibrium.require()
        return PlanarLinearisation(self, equilibrium.state, load, ratios)


VIEW = frontal_view(centre=(0, 150, 0))


def push(force: float, bone: int = 4) -> LoadCase:
    return LoadCase(PointsOnBones(np.array([bone]), [[-40.0, 0, 0]]), [[force, 0, 0]], f"{force:g} N")


def shown(problem: PlanarSpine, load: LoadCase, ratios: StiffnessRatios, error: float = 0.0, seed: int = 0) -> Trial:
    """A trial whose corners are the simulated ones, with white errors of sd ``error`` mm at the patient plane."""
    state = problem.solve(load, ratios).require().state
    shares = silhouette_shares(problem.torso, VIEW, problem.torso.rest_pose)
    corners = state_features(problem.torso, VIEW, state, shares).corners
    noise = np.random.default_rng(seed).standard_normal(corners.shape)
    corners = corners + error * VIEW.magnification * noise
    visible = slice(0, len(problem.torso.vertebrae) - 1)
    return Trial(load, VertebraCorners(problem.torso.vertebrae[visible], corners[visible]), VIEW, load.label, "push 1")


@pytest.fixture
def spine() -> PlanarSpine:
    return PlanarSpine(planar_torso())


@pytest.fixture
def show():
    return shown


@pytest.fixture
def push_by():
    return push


@pytest.fixture
def planar_spine_type():
    return PlanarSpine


@pytest.fixture
def trials(spine, show, push_by):
    def make(truth=SOFT, error=0.0, forces=(30.0, 60.0), problem=None):
        problem = problem or spine
        ratios = stiffness_ratios(truth, problem.torso.joints.kinds)
        return [show(problem, push_by(force), ratios, error, seed) for seed, force in enumerate(forces)]

    return make
