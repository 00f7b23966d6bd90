"""Counted nouns for messages."""

from __future__ import annotations


def counted(count: int, singular: str, plural: str | None = None) -> str:
    """The count and its noun, "1 frame" or "3 frames"; ``plural`` is the singular with an s if left out."""
    return f"{count} {singular if count == 1 else plural or singular + 's'}"
