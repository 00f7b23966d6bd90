import numpy as np
import pytest

from spinestiff.anatomy.names import JOINTS
from spinestiff.anatomy.stiffness import (
    DIRECTIONS,
    TABLE_1,
    StiffnessRatios,
    joint_stiffness,
    lame_parameters,
    parameter_group,
    stiffness_ratios,
)
from spinestiff.errors import TorsoError

KINDS = tuple(joint.kind for joint in JOINTS)


def test_default_stiffness_is_table_1_in_newtons_and_millimetres():
    k = joint_stiffness()
    assert k.shape == (67, 6)
    first = KINDS.index("thoracic")
    np.testing.assert_allclose(k[first], [262, 1720, 262, 154e3, 137e3, 154e3])
    np.testing.assert_allclose(k[KINDS.index("rib_sternum")], [51.85, 8, 8, 9.7e3, 2.29e3, 2.29e3])
    assert set(KINDS) == set(TABLE_1)


def test_lame_parameters_give_back_young_and_poisson():
    mu, lambda_ = lame_parameters(1.2, 0.45)
    assert mu * (3.0 * lambda_ + 2.0 * mu) / (lambda_ + mu) == pytest.approx(1.2)
    assert lambda_ / (2.0 * (lambda_ + mu)) == pytest.approx(0.45)


@pytest.mark.parametrize(("young", "poisson"), [(0.0, 0.4), (-1.0, 0.4), (1.0, 0.5), (1.0, -1.0), (float("nan"), 0.4)])
def test_impossible_materials_are_refused(young, poisson):
    with pytest.raises(TorsoError, match="Poisson"):
        lame_parameters(young, poisson)


@pytest.mark.parametrize("name", [*(n for n in DIRECTIONS if n != "lateral_bending"), "intervertebral_bending"])
def test_a_direction_scales_one_column_of_the_seventeen_intervertebral_joints(name):
    group = parameter_group(name, KINDS)
    assert group.joints.sum() == 17
    assert group.joints[:17, DIRECTIONS.get(name, 5)].all()
    assert not (group.mu or group.lambda_)


def test_lateral_bending_takes_the_sternal_joints_along():
    group, papers = parameter_group("lateral_bending", KINDS), parameter_group("intervertebral_bending", KINDS)
    added = group.joints & ~papers.joints
    assert (group.joints >= papers.joints).all()
    assert added.sum() == 20 * 6
    assert {KINDS[i] for i in np.flatnonzero(added.any(1))} == {"rib_sternum"}


def test_a_row_of_table_1_scales_all_its_directions():
    group = parameter_group("rib_vertebra", KINDS)
    assert group.joints.sum() == 24 * 6
    assert [KINDS[i] for i in np.flatnonzero(group.joints.any(1))] == ["rib_vertebra"] * 24


def test_tissue_ratio_scales_both_lame_parameters_and_its_parts_one():
    for name, mu, lambda_ in (("tissue", 0.1, 0.2), ("tissue_mu", 0.1, 2.0), ("tissue_lambda", 1.0, 0.2)):
        scaled = stiffness_ratios({name: 0.1}).scale_tissue(np.ones(3), np.full(3, 2.0))
        assert np.array(scaled) == pytest.approx(np.array([[mu] * 3, [lambda_] * 3]))


def test_a_part_of_a_group_lies_at_some_joints_and_in_some_elements():
    whole, at = parameter_group("everything", KINDS), np.arange(len(KINDS)) % 3 == 0
    part = whole.within("a third", at, [True, False, False])
    assert part.name == "a third"
    assert (part.joints == at[:, None]).all()
    assert part.elements.tolist() == [True, False, False]
    # Masks narrow further, and what is not named stays.
    narrow = part.within("narrow", elements=[True, True, False])
    assert narrow.elements.tolist() == [True, False, False]
    assert (narrow.joints == part.joints).all()
    ratios = StiffnessRatios((part, whole), np.array([0.5, 2.0]))
    mu, lambda_ = ratios.scale_tissue(np.ones(3), np.ones(3))
    assert mu.tolist() == lambda_.tolist() == [1.0, 2.0, 2.0]
    assert (ratios.scale_joints(np.ones((len(KINDS), 6)))[:, 0] == np.where(at, 1.0, 2.0)).all()


def test_masks_of_another_length_are_refused():
    whole = parameter_group("everything", KINDS)
    with pytest.raises(TorsoError, match=r"joints has shape \(2,\), wanted \(67\)"):
        whole.within("part", np.ones(2, dtype=bool))
    ratios = StiffnessRatios((whole.within("part", elements=[True, False]),), np.ones(1))
    with pytest.raises(TorsoError, match="'part' names 2 tissue elements, the mesh has 3"):
        ratios.scale_tissue(np.ones(3), np.ones(3))
    with pytest.raises(TorsoError, match="'everything' names 67 joints, the torso has 2"):
        StiffnessRatios((whole,), np.ones(1)).scale_joints(np.ones((2, 6)))
    with pytest.raises(TorsoError, match=r"elements has shape \(2,\), wanted \(3\)"):
        whole.within("part", elements=np.ones(3, dtype=bool)).within("part", elements=np.ones(2, dtype=bool))


def test_ratios_of_overlapping_groups_multiply():
    ratios = stiffness_ratios({"lateral_bending": 0.5, "thoracic": 0.1, "everything": 2.0})
    factor = ratios.scale_joints(joint_stiffness()) / joint_stiffness()
    assert factor[KINDS.index("thoracic"), 5] == pytest.approx(0.1)
    assert factor[KINDS.index("thoracic"), 4] == pytest.approx(0.2)
    assert factor[KINDS.index("lumbar"), 5] == pytest.approx(1.0)
    assert factor[KINDS.index("rib_sternum"), 0] == pytest.approx(1.0)
    assert factor[KINDS.index("rib_vertebra"), 0] == pytest.approx(2.0)
    assert [v.tolist() for v in ratios.scale_tissue(np.ones(2), np.ones(2))] == [[2.0, 2.0], [2.0, 2.0]]


def test_scaling_leaves_the_defaults_alone():
    k = joint_stiffness()
    stiffness_ratios({"everything": 0.5}).scale_joints(k)
    np.testing.assert_array_equal(k, joint_stiffness())


def test_ratios_by_name_and_back():
    ratios = stiffness_ratios({"axial_rotation": 0.3, "tissue": 0.02})
    assert ratios.as_dict() == {"axial_rotation": 0.3, "tissue": 0.02}
    assert ratios.with_values([1.0, 2.0]).as_dict() == {"axial_rotation": 1.0, "tissue": 2.0}


def test_unknown_names_and_ratios_that_are_not_positive_are_refused():
    with pytest.raises(TorsoError, match="lateral_bending"):
        stiffness_ratios({"sideways": 1.0})
    with pytest.raises(TorsoError, match="positive"):
        stiffness_ratios({"tissue": 0.0})
