"""Corners out of order: put right where there is one safe way, refused with the reason everywhere else."""

from __future__ import annotations

import csv
from dataclasses import replace

import numpy as np
import pytest

from spine_images import LABELLED, image, labelled_images
from spinestiff.anatomy.names import VERTEBRAE
from spinestiff.curves.corner_files import ImageCorners
from spinestiff.curves.corner_order import _squashed, in_order
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
        (lambda c: (c @ [[0.0, 1.0], [-1.0, 0.0]])[:, [3, 0, 1, 2]] + [2000.0, 0.0], "across the image"),
        (lambda c: c[:, :, ::-1], "across the image: turn it so that the head is at the top, or exchange x and y"),
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
        (
            spoiled(16, SPINE.corners[0] - [0.0, 300.0]),
            "no repair is safe.* but T1 lies .* level distances above where its neighbours foretell",
        ),
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
    refused(changed(corners), "T5 is 1.8 times as wide as its neighbours foretell")
    corners[4] = SPINE.corners[4][[1, 0, 3, 2]] + [[0, -20], [0, 25], [0, -20], [0, 15]]
    refused(changed(corners), "T5 is wedged by")


def test_a_repaired_vertebra_must_be_nearer_than_the_oddest_sound_one():
    """1.4 times as wide as foretold: let pass in order, and too odd for one whose corners were mirrored."""
    for factor, repaired in ((1.2, True), (1.4, False)):
        corners = SPINE.corners.copy()
        side = 0.5 * (factor - 1.0) * (corners[4, 1] - corners[4, 0])
        corners[4] += np.array([-side, side, side, -side])
        assert in_order(changed(corners)).warnings == ()
        mirrored = corners.copy()
        mirrored[4] = corners[4, [1, 0, 3, 2]]
        if repaired:
            assert np.array_equal(in_order(changed(mirrored)).corners, corners)
        else:
            refused(changed(mirrored), "no repair is safe.* but T5 is 1.4 times as wide as its neighbours foretell")


def test_a_vertebra_labelled_twice_is_warned_of():
    corners = SPINE.corners.copy()
    corners[16] = corners[15] + [2.0, 1.0]
    found = in_order(changed(corners))
    assert found.repairs == ()
    assert "L5 lies over L4" in found.warnings[0] and "labelled twice" in found.warnings[0]


SMALL = image([-6, -6, -3, -9, -7, -5, -2, -8, -11, -13, -19, -10, -13, -11, -12, -4, 2], width=14.0, height=10.0)


@pytest.mark.parametrize("at", [0, 2, 3, 8, 15, 16])
@pytest.mark.parametrize("aside", [-30.0, 30.0])
def test_a_vertebra_out_of_place_changes_no_sound_one(at, aside):
    """Neighbours stand across the bent line of middles; the vertebra itself is named, and nothing is turned."""
    corners = SMALL.corners.copy()
    corners[at] += [aside, 0.0]
    refused(
        replace(SMALL, corners=corners), f"^{VERTEBRAE[at]} lies .* widths beside its neighbours' line; correct its"
    )


@pytest.mark.parametrize(("factor", "warned"), [(1.0, False), (1.8, False), (2.2, True)])
def test_a_picture_that_was_squashed_is_warned_of(factor, warned):
    """Its vertebrae are 1.2 times as wide as they are apart."""
    found = in_order(changed(SPINE.corners * [factor, 1.0]))
    assert any("times as wide as they are apart" in line for line in found.warnings) == warned


@pytest.mark.skipif(not LABELLED.is_dir(), reason="the labelled scoliosis radiographs are not here")
def test_no_radiograph_is_taken_for_a_squashed_one():
    """And four of five are noticed once they are made square."""
    with (LABELLED / "images.csv").open() as file:
        sizes = [(float(row["width_px"]), float(row["height_px"])) for row in csv.DictReader(file)]
    seen = [one.corners for one in labelled_images()[0]]
    squares = [corners * 512.0 / size for corners, size in zip(seen, sizes, strict=True)]
    warned = [sum(bool(_squashed(range(17), corners)) for corners in each) for each in (seen, squares)]
    assert warned[0] == 0
    assert warned[1] > 0.75 * len(seen)


def test_a_vertebra_somewhat_out_of_place_is_warned_of():
    corners = SPINE.corners.copy()
    corners[3] += [60.0, 0.0]
    found = in_order(changed(corners))
    assert np.array_equal(found.corners, corners)
    (warning,) = found.warnings
    assert warning.startswith("T4 lies 0.50 widths beside its neighbours' line") and "look at its corners" in warning


def test_a_vertebra_that_is_turned_in_place_is_named():
    corners = SPINE.corners.copy()
    for degrees, words in ((25.0, None), (40.0, "^T9 is turned by .* degrees against its neighbours")):
        turn = np.radians(degrees)
        rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
        middle = SPINE.corners[8].mean(axis=0)
        corners[8] = middle + (SPINE.corners[8] - middle) @ rotation
        if words:
            refused(changed(corners), words)
        else:
            assert in_order(changed(corners)).warnings[0].startswith("T9 is turned by")


def test_a_vertebra_in_another_unit_is_named():
    corners = SPINE.corners.copy()
    corners[7] = 0.417 * corners[7]
    refused(changed(corners), "T8 ")
    corners = SPINE.corners.copy()
    corners[7] = corners[7].mean(axis=0) + 0.417 * (corners[7] - corners[7].mean(axis=0))
    refused(changed(corners), "^T8 is 0.42 times as wide as its neighbours foretell; correct its corners")


@pytest.mark.parametrize("pair", [(3, 4), (2, 11), (0, 16)])
def test_two_levels_exchanged_are_renamed(pair):
    corners = SPINE.corners.copy()
    corners[list(pair)] = corners[list(reversed(pair))]
    found = in_order(changed(corners))
    assert np.array_equal(found.corners, SPINE.corners) and "levels renamed" in found.repairs[0]


def test_half_a_turn_of_a_wedged_vertebra_is_refused():
    """Its corners' names, or the vertebra itself: which endplate is the upper one can't be told."""
    for wedge, repaired in ((1.5, True), (3.5, False)):
        spine = image(TILTS, wedge=wedge)
        corners = spine.corners.copy()
        corners[8] = corners[8, [2, 3, 0, 1]]
        if repaired:
            assert np.array_equal(in_order(replace(spine, corners=corners)).corners, spine.corners)
        else:
            words = "T9 may as well be turned itself, by 180 degrees, its tilt 7 degrees off"
            refused(replace(spine, corners=corners), words)


def test_a_quarter_turn_of_an_oblique_square_is_refused():
    """As wide as high and not quite rectangular: turned back it would fit in as well, and lie differently."""
    for width, oblique, repaired in ((84.0, 0.0, True), (84.0, 8.0, False), (120.0, 8.0, True)):
        spine = image(TILTS, width=width, height=80.0)
        wanted = spine.corners.copy()
        wanted[8, :2] += [oblique, 0.0]
        corners = wanted.copy()
        corners[8] = wanted[8, [1, 2, 3, 0]]
        if repaired:
            assert np.array_equal(in_order(replace(spine, corners=corners)).corners, wanted)
        else:
            refused(replace(spine, corners=corners), "T9 may as well be turned itself, by 90 degrees")


def test_corners_that_might_have_been_begun_at_either_are_refused():
    """A square vertebra turned by half a quarter: both readings are as odd."""
    corners = SPINE.corners.copy()
    middle = corners[8].mean(axis=0)
    across = SPINE.corners[7][1] - SPINE.corners[7][0] + SPINE.corners[9][1] - SPINE.corners[9][0]
    lean = np.arctan2(across[1], across[0]) + np.radians(45.0 + np.array([-135.0, -45.0, 45.0, 135.0]))
    square = middle + 60.0 * np.stack([np.cos(lean), np.sin(lean)], axis=-1)
    corners[8] = square[[1, 0, 3, 2]]
    refused(changed(corners), "T9: its corners are out of order, and which is which can't be told")


def test_missing_levels_are_named():
    rows = [i for i in range(2, 17) if i not in (7, 8)]
    found = in_order(ImageCorners("a", [VERTEBRAE[i] for i in rows], SPINE.corners[rows]))
    assert found.warnings == ("no corners of T8, T9; a larger angle may end there",)
