"""Breadths and depths of the trunk by tape or caliper: the skin moved to them, the tissue under it carried along."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from spinestiff.anatomy.torso import TorsoModel
from spinestiff.arrays import Floats, Ints
from spinestiff.errors import TorsoError
from spinestiff.personalise.quality import mesh_quality
from spinestiff.personalise.sizes import spread

# A trunk that differs more from the carried one is a mistake, or another person's.
FACTOR_LIMITS = (0.75, 1.35)
# mm beyond the measured levels over which the skin goes back to the carried one.
FADE_MM = 150.0
# mm off the measures at which the skin counts as there, and rounds of stretching until then: where the tissue does not
# bear the skin that all of them lead to, what fewer lead to is taken, which is farther off.
MISS_MM = 0.5
ROUNDS = (30, 10, 4)


@dataclass(frozen=True)
class TrunkSize:
    """Horizontal extents of the skin at a level, mm: side to side and front to back.

    Raises
    ------
    TorsoError : not above 0.
    """

    breadth_mm: float
    depth_mm: float

    def __post_init__(self) -> None:
        if not (self.breadth_mm > 0.0 and self.depth_mm > 0.0):
            raise TorsoError(f"trunk of {self.breadth_mm:g} by {self.depth_mm:g} mm; wanted both above 0")


def trunk_sizes(torso: TorsoModel, levels: tuple[str, ...]) -> tuple[dict[str, TrunkSize], Floats]:
    """The torso's own extents at the heights of bones at rest, and the middles (n, 2) mm of the sections in x and z.

    Raises
    ------
    TorsoError : unknown bone, or no skin at its height.
    """
    return _extents(torso.tissue.rest_positions, torso.tissue.boundary_faces()[:, :3], _heights(torso, levels))


def with_trunk_sizes(torso: TorsoModel, wanted: Mapping[str, TrunkSize]) -> TorsoModel:
    """The torso with its skin at the ``wanted`` extents, at the heights of the bones they are named by.

    Between levels factors go over linearly in height, beyond them they fade to 1. Bones stay where they are; free
    tissue between them and the skin follows harmonically. The skin comes as near to the extents as the mesh bears while
    its quality is good, to within 0.5 mm if it can; ``trunk_misses`` says how near.

    Raises
    ------
    TorsoError : an extent below 0.75 or above 1.35 of the carried skin's, or tissue that is squeezed inside out.
    """
    if not wanted:
        return torso
    mesh = torso.tissue
    faces = mesh.boundary_faces()
    skin = np.unique(faces)
    skin = skin[mesh.bone_of_node[skin] < 0]
    found, reason = None, ""
    for rounds in ROUNDS:
        points = skin_at_sizes(torso, mesh.rest_positions, faces[:, :3], wanted, rounds)
        moved = np.zeros_like(mesh.rest_positions)
        moved[skin] = (points - mesh.rest_positions)[skin]
        try:
            found = with_moved_skin(torso, skin, moved)
        except TorsoError as error:
            reason = str(error)
            continue
        if mesh_quality(found).good:
            return found
    if found is not None:
        return found
    raise TorsoError(
        f"the skin can't come to the trunk's extents at {', '.join(wanted)}: the ribs, which they don't move, "
        f"leave no room for the tissue between ({reason}); check the measures or leave them out"
    )


def trunk_misses(torso: TorsoModel, wanted: Mapping[str, TrunkSize]) -> dict[str, tuple[TrunkSize, float]]:
    """The skin's extents at each wanted level, and by how many mm the farther off of the two misses."""
    if not wanted:
        return {}
    own, _ = trunk_sizes(torso, tuple(wanted))
    return {level: (own[level], _farthest(own, {level: size})) for level, size in wanted.items()}


def with_moved_skin(torso: TorsoModel, skin: Ints, moved: Floats) -> TorsoModel:
    """The torso with nodes ``skin`` (n,) of its tissue displaced by their rows of ``moved`` (N, 3) mm at rest.

    Bones stay where they are; free tissue between them and the skin follows harmonically.

    Raises
    ------
    TorsoError : an element is turned over.
    """
    mesh = torso.tissue
    told = mesh.bone_of_node >= 0
    told[skin] = True
    nodes = mesh.rest_positions + spread(mesh, moved, told)
    pose = replace(torso.rest_pose, tissue_positions=nodes[mesh.free_nodes])
    return replace(torso, tissue=replace(mesh, rest_positions=nodes), rest_pose=pose)


def skin_at_sizes(
    torso: TorsoModel, points: Floats, faces: Ints, wanted: Mapping[str, TrunkSize], rounds: int = ROUNDS[0]
) -> Floats:
    """(n, 3) mm, the vertices of a closed skin (points (n, 3), faces (m, 3)) around ``torso`` at the wanted extents.

    A round stretches the skin by what is lacking at the levels; levels near by share triangles and spoil each other's
    extents, so that it takes several. They end after ``rounds``, or where the skin is within 0.5 mm.

    Raises
    ------
    TorsoError : an extent below 0.75 or above 1.35 of the skin's.
    """
    levels = tuple(sorted(wanted, key=lambda name: torso.rest_pose.bone_positions[torso.bone(name), 1]))
    if not levels:
        return points
    heights = _heights(torso, levels)
    own, _ = _extents(points, faces, heights)
    low, high = FACTOR_LIMITS
    for level in levels:
        for what in ("breadth_mm", "depth_mm"):
            ratio = getattr(wanted[level], what) / getattr(own[level], what)
            if not low <= ratio <= high:
                raise TorsoError(
                    f"{what.removesuffix('_mm')} at {level} is {getattr(wanted[level], what):g} mm, {ratio:.2f} times "
                    f"the skin's ({getattr(own[level], what):.0f} mm); wanted {low} to {high} times: check the measure"
                )
    for _ in range(rounds):
        own, middles = _extents(points, faces, heights)
        if _farthest(own, wanted) < MISS_MM:
            break
        factors = [(wanted[v].breadth_mm / own[v].breadth_mm, wanted[v].depth_mm / own[v].depth_mm) for v in levels]
        points = _stretched(points, np.array(list(heights.values())), np.array(factors), middles)
    return points


def _farthest(own: Mapping[str, TrunkSize], wanted: Mapping[str, TrunkSize]) -> float:
    """mm by which an extent at a wanted level is off, at most."""
    pairs = [(own[level], size) for level, size in wanted.items()]
    return max(max(abs(a.breadth_mm - b.breadth_mm), abs(a.depth_mm - b.depth_mm)) for a, b in pairs)


def _stretched(points: Floats, heights: Floats, factors: Floats, middles: Floats) -> Floats:
    knots = np.concatenate([[heights[0] - FADE_MM], heights, [heights[-1] + FADE_MM]])
    grown = np.vstack([[0.0, 0.0], factors - 1.0, [0.0, 0.0]])
    centre = np.vstack([middles[:1], middles, middles[-1:]])
    moved = np.array(points)
    for axis, column in ((0, 0), (2, 1)):
        share, middle = (np.interp(points[:, 1], knots, values[:, column]) for values in (grown, centre))
        moved[:, axis] += share * (points[:, axis] - middle)
    return moved


def _heights(torso: TorsoModel, levels: tuple[str, ...]) -> dict[str, float]:
    return {level: float(torso.rest_pose.bone_positions[torso.bone(level), 1]) for level in levels}


def _extents(points: Floats, faces: Ints, heights: Mapping[str, float]) -> tuple[dict[str, TrunkSize], Floats]:
    found, middles = {}, []
    for level, height in heights.items():
        section = _section(points, faces, height)
        if not len(section):
            raise TorsoError(f"no skin at the height of {level}; measure between the neck and the hips")
        low, high = section.min(0), section.max(0)
        found[level] = TrunkSize(*(high - low).tolist())
        middles.append(0.5 * (low + high))
    return found, np.array(middles)


def _section(points: Floats, faces: np.ndarray, height: float) -> Floats:
    """(n, 2) mm, x and z where edges of the faces pass a height."""
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    a, b = points[edges[:, 0]], points[edges[:, 1]]
    # Ends at the very height count as above it, so that the section has corners that lie there.
    across = (a[:, 1] < height) != (b[:, 1] < height)
    a, b = a[across], b[across]
    share = ((height - a[:, 1]) / (b[:, 1] - a[:, 1]))[:, None]
    return np.asarray((a + share * (b - a))[:, [0, 2]])
