"""What an NVIDIA GPU makes faster: factorisations one by one and in batches, and a whole estimate (extra [gpu]).

``python benchmarks/gpu.py [--json] [--write FILE]``, on a machine with a GPU. For the coarse and the fine template
under a push, with the tangent's own values:

    processor   ms of a factorisation and of a solve by rslab on one thread, and of one of many factorisations side by
                side on as many threads as there are processors
    gpu         the same by the backend "cudss", the values' way to the GPU included; an analysis; the largest residual
                (relative, scaled) of solutions without refinement
    batches     by cuDSS's uniform batch, ms a matrix: so many matrices of one pattern factorised, and solved, at once;
                whether cuDSS tells their inertia
    estimate    the subject of estimator_work.py: search from one start, and intervals: s on the wall, CPU s, and how
                far apart both ends are, in standard deviations
"""

from __future__ import annotations

import argparse
import datetime
import json
import logging
import os
import platform
import statistics
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
from estimator_work import MOST_EVALUATIONS, subject

from spinestiff.anatomy.stiffness import stiffness_ratios
from spinestiff.anatomy.template import MESHES, template_torso
from spinestiff.estimation.emulator import Place
from spinestiff.estimation.mode import likeliest
from spinestiff.estimation.profiles import likely_ratios
from spinestiff.mechanics import cudss as gpu
from spinestiff.mechanics.equilibrium import EquilibriumProblem
from spinestiff.mechanics.factor import Analysis
from spinestiff.mechanics.loads import rib_push
from spinestiff.mechanics.supports import three_point_supports

RESULTS = Path(__file__).parent / "results" / "gpu.json"
BATCHES = (1, 2, 4, 8, 16, 32)
START = (0.3, 0.08)


def milliseconds(action: Callable[..., object], *given: object, repeats: int = 5) -> float:
    """Median on the wall, after one run that is not counted."""
    action(*given)
    times = []
    for _ in range(repeats):
        began = time.perf_counter()
        action(*given)
        times.append(1e3 * (time.perf_counter() - began))
    return round(statistics.median(times), 3)


class Tangent:
    """A tangent of a template under a push, in the units of the solver."""

    def __init__(self, mesh: str) -> None:
        torso = template_torso(157.0, mesh)
        problem = EquilibriumProblem(torso, three_point_supports(torso, "left"), backend="rslab")
        ratios = stiffness_ratios({"lateral_bending": 0.1, "tissue": 0.03}, torso.joints.kinds)
        load = rib_push(torso, "left", 8.0, 40.0)
        state = problem.solve(load, ratios).require().state
        values = problem.potential.hessian(state, problem.potential.stiffness(ratios), problem.all_terms(load))
        values[problem._held_entries], values[problem._held_diagonal] = 0.0, 1.0
        self.pattern = problem.potential.pattern
        self.analysis = problem._analysis
        assert isinstance(self.analysis, Analysis)
        self.values = values
        self.scaled = values * self.analysis._scale_of_value
        self.size = len(self.pattern.indptr) - 1
        self.rhs = np.random.default_rng(0).normal(size=self.size)

    def residual(self, solution: np.ndarray, rhs: np.ndarray) -> float:
        """Of a solution in the units of the solver."""
        product = self.analysis.factor(self.values)._product(solution)
        return float(np.abs(product - rhs).max() / np.abs(rhs).max())


def on_processor(tangent: Tangent) -> dict[str, float]:
    """By rslab."""
    symbolic, many = tangent.analysis._symbolic, os.cpu_count() or 1
    factor = symbolic.factor(tangent.scaled, threads=1)
    found = {
        "factorisation_ms": milliseconds(lambda: symbolic.factor(tangent.scaled, threads=1)),
        "solve_ms": milliseconds(factor.solve, tangent.rhs, repeats=20),
    }
    with ThreadPoolExecutor(many) as pool:
        began = time.perf_counter()
        list(pool.map(lambda _: symbolic.factor(tangent.scaled, threads=1), range(4 * many)))
        each = 1e3 * (time.perf_counter() - began) / (4 * many)
    return found | {"side_by_side": many, "side_by_side_ms": round(each, 3)}


def on_gpu(tangent: Tangent) -> dict[str, float]:
    """By the backend "cudss"."""
    analysis = gpu.CudssAnalysis(tangent.pattern.indptr, tangent.pattern.indices)
    slot = gpu._Slot(analysis._indptr, analysis._indices)
    slot.factorise(tangent.scaled)
    return {
        "analysis_ms": milliseconds(gpu._Slot, analysis._indptr, analysis._indices, repeats=3),
        "factorisation_ms": milliseconds(slot.factorise, tangent.scaled, repeats=20),
        "solve_ms": milliseconds(slot.solve, tangent.rhs, repeats=20),
        "residual": tangent.residual(slot.solve(tangent.rhs), tangent.rhs),
    }


class UniformBatch:
    """So many matrices of one pattern, which cuDSS factorises and solves at once."""

    def __init__(self, indptr: np.ndarray, indices: np.ndarray, count: int) -> None:
        from nvmath.bindings import cudss

        self.cudss, self.count, self.size = cudss, count, len(indptr) - 1
        owned = self.owned = gpu._Owned()
        self.stream = owned.stream()
        handle = self.handle = owned.keep(cudss.destroy, cudss.create())
        cudss.set_stream(self.handle, self.stream)
        self.settings = owned.keep(cudss.config_destroy, cudss.config_create())
        size = int(cudss.ConfigParam.UBATCH_SIZE)
        number = np.array([count], cudss.get_config_param_dtype(size))
        cudss.config_set(self.settings, size, number.ctypes.data, number.nbytes)
        self.data = owned.keep(lambda data: cudss.data_destroy(handle, data), cudss.data_create(handle))
        self.values = owned.room(8 * count * len(indices))
        self.rhs, self.solution = (owned.room(8 * count * self.size) for _ in range(2))
        rows, columns = (owned.copied(part, self.stream) for part in (indptr, indices))
        n = self.size
        kind, of_vector = gpu.kind_of_matrix(cudss), gpu.kind_of_vector(cudss)
        matrix = cudss.matrix_create_csr(n, n, len(indices), rows, 0, columns, self.values, *kind)
        vectors = [cudss.matrix_create_dn(n, 1, n, at, *of_vector) for at in (self.solution, self.rhs)]
        self.matrices = [owned.keep(cudss.matrix_destroy, one) for one in (matrix, *vectors)]
        self.run(cudss.Phase.ANALYSIS)

    def run(self, phase: int) -> None:
        self.cudss.execute(self.handle, int(phase), self.settings, self.data, *self.matrices)
        self.owned.wait(self.stream)

    def factorise(self, values: np.ndarray) -> None:
        self.owned.copy_in(self.values, values, self.stream)
        self.run(self.cudss.Phase.FACTORIZATION)

    def solve(self, rhs: np.ndarray) -> np.ndarray:
        found = np.empty_like(rhs)
        self.owned.copy_in(self.rhs, rhs, self.stream)
        self.run(self.cudss.Phase.SOLVE)
        self.owned.copy_out(found, self.solution, self.stream)
        return found

    def tells_inertia(self) -> bool:
        found, written = np.zeros(2 * self.count, np.int32), np.zeros(1, np.uint64)
        try:
            self.cudss.data_get(
                self.handle,
                self.data,
                int(self.cudss.DataParam.INERTIA),
                found.ctypes.data,
                found.nbytes,
                written.ctypes.data,
            )
        except self.cudss.cuDSSError:
            return False
        return found[::2].tolist() == [self.size] * self.count


def in_batches(tangent: Tangent) -> list[dict[str, Any]]:
    """By cuDSS's uniform batch."""
    random, rows = np.random.default_rng(1), []
    indptr, indices = (part.astype(np.int32) for part in (tangent.pattern.indptr, tangent.pattern.indices))
    for count in BATCHES:
        batch = UniformBatch(indptr, indices, count)
        values, rhs = np.tile(tangent.scaled, (count, 1)), random.normal(size=(count, tangent.size))
        factor, solve = milliseconds(batch.factorise, values), milliseconds(batch.solve, rhs)
        rows.append(
            {
                "matrices": count,
                "factorisation_ms": round(factor / count, 3),
                "solve_ms": round(solve / count, 3),
                "inertia": batch.tells_inertia(),
                "residual": max(tangent.residual(*pair) for pair in zip(batch.solve(rhs), rhs)),
            }
        )
        print(json.dumps(rows[-1]), flush=True)
        batch.owned.free()
    return rows


class Left(logging.Handler):
    """What the GPU did not do."""

    def __init__(self) -> None:
        super().__init__()
        self.reasons: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        self.reasons.append(record.getMessage())


def estimated(mesh: str, backend: str) -> dict[str, Any]:
    """Search and intervals of one subject."""
    os.environ["SPINESTIFF_SOLVER"] = backend
    left = Left()
    logging.getLogger("spinestiff.mechanics.factor").addHandler(left)
    problem = subject(0, mesh)
    walls, cpus = [time.perf_counter()], [time.process_time()]
    found = likeliest(problem, problem.solve(np.log(START), np.zeros(len(problem.unknowns))), MOST_EVALUATIONS)
    walls, cpus = [*walls, time.perf_counter()], [*cpus, time.process_time()]
    likely, _ = likely_ratios(problem, found, [Place(*place) for place in found.visited])
    walls, cpus = [*walls, time.perf_counter()], [*cpus, time.process_time()]
    return {
        "status": found.status.name,
        "left_to_the_processor": left.reasons,
        "factorisations": problem.trial_set.cost.factorisations,
        "search_s": round(walls[1] - walls[0], 2),
        "search_cpu_s": round(cpus[1] - cpus[0], 2),
        "intervals_s": round(walls[2] - walls[1], 2),
        "intervals_cpu_s": round(cpus[2] - cpus[1], 2),
        "log_ratios": found.point.log_ratios.tolist(),
        "log_ends": np.stack([likely.low, likely.high]).tolist(),
    }


def name_of_gpu() -> str:
    from cuda.bindings import runtime

    _, properties = runtime.cudaGetDeviceProperties(0)
    return properties.name.decode()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", action="store_true", help="print what is stored")
    parser.add_argument(
        "--write", type=Path, nargs="?", const=RESULTS, metavar="FILE", help="results/gpu.json if left out"
    )
    asked = parser.parse_args()
    if asked.json:
        print(RESULTS.read_text(encoding="utf-8"), end="")
        return
    try:
        gpu.require_gpu()
    except gpu.GpuFailure as error:
        parser.error(str(error))
    result: dict[str, Any] = {
        "date": datetime.date.today().isoformat(),
        "gpu": name_of_gpu(),
        "machine": f"{platform.machine()}, {os.cpu_count()} processors",
        "meshes": {},
    }
    for mesh in MESHES:
        tangent = Tangent(mesh)
        row: dict[str, Any] = {"unknowns": tangent.size, "processor": on_processor(tangent), "gpu": on_gpu(tangent)}
        print(json.dumps({mesh: row}), flush=True)
        row["batches"] = in_batches(tangent)
        row["estimate"] = {}
        for backend in ("cudss", "rslab"):
            row["estimate"][backend] = estimated(mesh, backend)
            print(json.dumps(row["estimate"][backend]), flush=True)
        result["meshes"][mesh] = row
        if asked.write:
            asked.write.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
