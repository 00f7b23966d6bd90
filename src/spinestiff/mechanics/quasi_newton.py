"""A factor of one state's tangent that goes on serving at others, and learns from the steps taken with it."""

from __future__ import annotations

import numpy as np

from spinestiff.arrays import Floats, Ints
from spinestiff.mechanics.factor import Factor
from spinestiff.mechanics.kinematics import Frame


class FrameFactor:
    """A factor of one state's tangent, applied in relative coordinates at others.

    It learns from the steps that were taken with it (BFGS, with the factor as the first matrix; Matthies and Strang
    1979), so that the few directions in which the tangent has changed much cost a step each and not a new factor.

    Parameters
    ----------
    frame : where the tangent was factorised.
    factor : of the tangent in dx, held DoFs replaced by the identity.
    held : indices of held DoFs.
    projected : whether negative curvature was left out of what was factorised.
    """

    def __init__(self, frame: Frame, factor: Factor, held: Ints, projected: bool = False) -> None:
        self.frame = frame
        self.factor = factor
        self.projected = projected
        self._held = held
        self._checked = False
        self._pairs: list[tuple[Floats, Floats, float]] = []

    def apply(self, gradient: Floats) -> Floats:
        """T0^-1 K0^-1 T0^-T times a gradient per y."""
        world = self.frame.push(gradient)
        world[self._held] = 0.0
        # One solve tells whether the matrix is singular.
        checked, self._checked = self._checked or self.factor.iterative, True
        return self.frame.from_world(self.factor.inverse(world) if checked else self.factor.solve(world, 1e-6))

    def solve(self, gradient: Floats) -> Floats:
        """As ``apply``, with what was learnt: the inverse BFGS matrix by its two loops."""
        q, shares = gradient.copy(), []
        for step, change, product in reversed(self._pairs):
            share = float(step @ q) / product
            q -= share * change
            shares.append(share)
        y = self.apply(q)
        for (step, change, product), share in zip(self._pairs, reversed(shares)):
            y += (share - float(change @ y) / product) * step
        return y

    def learn(self, step: Floats, change: Floats) -> None:
        """A step y changed the gradient per y by ``change``; left aside where its curvature is not positive."""
        product = float(step @ change)
        if product > 1e-8 * float(np.linalg.norm(step) * np.linalg.norm(change)):
            self._pairs.append((step, change, product))
