"""Path lengths of rays inside closed surfaces, exactly and without cracks.

Every triangle is projected on the detector once and the pixel centres it covers get plus or minus its depth, so a
closed surface adds the length of the ray inside it, and surfaces that overlap add up. The fill rule is watertight:
projected vertices are rounded to a fine grid on which the side of an edge is decided exactly, and a pixel centre
on an edge or a vertex is nudged the same way for all triangles.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import ArrayLike

from spinestiff.arrays import Floats, Ints, ShortRepr, read_only
from spinestiff.errors import RadiographError, TorsoError
from spinestiff.imaging.projection import XRayView
from spinestiff.words import counted

_GRID = 2.0**36  # of projected vertices, a pixel; differences below 2**17 pixels stay exact in 53 bits
_FARTHEST_PIXEL = 2.0**16


@dataclass(frozen=True, repr=False)
class Surface(ShortRepr):
    """A closed surface whose faces are known to be: vertices (n, 3) mm, faces (m, 3) outward."""

    vertices: Floats
    faces: Ints


@dataclass(frozen=True)
class Shadow:
    """The part of a detector that a surface's shadow lies in.

    Attributes
    ----------
    rows, columns : that part.
    length : (h, w) mm along the ray inside the surface.
    middle : (h, w) mm, mean distance of the inside from the source along the detector's normal.
    """

    rows: slice
    columns: slice
    length: Floats
    middle: Floats


def path_length(vertices: ArrayLike, faces: ArrayLike, view: XRayView, out: Floats | None = None) -> Floats:
    """Length of each pixel's ray inside a closed surface.

    Parameters
    ----------
    vertices, faces : (n, 3) mm in the world and (m, 3) outward, anticlockwise from outside. Pieces that overlap count
        each; faces turned inward count negative.
    out : (H, W) to add to; a new map if None.

    Returns
    -------
    (H, W) mm.

    Raises
    ------
    TorsoError : the surface is not closed.
    RadiographError : the surface reaches the source.
    """
    lengths = np.zeros(view.shape) if out is None else out
    shadow = cast(closed_surface(vertices, faces), view)
    if shadow is not None:
        lengths[shadow.rows, shadow.columns] += shadow.length
    return lengths


def closed_surface(vertices: ArrayLike, faces: ArrayLike) -> Surface:
    """The surface, checked. Raises TorsoError if it is not closed."""
    points = read_only("vertices", vertices, (None, 3), TorsoError)
    triangles = read_only("faces", faces, (None, 3), TorsoError, np.int64)
    if len(triangles) and (triangles.min() < 0 or triangles.max() >= len(points)):
        raise TorsoError(f"a face names vertex {int(triangles.max())}, but the surface has {len(points)}")
    if _open_edges(triangles, len(points)):
        # Pieces cut along a seam share places, not vertices.
        _, same = np.unique(points, axis=0, return_inverse=True)
        count = _open_edges(np.asarray(same).reshape(-1)[triangles], len(points))
        if count:
            raise TorsoError(
                f"surface is not closed: {counted(int(count), 'edge')} without a neighbour; close it or leave it out"
            )
    return Surface(points, triangles)


def _open_edges(faces: Ints, vertices: int) -> int:
    start, end = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    there, back = start * vertices + end, end * vertices + start
    if np.array_equal(np.sort(there), np.sort(back)):
        return 0
    _, edge = np.unique(np.concatenate([there, back]), return_inverse=True)
    balance = np.bincount(edge.reshape(-1), np.repeat([1.0, -1.0], len(there)))
    return int(np.count_nonzero(balance)) // 2


def shrunk(surface: Surface, thickness: Floats | float) -> Surface:
    """The vertices moved inward along their normals, by one thickness or one a vertex (n,), mm."""
    corners = surface.vertices[surface.faces]
    weighted = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = np.zeros_like(surface.vertices)
    for corner in range(3):
        np.add.at(normals, surface.faces[:, corner], weighted)
    size = np.linalg.norm(normals, axis=1, keepdims=True)
    inward = np.broadcast_to(thickness, len(normals))[:, None] * normals / np.where(size > 0.0, size, 1.0)
    return Surface(surface.vertices - inward, surface.faces)


def cast(surface: Surface, view: XRayView, block: int = 1) -> Shadow | None:
    """The shadow of a surface, or None where it misses the detector.

    Its rows and columns start and end at multiples of ``block``, which must divide the detector's.
    """
    if not len(surface.faces):
        return None
    used = surface.vertices
    pixels = view.pixels(view.project(used))
    if np.abs(pixels).max() > _FARTHEST_PIXEL:
        raise RadiographError("a surface comes too close to the X-ray source; check the distance source to patient")
    low = np.maximum(np.ceil(pixels.min(axis=0)), 0).astype(int)
    high = np.minimum(np.floor(pixels.max(axis=0)), np.array(view.shape[::-1]) - 1).astype(int)
    if (high < low).any():
        return None
    low, end = low // block * block, (high // block + 1) * block
    length, moment = np.zeros((2, end[1] - low[1], end[0] - low[0]))
    ahead = (used - view.source) @ view.normal
    handed = 1.0 if np.cross(*view.detector_axes) @ view.normal > 0.0 else -1.0
    _scan(np.rint(pixels * _GRID) / _GRID, ahead, surface.faces, handed, low[0], low[1], length, moment)
    rows, columns = slice(low[1], end[1]), slice(low[0], end[0])
    _finish(length, moment, *offsets(view, rows, columns), view.source_to_detector, float(ahead.mean()))
    return Shadow(rows, columns, length, moment)


def offsets(view: XRayView, rows: slice, columns: slice) -> tuple[Floats, Floats]:
    """mm from the principal point, along columns (w,) and rows (h,)."""
    u = np.arange(columns.start, columns.stop) * view.pixel_spacing[0] - view.principal_point[0]
    v = np.arange(rows.start, rows.stop) * view.pixel_spacing[1] - view.principal_point[1]
    return u, v


@njit(cache=True, nogil=True)
def _product_error(a, b, product):  # type: ignore[no-untyped-def]
    """``a * b - product`` exactly (Dekker's product)."""
    c = 134217729.0 * a
    a_high = c - (c - a)
    a_low = a - a_high
    c = 134217729.0 * b
    b_high = c - (c - b)
    b_low = b - b_high
    return ((a_high * b_high - product) + a_high * b_low + a_low * b_high) + a_low * b_low


@njit(cache=True, nogil=True)
def _turn(ax, ay, bx, by, px, py):  # type: ignore[no-untyped-def]
    """Sign of (b - a) x (p - a), exact for points of the grid."""
    dx, dy, ex, ey = bx - ax, by - ay, px - ax, py - ay
    first, second = dx * ey, dy * ex
    # Rounding is monotonic: only equal products need their errors.
    if first == second:
        first, second = _product_error(dx, ey, first), _product_error(dy, ex, second)
    return 1 if first > second else (-1 if first < second else 0)


@njit(cache=True, nogil=True)
def _side(ax, ay, bx, by, px, py):  # type: ignore[no-untyped-def]
    """``_turn`` of p nudged by (eps, eps^2), so that a p on an edge belongs to one of its two triangles."""
    turn = _turn(ax, ay, bx, by, px, py)
    if turn != 0:
        return turn
    if by != ay:
        return 1 if by < ay else -1
    return 1 if bx > ax else -1


@njit(cache=True, nogil=True)
def _scan(pixels, ahead, faces, handed, column0, row0, length, moment):  # type: ignore[no-untyped-def]
    """Add sign x depth and sign x depth^2 / 2 of every triangle at the pixel centres it covers."""
    height, width = length.shape
    for f in range(faces.shape[0]):
        i, j, k = faces[f, 0], faces[f, 1], faces[f, 2]
        ax, ay = pixels[i, 0], pixels[i, 1]
        bx, by = pixels[j, 0], pixels[j, 1]
        cx, cy = pixels[k, 0], pixels[k, 1]
        turn = _turn(ax, ay, bx, by, cx, cy)
        if turn == 0:
            continue
        first_row = max(int(np.ceil(min(ay, by, cy))), row0)
        last_row = min(int(np.floor(max(ay, by, cy))), row0 + height - 1)
        first_column = max(int(np.ceil(min(ax, bx, cx))), column0)
        last_column = min(int(np.floor(max(ax, bx, cx))), column0 + width - 1)
        sign = turn * handed
        for row in range(first_row, last_row + 1):
            y = float(row)
            for column in range(first_column, last_column + 1):
                x = float(column)
                if _side(ax, ay, bx, by, x, y) != turn:
                    continue
                if _side(bx, by, cx, cy, x, y) != turn or _side(cx, cy, ax, ay, x, y) != turn:
                    continue
                # Weights of the corners; 1 / depth is linear on the detector.
                wc = abs((bx - ax) * (y - ay) - (by - ay) * (x - ax))
                wa = abs((cx - bx) * (y - by) - (cy - by) * (x - bx))
                wb = abs((ax - cx) * (y - cy) - (ay - cy) * (x - cx))
                total = wa + wb + wc
                if total > 0.0:
                    depth = total / (wa / ahead[i] + wb / ahead[j] + wc / ahead[k])
                else:
                    depth = (ahead[i] + ahead[j] + ahead[k]) / 3.0
                length[row - row0, column - column0] += sign * depth
                moment[row - row0, column - column0] += 0.5 * sign * depth * depth


@njit(cache=True, nogil=True)
def _finish(length, moment, u, v, distance, nowhere):  # type: ignore[no-untyped-def]
    """From depths along the detector's normal to lengths along the rays, from moments to middles."""
    for row in range(length.shape[0]):
        for column in range(length.shape[1]):
            depth = length[row, column]
            moment[row, column] = moment[row, column] / depth if abs(depth) > 1e-2 else nowhere
            length[row, column] = depth * np.sqrt(1.0 + (u[column] ** 2 + v[row] ** 2) / distance**2)
