"""Points that ride on the tissue: each on a face of its boundary, carried by that face's nodes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp

from spinestiff.anatomy.state import TorsoState
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.arrays import Floats, Ints, ShortRepr, read_only
from spinestiff.errors import TorsoError


@dataclass(frozen=True, repr=False)
class PointsOnTissue(ShortRepr):
    """Points fixed to the tissue of a torso.

    Attributes
    ----------
    nodes : (P, K) numbers of tissue nodes, K of a point.
    shares : (P, K) of each node in the point's place; those of a point add up to 1.

    Raises
    ------
    TorsoError : wrong shapes, or shares that do not add up to 1.
    """

    nodes: Ints
    shares: Floats

    def __post_init__(self) -> None:
        nodes = read_only("nodes of points", self.nodes, (None, None), TorsoError, np.int64)
        object.__setattr__(self, "nodes", nodes)
        object.__setattr__(self, "shares", read_only("shares of points", self.shares, nodes.shape, TorsoError))
        if np.abs(self.shares.sum(1) - 1.0).max(initial=0.0) > 1e-9:
            raise TorsoError("the shares of a point's nodes do not add up to 1")

    def __len__(self) -> int:
        return len(self.nodes)

    def __getitem__(self, which: Any) -> PointsOnTissue:
        return PointsOnTissue(self.nodes[which], self.shares[which])

    def positions(self, torso: TorsoModel, state: TorsoState) -> Floats:
        """World positions, (P, 3) mm."""
        return np.asarray(np.einsum("pk,pki->pi", self.shares, torso.node_positions(state)[self.nodes]))

    def jacobian(self, torso: TorsoModel, state: TorsoState) -> sp.csr_array:
        """(3 P, dofs), derivative of the positions, point by point, in a change of state (``anatomy.state.retract``).

        A free node moves by itself, one that is tied to a bone with the bone.
        """
        bones = len(state.bone_positions)
        used = np.unique(self.nodes)
        bone = torso.tissue.bone_of_node
        tied, free = used[bone[used] >= 0], used[bone[used] < 0]
        number = np.cumsum(bone >= 0) - 1
        carried = torso.tied_nodes[number[tied]]
        columns = 6 * carried.bone[:, None] + np.arange(6)
        own = 6 * bones + 3 * np.searchsorted(torso.tissue.free_nodes, free)[:, None] + np.arange(3)
        rows = 3 * np.searchsorted(used, tied)[:, None] + np.arange(3)
        count = 3 * len(used)
        of_bones = sp.csr_array(
            (
                carried.jacobian(state).ravel(),
                (np.repeat(rows, 6, axis=1).ravel(), np.repeat(columns, 3, axis=0).ravel()),
            ),
            shape=(count, state.dofs),
        )
        rows = 3 * np.searchsorted(used, free)[:, None] + np.arange(3)
        of_nodes = sp.csr_array((np.ones(own.size), (rows.ravel(), own.ravel())), shape=(count, state.dofs))
        point = np.repeat(3 * np.arange(len(self)), self.nodes.shape[1])
        node = 3 * np.searchsorted(used, self.nodes).ravel()
        mixing = sp.csr_array(
            (
                np.tile(self.shares.ravel(), 3),
                (np.concatenate([point + i for i in range(3)]), np.concatenate([node + i for i in range(3)])),
            ),
            shape=(3 * len(self), count),
        )
        return sp.csr_array(mixing @ (of_bones + of_nodes))


def face_functions(share: Floats, nodes: int) -> tuple[Floats, Floats]:
    """Shape functions of a face.

    Parameters
    ----------
    share : (P, 3) of the face's corners in each point.
    nodes : of a face, 3 or 6 (``TissueMesh.boundary_faces``).

    Returns
    -------
    (P, nodes) values, and (P, 2, nodes) derivatives along the second and the third share.
    """
    step = np.array([[-1.0, 1.0, 0.0], [-1.0, 0.0, 1.0]])
    if nodes == 3:
        return share, np.broadcast_to(step, (len(share), 2, 3))
    edges = ([0, 1, 2], [1, 2, 0])
    value = np.hstack([share * (2.0 * share - 1.0), 4.0 * share[:, edges[0]] * share[:, edges[1]]])
    corner = (4.0 * share - 1.0)[:, None] * step
    middle = 4.0 * (step[:, edges[0]] * share[:, None, edges[1]] + step[:, edges[1]] * share[:, None, edges[0]])
    return value, np.concatenate([corner, middle], axis=2)
