"""Another element on the torso's mesh, to compare the package's with: linear tetrahedra, volumes averaged at nodes.

The volumetric energy of each node a follows the volume of the elements around it (Bonet and Burton 1998):

    E = sum_e V_e mu [(I1 - 3)/2 - log J_e] + sum_a V_a lambda/2 (log Jbar_a)^2,   V_a Jbar_a = sum_e V_e/4 J_e

With G_a = d(V_a Jbar_a)/dx and D_a = lambda (1 - log Jbar_a) / (V_a Jbar_a^2) the tangent is A + G^T D G, where A
couples no more nodes than linear tetrahedra do. ``Form.CONDENSED`` adds the product up, which couples neighbours of
neighbours; ``Form.MIXED`` keeps one pressure increment y a node, [[A, G^T], [G, -1/D]], whose inertia has as many
negative eigenvalues as there are pressures where the state is a minimum. Both have the same solution.

Benchmark code: it shares the element kernels and the joints with the package, not its assembly. ``python
benchmarks/elements.py [--write]`` prints how far it is from finite differences and from the package.
"""

from __future__ import annotations

import argparse
import datetime
import enum
import json
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import rslab
import scipy.sparse as sp

from spinestiff.anatomy.points import rotation_second_derivative
from spinestiff.anatomy.state import TorsoState, retract
from spinestiff.anatomy.stiffness import StiffnessRatios, stiffness_ratios
from spinestiff.anatomy.template import template_torso
from spinestiff.anatomy.torso import TET10_EDGES, TissueMesh, TorsoModel
from spinestiff.arrays import Floats, Ints
from spinestiff.mechanics import tissue as law
from spinestiff.mechanics.loads import LoadCase, rib_push
from spinestiff.mechanics.potential import Potential
from spinestiff.mechanics.supports import Supports, three_point_supports


def _split() -> Ints:
    # A ten-node element as eight linear ones on the same nodes: corners cut off, then the octahedron around the axis
    # between the middles of two opposite edges.
    middle = {frozenset(edge): 4 + place for place, edge in enumerate(TET10_EDGES)}
    cut = [[a, *(middle[frozenset((a, b))] for b in range(4) if b != a)] for a in range(4)]
    ring = [middle[frozenset(edge)] for edge in ((0, 2), (1, 2), (1, 3), (0, 3))]
    axis = [middle[frozenset((0, 1))], middle[frozenset((2, 3))]]
    return np.array(cut + [[*axis, ring[i], ring[(i + 1) % 4]] for i in range(4)])


SPLIT = _split()


class Form(enum.Enum):
    """How the tangent is solved."""

    CONDENSED = "nodal-averaged J"
    MIXED = "mixed displacement-pressure"


def linear_torso(torso: TorsoModel) -> TorsoModel:
    """The same torso on linear tetrahedra with the same nodes: every ten-node element becomes eight."""
    mesh = torso.tissue
    elements = mesh.elements[:, SPLIT].reshape(-1, 4)
    corners = mesh.rest_positions[elements]
    flip = np.linalg.det(corners[:, 1:] - corners[:, :1]) < 0.0
    elements[flip] = elements[flip][:, [1, 0, 2, 3]]
    mu, lambda_ = (np.repeat(values, len(SPLIT)) for values in (mesh.lame_mu, mesh.lame_lambda))
    return replace(torso, tissue=TissueMesh(mesh.rest_positions, elements, mesh.bone_of_node, mu, lambda_))


@dataclass(frozen=True)
class Solved:
    """An equilibrium of ``VolumeAveraged``: state, Newton steps, largest force left N, whether it is a minimum,
    smallest J of an element and of a node, and the median CPU s of a step's assembly, factorisation and solve."""

    state: TorsoState
    steps: int
    residual: float
    minimum: bool
    smallest_j: float
    smallest_nodal_j: float
    step_cpu_s: tuple[float, float, float]


class VolumeAveraged:
    """Equilibrium of a torso on linear tetrahedra with volumes averaged at nodes.

    Parameters
    ----------
    torso : on linear tetrahedra. supports : holds and springs.
    """

    def __init__(self, torso: TorsoModel, supports: Supports, ratios: StiffnessRatios | None, form: Form) -> None:
        mesh = torso.tissue
        self.torso, self.supports, self.ratios, self.form = torso, supports, ratios, form
        none = TissueMesh(np.zeros((0, 3)), np.zeros((0, 4), np.int64), np.zeros(0, np.int64), np.zeros(0), np.zeros(0))
        rest = torso.rest_pose
        bare = TorsoState(rest.bone_positions, rest.bone_rotations, np.zeros((0, 3)))
        # Joints, springs and loads come from the package, of the same torso without its tissue.
        self.bare = Potential(replace(torso, tissue=none, rest_pose=bare))
        self.data = law.element_data(mesh)
        moduli = mesh.lame_mu, mesh.lame_lambda
        mu, lambda_ = ratios.scale_tissue(*moduli) if ratios else moduli
        self.mu = mu[self.data.number]
        self.volume = self.data.weights[:, 0]
        self.node, self.place = np.unique(self.data.elements, return_inverse=True)
        self.place = self.place.reshape(self.data.elements.shape)
        self.node_volume = self._at_nodes(self.volume)
        stiffness = lambda_[self.data.number]
        self.lambda_ = self._at_nodes(stiffness * self.volume) / self.node_volume
        self.bones, self.free = len(torso.bone_names), mesh.free_nodes
        self.dofs = 6 * self.bones + 3 * len(self.free)
        self.tied = np.flatnonzero(mesh.bone_of_node >= 0)
        self.held = np.flatnonzero(supports.held.ravel())
        self._pattern: tuple[Ints, Ints, Ints] | None = None
        self._symbolic = None

    def _at_nodes(self, values: Floats) -> Floats:
        # A quarter of each element's value to each of its nodes.
        return np.bincount(self.place.ravel(), np.repeat(0.25 * values, 4), minlength=len(self.node))

    def volumes(self, x: Floats) -> tuple[Floats, Floats]:
        """J of the elements (T,) and averaged at the nodes that deform (n,)."""
        f = np.einsum("tni,tnj->tij", x[self.data.elements], self.data.gradients[:, 0])
        j = np.linalg.det(f)
        return j, self._at_nodes(self.volume * j) / self.node_volume

    def energy(self, state: TorsoState, load: LoadCase) -> float:
        """N mm; infinite where an element is inverted."""
        x = self.torso.node_positions(state)
        parts, smallest = law.element_energies(x, self.data.elements, self.data.gradients, self.data.weights)
        if not smallest.min() > 0.0:
            return np.inf
        averaged = self.volumes(x)[1]
        volumetric = 0.5 * np.sum(self.lambda_ * self.node_volume * np.log(averaged) ** 2)
        bones, _ = self.bare.energy(self._bare(state), self.bare.stiffness(self.ratios), self._terms(load))
        return float(self.mu @ parts[:, 0] + volumetric + bones)

    def gradient(self, state: TorsoState, load: LoadCase) -> Floats:
        """(dofs,) of the energy, holds included."""
        gradient = np.asarray(self._motion(state).T @ self._node_gradient(state).ravel())
        gradient[: 6 * self.bones] += self.bare.gradient(
            self._bare(state), self.bare.stiffness(self.ratios), self._terms(load)
        )
        return gradient

    def tangent(self, state: TorsoState, load: LoadCase) -> sp.csc_array:
        """The condensed Hessian, or the saddle's matrix (dofs + n) with the pressures last; holds not yet applied."""
        x, d = self.torso.node_positions(state), self.data
        j, averaged = self.volumes(x)
        pressure = self._pressures(averaged)
        pairs = law.element_hessians(x, d.elements, d.gradients, d.weights, self.mu, np.zeros(len(self.mu)))
        blocks = np.empty((len(pairs), 4, 4, 3, 3))
        for pair, (a, b) in enumerate(zip(*np.tril_indices(4))):
            blocks[:, b, a] = np.swapaxes(pairs[:, pair], -1, -2)
            blocks[:, a, b] = pairs[:, pair]
        h = self._spatial(x)
        outer = np.einsum("t,tai,tbj->tabij", self.volume * pressure * j, h, h)
        blocks += outer - outer.transpose(0, 1, 2, 4, 3)
        rows = 3 * d.elements[:, :, None] + np.arange(3)
        shape = blocks.shape[0], 4, 4, 3, 3
        a = sp.coo_array(
            (
                blocks.ravel(),
                (
                    np.broadcast_to(rows[:, :, None, :, None], shape).ravel(),
                    np.broadcast_to(rows[:, None, :, None, :], shape).ravel(),
                ),
            ),
            shape=(3 * len(x), 3 * len(x)),
        ).tocsr()
        motion = self._motion(state)
        k = (motion.T @ a @ motion + self._bone_blocks(state, load)).tocsc()
        g = (self._volume_slopes(x, j) @ motion).tocsr()
        d_a = self.lambda_ * (1.0 - np.log(averaged)) / (self.node_volume * averaged**2)
        if self.form is Form.CONDENSED:
            return sp.csc_array(k + g.T @ sp.diags_array(d_a) @ g)
        return sp.csc_array(sp.block_array([[k, g.T], [g, -sp.diags_array(1.0 / d_a)]]))

    def solve(self, load: LoadCase, start: TorsoState, tolerance: float = 1e-7, most: int = 60) -> Solved:
        """Newton's method from ``start``, with a line search on the energy.

        Raises
        ------
        RuntimeError : no convergence.
        """
        state, energy, cost, minimum = start, self.energy(start, load), [], False
        for step in range(most):
            gradient = self.gradient(state, load)
            gradient[self.held] = 0.0
            residual = float(np.abs(gradient).max())
            if residual <= tolerance and step:
                j, averaged = self.volumes(self.torso.node_positions(state))
                per_step = tuple(float(np.median(column)) for column in zip(*cost))
                return Solved(state, step, residual, minimum, float(j.min()), float(averaged.min()), per_step)
            direction, minimum, times = self._direction(state, load, gradient)
            cost.append(times)
            slope, length = float(gradient @ direction), 1.0
            while True:
                trial = retract(state, length * direction)
                found = self.energy(trial, load)
                if found <= energy + 1e-4 * length * slope + 1e-12 * abs(energy):
                    break
                length *= 0.5
                if length < 1e-6:
                    raise RuntimeError(f"{self.form.value}: no descent, {residual:.1e} N left")
            state, energy = trial, found
        raise RuntimeError(f"{self.form.value}: not converged, {residual:.1e} N left")

    def _direction(
        self, state: TorsoState, load: LoadCase, gradient: Floats
    ) -> tuple[Floats, bool, tuple[float, float, float]]:
        began = time.process_time()
        matrix = sp.tril(self.tangent(state, load), format="csc")
        matrix.sort_indices()
        held = np.zeros(matrix.shape[0], dtype=bool)
        held[self.held] = True
        column = np.repeat(np.arange(matrix.shape[0]), np.diff(matrix.indptr))
        matrix.data[held[column] | held[matrix.indices]] = 0.0
        matrix.data[matrix.indptr[self.held]] = 1.0
        assembled = time.process_time()
        same = self._pattern is not None and all(
            np.array_equal(a, b) for a, b in zip(self._pattern, (matrix.indptr, matrix.indices))
        )
        if not same:
            self._symbolic = rslab.analyze(sp.csc_matrix(matrix), path="ldlt")
            self._pattern = (matrix.indptr, matrix.indices)
        analysed = time.process_time()
        factor = self._symbolic.factor(matrix.data)
        factored = time.process_time()
        rhs = np.zeros(matrix.shape[0])
        rhs[: self.dofs] = -gradient
        solution = factor.solve(rhs)[: self.dofs]
        _, negative, zero = factor.inertia
        wanted = 0 if self.form is Form.CONDENSED else len(self.node)
        done = time.process_time()
        return solution, negative == wanted and zero == 0, (assembled - began, factored - analysed, done - factored)

    def _bare(self, state: TorsoState) -> TorsoState:
        return TorsoState(state.bone_positions, state.bone_rotations, np.zeros((0, 3)))

    def _terms(self, load: LoadCase) -> tuple:
        return load, self.supports.springs

    def _pressures(self, averaged: Floats) -> Floats:
        # (T,) MPa, the mean over an element's nodes of dE/d(V Jbar).
        return (self.lambda_ * np.log(averaged) / averaged)[self.place].mean(1)

    def _spatial(self, x: Floats) -> Floats:
        # (T, 4, 3) F^-T g.
        f = np.einsum("tni,tnj->tij", x[self.data.elements], self.data.gradients[:, 0])
        return np.einsum("tji,tnj->tni", np.linalg.inv(f), self.data.gradients[:, 0])

    def _node_gradient(self, state: TorsoState) -> Floats:
        x, d = self.torso.node_positions(state), self.data
        j, averaged = self.volumes(x)
        parts = law.element_gradients(x, d.elements, d.gradients, d.weights)[:, 0] * self.mu[:, None, None]
        parts = parts + (self.volume * self._pressures(averaged) * j)[:, None, None] * self._spatial(x)
        flat = d.elements.ravel()
        return np.stack([np.bincount(flat, parts[..., i].ravel(), minlength=len(x)) for i in range(3)], 1)

    def _volume_slopes(self, x: Floats, j: Floats) -> sp.csr_array:
        # (n, 3 N), d(V_a Jbar_a)/dx.
        slopes = (0.25 * self.volume * j)[:, None, None] * self._spatial(x)
        shape = len(j), 4, 4, 3
        rows = np.broadcast_to(self.place[:, :, None, None], shape)
        columns = np.broadcast_to((3 * self.data.elements[:, :, None] + np.arange(3))[:, None], shape)
        values = np.broadcast_to(slopes[:, None], shape)
        size = len(self.node), 3 * len(x)
        return sp.coo_array((values.ravel(), (rows.ravel(), columns.ravel())), shape=size).tocsr()

    def _motion(self, state: TorsoState) -> sp.csr_array:
        # (3 N, dofs), how nodes move with the degrees of freedom.
        mesh, count = self.torso.tissue, len(self.torso.tissue.rest_positions)
        a = self.torso.tied_nodes.arms(state)
        zero = np.zeros(len(a))
        cross = np.array([[zero, a[:, 2], -a[:, 1]], [-a[:, 2], zero, a[:, 0]], [a[:, 1], -a[:, 0], zero]])
        six = np.concatenate([np.broadcast_to(np.eye(3)[..., None], cross.shape), cross], axis=1).transpose(2, 0, 1)
        rows = np.broadcast_to((3 * self.tied[:, None] + np.arange(3))[:, :, None], six.shape)
        columns = np.broadcast_to((6 * mesh.bone_of_node[self.tied][:, None] + np.arange(6))[:, None], six.shape)
        own = (3 * self.free[:, None] + np.arange(3)).ravel()
        after = 6 * self.bones + np.arange(3 * len(self.free))
        return sp.coo_array(
            (
                np.concatenate([six.ravel(), np.ones(len(own))]),
                (np.concatenate([rows.ravel(), own]), np.concatenate([columns.ravel(), after])),
            ),
            shape=(3 * count, self.dofs),
        ).tocsr()

    def _bone_blocks(self, state: TorsoState, load: LoadCase) -> sp.csc_array:
        bare = self._bare(state)
        values = self.bare.hessian(bare, self.bare.stiffness(self.ratios), self._terms(load))
        pattern = self.bare.pattern
        size = 6 * self.bones
        lower = sp.csc_array((values, pattern.indices, pattern.indptr), shape=(size, size))
        full = (lower + sp.tril(lower, -1).T).tolil()
        turning = rotation_second_derivative(self._node_gradient(state)[self.tied], self.torso.tied_nodes.arms(state))
        blocks = np.zeros((self.bones, 3, 3))
        np.add.at(blocks, self.torso.tissue.bone_of_node[self.tied], turning)
        for bone, block in enumerate(blocks):
            at = slice(6 * bone + 3, 6 * bone + 6)
            full[at, at] = full[at, at].toarray() + block
        whole = sp.coo_array(full)
        return sp.csc_array(sp.coo_array((whole.data, whole.coords), shape=(self.dofs, self.dofs)))


def agreement() -> dict[str, float]:
    """Relative differences of the element from what it must agree with, by name."""
    torso = linear_torso(template_torso(157.0, "coarse"))
    supports, load = three_point_supports(torso, "right"), rib_push(torso, "right", 8.0, 60.0)
    random = np.random.default_rng(0)
    soft = stiffness_ratios({"lateral_bending": 0.10, "tissue": 0.01})
    condensed, mixed = (VolumeAveraged(torso, supports, soft, form) for form in Form)
    bone, nodes = np.tile([1.0, 1.0, 1.0, 0.01, 0.01, 0.01], condensed.bones), 3 * len(condensed.free)
    scale = np.concatenate([bone, np.ones(nodes)])
    state = retract(torso.rest_pose, 0.02 * scale * random.standard_normal(condensed.dofs))
    along, step = scale * random.standard_normal(condensed.dofs), 1e-4
    before, here, after = (condensed.energy(retract(state, s * along), load) for s in (-step, 0.0, step))
    gradient, tangent = condensed.gradient(state, load), condensed.tangent(state, load)
    slope, curvature = gradient @ along, along @ (tangent @ along)
    found = {
        "gradient against differences of the energy": abs((after - before) / (2 * step) / slope - 1.0),
        "tangent against differences of the energy": abs((after + before - 2 * here) / step**2 / curvature - 1.0),
    }
    gradient[condensed.held] = 0.0
    one, two = (element._direction(state, load, gradient)[0] for element in (condensed, mixed))
    found["Newton step, mixed against condensed"] = np.abs(one - two).max() / np.abs(one).max()
    thin = stiffness_ratios({"lateral_bending": 0.10, "tissue_mu": 0.01, "tissue_lambda": 1e-9})
    ours, package = VolumeAveraged(torso, supports, thin, Form.CONDENSED), Potential(torso)
    terms, stiffness = (load, supports.springs), package.stiffness(thin)
    energy = package.energy(state, stiffness, terms)[0]
    found["energy at lambda near 0 against the package's"] = abs(ours.energy(state, load) / energy - 1.0)
    theirs = package.gradient(state, stiffness, terms)
    found["its gradient"] = np.abs(ours.gradient(state, load) - theirs).max() / np.abs(theirs).max()
    stretch = np.array([[1.10, 0.10, 0.0], [0.0, 0.95, 0.05], [0.02, 0.0, 1.03]])
    averaged = condensed.volumes(torso.tissue.rest_positions @ stretch.T)[1]
    found["averaged J under a uniform deformation"] = np.abs(averaged / np.linalg.det(stretch) - 1.0).max()
    return {name: float(error) for name, error in found.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--write", action="store_true", help="store the differences in benchmarks/results/")
    arguments = parser.parse_args()
    found = agreement()
    for name, error in found.items():
        print(f"{name}: {error:.1e}")
    if arguments.write:
        record = {"date": datetime.datetime.now(datetime.UTC).date().isoformat(), "relative_difference": found}
        path = Path(__file__).parent / "results" / "elements.json"
        path.write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
