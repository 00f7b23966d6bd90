"""Names of uploaded files made harmless: what a browser or a zip file sends is a name to be shown, never a path."""

from __future__ import annotations

import re
from collections.abc import Container

MOST_PARTS, LONGEST_PART = 12, 80
_RESERVED = re.compile(r"(con|prn|aux|nul|com[0-9]|lpt[0-9])(\..*)?", re.IGNORECASE)


def harmless(name: str, taken: Container[str] = ()) -> str:
    """A relative path of plain parts, close to the name, that is not taken: no ``..``, no root, nothing hidden."""
    parts = []
    for part in re.split(r"[/\\]", name[:2000]):
        plain = "".join(c if c.isalnum() or c in " ._-+()^=," else "_" for c in part).strip(" .")[:LONGEST_PART]
        plain = plain.rstrip(" .")
        if plain:
            parts.append(f"_{plain}" if _RESERVED.fullmatch(plain) else plain)
    first = "/".join(parts[-MOST_PARTS:]) or "file"
    found, count = first, 1
    while found.casefold() in taken:
        count += 1
        stem, dot, end = first.rpartition(".")
        found = f"{stem}-{count}{dot}{end}" if dot and "/" not in end and stem else f"{first}-{count}"
    return found
