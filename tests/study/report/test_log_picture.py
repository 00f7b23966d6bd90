"""A log beside its frames: what is drawn lies where the numbers say."""

from __future__ import annotations

import numpy as np
from matplotlib.colors import to_hex

from spinestiff.study.report.figures import FIT, as_png
from spinestiff.study.report.log_picture import draw_log
from spinestiff.subject.intake.force_log import ForceLog
from spinestiff.subject.intake.log_match import LogMatch, given_offset

LOG = ForceLog(np.arange(0.0, 10.0, 0.1), np.clip(20.0 * (np.arange(0.0, 10.0, 0.1) - 3.0), 0.0, 60.0))
TIMES = np.arange(8) / 2.0
MOTION = np.linspace(0.0, 9.0, 8)


def test_frames_lie_on_the_log_and_their_motion_below_them():
    match = given_offset(LOG, TIMES, 3.2, MOTION)
    force, moved = draw_log("push left-5", LOG, match, TIMES, MOTION).axes
    np.testing.assert_allclose(force.lines[0].get_xydata(), np.column_stack([LOG.times_s, LOG.forces_n]))
    (points,) = [line for line in force.lines if line.get_marker() == "o" and to_hex(line.get_color()) == FIT.lower()]
    np.testing.assert_allclose(points.get_xydata(), np.column_stack([TIMES + 3.2, LOG.at(TIMES + 3.2)]))
    (motion,) = [line for line in moved.lines if line.get_marker() == "o"]
    np.testing.assert_allclose(motion.get_xydata(), np.column_stack([TIMES + 3.2, MOTION]))
    assert [text.get_text() for text in moved.texts] == [str(i) for i in range(8)]
    assert force.get_xlim() == moved.get_xlim()


def test_without_an_offset_no_force_is_drawn_and_each_has_its_own_time():
    nothing = np.full(8, np.nan)
    match = LogMatch(np.nan, 0.0, 9.9, False, "the picture moves by 0.10 pixels only", 0.0, nothing, nothing, nothing)
    figure = draw_log("push left-5", LOG, match, TIMES, MOTION)
    force, moved = figure.axes
    assert len(force.lines) == 1
    (motion,) = moved.lines
    np.testing.assert_allclose(motion.get_xydata(), np.column_stack([TIMES, MOTION]))
    assert "not determined" in figure.get_suptitle()
    assert as_png(figure)[:4] == b"\x89PNG"
