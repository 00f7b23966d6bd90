"""Synthetic radiographs: path lengths through closed surfaces, Beer-Lambert's law, a detector with noise.

Every triangle is projected on the detector once and the pixel centres it covers get plus or minus its depth, so a
closed surface adds the length of the ray inside it, and surfaces that overlap add up. The fill rule is watertight:
projected vertices are rounded to a fine grid on which the side of an edge is decided exactly, and a pixel centre
on an edge or a vertex is nudged the same way for all triangles.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import cv2
import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from spinestiff.arrays import Floats, Ints, read_only
from spinestiff.errors import RadiographError, TorsoError
from spinestiff.imaging.projection import XRayView

# Linear attenuation, 1/mm, of a 71 kVp beam hardened by a torso (about 55 keV effective). From NIST's tables of mass
# attenuation (ICRU-44 materials; soft tissue 0.226 cm2/g at 50 keV and 0.205 at 60; cortical bone 0.424 and 0.315)
# and the densities 1.06 and 1.92 g/cm3. Bone counts as what it adds to the tissue whose place it takes.
SOFT_TISSUE = 0.021
CORTICAL_BONE = 0.050
CANCELLOUS_BONE = 0.014
LUNG = -0.0155  # inflated lung weighs about a quarter of tissue

GREY_PER_OPTICAL_DEPTH = 8000.0
AIR_GREY = 4000.0

_GRID = 2.0**36  # of projected vertices, a pixel; differences below 2**17 pixels stay exact in 53 bits
_FARTHEST_PIXEL = 2.0**16


@dataclass(frozen=True)
class Texture:
    """Density that varies inside a body and rides on it: trabecular clumps, bowel, muscle.

    Attributes
    ----------
    amplitude : standard deviation is about a third of it; relative change of the path length.
    grain : mm, coarsest grain; three octaves down to a quarter of it.
    seed : which pattern.
    position, rotation : (3,) mm and (3, 3), world_from_body.
    """

    amplitude: float
    grain: float
    seed: int
    position: Floats = field(default_factory=lambda: np.zeros(3))
    rotation: Floats = field(default_factory=lambda: np.eye(3))


@dataclass(frozen=True)
class Absorber:
    """A body that absorbs X-rays.

    Attributes
    ----------
    vertices, faces : closed surface in the world, (n, 3) mm and (m, 3) outward.
    attenuation : 1/mm, on top of what surrounds the body; negative for air in tissue.
    shell : mm, thickness of a cortical shell that absorbs ``shell_attenuation`` more; 0 for none.
    shell_attenuation : 1/mm.
    texture : density pattern of the inside, or None.
    smoothing : mm at the detector, blur of the path length; hides the facets of a coarse skin.
    """

    vertices: Floats
    faces: Ints
    attenuation: float
    shell: float = 0.0
    shell_attenuation: float = 0.0
    texture: Texture | None = None
    smoothing: float = 0.0


@dataclass(frozen=True)
class Exposure:
    """How the beam and the detector turn optical depth into grey values.

    Attributes
    ----------
    photons : mean count of a pixel in the unattenuated beam. The default leaves some 1,000 a pixel of 0.417 mm
        behind 200 mm of tissue, scatter included: about an eighth of a standard exposure.
    factor : exposure of this frame relative to the series (tube output wanders from frame to frame).
    scatter : scattered to primary photons behind thick tissue and a grid.
    scatter_width : mm at the detector, standard deviation of the scatter's blur.
    haze : constant fraction of the patient's mean signal (veiling glare, off-focus radiation).
    blur : pixels, standard deviation of the detector's blur.
    electronic_noise : photons, standard deviation.
    """

    photons: float = 6.0e4
    factor: float = 1.0
    scatter: float = 0.4
    scatter_width: float = 25.0
    haze: float = 0.02
    blur: float = 0.5
    electronic_noise: float = 4.0

    def __post_init__(self) -> None:
        if not (self.photons > 0.0 and self.factor > 0.0):
            raise RadiographError(f"exposure of {self.photons:g} photons times {self.factor:g}; wanted > 0")


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
    window = _scan_window(_checked_surface(vertices, faces), view)
    if window is not None:
        lengths[window.rows, window.columns] += window.length
    return lengths


def optical_depth(absorbers: Sequence[Absorber], view: XRayView, samples: int = 1) -> Floats:
    """Sum of attenuation times path length over all absorbers, (H, W), before any noise or scatter.

    A pixel is the mean of ``samples`` x ``samples`` rays; one ray a pixel leaves steps on thin slanting edges.
    """
    fine = _refined(view, samples)
    depth = np.zeros(fine.shape)
    for absorber in absorbers:
        _add_absorber(depth, absorber, fine)
    rows, columns = view.shape
    return depth.reshape(rows, samples, columns, samples).mean(axis=(1, 3)) if samples > 1 else depth


def render_radiograph(
    absorbers: Sequence[Absorber],
    view: XRayView,
    exposure: Exposure = Exposure(),
    seed: int = 0,
    samples: int = 1,
) -> NDArray[np.uint16]:
    """A radiograph of ``absorbers``, (H, W), bone bright: 8000 grey values an optical depth, 4000 in free air.

    ``exposure`` and ``seed`` as in ``expose``, ``samples`` as in ``optical_depth``.
    """
    return expose(optical_depth(absorbers, view, samples), view, exposure, seed)


def expose(depth: Floats, view: XRayView, exposure: Exposure = Exposure(), seed: int = 0) -> NDArray[np.uint16]:
    """Grey values of an optical depth (H, W): scatter, haze, quantum and electronic noise, detector blur, logarithm."""
    random = np.random.default_rng(seed)
    primary = np.exp(-depth)
    # What is scattered is what met tissue, so free air beside the patient sends none.
    scattered = _wide_blur(primary * (1.0 - np.exp(-np.maximum(depth, 0.0))), exposure.scatter_width, view)
    behind = depth > 0.5
    haze = exposure.haze * float(primary[behind].mean()) if behind.any() else 0.0
    signal = exposure.photons * exposure.factor * (primary + exposure.scatter * scattered + haze)
    counts = random.poisson(signal).astype(np.float64)
    if exposure.blur > 0.0:
        counts = np.asarray(cv2.GaussianBlur(counts, (0, 0), exposure.blur), dtype=np.float64)
    counts += exposure.electronic_noise * random.standard_normal(counts.shape, dtype=np.float32)
    absorbed = -np.log(np.maximum(counts, 0.5) / exposure.photons)
    return np.clip(np.rint(AIR_GREY + GREY_PER_OPTICAL_DEPTH * absorbed), 0, 65535).astype(np.uint16)


def _refined(view: XRayView, samples: int) -> XRayView:
    """The same detector with ``samples`` x ``samples`` pixels in the place of each."""
    if samples < 1:
        raise RadiographError(f"{samples} samples a pixel; wanted at least 1")
    spacing = view.pixel_spacing / samples
    first = view.detector_origin - 0.5 * (samples - 1) * spacing @ view.detector_axes
    rows, columns = view.shape
    return replace(view, detector_origin=first, pixel_spacing=spacing, shape=(rows * samples, columns * samples))


@dataclass(frozen=True)
class _Surface:
    vertices: Floats
    faces: Ints


@dataclass(frozen=True)
class _Window:
    """The part of the detector that a surface's shadow lies in."""

    rows: slice
    columns: slice
    length: Floats  # mm along the ray
    middle: Floats  # mean distance of the inside from the source along the detector's normal, mm


def _add_absorber(depth: Floats, absorber: Absorber, view: XRayView) -> None:
    surface = _checked_surface(absorber.vertices, absorber.faces)
    window = _scan_window(surface, view)
    if window is None:
        return
    absorbed = absorber.attenuation * window.length
    if absorber.texture is not None:
        absorbed *= 1.0 + absorber.texture.amplitude * _texture_of(window, absorber.texture, view)
    if absorber.smoothing > 0.0:
        sharp = np.zeros_like(depth)
        sharp[window.rows, window.columns] = absorbed
        depth += _wide_blur(sharp, absorber.smoothing, view)
    else:
        depth[window.rows, window.columns] += absorbed
    if absorber.shell > 0.0:
        depth[window.rows, window.columns] += absorber.shell_attenuation * window.length
        inside = _scan_window(_Surface(_shrunk(surface, absorber.shell), surface.faces), view)
        if inside is not None:
            depth[inside.rows, inside.columns] -= absorber.shell_attenuation * inside.length


def _checked_surface(vertices: ArrayLike, faces: ArrayLike) -> _Surface:
    points = read_only("vertices", vertices, (None, 3), TorsoError)
    triangles = read_only("faces", faces, (None, 3), TorsoError, np.int64)
    if len(triangles) and (triangles.min() < 0 or triangles.max() >= len(points)):
        raise TorsoError(f"a face names vertex {int(triangles.max())}, but the surface has {len(points)}")
    if _open_edges(triangles, len(points)):
        # Pieces cut along a seam share places, not vertices.
        _, same = np.unique(points, axis=0, return_inverse=True)
        count = _open_edges(np.asarray(same).reshape(-1)[triangles], len(points))
        if count:
            raise TorsoError(f"surface is not closed: {count} edges lack a neighbour; close it or leave it out")
    return _Surface(points, triangles)


def _open_edges(faces: Ints, vertices: int) -> int:
    start, end = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    there, back = start * vertices + end, end * vertices + start
    if np.array_equal(np.sort(there), np.sort(back)):
        return 0
    _, edge = np.unique(np.concatenate([there, back]), return_inverse=True)
    balance = np.bincount(edge.reshape(-1), np.repeat([1.0, -1.0], len(there)))
    return int(np.count_nonzero(balance)) // 2


def _shrunk(surface: _Surface, thickness: float) -> Floats:
    """The vertices moved inward along their normals."""
    corners = surface.vertices[surface.faces]
    weighted = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = np.zeros_like(surface.vertices)
    for corner in range(3):
        np.add.at(normals, surface.faces[:, corner], weighted)
    size = np.linalg.norm(normals, axis=1, keepdims=True)
    return surface.vertices - thickness * normals / np.where(size > 0.0, size, 1.0)


def _scan_window(surface: _Surface, view: XRayView) -> _Window | None:
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
    size = (high[1] - low[1] + 1, high[0] - low[0] + 1)
    length, moment = np.zeros(size), np.zeros(size)
    ahead = (used - view.source) @ view.normal
    handed = 1.0 if np.cross(*view.detector_axes) @ view.normal > 0.0 else -1.0
    _scan(np.rint(pixels * _GRID) / _GRID, ahead, surface.faces, handed, low[0], low[1], length, moment)
    middle = np.where(np.abs(length) > 1e-2, moment / np.where(length == 0.0, 1.0, length), ahead.mean())
    rows, columns = slice(low[1], high[1] + 1), slice(low[0], high[0] + 1)
    length *= _obliquity(view, rows, columns)
    return _Window(rows, columns, length, middle)


def _offsets(view: XRayView, rows: slice, columns: slice) -> tuple[Floats, Floats]:
    """mm from the principal point, along columns (w,) and rows (h,)."""
    u = np.arange(columns.start, columns.stop) * view.pixel_spacing[0] - view.principal_point[0]
    v = np.arange(rows.start, rows.stop) * view.pixel_spacing[1] - view.principal_point[1]
    return u, v


def _obliquity(view: XRayView, rows: slice, columns: slice) -> Floats:
    """Length of a ray per mm along the detector's normal."""
    u, v = _offsets(view, rows, columns)
    slope2: Floats = (u[None, :] ** 2 + v[:, None] ** 2) / view.source_to_detector**2
    return np.sqrt(1.0 + slope2)


def _texture_of(window: _Window, texture: Texture, view: XRayView) -> Floats:
    u, v = _offsets(view, window.rows, window.columns)
    axes = texture.rotation.T @ np.column_stack([view.detector_axes.T, view.normal])
    start = texture.rotation.T @ (view.source - texture.position)
    values = np.zeros_like(window.length)
    _sample_noise(u, v, window.length, window.middle, view.source_to_detector, start, axes, texture.grain,
                  np.uint64(texture.seed), values)  # fmt: skip
    return values


def _wide_blur(image: Floats, width: float, view: XRayView) -> Floats:
    """Gaussian blur by ``width`` mm, on a grid coarse enough to be quick."""
    step = max(1, int(width / float(view.pixel_spacing.max()) / 6.0))
    rows, columns = image.shape
    small = cv2.resize(image, (max(1, columns // step), max(1, rows // step)), interpolation=cv2.INTER_AREA)
    sigma = width / (view.pixel_spacing * np.array([columns, rows]) / np.array(small.shape[::-1]))
    small = cv2.GaussianBlur(small, (0, 0), sigmaX=float(sigma[0]), sigmaY=float(sigma[1]))
    return np.asarray(cv2.resize(small, (columns, rows), interpolation=cv2.INTER_LINEAR), dtype=np.float64)


@njit(cache=True)
def _product_error(a, b, product):  # type: ignore[no-untyped-def]
    """``a * b - product`` exactly (Dekker's product)."""
    c = 134217729.0 * a
    a_high = c - (c - a)
    a_low = a - a_high
    c = 134217729.0 * b
    b_high = c - (c - b)
    b_low = b - b_high
    return ((a_high * b_high - product) + a_high * b_low + a_low * b_high) + a_low * b_low


@njit(cache=True)
def _turn(ax, ay, bx, by, px, py):  # type: ignore[no-untyped-def]
    """Sign of (b - a) x (p - a), exact for points of the grid."""
    dx, dy, ex, ey = bx - ax, by - ay, px - ax, py - ay
    first, second = dx * ey, dy * ex
    # Rounding is monotonic: only equal products need their errors.
    if first == second:
        first, second = _product_error(dx, ey, first), _product_error(dy, ex, second)
    return 1 if first > second else (-1 if first < second else 0)


@njit(cache=True)
def _side(ax, ay, bx, by, px, py):  # type: ignore[no-untyped-def]
    """``_turn`` of p nudged by (eps, eps^2), so that a p on an edge belongs to one of its two triangles."""
    turn = _turn(ax, ay, bx, by, px, py)
    if turn != 0:
        return turn
    if by != ay:
        return 1 if by < ay else -1
    return 1 if bx > ax else -1


@njit(cache=True)
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


@njit(cache=True)
def _lattice(i, j, k, seed):  # type: ignore[no-untyped-def]
    """A number in [-1, 1) that depends on a lattice point only (splitmix64)."""
    h = np.uint64(i) * np.uint64(0x9E3779B97F4A7C15) ^ np.uint64(j) * np.uint64(0xC2B2AE3D27D4EB4F)
    h ^= np.uint64(k) * np.uint64(0x165667B19E3779F9) ^ seed * np.uint64(0xD6E8FEB86659FD93)
    h = (h ^ (h >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    h = (h ^ (h >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    h ^= h >> np.uint64(31)
    return float(h >> np.uint64(11)) / 4503599627370496.0 - 1.0


@njit(cache=True)
def _noise(x, y, z, seed):  # type: ignore[no-untyped-def]
    """Smooth noise with one random value a unit cell."""
    i, j, k = np.floor(x), np.floor(y), np.floor(z)
    fx, fy, fz = x - i, y - j, z - k
    sx, sy, sz = fx * fx * (3.0 - 2.0 * fx), fy * fy * (3.0 - 2.0 * fy), fz * fz * (3.0 - 2.0 * fz)
    value = 0.0
    for a in range(2):
        wa = sx if a else 1.0 - sx
        for b in range(2):
            wb = sy if b else 1.0 - sy
            for c in range(2):
                wc = sz if c else 1.0 - sz
                value += wa * wb * wc * _lattice(np.int64(i) + a, np.int64(j) + b, np.int64(k) + c, seed)
    return value


@njit(cache=True)
def _sample_noise(u, v, length, middle, distance, start, axes, grain, seed, values):  # type: ignore[no-untyped-def]
    """Three octaves of noise where each ray's inside has its middle, in the body's frame."""
    for row in range(length.shape[0]):
        for column in range(length.shape[1]):
            if abs(length[row, column]) < 1e-2:
                continue
            z = middle[row, column]
            x, y = u[column] * z / distance, v[row] * z / distance
            px = start[0] + axes[0, 0] * x + axes[0, 1] * y + axes[0, 2] * z
            py = start[1] + axes[1, 0] * x + axes[1, 1] * y + axes[1, 2] * z
            pz = start[2] + axes[2, 0] * x + axes[2, 1] * y + axes[2, 2] * z
            scale, weight, value = 1.0 / grain, 0.5, 0.0
            for octave in range(3):
                value += weight * _noise(px * scale, py * scale, pz * scale, seed + np.uint64(octave))
                scale *= 2.0
                weight *= 0.7
            values[row, column] = value
