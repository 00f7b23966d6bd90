"""A vertebra measured on its surface: median plane, endplates, frame and box of its body.

The median plane is where the mesh is its own mirror image. The body is measured by rays from its middle: up and down to
the endplates, sideways to its walls, backwards to the canal.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize
from scipy.spatial import cKDTree

from spinestiff.anatomy.rotation import exp_so3
from spinestiff.anatomy.solids import exits
from spinestiff.anatomy.template.surfaces import Surface
from spinestiff.arrays import Floats, Ints
from spinestiff.errors import TorsoError

BODY_SHAPE = (0.35, 1.5)  # depth over width
ROUNDS = 4
FAR_MM = 3.0
MOST_TURNED = 0.6  # cosine of 53 degrees, a vertebra's turn from the body's left
FLAT_MM = 3.2  # real endplates are concave by some 1 to 3 mm in sum; a body taken askew scores 4 and more
TILTS_DEG = (0.0, 20.0, -20.0, 40.0, -40.0)
_Plates = tuple[Floats, Floats, Floats, Floats, float]


@dataclass(frozen=True)
class MeasuredVertebra:
    """A vertebra's body in the world.

    Attributes
    ----------
    centre : (3,) mm, midway between the endplates' centres.
    axes : (3, 3) world_from_vertebra; x to the left, y along the body, z to its front.
    box : (8, 3) mm in these axes from the centre; order as ``TorsoModel.vertebra_boxes``.
    upper, lower : (3,) mm, the endplates' centres.
    upper_axes, lower_axes : (3, 3) their frames; y is the plate's normal, upwards.
    """

    centre: Floats
    axes: Floats
    box: Floats
    upper: Floats
    lower: Floats
    upper_axes: Floats
    lower_axes: Floats


def median_plane(points: Floats, up: Floats, rounds: int = 12) -> tuple[Floats, Floats]:
    """A point of the plane about which ``points`` (n, 3) on a surface mirror themselves best, and its unit normal.

    Looked for from the world's left and from 30 degrees about ``up`` to both sides of it. Pairs of a point and the
    nearest to its mirror image give a plane, some rounds long; the best one is polished: the mean distance of the
    mirror image, cut off at ``FAR_MM``, is minimised.
    """
    tree = cKDTree(points)
    some = points[:: max(1, len(points) // 600)]

    def apart_mm(place: Floats, normal: Floats) -> float:
        mirrored = some - 2.0 * np.outer((some - place) @ normal, normal)
        return float(tree.query(mirrored, distance_upper_bound=FAR_MM)[0].clip(max=FAR_MM).mean())

    left = np.array([1.0, 0.0, 0.0]) - up[0] * up
    starts = [exp_so3(np.deg2rad(turn) * up) @ (left / np.linalg.norm(left)) for turn in (0.0, 30.0, -30.0)]
    at, n = min((_paired(some, points, tree, start, rounds) for start in starts), key=lambda plane: apart_mm(*plane))
    across = np.linalg.svd(n[None])[2][1:]

    def plane(change: Floats) -> tuple[Floats, Floats]:
        turned = n + np.deg2rad(change[:2]) @ across
        turned /= np.linalg.norm(turned)
        return at + change[2] * turned, turned

    start = np.vstack([np.zeros(3), 4.0 * np.eye(3)])
    start[3, 2] = 1.0
    options = {"initial_simplex": start, "xatol": 0.02, "fatol": 1e-4, "maxfev": 200}
    return plane(minimize(lambda x: apart_mm(*plane(x)), np.zeros(3), method="Nelder-Mead", options=options).x)


def _paired(some: Floats, points: Floats, tree: cKDTree, normal: Floats, rounds: int) -> tuple[Floats, Floats]:
    at, n = points.mean(0), normal
    before: Ints = np.zeros(0, dtype=np.int64)
    for _ in range(rounds):
        distance, nearest = tree.query(some - 2.0 * np.outer((some - at) @ n, n))
        good = distance <= np.quantile(distance, 0.8)
        pairs = np.where(good, nearest, -1)
        if np.array_equal(pairs, before):
            break  # the same pairs, the same plane
        before = pairs
        p, q = some[good], points[nearest[good]]
        at = 0.5 * (p + q).mean(0)
        # Middles of pairs lie on the plane, differences across it.
        half, apart = 0.5 * (p + q) - at, p - q
        new = np.linalg.eigh(half.T @ half - 0.25 * apart.T @ apart)[1][:, 0]
        n = new if new @ n > 0.0 else -new
    return at, n


def measure_vertebra(name: str, surface: Surface, up: Floats, samples: Floats) -> MeasuredVertebra:
    """Frame, endplates and box of a vertebra.

    The body is looked for along ``up`` and tilted forwards and backwards from it until its endplates are flat; else the
    flattest hold.

    Parameters
    ----------
    name : for messages. surface : closed, outward, world mm. up : (3,) roughly along the spine there.
    samples : (n, 3) mm, points spread over the surface.

    Raises
    ------
    TorsoError : no vertebral body in front of a canal is found.
    """
    up = up / np.linalg.norm(up)
    left = np.array([1.0, 0.0, 0.0]) - up[0] * up
    left /= np.linalg.norm(left)
    at, x = median_plane(samples, up)
    if x @ left < MOST_TURNED:
        raise TorsoError(
            f"{name}: its two sides are too unlike to find its middle; is this mesh the right bone, and whole?"
        )
    best: tuple[float, Floats, Floats, _Plates] | None = None
    failure: TorsoError | None = None
    for tilt in TILTS_DEG:
        y = exp_so3(np.deg2rad(tilt) * x) @ up
        try:
            score, origin, axes, plates = _body(name, surface, samples, at, x, y - (y @ x) * x)
        except TorsoError as error:
            failure = failure or error
            continue
        if best is None or score < best[0]:
            best = (score, origin, axes, plates)
        if score < FLAT_MM:
            break
    if best is None:
        assert failure is not None
        raise failure
    upper, upper_normal, lower, lower_normal, _ = best[3]
    # The plates' tilt to the side holds, not the median plane's: it is what a radiograph shows.
    axes, centre = _framed(upper_normal + lower_normal, x), 0.5 * (upper + lower)
    box = _box(name, surface, centre, axes, upper, lower, upper_normal, lower_normal)
    return MeasuredVertebra(centre, axes, box, upper, lower, _framed(upper_normal, x), _framed(lower_normal, x))


def _body(
    name: str, surface: Surface, samples: Floats, at: Floats, x: Floats, y: Floats
) -> tuple[float, Floats, Floats, _Plates]:
    # The body found from one guess of its axis, and how far its endplates are from flat, parallel and across that axis.
    y = y / np.linalg.norm(y)
    axes = np.stack([x, y, np.cross(x, y)], -1)
    origin, half = _front_middle(samples, at, axes), np.array([10.0, 8.0, 8.0])
    for _ in range(ROUNDS):
        origin, half = _recentred(name, surface, origin, axes, half)
        plates = _plates(name, surface, origin, axes, half)
        normal = plates[1] + plates[3]
        y = normal - (normal @ x) * x
        y /= np.linalg.norm(y)
        axes = np.stack([x, y, np.cross(x, y)], -1)
    parallel = float(np.linalg.norm(np.cross(plates[1], plates[3])))
    return plates[4] + half[2] * parallel, origin, axes, plates


def _framed(normal: Floats, left: Floats) -> Floats:
    y = normal / np.linalg.norm(normal)
    x = left - (left @ y) * y
    x /= np.linalg.norm(x)
    return np.stack([x, y, np.cross(x, y)], -1)


def _front_middle(samples: Floats, at: Floats, axes: Floats) -> Floats:
    # A point somewhat behind the middle of the front wall; nothing of a vertebra lies before its body.
    local = (samples - at) @ axes
    near = np.abs(local[:, 0]) < 0.25 * np.abs(local[:, 0]).max()
    front = local[near, 2].max()
    depth = front - local[:, 2].min()
    wall = local[near & (local[:, 2] > front - 0.1 * depth)]
    height = 0.5 * (wall[:, 1].min() + wall[:, 1].max())
    return at + axes @ np.array([0.0, height, front - 0.15 * depth])


def _recentred(name: str, surface: Surface, origin: Floats, axes: Floats, half: Floats) -> tuple[Floats, Floats]:
    # Origin to the middle between the walls it sees along z, y and x in turn; and the half sizes.
    half = half.copy()
    for axis in (2, 1, 2, 0):
        spread = [0.0, -0.25, 0.25]
        across = [i for i in range(3) if i != axis]
        starts = np.array([origin + axes[:, across[0]] * s * half[across[0]] + axes[:, across[1]] * r * half[across[1]]
                           for s in spread for r in spread])  # fmt: skip
        ahead, back = exits(surface, starts, axes[:, axis]), exits(surface, starts, -axes[:, axis])
        if np.isfinite(ahead + back).sum() < 3:
            raise TorsoError(f"{name}: no vertebral body found where its front should be; is this mesh the right bone?")
        forwards, backwards = float(np.nanmedian(ahead)), float(np.nanmedian(back))
        if axis != 0:  # the median plane is known better from the whole bone
            origin = origin + axes[:, axis] * 0.5 * (forwards - backwards)
        half[axis] = 0.5 * (forwards + backwards)
    if not BODY_SHAPE[0] <= half[2] / half[0] <= BODY_SHAPE[1]:
        raise TorsoError(
            f"{name}: its body would be {2 * half[0]:.0f} mm wide and {2 * half[2]:.0f} mm deep; "
            "is the canal behind it closed, or the mesh another bone?"
        )
    return origin, half


def _plates(name: str, surface: Surface, origin: Floats, axes: Floats, half: Floats) -> _Plates:
    # Centre and upward normal of the upper and the lower endplate, fitted to where rays leave the body; how far off.
    grid = np.linspace(-0.62, 0.62, 7)
    s, t = (v.ravel() for v in np.meshgrid(grid, grid, indexing="ij"))
    inner = np.hypot(s, t) < 0.75
    starts = origin + np.outer(s[inner] * half[0], axes[:, 0]) + np.outer(t[inner] * half[2], axes[:, 2])
    found: list[Floats] = []
    off = 0.0
    for sign in (1.0, -1.0):
        reach = sign * exits(surface, starts, sign * axes[:, 1])
        points = starts + reach[:, None] * axes[:, 1]
        good = np.isfinite(reach) & (np.abs(reach) < 2.2 * half[1])
        if good.sum() < 10:
            raise TorsoError(
                f"{name}: no {'upper' if sign > 0 else 'lower'} endplate found; is this mesh the right bone?"
            )
        centre, normal = fitted_plane(points[good], axes[:, 1])
        # The plate's centre lies on the body's axis.
        found += [origin + axes[:, 1] * float((centre - origin) @ normal / (axes[:, 1] @ normal)), normal]
        off += float(np.abs((points[good] - centre) @ normal).mean()) + 0.2 * float((~good).sum())
    return (found[0], found[1], found[2], found[3], off)


def fitted_plane(points: Floats, up: Floats) -> tuple[Floats, Floats]:
    """A point and the unit normal (along ``up``) of a plane through ``points`` (n, 3); outliers count little."""
    weight = np.ones(len(points))
    for _ in range(20):
        centre = (weight[:, None] * points).sum(0) / weight.sum()
        apart = points - centre
        normal = np.linalg.eigh((weight[:, None] * apart).T @ apart)[1][:, 0]
        off = np.abs(apart @ normal)
        scale = max(float(np.median(off)), 0.1)
        weight = 1.0 / (1.0 + (off / (2.0 * scale)) ** 2) ** 2
    return centre, normal if normal @ up > 0.0 else -normal


def _box(
    name: str, surface: Surface, centre: Floats, axes: Floats, upper: Floats, lower: Floats, *normals: Floats
) -> Floats:
    # Half widths and depths near each plate; the corners lie on the plates' planes.
    corners = []
    for plate, normal in ((upper, normals[0]), (lower, normals[1])):
        inwards = centre - plate
        sizes = {}
        for axis, sign in ((0, 1.0), (0, -1.0), (2, 1.0), (2, -1.0)):
            starts = np.array([plate + share * inwards for share in (0.12, 0.18, 0.25, 0.32, 0.4)])
            reach = exits(surface, starts, sign * axes[:, axis])
            if not np.isfinite(reach).any():
                raise TorsoError(f"{name}: an endplate has no rim; is this mesh the right bone?")
            # The rim bulges beyond the waist. Where a ray runs on into the arch, others don't.
            sizes[axis, sign] = float(np.nanquantile(reach, 0.6))
        for sx in (1.0, -1.0):
            for sz in (1.0, -1.0):
                flat = sx * sizes[0, sx] * axes[:, 0] + sz * sizes[2, sz] * axes[:, 2]
                rise = -float(flat @ normal) / float(axes[:, 1] @ normal)
                corners.append((plate + flat + rise * axes[:, 1] - centre) @ axes)
    return np.array(corners)
