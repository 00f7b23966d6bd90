"""A bench phantom as a torso: a column of equal blocks on leaf springs over a base, in a block of rubber or bare.

World axes as a patient's: x to the phantom's left, y from the base to the top, z to its front. Blocks have the names
of vertebrae, top to bottom, and the base is the pelvis. The marks of a block lie in one plane on its front.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from spinestiff.anatomy.grid_mesh import grid_mesh, quadratic
from spinestiff.anatomy.state import TorsoState
from spinestiff.anatomy.stiffness import lame_parameters
from spinestiff.anatomy.torso import JointTable, TissueMesh, TorsoModel, joint_frames
from spinestiff.arrays import Floats, Ints, ShortRepr
from spinestiff.errors import TorsoError

# A leaf spring of rectangular section, k = E b t^3 / (12 L), held in two blocks at L from each other. Turned to the
# side about its middle it has k; in shear, 12 k / L^2; in torsion G b t^3 / (3 L) = 2 k / (1 + nu), nu = 0.3.
TORSION_OVER_BENDING = 2.0 / 1.3
# In its plane a leaf turns a thousand times as stiffly as across; in it and along the column it gives by 1000 k / L^2,
# 83 times as stiffly as across: no picture shows any of that.
IN_PLANE_OVER_BENDING = 1e3
# Nodes of a mesh that is still solved by one factorisation in a minute or two.
MOST_NODES = 60_000
KIND = "lumbar"  # of the joints, so that the parameters of intervertebral joints are theirs


@dataclass(frozen=True)
class RubberBlock:
    """What a column is cast in, from the base to the top of the uppermost block; gaps between blocks stay empty.

    Attributes
    ----------
    width_mm, depth_mm : side to side, front to rear; the column stands in the middle.
    young_mpa, poisson : of the material.
    spacing_mm : largest distance of the mesh's grid lines.
    """

    width_mm: float
    depth_mm: float
    young_mpa: float
    poisson: float = 0.49
    spacing_mm: float = 14.0


@dataclass(frozen=True, repr=False)
class Column(ShortRepr):
    """A column of blocks.

    Attributes
    ----------
    levels : names of the blocks, top to bottom.
    block_mm : (3,) width, height and depth of a block.
    gap_mm : between two blocks, and between the lowest one and the base: the leaf springs' free length.
    marks_mm : (2,) distance between the marks of a block, side to side and along the column.
    marks_front_mm : of the marks' plane before the column's middle.
    stiffness : (n,) N mm/rad of each block's joint to what is below it.
    rubber : what it is cast in, or None.

    Raises
    ------
    TorsoError : fewer than three blocks, sizes or stiffnesses not above 0, marks wider than their block, or rubber
        that does not hold the blocks.
    """

    levels: tuple[str, ...]
    block_mm: tuple[float, float, float]
    gap_mm: float
    marks_mm: tuple[float, float]
    marks_front_mm: float
    stiffness: tuple[float, ...]
    rubber: RubberBlock | None = None

    def __post_init__(self) -> None:
        if len(self.levels) < 3:
            raise TorsoError(f"a column of {len(self.levels)} blocks; wanted at least 3")
        if len(self.stiffness) != len(self.levels):
            raise TorsoError(f"{len(self.levels)} blocks but {len(self.stiffness)} joints; wanted one below each block")
        if not all(value > 0.0 for value in (*self.block_mm, self.gap_mm, *self.marks_mm, *self.stiffness)):
            raise TorsoError("a size or a stiffness of the column is not above 0")
        for mark, block, what in zip(self.marks_mm, self.block_mm, ("width", "height")):
            if mark > block:
                raise TorsoError(f"marks {mark:g} mm apart on blocks of {block:g} mm {what}; wanted at most that")
        if self.rubber is not None:
            if not self.rubber.spacing_mm > 0.0:
                raise TorsoError(f"grid lines {self.rubber.spacing_mm:g} mm apart in the rubber; wanted more than 0")
            for own, block, what in zip(
                (self.rubber.width_mm, self.rubber.depth_mm), (self.block_mm[0], self.block_mm[2]), ("width", "depth")
            ):
                if not own > block:
                    raise TorsoError(f"rubber of {own:g} mm {what} round blocks of {block:g} mm; wanted more")

    @property
    def lower_faces(self) -> Floats:
        """(n,) mm above the base, top to bottom."""
        pitch = self.block_mm[1] + self.gap_mm
        return np.asarray(self.gap_mm + pitch * np.arange(len(self.levels))[::-1], dtype=float)

    @property
    def centres(self) -> Floats:
        """(n, 3) mm, the middles of the blocks."""
        places = np.zeros((len(self.levels), 3))
        places[:, 1] = self.lower_faces + 0.5 * self.block_mm[1]
        return places


def phantom_torso(column: Column) -> TorsoModel:
    """The column at rest, free of stress. Raises TorsoError for rubber whose mesh would be too large."""
    n = len(column.levels)
    positions = np.vstack([column.centres, np.zeros(3)])
    mesh, bone_of_node = _rubber(column)
    rest = TorsoState(positions, np.broadcast_to(np.eye(3), (n + 1, 3, 3)), mesh[0][bone_of_node < 0])
    child, parent = np.arange(n), np.arange(1, n + 1)
    middles = np.zeros((n, 3))
    middles[:, 1] = column.lower_faces - 0.5 * column.gap_mm
    bending = np.array(column.stiffness)
    shear, along = 12.0 * bending / column.gap_mm**2, IN_PLANE_OVER_BENDING * bending / column.gap_mm**2
    turning = (IN_PLANE_OVER_BENDING * bending, TORSION_OVER_BENDING * bending, bending)
    below = (*column.levels[1:], "pelvis")
    mu, lambda_ = lame_parameters(column.rubber.young_mpa, column.rubber.poisson) if column.rubber else (0.0, 0.0)
    elements = len(mesh[1])
    return TorsoModel(
        bone_names=(*column.levels, "pelvis"),
        rest_pose=rest,
        joints=JointTable(
            tuple(f"{lower}-{upper}" for lower, upper in zip(below, column.levels)),
            (KIND,) * n,
            parent,
            child,
            stiffness=np.column_stack([shear, along, along, *turning]),
            **joint_frames(rest, parent, child, middles, np.broadcast_to(np.eye(3), (n, 3, 3))),
        ),
        tissue=TissueMesh(*mesh, bone_of_node, np.full(elements, mu), np.full(elements, lambda_)),
        vertebra_boxes=np.broadcast_to(_marks(column), (n, 8, 3)),
        bone_surfaces=(),
        landmarks={},
        height_cm=0.1 * float(column.lower_faces[0] + column.block_mm[1]),
        vertebrae=column.levels,
    )


def _marks(column: Column) -> Floats:
    """(8, 3) mm, [superior, inferior] x [left, right] x [anterior, posterior]: a box without depth."""
    width, height = column.marks_mm
    corners = [
        (0.5 * side * width, 0.5 * level * height, column.marks_front_mm)
        for level in (1, -1)
        for side in (1, -1)
        for _ in range(2)
    ]
    return np.array(corners)


def _rubber(column: Column) -> tuple[tuple[Floats, Ints], Ints]:
    """Nodes and elements of the rubber, and the bone of each node; nothing without rubber."""
    rubber = column.rubber
    if rubber is None:
        return (np.empty((0, 3)), np.empty((0, 10), np.int64)), np.empty(0, np.int64)
    width, height, depth = column.block_mm
    faces = np.unique(np.concatenate([[0.0], column.lower_faces, column.lower_faces + height]))
    x = _lines(np.array([-rubber.width_mm, -width, width, rubber.width_mm]) / 2.0, rubber.spacing_mm)
    y = _lines(faces, rubber.spacing_mm)
    z = _lines(np.array([-rubber.depth_mm, -depth, depth, rubber.depth_mm]) / 2.0, rubber.spacing_mm)
    count = 8 * len(x) * len(y) * len(z)
    if count > MOST_NODES:
        raise TorsoError(
            f"rubber with grid lines {rubber.spacing_mm:g} mm apart takes about {count} nodes; wanted at most "
            f"{MOST_NODES}, so raise spacing_mm"
        )
    middle = [0.5 * (lines[1:] + lines[:-1]) for lines in (x, y, z)]
    within = (np.abs(middle[0]) < 0.5 * width)[:, None, None] & (np.abs(middle[2]) < 0.5 * depth)[None, None, :]
    # Blocks are stiff and gaps are empty: no rubber in either.
    inner = np.broadcast_to(within, (len(middle[0]), len(middle[1]), len(middle[2])))
    mesh = quadratic(*grid_mesh(x, y, z, inner))
    nodes = mesh[0]
    bone_of_node = np.full(len(nodes), -1)
    bone_of_node[nodes[:, 1] < 1e-9] = len(column.levels)
    inside = (np.abs(nodes[:, 0]) < 0.5 * width + 1e-9) & (np.abs(nodes[:, 2]) < 0.5 * depth + 1e-9)
    for bone, low in enumerate(column.lower_faces):
        bone_of_node[inside & (nodes[:, 1] > low - 1e-9) & (nodes[:, 1] < low + height + 1e-9)] = bone
    return mesh, bone_of_node


def _lines(through: Floats, spacing: float) -> Floats:
    """Grid lines at ``through`` and evenly between, at most ``spacing`` apart."""
    parts = [np.linspace(a, b, max(2, int(np.ceil((b - a) / spacing)) + 1))[:-1] for a, b in zip(through, through[1:])]
    return np.append(np.concatenate(parts), through[-1])
