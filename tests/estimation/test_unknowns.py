"""What of a push is not quite known: which frames share it, what it does to a load and to the supports."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest

from spinestiff.anatomy.points import PointsOnBones
from spinestiff.anatomy.regions import parameter_groups
from spinestiff.anatomy.stiffness import parameter_group
from spinestiff.anatomy.template import template_torso
from spinestiff.estimation.discrepancy import pushed_site
from spinestiff.estimation.load_acts import HEIGHT_STEP_MM, changed_load, load_changes
from spinestiff.estimation.priors import Priors
from spinestiff.estimation.unknowns import (
    ACTS,
    LOADING,
    acts_by_name,
    is_fitted,
    place_of,
    unknowns_of,
)
from spinestiff.mechanics.equilibrium import EquilibriumProblem
from spinestiff.mechanics.loads import LoadCase, rib_push, tissue_load
from spinestiff.mechanics.push import PushSite, Rig, push_load, raised_level

# What belongs to pictures and not to pushes.
OF_PICTURES = (
    "place_mm", "place_deg", "place_yaw_deg", "posture_deg", "stance_mm", "stance_deg", "stance_scale",
    "stance_yaw_deg", "annotation_mm", "marking_mm", "pedicle_mm", "pedicles_mm", "own_pedicle_mm",
)  # fmt: skip


@pytest.fixture(scope="module")
def trials(column):
    """Two frames of a push from the right, one of a push from the left, and an unloaded one."""
    still, first, second = column.trials(forces=(20.0, 40.0))
    other = replace(first, load=column.push(-30.0), label="left", push="push 2")
    return [first, second, other, still]


def of(column, trials, priors=None, taped=False):
    return unknowns_of([column.problem] * len(trials), trials, priors or Priors(), taped)


def touched(unknowns, name):
    size = unknowns.acts[:, :, unknowns.names.index(name)]
    return np.abs(size).max(axis=1)


def test_frames_of_a_push_share_its_errors_and_pushes_do_not(column, trials) -> None:
    found = of(column, trials, Priors(force_scale=0.03))
    for what in ("force", "force offset", "direction upward", "direction forward", "height", "depth"):
        assert (touched(found, f"{what} of push 1") > 0.0).tolist() == [True, True, False, False]
        assert (touched(found, f"{what} of push 2") > 0.0).tolist() == [False, False, True, False]
    assert touched(found, "force of push 2")[2] == 0.03
    assert touched(found, "direction upward of push 1")[0] == pytest.approx(np.deg2rad(3.0))
    for i, trial in enumerate(trials[:3]):
        for what in ("breathing", "obliquity", "shoulder"):
            assert np.flatnonzero(touched(found, f"{what} in {trial.label}")).tolist() == [i]
    for what in ("trunk breadth", "trunk depth", "source distance"):
        assert (touched(found, what) > 0.0).tolist() == [True, True, True, False]


def test_supports_give_with_the_force_for_each_side_and_as_much_in_all_as_the_prior_says(column, trials) -> None:
    found = of(column, trials)
    right, left = (touched(found, f"obliquity under pushes from the {side}") for side in ("right", "left"))
    assert right[1] == 2.0 * right[0] > 0.0
    assert (right[2], left[0], left[1], left[3]) == (0.0, 0.0, 0.0, 0.0)
    for act, total in (("obliquity", np.deg2rad(3.0)), ("shoulder", 3.0)):
        at_60 = of(column, [replace(trials[0], load=column.push(60.0))])
        sizes = at_60.acts[0, ACTS.index(act)]
        assert np.sqrt(np.sum(sizes**2)) == pytest.approx(total)


def test_an_unknown_whose_standard_deviation_is_0_is_none(column, trials) -> None:
    kept = Priors()
    names = [f.name for f in fields(Priors) if f.name not in OF_PICTURES]
    names = [n for n in names if not n.startswith(("tracking", "support_force", "marker"))]
    everything = replace(kept, **{n: (0.0, 0.0) if n == "trunk_power" else 0.0 for n in names})
    assert len(of(column, trials, everything)) == 0
    assert of(column, trials, everything).acts.shape == (4, len(ACTS), 0)
    groups = set(of(column, trials).groups)
    for name, gone in (
        ("force_scale", {"force scale"}),
        ("force_offset_n", {"force offset"}),
        ("direction_deg", {"push direction"}),
        ("push_height_mm", {"push height"}),
        ("push_depth_mm", {"push depth"}),
        ("breathing_mm", {"breathing"}),
        ("frame_obliquity_deg", {"obliquity of a frame"}),
        ("frame_shoulder_mm", {"shoulder of a frame"}),
        ("trunk", {"trunk size"}),
        ("mesh", {"tissue mesh"}),
        ("source_distance", {"source distance"}),
    ):
        assert groups - set(of(column, trials, kept.scaled(name, 0.0)).groups) == gone


def test_a_taped_trunk_is_known_better(column, trials) -> None:
    loose, tight = (touched(of(column, trials, taped=taped), "trunk breadth")[0] for taped in (False, True))
    assert (loose, tight) == (pytest.approx(0.072), pytest.approx(0.012))


def test_groups_cover_all_unknowns_once(column, trials) -> None:
    found = of(column, trials)
    assert sum(found.in_group(group).astype(int) for group in found.groups).tolist() == [1] * len(found)


def test_a_hinged_pelvis_has_no_obliquity_of_its_own(column, trials) -> None:
    held = column.problem.supports.held.copy()
    held[column.torso.bone("pelvis"), 5] = False
    hinged = EquilibriumProblem(column.torso, replace(column.problem.supports, held=held))
    found = unknowns_of([hinged] * 4, trials, Priors())
    assert not any(unknown.act == "obliquity" for unknown in found.each)
    assert any(unknown.act == "shoulder" for unknown in found.each)


def test_acts_by_name(column, trials) -> None:
    found = of(column, trials)
    acts = acts_by_name(found, {"force of push 1": 2.0, "shoulder in left": -1.0, "of another day": 3.0})
    assert acts[:, ACTS.index("force")].tolist() == [0.04, 0.04, 0.0, 0.0]
    assert acts[:, ACTS.index("shoulder")].tolist() == [0.0, 0.0, -1.0, 0.0]
    assert np.count_nonzero(acts) == 3


@pytest.mark.parametrize("force", [50.0, -50.0])
@pytest.mark.parametrize("bones", [(3, 4), (4,)])
def test_what_each_act_does_to_a_load(column, force, bones) -> None:
    rest, load = column.torso.rest_pose, column.push(force, bones)
    changes = load_changes(load, column.torso)

    def with_act(name, size):
        return changed_load(load, changes, size * np.eye(len(ACTS))[ACTS.index(name)])

    assert np.allclose(with_act("force", 0.1).total, np.exp(0.1) * load.total)
    assert np.allclose(with_act("offset", 3.0).total, load.total + [np.sign(force) * 3.0, 0.0, 0.0])
    assert with_act("upward", 0.1).total == pytest.approx([force, 5.0, 0.0])
    assert with_act("forward", 0.1).total == pytest.approx([force, 0.0, 5.0])
    # Higher or farther to the front: the same force, and its moment grows by arm x force.
    for name, arm in (("height", [0.0, 2.0, 0.0]), ("depth", [0.0, 0.0, 2.0])):
        moved = with_act(name, 2.0)
        assert moved.total == pytest.approx(load.total)
        assert moved.moment(rest) - load.moment(rest) == pytest.approx(np.cross(arm, load.total), abs=1e-9)
    for name in ("obliquity", "shoulder", "tissue", "ribs", "volume", "motion"):
        assert np.allclose(with_act(name, 0.1).forces, load.forces)


def test_a_push_on_tissue_has_no_point_of_its_own_and_no_load_has_no_acts(column) -> None:
    none = PointsOnBones(np.empty(0, np.int64), np.empty((0, 3)))
    pressed = LoadCase(none, np.empty((0, 3)), "pressed", np.array([0]), np.array([[5.0, 0.0, 0.0]]))
    changes = load_changes(pressed, column.torso)
    assert [change.size for change in changes[4:]] == [0.0, 0.0]
    moved = changed_load(pressed, changes, np.array([0.0, 1.0, 0.1, 0.0, 9.0, 9.0, *np.zeros(len(ACTS) - 6)]))
    assert moved.total == pytest.approx([6.0, 0.5, 0.0])
    still = LoadCase(none, np.empty((0, 3)))
    assert changed_load(still, load_changes(still, column.torso), np.ones(len(ACTS))).size == 0.0


def test_no_trial_has_no_unknown(column) -> None:
    """As of a subject without held-out frames."""
    unknowns = of(column, [])
    assert len(unknowns) == 0
    assert unknowns.acts.shape == (0, len(ACTS), 0)


def test_the_place_of_the_supports_is_what_the_acts_say() -> None:
    acts = np.zeros(len(ACTS))
    acts[[ACTS.index("obliquity"), ACTS.index("shoulder")]] = 0.05, -2.0
    assert (place_of(acts).obliquity, place_of(acts).shoulder_mm) == (0.05, -2.0)


def test_a_ratio_that_is_fitted_is_no_unknown_beside_itself(column, trials) -> None:
    """Tissue's volume is lambda at a given mu: known by neither of the two alone, but by both."""

    def groups(*names):
        return [parameter_group(name, column.torso.joints.kinds) for name in names]

    def volume(*names):
        found = unknowns_of([column.problem] * 4, trials, Priors(), fitted=groups(*names))
        assert {"trunk breadth", "trunk depth"} <= set(found.names)
        return "tissue's volume" in found.names

    assert volume("lateral_bending", "tissue")
    assert volume("lateral_bending", "tissue_mu")
    assert volume("everything")
    assert not volume("lateral_bending", "tissue_mu", "tissue_lambda")
    assert not volume("tissue", "tissue_lambda")


def test_ribs_that_are_fitted_are_no_unknown() -> None:
    torso = template_torso(157.0, "coarse")
    for names, fitted in (
        (("lateral_bending", "tissue"), False),
        (("rib_vertebra",), False),
        (("tissue", "rib_rotation"), True),
    ):
        assert is_fitted("ribs", parameter_groups(torso, names), torso) == fitted
    halves = parameter_groups(torso, ("tissue@thorax", "tissue@abdomen"))
    assert not is_fitted("volume", halves, torso)
    assert is_fitted("volume", (*halves, *parameter_groups(torso, ("tissue_lambda",))), torso)


@pytest.mark.parametrize("side", ["left", "right"])
@pytest.mark.parametrize("force_n", [20.0, 60.0])
def test_dead_loads_have_the_side_size_and_height_of_their_push(side, force_n) -> None:
    """F1 and F2 take all of F3 up, so that all together are rounding."""
    torso = template_torso(157.0, "coarse")
    site = PushSite(side, 8.5, 412.3, 188.7)
    dead, alone = (push_load(torso, site, force_n, Rig(pelvis)) for pelvis in ("dead-loads", "level"))
    assert dead.size == pytest.approx(2.0 * alone.size)
    assert pushed_site(dead, torso) == (side, pytest.approx(8.5))
    changes, wanted = load_changes(dead, torso), load_changes(alone, torso)
    of = dict(zip(LOADING, changes))
    # The gauge's error is that of F3, with which F1 and F2 grow.
    assert np.abs(of["offset"].forces[:2]).sum() == pytest.approx(1.0)
    for name, one in zip(LOADING[2:], wanted[2:]):
        np.testing.assert_allclose(of[name].forces, one.forces, err_msg=name)
    assert np.abs(of["height"].forces).max() > 0.01


def height_change(torso, side, level, force_n=60.0):
    """What a push changes by for each mm that it is higher, N by rib, and the load itself."""
    load = rib_push(torso, side, level, force_n, anterior_mm=12.0)
    change = load_changes(load, torso)[ACTS.index("height")]
    total = {}
    for bone, force in zip(change.points.bone, change.forces):
        name = torso.bone_names[bone]
        total[name] = total.get(name, 0.0) + float(force[0])
    return {name: force for name, force in total.items() if abs(force) > 1e-9}, change, load


@pytest.mark.parametrize(("side", "sign"), [("right", 1.0), ("left", -1.0)])
def test_a_push_at_a_whole_level_that_is_higher_leaves_its_rib_for_the_one_above(side, sign) -> None:
    """And one that is lower for the one below: the change is the mean of both."""
    torso = template_torso(157.0, "coarse")
    forces, change, load = height_change(torso, side, 8.0)
    mark = side[0].upper()
    assert set(forces) == {f"R7_{mark}", f"R8_{mark}", f"R9_{mark}"}
    assert sign * forces[f"R7_{mark}"] > 0.0 > sign * forces[f"R9_{mark}"]
    higher, _ = raised_level(torso, side, 8.0, HEIGHT_STEP_MM)
    pushed = rib_push(torso, side, higher, 60.0).forces[0, 0]
    assert 2.0 * HEIGHT_STEP_MM * forces[f"R7_{mark}"] == pytest.approx(pushed)
    assert change.total == pytest.approx(np.zeros(3), abs=1e-9)
    rest = torso.rest_pose
    # The resultant rises by 1 mm at its depth; the three ribs' points lie at depths of their own.
    assert change.moment(rest)[2] == pytest.approx(-60.0 * sign)
    assert load.moment(rest)[2] == pytest.approx(-60.0 * sign * load.points.positions(rest)[0, 1])


def test_a_push_well_between_two_ribs_stays_with_them() -> None:
    torso = template_torso(157.0, "coarse")
    forces, change, _ = height_change(torso, "right", 7.5)
    assert set(forces) == {"R7_R", "R8_R"}
    assert change.moment(torso.rest_pose)[2] == pytest.approx(-60.0)


@pytest.mark.parametrize("level", [1.0, 11.0, 11.5, 12.0])
def test_the_height_of_a_push_moves_no_more_force_than_there_is(level) -> None:
    """At the first and the last rib, and where two are as high as each other."""
    torso = template_torso(157.0, "coarse")
    forces, change, _ = height_change(torso, "left", level)
    assert change.total == pytest.approx(np.zeros(3), abs=1e-9)
    assert max(np.abs([*forces.values(), 0.0])) <= 60.0 / HEIGHT_STEP_MM
    assert change.moment(torso.rest_pose)[2] == pytest.approx(60.0)


@pytest.mark.parametrize("level", [1.0, 8.3, 11.0, 11.5, 12.0])
def test_a_push_is_at_the_level_of_its_ribs(level) -> None:
    """Also where rib 12 reaches higher than rib 11."""
    torso = template_torso(157.0, "coarse")
    assert pushed_site(rib_push(torso, "right", level, 40.0), torso) == ("right", pytest.approx(level))


@pytest.mark.parametrize("level", [5.0, 8.0])
def test_a_push_on_tissue_is_at_the_rib_of_its_height(level) -> None:
    torso = template_torso(157.0, "coarse")
    point = push_load(torso, PushSite("left", level), 1.0, Rig()).points.positions(torso.rest_pose)[0]
    tissue = torso.tissue
    free = np.flatnonzero(tissue.bone_of_node < 0)
    near = free[np.argsort(np.abs(tissue.rest_positions[free, 1] - point[1]))[:6]]
    side, found = pushed_site(tissue_load(torso, near, np.tile([-5.0, 0.0, 0.0], (6, 1))), torso)
    assert side == "left"
    assert found == pytest.approx(level, abs=0.1)
