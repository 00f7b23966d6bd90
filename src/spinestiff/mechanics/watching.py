"""Long solves in words, an iteration a line, for whoever prints lines: a terminal, a log, a notebook."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from spinestiff.mechanics.equilibrium import NewtonStep

# Solves that take less say nothing; those that take more say something this often.
SAY_EVERY = 0.5  # s


def newton_line(step: NewtonStep) -> str:
    """One iteration: residual, energy, smallest volume ratio, and what was unusual about its step."""
    line = (
        f"iteration {step.iteration}, residual {step.residual:.1e} N, "
        f"energy {step.energy:.6g} N mm, smallest J {step.smallest_j:.3g}"
    )
    if step.step > 0.0 and not step.factorised:
        line += ", factor kept"
    if step.projected:
        line += ", tangent not positive definite"
    return line if step.step in (0.0, 1.0) else f"{line}, step {step.step:.2g}"


def watched(say: Callable[[str], None], label: str, every: float = SAY_EVERY) -> Callable[[NewtonStep], None]:
    """An observer for ``EquilibriumProblem.solve`` that hands ``say`` a line "label: iteration ..." every so many s."""
    last_said = time.perf_counter()

    def observe(step: NewtonStep) -> None:
        nonlocal last_said
        now = time.perf_counter()
        if step.iteration == 0:
            last_said = now
        elif now - last_said >= every:
            say(f"{label}: {newton_line(step)}")
            last_said = now

    return observe
