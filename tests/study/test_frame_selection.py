"""The proposal of training and validation frames, its reasons, and roles put into subject.json."""

from __future__ import annotations

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest

from spinestiff.errors import SubjectError
from spinestiff.imaging.image_quality import ImageQuality
from spinestiff.imaging.projection import frontal_view
from spinestiff.imaging.radiograph import Radiograph
from spinestiff.study import frame_selection
from spinestiff.study.frame_selection import FrameQuality, Motion, propose
from spinestiff.subject.records import SubjectRecord, read_record
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
        ({"dropped": "frame 3: the pelvis moved by 4.1 mm (limit 3.0 mm); the frame is dropped"},
         "unused, the pelvis moved by 4.1 mm (limit 3.0 mm)"),
        ({"image": ImageQuality(0.5, 5.0, 0.0)}, "blurred (sharpness 0.50 of the sharpest frame's)"),
        ({"image": ImageQuality(float("nan"), 0.0, 0.0)}, "blurred"),
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
    # Nothing usable: nothing proposed.
    bad = replace(low[1], dropped="frame 1: the pelvis moved by 9.0 mm; the frame is dropped")
    assert roles([low[0], bad]) == [["unused", "unused"]]


def test_supports_in_words():
    unseen = frames("a", 60.0, f0={"supports": {}})
    one = frames("a", 60.0, f0={"supports": {"pelvis": Motion(1.23, 0.4)}, "image": ImageQuality(1.0, 0.5, 0.0)})
    assert reasons(unseen)[0][0].startswith("60 N, sharp, supports not seen: ")
    assert reasons(one)[0][0].startswith("60 N, sharp, noisy, pelvis moved 1.2 mm: ")


def test_a_support_that_turns_and_one_that_slides(monkeypatch):
    """Points moved by hand in a real picture: mean motion, turn in degrees, and a shoulder's slide not counted."""
    view = frontal_view(sid=1500.0, source_to_patient=1340.0, shape=(600, 500), pixel=(0.8, 0.8))
    random = np.random.default_rng(3)
    rows = np.arange(600)[:, None]
    image = np.float32(50.0) * cv2.GaussianBlur(random.normal(0.0, 1.0, (600, 500)).astype(np.float32), (0, 0), 5.0)
    turn = cv2.getRotationMatrix2D((250.0, 450.0), -1.5, 1.0)  # clockwise as seen
    turned = cv2.warpAffine(image, turn, (500, 600), borderMode=cv2.BORDER_REFLECT)
    slid = np.roll(image, 4, axis=0)
    second = np.where(rows > 250, turned, slid).astype(np.float32)
    points = {"pelvis": np.array([[130.0, 450.0], [370.0, 450.0]]), "shoulder": np.array([[250.0, 100.0]])}
    pictures = [Radiograph(pixels, view) for pixels in (image, second)]
    _, moved = frame_selection._motions(pictures, points)
    assert moved["pelvis"].degrees == pytest.approx(1.5, abs=0.1)
    assert moved["pelvis"].mm < 0.2
    assert moved["shoulder"].mm < 0.2  # it slid by 4 pixels along the wall
    assert moved["shoulder"].degrees is None


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
