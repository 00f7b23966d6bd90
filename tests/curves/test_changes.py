"""What the corners' errors make of a change of the Cobb angle, against draws of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from spinestiff.curves.changes import change_between, change_words, forms_in_words, signed_levels, tracked_noise
from spinestiff.curves.cobb import TRACKED_TURN
from spinestiff.curves.tilts import Forms, tilts
from spinestiff.imaging.features import VertebraCorners
from spinestiff.imaging.projection import frontal_view
from spinestiff.imaging.tracking.quality import quality_of

NAMES = tuple(f"T{i}" for i in range(3, 13))
VIEW = frontal_view()
ERROR_MM = 0.4
DRAWS = 600


def corners(tilts, error=ERROR_MM):
    """Vertebrae 40 mm wide and 20 high on the detector, one below the other, each turned; as good as ``error``."""
    turns = np.radians(tilts)
    box = np.array([[20.0, 10.0], [-20.0, 10.0], [-20.0, -10.0], [20.0, -10.0]])
    points = []
    for i, turn in enumerate(turns):
        along = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
        points.append(box @ along + [0.0, -30.0 * i])
    # To the patient's left and up, as columns and rows of this view.
    seen = np.array(points) * [1.0, -1.0]
    return VertebraCorners(NAMES, seen, np.full((len(NAMES), 4), float(quality_of(np.array(error)))))


REST = corners([4.0, 8.0, 10.0, 6.0, 0.0, -6.0, -10.0, -8.0, -4.0, 0.0])
PUSHED = corners([2.0, 4.0, 5.0, 3.0, 0.0, -3.0, -5.0, -4.0, -2.0, 0.0])


def turned(points, angles):
    """Each vertebra by its angle, rad, about its middle."""
    middles = points.mean(axis=1, keepdims=True)
    out = points - middles
    a = angles[:, None]
    across, down = np.cos(a) * out[..., 0] - np.sin(a) * out[..., 1], np.sin(a) * out[..., 0] + np.cos(a) * out[..., 1]
    return middles + np.stack([across, down], axis=-1)


@pytest.mark.parametrize("same_origin", [True, False])
def test_standard_deviations_are_those_of_draws(same_origin):
    """Between levels that stay: annotation drops out of a change where both pictures come from one of them."""
    random = np.random.default_rng(5)
    change = change_between(VIEW, REST, PUSHED, same_origin=same_origin)
    tracking = float(tracked_noise(REST.quality)[0, 0]) * VIEW.magnification
    assert tracking / VIEW.magnification == pytest.approx(ERROR_MM / np.sqrt(2.0), rel=1e-6)
    found = []
    for _ in range(DRAWS):
        marked = [random.normal(0.0, 0.02 * 40.0, REST.corners.shape) for _ in range(2)]
        pictures = [
            replace(one, corners=one.corners + mark + random.normal(0.0, tracking, mark.shape))
            for one, mark in zip((REST, PUSHED), (marked[0], marked[0] if same_origin else marked[1]))
        ]
        names = (change.levels, change.levels)
        drawn = [picture.selected(names[0]) for picture in pictures]
        found.append(change_between(VIEW, *drawn).fixed_levels)
    assert np.std(found) == pytest.approx(change.sds[1], rel=0.12)
    assert np.mean(found) == pytest.approx(change.fixed_levels, abs=0.3)


def test_a_change_of_levels_keeps_the_annotation_and_is_less_certain():
    other = corners([-8.0, -4.0, 0.0, 4.0, 8.0, 4.0, 0.0, -4.0, -8.0, -9.0])
    change = change_between(VIEW, REST, other)
    assert (change.rest.upper, change.rest.lower) != (change.pushed.upper, change.pushed.lower)
    assert change.sds[0] > 1.5 * change.sds[1]
    same = change_between(VIEW, REST, PUSHED)
    assert same.sds[0] == pytest.approx(same.sds[1])
    assert signed_levels(same) == "T5–T9" and " to " in signed_levels(change)


def test_worse_corners_and_the_other_definition_count():
    worse = replace(PUSHED, quality=np.full_like(PUSHED.quality, float(quality_of(np.array(4.0 * ERROR_MM)))))
    assert change_between(VIEW, REST, worse).sds[1] > 2.0 * change_between(VIEW, REST, PUSHED).sds[1]
    # A mid-line is between the middles of two pairs, which tracking turns with their vertebra.
    midline = change_between(VIEW, REST, PUSHED, "midline")
    by_corners = change_between(VIEW, REST, PUSHED).sds[1] / np.sqrt(2.0)
    assert midline.sds[1] == pytest.approx(TRACKED_TURN * by_corners, rel=0.01)


def test_a_given_noise_is_that_of_the_annotation():
    """Annotated twice, so that nothing of it drops out; the default is 2 % of 40 mm on the detector."""
    usual, doubled = (
        np.array(change_between(VIEW, REST, PUSHED, same_origin=False, noise=noise).sds)
        for noise in (None, 2.0 * 0.02 * 40.0 / VIEW.magnification)
    )
    tracking = np.array(change_between(VIEW, REST, PUSHED).sds)
    assert doubled**2 - tracking**2 == pytest.approx(4.0 * (usual**2 - tracking**2), rel=1e-6)


def test_a_vertebra_that_ends_one_curve_and_begins_the_other_errs_in_both():
    """T8 ends the largest curve at rest and begins that under the push: by mid-lines its annotation counts twice.

    Tracking turns each vertebra as one body.
    """
    rest = corners([0.0, 6.0, 12.0, 4.0, -4.0, -12.0, -8.0, -4.0, 0.0, 2.0])
    pushed = corners([0.0, 2.0, 4.0, 0.0, -4.0, -8.0, -2.0, 4.0, 9.0, 6.0])
    change = change_between(VIEW, rest, pushed, "midline")
    assert signed_levels(change) == "T5–T8 to T8–T11"
    random, found = np.random.default_rng(7), []
    turn = TRACKED_TURN * float(tracked_noise(rest.quality)[0, 0]) * VIEW.magnification / 40.0
    for _ in range(DRAWS):
        mark = random.normal(0.0, 0.02 * 40.0, rest.corners.shape)
        drawn = [turned(one.corners + mark, random.normal(0.0, turn, len(NAMES))) for one in (rest, pushed)]
        before, after = (tilts(NAMES, each, VIEW, "midline") for each in drawn)
        found.append(after.cobb_degrees("T8", "T11") - before.cobb_degrees("T5", "T8"))
    assert np.std(found) == pytest.approx(change.sds[0], rel=0.06)


def test_a_picture_has_not_changed_since_itself():
    assert change_between(VIEW, PUSHED, PUSHED).sds == (0.0, 0.0, 0.0)
    assert min(change_between(VIEW, PUSHED, replace(PUSHED)).sds) > 0.0


def test_words_have_sign_error_and_levels():
    assert change_words(-10.44, 0.6, "T6–T11") == "−10.4° ± 1.2° (T6–T11)"
    assert change_words(0.04, None, "T6–T11") == "0.0° (T6–T11)"
    assert change_words(2.0, None, "T6–T11") == "+2.0° (T6–T11)"
    change = change_between(VIEW, REST, PUSHED)
    forms = forms_in_words(change)
    assert list(forms) == ["signed", "fixed_levels", "tilt"]
    assert forms["fixed_levels"] == f"−10.0° ± {1.96 * change.sds[1]:.1f}° (T5–T9)"
    assert "±" not in forms_in_words(replace(change, sds=Forms()))["tilt"]


def test_one_vertebra_in_common_is_no_change():
    assert change_between(VIEW, REST.selected(("T3", "T4")), PUSHED.selected(("T4", "T5"))) is None
