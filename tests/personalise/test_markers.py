"""Markers placed on a torso: the cameras' shift and turn found again, and what can't be on this skin refused."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree

from spinestiff.anatomy.rotation import exp_so3
from spinestiff.anatomy.template import template_torso
from spinestiff.errors import SubjectError
from spinestiff.imaging.projection import frontal_view
from spinestiff.personalise.markers import place_markers
from spinestiff.personalise.skin_surface import nearest_points, skin_surface
from spinestiff.study.synthetic.markers import spread_markers

VIEW = frontal_view()
SHIFT = np.array([400.0, -900.0, 250.0])
TURN = exp_so3(np.deg2rad([2.0, -3.0, 1.5]))
COUNT = 14
SOME_TURN = float(np.deg2rad(3.0))
NAMES = tuple(f"m{i}" for i in range(COUNT))


@pytest.fixture(scope="module")
def torso():
    return template_torso(157.0, "coarse")


@pytest.fixture(scope="module")
def there(torso):
    """(M, 3) mm, on front and flanks."""
    return spread_markers(torso, COUNT, np.full((1, 3), 1e4))[0].positions(torso, torso.rest_pose)


def placed(torso, there, rows=(0, 4, 9), beside=0.0, side="front", turn_sd=SOME_TURN, change=lambda seen: seen):
    rows = np.array(rows)
    marks = VIEW.project(there[rows]) + beside * VIEW.magnification
    seen = change(there @ TURN.T + SHIFT)
    return place_markers(torso, NAMES[: len(there)], seen, (rows, marks), VIEW, side, turn_sd), seen


def test_shift_and_turn_of_the_cameras_are_found(torso, there):
    found, seen = placed(torso, there)
    again = found.placed(seen)
    assert np.abs(again - there).max() < 1.5
    assert np.degrees(np.linalg.norm(found.turn @ TURN - np.eye(3))) < 0.5
    on = found.points.positions(torso, torso.rest_pose)
    assert np.linalg.norm(on - again, axis=1).max() < 1.0
    assert np.allclose(np.linalg.norm(found.outward, axis=1), 1.0)
    # Several frames at once, as a table has them.
    assert np.allclose(found.placed(np.stack([seen, seen + [0.0, 5.0, 0.0]]))[0], again)


def test_markers_off_the_skin_say_how_far_and_ride_on_the_nearest_point(torso, there):
    found, _ = placed(torso, there)
    outside, seen = placed(torso, there + 6.0 * found.outward)
    assert np.abs(outside.off_mm).mean() < 6.0
    again = outside.placed(seen)
    apart = again - outside.points.positions(torso, torso.rest_pose)
    fine = skin_surface(torso, 2.0)
    nearest = cKDTree(fine.points[~fine.ends]).query(again)[0]
    assert (np.linalg.norm(apart, axis=1) <= nearest + 1e-9).all()
    assert np.allclose(outside.off_mm, np.einsum("mi,mi->m", apart, outside.outward))


def test_one_marker_in_the_radiograph_tells_the_height(torso, there):
    found, seen = placed(torso, there, rows=(0,))
    assert np.abs(found.placed(seen) - there)[:, 1].max() < 6.0


def test_markers_of_the_back_are_looked_for_there(torso, there):
    behind = there * [1.0, 1.0, -1.0]
    back = nearest_points(torso, skin_surface(torso), behind)[0]
    back = back.positions(torso, torso.rest_pose)
    back = back[back[:, 2] < back[:, 2].mean()]
    found, seen = placed(torso, back, rows=(0, 1, 2), side="back")
    assert np.abs(found.placed(seen) - back).max() < 3.0
    assert (found.outward[:, 2] < 0.5).all()


def test_the_nearest_point_is_nearer_than_any_sample_of_the_skin(torso, there):
    skin = skin_surface(torso, 4.0)
    wanted = there + np.random.default_rng(0).normal(0.0, 5.0, there.shape)
    distance, start = skin.tree.query(wanted)
    points, outward = nearest_points(torso, skin, wanted)
    apart = wanted - points.positions(torso, torso.rest_pose)
    assert (np.linalg.norm(apart, axis=1) <= distance + 1e-9).all()
    assert np.linalg.norm(apart, axis=1).mean() < 0.97 * distance.mean()
    assert (points.shares @ np.ones(points.shares.shape[1])) == pytest.approx(1.0)
    assert (np.einsum("mi,mi->m", outward, skin.normals[start]) > 0.7).all()


@pytest.mark.parametrize(
    ("how", "words"),
    [
        ({"change": lambda seen: 0.1 * seen}, "the two farthest apart are 42.59 mm apart, wanted 126 to 1099 mm"),
        ({"change": lambda seen: 10.0 * seen}, "apart, wanted 126 to 1099 mm .* check the unit"),
        ({"change": lambda seen: seen + 60.0 * np.eye(COUNT)[:, :1] * [0.0, 0.0, 1.0]}, "marker 'm0' lies"),
        ({"change": lambda seen: seen @ exp_so3(np.array([0.0, 0.0, 0.6])).T}, "lies|degrees from the body's"),
        ({"rows": (0, 4), "beside": np.array([[0.0, 0.0], [0.0, 90.0]])}, "beside its picture|from the skin"),
        ({"side": "back"}, r"they lie within \d mm of the skin of the front, but \d+ mm off that of the back"),
    ],
    ids=["small", "large", "off", "turned", "shown", "side"],
)
def test_what_cannot_be_on_this_skin_is_refused(torso, there, how, words):
    with pytest.raises(SubjectError, match=words):
        placed(torso, there, **how)


def test_axes_that_are_known_are_not_turned(torso, there):
    found, _ = placed(torso, there, turn_sd=0.0)
    assert np.abs(found.turn - np.eye(3)).max() < 1e-3
