"""Choices the paper leaves open: where discs turn, how scapulae rest, T12-L1's row of Table 1."""

from dataclasses import replace

import numpy as np
import pytest

from spinestiff.anatomy.names import INTERVERTEBRAL
from spinestiff.anatomy.points import PointsOnBones
from spinestiff.anatomy.state import TorsoState
from spinestiff.anatomy.stiffness import TABLE_1
from spinestiff.anatomy.template import template_torso
from spinestiff.errors import TorsoError
from spinestiff.mechanics.joints import joint_energies


def places(torso, side):
    table, rest = torso.joints, torso.rest_pose
    bone = getattr(table, side)
    centres = PointsOnBones(bone, getattr(table, f"{side}_position")).positions(rest)
    return centres, rest.bone_rotations[bone] @ getattr(table, f"{side}_axes")


@pytest.fixture(scope="module")
def plain():
    return template_torso(157.0)


def test_defaults_change_nothing(plain):
    same = template_torso(157.0, disc_shift_mm=0.0, scapulothoracic_n_per_mm=0.0, thoracolumbar="lumbar")
    for key in ("stiffness", "parent_position", "child_position"):
        np.testing.assert_array_equal(getattr(same.joints, key), getattr(plain.joints, key))
    assert same.joints.kinds == plain.joints.kinds


def test_disc_centres_shift_backwards_in_the_discs_frame(plain):
    torso = template_torso(157.0, disc_shift_mm=5.0)
    old, axes = places(plain, "parent")
    new, _ = places(torso, "parent")
    discs = np.array([kind in INTERVERTEBRAL for kind in plain.joints.kinds])
    assert discs.sum() == 17
    np.testing.assert_allclose(new[discs] - old[discs], -5.0 * axes[discs, :, 2], atol=1e-9)
    np.testing.assert_array_equal(new[~discs], old[~discs])
    assert (new[discs, 2] < old[discs, 2] - 3.0).all()
    np.testing.assert_allclose(places(torso, "child")[0], new, atol=1e-9)  # free of stress
    # What does not slide is left: a turn of T6 about the shifted centre costs the joint no translation.
    joint = torso.joints.names.index("T7-T6")
    assert not np.allclose(torso.joints.child_position[joint], plain.joints.child_position[joint])


def test_t12_l1_in_the_thoracic_group(plain):
    torso = template_torso(157.0, thoracolumbar="thoracic")
    row = torso.joints.names.index("L1-T12")
    assert plain.joints.kinds[row] == "lumbar" and torso.joints.kinds[row] == "thoracic"
    assert torso.joints.kinds.count("thoracic") == 12 and torso.joints.kinds.count("lumbar") == 5
    np.testing.assert_allclose(torso.joints.stiffness[row, :3], TABLE_1["thoracic"][:3])
    np.testing.assert_allclose(torso.joints.stiffness[row, 3:], 1e3 * np.array(TABLE_1["thoracic"][3:]))
    others = np.arange(67) != row
    np.testing.assert_array_equal(torso.joints.stiffness[others], plain.joints.stiffness[others])


def test_scapulothoracic_springs_are_two_more_joints_between_rib_and_blade(plain):
    assert len(plain.joints) == 67
    torso = template_torso(157.0, scapulothoracic_n_per_mm=10.0)
    assert torso.joints.names[-2:] == ("R5_L-scapula_L", "R5_R-scapula_R")
    assert torso.joints.kinds[-2:] == ("scapulothoracic",) * 2
    centres, axes = places(torso, "parent")
    np.testing.assert_allclose(places(torso, "child")[0], centres, atol=1e-9)
    np.testing.assert_allclose(centres[-2] * [-1.0, 1.0, 1.0], centres[-1], atol=1e-9)
    assert axes[-2, 2, 0] < -0.3 and axes[-2, 0, 0] > 0.3  # X from the rib out to the blade, back and sideways
    for name in ("R5_L", "scapula_L"):
        bone = torso.bone(name)
        near = np.linalg.norm(torso.surface_positions(torso.rest_pose, bone) - centres[-2], axis=1).min()
        assert near < 15.0, name
    np.testing.assert_array_equal(torso.joints.stiffness[:67], plain.joints.stiffness)


def test_the_spring_resists_lifting_and_lets_the_blade_glide():
    torso = template_torso(157.0, scapulothoracic_n_per_mm=10.0)
    _, axes = places(torso, "parent")
    rest, blade = torso.rest_pose, torso.bone("scapula_L")

    def energy(step):
        at = np.array(rest.bone_positions)
        at[blade] += step
        moved = TorsoState(at, rest.bone_rotations, rest.tissue_positions)
        return joint_energies(torso.joints, moved, torso.joints.stiffness)[-2]

    assert energy(2.0 * axes[-2, :, 0]) == pytest.approx(0.5 * 10.0 * 4.0)
    assert energy(2.0 * axes[-2, :, 1]) == pytest.approx(0.0, abs=1e-12)
    assert energy(2.0 * axes[-2, :, 2]) == pytest.approx(0.0, abs=1e-12)


def test_options_hold_for_other_bodies():
    torso = template_torso(
        140.0, age_years=10.0, sex="male", disc_shift_mm=4.0, scapulothoracic_n_per_mm=1.0, thoracolumbar="thoracic"
    )
    assert len(torso.joints) == 69 and torso.joints.kinds.count("thoracic") == 12
    centres, _ = places(torso, "parent")
    np.testing.assert_allclose(centres[-2] * [-1.0, 1.0, 1.0], centres[-1], atol=1e-9)
    plain = template_torso(140.0, age_years=10.0, sex="male")
    shift = centres[:17] - places(plain, "parent")[0][:17]
    np.testing.assert_allclose(np.linalg.norm(shift, axis=1), 4.0)
    assert replace(torso).height_cm == 140.0


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"disc_shift_mm": -1.0}, "shift of the disc centres -1 mm; wanted 0 to 15 mm backwards"),
        ({"disc_shift_mm": float("nan")}, "shift of the disc centres nan mm"),
        ({"scapulothoracic_n_per_mm": -3.0}, "scapulothoracic stiffness -3 N/mm"),
        ({"thoracolumbar": "sacral"}, "T12-L1 in group 'sacral'; wanted thoracic or lumbar"),
    ],
)
def test_impossible_options_are_refused(options, said):
    with pytest.raises(TorsoError, match=said):
        template_torso(157.0, **options)
