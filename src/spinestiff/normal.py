"""The normal distribution, as far as all results share it."""

HALF_WIDTH_95 = 1.96
"""Standard deviations either way that hold 95 %."""
