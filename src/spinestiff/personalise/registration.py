"""Where a skin scan lies on a torso: its turn and shift, by robust closest points from many starts.

A scan has an origin of its own, and a person turns and leans a little between radiograph and scan. Only what faces the
skin counts: arms, head and legs, and what was scanned around the person, find no skin that looks their way near by.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from spinestiff.anatomy.rotation import exp_so3
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.arrays import Floats, Ints
from spinestiff.errors import SubjectError
from spinestiff.personalise.scan import SkinScan
from spinestiff.personalise.skin_surface import SkinSurface, skin_surface

# Degrees about the vertical from the stated axes: more is another axis.
MOST_YAW_DEG = 45.0
START_YAWS_DEG = (-30.0, 30.0)  # beside none
START_STEP_MM = 60.0
# Degrees, standard deviation of a lean in the scan, and the most of it.
TILT_SD_DEG, MOST_TILT_DEG = 4.0, 15.0
# mm: a point this far off counts nothing. From the first closest points, which bridge the wrong place, to the last,
# which bridge the difference between two bodies.
REACHES_MM = (120.0, 90.0, 60.0, 60.0, 45.0, 45.0, 45.0)
ROUNDS_A_REACH = 3
LAST_MM = 45.0
# mm that a turn by 1 rad counts for in what is closest: a back is never taken for a belly.
FACING_MM = 90.0
LEAST_ALIKE = 0.6  # cosine between the scan's direction and the skin's
ASIDE_MM = 15.0  # that a point may lie beside the skin's normal
SEARCH_STEP_MM = 26.0  # between the skin's points
FEW, SOME = 150, 1500  # points for telling starts apart, and for the best of them
KEPT = 3
# A wrong set of axes that fits so much better than the stated one proves those wrong.
BETTER = 0.85
# The least share of a scan that faces the skin, and how firmly this has to hold the height: the mean square of
# what their directions say of it alone.
LEAST_MATCHED = 0.10
LEAST_HOLD = 0.02
WRONG_AXES = {
    "left and front turned round": np.diag([-1.0, 1.0, -1.0]),
    "left and up turned round": np.diag([-1.0, -1.0, 1.0]),
    "up and front turned round": np.diag([1.0, -1.0, -1.0]),
}


@dataclass(frozen=True)
class Placement:
    """World from scan: x = turn @ (points - middle) + shift.

    Attributes
    ----------
    turn : (3, 3).
    middle, shift : (3,) mm.
    inside_out : whether the scan's triangles face inward.
    cost : mm2, mean over all points of the squared distance, no point counting more than 45 mm.
    """

    turn: Floats
    middle: Floats
    shift: Floats
    inside_out: bool
    cost: float

    @property
    def yaw_deg(self) -> float:
        """Turn about the vertical."""
        return float(np.degrees(np.arctan2(self.turn[0, 2], self.turn[2, 2])))

    @property
    def tilt_deg(self) -> float:
        """Between the scan's vertical and the torso's."""
        return float(np.degrees(np.arccos(np.clip(self.turn[1, 1], -1.0, 1.0))))

    def placed(self, scan: SkinScan) -> SkinScan:
        """The scan in world axes, facing outward."""
        normals = scan.normals @ self.turn.T * (-1.0 if self.inside_out else 1.0)
        return SkinScan((scan.points - self.middle) @ self.turn.T + self.shift, normals, scan.name)


@dataclass(frozen=True)
class Matches:
    """Points of a scan that face the skin.

    Attributes
    ----------
    scan : (m,) their numbers.
    skin : (m,) the point of the skin that each belongs to.
    off : (m,) mm, how far the scan lies outside the skin, along the skin's normal.
    """

    scan: Ints
    skin: Ints
    off: Floats


def matches(skin: SkinSurface, scan: SkinScan, reach: float) -> Matches:
    """What of a placed scan faces the skin within ``reach`` mm."""
    if not len(scan.points):
        return Matches(np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros(0))
    return _Matcher(skin).matches(scan.points, scan.normals, reach)


class _Matcher:
    """A search of the skin by place and direction together."""

    def __init__(self, skin: SkinSurface) -> None:
        self.skin = skin
        self.tree = cKDTree(np.hstack([skin.points, FACING_MM * skin.normals]))

    def matches(self, points: Floats, normals: Floats, reach: float) -> Matches:
        _, near = self.tree.query(np.hstack([points, FACING_MM * normals]))
        normal = self.skin.normals[near]
        apart = points - self.skin.points[near]
        off = np.einsum("ni,ni->n", apart, normal)
        aside = np.linalg.norm(apart - off[:, None] * normal, axis=1)
        alike = np.einsum("ni,ni->n", normal, normals)
        good = (np.abs(off) < reach) & (aside < np.maximum(ASIDE_MM, 0.5 * reach)) & (alike > LEAST_ALIKE)
        good &= ~self.skin.ends[near]
        kept = np.flatnonzero(good)
        return Matches(kept, near[kept], off[kept])


def register(scan: SkinScan, torso: TorsoModel) -> Placement:
    """Where the scan lies on the skin of a torso at rest.

    Raises
    ------
    SubjectError : the scan does not face this skin, other axes than the stated ones fit better, it stands turned by
        more than 45 degrees, or it does not tell how high it sits.
    """
    skin = skin_surface(torso, SEARCH_STEP_MM)
    matcher = _Matcher(skin)
    rng = np.random.default_rng(0)
    order = rng.permutation(len(scan.points))
    few, some = (SkinScan(scan.points[order[:n]], scan.normals[order[:n]]) for n in (FEW, SOME))
    best = _best(matcher, few, some, np.eye(3), (False, True), START_YAWS_DEG)
    others = {said: _best(matcher, few, some, turn, (best.inside_out,), ()) for said, turn in WRONG_AXES.items()}
    said, other = min(others.items(), key=lambda item: item[1].cost)
    if other.cost < BETTER * best.cost:
        raise SubjectError(
            f"skin scan: {scan.name} fits the body better with {said} ({np.sqrt(other.cost):.0f} mm off, as stated "
            f"{np.sqrt(best.cost):.0f} mm); check the axes"
        )
    if abs(best.yaw_deg) > MOST_YAW_DEG or best.tilt_deg > MOST_TILT_DEG:
        raise SubjectError(
            f"skin scan: {scan.name} stands turned by {best.yaw_deg:.0f} degrees about the vertical and leans by "
            f"{best.tilt_deg:.0f}; wanted at most {MOST_YAW_DEG:g} and {MOST_TILT_DEG:g}: check the axes"
        )
    found = best.placed(scan)
    held = matcher.matches(found.points, found.normals, LAST_MM)
    if len(held.scan) < LEAST_MATCHED * len(scan.points) or len(held.scan) < 6:
        raise SubjectError(
            f"skin scan: {100.0 * len(held.scan) / len(scan.points):.0f} % of {scan.name} face the skin of this body "
            f"within {LAST_MM:g} mm, wanted {100.0 * LEAST_MATCHED:g} %; check unit, axes and what was scanned"
        )
    hold = height_hold(skin, held)
    if hold < LEAST_HOLD:
        raise SubjectError(
            f"skin scan: {scan.name} does not tell how high on the trunk it sits (hold {hold:.3f}, wanted "
            f"{LEAST_HOLD:g}); scan more of shoulders, waist or hips"
        )
    return best


def height_hold(skin: SkinSurface, held: Matches) -> float:
    """How firmly matches hold the height: mean square of the normals' vertical part that no other motion explains."""
    rows = _rows(skin, held.skin, skin.points.mean(0))
    hessian = rows.T @ rows / len(rows)
    others = [0, 2, 3, 4, 5]
    cross = hessian[np.ix_(others, [1])]
    taken = cross.T @ np.linalg.lstsq(hessian[np.ix_(others, others)], cross, rcond=None)[0]
    return float(hessian[1, 1] - taken[0, 0])


def _best(
    matcher: _Matcher, few: SkinScan, some: SkinScan, turn: Floats, sides: Sequence[bool], yaws: Sequence[float]
) -> Placement:
    starts = [
        _refined(matcher, few, start, REACHES_MM[:3])
        for inside_out in sides
        for start in _starts(matcher.skin, few, turn, inside_out)
    ]
    outward = min(starts, key=lambda placement: placement.cost).inside_out
    starts += [
        _refined(matcher, few, start, REACHES_MM[:3])
        for yaw in yaws
        for start in _starts(matcher.skin, few, exp_so3(np.array([0.0, np.deg2rad(yaw), 0.0])) @ turn, outward)
    ]
    best = sorted(starts, key=lambda placement: placement.cost)[:KEPT]
    return min((_refined(matcher, some, start, REACHES_MM) for start in best), key=lambda placement: placement.cost)


def _starts(skin: SkinSurface, scan: SkinScan, turn: Floats, inside_out: bool) -> list[Placement]:
    # The scan's middle over the skin's, at heights from feet to head.
    middle = np.median(scan.points, axis=0)
    turned = (scan.points - middle) @ turn.T
    low, high = skin.points[:, 1].min(), skin.points[:, 1].max()
    bottom, top = np.percentile(turned[:, 1], [1.0, 99.0])
    # The shorter of the two lies within the longer one, give or take a third of it.
    slack = 0.33 * min(top - bottom, high - low)
    ends = sorted([low - bottom, high - top])
    heights = np.arange(ends[0] - slack, ends[1] + slack + START_STEP_MM, START_STEP_MM)
    across, _, deep = np.median(skin.points, axis=0)
    return [Placement(turn, middle, np.array([across, y, deep]), inside_out, np.inf) for y in heights]


def _refined(matcher: _Matcher, scan: SkinScan, start: Placement, reaches: Sequence[float]) -> Placement:
    turn, shift = start.turn, start.shift
    normal = -scan.normals if start.inside_out else scan.normals
    upright = start.turn[:, 1]
    about = matcher.skin.points.mean(0)
    # A lean costs as much as every point a centimetre off where it reaches its standard deviation.
    prior = (10.0 / np.deg2rad(TILT_SD_DEG)) ** 2 * np.diag([1.0, 0.0, 1.0])
    for reach in (r for r in reaches for _ in range(ROUNDS_A_REACH)):
        points = (scan.points - start.middle) @ turn.T + shift
        held = matcher.matches(points, normal @ turn.T, reach)
        if len(held.scan) < 6:
            break
        rows = _rows(matcher.skin, held.skin, about)
        weight = (1.0 - (held.off / reach) ** 2) ** 2
        # Next to nothing on what no point tells of, so that the step has one answer.
        hessian = (weight[:, None] * rows).T @ rows / len(rows) + np.diag([1e-6, 1e-6, 1e-6, 1.0, 1.0, 1.0])
        slope = rows.T @ (weight * held.off) / len(rows)
        hessian[3:, 3:] += prior
        slope[3:] += prior @ np.cross(upright, turn[:, 1])
        step = np.asarray(-np.linalg.solve(hessian, slope), dtype=np.float64)
        move = exp_so3(step[3:])
        turn = move @ turn
        shift = move @ (shift - about) + about + step[:3]
    points = (scan.points - start.middle) @ turn.T + shift
    held = matcher.matches(points, normal @ turn.T, LAST_MM)
    cost = (len(points) - len(held.scan)) * LAST_MM**2 + np.sum(held.off**2)
    return Placement(turn, start.middle, shift, start.inside_out, float(cost / len(points)))


def _rows(skin: SkinSurface, matched: Ints, about: Floats) -> Floats:
    # (m, 6) derivative of the distances in a shift and a turn of the scan about a point.
    normal = skin.normals[matched]
    return np.hstack([normal, np.cross(skin.points[matched] - about, normal)])
