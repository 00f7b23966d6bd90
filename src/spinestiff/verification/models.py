"""Small models with every feature of a torso, for checks and tests."""

from __future__ import annotations

import numpy as np

from spinestiff.anatomy.grid_mesh import grid_mesh, quadratic
from spinestiff.anatomy.points import PointsOnBones
from spinestiff.anatomy.rotation import exp_so3
from spinestiff.anatomy.state import TorsoState
from spinestiff.anatomy.stiffness import lame_parameters
from spinestiff.anatomy.torso import JointTable, TissueMesh, TorsoModel, joint_frames
from spinestiff.arrays import Floats, Ints


def box_mesh(cells: tuple[int, int, int], size: tuple[float, float, float], nodes: int = 10) -> tuple[Floats, Ints]:
    """Positions (N, 3) mm and elements (T, 4 or 10) of a box with one corner at the origin."""
    x, y, z = (np.linspace(0, s, n + 1) for s, n in zip(size, cells))
    positions, elements = grid_mesh(x, y, z)
    return (positions, elements) if nodes == 4 else quadratic(positions, elements)


def make_torso(
    state_positions: Floats,
    links: list[tuple[int, int]],
    stiffness: Floats,
    mesh: tuple[Floats, Ints] | None = None,
    bone_of_node: Ints | None = None,
    young: float = 0.05,
    poisson: float = 0.4,
    centres: Floats | None = None,
    axes: Floats | None = None,
    rotations: Floats | None = None,
) -> TorsoModel:
    """A torso of bare bones at ``state_positions`` (B, 3), joined by ``links`` and set in a mesh."""
    b = len(state_positions)
    rotations = np.broadcast_to(np.eye(3), (b, 3, 3)) if rotations is None else rotations
    positions, elements = mesh or (np.empty((0, 3)), np.empty((0, 4), np.int64))
    bone_of_node = np.full(len(positions), -1) if bone_of_node is None else bone_of_node
    rest = TorsoState(state_positions, rotations, positions[bone_of_node < 0])
    parent, child = np.array(links, dtype=np.int64).reshape(-1, 2).T
    centres = 0.5 * (state_positions[parent] + state_positions[child]) if centres is None else centres
    axes = np.broadcast_to(np.eye(3), (len(links), 3, 3)) if axes is None else axes
    mu, lam = lame_parameters(young, poisson)
    t = len(elements)
    return TorsoModel(
        bone_names=tuple(f"bone{i}" for i in range(b)),
        rest_pose=rest,
        joints=JointTable(
            tuple(f"bone{p}-bone{c}" for p, c in links),
            ("thoracic",) * len(links),
            parent,
            child,
            stiffness=np.broadcast_to(stiffness, (len(links), 6)),
            **joint_frames(rest, parent, child, centres, axes),
        ),
        tissue=TissueMesh(positions, elements, bone_of_node, np.full(t, mu), np.full(t, lam)),
        vertebra_boxes=np.empty((0, 8, 3)),
        bone_surfaces=(),
        landmarks={},
        height_cm=157.0,
        vertebrae=(),
    )


def toy_torso(seed: int = 0, nodes: int = 10, turned: float = 0.4) -> TorsoModel:
    """Three bones in a block of tissue, two joints with tilted frames; rest shape of the elements slightly curved.

    ``turned`` is the largest component, rad, of the bones' rotations at rest.
    """
    random = np.random.default_rng(seed)
    positions, elements = box_mesh((2, 2, 2), (60.0, 90.0, 40.0), nodes)
    positions = positions + random.uniform(-1.0, 1.0, positions.shape)
    middles = np.array([[30.0, 10.0, 20.0], [30.0, 45.0, 20.0], [30.0, 80.0, 20.0]])
    near = np.linalg.norm(positions[:, None] - middles, axis=-1)
    bone_of_node = np.where(near.min(1) < 23.0, near.argmin(1), -1)
    rotations = exp_so3(turned * random.uniform(-1.0, 1.0, (3, 3)))
    return make_torso(
        middles,
        [(1, 0), (2, 1)],
        np.array([26.0, 170.0, 30.0, 15e3, 13e3, 11e3]),
        (positions, elements),
        bone_of_node,
        centres=middles[1:] - [1.0, 18.0, 2.0],
        axes=exp_so3(random.uniform(-0.4, 0.4, (2, 3))),
        rotations=rotations,
    )


def shaken(torso: TorsoModel, seed: int, turn: float = 0.15, move: float = 2.0) -> TorsoState:
    """The rest pose with every bone and node moved at random: rad, mm."""
    random = np.random.default_rng(seed)
    rest = torso.rest_pose
    b = len(rest.bone_positions)
    return TorsoState(
        rest.bone_positions + random.uniform(-move, move, (b, 3)),
        exp_so3(random.uniform(-turn, turn, (b, 3))) @ rest.bone_rotations,
        rest.tissue_positions + random.uniform(-move, move, rest.tissue_positions.shape),
    )


def points_on(torso: TorsoModel, count: int, seed: int) -> PointsOnBones:
    """Random points on random bones."""
    random = np.random.default_rng(seed)
    return PointsOnBones(random.integers(0, len(torso.bone_names), count), random.uniform(-20.0, 20.0, (count, 3)))
