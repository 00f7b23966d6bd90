"""Tissue alone against scikit-fem: the same mesh and energy, weak forms written out, SciPy's sparse solver."""

from __future__ import annotations

import numpy as np
import pytest

skfem = pytest.importorskip("skfem", reason="needs scikit-fem (extra [oracles])")

MU, LAMBDA = 0.02, 0.15
RELATIVE = 1e-8


class _Solid:
    """Forces and tangents of the block by scikit-fem; places as (N, 3) in our order of nodes."""

    def __init__(self, nodes, elements):
        from skfem.helpers import ddot, det, grad, identity, inv, mul, trace, transpose

        quadratic = elements.shape[1] == 10
        corners = np.unique(elements[:, :4])
        new = np.full(len(nodes), -1)
        new[corners] = np.arange(len(corners))
        mesh = skfem.MeshTet(nodes[corners].T.copy(), new[elements[:, :4]].T.copy())
        element = skfem.ElementVector(skfem.ElementTetP2() if quadratic else skfem.ElementTetP1())
        self.basis = skfem.Basis(mesh, element, intorder=2 if quadratic else 1)
        # Its dofs, by where they lie: the elements have straight sides.
        places = self.basis.doflocs[:, ::3].T
        gaps = np.linalg.norm(places[:, None] - nodes, axis=-1)
        self.node = gaps.argmin(1)
        assert gaps.min(1).max() < 1e-9 and len(np.unique(self.node)) == len(nodes)
        self.rest = nodes

        def kinematics(w):
            f = grad(w["u"]) + identity(grad(w["u"]))
            return f, transpose(inv(f)), np.log(det(f))

        @skfem.LinearForm
        def force(v, w):
            f, g, log_j = kinematics(w)
            return ddot(MU * (f - g) + LAMBDA * log_j * g, grad(v))

        @skfem.BilinearForm
        def tangent(u, v, w):
            _, g, log_j = kinematics(w)
            du = grad(u)
            turned = mul(mul(g, transpose(du)), g)
            stress = MU * du + (MU - LAMBDA * log_j) * turned + LAMBDA * trace(mul(transpose(g), du)) * g
            return ddot(stress, grad(v))

        self._force, self._tangent = force, tangent
        self.order = (3 * np.argsort(self.node)[:, None] + np.arange(3)).ravel()

    def assemble(self, x):
        u = np.empty(x.size)
        u[self.order] = (x - self.rest).ravel()
        field = self.basis.interpolate(u)
        force = self._force.assemble(self.basis, u=field)[self.order].reshape(-1, 3)
        tangent = self._tangent.assemble(self.basis, u=field).tocsr()
        return force, tangent[self.order][:, self.order]


def test_displacements_of_a_block_between_moved_ends(block):
    solid = _Solid(block.nodes, block.elements)
    moves = block.found - block.nodes
    x = block.found + np.random.default_rng(0).uniform(-0.2, 0.2, moves.shape)
    x[block.fixed] = block.found[block.fixed]
    assert np.abs(x - block.found).max() > 0.15
    inner = np.setdiff1d(np.arange(x.size), (3 * block.fixed[:, None] + np.arange(3)).ravel())
    for _ in range(12):
        force, tangent = solid.assemble(x)
        x.ravel()[inner] += skfem.solve(tangent[inner][:, inner], -force.ravel()[inner])
    assert np.abs(force.ravel()[inner]).max() < 1e-12
    assert np.abs(x - block.found).max() / np.abs(moves).max() < RELATIVE


def test_a_bone_in_tissue(bone_block, reduced):
    b = bone_block
    x, place, turn = reduced(b, _Solid(b.block.nodes, b.block.elements).assemble).solve()
    size = np.abs(b.block.found - b.block.nodes).max()
    assert np.abs(b.turn - np.eye(3)).max() > 0.1
    assert np.abs(x - b.block.found).max() < RELATIVE * size
    assert place == pytest.approx(b.place, abs=RELATIVE * size)
    assert turn == pytest.approx(b.turn, abs=RELATIVE)
