"""A bench phantom as a torso: joints, marks and rubber where they belong."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from spinestiff.anatomy.phantom import Column, RubberBlock, phantom_torso
from spinestiff.errors import TorsoError

COLUMN = Column(("L3", "L4", "L5"), (30.0, 25.0, 20.0), 10.0, (24.0, 19.0), 12.0, (3e3, 2e3, 1e3))
RUBBER = RubberBlock(80.0, 60.0, 0.05, spacing_mm=15.0)


def test_blocks_stand_on_the_base_with_a_joint_in_each_gap() -> None:
    torso = phantom_torso(COLUMN)
    assert torso.bone_names == ("L3", "L4", "L5", "pelvis")
    assert torso.rest_pose.bone_positions[:, 1].tolist() == [92.5, 57.5, 22.5, 0.0]
    assert torso.joints.names == ("L4-L3", "L5-L4", "pelvis-L5")
    middles = torso.rest_pose.bone_positions[torso.joints.parent] + torso.joints.parent_position
    assert middles[:, 1].tolist() == [75.0, 40.0, 5.0]
    assert torso.joints.stiffness[:, 5].tolist() == [3e3, 2e3, 1e3]


def test_a_leaf_resists_shear_as_a_clamped_beam() -> None:
    """A beam clamped at both ends gives by V L^3 / (12 E I), and turns by M L / (E I)."""
    shear, bending = phantom_torso(COLUMN).joints.stiffness[:, [0, 5]].T
    assert shear == pytest.approx(12.0 * bending / COLUMN.gap_mm**2)


def test_marks_are_a_frame_without_depth_on_the_front() -> None:
    box = phantom_torso(COLUMN).vertebra_boxes[0].reshape(2, 2, 2, 3)
    assert np.ptp(box[..., 2]) == 0.0 and box[0, 0, 0].tolist() == [12.0, 9.5, 12.0]
    assert box[1, 1, 1].tolist() == [-12.0, -9.5, 12.0]


def test_rubber_fills_what_blocks_and_gaps_leave() -> None:
    torso = phantom_torso(replace(COLUMN, rubber=RUBBER))
    tissue, height = torso.tissue, 3 * 35.0
    assert tissue.corner_volumes().sum() == pytest.approx(80.0 * 60.0 * height - 30.0 * 20.0 * height)
    assert np.ptp(tissue.rest_positions, axis=0).tolist() == [80.0, height, 60.0]
    x, y, z = np.abs(tissue.rest_positions).T
    inside = (x <= 15.0) & (z <= 10.0)
    blocks = inside & ((y % 35.0 >= 10.0) | ((y > 0.0) & (y % 35.0 == 0.0)))
    assert (tissue.bone_of_node[y == 0.0] == 3).all()
    assert blocks.any() and (tissue.bone_of_node[blocks] >= 0).all()
    assert (tissue.bone_of_node[~blocks & (y > 0.0)] == -1).all()
    assert [int(np.ceil(h / 35.0)) for h in y[tissue.bone_of_node == 0]] == [3] * int((tissue.bone_of_node == 0).sum())


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"levels": ("L4", "L5"), "stiffness": (1.0, 1.0)}, "a column of 2 blocks; wanted at least 3"),
        ({"stiffness": (1.0, 1.0)}, "3 blocks but 2 joints"),
        ({"stiffness": (1.0, 1.0, 0.0)}, "not above 0"),
        ({"stiffness": (1.0, np.nan, 1.0)}, "not above 0"),
        ({"gap_mm": np.nan}, "not above 0"),
        ({"marks_mm": (31.0, 19.0)}, "marks 31 mm apart on blocks of 30 mm width"),
        ({"rubber": replace(RUBBER, depth_mm=20.0)}, "rubber of 20 mm depth round blocks of 20 mm"),
        *(({"rubber": replace(RUBBER, spacing_mm=s)}, f"grid lines {s:g} mm apart") for s in (0.0, -1.0, np.nan)),
    ],
)
def test_what_is_no_column_is_refused(changes, words) -> None:
    with pytest.raises(TorsoError, match=words):
        replace(COLUMN, **changes)


def test_a_mesh_too_large_is_refused_before_it_is_made() -> None:
    wide = replace(COLUMN, rubber=replace(RUBBER, width_mm=300.0, depth_mm=300.0, spacing_mm=5.0))
    with pytest.raises(TorsoError, match=r"5 mm apart takes about .* nodes; wanted at most 60000, so raise spacing_mm"):
        phantom_torso(wide)
