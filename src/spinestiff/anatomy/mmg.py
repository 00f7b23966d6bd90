"""MMG, which makes better tetrahedra (extra [mesh]), in a process of its own: on some meshes it does not end.

The process ends itself when its time is over, so that nothing is left of it if the program that waits is killed. Its
time is that of the processor where the system counts it (not on Windows): then a mesh does not depend on how busy the
machine is.
"""

from __future__ import annotations

import faulthandler
import json
import math
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from spinestiff.anatomy.tetrahedra import least_angles, signed_volumes
from spinestiff.arrays import Floats, Ints
from spinestiff.errors import TorsoError

NO_MMG = 'meshing needs MMG; install it with pip install "spinestiff[mesh]"'
WANTED_ANGLE_DEG = 10.0
HAUSDORFF_MM = 3.0  # of the skin from its triangles, where these may change
EDGE_DEG = 20.0  # between two triangles of the skin: a larger angle is an edge, and stays one
VOLUME_TOLERANCE = 0.02
# CPU s, and CPU s a tetrahedron, that it may take; it mostly needs less than a twentieth of that. By the clock, so many
# times as long.
LONGEST_S, LONGEST_S_EACH, BY_CLOCK = 30.0, 0.002, 20.0


def mmg(points: Floats, tetrahedra: Ints, required: Ints) -> tuple[Floats, Ints]:
    """Better tetrahedra by MMG (through mmgpy): required points stay, sizes and the boundary about as they are.

    Raises
    ------
    TorsoError : the extra [mesh] is not installed, or MMG fails or does not end.
    """
    best: tuple[float, Floats, Ints] | None = None
    whole = np.abs(signed_volumes(points[tetrahedra])).sum()
    # First inside alone; where that leaves flat elements, the skin's triangles may change, too: with edges between
    # them kept, then as if they stood for a smooth surface, which bulges over them.
    passes: tuple[Mapping[str, float], ...] = (
        {"nosurf": 1},
        {"hausd": HAUSDORFF_MM, "ar": EDGE_DEG},
        {"hausd": HAUSDORFF_MM},
    )
    for options in passes:
        try:
            found = remeshed(points, tetrahedra, required, options)
        except TimeoutError as error:
            if best is None:
                raise TorsoError(str(error)) from None
            break
        corners = found[0][found[1]]
        angle = float(least_angles(corners).min())
        grown = abs(float(np.abs(signed_volumes(corners)).sum() / whole) - 1.0) > 0.5 * VOLUME_TOLERANCE
        if best is None or (angle > best[0] and not grown):
            best = (angle, *found)
        if best[0] >= WANTED_ANGLE_DEG:
            break
    assert best is not None
    return best[1:]


def remeshed(points: Floats, tetrahedra: Ints, required: Ints, options: Mapping[str, float]) -> tuple[Floats, Ints]:
    """Points (n, 3) and tetrahedra (t, 4) as MMG leaves them with these options.

    Raises
    ------
    TorsoError : the extra [mesh] is not installed, or MMG fails. TimeoutError : it does not end.
    """
    try:
        import mmgpy  # noqa: F401  (in a process of its own)
    except ImportError:
        raise TorsoError(NO_MMG) from None
    longest = LONGEST_S + LONGEST_S_EACH * len(tetrahedra)
    with tempfile.TemporaryDirectory(prefix="spinestiff-", ignore_cleanup_errors=True) as folder:
        given, made = Path(folder) / "given.npz", Path(folder) / "made.npz"
        np.savez(given, points=points, tetrahedra=tetrahedra, required=required)
        # The signal that ends a process whose time of the processor is over; Windows has none.
        over = getattr(signal, "SIGXCPU", None)
        began, by_clock = time.monotonic(), longest if over is None else BY_CLOCK * longest
        asked = json.dumps({"longest_s": longest, "by_clock_s": by_clock, "options": dict(options)})
        ran = subprocess.run(
            [sys.executable, "-P", "-m", "spinestiff.anatomy.mmg", str(given), str(made), asked],
            stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, check=False, cwd=folder,
        )  # fmt: skip
        if ran.returncode == 0 and made.is_file():
            with np.load(made) as found:
                return found["points"], found["tetrahedra"]
        if over is not None and ran.returncode == -over:
            raise TimeoutError(f"MMG has not ended within {longest:.0f} s of the processor")
        if time.monotonic() - began >= by_clock:
            raise TimeoutError(f"MMG has not ended within {by_clock:.0f} s")
        # Whatever MMG says, another set of points may do.
        said = " ".join(ran.stderr.decode(errors="replace").split())[-120:]
        raise TorsoError(f"MMG failed ({said or f'status {ran.returncode}'})")


def main(given: str, made: str, asked: str) -> None:
    """In the process of its own."""
    order = json.loads(asked)
    faulthandler.dump_traceback_later(order["by_clock_s"], exit=True, file=open(os.devnull, "w"))  # noqa: SIM115
    _limit(math.ceil(order["longest_s"]))
    import mmgpy

    with np.load(given) as content:
        points, tetrahedra, required = (content[name] for name in ("points", "tetrahedra", "required"))
    mesh = mmgpy.MmgMesh3D()
    mesh.set_mesh_size(vertices=len(points), tetrahedra=len(tetrahedra))
    mesh.set_vertices(np.ascontiguousarray(points, dtype=np.float64))
    mesh.set_tetrahedra(np.ascontiguousarray(tetrahedra, dtype=np.int32))
    mesh.set_required_vertices(np.ascontiguousarray(required, dtype=np.int32))
    try:
        mesh.remesh(optim=1, verbose=-1, **order["options"])
    except Exception as error:
        sys.exit(str(error))
    found = np.asarray(mesh.get_vertices(), dtype=float), np.asarray(mesh.get_tetrahedra(), dtype=np.int64)
    np.savez(made, points=found[0], tetrahedra=found[1])


def _limit(seconds: int) -> None:
    """End this process, without a core file, once it has had so much of the processor."""
    try:
        import resource
    except ImportError:  # Windows: the clock alone ends it
        return
    for kind, most in ((resource.RLIMIT_CPU, seconds), (resource.RLIMIT_CORE, 0)):
        _, hard = resource.getrlimit(kind)
        resource.setrlimit(kind, (most if hard == resource.RLIM_INFINITY else min(most, hard), hard))


if __name__ == "__main__":
    main(*sys.argv[1:])
