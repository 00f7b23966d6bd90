"""spinestiff.anatomy.picture: pictures of torsos that lack skin, bone surfaces or the template's names."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.collections import PolyCollection

from spinestiff.anatomy.picture import COLOURS, torso_figure
from spinestiff.anatomy.template.surfaces import ball
from spinestiff.anatomy.torso import BoneSurface
from spinestiff.verification.models import make_torso, toy_torso

PLACES = np.array([[10.0, 0.0, 5.0], [20.0, 40.0, -5.0], [30.0, 80.0, 0.0]])


@pytest.fixture
def bare():
    """Three bones without tissue and surfaces."""
    return make_torso(PLACES, [(0, 1), (1, 2)], np.ones((1, 6)))


def polygons(axis):
    return [len(c.get_paths()) for c in axis.collections if isinstance(c, PolyCollection)]


def test_bones_without_surfaces_and_skin_are_dots_from_every_side(bare):
    front, side, rear = torso_figure(bare).axes
    for axis, across in ((front, PLACES[:, 0]), (side, PLACES[:, 2]), (rear, -PLACES[:, 0])):
        assert polygons(axis) == []
        bones, joints = axis.lines
        np.testing.assert_array_equal(bones.get_xydata(), np.stack([across, PLACES[:, 1]], 1))
        np.testing.assert_allclose(joints.get_xydata()[:, 1], [20.0, 60.0])


def test_bones_without_surfaces_lie_over_their_skin():
    torso = toy_torso()
    for axis in torso_figure(torso).axes:
        assert polygons(axis) == [len(torso.tissue.boundary_faces())]
        assert len(axis.lines[0].get_xydata()) == 3


def test_bones_of_any_name_are_drawn(bare):
    assert "b" not in COLOURS
    surfaces = tuple(BoneSurface(*ball(np.zeros(3), 8.0)) for _ in PLACES)
    for names in (bare.bone_names, ("", "x", "7")):
        for axis in torso_figure(replace(bare, bone_surfaces=surfaces, bone_names=names)).axes:
            (drawn,) = polygons(axis)
            assert 0 < drawn < 3 * len(surfaces[0].faces)  # what faces away is left out


def test_notebooks_show_a_torso_of_bare_bones(bare):
    assert "<td" in bare._repr_html_()
