"""Counted nouns, names of pushes, paths and words that were meant, for messages."""

from __future__ import annotations

import re
from collections.abc import Iterable
from difflib import get_close_matches
from pathlib import Path

_PUSH = re.compile(r"push(?![a-z])", re.IGNORECASE)


def counted(count: int, singular: str, plural: str | None = None) -> str:
    """The count and its noun, "1 frame" or "3 frames"; ``plural`` is the singular with an s if left out."""
    return f"{count} {singular if count == 1 else plural or singular + 's'}"


def push_named(name: str) -> str:
    """A push by its id, "push left-5"; an id that says what it is, as "push-1", stands alone."""
    return name if _PUSH.match(name) else f"push {name}"


def sentence(words: str) -> str:
    """Words with a capital letter."""
    return words[:1].upper() + words[1:]


def pasted(path: Path) -> str:
    """A path as a command that is pasted into a terminal takes it: in double quotes where it has a blank."""
    return f'"{path}"' if any(letter.isspace() for letter in str(path)) else str(path)


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """The end of a message about an unknown word: the known one that it resembles; "" if it resembles none."""
    close = get_close_matches(word, sorted(known), 1)
    return f"; did you mean {close[0]}?" if close else ""
