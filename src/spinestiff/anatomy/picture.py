"""A picture of a torso for people: skin, bones and joints from the front, the side and behind, at true proportions."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

from spinestiff.anatomy.points import PointsOnBones
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.arrays import Floats
from spinestiff.files import write_bytes
from spinestiff.shown import as_html

# title, world axis and sign that runs to the right of the page, direction towards the viewer
View = tuple[str, int, float, tuple[float, float, float]]
FRONT: View = ("front", 0, 1.0, (0.0, 0.0, 1.0))
SIDE: View = ("patient's right side", 2, 1.0, (-1.0, 0.0, 0.0))
REAR: View = ("rear", 0, -1.0, (0.0, 0.0, -1.0))
COLOURS = {
    "R": "#e3d5b0",
    "T": "#f0e2b6",
    "L": "#f0dca0",
    "p": "#dcc39a",
    "s": "#b9c8d6",
    "c": "#b4cdb0",
    "h": "#d3b1ab",
}
OTHER_COLOUR = "#e0d3b8"  # of bones that the template doesn't have
LANDSCAPE, DPI = (17.0, 9.0), 80


def _colour(name: str) -> tuple[float, float, float]:
    return to_rgb("#cdb4c6" if name == "sternum" else COLOURS.get(name[:1], OTHER_COLOUR))


def draw_skin(ax: Axes, torso: TorsoModel, across: int, sign: float) -> None:
    """The outline of the skin, if there is tissue, as a grey area."""
    ax.set_aspect("equal")
    skin = torso.tissue.rest_positions[torso.tissue.boundary_faces()[:, :3]]
    if not len(skin):
        return
    flat: Any = np.stack([sign * skin[..., across], skin[..., 1]], -1)
    ax.add_collection(PolyCollection(flat, facecolors="#eeeef2", edgecolors="#eeeef2", linewidths=0.3))
    ax.set_xlim(flat[..., 0].min() - 15, flat[..., 0].max() + 15)
    ax.set_ylim(flat[..., 1].min() - 15, flat[..., 1].max() + 15)
    ax.tick_params(labelsize=7)


def draw_bones(ax: Axes, torso: TorsoModel, view: View, alpha: float = 1.0) -> None:
    """The bones, shaded and sorted by depth; of a torso without bone surfaces, dots where its bones are."""
    _, across, sign, viewer = view
    if not torso.bone_surfaces:
        places = torso.rest_pose.bone_positions
        ax.plot(sign * places[:, across], places[:, 1], "o", color="#3b4a5a", markersize=4.0, alpha=alpha)
        return
    direction = np.array(viewer)
    polygons: list[Any] = []
    depth, colours = [], []
    for index, name in enumerate(torso.bone_names):
        p = torso.surface_positions(torso.rest_pose, index)[torso.bone_surfaces[index].faces]
        normal = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
        facing = normal @ direction / (np.linalg.norm(normal, axis=1) + 1e-12)
        p, facing = p[facing > 0.0], facing[facing > 0.0]
        polygons.append(np.stack([sign * p[..., across], p[..., 1]], -1))
        depth.append(p.mean(1) @ direction)
        colours.append(np.array(_colour(name)) * (0.30 + 0.70 * facing[:, None]))
    order = np.argsort(np.concatenate(depth))
    colour = np.concatenate(colours)[order]
    colour = alpha * colour + (1.0 - alpha)
    shapes: Any = np.concatenate(polygons)[order]
    ax.add_collection(PolyCollection(shapes, facecolors=colour, edgecolors=colour, linewidths=0.2))


def joint_places(torso: TorsoModel) -> tuple[Floats, Floats]:
    """World centres (J, 3) mm and world_from_joint axes (J, 3, 3)."""
    joints = torso.joints
    centres = PointsOnBones(joints.parent, joints.parent_position).positions(torso.rest_pose)
    return centres, torso.rest_pose.bone_rotations[joints.parent] @ joints.parent_axes


def draw_view(ax: Axes, torso: TorsoModel, view: View) -> None:
    """One view: skin in grey, bones, joint centres as dots."""
    _, across, sign, _ = view
    draw_skin(ax, torso, across, sign)
    draw_bones(ax, torso, view)
    centres, _ = joint_places(torso)
    ax.plot(sign * centres[:, across], centres[:, 1], ".", color="#b03030", markersize=2.5)


def torso_figure(torso: TorsoModel) -> Figure:
    """The torso at rest from three sides."""
    figure = Figure(figsize=LANDSCAPE, layout="constrained")
    axes = figure.subplots(1, 3, width_ratios=(1.5, 1.0, 1.5))
    for ax, view in zip(axes, (FRONT, SIDE, REAR)):
        draw_view(ax, torso, view)
        ax.set_title(view[0], fontsize=10)
    axes[0].set_ylabel("mm above the sacral endplate", fontsize=8)
    return figure


def small_figure(torso: TorsoModel) -> Figure:
    """The torso from the front, for a notebook."""
    figure = Figure(figsize=(2.4, 3.2), layout="constrained")
    axis = figure.add_subplot()
    draw_front(axis, torso)
    axis.set_axis_off()
    return figure


def draw_front(axis: Axes, torso: TorsoModel) -> None:
    """Skin and bones from the front."""
    draw_skin(axis, torso, 0, 1.0)
    draw_bones(axis, torso, FRONT)


def scan_figure(torso: TorsoModel, points: Floats) -> Figure:
    """Points (n, 3) mm of a skin scan over the torso's skin and bones, from the front and the side, those nearer to the
    viewer than the torso's middle in blue, those behind in pale blue."""
    figure = Figure(figsize=(12.0, 9.0), layout="constrained")
    axes = figure.subplots(1, 2, width_ratios=(1.5, 1.0))
    middle = torso.tissue.rest_positions.mean(0)
    for ax, view in zip(axes, (FRONT, SIDE)):
        title, across, sign, viewer = view
        draw_skin(ax, torso, across, sign)
        draw_bones(ax, torso, view, 0.5)
        near = (points - middle) @ np.array(viewer) > 0.0
        for part, colour in ((~near, "#9cd3f2"), (near, "#0072b2")):
            ax.plot(sign * points[part, across], points[part, 1], ".", color=colour, markersize=2.0)
        ax.set_title(title, fontsize=10)
    axes[0].set_ylabel("mm above the sacral endplate", fontsize=8)
    return figure


def draw_scan(torso: TorsoModel, points: Floats, path: Path) -> None:
    """Write ``scan_figure`` (PNG)."""
    _write(scan_figure(torso, points), path)


def draw_torso(torso: TorsoModel, path: Path) -> None:
    """Write ``torso_figure`` (PNG)."""
    _write(torso_figure(torso), path)


def _write(figure: Figure, path: Path) -> None:
    stream = BytesIO()
    figure.savefig(stream, format="png", dpi=DPI, pil_kwargs={"optimize": True})
    write_bytes(path, stream.getvalue())


def html_of(torso: TorsoModel) -> str:
    """As a notebook shows it."""
    rows = [
        ("height", f"{torso.height_cm:.4g} cm"),
        ("bones", str(len(torso.bone_names))),
        ("joints", str(len(torso.joints))),
        ("tissue", f"{len(torso.tissue.rest_positions)} nodes, {len(torso.tissue.elements)} tetrahedra"),
    ]
    return as_html("Torso at rest", rows, small_figure(torso))
