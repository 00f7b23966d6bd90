"""What the scripts of this folder share: the problem as plain arrays, and how it is timed.

Runs in every peer's own environment, so it imports nothing but NumPy.
"""

from __future__ import annotations

import argparse
import importlib.metadata
import json
import statistics
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
TOLERANCE = 1e-8  # N, largest force on a free node at which a state counts as an equilibrium
# N, for codes that measure the root of the sum of squares: about twice the largest force near a solution here
# (measured, 1.1 to 2.7), so that all stop at the same iterate.
NORM_TOLERANCE = 2e-8
MU_GROWTH = 1.05  # of the warm solve


@dataclass(frozen=True)
class Problem:
    """Tissue whose bone nodes have been moved; Psi = mu/2 (I1 - 3) - mu log J + lambda/2 (log J)^2.

    Attributes
    ----------
    points : (N, 3) mm, at rest. cells : (T, 4) or (T, 10), middles of edges 01, 12, 02, 03, 13, 23.
    fixed : (N,) bool, nodes on bones. start : (N, 3) mm displacement, on bones the prescribed one.
    mu, lambda_ : MPa. weights : (N, 3) w of the loss w . u, zero on bones.
    quadrature_points, quadrature_weights : (Q, 3), (Q,) on the unit tetrahedron.
    bone_of_node, bone_rest, bone_moved, bone_turned : which rigid bone a fixed node is on (-1: none), (B, 3) mm where
        its origin was and is, (B, 3, 3) how it turned. For codes that know rigid bones.
    """

    points: Floats
    cells: NDArray[np.int64]
    fixed: NDArray[np.bool_]
    start: Floats
    mu: float
    lambda_: float
    weights: Floats
    quadrature_points: Floats
    quadrature_weights: Floats
    bone_of_node: NDArray[np.int64]
    bone_rest: Floats
    bone_moved: Floats
    bone_turned: Floats

    @property
    def free_dofs(self) -> NDArray[np.int64]:
        """Degrees of freedom 3 node + axis of the free nodes."""
        return np.flatnonzero(~np.repeat(self.fixed, 3))

    def save(self, path: Path) -> None:
        np.savez(path, **vars(self))

    @classmethod
    def load(cls, path: Path) -> Problem:
        with np.load(path) as file:
            return cls(**{name: file[name] if file[name].ndim else float(file[name]) for name in file.files})


class Solver(ABC):
    """One code on one problem."""

    @abstractmethod
    def solve(self, mu: float, lambda_: float, start: Floats, warm: bool) -> tuple[Floats, int]:
        """Displacement (N, 3) mm at equilibrium and the number of tangents built on the way.

        With ``warm``, ``start`` is the last solution and the gradient will be asked.
        """

    @abstractmethod
    def gradient(self, weights: Floats) -> tuple[float, float]:
        """d (w . u) / d mu and / d lambda at the last solution, mm/MPa."""

    def settle(self) -> None:
        """Leave behind what a gradient at the last solution would have, for codes that use it in a warm solve."""
        return


def cpu_seconds(action: Callable[[], object]) -> float:
    began = time.process_time()
    action()
    return time.process_time() - began


def main(
    make: Callable[[Problem], Solver],
    packages: Sequence[str],
    extra: Callable[[Solver], dict[str, float]] | None = None,
) -> None:
    """Time ``make``'s solver on the problem of the command line and store figures and solutions.

    CPU seconds of all threads, medians: ``solve`` from the start, ``warm`` from the solution after mu grew by 5 %,
    ``adjoint`` the gradient there. A fit has asked the gradient at the solution before, too: what that leaves behind
    (a factor) may serve the warm solve, and is not counted twice. ``set_up`` and the first calls, which compile and
    analyse, are stored apart.
    """
    parser = argparse.ArgumentParser()
    parser.add_argument("problem", type=Path)
    parser.add_argument("result", type=Path, help="without suffix; .json and .npz are written")
    parser.add_argument("--repeats", type=int, default=3, help="at most")
    parser.add_argument("--budget", type=float, default=10.0, help="CPU seconds after which no repeat is begun")
    arguments = parser.parse_args()
    problem = Problem.load(arguments.problem)
    began = time.process_time()
    solver = make(problem)
    set_up = time.process_time() - began
    found: dict[str, tuple[Floats, int]] = {}
    gradient: list[tuple[float, float]] = []

    def solve() -> None:
        found["cold"] = solver.solve(problem.mu, problem.lambda_, problem.start, False)

    def warm() -> None:
        found["warm"] = solver.solve(MU_GROWTH * problem.mu, problem.lambda_, found["cold"][0], True)

    def adjoint() -> None:
        gradient.append(solver.gradient(problem.weights))

    actions = {"solve": solve, "settle": solver.settle, "warm": warm, "adjoint": adjoint}
    first = {name: cpu_seconds(action) for name, action in actions.items()}
    times: dict[str, list[float]] = {name: [] for name in actions}
    walls = []
    spent = 0.0
    for _ in range(arguments.repeats):
        if spent > arguments.budget:
            break
        # The cold solve goes first, so that no warm solve starts on a factor of its own result.
        for name, action in actions.items():
            wall = time.perf_counter()
            times[name].append(cpu_seconds(action))
            if name == "solve":
                walls.append(time.perf_counter() - wall)
            spent += times[name][-1]
    figures = {
        "repeats": len(walls),
        "versions": {name: importlib.metadata.version(name) for name in packages},
        "iterations": found["cold"][1],
        "warm_iterations": found["warm"][1],
        "set_up_cpu_s": set_up,
        "first_solve_cpu_s": first["solve"],
        "solve_cpu_s": statistics.median(times["solve"]),
        "solve_wall_s": statistics.median(walls),
        "warm_cpu_s": statistics.median(times["warm"]),
        "adjoint_cpu_s": statistics.median(times["adjoint"]),
        "warm_with_gradient_cpu_s": statistics.median(map(sum, zip(times["warm"], times["adjoint"]))),
        **(extra(solver) if extra else {}),
    }
    arguments.result.with_suffix(".json").write_text(json.dumps(figures), encoding="utf-8")
    np.savez(
        arguments.result.with_suffix(".npz"),
        cold=found["cold"][0],
        warm=found["warm"][0],
        gradient=np.array(gradient[-1]),
    )
