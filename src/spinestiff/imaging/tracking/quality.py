"""How far a tracked corner can be trusted."""

from __future__ import annotations

import numpy as np

# Correlation with the annotated frame up to which quality is 0 and from which on it is 1.
CORRELATION = (0.25, 0.75)
# Disagreement of forward and backward flow (mm, patient plane) that halves quality.
ROUND_TRIP_MM = 1.0
LOST = 0.1


def quality_of(correlation: float, round_trip: float) -> float:
    """Quality of a vertebra from its correlation with the annotated frame and the round trip (mm) of flow."""
    low, high = CORRELATION
    likeness = np.clip((correlation - low) / (high - low), 0.0, 1.0)
    return float(likeness / (1.0 + (round_trip / ROUND_TRIP_MM) ** 2))
