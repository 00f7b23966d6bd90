"""Counted nouns, names of pushes and paths for messages."""

from __future__ import annotations

import re
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
