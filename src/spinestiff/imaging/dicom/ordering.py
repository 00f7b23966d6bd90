"""The order of single-frame files: by time and instance number; by file name where no file has either."""

from __future__ import annotations

import re
from collections.abc import Sequence

from spinestiff.errors import RadiographError

DAY_S = 86400.0


def ordered(
    folder: str,
    names: Sequence[str],
    clocks: Sequence[float | None],
    numbers: Sequence[int | None],
    contents: Sequence[float | None],
) -> tuple[list[int], str]:
    """Indices of files in order: by time, equal times by instance number; without times by number; where no file has
    either, by name, numbers in names as numbers. And what is odd about it, in a line; "" if nothing: times and numbers
    disagree, numbers occur twice, only some files have a time, or times of content alone or the names decide.

    Parameters
    ----------
    folder : for messages.
    names : of the files, each once.
    clocks : s, of the acquisition, with its day or of the day alone.
    numbers : InstanceNumber.
    contents : s, as ``clocks``, of the content; they count as ``times_told`` says.

    Raises
    ------
    RadiographError : two files can't be told apart in order; some are of different days and others of no day.
    """
    indices = range(len(names))
    told = times_told(clocks, numbers, contents)
    if None not in told and None in clocks and None in numbers:
        odd = f"{folder}: no file has an acquisition time; ordered by the times of their content: check the order"
        return sorted(indices, key=lambda i: told[i] or 0.0), odd
    of_days = dated(told)
    if of_days is None:
        raise RadiographError(
            f"{folder}: files of several days among some without a date, so the order is unknown; keep days apart"
        )
    clocks = of_days
    timed = all(clock is not None for clock in clocks)
    counted = all(number is not None for number in numbers)
    if unnumbered(clocks, numbers):
        odd = f"{folder}: no file has an acquisition time or an instance number; ordered by file name: check the order"
        return sorted(indices, key=lambda i: natural(names[i])), odd
    if not timed and not counted:
        raise RadiographError(
            f"{folder}: neither all acquisition times nor all instance numbers, so the order is unknown; "
            "export the series again, or as one multi-frame file"
        )
    keys = [(clocks[i] if timed else None, numbers[i] if counted else None) for i in indices]
    first: dict[tuple[float | None, int | None], int] = {}
    for i in indices:
        if keys[i] in first:
            same = "acquisition time" if timed else "instance number"
            same += " and instance number" if timed and counted else ""
            one, other = names[first[keys[i]]], names[i]
            raise RadiographError(f"{folder}: {one} and {other} have the same {same}, so their order is unknown")
        first[keys[i]] = i
    order = sorted(indices, key=lambda i: (clocks[i] or 0.0 if timed else 0.0, numbers[i] or 0 if counted else 0))
    if not timed:
        if any(clock is not None for clock in clocks):
            return order, f"{folder}: only some files have an acquisition time; ordered by instance number"
        return order, ""
    if counted:
        in_order = [numbers[i] or 0 for i in order]
        if len(set(in_order)) < len(in_order):
            return order, f"{folder}: instance numbers occur twice; ordered by time"
        if in_order != sorted(in_order):
            return order, f"{folder}: acquisition times and instance numbers disagree; ordered by time"
    return order, ""


def dated(clocks: Sequence[float | None]) -> list[float | None] | None:
    """Clocks, s, that compare: where only some have a day, the others' is the same. None where that is not one day."""
    days = {int(clock // DAY_S) for clock in clocks if clock is not None}
    if days <= {0} or 0 not in days:
        return list(clocks)
    if len(days) > 2:
        return None
    (day,) = days - {0}
    return [clock if clock is None or clock >= DAY_S else clock + DAY_S * day for clock in clocks]


def times_told(
    clocks: Sequence[float | None], numbers: Sequence[int | None], contents: Sequence[float | None]
) -> Sequence[float | None]:
    """Times of files, s: of the acquisition; where no file has one, of the content, if these can be times of frames.

    They can't be where one is missing or all are alike, as those of an export; where they contradict the numbers; and,
    without numbers, where two are alike.
    """
    days = dated(contents)
    if any(clock is not None for clock in clocks) or days is None:
        return clocks
    times = [time for time in days if time is not None]
    if len(times) < len(days) or len(set(times)) == 1:
        return clocks
    whole = [number for number in numbers if number is not None]
    if len(whole) < len(days):
        return clocks if len(set(times)) < len(times) else days
    by_number = [time for _, time in sorted(zip(whole, times))]
    return days if by_number == sorted(times) else clocks


def unnumbered(clocks: Sequence[float | None], numbers: Sequence[int | None]) -> bool:
    """Whether no file says when it was taken or which one it is, so that names alone are left."""
    return all(clock is None for clock in clocks) and all(number is None for number in numbers)


def natural(name: str) -> tuple[tuple[tuple[str, int], ...], str]:
    """What sorts names as people do: img2 before img10."""
    pieces = re.findall(r"(\D*)(\d*)", name.casefold())
    return tuple((text, int(digits or -1)) for text, digits in pieces), name
