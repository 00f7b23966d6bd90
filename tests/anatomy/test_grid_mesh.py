"""Tetrahedra over a grid of boxes."""

from __future__ import annotations

import numpy as np
import pytest

from spinestiff.anatomy.grid_mesh import grid_mesh, quadratic

X, Y, Z = np.array([0.0, 1.0, 4.0]), np.array([-2.0, 0.0]), np.array([0.0, 1.0, 2.0, 5.0])


def volumes(positions, elements):
    corners = positions[elements[:, :4]]
    return np.linalg.det(corners[:, 1:] - corners[:, :1]) / 6.0


def test_boxes_of_any_size_are_filled_by_six_upright_elements_each() -> None:
    positions, elements = grid_mesh(X, Y, Z)
    assert len(positions) == 3 * 2 * 4 and len(elements) == 6 * 2 * 1 * 3
    assert volumes(positions, elements).min() > 0.0
    assert volumes(positions, elements).sum() == pytest.approx(4.0 * 2.0 * 5.0)


def test_boxes_left_out_take_their_nodes_along() -> None:
    left_out = np.zeros((2, 1, 3), dtype=bool)
    left_out[1] = True
    positions, elements = grid_mesh(X, Y, Z, left_out)
    assert positions[:, 0].max() == 1.0 and len(positions) == 2 * 2 * 4
    assert volumes(positions, elements).sum() == pytest.approx(1.0 * 2.0 * 5.0)
    assert elements.max() == len(positions) - 1


def test_middles_of_edges_are_shared() -> None:
    positions, elements = quadratic(*grid_mesh(X, Y, Z))
    assert elements.shape[1] == 10
    assert len(np.unique(positions.round(9), axis=0)) == len(positions)
    assert positions[elements[:, 4]] == pytest.approx(0.5 * (positions[elements[:, 0]] + positions[elements[:, 1]]))
