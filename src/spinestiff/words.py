"""Counted nouns and paths for messages."""

from __future__ import annotations

from pathlib import Path


def counted(count: int, singular: str, plural: str | None = None) -> str:
    """The count and its noun, "1 frame" or "3 frames"; ``plural`` is the singular with an s if left out."""
    return f"{count} {singular if count == 1 else plural or singular + 's'}"


def pasted(path: Path) -> str:
    """A path as a command that is pasted into a terminal takes it: in double quotes where it has a blank."""
    return f'"{path}"' if any(letter.isspace() for letter in str(path)) else str(path)
