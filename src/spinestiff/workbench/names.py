"""Names of uploaded files made harmless: what a browser or a zip file sends is a name to be shown, never a path."""

from __future__ import annotations

import re
from collections.abc import Iterable

MOST_PARTS, LONGEST_PART = 12, 80
_RESERVED = re.compile(r"(con|prn|aux|nul|com[0-9]|lpt[0-9])(\..*)?", re.IGNORECASE)


class Names:
    """Harmless names, each given once, in whatever case its letters are."""

    def __init__(self, taken: Iterable[str] = ()) -> None:
        self._taken = {name.casefold() for name in taken}
        self._counts: dict[str, int] = {}

    def new(self, name: str) -> str:
        """``harmless``, with a number where that is taken."""
        first = harmless(name)
        # The same name may come thousands of times: counting goes on where it ended.
        found, count = first, self._counts.get(first.casefold(), 1)
        while found.casefold() in self._taken:
            count += 1
            stem, dot, end = first.rpartition(".")
            found = f"{stem}-{count}{dot}{end}" if dot and "/" not in end and stem else f"{first}-{count}"
        self._counts[first.casefold()] = count
        self._taken.add(found.casefold())
        return found


def harmless(name: str) -> str:
    """A relative path of plain parts, close to the name: no ``..``, no root, nothing hidden."""
    parts = []
    for part in re.split(r"[/\\]", name[:2000]):
        plain = "".join(c if c.isalnum() or c in " ._-+()^=," else "_" for c in part).strip(" .")[:LONGEST_PART]
        plain = plain.rstrip(" .")
        if plain:
            parts.append(f"_{plain}" if _RESERVED.fullmatch(plain) else plain)
    return "/".join(parts[-MOST_PARTS:]) or "file"
