"""A step of Newton's method where the tangent may be indefinite, by conjugate gradients (Steihaug 1983)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from spinestiff.arrays import Floats
from spinestiff.errors import EquilibriumError

Linear = Callable[[Floats], Floats]


@dataclass(frozen=True)
class TruncatedStep:
    """Where conjugate gradients ended.

    Attributes
    ----------
    y : (n,) the step; the quadratic model falls along it.
    size : of y, in the preconditioner's norm.
    concave : (n,) a way down along which the model is concave, if one was met.
    products : of the tangent with a vector that it took.
    """

    y: Floats
    size: float
    concave: Floats | None
    products: int


def truncated_step(
    gradient: Floats, tangent: Linear, precondition: Linear, radius: float, most: int, gain: float
) -> TruncatedStep:
    """The step that conjugate gradients find for tangent(y) = -gradient, up to where they leave a ball, meet a
    direction along which the model is concave, or have gained enough.

    Parameters
    ----------
    gradient : (n,). tangent : symmetric, of any sign. precondition : the inverse M^-1 of a positive definite matrix.
    radius : of the ball, in the norm of M; may be infinite.
    most : products at most. gain : of the residual's square in the norm of M^-1.

    Raises
    ------
    EquilibriumError : ``precondition`` is not positive definite, as near collapse.
    """
    r = gradient
    z = precondition(r)
    y, p, rz = np.zeros_like(r), -z, float(r @ z)
    if not rz > 0.0:
        raise EquilibriumError("the preconditioner is not positive definite")
    enough = gain * rz
    # Products of y and p in the norm of M, by their recurrences.
    yy, yp, pp = 0.0, 0.0, rz
    for count in range(1, most + 1):
        product = tangent(p)
        curvature = float(p @ product)
        if not curvature > 0.0:
            # The first direction is preconditioned steepest descent, of a length that M gives it.
            return TruncatedStep(y if count > 1 else p, float(np.sqrt(yy if count > 1 else pp)), p, count)
        length = rz / curvature
        if yy + 2.0 * length * yp + length**2 * pp >= radius**2:
            length = (np.sqrt(yp**2 + pp * (radius**2 - yy)) - yp) / pp
            return TruncatedStep(y + length * p, radius, None, count)
        y = y + length * p
        yy += 2.0 * length * yp + length**2 * pp
        if count == most:
            break
        r = r + length * product
        z = precondition(r)
        rz, last = float(r @ z), rz
        if not rz > enough:
            break
        p = -z + rz / last * p
        yp = rz / last * (yp + length * pp)
        pp = rz + (rz / last) ** 2 * pp
    return TruncatedStep(y, float(np.sqrt(max(yy, 0.0))), None, count)
