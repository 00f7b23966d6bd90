"""The paper's Figures 2, 4 and 5 for the study."""

from __future__ import annotations

import numpy as np
import pytest

from spinestiff.anatomy.template import template_torso
from spinestiff.imaging.projection import frontal_view
from spinestiff.imaging.synthetic.rendering import coarser
from spinestiff.study.report.figures import as_png
from spinestiff.study.report.seven_page import SHADOW_STEP, bone_shadow
from spinestiff.study.report.seven_pictures import MARGIN_MM, NARROWEST_MM, Shot, draw_models, draw_sequence


def shot(title="45 N", simulated=True, down=200.0):
    pixels = np.random.default_rng(0).normal(100.0, 10.0, (400, 300))
    box = np.array([[140.0, 100.0], [160.0, 100.0], [160.0, 115.0], [140.0, 115.0]])
    measured = np.stack([box, box + [0.0, down]])
    bones = np.zeros((100, 75))
    bones[20:80, 30:45] = 1.0
    return Shot(
        title, pixels, (0.5, 0.5), measured, measured + 4.0 if simulated else None, bones if simulated else None
    )


def test_a_sequence_shows_every_corner_of_every_frame():
    figure = draw_sequence([shot("0 N", False), shot("45 N", False)])
    assert [axis.get_title() for axis in figure.axes] == ["0 N", "45 N"]
    for axis in figure.axes:
        np.testing.assert_allclose(np.array(axis.lines[0].get_data()).T, 0.5 * shot().measured.reshape(-1, 2))
        # As wide as a chest at least, and the spine with a margin; rows grow downwards.
        assert np.ptp(axis.get_xlim()) == pytest.approx(NARROWEST_MM)
        assert axis.get_ylim() == pytest.approx((0.5 * 315.0 + MARGIN_MM, 0.5 * 100.0 - MARGIN_MM))


def test_a_row_a_subject_has_pictures_and_corners_at_one_scale():
    rows = [("# 1", [shot("initial"), shot("default"), shot("optimized")]), ("# 2", [shot("initial"), shot("default")])]
    figure = draw_models(rows)
    assert len(figure.axes) == 12
    over, beside = figure.axes[0], figure.axes[1]
    assert over.get_ylim() == beside.get_ylim() and over.get_xlim() == beside.get_xlim()
    assert len(over.images) == 2
    np.testing.assert_allclose(np.array(beside.lines[1].get_data()).T, 0.5 * (shot().measured + 4.0).reshape(-1, 2))
    assert not figure.axes[10].axison  # no third picture of the second subject
    assert as_png(figure) == as_png(draw_models(rows))


def test_without_a_model_only_corners_are_drawn():
    figure = draw_models([("# 1", [shot(simulated=False)])])
    assert len(figure.axes[0].images) == 1 and len(figure.axes[1].lines) == 1


def test_the_bones_shadow_falls_where_they_are():
    torso = template_torso(157.0)
    spine = torso.rest_pose.bone_positions[torso.vertebra_bones]
    view = frontal_view(shape=(512, 512), pixel=0.9, centre=(0.0, float(spine[:, 1].mean()), 0.0))
    shadow = bone_shadow(torso, torso.rest_pose, view)
    assert shadow.shape == (512 // SHADOW_STEP, 512 // SHADOW_STEP)
    assert 0.0 == shadow.min() < shadow.max() == 1.0
    column, row = np.rint(coarser(view, SHADOW_STEP).pixels(view.project(spine[8:9]))[0]).astype(int)
    assert shadow[row, column] > 0.5
    assert shadow[row, :10].max() == 0.0  # beside the ribs
