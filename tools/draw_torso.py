"""Draw the template at true proportions (needs matplotlib): the reference body, a row of bodies, the joints' frames.

python tools/draw_torso.py [--only torso bodies joint_frames] [--mesh fine] [--out docs/images]
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from spinestiff.anatomy.picture import (
    DPI,
    FRONT,
    LANDSCAPE,
    SIDE,
    View,
    draw_bones,
    draw_skin,
    draw_view,
    joint_places,
    torso_figure,
)
from spinestiff.anatomy.template import template_torso
from spinestiff.anatomy.torso import TorsoModel

AXIS_COLOURS = ("#d02020", "#208020", "#2040d0")


def draw_torso(mesh: str) -> Figure:
    """The reference body from three sides."""
    return torso_figure(template_torso(157.0, mesh))


def draw_bodies(mesh: str) -> Figure:
    """Bodies of four ages and both sexes, front and side, at one scale."""
    bodies = {
        "girl, 8 years, 120 cm": template_torso(120.0, mesh, age_years=8.0, sex="female"),
        "girl, 13 years, 157 cm": template_torso(157.0, mesh, age_years=13.0, sex="female"),
        "woman, 165 cm": template_torso(165.0, mesh, age_years=30.0, sex="female"),
        "man, 190 cm": template_torso(190.0, mesh, age_years=30.0, sex="male"),
    }
    figure = Figure(figsize=(17.0, 12.3), layout="constrained")
    axes = figure.subplots(2, len(bodies))
    for column, (title, torso) in zip(axes.T, bodies.items()):
        for ax, view in zip(column, (FRONT, SIDE)):
            draw_view(ax, torso, view)
            ax.set_xlim(-250.0, 250.0)
            ax.set_ylim(-200.0, 520.0)
        column[0].set_title(title, fontsize=11)
    for ax, view in zip(axes[:, 0], (FRONT, SIDE)):
        ax.set_ylabel(f"{view[0]}; mm above the sacral endplate", fontsize=9)
    return figure


def draw_frames(ax: Axes, torso: TorsoModel, view: View, kinds: tuple[str, ...] | None, length: float) -> None:
    """X, Y and Z of the joints as red, green and blue lines."""
    _, across, sign, _ = view
    centres, axes = joint_places(torso)
    chosen = [kinds is None or kind in kinds for kind in torso.joints.kinds]
    for axis, colour in enumerate(AXIS_COLOURS):
        ends = centres + length * axes[:, :, axis]
        lines = np.stack([centres, ends], 1)[chosen][..., [across, 1]] * [sign, 1.0]
        ax.add_collection(LineCollection(lines, colors=colour, linewidths=1.6))
    ax.plot(sign * centres[chosen, across], centres[chosen, 1], ".", color="black", markersize=3.5)


def draw_joint_frames(mesh: str) -> Figure:
    """The frames of all joints: the whole from the front and the side, and the shoulder and sternum near."""
    torso = template_torso(157.0, mesh)
    figure = Figure(figsize=LANDSCAPE, layout="constrained")
    axes = figure.subplots(1, 3, width_ratios=(1.35, 0.85, 1.4))
    for ax, view in zip(axes, (FRONT, SIDE, FRONT)):
        draw_skin(ax, torso, view[1], view[2])
        draw_bones(ax, torso, view, 0.45)
        draw_frames(ax, torso, view, ("thoracic", "lumbar") if view == SIDE else None, 12.0 if ax is axes[2] else 16.0)
        ax.set_title(view[0], fontsize=10)
    axes[1].set_title(f"{SIDE[0]}: intervertebral joints", fontsize=10)
    axes[2].set_title("left ribs, sternum and shoulder, from the front", fontsize=10)
    axes[2].set_xlim(-35.0, 175.0)
    axes[2].set_ylim(110.0, 412.0)
    for colour, name, height in zip(AXIS_COLOURS, ("X", "Y", "Z"), (0.97, 0.935, 0.90)):
        axes[0].text(0.02, height, name, color=colour, transform=axes[0].transAxes, weight="bold", va="top")
    axes[0].set_ylabel("mm above the sacral endplate", fontsize=8)
    return figure


PICTURES = {"torso": draw_torso, "bodies": draw_bodies, "joint_frames": draw_joint_frames}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="+", choices=sorted(PICTURES), default=sorted(PICTURES))
    parser.add_argument("--mesh", choices=("coarse", "fine"), default="fine")
    parser.add_argument("--out", type=Path, default=Path(__file__).parent.parent / "docs" / "images")
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    for name in arguments.only:
        PICTURES[name](arguments.mesh).savefig(arguments.out / f"{name}.png", dpi=DPI, pil_kwargs={"optimize": True})


if __name__ == "__main__":
    main()
