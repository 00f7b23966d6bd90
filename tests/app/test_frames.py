"""``spinestiff frames``: what it prints and writes, and that roles change only when asked."""

from __future__ import annotations

import json
import sys
from types import SimpleNamespace

import cv2
import pytest

from spinestiff.app import cli
from spinestiff.study.results import read_json, write_json


@pytest.fixture
def spinestiff(monkeypatch, capsys):
    def call(*arguments):
        monkeypatch.setattr(sys, "argv", ["spinestiff", *map(str, arguments)])
        try:
            cli.main()
            status = 0
        except SystemExit as end:
            status = end.code or 0
        out, err = capsys.readouterr()
        assert "Traceback" not in out + err
        return SimpleNamespace(status=status, out=out, err=err)

    return call


def test_a_proposal_for_a_subject_without_roles(spinestiff, subject):
    content = read_json(subject / "subject.json")
    for push in content["pushes"]:
        del push["roles"]
    write_json(subject / "subject.json", content)
    before = (subject / "subject.json").read_text()
    # Nothing can be estimated before somebody has chosen.
    ran = spinestiff("run", subject)
    assert ran.status == 2
    assert "subject.json: no frame has the role training; spinestiff frames proposes roles" in ran.err
    ran = spinestiff("frames", subject, "--json")
    assert (ran.status, ran.err) == (0, "")
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
    assert all(frame["supports"]["shoulder"]["mm"] < 0.5 for frame in found)
    assert (subject / "subject.json").read_text() == before
    strip = cv2.imread(str(subject / "results/frames.png"))
    assert strip.shape[0] > 1000
    # With --write the choice is in subject.json, and a second look finds nothing to change.
    ran = spinestiff("frames", subject, "--write")
    assert ran.status == 0
    assert "the proposed roles are in subject.json now" in ran.out
    assert "push 'main' frame 3: 30 N, sharp, shoulder moved" in ran.out
    roles = [push["roles"] for push in read_json(subject / "subject.json")["pushes"]]
    assert roles == [["unused", "training", "training", "validation"], ["unused", "validation"]]
    assert "--write" not in spinestiff("frames", subject).out
