"""Numbers as people read them: no more digits than they have, open ends of intervals told from closed ones."""

from __future__ import annotations

import math
from collections.abc import Iterable

from spinestiff.normal import HALF_WIDTH_95
from spinestiff.subject.outcome_parts import Determination, Quantity

MISSING = "not available"
NO_INTERVALS = "no intervals"
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
    # Of the rounded number: 9.96 with two digits is 10.
    decimals = digits - 1 - int(f"{value:.{digits - 1}e}".partition("e")[2])
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
    return number(quantity.value, digits_of(quantity))


def digits_of(quantity: Quantity) -> int:
    """Significant ones of a value and of its interval's ends, which with fewer may read alike."""
    return 3 if quantity.sd_log < SURE else 2


def interval(quantity: Quantity) -> str:
    """A 95 % interval: "0.06 to 0.34"; an end at the fit's bound is open, "≤ 0.005 to 0.34"."""
    digits = digits_of(quantity)
    if quantity.low is None and quantity.high is None:
        return MISSING
    first = (
        MISSING
        if quantity.low is None
        else "≤ " + _bound(quantity.low)
        if quantity.open_low
        else number(quantity.low, digits)
    )
    last = (
        MISSING
        if quantity.high is None
        else "≥ " + _bound(quantity.high)
        if quantity.open_high
        else number(quantity.high, digits)
    )
    return f"{first} to {last}"


def span_in_words(quantity: Quantity, unit: str, determined: Determination | None = None) -> str:
    """What is known of a quantity as half a sentence: where the radiographs don't fix it a range, never a number alone.

    E.g. "3.8 kPa, between 3.0 and 4.8 kPa (95 %)", "between 1.9 and 6.9 kPa (95 %), most probably 3.8", "at most 5.1
    N m/rad (95 %), no lower end", "not fixed by the radiographs: between 2.6 and 98 N m/rad (95 %)".

    Parameters
    ----------
    determined : how far the data do, where the interval is not theirs alone; default: by the interval.
    """
    value, low, high = estimated(quantity), quantity.low, quantity.high
    if low is None or high is None:
        return f"{value} {unit}, {NO_INTERVALS}"
    if quantity.open_low and quantity.open_high:
        return f"not fixed by the radiographs: anything that the fit allows, {_bound(low)} to {_bound(high)} {unit}"
    if quantity.open_low:
        return f"at most {number(high, 2)} {unit} (95 %), no lower end"
    if quantity.open_high:
        return f"at least {number(low, 2)} {unit} (95 %), no upper end"
    digits = digits_of(quantity)
    ends = f"between {number(low, digits)} and {number(high, digits)} {unit} (95 %)"
    determined = determined or quantity.determination
    if determined == "determined":
        return f"{value} {unit}, {ends}"
    if determined == "weakly determined":
        return f"{ends}, most probably {value}"
    return f"not fixed by the radiographs: {ends}"


def short_span(quantity: Quantity, determined: Determination | None = None) -> str:
    """The value if it is determined or has no interval, else the interval (``determined``: see ``span_in_words``)."""
    alone = (determined or quantity.determination) == "determined" or (quantity.low is None and quantity.high is None)
    return estimated(quantity) if alone else interval(quantity)


def factor95(sd_log: float) -> str:
    """The factor either way within which a value lies with 95 %, from the standard deviation of its log."""
    factor = math.exp(HALF_WIDTH_95 * sd_log) if sd_log < 20.0 else math.inf
    return number(factor, 3 if factor < 2.0 else 2) if factor < 1000.0 else "more than 1000"


def listed(parts: Iterable[str]) -> str:
    """Words as a list: a, b and c."""
    parts = list(parts)
    return ", ".join(parts[:-1]) + " and " + parts[-1] if len(parts) > 1 else "".join(parts)


def _bound(value: float) -> str:
    """A bound of the fit: two digits, without zeros behind them."""
    text = number(value, 2)
    return text.rstrip("0").rstrip(".") if "." in text else text
