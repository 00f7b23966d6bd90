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

The limit is that of the ten-node family, a line fitted to several meshes of each size. Grid convergence index after
Roache (1998), safety factor 1.25, with distances in proportion to the cube root of 1 / nodes.
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

from spinestiff.anatomy.state import TorsoState
from spinestiff.anatomy.stiffness import DEFAULT_YOUNG_MPA, StiffnessRatios, stiffness_ratios
from spinestiff.anatomy.template.assemble import assemble, build_skeleton
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.curves.tilts import cobb_change, tilts
from spinestiff.imaging.features import silhouette_shares, state_features
from spinestiff.imaging.projection import frontal_view
from spinestiff.mechanics.equilibrium import EquilibriumProblem
from spinestiff.mechanics.loads import rib_push
from spinestiff.mechanics.supports import three_point_supports
from spinestiff.mechanics.tissue import smallest_nodal_jacobian

ROOT = Path(__file__).parent.parent
sys.path.insert(0, str(ROOT / "tools"))

import build_torso  # noqa: E402
from tissue_mesh import HalfMesh, half_mesh, mirror, quadratic  # noqa: E402

RESULTS = Path(__file__).parent / "results" / "mesh_convergence.json"
FIGURE = ROOT / "docs" / "images" / "mesh_convergence.png"
# The shipped coarse (39) and fine (24.5) meshes; others of about the same size lie differently about the bones.
SPACINGS = (39.0, 40.5, 37.5, 30.0, 24.5, 25.4, 23.6, 17.0, 17.5, 16.5, 12.6)
ONE_A_SIZE = (39.0, 30.0, 24.5, 17.0, 12.6)
STATES = {"default": {}, "soft": {"lateral_bending": 0.10, "tissue": 0.01}}
LITERAL = {"lateral_bending": 0.10, "tissue_mu": 0.01}
ELEMENTS = ("ten-node", "linear", "literal", "nodal-averaged", "mixed")
FORMS = {"nodal-averaged": Form.CONDENSED, "mixed": Form.MIXED}
SIDE, LEVEL, FORCE_N = "right", 8.0, 60.0
SAFETY = 1.25
ORDER, ORDERS = 1.0, np.linspace(0.5, 2.0, 16)
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
        self.shares = silhouette_shares(torso, self.view, torso.rest_pose)
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
        corners = state_features(self.torso, self.view, state, self.shares).corners
        return tilts(self.torso.vertebrae, corners, self.view)


def step_cpu(problem: EquilibriumProblem, state: TorsoState, ratios: StiffnessRatios, load: Any) -> list[float]:
    """CPU s of assembly, factorisation and solve of a Newton step at a state; on small meshes medians of three."""
    stiffness, terms = problem.potential.stiffness(ratios), problem.all_terms(load)
    times = []
    for _ in range(3 if problem.potential.dofs < 60_000 else 1):
        marks = [time.process_time()]
        gradient = problem.free(problem.potential.gradient(state, stiffness, terms))
        values = problem.potential.hessian(state, stiffness, terms)
        marks.append(time.process_time())
        factor = problem.numeric_factor(values)
        marks.append(time.process_time())
        factor.solve(gradient)
        marks.append(time.process_time())
        times.append(np.diff(marks))
    return np.median(times, axis=0).tolist()


def wanted(inside: float, element: str, state: str) -> bool:
    """Whether a row belongs to the study: every mesh with the ten-node element alone, the literal and the averaged
    elements in the soft state alone, the averaged ones (assembled in SciPy) not on meshes beyond the fine one."""
    if element == "ten-node":
        return True
    if inside not in ONE_A_SIZE or (element != "linear" and state != "soft"):
        return False
    return element not in FORMS or inside >= build_torso.SPACINGS["fine"].inside


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


def convergence(
    rows: list[dict[str, Any]], state: str, key: str = "tilt_deg", element: str = "ten-node"
) -> dict[str, Any]:
    """Limit of a family in a state, its uncertainty, and how far from it every mesh lies.

    Meshes of one size scatter, because each meets the bones at other places; so the limit is that of a line fitted to
    all of them, value = limit + a h with weights 1/h (Eca and Hoekstra 2014, J Comput Phys 262:104). Order 1 is that of
    nodes which ride on bones or do not; the scatter hides what order the figures have, so ``limit_by_order`` tells what
    others would give and ``fitted_order`` which fits best. ``gci`` is that of the finest mesh on the fitted line,
    ``standard_error`` the limit's from the scatter about it, ``scatter`` a single mesh's; all as shares of the limit.
    """
    family = _family(rows, state, element)
    values = np.array([r[key] for r in family])
    h = _spacing(family)
    fitted = float(min(ORDERS, key=lambda p: _fit(h, values, p)[1]))
    (limit, slope), scatter, error = _fit(h, values, ORDER)
    return {
        "state": state,
        "nodes": [r["nodes"] for r in family],
        key: values.round(4).tolist(),
        "order": ORDER,
        "fitted_order": round(fitted, 2),
        "limit": round(float(limit), 4),
        "limit_by_order": {f"{p:g}": round(float(_fit(h, values, p)[0][0]), 4) for p in (0.5, 1.0, 2.0)},
        "gci": round(float(SAFETY * abs(slope) * h[-1] ** ORDER / abs(limit)), 4),
        "standard_error": round(float(error / abs(limit)), 4),
        "scatter": round(float(scatter / abs(limit)), 4),
        "over_limit": (values / limit).round(4).tolist(),
    }


def _family(rows: list[dict[str, Any]], state: str, element: str = "ten-node") -> list[dict[str, Any]]:
    return sorted((r for r in rows if r["element"] == element and r["state"] == state), key=lambda r: r["nodes"])


def _spacing(family: list[dict[str, Any]]) -> np.ndarray:
    # In units of that of 1,000 nodes.
    return np.array([r["nodes"] / 1000.0 for r in family]) ** (-1.0 / 3.0)


def _fit(h: np.ndarray, values: np.ndarray, order: float) -> tuple[np.ndarray, Any, float]:
    # Limit and slope of values = limit + slope h^order, a single value's scatter, and the limit's standard error.
    weights = (1.0 / h) / (1.0 / h).mean()
    columns = np.column_stack([np.ones_like(h), h**order])
    root = np.sqrt(weights)
    found = np.linalg.lstsq(columns * root[:, None], (values.T * root).T, rcond=None)[0]
    left = values - columns @ found
    scatter = np.sqrt((weights * (left.T**2)).sum(-1) / max(len(h) - 2, 1))
    # Meshes scatter alike whatever their weight in the fit.
    gain = np.linalg.solve((columns * weights[:, None]).T @ columns, (columns * weights[:, None]).T)[0]
    return found, scatter, float(np.max(scatter) * np.linalg.norm(gain))


def levels_over_limit(rows: list[dict[str, Any]], state: str, levels: slice = slice(0, 5)) -> dict[str, list[float]]:
    """Tilt by level (T1 to T5) of every ten-node mesh over the limit's, extrapolated as the largest change is."""
    family = _family(rows, state)
    values = np.array([r["levels_deg"] for r in family])[:, levels]
    limit = _fit(_spacing(family), values, ORDER)[0][0]
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
        own = _family(rows, state, element)
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
        if slope >= -0.2:  # no figure worth extrapolating
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
        "linear_tetrahedra": [convergence(rows, state, element="linear") for state in STATES],
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
    limit, band = found["limit"], found["gci"] * found["limit"]
    figure, (left, right) = plt.subplots(1, 2, figsize=(10.0, 4.2), layout="constrained")
    left.axhspan(limit - band, limit + band, color=colours["ten-node"], alpha=0.15, label="limit ± GCI")
    for element in ELEMENTS:
        own = _family(rows, "soft", element)
        if not own:
            continue
        style = {"color": colours[element], "marker": marks[element], "markersize": 6 if element != "mixed" else 4}
        scattered = [r for r in own if r["spacing_mm"] not in ONE_A_SIZE]
        alone = {**style, "linestyle": "none", "alpha": 0.5}
        for some, look in ((scattered, alone), ([r for r in own if r not in scattered], {**style, "label": element})):
            # 26 l of tissue; the node spacing is the edge of the cube that belongs to a node.
            h = [(26.2e6 / r["nodes"]) ** (1.0 / 3.0) for r in some]
            left.plot(h, [r["tilt_deg"] for r in some], **look)
            error = [max(100.0 * abs(r["tilt_deg"] / limit - 1.0), 0.01) for r in some]
            right.loglog([_solver_cpu(r) for r in some], error, **look)
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
                if not wanted(inside, element, state):
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
