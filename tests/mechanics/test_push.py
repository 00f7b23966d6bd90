"""spinestiff.mechanics.push: loads and supports that belong together."""

from __future__ import annotations

import numpy as np
import pytest

from spinestiff.anatomy.stiffness import stiffness_ratios
from spinestiff.anatomy.template import template_torso
from spinestiff.errors import TorsoError
from spinestiff.mechanics.contact import OneSidedProblem
from spinestiff.mechanics.loads import rib_push, three_point_reactions
from spinestiff.mechanics.push import PushSite, Rig, push_heights, push_load, push_problem, raised_level, support_forces
from spinestiff.mechanics.supports import SupportKind, held_shoulder

RATIOS = stiffness_ratios({"lateral_bending": 0.5, "tissue": 0.3})


@pytest.fixture(scope="module")
def torso():
    return template_torso(157.0, "coarse")


def site(torso, side="right", level=8.0):
    """With the distances of the torso itself."""
    push = rib_push(torso, side, level, 1.0)
    rest = torso.rest_pose
    rib = np.abs(push.forces[:, 0]) @ push.points.positions(rest)[:, 1]
    shoulder = held_shoulder(torso, side).positions(rest)[0, 1]
    belt = torso.landmarks["pelvis_belt"].positions(rest)[0, 1]
    return PushSite(side, level, float(shoulder - belt), float(shoulder - rib))


def solved(torso, rig, force, at=None):
    at = at or site(torso)
    load = push_load(torso, at, force, rig)
    return load, push_problem(torso, at.side, rig).solve(load, RATIOS).require()


def test_what_is_held_and_what_is_load(torso):
    at = site(torso)
    for rig in (Rig(), Rig("hinge"), Rig(wall="one-sided")):
        load = push_load(torso, at, 30.0, rig, "a push")
        np.testing.assert_array_equal(load.forces, rib_push(torso, "right", 8.0, 30.0).forces)
        assert load.label == "a push"
        assert push_problem(torso, "right", rig).supports.of_kind(SupportKind.SHOULDER).sum() == 1
    assert type(push_problem(torso, "left", Rig(wall="one-sided"))) is OneSidedProblem
    assert push_problem(torso, "left", Rig("hinge")).supports.held.sum() == 5
    assert push_problem(torso, "left", Rig()).supports.held.sum() == 6


@pytest.mark.parametrize(("side", "sign"), [("right", 1.0), ("left", -1.0)])
def test_dead_loads_are_those_of_eqs_1_and_2(torso, side, sign):
    at = PushSite(side, 8.0, 400.0, 150.0)
    load = push_load(torso, at, 60.0, Rig("dead-loads"))
    f1, f2 = three_point_reactions(60.0, 400.0, 150.0)
    humerus = torso.bone("humerus_L" if side == "right" else "humerus_R")
    of_bone = {int(b): load.forces[load.points.bone == b].sum(axis=0) for b in load.points.bone}
    assert of_bone[humerus] == pytest.approx([-sign * f1, 0.0, 0.0])
    assert of_bone[torso.bone("pelvis")] == pytest.approx([-sign * f2, 0.0, 0.0])
    assert load.total == pytest.approx(np.zeros(3), abs=1e-12)
    supports = push_problem(torso, side, Rig("dead-loads")).supports
    assert supports.held[torso.bone("pelvis")].all()
    assert supports.held.sum() == 6
    assert supports.names == ()


def test_what_holds_a_body_under_dead_loads_vanishes_with_the_push(torso):
    """Forces balance at any push; a moment is left that goes with the square of it, as the lines of force move."""
    left = []
    for force in (0.5, 1.0):
        load, found = solved(torso, Rig("dead-loads"), force)
        (pelvis,) = found.reactions
        assert np.abs(pelvis.force).max() < 1e-7
        left.append(pelvis.moment[2])
    assert left[1] / left[0] == pytest.approx(4.0, rel=0.05)
    # Of the push's own moment about the pelvis it is a thousandth.
    assert abs(left[1]) < 2e-3 * load.size * 200.0
    # The three forces act at different depths, which no equation of the frontal plane knows.
    assert pelvis.moment[1] == pytest.approx(-load.moment(found.state)[1], abs=1e-3)


def test_dead_loads_bend_the_spine_as_a_hinge_does(torso):
    """Under a small push the two differ by a turn of the whole: the same change of tilt from T5 to L3."""

    def change(rig):
        _, found = solved(torso, rig, 0.5)
        tilt = found.state.bone_rotations[:, 1, 0]
        return tilt[torso.bone("T5")] - tilt[torso.bone("L3")]

    level, hinge, dead = (change(Rig(pelvis)) for pelvis in ("level", "hinge", "dead-loads"))
    assert dead == pytest.approx(hinge, rel=0.05)
    assert abs(level - hinge) > 0.2 * abs(hinge)


def test_forces_at_the_supports(torso):
    """As reactions or as loads they balance the push; a level pelvis takes a moment, a hinge none."""
    for pelvis in ("level", "hinge", "dead-loads"):
        load, found = solved(torso, Rig(pelvis), 20.0)
        forces = support_forces(torso, load, found)
        assert forces.shoulder < 0.0
        assert forces.pelvis < 0.0
        assert forces.shoulder + forces.pelvis == pytest.approx(-20.0, abs=1e-6)
        if pelvis == "hinge":
            assert forces.pelvis_moment == 0.0
        elif pelvis == "level":
            # Against the push, which turns the body clockwise as seen from the front.
            assert forces.pelvis_moment > 100.0
            assert forces.wall_pull == pytest.approx(max(-r.force[2] for r in found.reactions if r.kind == "wall"))
            assert forces.wall_pull > 0.1
        else:
            assert forces.wall_pull == 0.0
            f1, f2 = three_point_reactions(20.0, site(torso).d21_mm, site(torso).d31_mm)
            assert (forces.shoulder, forces.pelvis) == pytest.approx((-f1, -f2), abs=1e-6)


def test_a_one_sided_wall_pulls_nowhere(torso):
    load, found = solved(torso, Rig(wall="one-sided"), 60.0)
    assert support_forces(torso, load, found).wall_pull < 1e-6


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ({"pelvis": "glued"}, "pelvis 'glued'; wanted one of level, hinge, dead-loads"),
        ({"wall": "soft"}, "wall 'soft'; wanted one of bilateral, one-sided"),
        ({"pelvis": "dead-loads", "wall": "one-sided"}, "leave the wall out"),
    ],
)
def test_unknown_rigs_are_refused(words, message):
    with pytest.raises(TorsoError, match=message):
        Rig(**words)


def test_dead_loads_need_the_distances_and_nothing_else_does(torso):
    nowhere = PushSite("right", 8.0)
    for pelvis in ("level", "hinge"):
        np.testing.assert_array_equal(
            push_load(torso, nowhere, 20.0, Rig(pelvis)).forces, push_load(torso, site(torso), 20.0, Rig(pelvis)).forces
        )
    with pytest.raises(TorsoError, match="push 'a' frame 1: d21 or d31 is not known; dead loads at shoulder"):
        push_load(torso, nowhere, 20.0, Rig("dead-loads"), "push 'a' frame 1")


@pytest.mark.parametrize("side", ["left", "right"])
def test_a_point_that_rises_passes_the_ribs_above(torso, side) -> None:
    heights = [push_heights(torso, side, level)[2] for level in (7.0, 8.0)]
    half = 0.5 * (heights[0] - heights[1])
    assert raised_level(torso, side, 8.0, half) == (pytest.approx(7.5), pytest.approx(half))
    assert raised_level(torso, side, 7.5, -half) == (pytest.approx(8.0), pytest.approx(-half))
    level, risen = raised_level(torso, side, 8.2, 31.0)
    assert risen == pytest.approx(31.0)
    assert push_heights(torso, side, level)[2] - push_heights(torso, side, 8.2)[2] == pytest.approx(31.0)


def test_a_point_stops_at_the_first_and_the_last_rib_and_passes_two_of_one_height(torso) -> None:
    assert raised_level(torso, "left", 1.0, 3.0) == (1.0, 0.0)
    assert raised_level(torso, "left", 12.0, -3.0) == (12.0, 0.0)
    # Rib 12 reaches higher than rib 11, which is taken for 5 mm lower.
    assert push_heights(torso, "left", 12.0)[2] > push_heights(torso, "left", 11.0)[2]
    assert raised_level(torso, "left", 11.5, -2.0) == (pytest.approx(11.9), pytest.approx(-2.0))
