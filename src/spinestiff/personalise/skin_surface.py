"""The skin of a torso as points on it: where they lie, which way they face, and how its corners move them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.spatial import cKDTree

from spinestiff.anatomy.tissue_points import PointsOnTissue, face_functions
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.arrays import Floats, Ints, ShortRepr

STEP_MM = 14.0
# Floor and lid close the tissue where the trunk was cut: they face along the body, near its ends.
END_FACING, END_SHARE = 0.9, 0.06
# Points of the skin from which the nearest place is looked for, and rounds of that.
CANDIDATES, ROUNDS = 8, 12


@dataclass(frozen=True, repr=False)
class SkinSurface(ShortRepr):
    """Points spread over the boundary of the tissue, P of them on the S faces.

    Attributes
    ----------
    faces : (S, 3) node numbers of the corners.
    face : (P,) the face of each point.
    share : (P, 3) share of the face's corners in it: the point moves by theirs, weighted so.
    points : (P, 3) mm.
    tangents : (P, 2, 3) mm, derivatives of the place along the second and the third share.
    area : (P,) mm2 that a point stands for.
    ends : (P,) bool, on the floor or the lid, where the tissue ends but the body doesn't.
    """

    faces: Ints
    face: Ints
    share: Floats
    points: Floats
    tangents: Floats
    area: Floats
    ends: np.ndarray

    @cached_property
    def tree(self) -> cKDTree:
        """The points, to be searched."""
        return cKDTree(self.points)

    @cached_property
    def normals(self) -> Floats:
        """(P, 3) unit, outward."""
        normal = np.cross(self.tangents[:, 0], self.tangents[:, 1])
        return np.asarray(normal / np.linalg.norm(normal, axis=1, keepdims=True))

    def moved(self, shift: Floats) -> SkinSurface:
        """The points after the faces' corners moved by ``shift`` (S, 3, 3) mm."""
        mine = shift[self.face]
        points = self.points + np.einsum("pk,pki->pi", self.share, mine)
        return replace(self, points=points, tangents=self.tangents + mine[:, 1:] - mine[:, :1])

    @property
    def corners(self) -> tuple[Ints, Floats]:
        """Nodes (K,) that are corners on skin, and the direction (K, 3) in which each may move: outward, and level for
        those on the rim of floor or lid."""
        skin = ~self.ends
        nodes = self.faces[self.face[skin]]
        every = np.unique(nodes)
        direction = np.zeros((len(every), 3))
        weight = self.area[skin, None] * self.share[skin]
        np.add.at(direction, np.searchsorted(every, nodes), weight[:, :, None] * self.normals[skin][:, None, :])
        direction[np.isin(every, self.faces[self.face[self.ends]]), 1] = 0.0
        return every, direction / np.linalg.norm(direction, axis=1, keepdims=True)


def tissue_points(torso: TorsoModel, skin: SkinSurface, which: Ints) -> PointsOnTissue:
    """Some of the points (numbers) of a torso's skin, as what rides on its tissue."""
    nodes = torso.tissue.boundary_faces()[skin.face[which]]
    return PointsOnTissue(nodes, face_functions(skin.share[which], nodes.shape[1])[0])


def nearest_points(torso: TorsoModel, skin: SkinSurface, wanted: Floats) -> tuple[PointsOnTissue, Floats]:
    """What of a torso's skin at rest, floor and lid left out, lies nearest to ``wanted`` (M, 3) mm, and its outward
    direction (M, 3)."""
    there = np.flatnonzero(~skin.ends)
    boundary = torso.tissue.boundary_faces()
    near = there[cKDTree(skin.points[there]).query(wanted, k=min(CANDIDATES, len(there)))[1]].reshape(len(wanted), -1)
    nodes = boundary[skin.face[near]]
    corners = torso.tissue.rest_positions[nodes]
    share = skin.share[near]
    best, distance = share[:, 0].copy(), np.full(len(wanted), np.inf)
    face = near[:, 0].copy()
    rows = np.arange(len(wanted))
    for _ in range(ROUNDS):
        value, slope = (part.reshape(*share.shape[:2], *part.shape[1:]) for part in _functions(share, nodes))
        tangents = np.einsum("mncf,mnfi->mnci", slope, corners)
        off = wanted[:, None] - np.einsum("mnf,mnfi->mni", value, corners)
        apart = np.linalg.norm(off, axis=2)
        which = np.argmin(apart, axis=1)
        nearer = apart[rows, which] < distance
        best[nearer], distance[nearer] = share[rows, which][nearer], apart[rows, which][nearer]
        face[nearer] = near[rows, which][nearer]
        inner = _nearest_inside(tangents, off, share[..., 1:])
        share = np.concatenate([1.0 - inner.sum(2, keepdims=True), inner], axis=2)
    nodes = boundary[skin.face[face]]
    value, slope = face_functions(best, nodes.shape[1])
    tangents = np.einsum("mcf,mfi->mci", slope, torso.tissue.rest_positions[nodes])
    normal = np.cross(tangents[:, 0], tangents[:, 1])
    return PointsOnTissue(nodes, value), normal / np.linalg.norm(normal, axis=1, keepdims=True)


def _nearest_inside(tangents: Floats, off: Floats, share: Floats) -> Floats:
    """(..., 2) second and third share of the place nearest to what lies ``off`` (..., 3) from that of ``share``,
    on a triangle that is flat along its ``tangents`` (..., 2, 3)."""
    gram = np.einsum("...ci,...di->...cd", tangents, tangents)
    free = share + np.linalg.solve(gram, np.einsum("...ci,...i->...c", tangents, off)[..., None])[..., 0]
    outside = (free < 0.0).any(-1) | (free.sum(-1) > 1.0)
    found, least = free, np.where(outside, np.inf, 0.0)
    for start, end in (((0.0, 0.0), (1.0, 0.0)), ((0.0, 0.0), (0.0, 1.0)), ((1.0, 0.0), (0.0, 1.0))):
        way = np.subtract(end, start)
        along = np.einsum("c,...ci->...i", way, tangents)
        left = off - np.einsum("...c,...ci->...i", np.array(start) - share, tangents)
        part = np.clip(np.sum(along * left, -1) / np.sum(along**2, -1), 0.0, 1.0)[..., None]
        apart = np.linalg.norm(left - part * along, axis=-1)
        nearer = apart < least
        least = np.where(nearer, apart, least)
        found = np.where(nearer[..., None], np.array(start) + part * way, found)
    return np.asarray(found)


def _functions(share: Floats, nodes: Ints) -> tuple[Floats, Floats]:
    return face_functions(share.reshape(-1, 3), nodes.shape[-1])


def skin_surface(torso: TorsoModel, step: float = STEP_MM) -> SkinSurface:
    """The skin of a torso at rest, as points about ``step`` mm apart."""
    boundary = torso.tissue.boundary_faces()
    nodes = torso.tissue.rest_positions[boundary]
    longest = np.linalg.norm(nodes[:, :3] - np.roll(nodes[:, :3], 1, axis=1), axis=2).max(1)
    parts = np.maximum(1, np.ceil(longest / step)).astype(int)
    face, share = [], []
    for k in np.unique(parts):
        # Middles of the k * k small triangles a face is cut into: each stands for the same area.
        i, j = np.nonzero(np.add.outer(np.arange(k), np.arange(k)) < k)
        upright = np.stack([i + 1 / 3, j + 1 / 3], -1)
        turned = np.stack([i + 2 / 3, j + 2 / 3], -1)[i + j < k - 1]
        at = np.vstack([upright, turned]) / k
        mine = np.flatnonzero(parts == k)
        face.append(np.repeat(mine, len(at)))
        share.append(np.tile(np.column_stack([1.0 - at.sum(1), at]), (len(mine), 1)))
    number, weight = np.concatenate(face), np.vstack(share)
    value, slope = face_functions(weight, nodes.shape[1])
    points = np.einsum("pk,pki->pi", value, nodes[number])
    tangents = np.einsum("pck,pki->pci", slope, nodes[number])
    length = np.linalg.norm(np.cross(tangents[:, 0], tangents[:, 1]), axis=1)
    low, high = points[:, 1].min(), points[:, 1].max()
    band = END_SHARE * (high - low)
    level = nodes[:, :3, 1]
    flat = np.cross(nodes[:, 1] - nodes[:, 0], nodes[:, 2] - nodes[:, 0])
    upward = flat[:, 1] / np.linalg.norm(flat, axis=1)
    lid = (upward > END_FACING) & (level.min(1) > high - band)
    floor = (upward < -END_FACING) & (level.max(1) < low + band)
    area = 0.5 * length / np.bincount(number)[number]
    return SkinSurface(boundary[:, :3], number, weight, points, tangents, area, (lid | floor)[number])
