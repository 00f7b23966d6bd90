"""Tracking behind the page: from what is annotated, in the background, and what an earlier run has left."""

from __future__ import annotations

import json
import threading
import time

import numpy as np
import pytest

from asking import wait_for
from spinestiff.anatomy.names import VERTEBRAE
from spinestiff.annotate import following
from spinestiff.annotate.draft import Draft, DraftImage
from spinestiff.annotate.following import Follower, Following, following_record
from spinestiff.errors import SubjectError, TrackingError
from spinestiff.study.runner import run_steps
from spinestiff.study.visit import open_visit
from unannotated import drawn

PUSH = "push/a"


def marked(image, *levels):
    return DraftImage.model_validate_json(json.dumps({"vertebrae": drawn(image).named(*levels)}))


@pytest.fixture
def annotated(session):
    images = {name: marked(name) for name in ("rest/frontal", "rest/lateral", PUSH)}
    session.save(Draft(schema_version=1, images=images), session.revision)
    return session


def ended(follower, seconds=60.0):
    wait_for(lambda: follower.state(PUSH).state != "running", seconds)
    return follower.state(PUSH)


def stand_in(monkeypatch, act):
    monkeypatch.setattr(following, "track", act)


def test_an_earlier_run_is_shown_until_its_input_changes(annotated):
    run_steps(open_visit(annotated.subject.folder), ("track",))
    found = Follower(annotated).state(PUSH)
    assert (found.state, found.done, found.total) == ("done", 3, 3)
    record = following_record(annotated, PUSH, found)
    stored = json.loads((annotated.subject.results / "tracked.json").read_text(encoding="utf-8"))
    for frame, kept in zip(record["frames"], stored["pushes"]["a"]["frames"], strict=True):
        np.testing.assert_allclose(list(frame["vertebrae"].values()), kept["corners_px"], atol=0.006)
    annotated.save(
        Draft(schema_version=1, images={**annotated.marks, PUSH: marked(PUSH, *VERTEBRAE[1:])}), annotated.revision
    )
    assert Follower(annotated).state(PUSH).state == "none"


def test_what_a_later_run_finds_is_shown(annotated):
    follower = Follower(annotated)
    assert follower.state(PUSH) == Following()
    run_steps(open_visit(annotated.subject.folder), ("track",))
    assert follower.state(PUSH).state == "done"


def test_a_damaged_run_is_shown_as_none(annotated):
    """Not an error: the page offers to track."""
    run_steps(open_visit(annotated.subject.folder), ("track",))
    path, record = annotated.subject.results / "tracked.json", annotated.subject.results / "run.json"
    text, told = path.read_text(encoding="utf-8"), record.read_text(encoding="utf-8")
    broken = ("{}", "null", "[]", "", "half", "a digit")
    changed = {
        text[: len(text) // 2],
        text.replace("1", "2", 1),
        text.replace('"schema_version": 3', '"schema_version": 99'),
    }
    assert text not in changed
    for damage in (*broken, *changed):
        path.write_text(damage, encoding="utf-8")
        assert Follower(annotated).state(PUSH) == Following(), damage[:90]
        path.write_text(text, encoding="utf-8")
        assert Follower(annotated).state(PUSH).state == "done"
    for damage in broken:
        record.write_text(damage, encoding="utf-8")
        assert Follower(annotated).state(PUSH) == Following(), damage
        record.write_text(told, encoding="utf-8")
        assert Follower(annotated).state(PUSH).state == "done"


def test_every_annotated_frame_is_a_start(annotated, monkeypatch):
    images = {**annotated.marks, f"{PUSH}/2": marked(f"{PUSH}/2", "T9")}
    annotated.save(Draft(schema_version=1, images=images), annotated.revision)
    asked = []
    stand_in(monkeypatch, lambda frames, starts, observer: asked.append((len(frames), dict(starts))) or ())
    follower = Follower(annotated)
    follower.start(PUSH)
    assert ended(follower).state == "done"
    ((count, starts),) = asked
    assert count == 3 and sorted(starts) == [0, 2]
    assert starts[2].vertebrae == ("T9",) and len(starts[0]) == 17


def test_a_new_start_replaces_the_run_that_goes_on(annotated, monkeypatch):
    go, states = threading.Event(), []

    def slow(frames, starts, observer):
        if not states:
            states.append("first")
            assert go.wait(20)
            observer(1, 3)
            states.append("not stopped")
        return ()

    stand_in(monkeypatch, slow)
    follower = Follower(annotated)
    follower.start(PUSH)
    while not states:
        time.sleep(0.01)
    follower.start(PUSH)
    assert ended(follower).state == "done"
    go.set()
    time.sleep(0.1)
    assert follower.state(PUSH).state == "done" and states == ["first"]


def test_a_run_is_shown_for_the_marks_that_it_began_from(annotated, monkeypatch):
    """Pedicles and marks of other radiographs are no part of these."""
    stand_in(monkeypatch, lambda *_: ())
    follower = Follower(annotated)
    follower.start(PUSH)
    assert ended(follower).state == "done"
    before = annotated.marks

    def state_of(**changed):
        images = {**before, **{name.replace("_", "/"): image for name, image in changed.items()}}
        annotated.save(Draft(schema_version=1, images=images), annotated.revision)
        return follower.state(PUSH).state

    assert state_of(rest_frontal=marked("rest/frontal", *VERTEBRAE[1:])) == "done"
    assert state_of(push_a=marked(PUSH, *VERTEBRAE[1:])) == "none"
    assert state_of(push_a_1=marked(f"{PUSH}/1", "T9")) == "none"
    assert state_of(push_a=marked(PUSH, "T9")) == "none"
    assert state_of() == "done"


def test_a_failure_is_told_in_a_line(annotated, monkeypatch):
    def fail(*_):
        raise TrackingError("no vertebra was found")

    stand_in(monkeypatch, fail)
    follower = Follower(annotated)
    follower.start(PUSH)
    found = ended(follower)
    assert (found.state, found.error, found.frames) == ("failed", "no vertebra was found", ())


def test_what_can_not_be_tracked_is_refused(session):
    follower = Follower(session)
    with pytest.raises(SubjectError, match="no push"):
        follower.start("rest/frontal")
    with pytest.raises(SubjectError, match=r"^Push a can't be tracked before its first frame is complete: no vertebra"):
        follower.start(PUSH)
    few = Draft(schema_version=1, images={PUSH: marked(PUSH, "T1", "T2")})
    session.save(few, session.revision)
    with pytest.raises(SubjectError, match=r"^Push a .* complete: 2 vertebrae, wanted at least 8$"):
        follower.start(PUSH)
