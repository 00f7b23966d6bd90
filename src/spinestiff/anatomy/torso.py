"""The torso: bones, joints and tissue at rest (paper 3.1).

Units: mm, N, MPa, rad. World frame, right-handed: x to the patient's left, y superior, z anterior.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any, ClassVar

import numpy as np

from spinestiff.anatomy.names import VERTEBRAE
from spinestiff.anatomy.points import PointsOnBones
from spinestiff.anatomy.rotation import mean_rotation
from spinestiff.anatomy.state import TorsoState
from spinestiff.arrays import ByFields, Floats, Ints, ShortRepr, read_only
from spinestiff.errors import TorsoError

# Node order of a ten-node tetrahedron: four corners, then the middles of these edges (VTK's and meshio's order).
TET10_EDGES = ((0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3))


@dataclass(frozen=True, repr=False)
class JointTable(ByFields, ShortRepr):
    """Compliant joints; each has a frame on its parent and one on its child that coincide at rest.

    Attributes
    ----------
    names : (J,) "parent-child".
    kinds : (J,) rows of Table 1.
    parent, child : (J,) bone indices.
    parent_position, child_position : (J, 3) mm, joint centre in the bone's frame.
    parent_axes, child_axes : (J, 3, 3) bone_from_joint rotations.
    stiffness : (J, 6) N/mm (x, y, z) and N mm/rad (alpha, beta, gamma) along the joint's axes.
    """

    names: tuple[str, ...]
    kinds: tuple[str, ...]
    parent: Ints
    child: Ints
    parent_position: Floats
    parent_axes: Floats
    child_position: Floats
    child_axes: Floats
    stiffness: Floats

    def __post_init__(self) -> None:
        n = len(self.names)
        if len(self.kinds) != n:
            raise TorsoError(f"{n} joint names but {len(self.kinds)} kinds")
        for key in ("parent", "child"):
            object.__setattr__(self, key, read_only(key, getattr(self, key), (n,), TorsoError, np.int64))
        shapes = {"position": (n, 3), "axes": (n, 3, 3)}
        for bone in ("parent", "child"):
            for key, shape in shapes.items():
                name = f"{bone}_{key}"
                object.__setattr__(self, name, read_only(name, getattr(self, name), shape, TorsoError))
            check_rotations(f"{bone}_axes of joint", getattr(self, f"{bone}_axes"), self.names)
        object.__setattr__(self, "stiffness", read_only("stiffness", self.stiffness, (n, 6), TorsoError))
        if (self.stiffness < 0.0).any():
            raise TorsoError(f"joint {self.names[int(np.argmin(self.stiffness.min(1)))]} has a negative stiffness")
        if (self.parent == self.child).any():
            raise TorsoError(f"joint {self.names[int(np.argmax(self.parent == self.child))]} joins a bone to itself")

    def __len__(self) -> int:
        return len(self.names)


@dataclass(frozen=True, repr=False)
class TissueMesh(ByFields, ShortRepr):
    """Soft tissue as tetrahedra whose nodes in or on bones are tied to them.

    Attributes
    ----------
    rest_positions : (N, 3) mm.
    elements : (T, 4) or (T, 10) node indices; ten-node order as ``TET10_EDGES``.
    bone_of_node : (N,) bone index, -1 = free.
    lame_mu, lame_lambda : (T,) MPa.
    """

    rest_positions: Floats
    elements: Ints
    bone_of_node: Ints
    lame_mu: Floats
    lame_lambda: Floats

    def __post_init__(self) -> None:
        set_ = object.__setattr__
        set_(self, "rest_positions", read_only("rest_positions", self.rest_positions, (None, 3), TorsoError))
        elements = read_only("elements", self.elements, (None, None), TorsoError, np.int64)
        if elements.shape[1] not in (4, 10):
            raise TorsoError(f"elements have {elements.shape[1]} nodes, wanted 4 or 10")
        n, t = len(self.rest_positions), len(elements)
        if t and (elements.min() < 0 or elements.max() >= n):
            strange = int(elements.min() if elements.min() < 0 else elements.max())
            raise TorsoError(f"elements name node {strange}, but the mesh has nodes 0 to {n - 1}")
        set_(self, "elements", elements)
        set_(self, "bone_of_node", read_only("bone_of_node", self.bone_of_node, (n,), TorsoError, np.int64))
        for key in ("lame_mu", "lame_lambda"):
            set_(self, key, read_only(key, getattr(self, key), (t,), TorsoError))
        if (self.lame_mu < 0.0).any():
            raise TorsoError(f"element {int(np.argmin(self.lame_mu))} has a negative shear modulus")
        volumes = self.corner_volumes()
        if t and volumes.min() <= 0.0:
            worst = int(np.argmin(volumes))
            raise TorsoError(f"element {worst} has volume {volumes[worst]:.3g} mm3; wanted positive")

    @property
    def free_nodes(self) -> Ints:
        """(F,) indices of nodes not tied to a bone."""
        return np.flatnonzero(self.bone_of_node < 0)

    @property
    def deformable(self) -> Ints:
        """(T',) elements that are not whole in one bone."""
        tied = self.bone_of_node[self.elements]
        return np.flatnonzero((tied < 0).any(1) | (tied != tied[:, :1]).any(1)) if len(tied) else np.empty(0, np.int64)

    def corner_volumes(self) -> Floats:
        """(T,) mm3, signed volume of each element's four corners."""
        p = self.rest_positions[self.elements[:, :4]]
        return np.einsum("ti,ti->t", p[:, 1] - p[:, 0], np.cross(p[:, 2] - p[:, 0], p[:, 3] - p[:, 0])) / 6.0

    def boundary_faces(self) -> Ints:
        """(S, 3) or (S, 6) nodes of the faces that belong to one element, seen from outside anticlockwise."""
        corners = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])
        local = corners
        if self.elements.shape[1] == 10:
            edge = {frozenset(e): 4 + i for i, e in enumerate(TET10_EDGES)}
            middles = [[edge[frozenset((f[i], f[(i + 1) % 3]))] for i in range(3)] for f in corners.tolist()]
            local = np.hstack([corners, middles])
        faces = self.elements[:, local].reshape(-1, local.shape[1])
        key = np.sort(faces[:, :3], axis=1)
        _, first, count = np.unique(key, axis=0, return_index=True, return_counts=True)
        return faces[np.sort(first[count == 1])]


@dataclass(frozen=True, repr=False)
class BoneSurface(ByFields, ShortRepr):
    """A closed triangle surface in its bone's frame: vertices (n, 3) mm, faces (m, 3) outward."""

    vertices: Floats
    faces: Ints

    def __post_init__(self) -> None:
        object.__setattr__(self, "vertices", read_only("vertices", self.vertices, (None, 3), TorsoError))
        object.__setattr__(self, "faces", read_only("faces", self.faces, (None, 3), TorsoError, np.int64))
        n = len(self.vertices)
        strange = self.faces[(self.faces < 0) | (self.faces >= n)]
        if len(strange):
            raise TorsoError(f"a face of a surface names vertex {strange[0]}, but there are {n}")


@dataclass(frozen=True, repr=False)
class TorsoModel(ByFields, ShortRepr):
    """A torso at rest, free of stress.

    Attributes
    ----------
    bone_names : (B,).
    rest_pose : the stress-free state.
    joints, tissue : how the bones hang together.
    vertebra_boxes : (V, 8, 3) mm in the vertebra's frame, vertebrae as ``vertebrae``; the corners are
        [superior, inferior] x [left, right] x [anterior, posterior], so that (V, 2, 2, 2, 3) is the same array.
    bone_surfaces : (B,) for drawing and rendering.
    landmarks : named points on bones: "rib_lateral" (24, order of RIBS), "wall" (points of scapulae and ribs that
        lie against a wall behind the patient), "humerus_head" (2: left, right), "pelvis_belt" (1).
    height_cm : body height.
    """

    SHOWN_BY: ClassVar[str] = "spinestiff.anatomy.picture:html_of"

    bone_names: tuple[str, ...]
    rest_pose: TorsoState
    joints: JointTable
    tissue: TissueMesh
    vertebra_boxes: Floats
    bone_surfaces: tuple[BoneSurface, ...]
    landmarks: Mapping[str, PointsOnBones]
    height_cm: float
    vertebrae: tuple[str, ...] = field(default=VERTEBRAE)

    def __post_init__(self) -> None:
        b = len(self.bone_names)
        if len(set(self.bone_names)) != b:
            raise TorsoError("bone names are not unique")
        if len(self.rest_pose.bone_positions) != b or len(self.bone_surfaces) not in (0, b):
            poses, surfaces = len(self.rest_pose.bone_positions), len(self.bone_surfaces)
            raise TorsoError(f"{b} bones, but {poses} poses, {surfaces} surfaces")
        check_rotations("rest rotation of bone", self.rest_pose.bone_rotations, self.bone_names)
        joined, tied = np.concatenate([self.joints.parent, self.joints.child]), self.tissue.bone_of_node
        marked = [("landmark", points.bone, 0) for points in self.landmarks.values()]
        for what, bones, least in (("joint", joined, 0), ("node", tied, -1), *marked):
            strange = bones[(bones < least) | (bones >= b)]
            if len(strange):
                raise TorsoError(f"a {what} names bone {strange[0]}, but there are {b}")
        for name in self.vertebrae:
            self.bone(name)
        if not 0.0 < self.height_cm < np.inf:
            raise TorsoError(f"height of {self.height_cm:g} cm; wanted a finite one above 0")
        if len(self.rest_pose.tissue_positions) != len(self.tissue.free_nodes):
            raise TorsoError("the rest pose and the tissue mesh differ in the number of free nodes")
        boxes = read_only("vertebra_boxes", self.vertebra_boxes, (len(self.vertebrae), 8, 3), TorsoError)
        object.__setattr__(self, "vertebra_boxes", boxes)
        object.__setattr__(self, "landmarks", MappingProxyType(dict(self.landmarks)))

    def bone(self, name: str) -> int:
        """Index of a bone by name; raises TorsoError for an unknown one."""
        try:
            return self.bone_names.index(name)
        except ValueError:
            raise TorsoError(f"no bone '{name}' in this torso") from None

    def landmark(self, name: str) -> PointsOnBones:
        """A landmark's points by name; raises TorsoError for one that this torso lacks."""
        try:
            return self.landmarks[name]
        except KeyError:
            known = ", ".join(self.landmarks) or "none"
            raise TorsoError(f"no landmark '{name}' in this torso; there are {known}") from None

    @property
    def vertebra_bones(self) -> Ints:
        """(V,) bone indices of the vertebrae."""
        return np.array([self.bone(name) for name in self.vertebrae], dtype=np.int64)

    def joints_among(self, bones: Iterable[str]) -> np.ndarray:
        """(J,) bool, the joints between two of the named ``bones``; e.g. those of some levels of the spine."""
        chosen = [self.bone(name) for name in bones]
        return np.isin(self.joints.parent, chosen) & np.isin(self.joints.child, chosen)

    @property
    def tied_nodes(self) -> PointsOnBones:
        """The tied tissue nodes, in the order of ``flatnonzero(bone_of_node >= 0)``."""
        tied = np.flatnonzero(self.tissue.bone_of_node >= 0)
        return PointsOnBones.at(self.rest_pose, self.tissue.bone_of_node[tied], self.tissue.rest_positions[tied])

    def node_positions(self, state: TorsoState) -> Floats:
        """(N, 3) mm, all tissue nodes in a state."""
        positions = np.empty_like(self.tissue.rest_positions)
        positions[self.tissue.bone_of_node >= 0] = self.tied_nodes.positions(state)
        positions[self.tissue.free_nodes] = state.tissue_positions
        return positions

    def surface_positions(self, state: TorsoState, bone: int) -> Floats:
        """(n, 3) mm, the vertices of a bone's surface in a state."""
        return state.bone_positions[bone] + self.bone_surfaces[bone].vertices @ state.bone_rotations[bone].T

    def rebased(self, state: TorsoState) -> TorsoModel:
        """This torso with ``state`` as its stress-free rest pose.

        Tissue takes the state's shape; each joint's centre and axes become the mean of its two frames there.

        Raises
        ------
        TorsoError : an element is inverted in ``state``.
        """
        joints, position, axes = self.joints, {}, {}
        for side, bone in (("parent", joints.parent), ("child", joints.child)):
            points = PointsOnBones(bone, getattr(joints, f"{side}_position"))
            position[side] = points.positions(state)
            axes[side] = state.bone_rotations[bone] @ getattr(joints, f"{side}_axes")
        centre = 0.5 * (position["parent"] + position["child"])
        frame = mean_rotation(axes["parent"], axes["child"])
        frames = joint_frames(state, joints.parent, joints.child, centre, frame)
        tissue = replace(self.tissue, rest_positions=self.node_positions(state))
        return replace(self, rest_pose=state, tissue=tissue, joints=replace(joints, **frames))

    def scaled(self, factor: float) -> TorsoModel:
        """This torso with all lengths times ``factor``; stiffnesses (joints and moduli) stay."""
        if not factor > 0.0:
            raise TorsoError(f"scale factor {factor}; wanted > 0")
        rest = self.rest_pose
        return replace(
            self,
            rest_pose=TorsoState(factor * rest.bone_positions, rest.bone_rotations, factor * rest.tissue_positions),
            joints=replace(
                self.joints,
                parent_position=factor * self.joints.parent_position,
                child_position=factor * self.joints.child_position,
            ),
            tissue=replace(self.tissue, rest_positions=factor * self.tissue.rest_positions),
            vertebra_boxes=factor * self.vertebra_boxes,
            bone_surfaces=tuple(BoneSurface(factor * s.vertices, s.faces) for s in self.bone_surfaces),
            landmarks={k: PointsOnBones(p.bone, factor * p.offset) for k, p in self.landmarks.items()},
            height_cm=factor * self.height_cm,
        )

    def _facts(self) -> Iterator[str]:
        yield f"{self.height_cm:.4g} cm"
        yield f"{len(self.bone_names)} bones"
        yield f"{len(self.joints)} joints"
        yield f"{len(self.tissue.rest_positions)} tissue nodes"
        yield f"{len(self.tissue.elements)} elements of {self.tissue.elements.shape[1]} nodes"


def joint_frames(state: TorsoState, parent: Ints, child: Ints, centre: Floats, axes: Floats) -> dict[str, Any]:
    """A joint table's four frame fields from world centres (J, 3) mm and world_from_joint axes (J, 3, 3)."""
    frames = {}
    for side, bone in (("parent", parent), ("child", child)):
        frames[f"{side}_position"] = PointsOnBones.at(state, bone, centre).offset
        frames[f"{side}_axes"] = np.swapaxes(state.bone_rotations[bone], -1, -2) @ axes
    return frames


def check_rotations(what: str, rotations: Floats, names: tuple[str, ...]) -> None:
    """Raise TorsoError, naming the culprit, unless all (n, 3, 3) are proper rotations."""
    error = np.abs(rotations @ np.swapaxes(rotations, -1, -2) - np.eye(3)).max(axis=(1, 2), initial=0.0)
    bad = (error > 1e-9) | (np.linalg.det(rotations) < 0.0)
    if bad.any():
        raise TorsoError(f"{what} {names[int(np.argmax(bad))]} is no right-handed rotation")
