"""How the load of a trial differs by what of its push is not quite known: force, direction and place.

Each act of ``unknowns.LOADING`` adds a load of its own per unit, so that a load with its acts is a sum of dead loads.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from spinestiff.anatomy.names import RIBS
from spinestiff.anatomy.points import PointsOnBones
from spinestiff.anatomy.state import TorsoState
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.arrays import Floats
from spinestiff.estimation.discrepancy import pushed_site
from spinestiff.estimation.unknowns import LOADING
from spinestiff.mechanics.loads import PUSH_DIRECTION, LoadCase, rib_load
from spinestiff.mechanics.push import raised_level

HEIGHT_STEP_MM = 5.0
"""Over which the change by a push's height is a difference: one prior standard deviation up, and one down."""
LEAST_RISE = 0.8  # mm that the pushed ribs' points lie higher for each mm of a push's height


def load_changes(load: LoadCase, torso: TorsoModel) -> tuple[LoadCase, ...]:
    """What is added to ``load`` per unit of each of the six acts on the load; nothing acts on an unloaded torso."""
    if load.size == 0.0:
        return (load,) * len(LOADING)
    push = load.push
    moved = [_turned(push, axis) for axis in (2, 1)]
    if len(load.nodes):
        # The height of forces on tissue nodes is no single point's.
        still = load.scaled(0.0)
        return (load, load.scaled(1.0 / push.size), *moved, still, still)
    # What holds against the push grows with it, and stays where it is.
    return (load, load.scaled(1.0 / push.size), *moved, _higher(push, torso), _moved(push, torso.rest_pose, 2))


def changed_load(load: LoadCase, changes: Sequence[LoadCase], acts: Floats) -> LoadCase:
    """``load`` with its acts (len(ACTS),): scaled, and what the others add."""
    total = load.scaled(float(np.exp(acts[0])))
    for change, size in zip(changes[1:], acts[1 : len(LOADING)]):
        if size != 0.0:
            total = _sum(total, change.scaled(float(size)))
    return total


def _sum(a: LoadCase, b: LoadCase) -> LoadCase:
    points = PointsOnBones(
        np.concatenate([a.points.bone, b.points.bone]), np.concatenate([a.points.offset, b.points.offset])
    )
    return LoadCase(
        points,
        np.concatenate([a.forces, b.forces]),
        a.label,
        np.concatenate([a.nodes, b.nodes]),
        np.concatenate([a.node_forces, b.node_forces]),
    )


def _turned(load: LoadCase, axis: int) -> LoadCase:
    """Change per rad of the forces' turn: up (about the AP axis) or forward (about the vertical)."""
    about = np.zeros(3)
    # Upward and forward whichever way the push points.
    about[axis] = np.sign(load.total[0] or 1.0) * (1.0 if axis == 2 else -1.0)
    return LoadCase(
        load.points, np.cross(about, load.forces), load.label, load.nodes, np.cross(about, load.node_forces)
    )


def _moved(load: LoadCase, rest: TorsoState, axis: int) -> LoadCase:
    """Change per mm that the pushed points lie further along ``axis`` of the world, each on its bone."""
    moved = PointsOnBones.at(rest, load.points.bone, load.points.positions(rest) + np.eye(3)[axis])
    return _sum(LoadCase(moved, load.forces, load.label), LoadCase(load.points, -load.forces))


def _higher(push: LoadCase, torso: TorsoModel) -> LoadCase:
    """Change per mm that a push acts higher: other ribs share it (``mechanics.push.raised_level``).

    It is the difference between the push ``HEIGHT_STEP_MM`` above its place and as far below: at a whole rib level,
    where one rib alone is pushed, both its neighbours have a part. A push that is not on ribs rises on its bones, and
    so does one at ribs 11 and 12, which may lie at one height.
    """
    rest, names = torso.rest_pose, [torso.bone_names[bone] for bone in push.points.bone]
    if not all(name in RIBS for name in names):
        return _moved(push, rest, 1)
    side, level = pushed_site(push, torso)
    lateral = torso.landmark("rib_lateral").positions(rest)
    depth = float(np.mean(push.points.positions(rest)[:, 2] - lateral[[RIBS.index(name) for name in names], 2]))
    levels, risen = zip(*(raised_level(torso, side, level, mm) for mm in (-HEIGHT_STEP_MM, HEIGHT_STEP_MM)))
    below, above = (rib_load(torso, side, one, 1.0, depth) for one in levels)
    change = _sum(above, below.scaled(-1.0))
    shares = change.forces[:, 0] * PUSH_DIRECTION[side] / (risen[1] - risen[0])
    if shares @ change.points.positions(rest)[:, 1] < LEAST_RISE:
        return _moved(push, rest, 1)
    return LoadCase(change.points, shares[:, None] * push.total, push.label)
