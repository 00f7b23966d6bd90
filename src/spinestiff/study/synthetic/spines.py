"""Rest shapes of synthetic subjects: curves of a wanted Cobb angle, and real spines from a table."""

from __future__ import annotations

import csv
import io
from pathlib import Path

import numpy as np
from scipy.optimize import brentq

from spinestiff.anatomy.names import VERTEBRAE
from spinestiff.anatomy.rotation import exp_so3
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.arrays import Floats
from spinestiff.errors import SubjectError
from spinestiff.files import regular_file
from spinestiff.formats import plain_number

# Apex as a share of the way from L5 to T1, and width, of a single curve; a double curve is a pair of opposite ones.
CURVES = {
    "thoracic": ((0.62, 0.22, 1.0),),
    "thoracolumbar": ((0.40, 0.24, 1.0),),
    "lumbar": ((0.24, 0.20, 1.0),),
    "double": ((0.68, 0.17, 1.0), (0.26, 0.17, -0.8)),
}
# Of a curve that compensates the first one, which it has beside it on the other side: apex and width.
SECONDARY = {"thoracic": (0.26, 0.17), "thoracolumbar": (0.76, 0.17), "lumbar": (0.64, 0.20)}
LARGEST_COBB_DEG = 80.0
# Vertebrae turn towards the convexity, about a third of the coronal tilt's size at the apex (Easwar et al. 2011 report
# the coupling, its size varies).
AXIAL_COUPLING = 0.3
SMOOTHING_LEVELS = 3.0
LARGEST_STRAY_MM = 5.0
LARGEST_TABLE = 50 * 2**20  # bytes
# Distance of neighbouring bodies over their mean height: below, they overlap; above, the disc is as tall as a body.
SPACING = (1.0, 2.2)

VertebraPoses = tuple[Floats, Floats]


def rest_vertebrae(torso: TorsoModel) -> VertebraPoses:
    """(V, 3) mm and (V, 3, 3): where the torso's vertebrae are at rest."""
    bones = torso.vertebra_bones
    return torso.rest_pose.bone_positions[bones], torso.rest_pose.bone_rotations[bones]


def curved_spine(torso: TorsoModel, cobb_deg: float, curve: str, secondary: float = 0.0) -> VertebraPoses:
    """The torso's spine bent sideways until its largest coronal angle is ``cobb_deg`` (above 0: left-convex).

    Neighbouring vertebrae stay as far apart as they are in the torso, so that the spine's length stays and T1 comes
    down; it stays over L5.

    Parameters
    ----------
    secondary : deflection of a second curve to the other side over the first one's (``SECONDARY``).

    Raises
    ------
    SubjectError : unknown curve name, an angle outside +-80 degrees, or a secondary curve beside a double one.
    """
    if curve not in CURVES:
        raise SubjectError(f"unknown curve '{curve}'; wanted one of {', '.join(CURVES)}")
    if secondary and curve not in SECONDARY:
        raise SubjectError(f"curve '{curve}' with a secondary one; wanted one of {', '.join(SECONDARY)}")
    if not abs(cobb_deg) <= LARGEST_COBB_DEG:
        raise SubjectError(f"Cobb angle {cobb_deg} degrees; wanted at most {LARGEST_COBB_DEG:g} to either side")
    positions, rotations = rest_vertebrae(torso)
    height = positions[:, 1] - positions[-1, 1]
    share = height / height[0]
    bumps = (*CURVES[curve], *(((*SECONDARY[curve], -secondary),) if secondary else ()))
    bump = sum(side * np.exp(-(((share - apex) / width) ** 2)) for apex, width, side in bumps)
    # Ends stay over each other: what is left of the bump there is taken out along the spine.
    bump = bump - (bump[-1] + (bump[0] - bump[-1]) * share)
    slope = np.gradient(bump, height)

    def angle(amplitude: float) -> float:
        lean = np.arcsin(amplitude * slope)
        return float(np.degrees(lean.max() - lean.min()))

    steepest = 1.0 / np.abs(slope).max()
    amplitude = 0.0 if cobb_deg == 0.0 else brentq(lambda a: angle(a) - abs(cobb_deg), 0.0, steepest)
    amplitude *= np.sign(cobb_deg)
    # Moving left while going up leans the left side down: a turn about z (anterior) by minus the lean.
    tilt = -np.arcsin(amplitude * slope)
    axial = AXIAL_COUPLING * amplitude * np.abs(slope).max() * bump / np.abs(bump).max()
    turned = exp_so3(np.outer(tilt, [0.0, 0.0, 1.0])) @ exp_so3(np.outer(axial, [0.0, 1.0, 0.0])) @ rotations
    # A spine that bends keeps its length and loses height.
    aside, rise = np.diff(amplitude * bump), np.diff(height)
    lower = height[0] - np.concatenate([[0.0], np.cumsum(np.sqrt(rise**2 - aside**2))])
    placed = positions.copy()
    placed[:, 0] += amplitude * bump
    placed[:, 1] = positions[-1, 1] + lower - lower[-1]
    return placed, turned


def real_spine(torso: TorsoModel, table: str | Path, spine_id: str) -> VertebraPoses:
    """A measured spine of the table, scaled to the torso's spine and set on its pelvis.

    The table has columns ``id, level, keypoint, x_mm, y_mm, z_mm`` with a ``body`` and, where known, a ``left`` and
    a ``right`` pedicle point for T1 to L5, in DICOM's patient frame (x left, y posterior, z up). Places and
    directions come from local parabolas through the bodies; axial rotation from the pedicles, smoothed alike.

    Raises
    ------
    SubjectError : no such file or spine, a spine without all 17 bodies, with neighbours that overlap or lie too far
        apart, or with a body far off the others' line.
    """
    points = _read_points(Path(table), spine_id)
    rest, _ = rest_vertebrae(torso)
    bodies = np.array([points[level]["body"] for level in VERTEBRAE])
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(bodies, axis=0), axis=1))])
    wanted = float(np.sum(np.linalg.norm(np.diff(rest, axis=0), axis=1)))
    # As the table has them, before a gap is smoothed over its neighbours and one of these seems to stray.
    try:
        refuse_spacing(bodies, body_heights(torso.vertebra_boxes) * arc[-1] / wanted)
    except SubjectError as error:
        raise SubjectError(f"{table}: spine '{spine_id}': {error}") from None
    smooth, slope = smoothed(bodies, arc)
    stray = np.linalg.norm(smooth - bodies, axis=1)
    if stray.max() > LARGEST_STRAY_MM:
        worst = int(np.argmax(stray))
        raise SubjectError(
            f"{table}: spine '{spine_id}': {VERTEBRAE[worst]} lies {stray[worst]:.1f} mm off the others' line "
            f"(limit {LARGEST_STRAY_MM:g}); a wrong point?"
        )
    centres, up = smooth * wanted / arc[-1], -slope
    axial = _axial_rotation(points)
    frames = _upright(centres, rest)
    return rest[-1] + (centres - centres[-1]) @ frames.T, frames @ _vertebra_frames(up, axial)


def body_heights(boxes: Floats) -> Floats:
    """(V,) mm, mean heights of vertebrae with boxes (V, 8, 3) as ``TorsoModel.vertebra_boxes``."""
    corners = boxes.reshape(-1, 2, 4, 3)
    return np.asarray(np.mean(corners[:, 0, :, 1] - corners[:, 1, :, 1], axis=1))


def refuse_spacing(centres: Floats, heights: Floats) -> None:
    """Refuses a spine whose bodies overlap, or in which a level is missing.

    Parameters
    ----------
    centres : (17, 3) mm, T1 to L5. heights : (17,) mm, of the bodies.

    Raises
    ------
    SubjectError : names the two levels that are farthest from any spine's, how far apart they lie, and what is wanted.
    """
    apart = np.linalg.norm(np.diff(centres, axis=0), axis=1)
    height = 0.5 * (heights[1:] + heights[:-1])
    low, high = (limit * height for limit in SPACING)
    worst = int(np.argmax(np.maximum(low / np.maximum(apart, 1e-9), apart / high)))
    if not low[worst] <= apart[worst] <= high[worst]:
        cause = "do they overlap" if apart[worst] < low[worst] else "is a level missing"
        raise SubjectError(
            f"{VERTEBRAE[worst]} and {VERTEBRAE[worst + 1]} lie {apart[worst]:.0f} mm apart; "
            f"wanted {low[worst]:.0f} to {high[worst]:.0f} mm, {SPACING[0]:g} to {SPACING[1]:g} of their height; "
            f"{cause}, or is a point wrong?"
        )


def smoothed(bodies: Floats, arc: Floats) -> tuple[Floats, Floats]:
    """Points and tangents (V, D) at ``arc`` (V,) from about two vertebrae to each side: local parabolas, and lines.

    Points on a grid of 1 to 3 mm carry angles of several degrees of noise from one to the next; a parabola's slope at
    the ends of the spine would be three times as noisy as the line's.
    """
    smooth, slope = np.empty_like(bodies), np.empty_like(bodies)
    for i, here in enumerate(arc):
        distance = np.abs(np.arange(len(arc)) - i) / SMOOTHING_LEVELS
        weight = np.sqrt(np.where(distance < 1.0, (1.0 - distance**3) ** 3, 0.0))[:, None]
        powers = (arc - here)[:, None] ** np.arange(3)
        parabola, line = (
            np.linalg.lstsq(weight * powers[:, :terms], weight * bodies, rcond=None)[0] for terms in (3, 2)
        )
        smooth[i], slope[i] = parabola[0], line[1]
    return smooth, slope


def _read_points(table: Path, spine_id: str) -> dict[str, dict[str, Floats]]:
    regular_file(table, SubjectError, cap_bytes=LARGEST_TABLE)
    points: dict[str, dict[str, Floats]] = {}
    try:
        text = table.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise SubjectError(f"{table}: not UTF-8 text (byte {error.start}); wanted a CSV table") from None
    rows = csv.DictReader(io.StringIO(text, newline=""))
    try:
        missing = {"id", "level", "keypoint", "x_mm", "y_mm", "z_mm"} - set(rows.fieldnames or ())
        if missing:
            raise SubjectError(f"{table}: column '{sorted(missing)[0]}' is missing")
        for row in rows:
            if row["id"] == spine_id and row["x_mm"]:
                where = f"{table}: line {rows.line_num}"
                lps = [plain_number(row[key] or "") for key in ("x_mm", "y_mm", "z_mm")]
                if not np.isfinite(lps).all():
                    raise SubjectError(f"{where}: not a number")
                known = points.setdefault(row["level"], {})
                if row["keypoint"] in known:
                    raise SubjectError(f"{where}: {row['keypoint']} of {row['level']} is given twice; keep one")
                known[row["keypoint"]] = torso_from_lps(np.array(lps))
    except csv.Error as error:
        raise SubjectError(f"{table}: after line {rows.line_num}: not CSV ({error})") from None
    if not points:
        raise SubjectError(f"{table}: no spine '{spine_id}'")
    lacking = [level for level in VERTEBRAE if "body" not in points.get(level, {})]
    if lacking:
        raise SubjectError(f"{table}: spine '{spine_id}' has no body point for {lacking[0]}")
    return points


def torso_from_lps(points: Floats) -> Floats:
    """DICOM's patient frame (x left, y posterior, z superior) to the torso's (x left, y superior, z anterior)."""
    return np.stack([points[..., 0], points[..., 2], -points[..., 1]], -1)


def _axial_rotation(points: dict[str, dict[str, Floats]]) -> Floats:
    angles = np.full(len(VERTEBRAE), np.nan)
    for i, level in enumerate(VERTEBRAE):
        pair = points[level]
        if "left" in pair and "right" in pair:
            left = pair["left"] - pair["right"]
            angles[i] = np.arctan2(-left[2], left[0])
    known = np.isfinite(angles)
    if known.sum() < 3:
        return np.zeros(len(VERTEBRAE))
    number = np.arange(float(len(VERTEBRAE)))
    filled = np.interp(number, number[known], angles[known] - np.median(angles[known]))
    # Pedicle points of single levels stray by tens of degrees: a median of five before the smoothing.
    padded = np.pad(filled, 2, mode="reflect")
    middle = np.median(np.lib.stride_tricks.sliding_window_view(padded, 5), axis=1)
    return np.asarray(smoothed(middle[:, None], number)[0][:, 0])


def _vertebra_frames(up: Floats, axial: Floats) -> Floats:
    y = up / np.linalg.norm(up, axis=1, keepdims=True)
    left = np.stack([np.cos(axial), np.zeros_like(axial), -np.sin(axial)], 1)
    x = left - np.sum(left * y, axis=1, keepdims=True) * y
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    return np.stack([x, y, np.cross(x, y)], axis=2)


def _upright(centres: Floats, rest: Floats) -> Floats:
    """The turn that brings the top of the spine over the pelvis as in the template: about z, then about x."""
    chord, wanted = centres[0] - centres[-1], rest[0] - rest[-1]
    roll = np.arctan2(chord[0], chord[1])
    upright = exp_so3(np.array([0.0, 0.0, roll]))
    chord = upright @ chord
    pitch = np.arctan2(wanted[2], wanted[1]) - np.arctan2(chord[2], chord[1])
    return np.asarray(exp_so3(np.array([pitch, 0.0, 0.0])) @ upright)
