"""How far a tracked corner can be trusted: the standard deviation of its error, predicted from what tracking saw."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from spinestiff.arrays import Floats

# Correlation with the annotated frame from which on a patch counts as found at all.
FOUND = 0.25
# mm at the patient plane: the predicted standard deviation that halves quality.
HALVING_MM = 0.2


@dataclass(frozen=True)
class Evidence:
    """What tracking saw of a body in a frame, in mm at the patient plane.

    Attributes
    ----------
    scatter : (k,) of its marks, by the jackknife over parts of the patch.
    travel : way across the picture since the annotated frame: parallax grows with it.
    inner : motion of what lies before or behind the body against its outline: it turned out of the picture's plane.
    neighbours : distance from where those beside it, taken together, would carry it.
    round_trip : by which backward flow misses where forward flow came from.
    likeness : correlation with the annotated frame.
    """

    scatter: Floats
    travel: float
    inner: float
    neighbours: float
    round_trip: float
    likeness: float

    def terms(self) -> Floats:
        """(k, 6) mm, each of which may explain a part of the error."""
        ones = np.ones(len(self.scatter))
        vague = np.sqrt(max(1.0 - self.likeness, 0.0))
        shared = [self.travel, self.inner, self.neighbours, self.round_trip, vague]
        return np.column_stack([self.scatter, *(value * ones for value in shared)])


FLOOR_MM = 0.03
WEIGHTS = np.array([1.0, 0.01, 0.2, 0.2, 0.1, 0.1])


def predicted_error(evidence: Evidence) -> Floats:
    """(k,) mm, root mean square of a mark's distance from the truth."""
    return np.asarray(np.sqrt(FLOOR_MM**2 + np.sum((WEIGHTS * evidence.terms()) ** 2, axis=1)))


def quality_of(error: Floats) -> Floats:
    """Quality in 0..1 of predicted errors in mm: 1 for none, 1/2 at ``HALVING_MM``, 0 for infinite ones."""
    return np.asarray(1.0 / (1.0 + (error / HALVING_MM) ** 2))
