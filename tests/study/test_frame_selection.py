"""The proposal of training and validation frames, its reasons, and roles put into subject.json."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from results import tracked_push
from spinestiff.errors import SubjectError
from spinestiff.imaging.features import VertebraCorners
from spinestiff.imaging.image_quality import ImageQuality
from spinestiff.imaging.projection import frontal_view
from spinestiff.study import frame_selection
from spinestiff.study.frame_selection import FrameQuality, Motion, propose
from spinestiff.subject.outcomes import TrackedFrame
from spinestiff.subject.record_reading import read_record
from spinestiff.subject.records import PushRecord, SubjectRecord
from spinestiff.subject.roles import write_roles

GOOD = ImageQuality(1.0, 5.0, 0.0)


def frames(push, *forces, **others):
    """Good frames of a push; ``others``: f3=dict(...) changes frame 3."""
    return [
        FrameQuality(push, i, force, **{
            "image": GOOD, "vertebrae": 14, "tracking_mm": 0.1,
            "supports": {"pelvis": Motion(0.8, 0.1), "shoulder": Motion(0.3, None)},
            **others.get(f"f{i}", {}),
        })
        for i, force in enumerate(forces)
    ]  # fmt: skip


def roles(*pushes):
    return [[proposal.role for proposal in found] for found in propose(pushes)]


def reasons(*pushes):
    return [[proposal.reason for proposal in found] for found in propose(pushes)]


def test_the_paper_s_three_frames():
    assert roles(frames("a", 0.0, 20.0, 40.0, 60.0)) == [["unused", "training", "training", "validation"]]
    (said,) = reasons(frames("a", 0.0, 30.0, 45.0, 60.0))
    assert said[3] == "60 N, sharp, supports moved 0.8 mm: validation, the largest force"
    assert said[1] == "30 N, sharp, supports moved 0.8 mm: training, nearest to half of the largest force"
    assert said[0].endswith("unused, no force; it shows how the patient stood")


def test_more_frames_than_needed_and_equal_forces():
    worse = {"f2": {"image": ImageQuality(0.8, 5.0, 0.0)}}
    found = roles(frames("a", 0.0, 5.0, 30.0, 30.5, 40.0, 50.0, 60.0, **worse))
    assert found == [["unused", "unused", "unused", "training", "unused", "training", "validation"]]
    (said,) = reasons(frames("a", 0.0, 5.0, 30.0, 30.5, 40.0, 50.0, 60.0, **worse))
    assert "too small a force" in said[1]
    assert "slightly blurred" in said[2]
    assert "another frame under about the same force is better" in said[2]
    assert "two training frames a push are enough" in said[4]


@pytest.mark.parametrize(
    ("bad", "why"),
    [
        ({"image": ImageQuality(0.5, 5.0, 0.0)}, "blurred (sharpness 0.50 of the sharpest frame's)"),
        ({"image": ImageQuality(float("nan"), 0.0, 0.0)}, "no vertebra's edges rise above the noise"),
        ({"image": ImageQuality(1.0, 5.0, 0.2)}, "20 % of the vertebrae have no grey values of their own"),
        ({"vertebrae": 2}, "2 vertebrae could be followed"),
        ({"vertebrae": 0}, "no vertebrae could be followed"),
        ({"tracking_mm": 1.3}, "followed unsurely (by about 1.3 mm)"),
    ],
)  # fmt: skip
def test_unfit_frames_are_never_proposed(bad, why):
    found = frames("a", 0.0, 20.0, 40.0, 60.0, f3=bad)
    assert roles(found) == [["unused", "training", "validation", "unused"]]
    assert why in reasons(found)[0][3]


def test_both_sides_and_several_sites():
    left, right, low = (
        frames("left-8", 0.0, 20.0, 40.0, 60.0),
        frames("right-9", 0.0, 25.0, 50.0),
        frames("l", 0.0, 30.0),
    )
    assert roles(left, right, low) == [
        ["unused", "training", "training", "validation"],
        ["unused", "training", "validation"],
        ["unused", "validation"],
    ]
    # Without a push that has two forces, one frame has to train.
    assert roles(low, frames("r", 30.0)) == [["unused", "training"], ["validation"]]
    assert "none is left to check with" in reasons(frames("r", 30.0))[0][0]
    (_, said), (other,) = reasons(low, frames("r", 30.0))
    assert said.endswith("no push has frames under two forces; this one trains, another push's checks")
    assert "left to check with" not in said + other
    # Nothing usable: nothing proposed.
    bad = replace(low[1], vertebrae=0)
    assert roles([low[0], bad]) == [["unused", "unused"]]


def test_supports_in_words():
    unseen = frames("a", 60.0, f0={"supports": {}})
    one = frames("a", 60.0, f0={"supports": {"pelvis": Motion(1.23, 0.4)}, "image": ImageQuality(1.0, 0.5, 0.0)})
    assert reasons(unseen)[0][0].startswith("60 N, sharp, supports not seen: ")
    assert reasons(one)[0][0].startswith("60 N, sharp, noisy, pelvis moved 1.2 mm: ")


def test_supports_that_moved_are_shown_and_exclude_nothing():
    far = {"supports": {"pelvis": Motion(9.0, 6.5), "shoulder": Motion(12.0, None)}}
    assert roles(frames("a", 0.0, 20.0, 40.0, 60.0, f2=far, f3=far)) == [
        ["unused", "training", "training", "validation"]
    ]
    # Nor do they decide between two pictures under one force: the sharper one counts.
    sharper = {"f1": far, "f2": {"image": ImageQuality(0.95, 5.0, 0.0)}}
    assert roles(frames("a", 0.0, 40.0, 40.0, 60.0, **sharper)) == [["unused", "training", "unused", "validation"]]


def test_what_is_said_of_supports_is_what_was_tracked(monkeypatch):
    """From the tracked frame: nothing is followed a second time."""
    seen = {"support_motion_mm": {"pelvis": 1.25, "shoulder": 0.5}, "obliquity_deg": {"value": -2.5, "sd": 0.25}}
    corners = VertebraCorners(("T8",), np.full((1, 4, 2), 10.0), np.full((1, 4), 0.5))
    tracked = tracked_push(frontal_view(), [0.0, 20.0], [corners, corners])
    moved = TrackedFrame.model_validate({**tracked.frames[1].model_dump(), **seen})
    tracked = tracked.model_copy(update={"frames": (tracked.frames[0], moved)})
    monkeypatch.setattr(frame_selection, "image_quality", lambda pictures, found: [GOOD] * len(found))
    record = PushRecord.model_validate(
        {"id": "a", "side": "right", "level": 8, "d21_mm": 400, "d31_mm": 200, "frames": "a.dcm", "forces_n": [0, 20]}
    )
    first, second = frame_selection.frame_qualities(record, [None, None], tracked)
    assert first.supports == {}
    assert second.supports == {"pelvis": Motion(1.25, -2.5), "shoulder": Motion(0.5, None)}


TEXT = """{
  "schema_version": 1, "id": "03",   "age": 12.5, "sex": "female",
\t"height_cm": 152,
  "pushes": [
    {"roles": ["training", "validation", "unused"], "id": "a", "side": "right", "level": 8.5, "d21_mm": 395,
     "d31_mm": 220, "frames": "pushes/a [roles].dcm", "forces_n": [20.50, 4e1, 60]},
    {"id": "b", "side": "left", "level": 9, "d21_mm": 395, "d31_mm": 220,
     "frames": "pushes/b.dcm", "forces_n": [ 0,
        30 ] }
  ],  "xray": {"source_detector_mm": 1500}
}
"""


def test_only_roles_change_in_the_file(tmp_path):
    path = tmp_path / "subject.json"
    path.write_text(TEXT)
    before = read_record(path, SubjectRecord)
    assert before.pushes[1].roles == ("unused", "unused")
    write_roles(tmp_path, {"a": ["unused", "training", "validation"], "b": ["unused", "validation"]})
    expected = TEXT.replace('["training", "validation", "unused"]', '["unused", "training", "validation"]')
    expected = expected.replace("30 ] }", '30 ], "roles": ["unused", "validation"] }')
    assert path.read_text() == expected
    after = read_record(path, SubjectRecord)
    assert after.pushes[0].roles == ("unused", "training", "validation")
    assert json.loads(TEXT)["xray"] == json.loads(path.read_text())["xray"]
    assert [p.name for p in tmp_path.iterdir()] == ["subject.json"]


@pytest.mark.parametrize(
    ("chosen", "why"),
    [
        ({"c": ["training"]}, "no push 'c'; there are a, b"),
        ({"a": ["training"]}, "3 forces_n and 1 roles"),
        ({"a": ["unused", "unused", "validation"]}, "no frame has the role training"),
    ],
)
def test_impossible_roles_leave_the_file_as_it_was(tmp_path, chosen, why):
    path = tmp_path / "subject.json"
    path.write_text(TEXT)
    with pytest.raises(SubjectError, match=why):
        write_roles(tmp_path, chosen)
    assert path.read_text() == TEXT
