"""What a check reports: a measured error beside the tolerance it was held to."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Check:
    """One comparison of the program with something it does not share code with.

    Attributes
    ----------
    name : area and subject, e.g. "gradient: tissue, mu part, ten nodes".
    kind : what the reference is; "independent" = closed form, manufactured solution, complex-step oracle, symmetry of
        physics or a second implementation. Nothing here compares with stored results of this program.
    error : measured, relative to the reference unless the name says otherwise.
    tolerance : largest error that passes.
    passed : ``error <= tolerance``.
    """

    name: str
    kind: str
    error: float
    tolerance: float
    passed: bool


def judged(name: str, error: float, tolerance: float) -> Check:
    """A check of an error that is already scaled."""
    error = float(error)
    return Check(name, "independent", error, tolerance, bool(np.isfinite(error) and error <= tolerance))


def compared(name: str, values: Any, reference: Any, tolerance: float) -> Check:
    """Largest difference over the largest reference; a reference that is nought or not finite fails."""
    values, reference = np.asarray(values, dtype=float), np.asarray(reference, dtype=float)
    size = float(np.abs(reference).max(initial=0.0))
    if values.shape != reference.shape or not size > 0.0 or not np.isfinite(size):
        return judged(name, np.inf, tolerance)
    return judged(name, float(np.abs(values - reference).max()) / size, tolerance)


def vanishing(name: str, values: Any, scale: float, tolerance: float) -> Check:
    """What should be nought, over the size of what cancels in it; a scale of nought fails."""
    largest = float(np.abs(np.asarray(values, dtype=float)).max(initial=0.0))
    return judged(name, largest / scale if scale > 0.0 else np.inf, tolerance)


def counted(name: str, failures: int, trials: int) -> Check:
    """How many of ``trials`` yes-or-no questions went wrong; none may, and there must be some."""
    return judged(name, float(failures) if trials > 0 else np.inf, 0.0)
