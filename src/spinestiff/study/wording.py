"""Numbers as people read them: no more digits than they have, open ends of intervals told from closed ones."""

from __future__ import annotations

import math
from collections.abc import Iterable

from spinestiff.subject.outcome_parts import Quantity
from spinestiff.subject.outcomes import Estimate

MISSING = "not available"
AT_AN_END = 1.001
"""Factor within which a value is its interval's end."""
SURE = 0.05
"""Standard deviation of a logarithm below which a number has three significant digits; else it has two."""


def number(value: float | None, digits: int = 3) -> str:
    """A number with so many significant digits, without an exponent; "not available" for none."""
    if value is None or not math.isfinite(value):
        return MISSING
    if value == 0.0:
        return "0"
    decimals = digits - 1 - math.floor(math.log10(abs(value)))
    return f"{round(value, decimals):.{max(decimals, 0)}f}".replace("-", "−")


def fixed(value: float | None, decimals: int = 1, sign: bool = False) -> str:
    """A number with so many decimals; "not available" for none."""
    if value is None or not math.isfinite(value):
        return MISSING
    # Plus zero: no sign before a rounded zero.
    rounded = round(value, decimals) + 0.0
    return f"{rounded:{'+' if sign and rounded else ''}.{decimals}f}".replace("-", "−")


def estimated(quantity: Quantity) -> str:
    """The value of an estimate with the digits that its interval leaves it; at an open end, "≤ 0.005"."""
    if quantity.open_low and quantity.low is not None and quantity.value <= quantity.low * AT_AN_END:
        return "≤ " + _bound(quantity.value)
    if quantity.open_high and quantity.high is not None and quantity.value >= quantity.high / AT_AN_END:
        return "≥ " + _bound(quantity.value)
    return number(quantity.value, 3 if quantity.sd_log < SURE else 2)


def interval(quantity: Quantity) -> str:
    """A 95 % interval: "0.06 to 0.34"; an end at the fit's bound is open, "≤ 0.005 to 0.34"."""
    if quantity.low is None and quantity.high is None:
        return MISSING
    first = (
        MISSING
        if quantity.low is None
        else "≤ " + _bound(quantity.low)
        if quantity.open_low
        else number(quantity.low, 2)
    )
    last = (
        MISSING
        if quantity.high is None
        else "≥ " + _bound(quantity.high)
        if quantity.open_high
        else number(quantity.high, 2)
    )
    return f"{first} to {last}"


def _bound(value: float) -> str:
    """A bound of the fit: two digits, without zeros behind them."""
    text = number(value, 2)
    return text.rstrip("0").rstrip(".") if "." in text else text


def badge(estimate: Estimate) -> str:
    """The word or two that stand above a result: doubtful, or how far it is determined."""
    return "doubtful" if estimate.status == "DOUBTFUL" else estimate.determined


def listed(parts: Iterable[str]) -> str:
    """Words as a list: a, b and c."""
    parts = list(parts)
    return ", ".join(parts[:-1]) + " and " + parts[-1] if len(parts) > 1 else "".join(parts)
