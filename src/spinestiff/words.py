"""Counted nouns, names of pushes, paths, words that were meant and what files hold, for messages."""

from __future__ import annotations

import os
import re
import shlex
from collections.abc import Iterable
from difflib import get_close_matches
from pathlib import Path

_MEANS_MORE = re.compile(r"[^\w .,:/\\@%+=-]" if os.name == "nt" else r"[^\w\udc80-\udcff .,:/@%+=-]")
"""Signs beside blanks that shells may take for something else than themselves. Bytes that are no text, by their codes,
are none."""
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
    """A path as a command that is pasted into a terminal takes it: in quotes where it has a blank, or a sign that has a
    meaning there.
    """
    text = str(path)
    if os.name != "nt" and _MEANS_MORE.search(text):
        return shlex.quote(text)
    return f'"{text}"' if " " in text or _MEANS_MORE.search(text) else text


def printable(text: str, most: int = 60) -> str:
    """What a file holds as a message may show it: at most so many characters, "?" for those that can't be printed."""
    shown = "".join(c if c.isprintable() else "?" for c in text[:most])
    return shown if len(text) <= most else shown[: most - 3] + "..."


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """The end of a message about an unknown word: the known one that it resembles; "" if it resembles none."""
    close = get_close_matches(word, sorted(known), 1)
    return f"; did you mean {close[0]}?" if close else ""
