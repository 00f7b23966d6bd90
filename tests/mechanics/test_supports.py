"""spinestiff.mechanics.supports: what holds the torso in the acquisition."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from spinestiff.anatomy.points import PointsOnBones
from spinestiff.anatomy.stiffness import stiffness_ratios
from spinestiff.anatomy.template import template_torso
from spinestiff.errors import TorsoError
from spinestiff.mechanics.equilibrium import EquilibriumProblem
from spinestiff.mechanics.loads import rib_push, three_point_reactions
from spinestiff.mechanics.places import shifted_shoulder
from spinestiff.mechanics.supports import SupportKind, Supports, three_point_supports
from spinestiff.mechanics.terms import PointSprings


@pytest.fixture(scope="module")
def torso():
    return template_torso(157.0, "coarse")


@pytest.mark.parametrize(("side", "opposite"), [("left", "right"), ("right", "left")])
def test_the_shoulder_opposite_the_push_is_held_sideways(torso, side, opposite):
    supports = three_point_supports(torso, side)
    assert supports.names[0] == f"humerus_{opposite[0].upper()}"
    assert supports.kinds[0] is SupportKind.SHOULDER
    assert supports.springs.directions[0] == pytest.approx([1.0, 0.0, 0.0])
    x = supports.springs.targets[0, 0]
    assert np.sign(x) == (1.0 if opposite == "left" else -1.0)


def test_a_level_pelvis_is_held_in_all_and_a_hinge_frees_one_turn(torso):
    pelvis = torso.bone("pelvis")
    level, hinge = (three_point_supports(torso, "left", pelvis=p).held for p in ("level", "hinge"))
    assert level[pelvis].all()
    assert hinge[pelvis].tolist() == [True, True, True, True, True, False]
    assert level.sum() == 6
    assert hinge.sum() == 5
    assert np.array_equal(three_point_supports(torso, "left").held, level)


def test_the_wall_holds_front_to_back_and_can_be_left_out(torso):
    with_wall, without = (three_point_supports(torso, "left", wall=w) for w in (True, False))
    assert len(without.names) == 1
    assert len(with_wall.names) > 3
    assert set(with_wall.kinds[1:]) == {SupportKind.WALL}
    assert with_wall.of_kind(SupportKind.WALL).tolist() == [False] + [True] * (len(with_wall.names) - 1)
    assert with_wall.springs.directions[1:] == pytest.approx(np.tile([0.0, 0.0, 1.0], (len(with_wall.names) - 1, 1)))


def test_supports_are_free_of_force_at_rest(torso):
    assert np.abs(three_point_supports(torso, "left").springs.forces(torso.rest_pose)).max() == 0.0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"side": "front"}, "push side 'front'"),
        ({"side": "left", "pelvis": "glued"}, "pelvis support 'glued'; wanted 'level' or 'hinge'"),
    ],
)
def test_unknown_words_are_refused(torso, arguments, message):
    with pytest.raises(TorsoError, match=message):
        three_point_supports(torso, **arguments)


def test_names_and_springs_must_match():
    springs = PointSprings(
        PointsOnBones(np.array([0]), np.zeros((1, 3))), np.zeros((1, 3)), np.array([[1.0, 0, 0]]), np.ones(1)
    )
    with pytest.raises(TorsoError, match="1 support springs but 0 names"):
        Supports(np.zeros((1, 6), dtype=bool), springs, ())


def test_kinds_may_be_words(torso):
    supports = three_point_supports(torso, "right")
    words = replace(supports, kinds=tuple(map(str, supports.kinds)))
    assert words.kinds == supports.kinds
    assert all(isinstance(kind, SupportKind) for kind in words.kinds)
    assert shifted_shoulder(words, 5.0).springs.targets[0, 0] == supports.springs.targets[0, 0] + 5.0


def test_a_kind_that_there_is_not_is_refused(torso):
    supports = three_point_supports(torso, "right", wall=False)
    with pytest.raises(TorsoError, match=r"^support of an unknown kind: 'pad' [^\n]*; there are held, shoulder, "):
        replace(supports, kinds=("pad",))


def test_a_torso_without_the_landmarks_is_refused(torso):
    """E.g. a phantom."""
    for name, make in (
        ("humerus_head", lambda t: three_point_supports(t, "right")),
        ("wall", lambda t: three_point_supports(t, "right")),
        ("rib_lateral", lambda t: rib_push(t, "right", 8.0, 40.0)),
    ):
        less = replace(torso, landmarks={k: v for k, v in torso.landmarks.items() if k != name})
        with pytest.raises(TorsoError, match=f"^no landmark '{name}' in this torso; there are "):
            make(less)
    assert three_point_supports(replace(torso, landmarks={}), "right", pelvis="dead-loads").names == ()


def test_eq1_eq2_three_point_reactions_hold_for_the_simulated_torso(torso):
    """With the pelvis hinged and no wall, shoulder and pelvis share the push as Eqs. 1-2 say (deformed lever arms)."""
    problem = EquilibriumProblem(torso, three_point_supports(torso, "right", pelvis="hinge", wall=False))
    load = rib_push(torso, "right", 7.25, 60.0)
    found = problem.solve(load, stiffness_ratios({"lateral_bending": 0.5, "tissue": 0.3})).require()
    shoulder = next(r for r in found.reactions if r.kind is SupportKind.SHOULDER)
    pelvis = next(r for r in found.reactions if r.name == "pelvis")
    weights = load.forces[:, 0] / 60.0
    rib = weights @ load.points.positions(found.state)[:, 1]
    f1, f2 = three_point_reactions(60.0, shoulder.point[1] - pelvis.point[1], shoulder.point[1] - rib)
    assert -shoulder.force[0] == pytest.approx(f1, rel=1e-8)
    assert -pelvis.force[0] == pytest.approx(f2, rel=1e-8)
    # Held against turning about its AP axis, the pelvis takes a moment, and Eqs. 1-2 no longer say it all.
    level = EquilibriumProblem(torso, three_point_supports(torso, "right", pelvis="level", wall=False))
    again = level.solve(load, stiffness_ratios({"lateral_bending": 0.5, "tissue": 0.3})).require()
    assert abs(again.reaction("shoulder")[0] + f1) > 1e-3
