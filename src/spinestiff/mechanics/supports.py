"""What holds the torso, and the reactions there (paper 2.1; docs/errata.md on "fixed" against "applied")."""

from __future__ import annotations

import enum
from dataclasses import dataclass, replace

import numpy as np

from spinestiff.anatomy.points import PointsOnBones
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.arrays import Floats, ShortRepr, read_only
from spinestiff.errors import TorsoError
from spinestiff.mechanics.terms import PointSprings


class SupportKind(enum.StrEnum):
    """What a support stands for: held degrees of freedom of a bone, a shoulder's pad, the back wall, another spring."""

    HELD = "held"
    SHOULDER = "shoulder"
    WALL = "wall"
    SPRING = "spring"


# N/mm; stiff against the torso (tens of N/mm). 25 N, the most that was seen, move the shoulder by 0.03 mm, and the back
# by 0.25 mm at one of its points, to the front or rear: less than the skin between bone and wall gives way.
SPRING_STIFFNESS: dict[SupportKind, float] = {SupportKind.SHOULDER: 1e3, SupportKind.WALL: 1e2}

PELVES = ("level", "hinge", "dead-loads")
"""How a pelvis may be held: in all six degrees of freedom, free to turn about the AP axis, or in all six with F1 and F2
as loads (``mechanics.push``)."""


@dataclass(frozen=True, repr=False)
class Supports(ShortRepr):
    """Held degrees of freedom and springs to the ground.

    Attributes
    ----------
    held : (B, 6) bool, bone DoFs (dt, dw; world axes) that stay where a solve's start has them: at rest by default.
    springs : points held along a direction.
    names : (S,) what each spring holds, for messages.
    kinds : (S,) what each spring stands for, also as its word; none given: ``SupportKind.SPRING`` for all.
    """

    held: np.ndarray
    springs: PointSprings
    names: tuple[str, ...]
    kinds: tuple[SupportKind, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "held", read_only("held", self.held, (None, 6), TorsoError, bool))
        count = len(self.springs.points)
        try:
            kinds = tuple(SupportKind(kind) for kind in self.kinds) or (SupportKind.SPRING,) * count
        except ValueError as error:
            raise TorsoError(f"support of an unknown kind: {error}; there are {', '.join(SupportKind)}") from None
        object.__setattr__(self, "kinds", kinds)
        for what, found in (("names", self.names), ("kinds", self.kinds)):
            if len(found) != count:
                raise TorsoError(f"{count} support springs but {len(found)} {what}")

    def of_kind(self, kind: SupportKind) -> np.ndarray:
        """(S,) bool, springs of a kind."""
        return np.array([own is kind for own in self.kinds], dtype=bool)


def switched(supports: Supports, acting: np.ndarray) -> Supports:
    """The supports with zero stiffness where ``acting`` (S,) is False."""
    springs = supports.springs
    return replace(supports, springs=replace(springs, stiffness=np.where(acting, springs.stiffness, 0.0)))


@dataclass(frozen=True)
class Reaction:
    """What one support exerts on the torso: force (3,) N and moment (3,) N mm about ``point`` (3,) mm.

    ``name``: of what is held, e.g. the bone; ``kind``: what the support stands for.
    """

    name: str
    kind: SupportKind
    point: Floats
    force: Floats
    moment: Floats


def held_shoulder(torso: TorsoModel, side: str) -> PointsOnBones:
    """The humeral head that bears a push on ``side``: the opposite one."""
    return torso.landmark("humerus_head")[[("right", "left").index(side)]]


def three_point_supports(torso: TorsoModel, side: str, pelvis: str = "level", wall: bool = True) -> Supports:
    """The acquisition's supports for a push on ``side``.

    A "level" pelvis is held in all six degrees of freedom; as a "hinge" it may turn about the AP axis through its own
    origin (the middle of the belt). The opposite humerus head is held sideways. The back wall holds scapulae and
    posterior ribs front to back, on both sides of contact; ``mechanics.contact`` lets it push only.

    With "dead-loads" the pelvis alone is held. These six conditions say where the body is and nothing else: shoulder
    and wall have no support, with ``wall`` or without.

    Raises
    ------
    TorsoError : unknown side or pelvis mode, or the torso lacks the landmark "humerus_head" or, with ``wall``, "wall".
    """
    if side not in ("left", "right"):
        raise TorsoError(f"push side '{side}'; wanted 'left' or 'right'")
    if pelvis not in PELVES:
        raise TorsoError(f"pelvis support '{pelvis}'; wanted {' or '.join(repr(kind) for kind in PELVES)}")
    held = np.zeros((len(torso.bone_names), 6), dtype=bool)
    held[torso.bone("pelvis")] = (True, True, True, True, True, pelvis != "hinge")
    if pelvis == "dead-loads":
        nothing = PointsOnBones(np.empty(0, np.int64), np.empty((0, 3)))
        return Supports(held, PointSprings(nothing, np.empty((0, 3)), np.empty((0, 3)), np.empty(0)), ())
    rows = [(SupportKind.SHOULDER, held_shoulder(torso, side), 0)]
    if wall:
        back = torso.landmark("wall")
        rows += [(SupportKind.WALL, back[[i]], 2) for i in range(len(back))]
    kinds = tuple(kind for kind, _, _ in rows)
    points = PointsOnBones(np.concatenate([p.bone for _, p, _ in rows]), np.concatenate([p.offset for _, p, _ in rows]))
    directions = np.eye(3)[[axis for _, _, axis in rows]]
    stiffness = np.array([SPRING_STIFFNESS[kind] for kind in kinds])
    springs = PointSprings(points, points.positions(torso.rest_pose), directions, stiffness)
    return Supports(held, springs, tuple(torso.bone_names[bone] for bone in points.bone), kinds)
