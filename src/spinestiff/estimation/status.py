"""How a fit of stiffness ratios ends."""

from __future__ import annotations

import enum


class FitStatus(enum.Enum):
    """How a fit ended; the text holds cause and remedy."""

    CONVERGED = "converged"
    AT_BOUND = (
        "converged with a ratio at its bound; the radiographs ask for a value outside: "
        "check force, pushed point and rest geometry, or widen the bounds"
    )
    NOT_IDENTIFIABLE = (
        "these radiographs can't tell the ratios apart (an interval covers nearly all that the bounds "
        "allow): use larger forces, more vertebrae or fewer ratios"
    )
    ITERATION_LIMIT = "not converged within the iteration limit; raise it or start from the ratios reached"
    STALLED = (
        "no step lowers the loss further, though the gradient is not zero: equilibria near the ratios reached fail "
        "or are inexact; reduce the force or raise the lower bound"
    )

    @property
    def usable(self) -> bool:
        """Whether the ratios are a minimum of the loss inside the bounds."""
        return self in (FitStatus.CONVERGED, FitStatus.AT_BOUND, FitStatus.NOT_IDENTIFIABLE)
