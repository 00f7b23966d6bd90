"""A check as one line: what was found and, where it did not pass, the limit and the mistakes to look for."""

from __future__ import annotations

from spinestiff.subject.estimate_outcome import Check


def check(name: str, found: str, value: float | None, limit: float | None, passed: bool, look_for: str) -> Check:
    """One line: what was found and, where it did not pass, the limit and the causes."""
    if not passed:
        said = "" if limit is None else f" (limit {limit:.3g})"
        found = f"{found}{said}; look for {look_for}"
    return Check(name=name, value=value, limit=limit, passed=passed, text=found)


def impossible(name: str, missing: str) -> Check:
    """A check that could not be made, and what it lacks."""
    return Check(name=name, value=None, limit=None, passed=None, text=f"not possible: {missing}")
