"""Questions on a terminal for what a subject lacks; an empty answer leaves it open."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, TypeVar

from spinestiff.errors import SubjectError
from spinestiff.formats import plain_number, plain_word
from spinestiff.subject.records import DISTANCES_MM, GAUGE_LIMIT_N, HEIGHTS_CM, LEVELS, OLDEST
from spinestiff.words import push_named

T = TypeVar("T")
_RANGES = {
    "age": (0.0, OLDEST), "height_cm": HEIGHTS_CM, "level": LEVELS, "d21_mm": DISTANCES_MM, "d31_mm": DISTANCES_MM,
}  # fmt: skip
_WORDS = {"sex": ("female", "male"), "side": ("left", "right")}


def on_terminal() -> bool:
    """Whether somebody can be asked: both what is read and what is printed are a terminal."""
    return sys.stdin.isatty() and sys.stderr.isatty()


def ask_open(
    data: dict[str, Any], keys: Mapping[str, str], where: str, ask: Callable[[str], str] | None = None
) -> None:
    """Ask for the values of ``PERSON`` or ``PUSH`` that are None or left out, and put the answers there.

    Parameters
    ----------
    where : in front of each question.
    ask : gives the answer to a question; None: the terminal.
    """
    for key in keys:
        if data.get(key) is None:
            answer = asked(f"{where}{key}, {keys[key]}", partial(_value, key, data), ask)
            if answer is not None:
                data[key] = answer


def ask_forces(
    push: dict[str, Any], check: Callable[[], None] = lambda: None, ask: Callable[[str], str] | None = None
) -> None:
    """Ask for all forces of a push, where one is not known.

    Parameters
    ----------
    check : judges the subject with the answer in it; raises SubjectError where it can't be so.
    ask : gives the answer to a question; None: the terminal.
    """
    before, count = push["forces_n"], len(push["forces_n"])

    def read(text: str) -> None:
        push["forces_n"] = _forces(text, count)
        try:
            check()
        except SubjectError as problem:
            push["forces_n"] = before
            raise ValueError(str(problem)) from None

    if None not in push["forces_n"]:
        return
    asked(
        f"{push_named(push['id'])}, force of each of its {count} frames in N (0 to {GAUGE_LIMIT_N:g}), separated by "
        "blanks",
        read,
        ask,
    )


def asked(question: str, read: Callable[[str], T], ask: Callable[[str], str] | None = None) -> T | None:
    """The answer, asked for until it can be read; None for an empty one, or at the end of the input.

    Parameters
    ----------
    read : the value of an answer; raises ValueError, in words, for one that is none.
    """
    while True:
        try:
            answer = (ask or _terminal)(question).strip()
        except EOFError:
            return None
        if not answer:
            return None
        try:
            return read(answer)
        except ValueError as problem:
            print(f"  {problem}", file=sys.stderr)


def confirmed(question: str, ask: Callable[[str], str] | None = None) -> bool:
    """Whether somebody says that it is so; an empty answer says it, too, the end of the input doesn't."""

    def read(text: str) -> bool:
        if text.casefold() not in ("y", "yes", "n", "no"):
            raise ValueError("wanted yes or no")
        return text.casefold() in ("y", "yes")

    def answer(question: str) -> str:
        # A whole line that holds nothing is a yes; that there is no line is none.
        try:
            return (ask or _terminal)(question).strip() or "yes"
        except EOFError:
            return "no"

    return asked(f"{question}; yes or no", read, answer) is True


def _terminal(question: str) -> str:
    print(f"{question}: ", end="", file=sys.stderr, flush=True)
    line = sys.stdin.readline()
    if not line:
        raise EOFError
    return line


def _value(key: str, data: Mapping[str, Any], text: str) -> Any:
    if key in _WORDS:
        if (found := plain_word(text, _WORDS[key])) is None:
            raise ValueError(f"wanted {' or '.join(_WORDS[key])}")
        return found
    value = number(text, *_RANGES[key], above=key == "age")
    d21, d31 = (value if key == name else data.get(name) for name in ("d21_mm", "d31_mm"))
    if key in ("d21_mm", "d31_mm") and d21 is not None and d31 is not None and d31 >= d21:
        raise ValueError(f"found d31_mm {d31:g} and d21_mm {d21:g}, wanted d31_mm below d21_mm: above the pelvis")
    return value


def number(text: str, low: float, high: float, above: bool = False) -> float:
    """A number within limits. Raises ValueError, in words."""
    value = plain_number(text.replace(",", "."))
    if not math.isfinite(value):
        raise ValueError(f"found {text[:40]!r}, wanted a number")
    if not low <= value <= high or (above and value == low):
        raise ValueError(f"found {value:g}, wanted {'above ' if above else ''}{low:g} to {high:g}")
    return value


def _forces(text: str, count: int) -> list[float]:
    forces = [number(part, 0.0, GAUGE_LIMIT_N) for part in text.replace(";", " ").split()]
    if len(forces) != count:
        raise ValueError(f"found {len(forces)} numbers, wanted {count}")
    return forces
