"""``spinestiff doctor``: versions, the solver in use, and what each extra is for, as a table and as JSON."""

from __future__ import annotations

import platform
import sys
from typing import Any

from rich.markup import escape
from rich.table import Table

from spinestiff.app import tables
from spinestiff.errors import EquilibriumError
from spinestiff.versions import EXTRAS, LIBRARIES, installed


def examine() -> dict[str, Any]:
    """What there is on this machine, as JSON."""
    from spinestiff.anatomy.template import MESHES, template_torso
    from spinestiff.parallel import threads
    from spinestiff.subject.program import program

    torsos = {mesh: template_torso(157.0, mesh) for mesh in MESHES}
    return {
        "spinestiff": program(),
        "python": sys.version.split()[0],
        "system": platform.platform(),
        "libraries": {name: installed(name) for name in LIBRARIES},
        "sparse_solver": sparse_solver(),
        "threads": threads(),
        "extras": {
            extra.name: {"use": extra.use, "installed": {name: installed(name) for name in extra.libraries}}
            for extra in EXTRAS
        },
        "meshes": {
            mesh: {"nodes": len(torso.tissue.rest_positions), "joints": len(torso.joints)}
            for mesh, torso in torsos.items()
        },
    }


def sparse_solver() -> str:
    """Which is in use, or why none is."""
    from spinestiff.mechanics.factor import default_backend

    try:
        return default_backend()
    except EquilibriumError as error:
        return f"NONE: {error}"


def doctor_tables(found: dict[str, Any]) -> tuple[Table, Table]:
    """What is installed, and the extras."""
    first = tables.table("spinestiff doctor", "what", "found", left=("found",))
    first.add_row("spinestiff", found["spinestiff"])
    first.add_row("Python", found["python"])
    first.add_row("system", found["system"])
    for name, version in found["libraries"].items():
        first.add_row(name, version or "MISSING: pip install it")
    first.add_row("sparse solver in use", escape(found["sparse_solver"]))
    first.add_row("threads", str(found["threads"]))
    for mesh, size in found["meshes"].items():
        first.add_row(f"template mesh '{mesh}'", f"{size['nodes']} nodes, {size['joints']} joints")
    second = tables.table('Extras: pip install "spinestiff[NAME]"', "name", "for", "", left=("for", ""))
    for name, extra in found["extras"].items():
        missing = [one for one, version in extra["installed"].items() if version is None]
        there = "installed" if not missing else f"not installed: {', '.join(missing)}"
        second.add_row(name, extra["use"], there)
    return first, second
