"""Draws docs/images/conventions.png: frames, signs and projection on one page.

Run: python tools/draw_conventions.py [FILE]
"""

from __future__ import annotations

import sys
from pathlib import Path

import matplotlib
import numpy as np
from numpy.typing import NDArray

matplotlib.use("Agg")
import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.patches import Arc, FancyArrowPatch, Polygon, Rectangle

INK, BODY, BONE, LINE = "#22303c", "#f1e4da", "#fbfaf5", "#8a94a0"
RED, BLUE, GREEN, PURPLE = "#c0392b", "#1f6fb2", "#2e8b57", "#7d3c98"
Point = tuple[float, float]


def arrow(ax: Axes, tail: Point, head: Point, colour: str, width: float = 2.0, style: str = "-|>") -> None:
    patch = FancyArrowPatch(
        tail, head, arrowstyle=style, mutation_scale=14, color=colour, lw=width, shrinkA=0, shrinkB=0, zorder=6
    )
    ax.add_patch(patch)


def turn(ax: Axes, centre: Point, radius: float, colour: str, start: float = 20.0, end: float = 250.0) -> None:
    """An anticlockwise turn: positive about the axis that points at the reader."""
    ax.add_patch(Arc(centre, 2 * radius, 2 * radius, theta1=start, theta2=end, color=colour, lw=2, zorder=6))
    last, before = np.radians(end), np.radians(end - 14)
    tip = (centre[0] + radius * np.cos(last), centre[1] + radius * np.sin(last))
    tail = (centre[0] + radius * np.cos(before), centre[1] + radius * np.sin(before))
    arrow(ax, tail, tip, colour)


def box(centre: Point, width: float, height: float, tilt: float) -> NDArray[np.float64]:
    c, s = np.cos(tilt), np.sin(tilt)
    corners = np.array([[0.5, 0.5], [-0.5, 0.5], [-0.5, -0.5], [0.5, -0.5]]) * [width, height]
    return corners @ np.array([[c, s], [-s, c]]) + centre


def clean(ax: Axes, title: str, x: Point, y: Point) -> None:
    ax.set(xlim=x, ylim=y, aspect="equal", xticks=[], yticks=[])
    ax.set_title(title, fontsize=11.5, fontweight="bold", color=INK, loc="left")
    for spine in ax.spines.values():
        spine.set_color("#d5dae0")


def torso(ax: Axes, bend: float = 0.0) -> None:
    """Trunk, pelvis and vertebrae from the front; the curve's apex lies ``bend`` to the patient's left."""
    half = [(0.35, 10.4), (0.5, 9.7), (1.9, 9.3), (2.35, 8.6), (1.9, 7.6), (1.75, 5.5), (1.5, 3.6), (1.85, 2.0)]
    outline = [*half, (1.9, 1.0), (-1.9, 1.0), *[(-x, y) for x, y in reversed(half)]]
    ax.add_patch(Polygon(outline, closed=True, facecolor=BODY, edgecolor=LINE, lw=1.2))
    pelvis = [(-1.5, 2.5), (-0.6, 2.1), (0.6, 2.1), (1.5, 2.5), (1.2, 1.5), (0.0, 1.15), (-1.2, 1.5)]
    ax.add_patch(Polygon(pelvis, closed=True, facecolor=BONE, edgecolor=LINE, lw=1.0))
    for y in np.linspace(2.6, 9.6, 17):
        s = (y - 2.6) / 7.0
        slope = bend * np.pi * np.cos(np.pi * s) / 7.0
        width = 0.75 - 0.3 * s
        corners = box((bend * np.sin(np.pi * s), y), width, 0.34, -np.arctan(slope))
        ax.add_patch(Polygon(corners, closed=True, facecolor=BONE, edgecolor=INK, lw=0.9, zorder=3))


def draw_world(ax: Axes) -> None:
    clean(ax, "1  World frame, patient seen from the front", (-4.6, 4.6), (0.2, 11.4))
    torso(ax)
    origin = (0.0, 5.9)
    arrow(ax, origin, (2.9, 5.9), RED)
    arrow(ax, origin, (0.0, 8.9), GREEN)
    ax.plot(*origin, "o", ms=11, mfc="white", mec=BLUE, mew=2, zorder=7)
    ax.plot(*origin, "o", ms=3, color=BLUE, zorder=8)
    ax.text(3.0, 5.9, "x\npatient's\nleft", color=RED, va="center", fontsize=10)
    ax.text(0.5, 8.7, "y superior", color=GREEN, fontsize=10)
    ax.text(0.45, 5.2, "z anterior\n(at the reader)", color=BLUE, fontsize=10, va="center", zorder=9)
    ax.text(-4.4, 10.8, "patient's RIGHT", fontsize=10, color=INK)
    ax.text(4.4, 10.8, "patient's LEFT", fontsize=10, color=INK, ha="right")
    ax.text(-4.4, 0.5, "DICOM patient axes (LPS): left = x,  posterior = -z,  superior = y", fontsize=9, color=INK)


def draw_push(ax: Axes) -> None:
    clean(ax, "2  A positive push: from the patient's right side", (-4.6, 4.6), (0.2, 11.4))
    torso(ax, bend=0.75)
    arrow(ax, (-3.6, 6.3), (-1.85, 6.3), RED, 3.0)
    ax.text(-3.7, 5.35, "$F_3$ > 0\n(force +x)", color=RED, fontsize=10.5)
    arrow(ax, (4.1, 8.75), (2.45, 8.75), BLUE, 2.4)
    ax.text(4.4, 9.15, "reaction $F_1$\nat the opposite\nshoulder", color=BLUE, fontsize=10, ha="right")
    arrow(ax, (4.1, 1.8), (1.95, 1.8), BLUE, 2.4)
    ax.text(4.4, 2.2, "reaction $F_2$\nat the pelvis", color=BLUE, fontsize=10, ha="right")
    ax.plot(0, 1.8, "o", ms=11, mfc="white", mec=PURPLE, mew=2, zorder=7)
    ax.text(0.0, 0.55, "hinge about z through the pelvic belt", color=PURPLE, fontsize=9.5, ha="center")
    for x, low, height, label in ((-2.85, 6.3, 7.5, "$d_{31}$"), (-3.9, 1.8, 3.6, "$d_{21}$")):
        arrow(ax, (x, 8.75), (x, low), INK, 1.0, "<|-|>")
        ax.text(x + 0.12, height, label, fontsize=11, color=INK)
    ax.plot([-4.2, 2.3], [8.75, 8.75], ":", color=LINE, lw=1)
    ax.plot([-4.2, 0.0], [1.8, 1.8], ":", color=LINE, lw=1)
    ax.text(0.15, 10.8, "a push from the left is negative", fontsize=10, color=INK, ha="center")


def draw_cobb(ax: Axes) -> None:
    clean(ax, "3  Cobb angle: positive = convex to the patient's left", (-4.6, 4.6), (0.2, 11.4))
    for centre, sign, label in ((-2.3, 1.0, "+"), (2.3, -1.0, "\N{MINUS SIGN}")):
        s = np.linspace(0, 1, 12)
        y = 2.0 + 7.5 * s
        x = centre + sign * 1.1 * np.sin(np.pi * s) - sign * 0.55
        tilt = -np.arctan(sign * 1.1 * np.pi * np.cos(np.pi * s) / 7.5)
        for i in range(12):
            ends = i in (1, 10)
            corners = box((x[i], y[i]), 0.95, 0.45, tilt[i])
            ax.add_patch(Polygon(corners, closed=True, facecolor="#f9d9b5" if ends else BONE, edgecolor=INK, lw=1.0))
        for i, edge in ((1, -0.225), (10, 0.225)):
            direction = np.array([np.cos(tilt[i]), np.sin(tilt[i])])
            normal = np.array([-direction[1], direction[0]])
            start = np.array([x[i], y[i]]) + edge * normal
            line = np.array([start - 1.7 * direction, start + 1.7 * direction])
            ax.plot(*line.T, color=PURPLE, lw=1.3, zorder=5)
        ax.text(centre, 10.6, label, fontsize=26, fontweight="bold", color=RED, ha="center", va="center")
    turn(ax, (0.0, 5.75), 0.55, BLUE, -60.0, 200.0)
    ax.text(0, 5.75, "tilt\n+", fontsize=9.5, color=BLUE, ha="center", va="center")
    rule = "Cobb = tilt of the upper end \N{MINUS SIGN} tilt of the lower end"
    ax.text(0, 1.15, rule, fontsize=10, ha="center", color=INK)
    ax.text(0, 0.55, "tilt: turn about z, anticlockwise in this view is positive", fontsize=10, ha="center", color=INK)


def draw_vertebra(ax: Axes) -> None:
    clean(ax, "4  Axes of a vertebra and of its joint with the one below", (-4.6, 4.6), (-4.2, 4.6))
    # Oblique view: x to the right, y up, z towards the reader and down to the left.
    z = np.array([-0.52, -0.42])

    def at(x: float, y: float, depth: float) -> Point:
        return (float(x + depth * z[0]), float(y + depth * z[1]))

    faces = {
        "front": [(-1, -0.6, 1), (1, -0.6, 1), (1, 0.6, 1), (-1, 0.6, 1)],
        "top": [(-1, 0.6, 1), (1, 0.6, 1), (1, 0.6, -1), (-1, 0.6, -1)],
        "side": [(1, -0.6, 1), (1, -0.6, -1), (1, 0.6, -1), (1, 0.6, 1)],
    }
    for shade, (_, face) in zip(("#fbfaf5", "#efeadb", "#e2dccb"), faces.items()):
        ax.add_patch(Polygon([at(*p) for p in face], closed=True, facecolor=shade, edgecolor=INK, lw=1.2))
    arrow(ax, at(1, 0, 0), at(2.0, 0, 0), RED, 2.4)
    arrow(ax, at(0, 0.6, 0), at(0, 2.3, 0), GREEN, 2.4)
    arrow(ax, at(0, 0, 1), at(0, 0, 3.0), BLUE, 2.4)
    ax.text(2.05, -0.05, "x  lateral shear\n$\\alpha$  flexion-extension", color=RED, fontsize=10, va="center")
    ax.text(0.2, 2.5, "y  separation\n$\\beta$  axial rotation", color=GREEN, fontsize=10, va="center")
    ax.text(-4.4, -1.9, "z  sagittal shear\n$\\gamma$  lateral bending", color=BLUE, fontsize=10, va="center")
    note = (
        "At rest the joint's two frames coincide: at the disc's centre,\n"
        "axes the mean of the adjacent endplates.\n"
        "$\\Delta x$ in mm, $\\Delta\\theta = \\log(R_{parent}^T R_{child})$ in rad;\n"
        "rotations turn by the right-hand rule."
    )
    ax.text(-4.4, 4.35, note, fontsize=9.5, color=INK, va="top")
    ax.text(-4.4, -3.9, "all other joints: x along the separation, y and z across it", fontsize=9.5, color=INK)


def draw_projection(ax: Axes) -> None:
    clean(ax, "5  Frontal x-ray seen from above: source, patient, detector", (-4.6, 4.6), (-4.2, 4.6))
    source, patient, detector = (0.0, -3.3), 2.2, 3.3
    ax.plot(*source, "*", ms=16, color="#e0a000", zorder=7)
    ax.text(0.3, source[1], "source (in front, +z)", fontsize=10, va="center", color=INK)
    ax.add_patch(matplotlib.patches.Ellipse((0, patient - 0.25), 4.0, 1.7, facecolor=BODY, edgecolor=LINE))
    ax.plot([-4.1, 4.1], [detector, detector], color=INK, lw=4)
    ax.plot([-4.1, 4.1], [patient, patient], "--", color=PURPLE, lw=1.4)
    for x in (-3.6, 3.6):
        ax.plot([source[0], x], [source[1], detector], color="#e0a000", lw=0.9)
    ratio = (patient - source[1]) / (detector - source[1])
    arrow(ax, (0, patient), (ratio * 2.4, patient), PURPLE, 2.2)
    arrow(ax, (0, detector), (2.4, detector), RED, 2.2)
    ax.plot([source[0], 2.4], [source[1], detector], ":", color=INK, lw=1)
    ax.text(-4.4, detector + 0.25, "detector: where pixels are", fontsize=10, color=INK)
    ax.text(4.4, detector + 0.25, "columns grow to the left: x", fontsize=10, color=RED, ha="right")
    plane = "patient plane:\nall features and\nRMSE in mm here"
    ax.text(-4.4, patient - 1.35, plane, fontsize=10, color=PURPLE, va="center")
    for x, low, high, text in ((3.95, source[1], detector, "$d_{SID}$"), (3.2, source[1], patient, "$d_{SOD}$")):
        arrow(ax, (x, low), (x, high), INK, 1.0, "<|-|>")
        ax.text(x - 0.08, -1.3 if x > 3.5 else -2.1, text, fontsize=11, ha="right", color=INK)
    formula = "$m = d_{SID}/d_{SOD}$\nplane = (detector\n\N{MINUS SIGN} principal point) / $m$"
    ax.text(-4.4, -1.5, formula, fontsize=10, color=INK, va="center")
    lateral = "lateral: source at the patient's right, columns grow to anterior"
    ax.text(0, -4.0, lateral, fontsize=9.5, color=INK, ha="center")


def draw_corners(ax: Axes) -> None:
    clean(ax, "6  Image axes and the order of a vertebra's corners", (-4.6, 4.6), (-4.2, 4.6))
    ax.add_patch(Rectangle((-3.9, -2.6), 7.8, 6.0, facecolor="#2b3640", edgecolor=INK))
    for tilt, y in ((0.05, 2.1), (-0.06, -1.75)):
        ax.add_patch(Polygon(box((0.2, y), 2.6, 1.35, tilt), closed=True, facecolor="#97a3ad", edgecolor="none"))
    corners = box((0.1, 0.2), 2.7, 1.5, 0.1)
    ax.add_patch(Polygon(corners, closed=True, facecolor="#c9d1d8", edgecolor="white", lw=1.2))
    names = ("0 superior-left", "1 superior-right", "2 inferior-right", "3 inferior-left")
    for k, (corner, name) in enumerate(zip(corners, names)):
        ax.plot(*corner, "o", ms=7, color="#ffb84d", zorder=7)
        x, side = (corner[0] + 0.18, "left") if k in (0, 3) else (corner[0] - 0.18, "right")
        ax.text(x, corner[1], name, fontsize=9, color="#ffd591", ha=side, va="center", zorder=8)
    arrow(ax, (-3.9, 3.4), (-1.9, 3.4), RED, 2.2)
    arrow(ax, (-3.9, 3.4), (-3.9, 1.6), GREEN, 2.2)
    ax.text(-1.8, 3.75, "column: patient's left (frontal)", color=RED, fontsize=10, va="center", ha="left")
    ax.text(-3.75, 1.35, "row: down", color="#8fe0b4", fontsize=10, va="center")
    ax.plot(-3.9, 3.4, "s", ms=6, color="#ffb84d", zorder=8)
    ax.text(-4.4, 3.75, "centre of pixel (0, 0)", fontsize=9.5, color=INK, va="center")
    notes = (
        "left and right are the patient's; lateral view: anterior instead of left",
        "PatientOrientation: frontal L\\F, lateral A\\F",
        "pixel spacing is [column step, row step] in mm at the detector",
    )
    for k, note in enumerate(notes):
        ax.text(0, -3.0 - 0.5 * k, note, fontsize=9.5, color=INK, ha="center")


def main(path: Path) -> None:
    figure, axes = plt.subplots(2, 3, figsize=(17.0, 13.0), height_ratios=(11.2, 8.8))
    figure.subplots_adjust(left=0.01, right=0.99, bottom=0.01, top=0.97, wspace=0.03, hspace=0.08)
    panels = (draw_world, draw_push, draw_cobb, draw_vertebra, draw_projection, draw_corners)
    for draw, ax in zip(panels, axes.flat):
        draw(ax)
    figure.savefig(path, dpi=75)


if __name__ == "__main__":
    default = Path(__file__).parents[1] / "docs" / "images" / "conventions.png"
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else default)
