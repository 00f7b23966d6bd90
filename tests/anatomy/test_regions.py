"""Stiffness parameters of regions and levels: what each scales, and which names there are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from spinestiff.anatomy.names import JOINTS
from spinestiff.anatomy.regions import (
    check_parameters,
    element_heights,
    expanded,
    joint_levels,
    levels_of,
    parameter_groups,
    scaled_torso,
    torso_ratios,
)
from spinestiff.anatomy.stiffness import KINDS, parameter_group
from spinestiff.anatomy.template import template_torso
from spinestiff.errors import TorsoError


@pytest.fixture(scope="module")
def torso():
    return template_torso(157.0)


def joints_of(torso, name):
    """Names of the joints that a parameter scales, of the spine and others."""
    (group,) = parameter_groups(torso, [name])
    names = {torso.joints.names[i] for i in np.flatnonzero(group.joints.any(axis=1))}
    spine = {str(joint) for joint in JOINTS if joint.kind in ("thoracic", "lumbar")}
    return names & spine, names - spine


def test_a_region_has_the_discs_between_its_ends_and_the_sternal_joints_of_their_ribs(torso):
    spine, others = joints_of(torso, "lateral_bending@thoracic")
    assert spine == {f"T{i + 1}-T{i}" for i in range(1, 12)}
    assert others == {f"sternum-R{i}_{side}" for i in range(1, 11) for side in "LR"}
    spine, others = joints_of(torso, "lateral_bending@lumbar")
    assert spine == {"L1-T12", "L2-L1", "L3-L2", "L4-L3", "L5-L4", "pelvis-L5"}
    assert others == set()


@pytest.mark.parametrize(
    ("name", "spine", "others"),
    [
        ("lateral_bending@T8-T9", {"T9-T8"}, {"sternum-R9_L", "sternum-R9_R"}),
        ("lateral_bending@T1-T2", {"T2-T1"}, {f"sternum-R{i}_{side}" for i in (1, 2) for side in "LR"}),
        ("intervertebral_bending@T11-L1", {"T12-T11", "L1-T12"}, set()),
        ("axial_rotation@L5-S1", {"pelvis-L5"}, set()),
        ("rib_rotation@T11-T12", set(), {"T12-R12_L", "T12-R12_R"}),
    ],
)
def test_levels_lie_between_two_vertebrae(torso, name, spine, others):
    assert joints_of(torso, name) == (spine, others)


@pytest.mark.parametrize("name", ["lateral_bending", "flexion_extension", "rib_rotation", "rib_sternum", "thoracic"])
def test_all_levels_together_are_the_group_each_joint_once(torso, name):
    whole = parameter_group(name, KINDS).joints
    parts = [group.joints for group in parameter_groups(torso, [f"{name}@levels"])]
    assert (np.sum(parts, axis=0) == whole).all()
    assert len(parts) > 5


def test_levels_of_a_whole_spine_run_from_above_downward(torso):
    names = expanded(torso, ["tissue", "lateral_bending@levels"])
    assert len(names) == 18
    assert names[:3] == ("tissue", "lateral_bending@T1-T2", "lateral_bending@T2-T3")
    assert names[-1] == "lateral_bending@L5-S1"
    assert expanded(torso, names) == names
    assert [levels_of(name) for name in names[1:]] == [(i,) for i in range(17)]


def test_joints_of_the_shoulder_girdle_have_no_level(torso):
    levels = joint_levels(torso)
    assert {torso.joints.kinds[i] for i in np.flatnonzero(levels < 0)} == {
        "sternum_clavicle", "clavicle_scapula", "scapula_humerus",
    }  # fmt: skip


def test_thorax_and_abdomen_part_the_tissue_at_the_thoracolumbar_joint(torso):
    thorax, abdomen = parameter_groups(torso, ["tissue@thorax", "tissue@abdomen"])
    assert (thorax.elements != abdomen.elements).all()
    assert thorax.mu and thorax.lambda_ and not thorax.joints.any()
    rest, centres = torso.rest_pose, torso.tissue.rest_positions[torso.tissue.elements[:, :4]].mean(axis=1)
    upper, lower = (rest.bone_positions[torso.bone(name), 1] for name in ("T12", "L1"))
    assert thorax.elements[centres[:, 1] > upper].all()
    assert abdomen.elements[centres[:, 1] < lower].all()
    # About a quarter of a vertebra's height of where the discs' centres put the line.
    assert centres[:, 1] - element_heights(torso) == pytest.approx(0.5 * (upper + lower), abs=8.0)
    mu, _ = torso_ratios(torso, {"tissue@thorax": 0.5}).scale_tissue(torso.tissue.lame_mu, torso.tissue.lame_lambda)
    assert (mu == torso.tissue.lame_mu * np.where(thorax.elements, 0.5, 1.0)).all()


def test_a_scaled_torso_has_the_ratios_in_its_own_stiffness(torso):
    ratios = {"lateral_bending@lumbar": 0.5, "tissue": 0.1}
    scaled, found = scaled_torso(torso, ratios), torso_ratios(torso, ratios)
    np.testing.assert_array_equal(scaled.joints.stiffness, found.scale_joints(torso.joints.stiffness))
    assert not np.array_equal(scaled.joints.stiffness, torso.joints.stiffness)
    for own, default in (
        (scaled.tissue.lame_mu, torso.tissue.lame_mu),
        (scaled.tissue.lame_lambda, torso.tissue.lame_lambda),
    ):
        np.testing.assert_allclose(own, 0.1 * default)
    np.testing.assert_array_equal(scaled.tissue.rest_positions, torso.tissue.rest_positions)


def test_a_part_beside_its_whole_multiplies(torso):
    ratios = torso_ratios(torso, {"lateral_bending": 0.1, "lateral_bending@lumbar": 3.0})
    factor = ratios.scale_joints(torso.joints.stiffness)[:, 5] / torso.joints.stiffness[:, 5]
    assert factor[torso.joints.names.index("L3-L2")] == pytest.approx(0.3)
    assert factor[torso.joints.names.index("T9-T8")] == pytest.approx(0.1)


@pytest.mark.parametrize(
    ("names", "words"),
    [
        ([], "no stiffness parameter; wanted at least one"),
        (["tissue", "tissue"], "'tissue' is named twice"),
        (["bending@lumbar"], "unknown stiffness parameter 'bending'; known are lateral_shear, "),
        (["lateral_bending@neck"], "unknown part 'neck' in 'lateral_bending@neck'; wanted one of thoracic, lumbar, "),
        (["lateral_bending@"], "unknown part '' in 'lateral_bending@'; wanted one of thoracic"),
        (["lateral_bending@T9-T8"], "unknown part 'T9-T8'"),
        (["lateral_bending@T8-T8"], "unknown part 'T8-T8'"),
        (["lateral_bending@C7-T1"], "unknown part 'C7-T1'"),
        (["lateral_bending@thorax"], "unknown part 'thorax' .*wanted one of thoracic"),
        (["tissue@thoracic"], "unknown part 'thoracic' in 'tissue@thoracic'; wanted one of thorax, abdomen$"),
        (["tissue@levels"], "unknown part 'levels' in 'tissue@levels'; wanted one of thorax, abdomen$"),
        (["everything@lumbar"], "'everything' is of joints and tissue, a part is of one of them"),
    ],
)  # fmt: skip
def test_unknown_names_are_refused_in_a_line(names, words):
    with pytest.raises(TorsoError, match=words) as caught:
        check_parameters(names)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "names", [("lateral_bending@lumbar", "lateral_bending@T12-S1"), ("rib_rotation", "rib_rotation@T1-S1")]
)
def test_two_names_of_the_same_stiffnesses_are_refused(torso, names):
    with pytest.raises(TorsoError, match=f"^'{names[0]}' and '{names[1]}' scale the same stiffnesses of this torso;"):
        parameter_groups(torso, ["tissue_mu", "tissue_lambda", *names])


def test_one_ratio_for_all_levels_is_refused_as_such(torso):
    with pytest.raises(TorsoError, match=r"^'lateral_bending@levels' is a ratio for each level; .*@T8-T9$"):
        torso_ratios(torso, {"lateral_bending@levels": 0.5})


def test_what_a_torso_has_not_is_refused(torso):
    with pytest.raises(TorsoError, match="the torso has nothing of 'rib_sternum' at lumbar"):
        parameter_groups(torso, ["rib_sternum@lumbar"])
    with pytest.raises(TorsoError, match="'sternum_clavicle' has no joints at the levels of the spine"):
        expanded(torso, ["sternum_clavicle@levels"])
    with pytest.raises(TorsoError, match="'lateral_bending@T8-T9' is named twice"):
        expanded(torso, ["lateral_bending@T8-T9", "lateral_bending@levels"])
    names = tuple(f"bone {i}" for i in range(len(torso.bone_names)))
    others = replace(torso, bone_names=names, vertebrae=tuple(names[i] for i in torso.vertebra_bones))
    with pytest.raises(TorsoError, match="no joint between T12 and L1 in this torso"):
        parameter_groups(others, ["tissue@thorax"])
