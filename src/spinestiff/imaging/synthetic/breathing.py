"""Breathing as a change of a torso's state: ribs turn on their vertebrae, the sternum follows, vertebrae stay.

A rib turns about the axis through its neck. Axes of upper ribs lie nearer to the frontal plane, so that their front
ends rise and go forward (pump handle); axes of lower ribs point more backward, so that their sides rise (bucket
handle). The torso's tissue is left where it is: what the change is for is the picture.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from spinestiff.anatomy.names import SIDES
from spinestiff.anatomy.rotation import exp_so3
from spinestiff.anatomy.state import TorsoState
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.arrays import Floats
from spinestiff.errors import RadiographError

# Angle of the neck axis from the frontal plane, degrees, ribs 1 to 12: from nearly lateral to pointing backward
# (design, after the range that anatomy books give, about 25 to 45 and more at the lowest ribs).
_AXIS_DEG = np.interp(np.arange(12), [0.0, 5.0, 11.0], [22.0, 35.0, 50.0])
_STERNAL = range(2, 8)  # ribs whose front ends carry the sternum


@dataclass(frozen=True)
class Breathing:
    """Quiet breathing.

    Attributes
    ----------
    rise : mm, half the way of the ribs' front ends between in- and expiration.
    diaphragm : mm, half the way of the diaphragm.
    period : s.

    Raises
    ------
    RadiographError : negative ways, or no period.
    """

    rise: float = 2.0
    diaphragm: float = 5.0
    period: float = 4.0

    def __post_init__(self) -> None:
        if not (self.rise >= 0.0 and self.diaphragm >= 0.0 and self.period > 0.0):
            raise RadiographError(
                f"breathing by {self.rise:g} and {self.diaphragm:g} mm in {self.period:g} s; wanted 0 or more, and a "
                "period above 0"
            )

    def phase(self, time: float, start: float = 0.0) -> float:
        """From -1 (expired) to 1 (inspired), ``time`` s after a start at phase angle ``start`` rad."""
        return float(np.sin(start + 2.0 * np.pi * time / self.period))


def breathed(torso: TorsoModel, state: TorsoState, rise: float) -> TorsoState:
    """The state with the front ends of the ribs about ``rise`` mm higher; vertebrae and tissue nodes stay."""
    positions, rotations = state.bone_positions.copy(), state.bone_rotations.copy()
    carried: list[Floats] = []
    for number in range(1, 13):
        for side in SIDES:
            if f"R{number}_{side}" not in torso.bone_names:
                continue
            rib, vertebra = torso.bone(f"R{number}_{side}"), torso.bone(f"T{number}")
            surface = torso.surface_positions(state, rib)
            spine = state.bone_positions[vertebra]
            away = np.linalg.norm(surface - spine, axis=1)
            head = surface[away <= np.quantile(away, 0.05)].mean(axis=0)
            tip = surface[away >= np.quantile(away, 0.97)].mean(axis=0)
            angle = np.deg2rad(_AXIS_DEG[number - 1])
            sign = 1.0 if side == "L" else -1.0
            axis = state.bone_rotations[vertebra] @ np.array([-np.cos(angle), 0.0, sign * np.sin(angle)])
            lever = float(np.cross(axis, tip - head)[1])
            # The first rib hardly moves, and floating ribs have no front end to speak of.
            wanted = rise * (0.4 if number == 1 else 1.0 if number <= 10 else 0.5)
            if abs(lever) < 20.0:
                continue
            turn = exp_so3(axis * (wanted / lever))
            positions[rib] = head + turn @ (positions[rib] - head)
            rotations[rib] = turn @ rotations[rib]
            if number in _STERNAL:
                carried.append(head + turn @ (tip - head) - tip)
    if carried and "sternum" in torso.bone_names:
        positions[torso.bone("sternum")] += np.mean(carried, axis=0) * [0.0, 1.0, 1.0]
    return replace(state, bone_positions=positions, bone_rotations=rotations)
