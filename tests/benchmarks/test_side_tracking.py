"""benchmarks/side_tracking.py: marks are taken away once, and followed corners are held against them in mm."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from programs import benchmark
from spinestiff.files import read_json, write_json
from spinestiff.imaging.projection import lateral_view
from spinestiff.subject.outcome_parts import ViewRecord
from spinestiff.subject.outcomes import SidePicture, SideView

benchmark("kept_rows")
side = benchmark("side_tracking")
NAMES = ("T7", "T8", "T9", "T10")


def test_marks_under_force_are_taken_away_once(tmp_path):
    marked = {"vertebrae": {"T8": [[1, 2], [3, 2], [3, 4], [1, 4]]}}
    names = ("rest/lateral", "push/main", "push/main/0/lateral", "push/main/2/lateral", "push/main/2")
    write_json(tmp_path / "annotation.json", {"images": dict.fromkeys(names, marked)})
    for _ in range(2):
        assert side.without_marks(tmp_path) == {"push/main/2/lateral": marked["vertebrae"]}
        left = read_json(tmp_path / "annotation.json")["images"]
        assert set(left) == set(names) - {"push/main/2/lateral"}


def test_marks_that_a_stopped_program_kept_only_are_taken_away(tmp_path):
    marked = {"vertebrae": {"T8": [[1, 2], [3, 2], [3, 4], [1, 4]]}}
    name = "push/main/2/lateral"
    write_json(tmp_path / "annotation.json", {"images": {name: marked}})
    write_json(tmp_path / "marks-taken-away.json", {name: marked["vertebrae"]})
    assert side.without_marks(tmp_path) == {name: marked["vertebrae"]}
    assert read_json(tmp_path / "annotation.json")["images"] == {}


def test_a_subject_without_all_its_frames_is_refused_and_not_left_out(tmp_path, monkeypatch):
    """Of two subjects one would be summed up alone otherwise."""
    folder, push = tmp_path / "seed-1", SimpleNamespace(id="main")
    subject = SimpleNamespace(record=SimpleNamespace(pushes=[push]))
    monkeypatch.setattr(side, "truth_path", lambda _: tmp_path)
    monkeypatch.setattr(side, "synthesise", lambda *_: None)
    monkeypatch.setattr(side, "open_visit", lambda _: SimpleNamespace(subject=subject))
    monkeypatch.setattr(side, "run_steps", lambda *_: None)
    tracked = SimpleNamespace(pushes={"main": SimpleNamespace(sides=[None])})
    monkeypatch.setattr(side, "read_outcome", lambda *_: tracked)
    for marks, rows, told in (({"a": {}, "b": {}}, 1, "1 frames were followed, wanted the 2"), ({}, 0, "0 frames")):
        monkeypatch.setattr(side, "without_marks", lambda _, marks=marks: marks)
        monkeypatch.setattr(side, "of_push", lambda *_, rows=rows: iter([{"force_n": 10.0}] * rows))
        with pytest.raises(SystemExit, match=rf"seed-1: {told}"):
            side.of_subject(folder, 1)
    with pytest.raises(SystemExit, match="--subjects 0: wanted 1 or more"):
        side.measured(tmp_path / "none", 0)


def picture(frame, corners, quality=None):
    told = {"frame": frame, "vertebrae": NAMES, "corners_px": corners.tolist()}
    if quality is not None:
        told |= {"quality": quality, "followed_from": 0}
    return SidePicture.model_validate(told)


def test_errors_and_motion_are_mm_at_the_patient_plane_and_lost_vertebrae_no_error():
    sight = lateral_view()
    px_mm = float(sight.pixel_spacing[0]) / sight.magnification
    box = np.array([[0.0, 0.0], [40.0, 0.0], [40.0, 30.0], [0.0, 30.0]])
    at_rest = np.array([box + [400.0, 300.0 + 50.0 * row] for row in range(4)])
    found = at_rest + [10.0, 0.0]
    found[3] += 500.0  # lost
    one = picture(2, found, [[0.9] * 4] * 3 + [[0.0] * 4])
    view = SideView(id="lateral", view=ViewRecord.of(sight), pictures=(picture(0, at_rest), one))
    by_hand = dict(zip(NAMES, (at_rest + [8.0, 0.0]).tolist()))
    told = side.of_frame(view, one, view.pictures[0], by_hand)
    assert (told["vertebrae"], told["kept"]) == (4, 3)
    assert told["error_mm"] == pytest.approx(2.0 * px_mm / np.sqrt(2.0))
    assert told["moved_mm"] == pytest.approx(np.sqrt((8.0 * px_mm) ** 2 / 2.0 - 2.0 * 0.3**2))


def test_frames_are_summed_up_by_force():
    frames = [
        {"force_n": 10.0, "vertebrae": 15, "kept": 15, "error_mm": 0.4, "moved_mm": 0.1},
        {"force_n": 60.0, "vertebrae": 15, "kept": 2, "error_mm": None, "moved_mm": 1.2},
    ]
    told = side.summarised([{"frames": frames}])
    assert told["error_mm"] == [0.4, 0.4] and told["moved_mm"] == [0.1, 1.2]
    assert (told["kept_up_to_20_n"], told["kept_at_largest_force"]) == ([15, 15], [2, 2])


def test_the_page_has_the_stored_figures():
    page = " ".join((Path(__file__).parents[2] / "docs" / "more-views.md").read_text(encoding="utf-8").split())
    stored = json.loads(side.RESULTS.read_text(encoding="utf-8"))
    *usual, worst = sorted(row["error_mm"] for one in stored["subjects"] for row in one["frames"])
    assert f"lay {usual[0]:.1f} to {usual[-1]:.1f} mm along an axis" in page
    assert f"{worst:.1f} mm in one of nine" in page
    moved, kept = stored["moved_mm"], stored["kept_at_largest_force"]
    assert f"moved by {moved[0]:.1f} to {moved[1]:.1f} mm" in page and f"at 60 N {kept[0]} and {kept[1]}" in page
