"""A frame has one number, counted from 0: in subject.json, annotation.json, pictures, the page and what is written."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

from spinestiff.annotate.pictures import frame_of
from spinestiff.annotate.server import session_record
from spinestiff.imaging.features import VertebraCorners
from spinestiff.imaging.image_quality import ImageQuality
from spinestiff.study.frame_selection import FrameQuality, Proposal
from spinestiff.study.report.frame_content import _frame_title
from spinestiff.study.report.frame_strip import Row, draw_strip
from unannotated import drawn


def test_the_files_and_the_page_number_frames_alike(session):
    subject = session.subject
    push = subject.push("a")
    frames = session.radiographs.frames("push/a")
    assert [frame.frame for frame in frames] == [0, 1, 2]
    assert [push.frame_image(i) for i in range(3)] == ["push/a", "push/a/1", "push/a/2"]
    (shown,) = [image for image in session_record(session)["images"] if image["name"] == "push/a"]
    assert shown["forces"][2] == push.forces_n[2] == 40.0
    np.testing.assert_array_equal(frame_of(session, "push/a", 2).pixels, frames[2].pixels)
    # The picture of number 2 is that with the bend of number 2.
    difference = [np.abs(frames[2].pixels - 20000.0 * drawn(f"push/a/{i}").pixels).mean() for i in range(3)]
    assert int(np.argmin(difference)) == 2


def test_the_strip_and_the_report_number_frames_alike(session):
    push = session.subject.push("a")
    corners = VertebraCorners(("T5",), session.radiographs.view("push/a").from_pixels(drawn("push/a").quads[4:5]))
    tracked = SimpleNamespace(corners=lambda index: corners)
    quality = [
        FrameQuality("a", i, force, ImageQuality(1.0, 5.0, 0.0), 1, 0.1, {}) for i, force in enumerate(push.forces_n)
    ]
    row = Row(push, session.radiographs.frames("push/a"), tracked, [Proposal(found, "unused", "") for found in quality])
    titles = [axis.get_title(loc="left") for axis in draw_strip([row]).axes]
    assert ["frame 0, 0 N" in titles[0], "frame 2, 40 N" in titles[2]] == [True, True]
    assert _frame_title(SimpleNamespace(push="a", frame=2, force_n=40.0)) == "“a”, frame 2, 40 N"
