"""spinestiff.mechanics.places: equilibria and derivatives where pelvis and shoulder are not at rest."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from spinestiff.anatomy.points import PointsOnBones
from spinestiff.anatomy.rotation import exp_so3
from spinestiff.anatomy.state import TorsoState
from spinestiff.anatomy.stiffness import stiffness_ratios
from spinestiff.anatomy.template import template_torso
from spinestiff.errors import EquilibriumError
from spinestiff.mechanics.contact import OneSidedProblem
from spinestiff.mechanics.equilibrium import EquilibriumProblem, SolveStatus
from spinestiff.mechanics.loads import rib_push
from spinestiff.mechanics.newton import Run
from spinestiff.mechanics.places import AT_REST, SupportPlace, place_of_pelvis
from spinestiff.mechanics.supports import SupportKind, three_point_supports
from spinestiff.mechanics.terms import PointSprings
from spinestiff.verification.equilibria import SOFT, motion, out_of_balance, toy_load
from spinestiff.verification.models import shaken
from spinestiff.verification.places import pelvic_torso, placed_supports
from spinestiff.verification.transforms import MIRROR, mirrored_load, mirrored_state, mirrored_torso

ASKEW = SupportPlace(obliquity=-0.12, shoulder_mm=6.0)


@pytest.fixture(scope="module")
def torso():
    return pelvic_torso(2, 10)


@pytest.fixture(scope="module")
def problem(torso):
    return EquilibriumProblem(torso, placed_supports(torso))


@pytest.fixture(scope="module")
def soft(torso):
    return stiffness_ratios(SOFT, torso.joints.kinds)


@pytest.fixture(scope="module")
def whole():
    """The template with its pelvis clamped, a push and ratios."""
    torso = template_torso(157.0, "coarse")
    problem = EquilibriumProblem(torso, three_point_supports(torso, "right", pelvis="level"))
    ratios = stiffness_ratios({"lateral_bending": 0.2, "tissue": 0.05}, torso.joints.kinds)
    return problem, rib_push(torso, "right", 6.0, 60.0), ratios


def _apart(one, other):
    """Largest difference of two states: mm, and rad of bones."""
    return np.abs(motion(one, other)).max()


def test_what_is_asked_for_is_where_the_supports_are(problem, soft):
    found = problem.with_place(ASKEW).solve(toy_load(), soft).require()
    rest, pelvis = problem.torso.rest_pose, problem.torso.bone("pelvis")
    np.testing.assert_array_equal(found.state.bone_positions[pelvis], rest.bone_positions[pelvis])
    turn = exp_so3(np.array([[0.0, 0.0, ASKEW.obliquity]]))[0]
    np.testing.assert_allclose(found.state.bone_rotations[pelvis], turn @ rest.bone_rotations[pelvis], atol=1e-14)
    assert place_of_pelvis(problem.torso, found.state) == pytest.approx(ASKEW.obliquity, abs=1e-14)
    targets = problem.with_place(ASKEW).supports.springs.targets - problem.supports.springs.targets
    np.testing.assert_allclose(targets, [[6.0, 0.0, 0.0], [0.0, 0.0, 0.0]], atol=1e-12)  # the wall stays
    force, moment = out_of_balance(found, toy_load())
    assert np.abs(force).max() < 1e-8
    assert np.abs(moment).max() < 1e-6


def test_supports_at_rest_are_no_place_of_their_own(problem, soft):
    plain = problem.solve(toy_load(), soft).require()
    placed = problem.with_place(AT_REST).solve(toy_load(), soft).require()
    assert _apart(plain.state, placed.state) == 0.0


def test_the_mirror_image_of_a_place_has_the_mirror_image_of_the_state(problem, soft):
    found = problem.with_place(ASKEW).solve(toy_load(), soft).require()
    springs = problem.supports.springs
    points = PointsOnBones(springs.points.bone, springs.points.offset @ MIRROR)
    mirrored = PointSprings(points, springs.targets @ MIRROR, springs.directions @ MIRROR, springs.stiffness)
    other = EquilibriumProblem(mirrored_torso(problem.torso), replace(problem.supports, springs=mirrored))
    place = SupportPlace(-ASKEW.obliquity, -ASKEW.shoulder_mm)
    image = other.with_place(place).solve(mirrored_load(toy_load()), soft).require()
    assert _apart(mirrored_state(found.state), image.state) < 1e-8


def test_eq6_place_derivative_of_the_whole_torso_against_differences_of_solves(whole):
    problem, load, ratios = whole
    place = SupportPlace(0.04, 5.0)
    found, tangent = problem.with_place(place).solve_linearised(load, ratios)
    forward = tangent.place_derivative()
    for i, step in enumerate((1e-3, 0.1)):
        change = np.eye(2)[i] * step
        places = [SupportPlace(place.obliquity + s * change[0], place.shoulder_mm + s * change[1]) for s in (-1, 1)]
        ends = [problem.with_place(at).solve(load, ratios, start=tangent).require().state for at in places]
        wanted = (motion(found.state, ends[1]) - motion(found.state, ends[0])) / (2.0 * step)
        assert np.abs(forward[:, i] - wanted).max() < 1e-5 * np.abs(wanted).max()
    together = tangent.forward(ratios.groups, (load,), place=True)
    for columns, apart in ((together[:, -2:], forward), (together[:, -3], tangent.load_derivative(load))):
        np.testing.assert_allclose(columns, apart, rtol=1e-9, atol=1e-9 * np.abs(apart).max())
    goal = np.random.default_rng(1).normal(size=len(forward))
    assert tangent.place_adjoint(goal) == pytest.approx(goal @ forward, rel=1e-9)


def test_only_the_pelvis_turn_and_the_pad_are_a_place(problem, soft):
    """Of what is held, the obliquity moves one degree of freedom, the shoulder none."""
    placed = problem.with_place(ASKEW)
    forward = placed.solve_linearised(toy_load(), soft)[1].place_derivative()
    np.testing.assert_array_equal(forward[problem.held, 0], [0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
    assert (forward[problem.held, 1] == 0.0).all()
    assert (np.abs(forward).max(0) > 0.1).all()


def test_a_hinged_pelvis_refuses_an_obliquity_and_takes_a_shoulder(torso):
    supports = placed_supports(torso)
    held = supports.held.copy()
    held[torso.bone("pelvis"), 5] = False
    hinged = EquilibriumProblem(torso, replace(supports, held=held))
    with pytest.raises(EquilibriumError, match=r"^the pelvis is free to turn, [^\n]*$"):
        hinged.with_place(SupportPlace(obliquity=0.01))
    pushed = hinged.with_place(SupportPlace(shoulder_mm=3.0))
    assert pushed.supports.springs.targets[0, 0] == hinged.supports.springs.targets[0, 0] + 3.0


def test_a_shoulder_without_pad_has_no_place(torso, problem):
    bare = placed_supports(torso, springs=False)
    with pytest.raises(EquilibriumError, match=r"^no pad holds a shoulder, [^\n]* by 3 mm; ask for 0 mm$"):
        EquilibriumProblem(torso, bare).with_place(SupportPlace(shoulder_mm=3.0))
    with pytest.raises(EquilibriumError, match="by 6 mm"):
        problem.with_place(ASKEW).with_supports(bare)
    turned = EquilibriumProblem(torso, bare).with_place(SupportPlace(obliquity=0.1))
    assert turned.place == SupportPlace(obliquity=0.1)


def test_a_hinged_pelvis_keeps_the_turn_of_a_start(torso, soft):
    """A place of the shoulder says nothing about a pelvis that is free to turn."""
    supports = placed_supports(torso)
    held = supports.held.copy()
    held[torso.bone("pelvis"), 5] = False
    hinged = EquilibriumProblem(torso, replace(supports, held=held))
    found = hinged.solve(toy_load(), soft).require()
    assert abs(place_of_pelvis(torso, found.state)) > 0.05
    again = hinged.with_place(AT_REST).solve(toy_load(), soft, start=found.state).require()
    assert again.iterations == 0
    assert _apart(found.state, again.state) == 0.0


def test_a_soft_torso_on_a_hinge_is_solved_from_an_equilibrium_near_by():
    """Turned back as a whole to a level pelvis, this start leads past the equilibrium and folds."""
    torso = template_torso(157.0, "coarse")
    hinged = EquilibriumProblem(torso, three_point_supports(torso, "right", pelvis="hinge"))
    load, ratios = rib_push(torso, "right", 8.0, 80.0), stiffness_ratios({"lateral_bending": 0.04, "tissue": 0.03})
    near = hinged.solve(load, ratios, largest_turn=np.pi / 2).require()
    placed = hinged.with_place(SupportPlace(shoulder_mm=0.5))
    found = placed.solve(load, ratios, start=near.state, largest_turn=np.pi / 2)
    assert found.status is SolveStatus.CONVERGED
    assert np.abs(found.state.bone_positions - near.state.bone_positions).max() < 20.0


@pytest.mark.parametrize(
    "place", [(0.501, 0.0), (-0.501, 0.0), (0.0, 100.1), (0.0, -100.1), (np.nan, 0.0), (0.0, np.nan), (np.inf, 0.0)]
)
def test_a_place_too_far_or_no_number_is_refused(place):
    with pytest.raises(EquilibriumError, match=r"^supports at an obliquity of [^\n]*wanted at most 0.5 rad and 100 mm"):
        SupportPlace(*place)


def test_the_farthest_places_are_taken():
    for sign in (-1.0, 1.0):
        assert SupportPlace(0.5 * sign, 100.0 * sign).obliquity == 0.5 * sign


def test_places_replace_each_other_and_do_not_add_up(problem, soft):
    once = problem.with_place(ASKEW)
    twice = problem.with_place(SupportPlace(0.05, -20.0)).with_place(ASKEW)
    assert twice.place == once.place == ASKEW
    np.testing.assert_allclose(twice.supports.springs.targets, once.supports.springs.targets, atol=1e-12)
    states = [at.solve(toy_load(), soft).require().state for at in (once, twice)]
    assert _apart(*states) < 1e-8
    back = twice.with_place(AT_REST).solve(toy_load(), soft).require().state
    assert _apart(back, problem.solve(toy_load(), soft).require().state) < 1e-8
    assert problem.place is None  # none of it is the first problem's


def test_other_supports_are_held_at_the_problems_place(problem, soft):
    supports = problem.supports
    again = problem.with_place(ASKEW).with_supports(supports)
    assert again.place == ASKEW
    wanted = problem.with_place(ASKEW).solve(toy_load(), soft).require().state
    assert _apart(wanted, again.solve(toy_load(), soft).require().state) == 0.0
    back = again.with_place(AT_REST).supports.springs.targets
    np.testing.assert_allclose(back, supports.springs.targets, atol=1e-12)


def test_springs_that_do_not_act_stay_at_the_problems_place(problem):
    placed = problem.with_place(ASKEW)
    off = placed.with_acting(np.array([True, False]))
    assert off.place == ASKEW
    assert off.supports.springs.stiffness.tolist() == [placed.supports.springs.stiffness[0], 0.0]
    np.testing.assert_array_equal(off.supports.springs.targets, placed.supports.springs.targets)


def test_a_linearisation_at_another_place_leads_to_the_same_state(problem, soft):
    load = toy_load()
    near = problem.with_place(SupportPlace(0.06, -3.0)).solve_linearised(load, soft)[1]
    placed = problem.with_place(ASKEW)
    from_rest = placed.solve(load, soft).require()
    for start in (near, near.state):
        assert _apart(from_rest.state, placed.solve(load, soft, start=start).require().state) < 1e-8
    assert _apart(from_rest.state, near.state) > 1.0


def test_a_load_in_steps_begins_at_the_place(problem, soft):
    placed, load = problem.with_place(ASKEW), toy_load()
    stepped = Run(placed, soft, None, 60, None).in_steps(load)
    assert stepped.status is SolveStatus.CONVERGED
    assert _apart(placed.solve(load, soft).require().state, stepped.state) < 1e-8


def test_a_start_that_fails_falls_back_on_rest_at_the_place(problem, soft):
    placed, load, rest = problem.with_place(ASKEW), toy_load(), problem.torso.rest_pose
    inside_out = TorsoState(rest.bone_positions, rest.bone_rotations, rest.tissue_positions[::-1].copy())
    assert Run(placed, soft, None, 60, None).newton(load, inside_out).status is SolveStatus.INVERTED_START
    found = placed.solve(load, soft, start=inside_out).require()
    assert _apart(placed.solve(load, soft).require().state, found.state) < 1e-8


def test_a_start_whose_pelvis_stands_elsewhere_is_turned_to_the_place(problem, soft):
    """A state of another place, and one that is not even an equilibrium."""
    placed, load = problem.with_place(ASKEW), toy_load()
    rest, pelvis = problem.torso.rest_pose, problem.torso.bone("pelvis")
    near = shaken(problem.torso, 3, 0.03, 0.3)
    positions, rotations = near.bone_positions.copy(), near.bone_rotations.copy()
    turn = exp_so3(np.array([[0.0, 0.0, 0.2]]))[0]
    positions[pelvis], rotations[pelvis] = rest.bone_positions[pelvis], turn @ rest.bone_rotations[pelvis]
    start = TorsoState(positions, rotations, near.tissue_positions)
    found = placed.solve(load, soft, start=start).require()
    assert _apart(placed.solve(load, soft).require().state, found.state) < 1e-8


def test_the_wall_does_not_pull_a_torso_that_stands_askew(whole):
    problem, load, ratios = whole
    placed = problem.with_place(SupportPlace(0.05, 8.0))
    bilateral = placed.solve(load, ratios).require()
    wall = [r.force[2] for r in bilateral.reactions if r.kind is SupportKind.WALL]
    assert min(wall) < -0.5  # else nothing is tested
    one_sided = OneSidedProblem(problem.torso, problem.supports).with_place(placed.place)
    found = one_sided.solve(load, ratios, bilateral.state).require()
    assert place_of_pelvis(problem.torso, found.state) == pytest.approx(0.05, abs=1e-12)
    pad = found.reaction("shoulder")[0] / placed.supports.springs.stiffness[0]
    shoulder = placed.supports.springs.points.positions(found.state)[0, 0]
    assert shoulder == pytest.approx(problem.supports.springs.targets[0, 0] + 8.0 - pad, abs=1e-9)
    assert min(r.force[2] for r in found.reactions if r.kind is SupportKind.WALL) >= -1e-6
    force, _ = out_of_balance(found, load)
    assert np.abs(force).max() < 1e-6 * load.size
