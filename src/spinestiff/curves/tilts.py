"""How a spine is tilted and curved (paper 5, Tables 2 and 6).

Tilt of a vertebra or an endplate: the rotation in the frontal plane about the world's z axis, anticlockwise seen from
the front. So a tilt above 0 means that the patient's left side is higher.

Cobb angle: tilt of the superior endplate of the upper minus tilt of the inferior endplate of the lower end vertebra.
Where the spine is convex to the patient's left, the lower end vertebra leans left (left side lower, tilt below 0) and
the upper one leans back right (tilt above 0), so a Cobb angle above 0 is a left-convex curve, as in Table 2.

Tilts are in rad; what a clinician reads (Cobb angles) is in degrees and says so by name.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from spinestiff.arrays import Floats, read_only
from spinestiff.errors import SpinestiffError
from spinestiff.imaging.features import picture_axes, view_kind

if TYPE_CHECKING:
    from spinestiff.imaging.projection import XRayView

# Two pairs whose angles differ by less (rad) are tied; rounding must not choose the end vertebrae.
TIE = 1e-11
EndplateMethod = Literal["endplates", "midline"]


@dataclass(frozen=True)
class SpineTilts:
    """Frontal tilts of a spine's vertebrae, head to foot.

    Attributes
    ----------
    vertebrae : (n,) names, n >= 2.
    superior, inferior : (n,) rad, tilt of the endplates; above 0 = the patient's left side is higher.
    """

    vertebrae: tuple[str, ...]
    superior: Floats
    inferior: Floats

    def __post_init__(self) -> None:
        object.__setattr__(self, "vertebrae", tuple(self.vertebrae))
        n = len(self.vertebrae)
        if n < 2:
            raise SpinestiffError(f"a curve needs the tilts of at least 2 vertebrae, found {n}")
        for key in ("superior", "inferior"):
            object.__setattr__(self, key, read_only(f"{key} tilts", getattr(self, key), (n,), SpinestiffError))

    def selected(self, names: tuple[str, ...]) -> SpineTilts:
        """The tilts of ``names``, in this order."""
        which = [self._row(name) for name in names]
        return SpineTilts(names, self.superior[which], self.inferior[which])

    def cobb_degrees(self, upper: str, lower: str) -> float:
        """Signed Cobb angle between two named vertebrae, degrees."""
        i, j = self._row(upper), self._row(lower)
        if i >= j:
            raise SpinestiffError(f"{upper} does not lie above {lower} in this spine")
        return float(np.degrees(_wrapped(self.superior[i] - self.inferior[j])))

    def _row(self, name: str) -> int:
        if name not in self.vertebrae:
            raise SpinestiffError(f"no tilt of {name}; there are {', '.join(self.vertebrae)}")
        return self.vertebrae.index(name)


@dataclass(frozen=True)
class CobbAngle:
    """A signed Cobb angle with the end vertebrae it was read between.

    Attributes
    ----------
    degrees : above 0 = convex to the patient's left.
    upper, lower : end vertebrae.
    """

    degrees: float
    upper: str
    lower: str

    @property
    def convexity(self) -> Literal["left", "right", "none"]:
        """The side to which the curve is convex, the patient's."""
        return "left" if self.degrees > 0.0 else "right" if self.degrees < 0.0 else "none"

    def __str__(self) -> str:
        return f"{self.degrees:+.1f} deg ({self.upper}-{self.lower}, convexity {self.convexity})"


class Forms(NamedTuple):
    """A number of each form in which a change of curvature is told (``CobbChange``); None where there is none."""

    signed: float | None = None
    fixed_levels: float | None = None
    tilt: float | None = None


NO_SDS = Forms()


@dataclass(frozen=True)
class CobbChange:
    """Change of curvature between rest and a pushed pose in three forms, degrees, left-convex above 0.

    Attributes
    ----------
    signed : difference of the two signed largest angles (the paper's). It jumps when another curve becomes largest.
    fixed_levels : change of the angle between the end vertebrae of the rest pose.
    tilt : the largest difference between two vertebrae of the change of tilt. Smooth.
    rest, pushed : the two angles behind ``signed``.
    levels : upper and lower end vertebra of ``fixed_levels``: those of the rest pose, or given ones.
    tilt_levels : upper and lower vertebra behind ``tilt``.
    sds : standard deviations by the errors of the corners; a model's corners have none.
    """

    signed: float
    fixed_levels: float
    tilt: float
    rest: CobbAngle
    pushed: CobbAngle
    levels: tuple[str, str]
    tilt_levels: tuple[str, str]
    sds: Forms = NO_SDS


def tilts(
    vertebrae: tuple[str, ...], corners: ArrayLike, view: XRayView, method: EndplateMethod = "endplates"
) -> SpineTilts:
    """Tilts of vertebrae from their corners in a frontal picture.

    Parameters
    ----------
    vertebrae : (n,) names, head to foot.
    corners : (n, 4, 2) along the view's columns and rows, in mm (detector or patient plane; a scale changes nothing).
        Order superior-left, superior-right, inferior-right, inferior-left of the patient.
    view : tells where left and up are in the picture.
    method : "endplates", each from its own two corners; "midline", one tilt a vertebra for both, from the middles of
        its left and right sides.

    Raises
    ------
    SpinestiffError : not a frontal view, unknown method, wrong shape, corners of a plate that coincide.
    """
    if view_kind(view) != "frontal":
        raise SpinestiffError("tilts and Cobb angles need a frontal view, this one is lateral")
    points = read_only("corners", corners, (len(vertebrae), 4, 2), SpinestiffError)
    return tilts_from_points(vertebrae, points @ np.stack(picture_axes(view), axis=1), method)


def tilts_from_points(
    vertebrae: tuple[str, ...], corners: ArrayLike, method: EndplateMethod = "endplates"
) -> SpineTilts:
    """``tilts`` for corners (n, 4, 2) given as (towards the patient's left, upwards), e.g. world x and y."""
    corners = read_only("corners", corners, (len(vertebrae), 4, 2), SpinestiffError)
    superior, inferior = corners[:, 0] - corners[:, 1], corners[:, 3] - corners[:, 2]
    if method == "midline":
        superior = inferior = 0.5 * (superior + inferior)
    elif method != "endplates":
        raise SpinestiffError(f"unknown tilt method '{method}'; wanted endplates or midline")
    for name, plate in zip((*vertebrae, *vertebrae), np.concatenate([superior, inferior])):
        if not plate.any():
            raise SpinestiffError(f"left and right corners of {name} coincide; it has no tilt")
    return SpineTilts(vertebrae, _direction(superior), _direction(inferior))


def cobb_angle(spine: SpineTilts) -> CobbAngle:
    """The largest angle between two vertebrae, with its sign (Table 2).

    Among pairs that tie, the one that spans fewest vertebrae is taken, then the uppermost: straight parts above and
    below a curve do not belong to it.
    """
    n = len(spine.vertebrae)
    upper, lower = np.triu_indices(n, k=1)
    angles = _wrapped(spine.superior[upper] - spine.inferior[lower])
    tied = np.flatnonzero(np.abs(angles) >= np.abs(angles).max() - TIE)
    best = min(tied.tolist(), key=lambda pair: (lower[pair] - upper[pair], upper[pair]))
    names = spine.vertebrae[int(upper[best])], spine.vertebrae[int(lower[best])]
    return CobbAngle(float(np.degrees(angles[best])), *names)


def cobb_change(rest: SpineTilts, pushed: SpineTilts, levels: tuple[str, str] | None = None) -> CobbChange:
    """Change of the Cobb angle from ``rest`` to ``pushed`` in its three forms, over the vertebrae that both have.

    Parameters
    ----------
    levels : upper and lower end vertebra of ``fixed_levels``; left out, those of the largest angle of ``rest``.

    Raises
    ------
    SpinestiffError : fewer than two vertebrae in common, or ``levels`` are not among them.
    """
    common = tuple(name for name in rest.vertebrae if name in pushed.vertebrae)
    rest, pushed = rest.selected(common), pushed.selected(common)
    before, after = cobb_angle(rest), cobb_angle(pushed)
    fixed = levels or (before.upper, before.lower)
    turned = SpineTilts(common, _wrapped(pushed.superior - rest.superior), _wrapped(pushed.inferior - rest.inferior))
    largest = cobb_angle(turned)
    return CobbChange(
        signed=after.degrees - before.degrees,
        fixed_levels=pushed.cobb_degrees(*fixed) - rest.cobb_degrees(*fixed),
        tilt=largest.degrees,
        rest=before,
        pushed=after,
        levels=fixed,
        tilt_levels=(largest.upper, largest.lower),
    )


def _direction(leftward: Floats) -> Floats:
    """Tilt (n,) rad of vectors (n, 2) that point from the right to the left side, as (left, up)."""
    return np.asarray(np.arctan2(leftward[:, 1], leftward[:, 0]))


def _wrapped(angle: Floats) -> Floats:
    """The same angle in (-pi, pi]; exact where it already lies there."""
    return np.where(np.abs(angle) > np.pi, angle - 2.0 * np.pi * np.round(angle / (2.0 * np.pi)), angle)
