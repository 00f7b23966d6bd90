"""Does the answer depend on the mesh? A family of meshes of one torso, five elements on it, and what each costs.

``python benchmarks/mesh_convergence.py [--spacing 39 30 24.5 17 12.6] [--element ...] [--cache FOLDER] [--write]``

Every mesh is built by tools/build_torso.py, tied nodes included, with distances that shrink together; large ones are
kept in a cache outside the repository. 60 N push rib 8 on three-point supports, at the default ratios and at bending
0.10, tissue 0.01. Elements:

    ten-node        ten-node tetrahedra, lambda tied to mu: what the package uses
    linear          linear tetrahedra on the same nodes (each ten-node one split into eight), lambda tied to mu
    literal         the same with the ratio on mu alone, the paper's reading: it locks
    nodal-averaged  volumes averaged at nodes, condensed (benchmarks/elements.py)
    mixed           the same as a saddle of displacements and pressures

A row is an equilibrium: change of tilt, its values by level, RMS displacement of the vertebrae, smallest J at
integration points and at nodes, CPU s of one Newton step (assembly, factorisation, solve). ``--write`` merges the rows
into benchmarks/results/mesh_convergence.json and draws docs/images/mesh_convergence.png; rows of another model
(stiffness or template) are dropped. ``--summary`` only evaluates what is stored.

The limit is that of the ten-node family. Grid convergence index after Roache (1998), safety factor 1.25, with distances
in proportion to the cube root of 1 / nodes.
"""

from __future__ import annotations

import argparse
import datetime
import hashlib
import json
import os
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from elements import Form, VolumeAveraged, linear_torso
from scipy.optimize import brentq

from spinestiff.anatomy.stiffness import DEFAULT_YOUNG_MPA, StiffnessRatios, stiffness_ratios
from spinestiff.anatomy.template.assemble import assemble, build_skeleton
from spinestiff.anatomy.torso import TorsoModel, TorsoState
from spinestiff.imaging.features import silhouette_choice, state_features
from spinestiff.imaging.projection import frontal_view
from spinestiff.mechanics.equilibrium import EquilibriumProblem
from spinestiff.mechanics.loads import rib_push
from spinestiff.mechanics.supports import three_point_supports
from spinestiff.mechanics.tissue import smallest_nodal_jacobian
from spinestiff.study.metrics import cobb_change, tilts

ROOT = Path(__file__).parent.parent
sys.path.insert(0, str(ROOT / "tools"))

import build_torso  # noqa: E402
from tissue_mesh import HalfMesh, half_mesh, mirror, quadratic  # noqa: E402

RESULTS = Path(__file__).parent / "results" / "mesh_convergence.json"
FIGURE = ROOT / "docs" / "images" / "mesh_convergence.png"
SPACINGS = (39.0, 30.0, 24.5, 17.0, 12.6)
STATES = {"default": {}, "soft": {"lateral_bending": 0.10, "tissue": 0.01}}
LITERAL = {"lateral_bending": 0.10, "tissue_mu": 0.01}
ELEMENTS = ("ten-node", "linear", "literal", "nodal-averaged", "mixed")
FORMS = {"nodal-averaged": Form.CONDENSED, "mixed": Form.MIXED}
SIDE, LEVEL, FORCE_N = "right", 8.0, 60.0
SAFETY = 1.25
ASKED = 0.05  # how near to the limit an answer shall lie


def cache_folder() -> Path:
    """Where meshes are kept by default."""
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "spinestiff" / "meshes"


def _digest(*patterns: str) -> str:
    files = [path for pattern in patterns for path in sorted(ROOT.glob(pattern))]
    return hashlib.sha256(b"".join(path.read_bytes() for path in files)).hexdigest()[:12]


def family_torso(inside: float, cache: Path, near: float = build_torso.NEAR) -> TorsoModel:
    """The template on the mesh with ``inside`` mm between points, built where the cache does not hold it yet."""
    coarse = build_torso.SPACINGS["coarse"]
    spacing = coarse if inside == coarse.inside else build_torso.family_spacing(inside)
    digest = _digest("tools/*.py", "src/spinestiff/anatomy/template/*.py")
    skeleton = build_skeleton()
    cache.mkdir(parents=True, exist_ok=True)
    halved, tied = cache / f"half_{inside:g}_{digest}.npz", cache / f"tied_{inside:g}_{near:g}_{digest}.npz"
    if not halved.exists():
        half = half_mesh(skeleton, spacing, build_torso.SEED)
        np.savez(halved, points=half.points, tetrahedra=half.tetrahedra, place=half.place, bone=half.bone)
    if not tied.exists():
        with np.load(halved) as kept:
            half = HalfMesh(kept["points"], kept["tetrahedra"], kept["place"], kept["bone"])
        nodes, elements, bones = quadratic(*mirror(half), skeleton, near * inside)
        np.savez(tied, nodes=nodes, elements=elements, bones=bones)
    with np.load(tied) as kept:
        return assemble(skeleton, kept["nodes"], kept["elements"], kept["bones"])


def model() -> str:
    """What the rows of one table have in common: stiffnesses, template, supports, mesh tool."""
    sources = _digest("tools/*.py", "src/spinestiff/anatomy/**/*.py", "src/spinestiff/mechanics/supports.py")
    return f"{sources}, {DEFAULT_YOUNG_MPA:g} MPa"


class Observation:
    """What is read from an equilibrium of one torso."""

    def __init__(self, torso: TorsoModel) -> None:
        self.torso = torso
        self.view = frontal_view(centre=(0.0, 200.0, 0.0))
        self.choice = silhouette_choice(torso, self.view, torso.rest_pose)
        self.rest = self._tilts(torso.rest_pose)

    def of(self, state: TorsoState) -> dict[str, Any]:
        """Largest change of tilt and by level, degrees, and RMS displacement of the vertebrae, mm."""
        pushed, bones = self._tilts(state), self.torso.vertebra_bones
        moved = state.bone_positions[bones] - self.torso.rest_pose.bone_positions[bones]
        levels = np.degrees(0.5 * (pushed.superior + pushed.inferior - self.rest.superior - self.rest.inferior))
        return {
            "tilt_deg": abs(cobb_change(self.rest, pushed).tilt),
            "rms_mm": float(np.sqrt(np.mean(np.sum(moved**2, axis=1)))),
            "levels_deg": levels.round(4).tolist(),
        }

    def _tilts(self, state: TorsoState) -> Any:
        corners = state_features(self.torso, self.view, state, self.choice).corners
        return tilts(self.torso.vertebrae, corners, self.view)


def step_cpu(problem: EquilibriumProblem, state: TorsoState, ratios: StiffnessRatios, load: Any) -> list[float]:
    """CPU s of assembly, factorisation and solve of a Newton step at a state; on small meshes medians of three."""
    stiffness, terms = problem.potential.stiffness(ratios), problem.all_terms(load)
    times = []
    for _ in range(3 if problem.potential.dofs < 60_000 else 1):
        marks = [time.process_time()]
        gradient, _ = problem.free_gradient(state, stiffness, terms)
        values = problem.potential.hessian(state, stiffness, terms)
        marks.append(time.process_time())
        factor = problem.numeric_factor(values)
        marks.append(time.process_time())
        factor.solve(gradient)
        marks.append(time.process_time())
        times.append(np.diff(marks))
    return np.median(times, axis=0).tolist()


def solve(torso: TorsoModel, element: str, state: str, torso_linear: TorsoModel) -> dict[str, Any]:
    """One row, without mesh and date."""
    ratios = stiffness_ratios(LITERAL if element == "literal" else STATES[state])
    on = torso if element == "ten-node" else torso_linear
    supports, load = three_point_supports(on, SIDE), rib_push(on, SIDE, LEVEL, FORCE_N)
    problem = EquilibriumProblem(on, supports)
    began = time.process_time()
    found = problem.solve(load, ratios).require()
    row = {"cpu_s": time.process_time() - began, "factorisations": found.factorisations}
    if element in FORMS:
        # From the linear tetrahedra's state: Newton's path from rest is not what is compared.
        averaged = VolumeAveraged(on, supports, ratios, FORMS[element])
        solved = averaged.solve(load, found.state)
        row = {"step_cpu_s": list(solved.step_cpu_s), "minimum": solved.minimum}
        row |= {"smallest_j": solved.smallest_j, "smallest_nodal_j": solved.smallest_nodal_j}
        return row | Observation(on).of(solved.state)
    nodes = problem.potential.nodes(found.state)
    row["step_cpu_s"] = step_cpu(problem, found.state, ratios, load)
    row["smallest_j"] = found.smallest_j
    row["smallest_nodal_j"] = smallest_nodal_jacobian(on.tissue.rest_positions, nodes, on.tissue.elements)
    return row | Observation(on).of(found.state)


def convergence(rows: list[dict[str, Any]], state: str, key: str = "tilt_deg") -> dict[str, Any]:
    """Limit of the ten-node family in a state, its uncertainty, and how far from it every mesh lies.

    From the three finest meshes. The observed order is taken where they converge monotonically with one between 0.5 and
    2. Else the order is 1, that of nodes which ride on bones or do not, the extrapolation is that of the outer two, and
    ``scatter`` says how far the middle one lies off it: each mesh meets the bones at other places.
    """
    family = sorted((r for r in rows if r["element"] == "ten-node" and r["state"] == state), key=lambda r: r["nodes"])
    values = np.array([r[key] for r in family])
    h = np.array([r["nodes"] for r in family], dtype=float) ** (-1.0 / 3.0)
    observed, order, other = _observed_order(h[-3:], values[-3:]), 1.0, -3
    if observed is not None and 0.5 <= observed <= 2.0:
        order, other = observed, -2
    limit, share = _extrapolated(h, values, order, other)
    between = limit + (values[-1] - limit) * (h[-2] / h[-1]) ** order
    return {
        "state": state,
        "nodes": [r["nodes"] for r in family],
        key: values.round(4).tolist(),
        "observed_order": None if observed is None else round(observed, 2),
        "order": round(order, 2),
        "from_nodes": [family[other]["nodes"], family[-1]["nodes"]],
        "limit": round(float(limit), 4),
        "gci": round(float(SAFETY * share * abs(values[-1] - values[other]) / abs(values[-1])), 4),
        "scatter": round(float(abs(values[-2] - between) / abs(limit)), 4),
        "over_limit": (values / limit).round(4).tolist(),
    }


def _extrapolated(h: np.ndarray, values: np.ndarray, order: float, other: int) -> tuple[Any, float]:
    # Richardson's extrapolation from the finest mesh and the ``other`` one.
    share = 1.0 / ((h[other] / h[-1]) ** order - 1.0)
    return values[-1] + share * (values[-1] - values[other]), share


def _observed_order(h: np.ndarray, values: np.ndarray) -> float | None:
    # Of three meshes, coarse to fine, refined by ratios that may differ; None where they do not converge monotonically.
    if len(values) < 3:
        return None
    coarse, fine = values[1] - values[0], values[2] - values[1]
    if coarse * fine <= 0.0:
        return None

    def miss(p: float) -> float:
        return float((h[0] ** p - h[1] ** p) / (h[1] ** p - h[2] ** p) - coarse / fine)

    low, high = 0.05, 8.0
    if miss(low) * miss(high) > 0.0:
        return None
    return float(brentq(miss, low, high))


def levels_over_limit(rows: list[dict[str, Any]], state: str, levels: slice = slice(0, 5)) -> dict[str, list[float]]:
    """Tilt by level (T1 to T5) of every ten-node mesh over the limit's, extrapolated as the largest change is."""
    family = sorted((r for r in rows if r["element"] == "ten-node" and r["state"] == state), key=lambda r: r["nodes"])
    h = np.array([r["nodes"] for r in family], dtype=float) ** (-1.0 / 3.0)
    found = convergence(rows, state)
    other = found["nodes"].index(found["from_nodes"][0])
    values = np.array([r["levels_deg"] for r in family])[:, levels]
    limit, _ = _extrapolated(h, values, found["order"], other)
    return {str(r["nodes"]): row.round(3).tolist() for r, row in zip(family, values / limit)}


def _solver_cpu(row: dict[str, Any]) -> float:
    # Factorisation and solve of one Newton step, without assembly: the other forms' is SciPy's, not made to be fast.
    return float(sum(row["step_cpu_s"][1:]))


def time_to(rows: list[dict[str, Any]], limit: float, state: str = "soft") -> dict[str, dict[str, float] | None]:
    """For each element the smallest mesh from which on it stays within ``ASKED`` of the limit, and its factorisation.

    Where no mesh of the family does, the size is extrapolated from the finest two (errors and CPU as powers of nodes).
    """
    found: dict[str, dict[str, float] | None] = {}
    for element in ELEMENTS:
        own = sorted((r for r in rows if r["element"] == element and r["state"] == state), key=lambda r: r["nodes"])
        if len(own) < 2:
            continue
        error = np.array([abs(r["tilt_deg"] / limit - 1.0) for r in own])
        cpu = np.array([_solver_cpu(r) for r in own])
        nodes = np.array([r["nodes"] for r in own], dtype=float)
        near = np.flatnonzero(error > ASKED)
        first = 0 if not len(near) else int(near[-1]) + 1
        if first < len(own):
            found[element] = {"nodes": int(nodes[first]), "solver_cpu_s": round(float(cpu[first]), 3)}
            continue
        slope = np.log(error[-1] / error[-2]) / np.log(nodes[-1] / nodes[-2])
        if slope >= -0.1:
            found[element] = None
            continue
        wanted = nodes[-1] * (ASKED / error[-1]) ** (1.0 / slope)
        growth = np.log(cpu[-1] / cpu[-2]) / np.log(nodes[-1] / nodes[-2])
        cost = cpu[-1] * (wanted / nodes[-1]) ** growth
        found[element] = {"nodes_extrapolated": round(float(wanted), -3), "solver_cpu_s": round(float(cost), 2)}
    return found


def summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Limits, distances from them and costs."""
    done = {state: convergence(rows, state) for state in STATES}
    return {
        "convergence": list(done.values()),
        "rms_mm": [convergence(rows, state, "rms_mm") for state in STATES],
        "t1_to_t5_over_limit": {state: levels_over_limit(rows, state) for state in STATES},
        "to_5_percent": time_to(rows, done["soft"]["limit"]),
    }


def draw(rows: list[dict[str, Any]], path: Path) -> None:
    """Tilt against the spacing of nodes, and error against the CPU time of a factorisation, in the soft state."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    colours = dict(zip(ELEMENTS, ("#0072b2", "#e69f00", "#999999", "#009e73", "#cc79a7")))
    marks = dict(zip(ELEMENTS, "osvD^"))
    found = convergence(rows, "soft")
    limit, band = found["limit"], found["gci"] * found[("tilt_deg")][-1]
    figure, (left, right) = plt.subplots(1, 2, figsize=(10.0, 4.2), layout="constrained")
    left.axhspan(limit - band, limit + band, color=colours["ten-node"], alpha=0.15, label="limit ± GCI")
    for element in ELEMENTS:
        own = sorted((r for r in rows if r["element"] == element and r["state"] == "soft"), key=lambda r: r["nodes"])
        if not own:
            continue
        # 26 l of tissue; the node spacing is the edge of the cube that belongs to a node.
        h = [(26.04e6 / r["nodes"]) ** (1.0 / 3.0) for r in own]
        style = {"color": colours[element], "marker": marks[element], "markersize": 6 if element != "mixed" else 4}
        left.plot(h, [r["tilt_deg"] for r in own], label=element, **style)
        error = [max(100.0 * abs(r["tilt_deg"] / limit - 1.0), 0.01) for r in own]
        right.loglog([_solver_cpu(r) for r in own], error, label=element, **style)
    left.set(
        xlim=(0.0, None), ylim=(0.0, None), xlabel="distance between nodes, mm", ylabel="largest change of tilt, deg"
    )
    right.axhline(100.0 * ASKED, color="black", linewidth=0.8, linestyle="--")
    right.text(right.get_xlim()[0], 105.0 * ASKED, " 5 %", va="bottom")
    right.set(xlabel="CPU time of one factorisation and solve, s", ylabel="distance from the limit, %")
    left.legend(fontsize=8, loc="lower left")
    for axes in (left, right):
        axes.grid(alpha=0.3)
        axes.spines[["top", "right"]].set_visible(False)
    figure.suptitle("Bending 0.10, tissue 0.01, 60 N at rib 8", fontsize=11)
    figure.savefig(path, dpi=130)
    plt.close(figure)


def stored() -> dict[str, Any]:
    """The file of results, or an empty one where it holds another model's."""
    if RESULTS.exists():
        kept: dict[str, Any] = json.loads(RESULTS.read_text(encoding="utf-8"))
        if kept.get("model") == model():
            return kept
    return {"date": "", "model": model(), "load": f"{FORCE_N:g} N at rib {LEVEL:g}, {SIDE}", "rows": []}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--spacing", type=float, nargs="+", default=list(SPACINGS), help="mm between points inside")
    parser.add_argument("--element", nargs="+", choices=ELEMENTS, default=list(ELEMENTS))
    parser.add_argument("--state", nargs="+", choices=sorted(STATES), default=list(STATES))
    parser.add_argument("--cache", type=Path, default=cache_folder(), help="folder for large meshes")
    parser.add_argument("--write", action="store_true", help="merge the rows into benchmarks/results/, draw the figure")
    parser.add_argument("--summary", action="store_true", help="evaluate what is stored")
    arguments = parser.parse_args()
    result = stored()
    for inside in () if arguments.summary else arguments.spacing:
        torso = family_torso(inside, arguments.cache)
        linear = linear_torso(torso)
        for element in arguments.element:
            for state in arguments.state:
                if element not in ("ten-node", "linear") and state != "soft":
                    continue
                row = {"spacing_mm": inside, "nodes": len(torso.tissue.rest_positions), "element": element}
                row |= {"state": state, **solve(torso, element, state, linear)}
                print(json.dumps({k: v for k, v in row.items() if k != "levels_deg"}), flush=True)
                same = [(r["spacing_mm"], r["element"], r["state"]) for r in result["rows"]]
                if (inside, element, state) in same:
                    result["rows"].pop(same.index((inside, element, state)))
                result["rows"].append(row)
                if arguments.write:
                    result["date"] = datetime.datetime.now(datetime.UTC).date().isoformat()
                    RESULTS.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    result["summary"] = summary(result["rows"])
    print(json.dumps(result["summary"], indent=1))
    if arguments.write:
        RESULTS.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
        draw(result["rows"], FIGURE)


if __name__ == "__main__":
    main()
