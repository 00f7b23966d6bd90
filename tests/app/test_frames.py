"""``spinestiff frames``: what it prints and writes, and that roles change only when asked."""

from __future__ import annotations

import json
import re

import cv2
from matplotlib.figure import Figure

from spinestiff.app import frames
from spinestiff.files import read_json, write_json
from spinestiff.imaging.image_quality import ImageQuality
from spinestiff.study import steps
from spinestiff.study.frame_selection import FrameQuality
from spinestiff.subject.folder import read_subject
from spinestiff.subject.outcomes import FrameProposals
from spinestiff.subject.run_record import read_outcome


def test_a_proposal_for_a_subject_without_roles(spinestiff, subject, capfd):
    path = subject / "subject.json"
    chosen = path.read_text()
    content = read_json(path)
    for push in content["pushes"]:
        del push["roles"]
    write_json(path, content)
    # Nothing can be estimated before somebody has chosen.
    ran = spinestiff("run", subject)
    assert ran.status == 2
    assert "subject.json: no frame has the role training; spinestiff frames" in ran.err
    assert "proposes roles, and --write sets them" in ran.err
    ran = spinestiff("frames", subject, "--json", "--write")
    assert ran.status == 0 and "frames: drawing" in ran.err
    found = json.loads(ran.out)
    assert found == read_json(subject / "results/frames.json")["frames"]
    assert [(frame["push"], frame["frame"], frame["role"], frame["proposed"]) for frame in found] == [
        ("main", 0, "unused", "unused"),
        ("main", 1, "unused", "training"),
        ("main", 2, "unused", "training"),
        ("main", 3, "unused", "validation"),
        ("second", 0, "unused", "unused"),
        ("second", 1, "unused", "validation"),
    ]
    assert all(0.9 < frame["sharpness"] <= 1.0 and frame["vertebrae"] > 10 for frame in found)
    # The pad gives by at most 4 mm.
    assert all(frame["supports"]["shoulder"]["mm"] < 5.0 for frame in found)
    assert cv2.imread(str(subject / "results/frames.png")).shape[0] > 1000
    assert json.loads(path.read_text()) == json.loads(chosen)
    # What people see of the same.
    records = read_outcome(read_subject(subject), FrameProposals).frames
    assert [record.role for record in records] == ["unused"] * 6
    frames.show_frames(records, subject / "results/frames.png", written=False)
    shown = capfd.readouterr().out
    assert re.fullmatch(r"30 N, sharp, shoulder moved 0\.\d mm: validation, the largest force", found[3]["reason"])
    assert f"push 'main' frame 3: {found[3]['reason']}" in shown
    assert "subject.json is as it was; --write puts the proposed roles in" in shown


def test_roles_stay_without_being_asked(spinestiff, subject, monkeypatch):
    monkeypatch.setattr("spinestiff.study.report.frame_strip.draw_strip", lambda rows: Figure())
    monkeypatch.setattr(steps, "frame_qualities", lambda push, *_: [
        FrameQuality(push.id, i, force, ImageQuality(1.0, 5.0, 0.0), 14, 0.1, {})
        for i, force in enumerate(push.forces_n)
    ])  # fmt: skip
    content = read_json(subject / "subject.json")
    content["pushes"][0]["roles"] = ["unused", "validation", "training", "unused"]
    write_json(subject / "subject.json", content)
    before = (subject / "subject.json").read_text()
    ran = spinestiff("frames", subject)
    assert ran.status == 0
    assert "supports not seen: validation" in ran.out
    (log,) = (subject / "results" / "logs").iterdir()
    lines = [json.loads(line) for line in log.read_text(encoding="utf-8").splitlines()]
    assert (lines[0]["command"], lines[0]["settings"]["write"]) == ("frames", False)
    assert ("begin", "frames") in {(line.get("event"), line.get("step")) for line in lines}
    assert lines[-1]["outcome"] == "done"
    assert (subject / "subject.json").read_text() == before
