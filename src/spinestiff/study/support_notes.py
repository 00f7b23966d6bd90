"""What the reactions and the pelvis of an equilibrium say against the supports as they were modelled."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from spinestiff.anatomy.state import TorsoState
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.arrays import Floats
from spinestiff.imaging.tracking import OBLIQUITY_LIMIT_DEG
from spinestiff.mechanics.places import place_of_pelvis
from spinestiff.mechanics.supports import SupportKind, Supports
from spinestiff.words import counted

PULLING_LIMIT_N = 2.0
"""A reaction that pulls on its support by more says that the person would have left it."""


def support_notes(
    torso: TorsoModel, supports: Supports, state: TorsoState, forces: Floats, side: str
) -> dict[str, str]:
    """Where a support pulls, and how far the pelvis turned, if beyond the limits.

    By "shoulder", "wall" and "pelvis".

    Parameters
    ----------
    forces : (S, 3) N, what the springs of ``supports`` exert, in their order.
    side : from which the push came.
    """
    found = {}
    push = 1.0 if side == "right" else -1.0
    for force in forces[supports.of_kind(SupportKind.SHOULDER)]:
        # The shoulder's wall pushes back against the force; a support can't pull.
        if push * force[0] > PULLING_LIMIT_N:
            found["shoulder"] = f"the shoulder's support pulls with {push * force[0]:.1f} N"
    pulling = [
        (name, -force[2])
        for name, kind, force in zip(supports.names, supports.kinds, forces)
        if kind is SupportKind.WALL and force[2] < -PULLING_LIMIT_N
    ]
    if pulling:
        bone, most = max(pulling, key=lambda entry: entry[1])
        points = counted(len(pulling), "point")
        worst = f"most at {bone}, {most:.1f} N"
        found["wall"] = f"the back wall pulls at {points} ({worst}): the back would have left the wall there"
    obliquity = float(np.degrees(place_of_pelvis(torso, state)))
    if abs(obliquity) > OBLIQUITY_LIMIT_DEG:
        found["pelvis"] = f"the pelvis tilts by {obliquity:+.1f} degrees (limit {OBLIQUITY_LIMIT_DEG:g})"
    return found


def strongest_notes(frames: Sequence[tuple[str, int, float, Mapping[str, str]]]) -> list[str]:
    """A line a push and support, from the frame of the largest force; how many others say the like.

    Parameters
    ----------
    frames : push, number, force (N) and notes of each.
    """
    told: dict[tuple[str, str], list[tuple[float, int, str]]] = {}
    for push, number, force, notes in frames:
        for support, text in notes.items():
            told.setdefault((push, support), []).append((force, number, text))
    lines = []
    for (push, _), found in told.items():
        _, number, text = max(found)
        others = f" and {counted(len(found) - 1, 'other frame')}" if len(found) > 1 else ""
        lines.append(f"push '{push}' frame {number}{others}: {text}")
    return lines
