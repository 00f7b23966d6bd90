"""A skin for bones that come without one: the template's, carried along by the joints, with enough cover everywhere."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.interpolate import RBFInterpolator
from scipy.ndimage import gaussian_filter, maximum_filter
from scipy.spatial import cKDTree

from spinestiff.anatomy.importing.placing import Skeleton
from spinestiff.anatomy.names import BONES
from spinestiff.anatomy.points import PointsOnBones
from spinestiff.anatomy.solids import dense_points, enclosed
from spinestiff.anatomy.state import TorsoState
from spinestiff.anatomy.template import template_torso
from spinestiff.anatomy.template.surfaces import Surface, loft
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.arrays import Floats
from spinestiff.errors import TorsoError

COVER_MM = 9.0  # of tissue over every bone, of a 157 cm body
FLOOR_MM = 14.0  # below the lowest bone, and lid above the highest
ROWS, SIDES = 56, 64
OUTSIDE_MM = 1.0  # a bone may stick out this far by rounding


def generated_skin(skeleton: Skeleton, rest: TorsoState, points: Mapping[str, PointsOnBones], scale: float) -> Surface:
    """A closed skin (world mm) around a skeleton.

    The template's skin is carried by a smooth map that takes its joints and landmarks to the skeleton's; then every row
    is widened until all bones have their cover.

    Parameters
    ----------
    rest, points : the skeleton's frames and landmarks. scale : its size over the 157 cm template's.
    """
    template = template_torso(157.0)
    own = PointsOnBones(template.joints.parent, template.joints.parent_position).positions(template.rest_pose)
    there, here = [own], [skeleton.centres]
    for key in ("rib_lateral", "humerus_head", "pelvis_belt"):
        there.append(template.landmarks[key].positions(template.rest_pose))
        here.append(points[key].positions(rest))
    there.append(_pelvis_ends(template.surface_positions(template.rest_pose, template.bone("pelvis"))))
    here.append(_pelvis_ends(skeleton.surfaces["pelvis"][0]))
    carried = RBFInterpolator(np.vstack(there), np.vstack(here), kernel="linear", smoothing=20.0, degree=1)
    vertices = carried(_template_rows(template).reshape(-1, 3)).reshape(ROWS, SIDES, 3)
    cloud = np.vstack([dense_points(skeleton.surfaces[name], 4.0) for name in BONES])
    low, high = (
        cloud[:, 1].min() - FLOOR_MM * scale,
        max(cloud[:, 1].max() + FLOOR_MM * scale, vertices[-1, :, 1].mean()),
    )
    heights = np.linspace(low, high, ROWS)
    # Each column of the carried grid, read off at level heights.
    level = np.empty_like(vertices)
    for j in range(SIDES):
        order = np.argsort(vertices[:, j, 1], kind="stable")
        column = vertices[order, j]
        level[:, j] = np.stack([np.interp(heights, column[:, 1], column[:, i]) for i in (0, 2)] + [heights], -1)[
            :, [0, 2, 1]
        ]
    middle = level.mean(1)
    return loft(_covered(level, middle, cloud, COVER_MM * scale))


def _pelvis_ends(vertices: Floats) -> Floats:
    # (6, 3) its outermost points to the sides, below, above, in front and behind.
    found = [vertices[np.argmax(sign * vertices[:, axis])] for axis in range(3) for sign in (1.0, -1.0)]
    points = np.array(found)
    points[2:, 0] = 0.0  # left and right are alike below, above, in front and behind
    return points


def _template_rows(template: TorsoModel) -> Floats:
    # (ROWS, SIDES, 3) level rings on the boundary of the template's tissue, equal angles about each row's middle.
    nodes, faces = template.tissue.rest_positions, template.tissue.boundary_faces()[:, :3]
    cloud = dense_points((nodes, faces), 6.0)
    heights = np.linspace(cloud[:, 1].min() + 1.0, cloud[:, 1].max() - 1.0, ROWS)
    angle = 2.0 * np.pi * np.arange(SIDES) / SIDES
    rows = np.empty((ROWS, SIDES, 3))
    step = heights[1] - heights[0]
    for k, y in enumerate(heights):
        near = cloud[np.abs(cloud[:, 1] - y) < step]
        middle = 0.5 * (near.min(0) + near.max(0))
        around = np.arctan2(near[:, 0] - middle[0], near[:, 2] - middle[2])
        reach = np.hypot(near[:, 0] - middle[0], near[:, 2] - middle[2])
        # Floor and lid are full of points: the outermost in each direction counts.
        radius = np.array([_outermost(reach, np.angle(np.exp(1j * (around - a)))) for a in angle])
        rows[k] = np.stack(
            [middle[0] + radius * np.sin(angle), np.full(SIDES, y), middle[2] + radius * np.cos(angle)], -1
        )
    return rows


def _outermost(reach: Floats, off: Floats) -> float:
    width = np.pi / SIDES
    while not (near := np.abs(off) < width).any():
        width *= 1.5
    return float(reach[near].max())


def _covered(rows: Floats, middle: Floats, cloud: Floats, cover: float) -> Floats:
    # Radii as functions of row and angle: at least ``cover`` mm beyond every bone, smoothed without going under that.
    angle = 2.0 * np.pi * np.arange(SIDES) / SIDES
    centre = middle[:, [0, 2]]
    for axis in range(2):
        centre[:, axis] = gaussian_filter(centre[:, axis], 2.0, mode="nearest")
    apart = rows[..., [0, 2]] - centre[:, None]
    at, reach = np.arctan2(apart[..., 0], apart[..., 1]), np.hypot(apart[..., 0], apart[..., 1])
    wanted = np.zeros((ROWS, SIDES))
    for k in range(ROWS):
        order = np.argsort(at[k])
        wanted[k] = np.interp(np.angle(np.exp(1j * angle)), at[k][order], reach[k][order], period=2.0 * np.pi)
    wanted = gaussian_filter(wanted, 1.0, mode=("nearest", "wrap"))
    heights = rows[:, 0, 1]
    step = heights[1] - heights[0]
    row = np.clip(np.round((cloud[:, 1] - heights[0]) / step).astype(int), 0, ROWS - 1)
    off = cloud[:, [0, 2]] - centre[row]
    slot = np.round(np.arctan2(off[:, 0], off[:, 1]) / (2.0 * np.pi / SIDES)).astype(int) % SIDES
    bony = np.zeros((ROWS, SIDES))
    np.maximum.at(bony, (row, slot), np.hypot(off[:, 0], off[:, 1]) + cover)
    # A cover also above, below and beside each point, as wide as it is thick.
    tall, wide = int(np.ceil(cover / step)), max(1, int(np.ceil(cover / (2.0 * np.pi * 110.0 / SIDES))))
    bony = maximum_filter(bony, size=(2 * tall + 1, 2 * wide + 1), mode=("nearest", "wrap"))
    least = np.maximum(wanted, bony)
    smooth = least
    for _ in range(6):
        smooth = np.maximum(gaussian_filter(smooth, 1.2, mode=("nearest", "wrap")), least)
        least = np.maximum(least * 0.0 + bony, wanted * 0.97)
    radius = np.maximum(smooth, bony)
    x, z = centre[:, :1] + radius * np.sin(angle), centre[:, 1:] + radius * np.cos(angle)
    return np.stack([x, np.repeat(heights[:, None], SIDES, axis=1), z], -1)


def refuse_bones_outside(surfaces: Mapping[str, Surface], skin: Surface) -> None:
    """Raise TorsoError, naming the bone that sticks out farthest, unless all bones lie inside the skin."""
    shell = cKDTree(dense_points(skin, 4.0))
    worst, where = 0.0, ""
    for name in BONES:
        points = dense_points(surfaces[name], 3.0)
        out = points[~enclosed(skin, points)]
        if len(out) and (far := float(shell.query(out)[0].max())) > worst:
            worst, where = far, name
    # Points of the shell lie up to 4 mm from each other.
    if worst > OUTSIDE_MM + 2.0:
        raise TorsoError(f"{where} sticks out of the skin by {worst:.0f} mm; wanted all bones inside it")


def section_middle(skin: Surface, y: float) -> float:
    """z of the middle between front and back of a skin at height ``y``, in the middle plane x = 0."""
    points = dense_points(skin, 4.0)
    for width in (8.0, 16.0, 40.0):
        near = points[(np.abs(points[:, 1] - y) < width) & (np.abs(points[:, 0]) < 2.0 * width)]
        if len(near) > 4:
            return 0.5 * float(near[:, 2].min() + near[:, 2].max())
    raise TorsoError(f"the skin has no front and back at the height of the pelvis (y = {y:.0f} mm)")
