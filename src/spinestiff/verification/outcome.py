"""What a check reports: a measured error beside the tolerance it was held to."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

# What a reference is. A gold number is one that the program gave before: it shows change, not error.
INDEPENDENT, GOLD = "independent", "gold"


@dataclass(frozen=True)
class Check:
    """One comparison of the program with something it does not share code with, or with an earlier answer of its own.

    Attributes
    ----------
    name : item of the list in ``verification.checks.ITEMS``, area and subject, e.g.
        "A1 gradient: tissue, mu part, ten nodes".
    kind : what the reference is; "independent" = closed form, manufactured solution, complex-step oracle, symmetry of
        physics or a second implementation; "gold" = a stored result of this program.
    error : measured, relative to the reference unless the name says otherwise.
    tolerance : largest error that passes.
    passed : ``error <= tolerance``.
    """

    name: str
    kind: str
    error: float
    tolerance: float
    passed: bool

    @property
    def item(self) -> str:
        """The item of the list that the name begins with, e.g. "A1"; "gold" for a stored number."""
        return self.name.split(maxsplit=1)[0].rstrip(":")


def judged(name: str, error: float, tolerance: float, kind: str = INDEPENDENT) -> Check:
    """A check of an error that is already scaled."""
    error = float(error)
    return Check(name, kind, error, tolerance, bool(np.isfinite(error) and error <= tolerance))


def compared(name: str, values: Any, reference: Any, tolerance: float, kind: str = INDEPENDENT) -> Check:
    """Largest difference over the largest reference; a reference that is nought or not finite fails."""
    values, reference = np.asarray(values, dtype=float), np.asarray(reference, dtype=float)
    size = float(np.abs(reference).max(initial=0.0))
    if values.shape != reference.shape or not size > 0.0 or not np.isfinite(size):
        return judged(name, np.inf, tolerance, kind)
    return judged(name, float(np.abs(values - reference).max()) / size, tolerance, kind)


def vanishing(name: str, values: Any, scale: float, tolerance: float) -> Check:
    """What should be nought, over the size of what cancels in it; a scale of nought fails."""
    largest = float(np.abs(np.asarray(values, dtype=float)).max(initial=0.0))
    return judged(name, largest / scale if scale > 0.0 else np.inf, tolerance)


def counted(name: str, failures: int, trials: int) -> Check:
    """How many of ``trials`` yes-or-no questions went wrong; none may, and there must be some."""
    return judged(name, float(failures) if trials > 0 else np.inf, 0.0)


def summary(checks: Sequence[Check]) -> str:
    """How many passed, each kind by itself: "231 of 231 independent checks passed, 12 of 12 gold regressions"."""
    parts = []
    for kind, what in ((INDEPENDENT, "independent checks passed"), (GOLD, "gold regressions")):
        those = [check for check in checks if check.kind == kind]
        if those or kind == INDEPENDENT:
            parts.append(f"{sum(check.passed for check in those)} of {len(those)} {what}")
    return ", ".join(parts)
