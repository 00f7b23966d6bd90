"""Profiles and supports as pictures: what they show lies where the numbers say."""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.colors import to_hex

from spinestiff.study.report.certainty_pictures import (
    HIGHEST,
    ProfileCurve,
    SupportPlace,
    draw_profiles,
    draw_support_places,
)
from spinestiff.study.report.figures import FIT, MEASURED, TRUTH, as_png

RATIO = np.geomspace(0.01, 1.0, 41)
BENT = np.column_stack([RATIO, 8.0 * np.log10(RATIO / 0.1) ** 2])


def marks(axis, marker: str, colour: str) -> list[np.ndarray]:
    return [
        line.get_xydata()
        for line in axis.lines
        if line.get_marker() == marker and to_hex(line.get_color()) == colour.lower()
    ]


def test_a_profile_shades_its_interval_from_end_to_end():
    curve = ProfileCurve("Bending", BENT, 1.92, (0.0323, 0.31), 0.1, truth=0.2)
    (axis,) = draw_profiles([curve]).axes
    (shade,) = axis.collections
    outline = shade.get_paths()[0].vertices
    assert (outline[:, 0].min(), outline[:, 0].max()) == (0.0323, 0.31)
    assert outline[:, 1].max() == pytest.approx(1.92, rel=0.03)
    assert np.allclose(marks(axis, "o", FIT), [[[0.1, 0.0]]])
    truth = marks(axis, "*", TRUTH)[0][0]
    assert truth == pytest.approx([0.2, 8.0 * np.log10(2.0) ** 2], rel=0.02)
    assert axis.get_ylim() == (0.0, HIGHEST * 1.92) and axis.get_xlabel() == "ratio to the default"
    (axis,) = draw_profiles([replace(curve, to="that of the whole")]).axes
    assert axis.get_xlabel() == "ratio to that of the whole"


@pytest.mark.parametrize("truth", [0.012, 0.9, 3.0])
def test_a_truth_far_off_is_seen_and_squeezes_no_panel(truth):
    figure = draw_profiles([ProfileCurve("Bending", BENT, 1.92, (0.0323, 0.31), 0.1, truth=truth)])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        as_png(figure)
    (axis,) = figure.axes
    low, high = axis.get_xlim()
    (mark,) = marks(axis, "*", TRUTH)
    assert low < truth < high and mark.tolist() == [[truth, HIGHEST * 1.92]]


def test_an_open_interval_is_shaded_to_the_profile_s_end():
    (axis,) = draw_profiles([ProfileCurve("Bending", BENT, 1.92, (None, 0.31), 0.1)]).axes
    assert axis.collections[0].get_paths()[0].vertices[:, 0].min() == pytest.approx(0.01)
    assert not marks(axis, "*", TRUTH)


def test_predicted_places_are_hollow_and_unseen_ones_have_no_mark():
    found = [SupportPlace(1.5, 2.0, (1.2, 0.3), False), SupportPlace(-2.5, 3.0, None, True)]
    figure = draw_support_places(["“main”, 40 N", "“main”, 60 N"], {"pelvis, degrees": found})
    (axis,) = figure.axes
    fitted, predicted = (line for line in axis.lines if line.get_marker() == "o")
    assert to_hex(fitted.get_markerfacecolor()) == FIT.lower() and predicted.get_markerfacecolor() == "white"
    assert (fitted.get_xdata()[0], predicted.get_xdata()[0]) == (1.5, -2.5)
    assert [float(one[0][0]) for one in marks(axis, "s", MEASURED)] == [1.2]
    assert [bar.get_width() for bar in axis.patches] == [4.0, 6.0]
    assert [text.get_text() for text in axis.get_yticklabels()] == ["“main”, 40 N", "“main”, 60 N"]
