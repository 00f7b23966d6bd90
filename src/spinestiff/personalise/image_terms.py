"""Image terms: energies that pull vertebrae to where a radiograph shows them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from spinestiff.anatomy.torso import TorsoModel, TorsoState
from spinestiff.arrays import Floats, Ints
from spinestiff.imaging.features import VertebraCorners, state_features, target_features, vertebra_rows
from spinestiff.imaging.projection import XRayView
from spinestiff.mechanics.terms import BoneBlocks


@dataclass(frozen=True)
class CornerTerm:
    """E = weight / 2 * sum |z(x) - z_hat|^2 over the features of the vertebrae seen in one view (Eq. 9).

    The Hessian is Gauss and Newton's: the term only shapes a geometry, and the features' own curvature is small
    against it (residual over vertebra size).

    Attributes
    ----------
    torso, view : what is seen, from where.
    rows : (Nv,) the torso's vertebrae that are seen.
    targets : (Nv, 4, 2) mm at the patient plane, z_hat.
    choice : (V, 4) silhouette choice.
    weight : N/mm.
    """

    torso: TorsoModel
    view: XRayView
    rows: Ints
    targets: Floats
    choice: Ints
    weight: float

    def residuals(self, state: TorsoState) -> Floats:
        """(Nv, 4, 2) mm, z - z_hat."""
        return state_features(self.torso, self.view, state, self.choice).z[self.rows] - self.targets

    def energy(self, state: TorsoState) -> float:
        return 0.5 * self.weight * float(np.sum(self.residuals(state) ** 2))

    def blocks(self, state: TorsoState) -> BoneBlocks:
        features = state_features(self.torso, self.view, state, self.choice)
        jacobian = features.jacobian[self.rows].reshape(len(self.rows), 8, 6)
        residual = (features.z[self.rows] - self.targets).reshape(len(self.rows), 8)
        gradient = self.weight * np.einsum("vkc,vk->vc", jacobian, residual)
        hessian = self.weight * np.swapaxes(jacobian, 1, 2) @ jacobian
        return BoneBlocks(self.torso.vertebra_bones[self.rows], gradient, hessian)


def corner_term(torso: TorsoModel, view: XRayView, corners: VertebraCorners, choice: Ints, weight: float) -> CornerTerm:
    """The term of annotated ``corners``; raises TrackingError for corners that are no picture of this torso."""
    targets = target_features(torso, view, corners)
    return CornerTerm(torso, view, vertebra_rows(torso, corners), targets, choice, weight)
