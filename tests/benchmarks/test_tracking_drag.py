"""What ``benchmarks/tracking_drag.py`` counts."""

from __future__ import annotations

import numpy as np
import pytest

from programs import benchmark

drag = benchmark("tracking_drag")


def column():
    """Corners (3, 4, 2) of three vertebrae 30 pixels apart."""
    box = np.array([[20.0, -10.0], [-20.0, -10.0], [-20.0, 10.0], [20.0, 10.0]])
    return box + np.array([[100.0, 50.0], [100.0, 80.0], [100.0, 110.0]])[:, None]


def test_a_column_that_moves_as_one_piece_shears_nowhere():
    turn = np.array([[np.cos(0.2), -np.sin(0.2)], [np.sin(0.2), np.cos(0.2)]])
    assert drag.disc_shear(column(), column() @ turn.T + [7.0, -3.0]) == pytest.approx([0.0, 0.0], abs=1e-12)


def test_a_vertebra_aside_shears_the_discs_beside_it_and_one_farther_down_none():
    aside, down = column(), column()
    aside[1, :, 0] += 0.6
    down[1, :, 1] += 0.6
    assert drag.disc_shear(column(), aside) == pytest.approx([0.02, 0.02])
    assert drag.disc_shear(column(), down) == pytest.approx([0.0, 0.0], abs=1e-12)
