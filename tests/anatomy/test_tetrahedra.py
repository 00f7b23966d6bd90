"""spinestiff.anatomy.tetrahedra: volumes and angles against known solids."""

import numpy as np
import pytest

from spinestiff.anatomy.meshing import least_angles
from spinestiff.anatomy.tetrahedra import dihedral_angles, signed_volumes

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
    flat = np.array([[0.0, 0, 0], [2, 0, 0], [1, 1, 0.01], [1, -1, 0.01]])
    angles = dihedral_angles(flat)
    assert angles.max() > 178.0 and angles.min() < 2.0
    assert least_angles(np.stack([flat, REGULAR])) == pytest.approx([min(angles.min(), 180.0 - angles.max()), 70.5288])


def test_volumes_carry_the_sign_of_the_order():
    assert signed_volumes(np.stack([CORNER, CORNER[[0, 2, 1, 3]]])) == pytest.approx([1 / 6, -1 / 6])
