"""Names of uploaded files made harmless: what a browser or a zip file sends is a name to be shown, never a path."""

from __future__ import annotations

import re
from collections.abc import Iterable

MOST_PARTS = 12
MOST_BYTES, LONGEST_END = 200, 16
"""Of a part in UTF-8, so that a number still fits into the 255 that file systems take, and characters of an ending
that is kept where the rest is cut: it tells what the file is."""
_NOWHERE = '<>:"|?*'
"""What some systems take in no name."""
_RESERVED = re.compile(r"(con|prn|aux|nul|com[0-9]|lpt[0-9])(\..*)?", re.IGNORECASE)


class Names:
    """Harmless names of files, each given once, in whatever case its letters are; no folder on the way is a file."""

    def __init__(self, taken: Iterable[str] = ()) -> None:
        self._taken: set[str] = set()
        self._folders: set[str] = set()
        self._counts: dict[str, int] = {}
        for name in taken:
            self._take(name)

    def new(self, name: str) -> str:
        """``harmless``, with a number where that is taken, or a folder of it a file."""
        *folders, last = harmless(name).split("/")
        place = ""
        for folder in folders:
            place = f"{self._free(place + folder, folder=True)}/"
        found = self._free(place + last)
        self._take(found)
        return found

    def _free(self, first: str, folder: bool = False) -> str:
        # The same name may come thousands of times: counting goes on where it ended.
        key = f"{first.casefold()}/" if folder else first.casefold()
        count = self._counts.get(key, 1)
        while (found := _numbered(first, count, folder)).casefold() in self._taken or (
            not folder and found.casefold() in self._folders
        ):
            count += 1
        self._counts[key] = count
        return found

    def _take(self, name: str) -> None:
        plain = name.casefold()
        self._taken.add(plain)
        self._folders.update(plain[:at] for at, letter in enumerate(plain) if letter == "/")


def _numbered(first: str, count: int, folder: bool) -> str:
    if count == 1:
        return first
    stem, dot, end = first.rpartition(".")
    return f"{stem}-{count}{dot}{end}" if not folder and dot and "/" not in end and stem else f"{first}-{count}"


def harmless(name: str) -> str:
    """A relative path of plain parts, close to the name: no ``..``, no root, nothing hidden, nothing unprintable.

    Whatever else stands in a name stays: tables call files by their names.
    """
    parts = []
    for part in re.split(r"[/\\]", name[:2000]):
        plain = _short("".join(c if c.isprintable() and c not in _NOWHERE else "_" for c in part).strip(" ."))
        if plain:
            parts.append(f"_{plain}" if _RESERVED.fullmatch(plain) else plain)
    return "/".join(parts[-MOST_PARTS:]) or "file"


def _short(part: str) -> str:
    stem, dot, end = part.rpartition(".")
    ending = f".{end}" if dot and stem and len(end) < LONGEST_END else ""
    kept = part.removesuffix(ending).encode()[: MOST_BYTES - len(ending.encode())].decode("utf-8", "ignore")
    return f"{kept}{ending}".rstrip(" .")
