"""Small pictures of a problem and of an equilibrium, for notebooks."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from spinestiff.anatomy.picture import draw_front
from spinestiff.anatomy.state import TorsoState
from spinestiff.arrays import Floats
from spinestiff.mechanics.result import Equilibrium
from spinestiff.mechanics.system import System
from spinestiff.shown import as_html

SMALL = (2.4, 3.2)  # inches
ARROW_MM = 60.0  # of the largest reaction
BONE, TISSUE, HELD, FORCE = "#3B4A5A", "#C9CED6", "#0072B2", "#D55E00"


def problem_figure(problem: System) -> Figure:
    """The torso from the front, with the points that its supports hold."""
    figure = Figure(figsize=SMALL, layout="constrained")
    axis = figure.add_subplot()
    torso = problem.torso
    draw_front(axis, torso)
    supports = problem.supports
    springs = supports.springs.points.positions(torso.rest_pose)
    bones = torso.rest_pose.bone_positions[supports.held.any(1)]
    points = np.vstack([springs, bones])
    axis.plot(points[:, 0], points[:, 1], "s", color=HELD, markersize=4.0, linestyle="none")
    axis.set_axis_off()
    return figure


def equilibrium_figure(equilibrium: Equilibrium) -> Figure:
    """Where bones and free nodes are, from the front, and the supports' forces as arrows."""
    figure = Figure(figsize=SMALL, layout="constrained")
    axis = figure.add_subplot(aspect="equal")
    draw_state(axis, equilibrium.state)
    forces: Floats = np.array([one.force for one in equilibrium.reactions]).reshape(-1, 3)
    points: Floats = np.array([one.point for one in equilibrium.reactions]).reshape(-1, 3)
    largest = float(np.abs(forces[:, :2]).max(initial=0.0))
    if largest > 0.0:
        arrows = ARROW_MM / largest * forces
        axis.quiver(
            points[:, 0], points[:, 1], arrows[:, 0], arrows[:, 1],
            angles="xy", scale_units="xy", scale=1.0, color=FORCE, width=0.012, zorder=4,
        )  # fmt: skip
    axis.set_axis_off()
    return figure


def draw_state(axis: Axes, state: TorsoState) -> None:
    """Bones as dots over free nodes, from the front."""
    axis.plot(*state.tissue_positions[:, :2].T, ".", color=TISSUE, markersize=1.0)
    axis.plot(*state.bone_positions[:, :2].T, "o", color=BONE, markersize=2.5)


def html_of_problem(problem: System) -> str:
    """As a notebook shows it."""
    held, springs = len(problem.held), dict.fromkeys(problem.supports.names)
    rows = [
        ("bones", str(problem.potential.bones)),
        ("unknowns", str(problem.potential.dofs)),
        ("held", f"{held} degrees of freedom"),
        ("springs", ", ".join(springs) if len(springs) <= 6 else f"{len(problem.supports.names)}"),
        ("solver", problem.backend),
    ]
    return as_html(type(problem).__name__, rows, problem_figure(problem))


def html_of_equilibrium(equilibrium: Equilibrium) -> str:
    """As a notebook shows it."""
    forces: dict[str, Floats] = {}
    for one in equilibrium.reactions:
        forces[str(one.kind)] = forces.get(str(one.kind), np.zeros(3)) + one.force
    rows = [
        ("status", equilibrium.status.name),
        ("energy", f"{equilibrium.energy:.6g} N mm"),
        ("residual", f"{equilibrium.residual_norm:.1e} N"),
        ("iterations", str(equilibrium.iterations)),
        *((f"{kind} exerts", ", ".join(f"{part:.1f}" for part in force) + " N") for kind, force in forces.items()),
        *([("at fault", equilibrium.fault)] if equilibrium.fault else []),
    ]
    return as_html("Equilibrium", rows, equilibrium_figure(equilibrium))
