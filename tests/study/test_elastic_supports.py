"""spinestiff.study.synthetic.elastic_supports: a belt and a shoulder's pad that give what is asked."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from spinestiff.anatomy.rotation import exp_so3
from spinestiff.anatomy.stiffness import stiffness_ratios
from spinestiff.anatomy.template import template_torso
from spinestiff.errors import EquilibriumError, SubjectError
from spinestiff.mechanics.equilibrium import EquilibriumProblem
from spinestiff.mechanics.loads import rib_push
from spinestiff.mechanics.places import place_of_pelvis
from spinestiff.mechanics.supports import SPRING_STIFFNESS, SupportKind, three_point_supports
from spinestiff.study.synthetic.elastic_supports import (
    LARGEST_OBLIQUITY_DEG,
    LARGEST_SHOULDER_MM,
    SupportStiffness,
    SyntheticSupports,
    drawn_supports,
    elastic_supports,
    shoulder_shift,
    support_stiffness,
)

RATIOS = stiffness_ratios({"lateral_bending": 0.1, "tissue": 0.02})


@pytest.fixture(scope="module")
def torso():
    return template_torso(157.0, "coarse")


def found_and_given(torso, side, give, levels=(8.0, 6.0), force=30.0, ratios=RATIOS):
    """Stiffness for pushes at some levels, and (pushes, 2) what the supports then give: degrees and mm."""
    pushes = [rib_push(torso, side, level, force) for level in levels]
    stiffness = support_stiffness(torso, side, pushes, ratios, give)
    problem = EquilibriumProblem(torso, elastic_supports(torso, side, stiffness))
    states = [problem.solve(push, ratios).require().state for push in pushes]
    given = [(np.degrees(place_of_pelvis(torso, s)), shoulder_shift(problem.supports, s)) for s in states]
    return stiffness, np.array(given)


@pytest.mark.parametrize(
    ("side", "asked", "levels", "force"),
    [
        ("left", (4.0, 0.3), (8.0, 6.0), 60.0),
        ("right", (0.5, 2.0), (8.0, 6.0), 30.0),
        ("right", (0.0, 1.0), (8.0,), 30.0),
        ("left", (1.0, 0.0), (8.0,), 30.0),
    ],
)
def test_the_supports_give_what_is_asked_the_way_that_the_push_turns_them(torso, side, asked, levels, force):
    """Under the push that moves each most; the pelvis turns towards the pushed side as a beam's end does."""
    _, given = found_and_given(torso, side, SyntheticSupports(*asked), levels, force)
    way = np.array([1.0, -1.0]) if side == "left" else np.array([-1.0, 1.0])
    for own, wanted in zip((way * given).T, asked):
        if wanted:
            assert own.max() == pytest.approx(wanted, rel=0.02)
            assert own.min() > 0.3 * wanted
        else:
            assert np.abs(own).max() < 0.05


def test_one_push_alone_moves_both_supports_as_asked_with_nearly_the_same_springs_from_either_side(torso):
    """The body is symmetric, its tissue mesh is not."""
    (left, given_left), (right, given_right) = (
        found_and_given(torso, side, SyntheticSupports(1.5, 1.0), levels=(8.0,)) for side in ("left", "right")
    )
    assert left.belt == pytest.approx(right.belt, rel=0.05)
    assert left.shoulder == pytest.approx(right.shoulder, rel=0.05)
    assert given_left[0] == pytest.approx([1.5, -1.0], rel=0.02)
    assert given_right[0] == pytest.approx([-1.5, 1.0], rel=0.02)


def test_a_pelvis_that_nothing_holds_may_turn_by_less_than_asked(torso):
    stiffness, given = found_and_given(torso, "left", SyntheticSupports(4.0, 1.0), levels=(8.0,), force=4.0)
    assert stiffness.belt == 0.0
    assert 0.3 < given[0, 0] < 3.0
    assert given[0, 1] == pytest.approx(-1.0, rel=0.02)


def test_supports_that_give_nothing_are_the_level_ones(torso):
    none = SyntheticSupports(0.0, 0.0)
    stiffness = support_stiffness(torso, "left", [rib_push(torso, "left", 8.0, 60.0)], RATIOS, none)
    assert stiffness == SupportStiffness(None, SPRING_STIFFNESS[SupportKind.SHOULDER])
    supports, level = elastic_supports(torso, "left", stiffness), three_point_supports(torso, "left", pelvis="level")
    assert np.array_equal(supports.held, level.held)
    assert supports.names == level.names
    assert np.array_equal(supports.springs.stiffness, level.springs.stiffness)


def test_a_shoulder_that_hardly_gives_has_the_usual_pad(torso):
    stiffness, _ = found_and_given(torso, "left", SyntheticSupports(1.0, 1e-3), levels=(8.0,))
    assert stiffness.shoulder == SPRING_STIFFNESS[SupportKind.SHOULDER]


def test_springs_that_do_not_settle_are_refused(torso):
    """A pad is to give while the pelvis is not held, which is known only after the first round."""
    push = rib_push(torso, "left", 8.0, 4.0)
    with pytest.raises(EquilibriumError, match=r"found no springs .* 4 degrees and 1 mm \(after 1 round"):
        support_stiffness(torso, "left", [push], RATIOS, SyntheticSupports(4.0, 1.0), max_rounds=1)


def test_the_belt_turns_the_pelvis_back_by_its_stiffness_and_does_nothing_else(torso):
    supports = elastic_supports(torso, "left", SupportStiffness(5e4, 12.0))
    pelvis, rest, angle = torso.bone("pelvis"), torso.rest_pose, 0.01
    rotations = rest.bone_rotations.copy()
    rotations[pelvis] = exp_so3(np.array([[0.0, 0.0, angle]]))[0] @ rotations[pelvis]
    turned = replace(rest, bone_rotations=rotations)
    assert np.abs(supports.springs.forces(rest)).max() < 1e-9
    belt = supports.of_kind(SupportKind.SPRING)
    arms = supports.springs.points.positions(turned) - rest.bone_positions[pelvis]
    forces = supports.springs.forces(turned)
    assert np.cross(arms, forces)[belt].sum(0) == pytest.approx([0.0, 0.0, -5e4 * angle], rel=1e-3, abs=1e-9)
    assert forces[belt].sum(0) == pytest.approx(np.zeros(3), abs=1e-9)
    assert np.abs(forces[~belt]).max() == 0.0
    assert supports.springs.stiffness[supports.of_kind(SupportKind.SHOULDER)].tolist() == [12.0]
    assert not supports.held[pelvis, 5]


def test_drawn_supports_fill_their_ranges():
    drawn = [drawn_supports(np.random.default_rng(seed)) for seed in range(200)]
    for values, most in (
        ([own.obliquity_deg for own in drawn], LARGEST_OBLIQUITY_DEG),
        ([own.shoulder_mm for own in drawn], LARGEST_SHOULDER_MM),
    ):
        assert 0.0 <= min(values) < 0.05 * most
        assert 0.95 * most < max(values) <= most
        assert np.mean(values) == pytest.approx(most / 2.0, rel=0.15)  # 3.7 standard errors


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ((-1.0, 0.0), "supports that give: obliquity_deg -1; wanted 0 to 20"),
        ((21.0, 0.0), "obliquity_deg 21; wanted 0 to 20"),
        ((float("nan"), 0.0), "obliquity_deg nan"),
        ((0.0, -0.5), "shoulder_mm -0.5; wanted 0 to 50"),
        ((0.0, 51.0), "shoulder_mm 51; wanted 0 to 50"),
    ],
)
def test_supports_that_no_person_has_are_refused(wrong, words):
    with pytest.raises(SubjectError, match=words):
        SyntheticSupports(*wrong)
