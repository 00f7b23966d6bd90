"""Build the template torsos that ship with the package (a run of the package only reads them).

    python tools/build_torso.py [--mesh coarse fine own] [--out src/spinestiff/anatomy/data]

"own", the synthetic subjects', is made by another program from other points (anatomy/meshing.py; needs the extra
[mesh]) and is not symmetric, so that it shares nothing with the estimator's two. Deterministic: fixed seeds, so that
the same versions of NumPy, SciPy and MMG write the same files.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from tissue_mesh import Spacing, half_mesh, mirror, quadratic

from spinestiff.anatomy.files import write_torso
from spinestiff.anatomy.meshing import mesh_tissue
from spinestiff.anatomy.names import BONES
from spinestiff.anatomy.template import OWN_MESH
from spinestiff.anatomy.template.assemble import Skeleton, assemble, build_skeleton
from spinestiff.anatomy.tetrahedra import dihedral_angles
from spinestiff.anatomy.torso import TorsoModel

SPACINGS = {
    "coarse": Spacing(bone=64.0, skin=54.0, inside=39.0, outwards=3.5),
    "fine": Spacing(bone=31.0, skin=29.0, inside=24.5, outwards=1.2),
}
# Nodes this close to a bone ride on it, as a share of the spacing inside. The last nodes in a bone lie under its
# surface, so that those alone make bones too thin, in proportion to the spacing; with this share meshes of 3,000 to
# 64,000 nodes move alike to about 3 % (benchmarks/mesh_convergence.py).
NEAR = 0.11
SEED = 20260101
# Of the synthetic subjects' mesh: mm between corners inside, triangles of the skin (rows, sides), seed of its points.
OWN_SPACING, OWN_SKIN, OWN_SEED = 22.0, (100, 120), 20260103
DATA = Path(__file__).parent.parent / "src" / "spinestiff" / "anatomy" / "data"


def family_spacing(inside: float) -> Spacing:
    """The fine mesh's distances in proportion, for a family of meshes: ``inside`` mm between points inside."""
    share = inside / SPACINGS["fine"].inside
    bone, skin = (share * length for length in (SPACINGS["fine"].bone, SPACINGS["fine"].skin))
    return Spacing(bone, skin, inside, SPACINGS["fine"].outwards * share**2)


def build(skeleton: Skeleton, spacing: Spacing, near: float = NEAR) -> TorsoModel:
    """One torso; nodes within ``near`` times the spacing inside of a bone are tied to it."""
    half = half_mesh(skeleton, spacing, SEED)
    nodes, elements, bones = quadratic(*mirror(half), skeleton, near * spacing.inside)
    return assemble(skeleton, nodes, elements, bones)


def build_own(skeleton: Skeleton) -> TorsoModel:
    """The synthetic subjects' torso."""
    surfaces = dict(zip(BONES, skeleton.surfaces, strict=True))
    made = mesh_tissue(surfaces, skeleton.skin.surface(*OWN_SKIN), OWN_SPACING, tried_shares=(1.0,), seed=OWN_SEED)
    return assemble(skeleton, made.nodes, made.elements, made.bone_of_node)


def report(torso: TorsoModel) -> str:
    """Figures of a mesh in a few lines."""
    tissue = torso.tissue
    angle = dihedral_angles(tissue.rest_positions[tissue.elements[:, :4]]).min(1)
    tied = np.bincount(tissue.bone_of_node[tissue.bone_of_node >= 0], minlength=len(torso.bone_names))
    fewest = torso.bone_names[int(np.argmin(tied))]
    return (
        f"{len(tissue.rest_positions)} nodes ({len(tissue.free_nodes)} free), {len(tissue.elements)} elements, "
        f"{tissue.corner_volumes().sum() * 1e-6:.2f} l; smallest dihedral {angle.min():.1f} deg, "
        f"{(angle < 10).sum()} elements below 10; tied nodes a bone {tied.min()} ({fewest}) to {tied.max()}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    meshes = (*SPACINGS, OWN_MESH)
    parser.add_argument("--mesh", nargs="+", choices=meshes, default=meshes)
    parser.add_argument("--out", type=Path, default=DATA)
    arguments = parser.parse_args()
    skeleton = build_skeleton()
    arguments.out.mkdir(parents=True, exist_ok=True)
    for mesh in arguments.mesh:
        torso = build_own(skeleton) if mesh == OWN_MESH else build(skeleton, SPACINGS[mesh])
        path = arguments.out / f"torso_{mesh}.npz"
        write_torso(path, torso)
        print(f"{path.name}: {path.stat().st_size / 1e6:.2f} MB; {report(torso)}")


if __name__ == "__main__":
    main()
