"""Built pages against their sources in ``web``."""

from __future__ import annotations

import hashlib
import re
from pathlib import Path

WEB = Path(__file__).parents[1] / "web"


def assert_built_from_its_sources(name: str, script: str) -> None:
    """A built script names the hash of ``web/<name>`` and ``web/shared``, as ``web/shared/build.ts`` makes it."""
    folder = WEB / name
    tops = ("index.html", "package.json", "package-lock.json", "tsconfig.json", "vite.config.ts")
    names = [top for top in tops if (folder / top).exists()]
    names += [f"{inner}/{path.name}" for inner in ("src", "../shared") for path in (folder / inner).iterdir()]
    digest = hashlib.sha256()
    for one in sorted(names):
        digest.update(f"{one}\n".encode() + (folder / one).read_bytes().replace(b"\r\n", b"\n"))
    assert len(names) > 10
    (recorded,) = re.findall(r"^sources sha256 ([0-9a-f]{64})$", script, re.MULTILINE)
    assert recorded == digest.hexdigest(), f"run npm ci && npm run build in web/{name}"


def style_sheet(name: str) -> str:
    """What the style sheet of a page is made of."""
    return "".join((WEB / path).read_text(encoding="utf-8") for path in ("shared/base.css", f"{name}/src/{name}.css"))
