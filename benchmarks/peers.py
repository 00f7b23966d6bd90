"""This engine beside other finite-element codes on one tissue-only problem.

The torso's bones are moved as they are under a push (lateral bending 0.2, tissue 0.05, 60 N at rib 8: up to 13 mm) and
held there; the tissue around them finds its equilibrium. Every code gets the same mesh, moduli, start (the bones'
motion, continued harmonically into the tissue), integration points and tolerance (1e-8 N on the largest free force),
and solves it again after mu has grown by 5 %, with the gradient of a random linear loss in mu and lambda there.

    python benchmarks/peers.py [--folder ENVS] [--mesh coarse|fine] [--elements linear|quadratic] [--write]

Each peer runs in a virtual environment of its own, made in ``--folder`` on the first run with pinned versions; one that
cannot be installed is listed with the reason. "linear" splits each ten-node tetrahedron in eight, so that both have the
same nodes. All codes are told to use one thread; figures are CPU seconds, medians over ``--rounds`` rounds of all
codes in turn.

Columns: tangents built in the first solve, then in the warm one; CPU seconds of solve, warm solve, warm solve with
gradient, first solve with compilation and analysis; largest difference from ours over our largest displacement (first
and warm solution) and gradient.
"""

from __future__ import annotations

import argparse
import datetime
import json
import os
import platform
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as spla

from spinestiff.anatomy.stiffness import stiffness_ratios
from spinestiff.anatomy.template import template_torso
from spinestiff.mechanics.equilibrium import EquilibriumProblem
from spinestiff.mechanics.loads import rib_push
from spinestiff.mechanics.supports import three_point_supports
from spinestiff.mechanics.tissue import QUADRATURE

SCRIPTS = Path(__file__).parent / "peers"
sys.path.insert(0, str(SCRIPTS))
from common import Floats, Problem  # noqa: E402

PUSH = {"lateral_bending": 0.2, "tissue": 0.05}
FORCE_N = 60.0
# Node order as in anatomy/torso.py: corners 0-3, middles of 01, 12, 02, 03, 13, 23. Four corners, then the
# octahedron between them about its diagonal 6-8.
EIGHT = np.array(
    [
        [0, 4, 6, 7],
        [1, 5, 4, 8],
        [2, 6, 5, 9],
        [3, 8, 7, 9],
        [6, 8, 4, 5],
        [6, 8, 5, 9],
        [6, 8, 9, 7],
        [6, 8, 7, 4],
    ]
)
ONE_THREAD = {f"{name}_NUM_THREADS": "1" for name in ("OMP", "MKL", "OPENBLAS", "NUMBA", "RAYON")}
ONE_THREAD["XLA_FLAGS"] = "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"


@dataclass(frozen=True)
class Peer:
    """A code, the script that drives it and what its environment holds (nothing: this one)."""

    name: str
    script: str
    packages: tuple[str, ...] = ()
    settings: tuple[tuple[str, str], ...] = ()
    needs_petsc: bool = False


PARDISO = ("pypardiso==0.4.7", "mkl==2026.2.0")
PEERS = (
    Peer("spinestiff", "ours.py"),
    Peer("FElupe", "with_felupe.py", ("felupe==11.3.0", *PARDISO)),
    Peer("scikit-fem", "with_skfem.py", ("scikit-fem==12.0.2", *PARDISO)),
    Peer(
        "scikit-fem, factor kept",
        "with_skfem.py",
        ("scikit-fem==12.0.2", *PARDISO),
        settings=(("SPINESTIFF_KEEP_FACTOR", "1"),),
    ),
    Peer("torch-fem", "with_torchfem.py", ("torch==2.13.0", "torch-fem==0.14.0", *PARDISO)),
    Peer(
        "JAX-FEM",
        "with_jaxfem.py",
        # Debian's petsc4py was built for NumPy 1; JAX-FEM's wheel names none of what it imports.
        ("jax-fem==0.0.11", "jax==0.4.30", "jaxlib==0.4.30", "numpy==1.26.4", "scipy==1.13.1", "fenics-basix==0.10.0")
        + ("meshio==5.3.5", "gmsh==4.15.2", "pyfiglet==1.0.4", *PARDISO),
        needs_petsc=True,
    ),
)


class SkippedError(Exception):
    """A peer cannot run here; the message says why."""


def tissue_problem(mesh: str, elements: str) -> Problem:
    """The problem on the template's mesh."""
    torso = template_torso(157.0, mesh)
    engine = EquilibriumProblem(torso, three_point_supports(torso, "left"))
    load = rib_push(torso, "left", 8.0, FORCE_N)
    pushed = engine.solve(load, stiffness_ratios(PUSH, torso.joints.kinds)).require().state
    cells, bone_of_node = torso.tissue.elements, torso.tissue.bone_of_node
    split = outward(torso.tissue.rest_positions, cells[:, EIGHT].reshape(-1, 4))
    if elements == "linear":
        cells = split
    # What is tied whole to one bone cannot deform, and nodes of nothing else are no unknowns.
    cells = cells[~((bone_of_node[cells] == bone_of_node[cells[:, :1]]).all(1) & (bone_of_node[cells[:, 0]] >= 0))]
    kept = np.unique(cells)
    number = np.full(len(bone_of_node), -1)
    number[kept] = np.arange(len(kept))
    points, tied = torso.tissue.rest_positions[kept], bone_of_node[kept]
    moved = (torso.node_positions(pushed) - torso.tissue.rest_positions)[kept]
    split = number[split]
    start = harmonic(points, split[(split >= 0).all(1)], tied >= 0, moved)
    rest = torso.rest_pose
    barycentric, shares = QUADRATURE[cells.shape[1]]
    weights = np.random.default_rng(0).normal(size=points.shape)
    weights[tied >= 0] = 0.0
    return Problem(
        points=points,
        cells=number[cells],
        fixed=tied >= 0,
        start=start,
        mu=float(torso.tissue.lame_mu[0]),
        lambda_=float(torso.tissue.lame_lambda[0]),
        weights=weights,
        quadrature_points=np.ascontiguousarray(barycentric[:, 1:]),
        quadrature_weights=shares / 6.0,
        bone_of_node=tied,
        # The engine gets its own rest pose: turns are relative to it.
        bone_rest=np.array(rest.bone_positions),
        bone_moved=np.array(pushed.bone_positions),
        bone_turned=pushed.bone_rotations @ np.swapaxes(rest.bone_rotations, 1, 2),
    )


def outward(points: Floats, cells: np.ndarray) -> np.ndarray:
    """The tetrahedra with two nodes swapped where their volume is negative."""
    edges = points[cells[:, 1:]] - points[cells[:, :1]]
    cells = cells.copy()
    inside_out = np.linalg.det(edges) < 0.0
    cells[inside_out] = cells[inside_out][:, [0, 2, 1, 3]]
    return cells


def harmonic(points: Floats, cells: np.ndarray, fixed: np.ndarray, values: Floats) -> Floats:
    """Values (N, 3) of fixed nodes continued by Laplace's equation on four-node tetrahedra."""
    edges = points[cells[:, 1:]] - points[cells[:, :1]]
    gradients = np.swapaxes(np.linalg.inv(edges), 1, 2)
    gradients = np.concatenate([-gradients.sum(1, keepdims=True), gradients], axis=1)
    blocks = np.einsum("tai,tbi->tab", gradients, gradients) * (np.linalg.det(edges) / 6.0)[:, None, None]
    rows, columns = np.repeat(cells, 4, axis=1).ravel(), np.tile(cells, 4).ravel()
    laplacian = sp.csr_array((blocks.ravel(), (rows, columns)), shape=(len(points),) * 2)
    free = np.flatnonzero(~fixed)
    continued = np.where(fixed[:, None], values, 0.0)
    continued[free] = -spla.splu(laplacian[free][:, free].tocsc()).solve((laplacian @ continued)[free])
    return continued


def petsc4py_folder() -> str:
    """Where a distribution keeps petsc4py for this Python; PyPI has its source only."""
    tag = f"cpython-{sys.version_info.major}{sys.version_info.minor}"
    for folder in sorted(Path("/usr/lib/petscdir").glob("*/*-real/lib/python3/dist-packages")):
        if any(folder.glob(f"petsc4py/lib/**/PETSc.{tag}*.so")):
            return str(folder)
    raise SkippedError("needs petsc4py, which has no wheel (Debian: python3-petsc4py)")


def environment(peer: Peer, folder: Path) -> Path:
    """The peer's Python; its environment is made where it is not there."""
    if not peer.packages:
        return Path(sys.executable)
    home = folder / peer.script.removesuffix(".py")
    python, done = home / "bin" / "python", home / "installed.json"
    if done.exists() and json.loads(done.read_text(encoding="utf-8")) == list(peer.packages):
        return python
    for command in (
        [sys.executable, "-m", "venv", "--clear", str(home)],
        [str(python), "-m", "pip", "install", "--quiet", "--disable-pip-version-check", *peer.packages],
    ):
        outcome = subprocess.run(command, capture_output=True, text=True, check=False)
        if outcome.returncode:
            raise SkippedError(f"cannot be installed: {last_line(outcome.stderr)}")
    done.write_text(json.dumps(peer.packages), encoding="utf-8")
    return python


def last_line(text: str) -> str:
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    return lines[-1] if lines else "no message"


def run(peer: Peer, folder: Path, problem: Path, result: Path, repeats: int, limit_s: float) -> dict[str, Any]:
    """The peer's figures and solutions on the stored problem; raises SkippedError."""
    extra = {"PYTHONPATH": petsc4py_folder()} if peer.needs_petsc else {}
    python = environment(peer, folder)
    if not peer.packages and os.environ.get("PYTHONPATH"):
        extra["PYTHONPATH"] = os.environ["PYTHONPATH"]
    variables = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}
    variables |= ONE_THREAD | dict(peer.settings) | extra
    command = [str(python), str(SCRIPTS / peer.script), str(problem), str(result), "--repeats", str(repeats)]
    try:
        outcome = subprocess.run(
            command, env=variables, capture_output=True, text=True, check=False, timeout=limit_s, cwd=SCRIPTS
        )
    except subprocess.TimeoutExpired:
        raise SkippedError(f"not done after {limit_s:.0f} s") from None
    if outcome.returncode:
        raise SkippedError(f"failed: {last_line(outcome.stderr)}")
    figures = json.loads(result.with_suffix(".json").read_text(encoding="utf-8"))
    with np.load(result.with_suffix(".npz")) as file:
        return {**figures, **{name: file[name] for name in file.files}}


def compare(
    problem: Problem, folder: Path, chosen: Sequence[Peer], rounds: int, repeats: int, limit_s: float
) -> list[dict[str, Any]]:
    """One row a code: medians over the rounds, and differences from ours."""
    found: dict[str, list[dict[str, Any]]] = {peer.name: [] for peer in chosen}
    skipped: dict[str, str] = {}
    with tempfile.TemporaryDirectory() as scratch:
        stored = Path(scratch) / "problem.npz"
        problem.save(stored)
        for turn in range(rounds):
            for peer in chosen:
                if peer.name in skipped:
                    continue
                try:
                    one = run(peer, folder, stored, Path(scratch) / f"{chosen.index(peer)}_{turn}.x", repeats, limit_s)
                except SkippedError as reason:
                    skipped[peer.name] = str(reason)
                    print(f"  {peer.name}: {reason}", flush=True)
                else:
                    found[peer.name].append(one)
    ours = found[PEERS[0].name]
    rows: list[dict[str, Any]] = []
    for peer in chosen:
        if peer.name in skipped:
            rows.append({"code": peer.name, "skipped": skipped[peer.name]})
            continue
        runs = found[peer.name]
        row: dict[str, Any] = {"code": peer.name, "versions": runs[0]["versions"]}
        for key, value in runs[0].items():
            if isinstance(value, float):
                row[key] = round(statistics.median(one[key] for one in runs), 4)
            elif isinstance(value, int):
                row[key] = value
        if ours:
            for key in ("cold", "warm", "gradient"):
                difference = np.abs(runs[0][key] - ours[0][key]).max() / np.abs(ours[0][key]).max()
                row[f"{key}_difference"] = float(f"{difference:.1e}")
        rows.append(row)
    return rows


def verdicts(rows: Sequence[dict[str, Any]]) -> dict[str, float]:
    """Our solve over the factorisations it made, and over those of Newton's method; the peers' best over ours."""
    ours = next(row for row in rows if row["code"] == PEERS[0].name)
    peers = [row for row in rows if row is not ours and "skipped" not in row]
    found = {
        "solve_over_factorisations": round(ours["solve_cpu_s"] / (ours["factorisations"] * ours["factor_cpu_s"]), 3)
    }
    for key in ("solve_cpu_s", "warm_with_gradient_cpu_s"):
        if peers:
            newton = min(row["iterations"] for row in peers)
            found["solve_over_newton_factorisations"] = round(ours["solve_cpu_s"] / (newton * ours["factor_cpu_s"]), 3)
            best = min(peers, key=lambda row: row[key])
            found[f"best_peer_over_ours_{key.removesuffix('_cpu_s')}"] = round(best[key] / ours[key], 2)
    return found


def show(rows: Sequence[dict[str, Any]]) -> None:
    print(f"{'':<24}{'tan':>5}{'warm':>5}{'solve':>9}{'warm':>9}{'+grad':>9}{'first':>9}   differences")
    for row in rows:
        if "skipped" in row:
            print(f"{row['code']:<24}  {row['skipped']}")
            continue
        times = ("solve_cpu_s", "warm_cpu_s", "warm_with_gradient_cpu_s", "first_solve_cpu_s")
        line = f"{row['code']:<24}{row['iterations']:>5}{row['warm_iterations']:>5}"
        line += "".join(f"{row[name]:>9.3f}" for name in times)
        print(line + "   " + "  ".join(f"{row[f'{key}_difference']:.1e}" for key in ("cold", "warm", "gradient")))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--folder", type=Path, default=Path(tempfile.gettempdir()) / "spinestiff-peers")
    parser.add_argument("--mesh", action="append", choices=("coarse", "fine"))
    parser.add_argument("--elements", action="append", choices=("linear", "quadratic"))
    parser.add_argument("--only", action="append", choices=[peer.name for peer in PEERS[1:]], help="these peers")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--repeats", type=int, default=2, help="in each round, after one that is not counted")
    parser.add_argument("--limit", type=float, default=900.0, help="seconds for one run of one code")
    parser.add_argument("--write", action="store_true", help="store the result in benchmarks/results/")
    arguments = parser.parse_args()
    chosen = [peer for peer in PEERS if not peer.packages or not arguments.only or peer.name in arguments.only]
    arguments.folder.mkdir(parents=True, exist_ok=True)
    tables = []
    for mesh in arguments.mesh or ("coarse", "fine"):
        for elements in arguments.elements or ("linear", "quadratic"):
            problem = tissue_problem(mesh, elements)
            size = {"nodes": len(problem.points), "elements": len(problem.cells), "unknowns": len(problem.free_dofs)}
            print(f"{mesh}, {elements}: " + ", ".join(f"{v} {k}" for k, v in size.items()), flush=True)
            rows = compare(
                problem, arguments.folder.resolve(), chosen, arguments.rounds, arguments.repeats, arguments.limit
            )
            show(rows)
            tables.append({"mesh": mesh, "element": elements, **size, "codes": rows, **verdicts(rows)})
            print(json.dumps(verdicts(rows)), flush=True)
    if arguments.write:
        result = {
            "date": datetime.datetime.now(datetime.UTC).date().isoformat(),
            "machine": f"{platform.machine()}, {os.cpu_count()} shared cores, one thread; CPU seconds",
            "problems": tables,
        }
        path = Path(__file__).parent / "results" / "peers.json"
        path.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
