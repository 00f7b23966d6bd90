"""One participant: its results are whole or not there, however a run ends."""

from __future__ import annotations

import errno
import json
import os
import shutil
import stat
import sys

import pytest

from spinestiff.cohort.asked import Cohort
from spinestiff.cohort.marker import examine, whole_results
from spinestiff.cohort.overview import write_overview
from spinestiff.cohort.places import input_files
from spinestiff.cohort.row import read_row
from spinestiff.cohort.supervisor import run_participants
from spinestiff.cohort.worker import as_given, ended, make_results, recover, runner_of
from spinestiff.errors import FitError, InUseError, SubjectError
from spinestiff.files import file_digest, write_text
from spinestiff.subject.lock import sole_run


def silent(_):
    pass


def names(folder):
    """What lies there beside the file that a run holds."""
    return sorted(path.name for path in folder.iterdir() if path.name != "participant.lock")


def test_results_are_published_with_their_marker_and_inputs_are_only_read(task):
    one, place = task
    before = file_digest(place.source)
    assert examine(place, one.order).state == "missing"
    assert make_results(one, silent) == "done"
    assert names(place.target) == ["results"]
    assert names(place.results) == ["done.json", "estimate.json", "figures", "report.html", "row.json"]
    found = examine(place, one.order)
    assert found.state == "current"
    assert set(found.marker.inputs) == {"subject.json", "rest/frontal.dcm"}
    assert set(found.marker.outputs) == {"estimate.json", "figures/one.svg", "report.html", "row.json"}
    assert file_digest(place.source) == before
    assert make_results(one, silent) == "up to date"


def test_results_and_hidden_files_of_a_given_folder_are_no_inputs(task):
    one, place = task
    make_results(one, silent)
    (place.source / "results").mkdir()
    (place.source / "results" / "estimate.json").write_text("old", encoding="utf-8")
    (place.source / ".draft").write_text("x", encoding="utf-8")
    assert set(input_files(place.source)) == {"subject.json", "rest/frontal.dcm"}
    assert examine(place, one.order).state == "current"


@pytest.mark.skipif(sys.platform != "linux", reason="names that are no UTF-8")
def test_an_input_whose_name_is_no_utf8_is_one_like_others(task):
    one, place = task
    odd = place.source / os.fsdecode(b"M\xfcller.txt")
    odd.write_text("x", encoding="utf-8")
    make_results(one, silent)
    assert examine(place, one.order).state == "current" and make_results(one, silent) == "up to date"
    odd.write_text("y", encoding="utf-8")
    assert examine(place, one.order).state == "out of date"


@pytest.mark.skipif(os.name == "nt", reason="links of Unix")
def test_what_is_no_input_may_be_anything(task):
    one, place = task
    (place.source / ".#subject.json").symlink_to("somebody@host.1234")
    (place.source / "results").symlink_to(place.source.parent)
    assert make_results(one, silent) == "done"
    (place.source / "results").unlink()
    (place.source / "results").write_text("a file", encoding="utf-8")
    shutil.rmtree(place.results)
    assert make_results(one, silent) == "done"


def test_a_look_at_results_by_a_file_manager_damages_none(task):
    one, place = task
    make_results(one, silent)
    (place.results / ".DS_Store").write_text("where icons lie", encoding="utf-8")
    assert make_results(one, silent) == "up to date"
    (place.source / "subject.json").write_text('{"number": 5, "trouble": ""}', encoding="utf-8")
    assert make_results(one, silent) == "done"
    assert not (place.results / ".DS_Store").exists()


def edit(place):
    (place.results / "report.html").write_text("mine", encoding="utf-8")


def take_away(place):
    (place.results / "figures" / "one.svg").unlink()


def add(place):
    (place.results / "new.txt").touch()


def cut_marker(place):
    place.marker.write_bytes(place.marker.read_bytes()[:-20])


def another(place):
    content = json.loads(place.marker.read_text(encoding="utf-8"))
    place.marker.write_text(json.dumps({**content, "participant": "sub-009"}), encoding="utf-8")


def no_marker(place):
    place.marker.unlink()


def no_folder(place):
    shutil.rmtree(place.results)
    place.results.write_text("a file", encoding="utf-8")


@pytest.mark.parametrize("harm", [edit, take_away, add, cut_marker, another, no_marker, no_folder])
def test_damaged_and_foreign_results_are_moved_aside_and_made_again(task, harm):
    one, place = task
    make_results(one, silent)
    sound = file_digest(place.results)
    harm(place)
    found = file_digest(place.results)
    assert examine(place, one.order).state == "damaged"
    said = []
    assert make_results(one, said.append) == "done"
    assert any("moved to aside-1, made again" in line for line in said)
    assert file_digest(place.target / "aside-1") == found
    assert file_digest(place.results) == sound


def test_changed_inputs_and_settings_are_run_again(task):
    one, place = task
    make_results(one, silent)
    other = one.order.model_copy(update={"settings": {**one.order.settings, "say": {"more": 1}}})
    assert examine(place, other).state == "out of date"
    (place.source / "subject.json").write_text('{"number": 5, "trouble": ""}', encoding="utf-8")
    assert examine(place, one.order).state == "out of date"
    assert make_results(one, silent) == "done"
    assert read_row(place.results / "row.json").age == 15.0
    make_results(one.model_copy(update={"order": other}), silent)
    assert json.loads((place.results / "estimate.json").read_text(encoding="utf-8"))["more"] == 1


def test_a_run_that_fails_leaves_earlier_results_whole(task):
    one, place = task
    make_results(one, silent)
    before = file_digest(place.results)
    (place.source / "subject.json").write_text('{"number": 5, "trouble": "refuse"}', encoding="utf-8")
    with pytest.raises(FitError):
        make_results(one, silent)
    assert file_digest(place.results) == before
    assert whole_results(place).state == "current"


def test_results_being_replaced_when_a_run_ended_stand_again(task):
    one, place = task
    make_results(one, silent)
    before = file_digest(place.results)
    place.results.rename(place.before)
    assert make_results(one, silent) == "up to date"
    assert file_digest(place.results) == before
    # Ended later: the new ones have their name already.
    shutil.copytree(place.results, place.before)
    assert make_results(one, silent) == "up to date"
    assert names(place.target) == ["results"]


class Killed(BaseException):
    """Stands in for the end of a process."""


@pytest.fixture
def replaced(task, monkeypatch):
    """As a kill between the two renamings leaves a participant: earlier results put by, new ones without their name."""
    one, place = task
    make_results(one, silent)
    before = file_digest(place.results)
    (place.source / "subject.json").write_text('{"number": 5, "trouble": ""}', encoding="utf-8")
    rename = os.rename

    def killed(source, target, **named):
        if str(source).endswith("work/results"):
            raise Killed
        rename(source, target, **named)

    with monkeypatch.context() as patch, pytest.raises(Killed):
        patch.setattr(os, "rename", killed)
        make_results(one, silent)
    assert not place.results.exists() and place.before.exists()
    return one, place, before


def test_results_killed_between_two_renamings_are_found_by_whoever_looks(replaced):
    one, place, before = replaced
    new = file_digest(place.work / "results")
    with sole_run(place.target, place.lock):
        recover(place)
    assert not place.results.exists()
    lines = write_overview(place.source.parent, place.target.parent, (one.participant,))
    assert lines[0] == "group: 1 done"
    assert file_digest(place.results) == new != before
    assert examine(place, one.order).state == "current"


def test_a_run_has_results_stand_that_were_killed_between_two_renamings(replaced):
    one, place, _ = replaced
    new = file_digest(place.work / "results")
    found = run_participants(Cohort(place.source.parent, place.target.parent, (one.participant,), one.order), 1)
    assert found.up_to_date == (one.participant,)
    assert file_digest(place.results) == new
    assert "work" not in names(place.target) and not place.before.exists()


def test_earlier_results_stand_again_where_the_new_ones_are_not_whole(replaced):
    _, place, before = replaced
    (place.work / "results" / "report.html").write_text("half", encoding="utf-8")
    recover(place)
    assert file_digest(place.results) == before
    assert not place.before.exists()


def test_a_renaming_that_fails_puts_earlier_results_back(task, monkeypatch):
    one, place = task
    make_results(one, silent)
    before = file_digest(place.results)
    (place.source / "subject.json").write_text('{"number": 5, "trouble": ""}', encoding="utf-8")
    rename = os.rename

    def failing(source, target, **named):
        if str(source).endswith("work/results"):
            raise OSError(errno.EIO, "broken", str(source))
        rename(source, target, **named)

    monkeypatch.setattr(os, "rename", failing)
    with pytest.raises(OSError, match="broken"):
        make_results(one, silent)
    assert file_digest(place.results) == before


@pytest.mark.skipif(os.name == "nt", reason="folders are not synchronised on Windows")
@pytest.mark.parametrize("number", [errno.EINVAL, errno.ENOTSUP])
def test_a_file_system_that_settles_no_folders_does_for_results(task, monkeypatch, number):
    one, place = task
    fsync = os.fsync

    def files_alone(handle):
        if stat.S_ISDIR(os.fstat(handle).st_mode):
            raise OSError(number, os.strerror(number))
        fsync(handle)

    monkeypatch.setattr(os, "fsync", files_alone)
    assert make_results(one, silent) == "done"
    assert names(place.target) == ["results"]


def test_half_a_file_of_a_run_that_was_killed_is_not_published(task):
    one, place = task
    (place.work / "results").mkdir(parents=True)
    litter = place.work / "results" / ".estimate.json.12ab.tmp"
    litter.write_text("half", encoding="utf-8")
    place.task.write_text(one.order.model_dump_json(), encoding="utf-8")
    make_results(one, silent)
    assert not (place.results / litter.name).exists()


def test_what_another_order_left_in_work_is_not_taken_along(task):
    one, place = task
    for order, kept in ((one.order, True), (one.order.model_copy(update={"version": "0"}), False)):
        shutil.rmtree(place.target, ignore_errors=True)
        (place.work / "results").mkdir(parents=True)
        (place.work / "results" / "posterior.csv").write_text("of a step", encoding="utf-8")
        place.task.write_text(order.model_dump_json(), encoding="utf-8")
        make_results(one, silent)
        assert (place.results / "posterior.csv").exists() == kept


def test_a_row_of_somebody_else_is_refused(task, monkeypatch):
    one, place = task
    renamed = one.model_copy(update={"order": one.order.model_copy(update={"runner": "cohort_runners:misnamed"})})
    with pytest.raises(SubjectError, match="is the row of 'sub-009', wanted that of 'sub-001'"):
        make_results(renamed, silent)
    assert not place.results.exists()


def test_a_participant_in_use_is_waited_for_and_then_named(task, monkeypatch):
    one, place = task
    monkeypatch.setattr("spinestiff.cohort.worker.LONGEST_WAIT_S", 0.3)
    place.target.mkdir(parents=True)
    with (
        sole_run(place.target, place.lock),
        pytest.raises(InUseError, match="another run of spinestiff is at work here"),
    ):
        make_results(one, silent)
    assert make_results(one, silent) == "done"


@pytest.mark.skipif(os.name == "nt", reason="locks of Unix")
def test_a_participant_is_held_by_a_file_opened_for_writing(task, monkeypatch):
    """That one file systems of several machines lock for all of them, a folder for one machine alone."""
    import fcntl

    one, place = task
    monkeypatch.setattr("spinestiff.cohort.worker.LONGEST_WAIT_S", 0.1)
    place.target.mkdir(parents=True)
    with open(place.target / "participant.lock", "w", encoding="utf-8") as elsewhere:
        fcntl.flock(elsewhere, fcntl.LOCK_EX)
        with pytest.raises(InUseError, match="another run of spinestiff is at work here"):
            make_results(one, silent)
    assert make_results(one, silent) == "done"


def test_how_an_exception_ends_a_run(tmp_path):
    assert ended(FitError("no  estimate\n")) == ("refused", "no estimate")
    assert ended(InUseError("held")) == ("in use", "held")
    assert ended(MemoryError()) == ("out of memory", "memory ran out")
    assert ended(ValueError("wrong")) == ("crashed", "ValueError: wrong")
    assert ended(OSError(errno.EROFS, "x", "a/b")) == ("no room", "a/b: the file system is read-only")
    assert ended(OSError(errno.EIO, "Input/output error", "a/b"))[0] == "crashed"


@pytest.mark.parametrize(
    ("number", "end"), [(errno.ENOSPC, "no room"), (errno.EIO, "crashed"), (errno.EACCES, "refused")]
)
def test_trouble_of_the_file_system_is_told_from_a_refusal(tmp_path, monkeypatch, number, end):
    def fail(_):
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(os, "fsync", fail)
    with pytest.raises(SubjectError) as caught:
        write_text(tmp_path / "a.txt", "x")
    assert ended(caught.value)[0] == end


def test_messages_name_the_input_and_not_its_copy(task):
    _, place = task
    assert as_given(f"{place.work}/subject.json: wrong", place) == f"{place.source}/subject.json: wrong"
    assert as_given(f"{place.work}: wrong", place) == f"{place.source}: wrong"
    kept = f"{place.work}/results/estimate.json: can't be written"
    assert as_given(kept, place) == kept


def test_a_runner_that_is_none_is_refused():
    for name in ("cohort_runners:none", "nowhere:quick", "cohort_runners"):
        with pytest.raises(SubjectError, match="wanted module:function"):
            runner_of(name)
