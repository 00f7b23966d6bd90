"""Reference deflections of nearly incompressible cantilevers, by another program and another formulation.

``python benchmarks/cantilever_reference.py [--cells 2 3 4 5]`` in an environment of its own with scikit-fem (12.0)
prints the end deflection over the force, mm/N, on meshes that are refined. Linear elasticity, displacement and pressure
as two fields (27-node hexahedra, trilinear pressure: inf-sup stable at any Poisson's ratio), where the package has
displacements alone on ten-node tetrahedra.

A bar of 10 x 10 x 50 mm, E = 1 MPa; the end at z = 0 is held, a rigid plate on the end at z = 50 carries 1 N along y.
tests/mechanics/test_cantilever.py holds the package to these numbers.
"""

from __future__ import annotations

import argparse

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as spla
from skfem import Basis, BilinearForm, ElementHex1, ElementHex2, ElementVector, MeshHex, asm
from skfem.helpers import ddot, div, sym_grad

POISSON = (0.45, 0.49, 0.4995)
SIDE, LENGTH, YOUNG = 10.0, 50.0, 1.0


def deflection(cells: int, poisson: float) -> float:
    """End deflection over the force, mm/N, with ``cells`` elements over a side and five times as many along the bar."""
    side = np.linspace(0.0, SIDE, cells + 1)
    mesh = MeshHex.init_tensor(side, side, np.linspace(0.0, LENGTH, 5 * cells + 1))
    moves = Basis(mesh, ElementVector(ElementHex2()), intorder=5)
    pressures = Basis(mesh, ElementHex1(), intorder=5)
    mu = YOUNG / (2.0 * (1.0 + poisson))
    lame = YOUNG * poisson / ((1.0 + poisson) * (1.0 - 2.0 * poisson))
    shear = asm(BilinearForm(lambda u, v, w: 2.0 * mu * ddot(sym_grad(u), sym_grad(v))), moves)
    couple = asm(BilinearForm(lambda u, q, w: div(u) * q), moves, pressures)
    mass = asm(BilinearForm(lambda p, q, w: p * q / lame), pressures)
    places, component = moves.doflocs, np.zeros(moves.N, dtype=int)
    for dofs in (moves.nodal_dofs, moves.edge_dofs, moves.facet_dofs, moves.interior_dofs):
        component[dofs] = np.arange(3)[:, None]
    plate, root = places[2] > LENGTH - 1e-9, places[2] < 1e-9
    free = np.flatnonzero(~plate & ~root)
    arm = places[:, plate] - np.array([[0.5 * SIDE], [0.5 * SIDE], [LENGTH]])
    rigid = np.zeros((plate.sum(), 6))
    for row, axis in enumerate(component[plate]):
        rigid[row, axis] = 1.0
        rigid[row, 3:] = np.cross(np.eye(3), arm[:, row])[:, axis]
    columns = len(free) + 6
    motion = sp.lil_array((moves.N, columns))
    motion[free, np.arange(len(free))] = 1.0
    motion[np.flatnonzero(plate), len(free) :] = rigid
    motion = motion.tocsr()
    k, b = motion.T @ shear @ motion, couple @ motion
    system = sp.block_array([[k, b.T], [b, -mass]], format="csc")
    force = np.zeros(system.shape[0])
    force[len(free) + 1] = 1.0
    return float(spla.spsolve(system, force)[len(free) + 1])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cells", type=int, nargs="+", default=[2, 3, 4, 5])
    arguments = parser.parse_args()
    for poisson in POISSON:
        found = [deflection(cells, poisson) for cells in arguments.cells]
        print(f"nu = {poisson}:", " ".join(f"{cells}: {value:.6f}" for cells, value in zip(arguments.cells, found)))


if __name__ == "__main__":
    main()
