"""spinestiff.anatomy.tetrahedra: volumes and angles against known solids."""

import numpy as np
import pytest

from spinestiff.anatomy.tetrahedra import dihedral_angles, least_angles, signed_volumes

REGULAR = np.array([[1.0, 1.0, 1.0], [-1.0, 1.0, -1.0], [1.0, -1.0, -1.0], [-1.0, -1.0, 1.0]])
CORNER = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])  # of a cube


def test_angles_of_a_regular_tetrahedron_and_of_a_cubes_corner():
    both = dihedral_angles(np.stack([REGULAR, CORNER]))
    steep = np.degrees(np.arctan(np.sqrt(2.0)))
    assert both[0] == pytest.approx(np.full(6, np.degrees(np.arccos(1.0 / 3.0))))
    assert np.sort(both[1]) == pytest.approx([steep] * 3 + [90.0] * 3)
    # Neither the order of the corners nor a turn of the solid matters.
    assert np.sort(dihedral_angles(CORNER[[1, 0, 3, 2]])) == pytest.approx(np.sort(both[1]))


def test_the_least_angle_counts_wide_ones_as_flat():
    wide = np.array([[5.0, 4, 0], [0, 1, 5], [3, 3, 3], [3, 2, 3]])
    angles = dihedral_angles(wide)
    assert angles.min() > 53.0 and 157.0 < angles.max() < 158.0
    assert least_angles(np.stack([wide, REGULAR])) == pytest.approx([180.0 - angles.max(), 70.5288])


def test_volumes_carry_the_sign_of_the_order():
    assert signed_volumes(np.stack([CORNER, CORNER[[0, 2, 1, 3]]])) == pytest.approx([1 / 6, -1 / 6])
