"""Corners out of order: put right where there is one safe way, refused with the reason everywhere else."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from spine_images import image
from spinestiff.anatomy.names import VERTEBRAE
from spinestiff.curves.corner_files import ImageCorners
from spinestiff.curves.corner_order import in_order
from spinestiff.errors import SubjectError

TILTS = [6, 10, 14, 12, 6, -2, -10, -16, -18, -14, -8, 0, 8, 14, 16, 12, 8]
SPINE = image(TILTS)


def changed(corners):
    return replace(SPINE, corners=corners)


def refused(spine, words):
    with pytest.raises(SubjectError, match=words) as error:
        in_order(spine)
    assert "\n" not in str(error.value)


def test_corners_in_order_are_left_alone():
    found = in_order(SPINE)
    assert (found.repairs, found.warnings) == ((), ())
    assert np.array_equal(found.corners, SPINE.corners)


@pytest.mark.parametrize("seed", range(3))
def test_the_order_of_a_files_rows_does_not_matter(seed):
    rows = np.random.default_rng(seed).permutation(17)
    found = in_order(ImageCorners("a", [VERTEBRAE[i] for i in rows], SPINE.corners[rows]))
    assert (found.levels, found.repairs) == (VERTEBRAE, ())
    assert np.array_equal(found.corners, SPINE.corners)


@pytest.mark.parametrize(
    "order",
    [(1, 0, 3, 2), (3, 2, 1, 0), (2, 3, 0, 1), (1, 2, 3, 0), (3, 0, 1, 2), (0, 1, 3, 2), (3, 1, 2, 0), (1, 0, 2, 3)],
)
@pytest.mark.parametrize("at", [0, 7, 16])
def test_any_order_of_one_vertebras_corners_is_repaired(order, at):
    corners = SPINE.corners.copy()
    corners[at] = corners[at, list(order)]
    found = in_order(changed(corners))
    assert np.array_equal(found.corners, SPINE.corners)
    assert len(found.repairs) == 1 and found.repairs[0].startswith(f"{VERTEBRAE[at]} corners were out of order")


def test_the_words_of_a_repair_name_the_corners():
    corners = SPINE.corners.copy()
    corners[3] = corners[3, [0, 1, 3, 2]]
    words = "what was named bottom_left is bottom_right, bottom_right is bottom_left"
    assert words in in_order(changed(corners)).repairs[0]


@pytest.mark.parametrize("shift", [1, -1])
def test_one_level_out_of_place_is_renamed_with_a_warning(shift):
    found = in_order(changed(np.roll(SPINE.corners, -shift, axis=0)))
    assert np.array_equal(found.corners, SPINE.corners)
    assert found.levels == VERTEBRAE
    assert "levels renamed from head to foot, T1 to L5" in found.repairs[0] and "check the names" in found.repairs[0]


def test_more_than_one_level_out_of_place_is_refused():
    refused(changed(np.roll(SPINE.corners, -3, axis=0)), "no order from head to foot")


def test_a_level_out_of_place_among_missing_ones_is_refused():
    rows = [i for i in range(17) if i != 8]
    levels = [VERTEBRAE[i] for i in rows]
    refused(ImageCorners("a", levels, np.roll(SPINE.corners[rows], -1, axis=0)), "as levels are missing")


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda c: c[:, [1, 0, 3, 2]], "left and right corners are exchanged in most"),
        (lambda c: c * [-1.0, 1.0], "left and right corners are exchanged in most"),
        (lambda c: c[:, [3, 2, 1, 0]], "top and bottom corners are exchanged in most"),
        (lambda c: c * [1.0, -1.0], "y grows upwards"),
        (lambda c: c[::-1], "T1 lies below L5: upside down, or the levels are named from below"),
        (lambda c: (2000.0 - c)[:, [2, 3, 0, 1]], "T1 lies below L5: upside down"),
        (lambda c: c[:, [0, 1, 3, 2]], "corners of 17 of 17 vertebrae are out of order"),
        (lambda c: (c @ [[0.0, 1.0], [-1.0, 0.0]])[:, [3, 0, 1, 2]] + [2000.0, 0.0], "across the image|out of order"),
    ],
)
def test_an_image_that_is_wrong_as_a_whole_is_refused(spoil, words):
    refused(changed(spoil(SPINE.corners)), words)


def spoiled(at, quad):
    corners = SPINE.corners.copy()
    corners[at] = quad
    return changed(corners)


@pytest.mark.parametrize(
    ("spine", "words"),
    [
        (
            spoiled(5, SPINE.corners[5].mean(0) + np.array([[0, 0], [1, 0], [1, 1], [0, 1]])),
            "T6 is 0.0083 times as wide",
        ),
        (spoiled(5, SPINE.corners[5].mean(0) + np.array([[0, 0], [1, 0], [2, 0], [3, 0]])), "T6: the corners make no"),
        (spoiled(5, np.tile(SPINE.corners[5].mean(0), (4, 1))), "T6: the corners make no vertebra"),
        (spoiled(5, [*SPINE.corners[5][:3], SPINE.corners[5].mean(0) + [20, 0]]), "T6: the corners make no vertebra"),
        (spoiled(16, SPINE.corners[15] + [3.0, -1.0]), "no repair is safe.*L5 lies over L4 by"),
        (spoiled(16, SPINE.corners[15]), "lie at the same height"),
        (spoiled(16, SPINE.corners[0] - [0.0, 300.0]), "T1 and T2 are then .* times as far apart"),
        (ImageCorners("a", ("T8",), SPINE.corners[:1]), "only T8; a curve needs at least two vertebrae"),
        (replace(SPINE, image="rest/lateral"), "a lateral image"),
    ],
)
def test_what_no_repair_makes_safe_is_refused(spine, words):
    refused(spine, words)


def test_a_repaired_vertebra_must_look_like_its_neighbours():
    corners = SPINE.corners.copy()
    middle = corners[4].mean(0)
    corners[4] = (middle + (corners[4] - middle) * [1.8, 0.9])[[1, 0, 3, 2]]
    refused(changed(corners), "T5 is then 1.8 times as wide as its neighbours")
    corners[4] = SPINE.corners[4][[1, 0, 3, 2]] + [[0, -20], [0, 25], [0, -20], [0, 15]]
    refused(changed(corners), "T5 is then wedged by")


def test_a_vertebra_labelled_twice_is_warned_of():
    corners = SPINE.corners.copy()
    corners[16] = corners[15] + [2.0, 1.0]
    found = in_order(changed(corners))
    assert found.repairs == ()
    assert "L5 lies over L4" in found.warnings[0] and "labelled twice" in found.warnings[0]


def test_missing_levels_are_named():
    rows = [i for i in range(2, 17) if i not in (7, 8)]
    found = in_order(ImageCorners("a", [VERTEBRAE[i] for i in rows], SPINE.corners[rows]))
    assert found.warnings == ("no corners of T8, T9; a larger angle may end there",)
