"""Which bone, joint, node or element is at fault where a solve ended without an equilibrium; in words."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy.sparse.linalg as spla

from spinestiff.anatomy.names import INTERVERTEBRAL
from spinestiff.anatomy.state import TorsoState
from spinestiff.anatomy.stiffness import DIRECTIONS, JOINT_AXES
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.arrays import Floats
from spinestiff.errors import EquilibriumError
from spinestiff.mechanics.assembly import ROTATION_LENGTH, Stiffness
from spinestiff.mechanics.joints import joint_pose
from spinestiff.mechanics.result import Equilibrium, SolveStatus
from spinestiff.mechanics.system import System
from spinestiff.mechanics.terms import Term
from spinestiff.mechanics.tissue import QUADRATURE, rest_jacobians

CLINICAL = {column: name.replace("_", " ") for name, column in DIRECTIONS.items()}


def fault_of(system: System, found: Equilibrium, stiffness: Stiffness, terms: Sequence[Term]) -> str:
    """What is at fault where a solve ended as ``found``, in one line; empty where it converged.

    An inverted start: its worst element. A saddle: the softest motion. Else residual, element and joint (``at_fault``).
    """
    if found.converged:
        return ""
    if found.status is SolveStatus.INVERTED_START:
        return worst_element(system.torso, found.state)
    if found.status is SolveStatus.SADDLE:
        try:
            return softest_motion(system, system.potential.hessian(found.state, stiffness, terms))
        except (EquilibriumError, spla.ArpackError):
            pass  # too near to singular for an eigenvalue
    gradient = system.free(system.potential.gradient(found.state, stiffness, terms))
    return at_fault(system.torso, found.state, gradient)


def at_fault(torso: TorsoModel, state: TorsoState, gradient: Floats) -> str:
    """Largest residual, smallest J and largest turn of a joint in one line."""
    return "; ".join(
        (largest_residual(torso, state, gradient), worst_element(torso, state), largest_joint_motion(torso, state))
    )


def largest_residual(torso: TorsoModel, state: TorsoState, gradient: Floats) -> str:
    """The bone or free node with the largest unbalanced force of a ``gradient`` (dofs,), N; moments over 30 mm."""
    bones = np.abs(gradient[: 6 * len(torso.bone_names)].reshape(-1, 2, 3)).max(axis=2)
    bones[:, 1] /= ROTATION_LENGTH
    nodes = np.abs(gradient[6 * len(torso.bone_names) :].reshape(-1, 3)).max(axis=1)
    if nodes.max(initial=0.0) > bones.max(initial=0.0):
        node = int(np.argmax(nodes))
        place = state.tissue_positions[node]
        number = int(torso.tissue.free_nodes[node])
        return (
            f"force of {nodes[node]:.1e} N on tissue node {number} at {_place(place)} near {_near(torso, state, place)}"
        )
    bone, turning = np.unravel_index(int(np.argmax(bones)), bones.shape)
    size, name = bones[bone, turning], torso.bone_names[bone]
    return f"moment of {ROTATION_LENGTH * size:.1e} N mm on {name}" if turning else f"force of {size:.1e} N on {name}"


def worst_element(torso: TorsoModel, state: TorsoState) -> str:
    """The tissue element with the smallest volume ratio J at an integration point, and the bones beside it."""
    mesh = torso.tissue
    if not len(mesh.elements):
        return "no tissue"
    points = QUADRATURE[mesh.elements.shape[1]][0]
    x = torso.node_positions(state)
    now, rest = (np.linalg.det(rest_jacobians(p, mesh.elements, points)[0]) for p in (x, mesh.rest_positions))
    ratio = (now / rest).min(axis=1)
    worst = int(np.argmin(ratio))
    nodes = mesh.elements[worst]
    place = x[nodes[:4]].mean(0)
    tied = np.unique(mesh.bone_of_node[nodes])
    names = [torso.bone_names[b] for b in tied[tied >= 0]]
    beside = f"tied to {' and '.join(names)}" if names else f"near {_near(torso, state, place)}"
    return f"J = {ratio[worst]:.2g} in tissue element {worst} at {_place(place)}, {beside}"


def largest_joint_motion(torso: TorsoModel, state: TorsoState) -> str:
    """The joint that has turned most since rest: its name, degrees and the axis with most of it."""
    if not len(torso.joints):
        return "no joints"
    turned = joint_pose(torso.joints, state).rotation
    joint = int(np.argmax(np.linalg.norm(turned, axis=1)))
    axis = int(np.argmax(np.abs(turned[joint])))
    name = JOINT_AXES[3 + axis]
    if torso.joints.kinds[joint] in INTERVERTEBRAL:
        name += f" ({CLINICAL[3 + axis]})"
    degrees = np.degrees(np.linalg.norm(turned[joint]))
    return f"joint {torso.joints.names[joint]} has turned {degrees:.1f} deg, most of it about {name}"


def softest_motion(system: System, hessian: Floats) -> str:
    """The softest direction of a tangent (``hessian``: values in the potential's pattern), and what moves most in it.

    The lowest eigenvalue, turns times 30 mm, by inverse iteration on the tangent plus the least of several stiffnesses
    to the ground that makes it positive definite: a few factorisations.

    Raises
    ------
    EquilibriumError : the tangent holds a value that is not finite.
    """
    torso, dofs = system.torso, system.potential.dofs
    scale = np.ones(dofs)
    scale[: 6 * len(torso.bone_names)].reshape(-1, 6)[:, 3:] = ROTATION_LENGTH
    diagonal = system.potential.pattern.indptr[:-1]  # a column of the lower triangle begins with its diagonal
    free = np.ones(dofs)
    free[system.held] = 0.0
    if not free.any():
        return "nothing can move"
    shifted, shift = np.array(hessian), 0.0
    # The first shift keeps a singular tangent from a division by zero; the last exceeds any stiffness of a torso.
    for power in range(-9, 7):
        shift = 10.0**power
        shifted[diagonal] = hessian[diagonal] + shift * scale**2
        factor = system.numeric_factor(shifted)
        if factor.positive_definite:
            break

    def inverse(v: Floats) -> Floats:
        # Held degrees of freedom are left out, so that their unit diagonal is no eigenvalue.
        solved: Floats = scale * free * factor.solve(scale * free * v.ravel())
        return solved

    operator = spla.LinearOperator((dofs, dofs), inverse, dtype=np.float64)
    start = np.random.default_rng(0).normal(size=dofs) * free
    values, vectors = spla.eigsh(operator, k=1, v0=start, tol=1e-6)
    vector = vectors[:, 0]
    bones = vector[: 6 * len(torso.bone_names)].reshape(-1, 2, 3)
    moves = np.linalg.norm(bones, axis=2)
    nodes = np.linalg.norm(vector[bones.size :].reshape(-1, 3), axis=1)
    what = f"stiffness {1.0 / values[0] - shift:.1e} N/mm in the motion"
    if nodes.max(initial=0.0) > moves.max(initial=0.0):
        node = int(torso.tissue.free_nodes[int(np.argmax(nodes))])
        place = torso.tissue.rest_positions[node]
        return f"{what} of tissue node {node} near {_near(torso, torso.rest_pose, place)}"
    bone, turning = np.unravel_index(int(np.argmax(moves)), moves.shape)
    how = "turns" if turning else "shifts"
    return f"{what} in which {torso.bone_names[bone]} {how} most, along {_direction(bones[bone, turning])}"


def _place(point: Floats) -> str:
    return "({:.0f}, {:.0f}, {:.0f}) mm".format(*(point.round() + 0.0))


def _near(torso: TorsoModel, state: TorsoState, point: Floats) -> str:
    """Name of the bone nearest to a point (3,) mm in a state, by its surface where it has one, else its origin."""
    gaps = np.linalg.norm(state.bone_positions - point, axis=1)
    for bone in range(len(torso.bone_surfaces)):
        gaps[bone] = np.linalg.norm(torso.surface_positions(state, bone) - point, axis=1).min()
    return torso.bone_names[int(np.argmin(gaps))]


def _direction(vector: Floats) -> str:
    unit = vector / np.linalg.norm(vector)
    unit = unit * np.sign(unit[np.argmax(np.abs(unit))])
    return "({:.2f}, {:.2f}, {:.2f})".format(*(unit.round(2) + 0.0))
