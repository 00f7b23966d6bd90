"""Tissue alone against FElupe: the same mesh, the same energy, its own shape functions, quadrature and Newton."""

from __future__ import annotations

import numpy as np
import pytest

fem = pytest.importorskip("felupe", reason="needs FElupe (extra [oracles])")

MU, LAMBDA = 0.02, 0.15
RELATIVE = 1e-8


def _field(nodes, elements):
    kind = {4: "tetra", 10: "tetra10"}[elements.shape[1]]
    mesh = fem.Mesh(nodes, elements, kind)
    # FElupe's own rule of four points has its coordinates to eight digits, which would show at 1e-8.
    a = (5.0 - np.sqrt(5.0)) / 20.0
    rule = fem.quadrature.Scheme(a + (1.0 - 4.0 * a) * np.vstack([np.zeros(3), np.eye(3)]), np.full(4, 1.0 / 24.0))
    region = fem.RegionTetra(mesh) if kind == "tetra" else fem.RegionQuadraticTetra(mesh, quadrature=rule)
    return fem.FieldContainer([fem.Field(region, dim=3)])


def _assembler(nodes, elements):
    field = _field(nodes, elements)
    solid = fem.SolidBody(fem.NeoHookeCompressible(mu=MU, lmbda=LAMBDA), field)

    def assemble(x):
        field[0].values[:] = x - nodes
        force = solid.assemble.vector(field).toarray().reshape(-1, 3)
        return force, solid.assemble.matrix(field).tocsr()

    return assemble


def test_displacements_of_a_block_between_moved_ends(block):
    field = _field(block.nodes, block.elements)
    solid = fem.SolidBody(fem.NeoHookeCompressible(mu=MU, lmbda=LAMBDA), field)
    moves = block.found - block.nodes
    boundaries = {"all": fem.Boundary(field[0], mask=np.isin(np.arange(len(block.nodes)), block.fixed))}
    held, free = fem.dof.partition(field, boundaries)
    # From our answer bent away by a millimetre, so that FElupe's own Newton has to find it.
    start = moves + np.random.default_rng(0).uniform(-0.2, 0.2, moves.shape)
    start[block.fixed] = moves[block.fixed]
    field[0].values[:] = start
    outside = moves.ravel()[held]
    fem.newtonraphson(field, items=[solid], dof0=held, dof1=free, ext0=outside, tol=1e-10, verbose=0)
    error = np.abs(field[0].values - moves).max() / np.abs(moves).max()
    assert np.abs(start - moves).max() > 0.15
    assert error < RELATIVE


def test_forces_agree_in_a_state_out_of_balance(block):
    x = block.found + np.random.default_rng(1).uniform(-0.2, 0.2, block.nodes.shape)
    force, _ = _assembler(block.nodes, block.elements)(x)
    from spinestiff.anatomy.torso import TissueMesh
    from spinestiff.mechanics.tissue import element_data, element_gradients

    count = len(block.elements)
    mesh = TissueMesh(block.nodes, block.elements, np.full(len(x), -1), np.full(count, MU), np.full(count, LAMBDA))
    data = element_data(mesh)
    parts = element_gradients(x, data.elements, data.gradients, data.weights)
    ours = np.zeros_like(x)
    np.add.at(ours, data.elements, MU * parts[:, 0] + LAMBDA * parts[:, 1])
    assert ours == pytest.approx(force, abs=1e-12 * np.abs(force).max())


def test_a_bone_in_tissue(bone_block, reduced):
    b = bone_block
    x, place, turn = reduced(b, _assembler(b.block.nodes, b.block.elements)).solve()
    moves = b.block.found - b.block.nodes
    assert np.abs(b.turn - np.eye(3)).max() > 0.1
    assert np.abs(x - b.block.found).max() < RELATIVE * np.abs(moves).max()
    assert place == pytest.approx(b.place, abs=RELATIVE * np.abs(moves).max())
    assert turn == pytest.approx(b.turn, abs=RELATIVE)
