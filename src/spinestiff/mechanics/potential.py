"""The total energy (Eq. 3), its gradient and Hessian: laws that couple bones and nodes, and terms that act on one."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from spinestiff.anatomy.state import TorsoState
from spinestiff.anatomy.stiffness import ParameterGroup, StiffnessRatios
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.arrays import Floats
from spinestiff.mechanics.assembly import Configuration, Law, ScaledLaw, Stiffness, Tangent, Unknowns, build_pattern
from spinestiff.mechanics.joints import JointLaw
from spinestiff.mechanics.terms import Term
from spinestiff.mechanics.tissue import TissueLaw


class Potential:
    """Energy of a torso as a function of its state. Built once a torso; holds constant arrays only.

    Parameters
    ----------
    torso : rest geometry, joints and tissue.
    laws : further laws beside those of its tissue and its joints.

    Attributes
    ----------
    unknowns : which degree of freedom is whose. pattern : of the Hessian. laws : tissue, joints, then the further ones.
    """

    def __init__(self, torso: TorsoModel, laws: Sequence[Law] = ()) -> None:
        self.torso = torso
        self.unknowns = of = Unknowns(torso)
        self.bones, self.dofs = of.bones, of.dofs
        tissue = TissueLaw(torso.tissue)
        self.tissue = tissue.data
        self.laws: tuple[Law, ...] = (tissue, JointLaw(torso.joints), *laws)
        self._scaled = [law for law in self.laws if isinstance(law, ScaledLaw)]
        pairs = [law.pairs(of) for law in self.laws]
        self.pattern = build_pattern(np.concatenate(pairs), of.sizes)
        self._offsets = [self.pattern.offset(*own.T) for own in pairs]

    def stiffness(self, ratios: StiffnessRatios | None) -> Stiffness:
        """Stiffnesses at the given ratios; ``None`` is the default model."""
        mesh, number = self.torso.tissue, self.tissue.number
        joints, mu, lambda_ = self.torso.joints.stiffness, mesh.lame_mu, mesh.lame_lambda
        if ratios:
            joints, (mu, lambda_) = ratios.scale_joints(joints), ratios.scale_tissue(mu, lambda_)
        return Stiffness(joints, mu[number], lambda_[number])

    def nodes(self, state: TorsoState) -> Floats:
        """(N, 3) mm, all tissue nodes."""
        return Configuration(self.unknowns, state).nodes

    def energy(self, state: TorsoState, stiffness: Stiffness, terms: Sequence[Term]) -> tuple[float, float]:
        """Total energy (Eq. 3), N mm, and the smallest J at an integration point. Infinite where J <= 0."""
        at, total, smallest = Configuration(self.unknowns, state), 0.0, np.inf
        for law in self.laws:
            energy, j = law.energy(at, stiffness)
            total, smallest = total + energy, min(smallest, j)
            if not j > 0.0:
                return np.inf, j
        return total + sum(term.energy(state) for term in terms), smallest

    def gradient(self, state: TorsoState, stiffness: Stiffness, terms: Sequence[Term]) -> Floats:
        """(dofs,) gradient of the total energy, N and N mm; minus the net force of Eq. 5."""
        at, gradient = Configuration(self.unknowns, state), np.zeros(self.dofs)
        for law in self.laws:
            law.add_gradient(at, stiffness, gradient)
        for term in terms:
            self._add_term(term, state, gradient)
        return gradient

    def term_gradient(self, term: Term, state: TorsoState) -> Floats:
        """(dofs,) gradient of one term alone."""
        gradient = np.zeros(self.dofs)
        self._add_term(term, state, gradient)
        return gradient

    def hessian(self, state: TorsoState, stiffness: Stiffness, terms: Sequence[Term], project: bool = False) -> Floats:
        """Values of the Hessian in ``pattern``; with ``project`` every part's negative curvature is left out."""
        at, tangent = Configuration(self.unknowns, state), Tangent(self.unknowns, self.pattern)
        for law, offsets in zip(self.laws, self._offsets):
            law.add_hessian(at, stiffness, tangent, offsets, project)
        for term in terms:
            own = term.blocks(state)
            np.add.at(tangent.bones, own.bone, own.hessian)
            np.add.at(tangent.nodes, own.node, own.node_hessian)
        return tangent.finished(project)

    def ratio_gradients(self, state: TorsoState, stiffness: Stiffness, groups: Sequence[ParameterGroup]) -> Floats:
        """(dofs, P) d gradient / d log ratio of each group: the group's own share of the force (paper 3.3)."""
        at, columns = Configuration(self.unknowns, state), np.zeros((len(groups), self.dofs)).T
        for law in self._scaled:
            law.add_shares(at, stiffness, groups, columns)
        return np.ascontiguousarray(columns)

    def ratio_products(
        self, state: TorsoState, stiffness: Stiffness, groups: Sequence[ParameterGroup], direction: Floats
    ) -> Floats:
        """(P,) ``ratio_gradients`` times ``direction`` (dofs,), in one pass for any number of groups."""
        at, total = Configuration(self.unknowns, state), np.zeros(len(groups))
        for law in self._scaled:
            total = total + law.share_products(at, stiffness, groups, direction)
        return total

    def _add_term(self, term: Term, state: TorsoState, gradient: Floats) -> None:
        blocks = term.blocks(state)
        np.add.at(self.unknowns.bone_rows(gradient), blocks.bone, blocks.gradient)
        np.add.at(self.unknowns.node_rows(gradient), blocks.node, blocks.node_gradient)
