"""The way of the work as the page asks for it: upload, form, jobs, results, zip files, trash."""

from __future__ import annotations

import errno
import gc
import io
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import threading
import time
import zipfile
from pathlib import Path

import numpy as np
import pydicom
import pytest

from asking import wait_for
from hospital import disc, export, gauged
from spinestiff.annotate import session
from spinestiff.annotate.draft import DRAFT_FILE, DraftImage
from spinestiff.app.plan import wish_of
from spinestiff.errors import OptionError, SubjectError
from spinestiff.files import read_json, write_json
from spinestiff.imaging.radiograph import read_radiographs
from spinestiff.study.planning.wish import Wish
from spinestiff.subject.annotation_record import Annotation
from spinestiff.subject.folder import read_subject, read_unannotated, write_annotation
from spinestiff.subject.plan_outcome import Plan, PlannedPush, PlanStep
from spinestiff.subject.records import (
    FurtherViewRecord,
    ImageXRayRecord,
    PushRecord,
    SubjectRecord,
    TrunkRecord,
    XRayRecord,
)
from spinestiff.subject.run_record import record_step, step_record, write_outcome
from spinestiff.workbench import job_process, parcel
from spinestiff.workbench.bench import open_bench
from spinestiff.workbench.job_process import run_job, start_job
from spinestiff.workbench.job_table import LOST_S, JobTable
from spinestiff.workbench.jobs import Jobs
from spinestiff.workbench.page_words import page_words
from spinestiff.workbench.parcel import KEPT, nameless_parcel
from spinestiff.workbench.rooms import open_root
from spinestiff.workbench.unzip import unzip
from spinestiff.workbench.verbs import VERBS, Choice, command_of
from studied import STUDY
from unannotated import CANARY, drawn

POSIX = pytest.mark.skipif(os.name == "nt", reason="processes as POSIX has them")


def annotated(folder):
    """Mark what the radiographs of the folder show."""
    images = {name: drawn(name) for name in ("rest/frontal", "rest/lateral", "push/a")}
    whole = {name: DraftImage.model_validate({"vertebrae": shown.named()}).whole() for name, shown in images.items()}
    write_annotation(folder, Annotation(schema_version=1, images=whole))


# New subjects.


def test_an_export_becomes_a_subject(served, tmp_path):
    upload = served.upload_folder(disc(tmp_path / "disc"))
    look = served.good("POST", "/api/look", {"origin": "upload", "key": upload})
    assert [(one["use"], one["frames"]) for one in look["files"]] == [
        ("rest, frontal", 1), ("rest, lateral", 1), ("push 1", 3), ("push 2", 2),
    ]  # fmt: skip
    assert len(look["left_out"]) == look["left_out_in_all"] == 7 and look["studies"][0]["label"] == "A1"
    made = {"origin": "upload", "key": upload, "name": "boy-04", "person": {"age": 14.5}}
    key = served.good("POST", "/api/subjects", made)["key"]
    card = served.good("GET", f"/api/subjects/{key}")
    assert (card["name"], card["stage"], card["age"], card["pushes"]) == ("boy-04", "form", 14.5, 2)
    assert card["missing"][0] == "Sex" and "Push-1, frame 0 to 2: force on the ribs in N" in card["missing"]
    assert sorted(path.name for path in (served.bench.root.path / "boy-04").iterdir()) == [
        "pushes",
        "rest",
        "subject.json",
    ]
    assert served.ask("POST", "/api/subjects", made)[0] in (404, 422)


def test_a_zip_file_and_several_studies(served, tmp_path):
    export(tmp_path / "all" / "a", study="1.2.1")
    export(tmp_path / "all" / "b", study="1.2.2", time="111500")
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w") as zipped:
        for name in ("a", "b"):
            zipped.write(tmp_path / "all" / name, f"deep/{name}")
    upload = served.upload({"disc.ZIP": content.getvalue()})
    look = served.good("POST", "/api/look", {"origin": "upload", "key": upload})
    assert [one["label"] for one in look["studies"]] == ["A1", "A2"] and look["files"] == [] and look["study"] is None
    said = ["2025-06-12 10:15: 1 picture, 1 frontal", "2025-06-12 11:15: 1 picture, 1 frontal"]
    assert [one["words"] for one in look["studies"]] == said
    look = served.good("POST", "/api/look", {"origin": "upload", "key": upload, "study": "A2"})
    assert [one["name"].rpartition("/")[2] for one in look["files"]] == ["b"]
    asked = {"origin": "upload", "key": upload, "study": "A2", "name": "x", "person": {}}
    assert served.good("POST", "/api/subjects", asked)


def test_studies_are_told_by_what_people_know_of_them(served, tmp_path):
    """The day, the hospital's words and the pictures; a patient by a letter, and a file where all of this is alike."""
    disc = tmp_path / "disc"
    export(disc / "a", study="1.2.1", AcquisitionDate="20240501", StudyDescription="Whole spine\r\n standing ")
    export(disc / "b", "lateral", study="1.2.1", time="101400", AcquisitionDate="20240501")
    export(disc / "c", frames=2, study="1.2.2", AcquisitionDate="20250612", StudyDescription="Push")
    export(disc / "d", study="1.2.3", time=None, StudyDate="20260101")
    export(disc / "e", study="1.2.4", time=None)

    def words():
        look = served.good("POST", "/api/look", {"origin": "upload", "key": served.upload_folder(disc)})
        return {one["label"]: one["words"] for one in look["studies"]}

    assert words() == {
        "A1": "2024-05-01 10:14, Whole spine standing: 2 pictures, 1 frontal, 1 lateral",
        "A2": "2025-06-12 10:15, Push: 1 picture, 1 of several frames",
        "A3": "2026-01-01: 1 picture, 1 frontal",
        "A4": "no date: 1 picture, 1 frontal (disc/e)",
    }
    export(disc / "f", patient="P2", study="1.2.5", AcquisitionDate="20240501")
    export(disc / "g", patient="P2", study="1.2.6", AcquisitionDate="20240501")
    told = words()
    assert told["B1"] == "Patient B, 2024-05-01 10:15: 1 picture, 1 frontal (disc/f)"
    assert told["A2"].startswith("Patient A, 2025-06-12 10:15, Push")


def test_an_upload_goes_on_where_it_stopped(served):
    key = served.good("POST", "/api/uploads", {})["key"]
    served.good("POST", f"/api/uploads/{key}/files", {"files": [{"name": "a", "size": 6}]})
    assert served.good("PUT", f"/api/uploads/{key}/files/0/0", b"abc")["come"] == 3
    status, body = served.json("PUT", f"/api/uploads/{key}/files/0/0", b"abc")
    assert (status, body["error"]) == (409, "go on at 3")
    assert "has not come whole" in served.json("POST", "/api/look", {"origin": "upload", "key": key})[1]["error"]
    assert served.good("PUT", f"/api/uploads/{key}/files/0/3", b"def")["come"] == 6
    assert (served.bench.uploads.place(key) / "files" / "a").read_bytes() == b"abcdef"
    # The same after the server has been started anew.
    served.bench.uploads._lists.clear()
    assert served.good("POST", f"/api/uploads/{key}/files", {"files": []})["files"] == [
        {"path": "a", "size": 6, "come": 6}
    ]


def test_uploads_whose_page_is_gone_do_not_stay(root, serve):
    def left(bench, hours):
        place = bench.uploads.place(bench.uploads.begin())
        os.utime(place, (time.time() - 3600.0 * hours,) * 2)
        return place.name

    def there(bench):
        return {one.name for one in bench.uploads.folder.iterdir()}

    bench = open_bench(root)
    young, old = left(bench, 23.0), left(bench, 25.0)
    assert there(bench) == {old, young}
    open_bench(root, read_only=True)
    assert there(bench) == {old, young}
    open_bench(root)
    assert there(bench) == {young}
    old = left(bench, 25.0)
    names = [bench.uploads.begin() for _ in range(19)]
    assert there(bench) == {young, *names}
    last = bench.uploads.begin()
    assert there(bench) == {*names, last}


def test_folders_on_the_machine_are_those_that_were_named(root, serve, tmp_path):
    disc(tmp_path / "exports" / "one")
    (tmp_path / "exports" / ".hidden").mkdir()
    with serve(root, sources=(tmp_path / "exports",)) as served:
        offered = served.good("GET", "/api/sources")["sources"]
        assert [one["name"] for one in offered] == ["exports", "exports/one"]
        look = served.good("POST", "/api/look", {"origin": "source", "key": offered[1]["key"]})
        assert len(look["files"]) == 4
        for key in ("0" * 16, "é"):
            assert served.ask("POST", "/api/look", {"origin": "source", "key": key})[0] == 404
        asked = {"origin": "source", "key": offered[1]["key"], "name": "new", "person": {}}
        assert served.good("POST", "/api/subjects", asked)["key"] == served.key("new")


def test_no_subject_and_no_folder_is_one_too_many(tmp_path):
    names = [f"{number:04d}" for number in range(2001)]
    for name in names:
        (tmp_path / "root" / name).mkdir(parents=True)
        (tmp_path / "root" / name / "subject.json").touch()
    bench = open_bench(tmp_path / "root", sources=(tmp_path / "root",))
    assert [folder.name for _, folder in bench.root.subjects()] == names
    assert bench.root.subject(bench.root.key_of(names[-1])).name == names[-1]
    assert [name for _, name, _ in bench.sources.offered()] == ["root", *(f"root/{name}" for name in names)]


def test_names_that_are_no_utf8_are_shown_and_hide_nothing(root, serve, tmp_path):
    latin = os.fsdecode(b"M\xfcller")
    try:
        shutil.copytree(root / "girl", root / latin)
    except OSError:
        pytest.skip("this file system takes UTF-8 names alone")
    for name in ("frontal", "lateral"):
        (tmp_path / "exports" / latin).mkdir(parents=True, exist_ok=True)
        shutil.copy(root / "girl" / "rest" / f"{name}.dcm", tmp_path / "exports" / latin / f"{latin}-{name}.dcm")
    with serve(root, sources=(tmp_path / "exports",)) as served:
        cards = served.good("GET", "/api/subjects")["subjects"]
        assert [(one["name"], one["stage"]) for one in cards] == [("M%FCller", "annotate"), ("girl", "annotate")]
        status, _, table = served.ask("GET", "/api/table.csv")
        assert status == 200 and [row.split(",")[0] for row in table.decode().splitlines()[1:]] == ["M%FCller", "girl"]
        assert len(served.good("GET", f"/annotate/{served.key(latin)}/api/session")["images"]) == 3
        (_, source) = served.good("GET", "/api/sources")["sources"]
        asked = {"origin": "source", "key": source["key"]}
        files = served.good("POST", "/api/look", asked)["files"]
        assert [one["name"] for one in files] == ["M%FCller-frontal.dcm", "M%FCller-lateral.dcm"]
        # By what was shown they are found again.
        wide = {**asked, "name": files[0]["name"]}
        assert served.ask("POST", "/api/look/picture", wide)[0] == 200
        chosen = {**asked, "frontal": files[0]["name"]}
        assert served.good("POST", "/api/look", chosen)["files"][0]["use"] == "rest, frontal"
        (root / "girl" / f"{latin}.txt").write_text("note", encoding="utf-8")
        ticket = served.good("POST", f"/api/subjects/{served.key()}/zip", {"nameless": False})["ticket"]
        _, _, content = served.ask("GET", f"/parcel/{ticket}")
        with zipfile.ZipFile(io.BytesIO(content)) as zipped:
            assert zipped.read("M%FCller.txt") == b"note"


# The form.


def test_the_form_is_the_schema_and_says_what_is_wrong_where(served):
    form = served.good("GET", f"/api/subjects/{served.key()}/form")
    assert (
        set(form["words"]) >= {"age", "pushes.d21_mm"} and form["schema"]["properties"]["height_cm"]["maximum"] == 200
    )
    values = form["values"]
    assert form["problems"] == [] and form["open"] == []
    values["height_cm"], values["age"] = 500, "old"
    values["pushes"][0] |= {"d31_mm": 600, "forces_n": [0, None, 20]}
    judged = served.good("POST", "/api/check", {"values": values})
    found = {one["field"]: one["text"] for one in judged["problems"]}
    assert (
        set(found) == {"age", "height_cm", "pushes[0]"} and "d31_mm 600 is not below d21_mm 400" in found["pushes[0]"]
    )
    assert "200" in found["height_cm"]
    assert [one["field"] for one in judged["open"]] == ["pushes[0].forces_n[1]"]


def test_values_are_saved_whole_or_not_at_all(served, root):
    key, path = served.key(), root / "girl" / "subject.json"
    form = served.good("GET", f"/api/subjects/{key}/form")
    before, values = path.read_bytes(), form["values"]
    bad = {"values": {**values, "height_cm": 500}, "revision": form["revision"]}
    assert served.ask("PUT", f"/api/subjects/{key}/form", bad)[0] == 422 and path.read_bytes() == before
    good = {"values": {**values, "height_cm": 150.5}, "revision": form["revision"]}
    saved = served.good("PUT", f"/api/subjects/{key}/form", good)
    assert read_unannotated(root / "girl").record.height_cm == 150.5
    # What is there already: the answer may have been lost.
    assert served.good("PUT", f"/api/subjects/{key}/form", good) == saved
    other = {"values": {**values, "height_cm": 150.6}, "revision": form["revision"]}
    status, body = served.json("PUT", f"/api/subjects/{key}/form", other)
    assert status == 409 and "changed meanwhile" in body["error"]
    values["height_cm"] = None
    opened = served.good("PUT", f"/api/subjects/{key}/form", {"values": values, "revision": saved["revision"]})
    assert [one["field"] for one in opened["open"]] == ["height_cm"]
    assert served.good("GET", f"/api/subjects/{key}")["stage"] == "form"


def test_a_gauges_log_gives_the_forces_and_writes_nothing(root, serve, tmp_path):
    true = gauged(tmp_path)
    with serve(root, sources=(tmp_path / "in",)) as served:
        source = served.good("GET", "/api/sources")["sources"][0]["key"]
        made = {"origin": "source", "key": source, "name": "new", "person": {}}
        key = served.good("POST", "/api/subjects", made)["key"]
        before, text = content_of(root / "new"), (tmp_path / "gauge.csv").read_text(encoding="utf-8")
        found = served.good("POST", f"/api/subjects/{key}/log", {"push": 0, "text": text})
        np.testing.assert_allclose(found["forces_n"], true, atol=2.5)
        assert found["placed"] and not found["given"] and found["low_s"] <= 3.1 <= found["high_s"]
        assert "'Load (kgf)' (kgf)" in found["columns"] and found["picture"].startswith("data:image/png;base64,iVBOR")
        given = served.good("POST", f"/api/subjects/{key}/log", {"push": 0, "text": text, "offset_s": 3.1})
        np.testing.assert_allclose(given["forces_n"], true, atol=0.6)
        flat = "time,force\n" + "\n".join(f"{i / 10},1.5" for i in range(200))
        units = {"time_unit": "s", "force_unit": "N"}
        assert (
            "say the unit of time"
            in served.json("POST", f"/api/subjects/{key}/log", {"push": 0, "text": flat})[1]["error"]
        )
        unknown = served.good("POST", f"/api/subjects/{key}/log", {"push": 0, "text": flat, **units})
        assert not unknown["placed"] and unknown["forces_n"] is None and "changes by 0.0 N only" in unknown["why"]
        for bad in ({"push": 1, "text": text}, {"push": 0, "text": "no log"}, {"push": -1, "text": text}):
            status, body = served.json("POST", f"/api/subjects/{key}/log", bad)
            assert status == 422 and str(tmp_path) not in body["error"] and "--" not in body["error"]
        assert content_of(root / "new") == before


def test_a_log_without_times_needs_its_entries_a_second(root, serve, tmp_path):
    true = gauged(tmp_path)
    rows = [row.split(";") for row in (tmp_path / "gauge.csv").read_text(encoding="utf-8").splitlines()[1:]]
    times, steps = [float(ms) / 1000.0 for ms, _ in rows], 20
    even = [round(i / steps, 6) for i in range(int(times[0] * steps), int(times[-1] * steps) + 1)]
    forces = np.interp(even, times, [float(force.replace(",", ".")) for _, force in rows])
    text = "Nr;Load (kgf)\n" + "\n".join(f"{i};{force:.3f}" for i, force in enumerate(forces, 1))
    with serve(root, sources=(tmp_path / "in",)) as served:
        source = served.good("GET", "/api/sources")["sources"][0]["key"]
        made = {"origin": "source", "key": source, "name": "new", "person": {}}
        key = served.good("POST", "/api/subjects", made)["key"]
        asked = {"push": 0, "text": text}
        status, body = served.json("POST", f"/api/subjects/{key}/log", asked)
        assert status == 422 and "a steady rate, give its entries a second" in body["error"]
        for named in ({}, {"columns": ["Load (kgf)"]}):
            found = served.good("POST", f"/api/subjects/{key}/log", {**asked, **named, "rate_hz": steps})
            assert "20 a second" in found["columns"] and found["placed"]
            np.testing.assert_allclose(found["forces_n"], true, atol=2.5)
        for bad, words in (
            ({"rate_hz": 0.0}, "rate_hz: found 0.0, wanted greater than or equal to 0.1"),
            ({"columns": ["load"]}, "names of both columns"),
            ({"columns": []}, "columns: found [], wanted at least 1 item"),
            ({"columns": "ab"}, "columns: found 'ab', wanted a list"),
        ):
            status, body = served.json("POST", f"/api/subjects/{key}/log", {**asked, **bad})
            assert status in (400, 422) and words in body["error"] and "--" not in body["error"], body


@POSIX
def test_values_are_not_changed_under_a_run(served, root):
    from spinestiff.subject.lock import sole_run

    form = served.good("GET", f"/api/subjects/{served.key()}/form")
    with sole_run(root / "girl"):
        sent = {"values": form["values"], "revision": form["revision"]}
        status, body = served.json("PUT", f"/api/subjects/{served.key()}/form", sent)
        assert status == 409 and "another run" in body["error"]
        assert served.ask("DELETE", f"/api/subjects/{served.key()}")[0] == 409


def test_cards_say_what_comes_next(served, root):
    def card():
        return served.good("GET", f"/api/subjects/{served.key()}")

    assert card()["stage"] == "annotate" and "Push a: not annotated" in card()["missing"]
    annotated(root / "girl")
    assert (card()["stage"], card()["missing"], card()["result"]) == ("run", [], None)
    (root / "girl" / "rest" / "frontal.dcm").rename(root / "girl" / "rest" / "other.dcm")
    assert card()["stage"] == "radiographs" and card()["missing"] == ["Rest, frontal: no radiograph"]
    (root / "girl" / "subject.json").write_text("{", encoding="utf-8")
    assert card()["stage"] == "broken" and "not JSON" in card()["missing"][0]


# Jobs.


@pytest.mark.parametrize("broken", ["rest", "results"])
def test_a_subject_that_can_not_be_read_hides_no_other(served, root, monkeypatch, broken):
    shutil.copytree(root / "girl", root / "boy")
    real = Path.stat

    def closed(path, **options):
        if path.is_relative_to(root / "boy" / broken):
            raise PermissionError(13, "Permission denied", str(path))
        return real(path, **options)

    for name in ("boy", "girl"):
        annotated(root / name)
        (root / name / "results").mkdir()
        (root / name / "results" / "estimate.json").write_text("{}", encoding="utf-8")
        subject = read_subject(root / name)
        record_step(subject, "report", step_record(subject, ("rest/frontal.dcm", "pushes/a.dcm"), {}), [])
    monkeypatch.setattr(Path, "stat", closed)
    boy, girl = served.good("GET", "/api/subjects")["subjects"]
    assert girl["stage"] == "run" and girl["missing"] == []
    assert boy["name"] == "boy" and "ermission" in " ".join([*boy["missing"], *[str(boy.get("result"))]])
    assert served.ask("GET", "/api/table.csv")[0] == 200


def test_one_job_at_a_time_a_subject_and_a_cancelled_one_that_waits(served):
    path = f"/api/subjects/{served.key()}/jobs"
    job = served.good("POST", path, {"verb": "run", "options": {"mesh": "coarse"}})
    assert (job["state"], job["options"]) == ("waiting", {"mesh": "coarse"})
    status, body = served.json("POST", path, {"verb": "view", "options": {}})
    assert status == 409 and "has a job already" in body["error"]
    assert served.ask("DELETE", f"/api/subjects/{served.key()}")[0] == 409
    assert served.good("POST", f"/api/jobs/{job['id']}/cancel", {})["state"] == "cancelled"
    assert served.good("POST", path, {"verb": "view", "options": {}})["state"] == "waiting"
    assert [one["verb"] for one in served.good("GET", path)["jobs"]] == ["view", "run"]


def test_jobs_start_in_turn_and_no_more_than_allowed(tmp_path):
    table = JobTable(tmp_path / "t.sqlite")
    table.make()
    first, second, third = (table.add(key, "run", {}) for key in "abc")
    assert table.take(2).id == first.id and table.take(2).id == second.id and table.take(2) is None
    table.end(first.id, "done", 0)
    assert table.take(2).id == third.id
    # Written twice, what was first stays.
    table.end(first.id, "failed", 1)
    assert table.job(first.id).state == "done"


def test_logs_that_the_page_can_not_show_are_deleted_when_a_job_starts(root, monkeypatch):
    started = []
    monkeypatch.setattr("spinestiff.workbench.jobs.start_job", lambda table, job, *_: started.append(job))
    monkeypatch.setattr("spinestiff.workbench.job_table.SHOWN", 3)
    bench = open_bench(root, side_by_side=2)
    jobs, (key, _) = bench.jobs, next(iter(bench.root.subjects()))

    def job_of(subject):
        job = jobs.table.add(subject, "run", {})
        jobs.log(job.id).parent.mkdir(exist_ok=True)
        jobs.log(job.id).write_text("what it said", encoding="utf-8")
        return job.id

    def ended(subject):
        job = job_of(subject)
        jobs.table.take(9)
        jobs.table.end(job, "done", 0)
        return job

    running = job_of("long")
    jobs.table.take(9)
    other = ended("other")
    old, *recent = (ended(key) for _ in range(4))
    stray = jobs.log("of-no-job")
    stray.write_text("", encoding="utf-8")
    last = job_of(key)
    jobs.look()
    assert started == [last]
    # Of this subject the last three; another's, however old; and what runs.
    assert {log.stem for log in stray.parent.iterdir()} == {last, *recent[1:], other, running}
    assert not stray.exists() and old not in recent


def test_a_job_without_a_sign_of_life_is_lost(tmp_path, monkeypatch):
    table = JobTable(tmp_path / "t.sqlite")
    table.make()
    job = table.add("a", "run", {})
    assert table.take(1).id == job.id
    table.give_up_lost()
    assert table.job(job.id).state == "running" and table.beat(job.id)
    now = time.time()
    monkeypatch.setattr("spinestiff.workbench.job_table.time.time", lambda: now + LOST_S + 1)
    table.give_up_lost()
    assert table.job(job.id).state == "lost" and not table.beat(job.id)


def test_a_job_is_not_given_up_at_once_after_this_machine_slept(tmp_path, monkeypatch):
    jobs = Jobs(open_root(tmp_path))
    jobs.table.make()
    job = jobs.table.add("a", "run", {})
    jobs.table.take(1)
    now = time.time()
    monkeypatch.setattr("spinestiff.workbench.job_table.time.time", lambda: now + 3600.0)
    jobs.look()
    assert jobs.table.job(job.id).state == "running"
    # One that gives no sign of life then either is lost.
    jobs.look()
    assert jobs.table.job(job.id).state == "lost"


def test_a_job_runs_says_its_lines_and_ends(root, serve):
    with serve(root, jobs=True) as served:
        job = served.good("POST", f"/api/subjects/{served.key()}/jobs", {"verb": "run", "options": {}})["id"]
        status, headers, body = served.ask("GET", f"/api/jobs/{job}/events")
        assert status == 200 and headers["content-type"].startswith("text/event-stream")
        events = [block.split("\n") for block in body.decode().strip().split("\n\n")]
        states = [json.loads(lines[-1].removeprefix("data: "))["state"] for lines in events if lines[0] == "event: job"]
        assert states[-1] == "failed" and "running" in states
        said = [
            line for lines in events if "event: lines" in lines for line in json.loads(lines[-1].removeprefix("data: "))
        ]
        assert any("no annotation; mark the vertebra corners" in line for line in said)
        # From a place on, as a page asks that was reloaded.
        at = max(int(lines[0].removeprefix("id: ")) for lines in events if lines[0].startswith("id: "))
        assert b"event: lines" not in served.ask("GET", f"/api/jobs/{job}/events?at={at}")[2]
        assert served.good("GET", f"/api/jobs/{job}/log")["lines"] == said
        assert served.good("GET", f"/api/subjects/{served.key()}")["job"]["status"] == 2


@pytest.mark.slow
@POSIX
def test_a_job_outlives_its_server_and_is_cancelled_by_the_next(root, serve):
    """A real run: the corners are followed and the torso is being shaped when it is cancelled."""
    annotated(root / "girl")
    with serve(root, jobs=True) as served:
        asked = {"verb": "run", "options": {"mesh": "coarse"}}
        job = served.good("POST", f"/api/subjects/{served.key()}/jobs", asked)["id"]
        served.until(job, "running")
        wait_for(lambda: "personalise:" in "".join(served.good("GET", f"/api/jobs/{job}/log")["lines"]), 120.0)
    with serve(root, jobs=True) as served:
        assert served.good("GET", f"/api/subjects/{served.key()}")["job"]["state"] == "running"
        served.good("POST", f"/api/jobs/{job}/cancel", {})
        served.until(job, "cancelled")
    # What was finished stays.
    assert (root / "girl" / "results" / "tracked.json").exists()


def alive(pid):
    try:
        return "\tZ" not in Path(f"/proc/{pid}/status").read_text(encoding="utf-8")
    except FileNotFoundError:
        return False


def check_of_the_girl(root, log):
    """The process of a job that has been taken."""
    bench = open_root(root)
    table = JobTable(bench.own / "jobs.sqlite")
    table.make()
    job = table.add(bench.key_of("girl"), "run", {})
    table.take(1)
    return start_job(table.path, job.id, root / "girl", ["check"], log)


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="looks at /proc")
def test_a_job_whose_process_is_killed_takes_the_command_along(root, tmp_path):
    process = check_of_the_girl(root, tmp_path / "log")

    def children():
        with open(f"/proc/{process.pid}/task/{process.pid}/children", encoding="utf-8") as file:
            return [int(pid) for pid in file.read().split()]

    (command,) = wait_for(children)
    process.send_signal(signal.SIGKILL)
    process.wait()
    wait_for(lambda: not alive(command))


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="looks at /proc")
def test_a_process_of_a_job_that_nobody_looks_at_leaves_nothing(root, tmp_path):
    number = check_of_the_girl(root, tmp_path / "log").pid
    gc.collect()  # a process that still runs would be told as a warning, which is an error here
    os.kill(number, signal.SIGKILL)
    wait_for(lambda: not Path(f"/proc/{number}").exists())


def test_a_job_whose_lines_can_not_be_kept_goes_on_to_its_end(tmp_path):
    table = JobTable(tmp_path / "t.sqlite")
    table.make()
    job = table.add("a", "check", {})
    table.take(1)
    # More than a pipe holds, and a log without a place, as on a disk that is full.
    command = (sys.executable, "-c", "for _ in range(4000): print('x' * 100)")
    log = tmp_path / "gone" / "log"
    work = threading.Thread(target=run_job, args=(table, job.id, tmp_path, [], log, command), daemon=True)
    work.start()
    work.join(timeout=15.0)
    table.ask_cancel(job.id)
    work.join(timeout=15.0)
    assert table.job(job.id).state == "done"


# What is left of it.


def test_everything_and_nothing_of_the_patient_as_zip_files(served, root, tmp_path):
    annotated(root / "girl")
    os.utime(root / "girl" / "pushes" / "a.dcm", (0.0, 0.0))  # a day that no zip file knows
    key = served.key()

    def packed(**asked):
        ticket = served.good("POST", f"/api/subjects/{key}/zip", asked)["ticket"]
        status, headers, content = served.ask("GET", f"/parcel/{ticket}", headers={"x-spinestiff-token": None})
        assert status == 200 and headers["content-disposition"] == 'attachment; filename="subject.zip"'
        assert served.ask("GET", f"/parcel/{ticket}")[0] == 404
        return content

    whole = packed(nameless=False)
    with zipfile.ZipFile(io.BytesIO(whole)) as zipped:
        assert sorted(zipped.namelist()) == sorted(
            path.relative_to(root / "girl").as_posix() for path in (root / "girl").rglob("*") if path.is_file()
        )
        assert zipped.read("pushes/a.dcm") == (root / "girl" / "pushes" / "a.dcm").read_bytes()
    values, distance = read_json(root / "girl" / "subject.json"), {"source_detector_mm": 1500.0}
    write_json(root / "girl" / "subject.json", values | {"mass_kg": 45, "xray": {"images": {"push/a": distance}}})
    bare = packed(nameless=True, burned_in_ok=True)
    (tmp_path / "bare.zip").write_bytes(bare)
    unzip(tmp_path / "bare.zip", tmp_path / "bare", 2**30)
    content = b"".join(path.read_bytes() for path in (tmp_path / "bare").rglob("*") if path.is_file())
    for word in (*CANARY.split("^"), "girl"):
        assert word.encode() not in content
    told = (tmp_path / "bare" / "README.txt").read_text(encoding="utf-8")
    kept = read_json(tmp_path / "bare" / "subject.json").keys() - {"schema_version", "id", "pushes", "xray"}
    assert kept == {"age", "sex", "height_cm", "mass_kg"}
    for word in kept:
        assert word.partition("_")[0] in told.lower(), word
    subject, first = read_subject(tmp_path / "bare"), read_subject(root / "girl")
    assert re.fullmatch("subject-[0-9a-f]{8}", subject.record.id) and subject.pushes[0].id == "push-1"
    assert read_json(tmp_path / "bare" / "subject.json")["xray"] == {"images": {"push/push-1": distance}}
    assert subject.annotation.images["push/push-1"] == first.annotation.images["push/a"]
    old = pydicom.dcmread(root / "girl" / first.pushes[0].frames)
    new = pydicom.dcmread(tmp_path / "bare" / subject.pushes[0].frames)
    assert (new.pixel_array == old.pixel_array).all() and new.PatientIdentityRemoved == "YES"
    assert list(served.bench.parcels.folder.iterdir()) == []


def test_what_leaves_a_house_is_named_value_by_value():
    """A value that records get later on stays inside until somebody has judged it; of what leaves whole, its parts."""
    told_anew = {
        SubjectRecord: {"schema_version", "id", "pushes", "torso", "skin_scan"},
        PushRecord: {"id", "frames", "views", "markers"},
        FurtherViewRecord: {"id", "files"},
    }
    for kind, others in told_anew.items():
        assert KEPT[kind] | others == set(kind.model_fields) and not KEPT[kind] & others
    lengths = {"source_detector_mm", "source_patient_mm", "imager_pixel_mm", "beam"}
    assert set(XRayRecord.model_fields) == {*lengths, "orientation", "scale", "images"}
    assert set(ImageXRayRecord.model_fields) == lengths
    assert set(TrunkRecord.model_fields) == {"breadth_mm", "depth_mm"}


def test_zip_files_without_names_have_ids_of_their_own_and_name_what_they_leave_out(root, tmp_path):
    """Visits with one id are taken for visits of one person; and marks that are not complete are not lost unsaid."""
    annotated(root / "girl")
    write_json(root / "girl" / DRAFT_FILE, read_json(root / "girl" / "annotation.json"))
    found = set()
    for number in range(2):
        place = nameless_parcel(root / "girl", tmp_path / f"parcels-{number}", True)
        with zipfile.ZipFile(place) as zipped:
            found.add(json.loads(zipped.read("subject.json"))["id"])
            assert "Left out: marks that are not complete yet." in zipped.read("README.txt").decode()
            assert DRAFT_FILE not in zipped.namelist()
    assert len(found) == 2


@pytest.mark.parametrize(
    ("name", "kept"),
    [
        ("120", True),
        ("100.5", True),
        ("T10", True),
        ("rib", True),
        ("Anna", False),
        ("4821357", False),
        ("19850312", False),
        ("1985.03.12", False),
        ("p-017", False),
        ("R10_L", False),
    ],
)
def test_a_log_hides_a_folders_name_unless_it_reads_as_what_the_program_says(tmp_path, name, kept):
    folder, log = tmp_path / name, tmp_path / "log"
    folder.mkdir()
    said = f"{folder}: {name} N, {name} is done"
    with subprocess.Popen([sys.executable, "-c", f"print({said!r})"], stdout=subprocess.PIPE) as process:
        job_process._keep_log(process, folder, log)
    rest = f"{name} N, {name} is done" if kept else "subject N, subject is done"
    assert log.read_text(encoding="utf-8") == f"subject: {rest}\n"


def test_a_zip_file_without_names_says_nothing_of_pushes_that_are_gone(served, root, tmp_path):
    annotated(root / "girl")
    annotation = read_json(root / "girl" / "annotation.json")
    marks = annotation["images"]["push/a"]
    images = ("push/Jane", "push/Jane/1", "push/a/1", "push/a/0/Jane", "push/a/Jane")
    annotation["images"] |= dict.fromkeys(images, marks | {"supports": {}})
    write_json(root / "girl" / "annotation.json", annotation)
    place = nameless_parcel(root / "girl", tmp_path / "parcels", True)
    with zipfile.ZipFile(place) as zipped:
        left = json.loads(zipped.read("annotation.json"))["images"]
        assert not any(b"Jane" in zipped.read(name) for name in zipped.namelist())
    assert set(left) == {"rest/frontal", "rest/lateral", "push/push-1", "push/push-1/1"}


def test_zip_files_that_nobody_fetches_do_not_stay(served, root, serve, monkeypatch):
    def pack():
        return served.good("POST", f"/api/subjects/{served.key()}/zip", {"nameless": False})["ticket"]

    parcels = served.bench.parcels.folder
    pack()
    (late,) = parcels.iterdir()
    os.utime(late, (time.time() - parcel.PARCEL_S - 1,) * 2)
    pack()
    assert not late.exists() and len(list(parcels.iterdir())) == 1
    monkeypatch.setattr(parcel, "MOST_PARCELS", 3)
    tickets = [pack() for _ in range(5)]
    assert len(list(parcels.iterdir())) == 3
    assert [served.ask("GET", f"/parcel/{one}")[0] for one in tickets] == [404, 404, 200, 200, 200]
    with monkeypatch.context() as patch:
        patch.setattr(parcel, "room_bytes", lambda _: 1000)
        status, said = served.json("POST", f"/api/subjects/{served.key()}/zip", {"nameless": False})
        assert status == 422 and "no room on the disk" in said["error"] and not list(parcels.iterdir())
    ticket = pack()
    # Another server of the same folder, which changes nothing.
    with serve(root, read_only=True):
        pass
    assert served.ask("GET", f"/parcel/{ticket}")[0] == 200
    served.bench.parcels.close()
    assert not parcels.exists()


GONE = """
import sys
from pathlib import Path
from spinestiff.workbench.parcel import Parcels

def made(place):
    place.mkdir(parents=True, exist_ok=True)
    (place / "a.zip").write_bytes(b"zip")
    return place / "a.zip"

print(Parcels(Path(sys.argv[1])).pack(made))
"""


@pytest.mark.skipif(os.name == "nt", reason="locks of Unix")
def test_zip_files_of_another_server_are_left_to_it_until_it_has_ended(tmp_path):
    common = tmp_path / "parcels"

    def made(place):
        half = place / "b.zip"
        half.write_bytes(b"half")
        # Another server starts, and packs, while this one is at it.
        other = parcel.Parcels(common)
        other.clear()
        theirs = other.pack(lambda place: Path(shutil.copy(half, place / "c.zip")))
        assert theirs.exists() and theirs.parent != place
        other.close()
        assert not theirs.parent.exists()
        return half

    gone = Path(
        subprocess.run([sys.executable, "-c", GONE, common], capture_output=True, text=True, check=True).stdout.strip()
    )
    assert gone.exists()
    # As versions before kept them.
    (common / "old.zip").write_bytes(b"zip")
    mine = parcel.Parcels(common)
    place = mine.pack(made)
    assert place.read_bytes() == b"half"
    assert not gone.exists() and list(common.iterdir()) == [mine.folder]


@pytest.mark.parametrize("beside", ["", "README.txt"])
def test_a_zip_file_without_names_keeps_frames_in_their_order(root, tmp_path, beside):
    """No file has a time or a number: the order is that of names as people read them."""
    values, frames = read_json(root / "girl" / "subject.json"), root / "girl" / "pushes" / "a"
    frames.mkdir()
    for number in range(11):
        dataset = pydicom.dcmread(root / "girl" / "rest" / "frontal.dcm")
        pixels = dataset.pixel_array.copy()
        pixels[0, 0] = number
        dataset.PixelData = pixels.tobytes()
        dataset.SOPInstanceUID = dataset.file_meta.MediaStorageSOPInstanceUID = f"1.2.3.{number}"
        for name in ("AcquisitionTime", "AcquisitionDateTime", "ContentTime", "InstanceNumber"):
            if name in dataset:
                delattr(dataset, name)
        dataset.save_as(frames / f"img{number + 1}.dcm")
    values["pushes"][0] |= {
        "frames": "pushes/a", "forces_n": [6.0 * number for number in range(11)],
        "roles": [*["unused"] * 10, "training"],
    }  # fmt: skip
    write_json(root / "girl" / "subject.json", values)
    if beside:  # passed by, as by whoever reads the frames
        (frames / beside).write_text("eleven frames", encoding="utf-8")
    with zipfile.ZipFile(nameless_parcel(root / "girl", tmp_path / "parcels", True)) as zipped:
        zipped.extractall(tmp_path / "bare")
    push = read_unannotated(tmp_path / "bare").pushes[0]
    with pytest.warns(UserWarning, match="ordered by file name"):
        shown = read_radiographs(tmp_path / "bare" / push.frames)
    assert list(push.forces_n) == [6.0 * number for number in range(11)]
    stored = [pydicom.dcmread(tmp_path / "bare" / push.frames / f"{number:03d}.dcm") for number in range(11)]
    assert [int(one.pixel_array[0, 0]) for one in stored] == list(range(11)) and len(shown) == 11


def content_of(folder):
    return {path.relative_to(folder): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_what_is_removed_can_be_put_back(served, root):
    before = content_of(root / "girl")
    trash = served.good("DELETE", f"/api/subjects/{served.key()}")["trash"]
    assert served.good("GET", "/api/subjects")["subjects"] == [] and not (root / "girl").exists()
    assert [(one["key"], one["name"]) for one in served.good("GET", "/api/trash")["trash"]] == [(trash, "girl")]
    assert served.good("POST", f"/api/trash/{trash}/restore", {})["key"] == served.key()
    assert content_of(root / "girl") == before
    trash = served.good("DELETE", f"/api/subjects/{served.key()}")["trash"]
    (root / "girl").mkdir()
    assert served.ask("POST", f"/api/trash/{trash}/restore", {})[0] == 422
    served.good("DELETE", f"/api/trash/{trash}")
    assert served.good("GET", "/api/trash")["trash"] == []


def test_a_subject_that_can_not_be_removed_leaves_nothing_in_the_trash(served, root, monkeypatch):
    def refused(self, target):
        raise OSError(errno.EXDEV, "another disk")

    trash = served.bench.trash
    monkeypatch.setattr(type(root), "rename", refused)
    with pytest.raises(SubjectError, match="the subject can't be removed"):
        trash.remove(root / "girl")
    assert (root / "girl" / "subject.json").is_file() and not list(trash.folder.iterdir())


def test_a_subject_is_not_removed_under_marks_that_are_being_saved(served, root, monkeypatch):
    page, write = f"/annotate/{served.key()}/api", session.write_json
    removal = threading.Thread(target=served.bench.trash.remove, args=(root / "girl",))

    def meanwhile(path, data):
        removal.start()
        removal.join(1.0)
        write(path, data)

    revision = served.good("GET", f"{page}/session")["revision"]
    draft = {"schema_version": 1, "images": {"rest/frontal": {"vertebrae": drawn("rest/frontal").named("T1")}}}
    monkeypatch.setattr(session, "write_json", meanwhile)
    served.good("PUT", f"{page}/annotation", {"revision": revision, "draft": draft})
    removal.join()
    assert not (root / "girl").exists()
    (trash,) = served.good("GET", "/api/trash")["trash"]
    served.good("POST", f"/api/trash/{trash['key']}/restore", {})
    assert (root / "girl" / "annotation.draft.json").is_file() and (root / "girl" / "subject.json").is_file()


def test_a_subject_whose_folder_has_any_name_can_be_put_back(served, root):
    (root / "girl").rename(root / "visit 1, girl")
    before, key = content_of(root / "visit 1, girl"), served.key("visit 1, girl")
    trash = served.good("DELETE", f"/api/subjects/{key}")["trash"]
    assert served.good("POST", f"/api/trash/{trash}/restore", {})["key"] == key
    assert content_of(root / "visit 1, girl") == before and served.good("GET", "/api/trash")["trash"] == []
    # A new one's name stays as the report takes it.
    with pytest.raises(SubjectError, match="wanted"):
        served.bench.root.new_subject("visit 2")


def test_a_page_saves_on_the_marks_that_it_has_however_often_its_room_is_made(served, root, serve):
    page = f"/annotate/{served.key()}/api"

    def save(client, revision, count):
        quads = dict(list(drawn("rest/frontal").named().items())[:count])
        draft = {"schema_version": 1, "images": {"rest/frontal": {"vertebrae": quads}}}
        status, said = client.json("PUT", f"{page}/annotation", {"revision": revision, "draft": draft})
        return status, said.get("revision")

    def marked_now():
        return len(read_json(root / "girl" / "annotation.draft.json")["images"]["rest/frontal"]["vertebrae"])

    old = revision = served.good("GET", f"{page}/session")["revision"]
    for count in (3, 4, 5):
        status, revision = save(served, revision, count)
        assert status == 200
    # Others are looked at meanwhile, and no room is kept for this one.
    for name in "bcde":
        shutil.copytree(root / "girl", root / name)
        served.good("GET", f"/annotate/{served.key(name)}/api/session")
    assert save(served, old, 1)[0] == 409 and marked_now() == 5
    status, revision = save(served, revision, 6)
    assert status == 200 and marked_now() == 6
    # The same where the server is started anew.
    with serve(root) as again:
        assert save(again, old, 1)[0] == 409
        assert save(again, revision, 7)[0] == 200 and marked_now() == 7


def test_the_annotation_page_is_a_room_of_its_own(served, root):
    page = f"/annotate/{served.key()}"
    status, headers, body = served.ask("GET", f"{page}/", headers={"x-spinestiff-token": None})
    assert status == 200 and b'src="annotate.js"' in body and "frame-src" not in headers["content-security-policy"]
    assert served.ask("GET", f"{page}/annotate.css")[0] == 200 and served.ask("GET", f"{page}/subject.json")[0] == 404
    session = served.good("GET", f"{page}/api/session")
    assert session["subject"] == "girl" and len(session["images"]) == 3
    marks = {"vertebrae": drawn("rest/frontal").named()}
    draft = {"schema_version": 1, "images": {"rest/frontal": marks}}
    sent = {"revision": session["revision"], "draft": draft}
    assert served.good("PUT", f"{page}/api/annotation", sent)["revision"] != session["revision"]
    assert set(read_json(root / "girl" / "annotation.json")["images"]) == {"rest/frontal"}
    # Values that change while somebody annotates: the marks stay.
    form = served.good("GET", f"/api/subjects/{served.key()}/form")
    sent = {"values": {**form["values"], "height_cm": 150}, "revision": form["revision"]}
    served.good("PUT", f"/api/subjects/{served.key()}/form", sent)
    assert set(served.good("GET", f"{page}/api/session")["marks"]) == {"rest/frontal"}


def test_a_plan_may_be_asked_all_that_the_command_line_takes():
    given = {"target": "cobb", "under": "right, 8,60", "side": "left", "ribs": " 5, 7.5", "views": "frontal"}
    assert command_of("plan", given) == [
        "plan", ".", "--target=cobb", "--under=right,8,60", "--side=left", "--ribs=5,7.5", "--views=frontal"
    ]  # fmt: skip
    assert command_of("plan", {"ribs": ""}) == ["plan", "."]
    wish_of("cobb", 80.0, 8.0, "left", "5,7.5", "right,8,60", 500.0, "frontal")
    for wrong, words in (
        ({"target": "cobb"}, "Under which push: wanted e.g. right,8,60"),
        ({"target": "cobb", "under": " "}, "Under which push: wanted"),
        ({"target": "cobb", "under": "up,8,60"}, "found 'up,8,60', wanted e.g. right,8,60"),
        ({"ribs": "5 7"}, "Ribs to push: found '5 7', wanted e.g. 5,7,9"),
        ({"ribs": "13"}, "Ribs to push"),
        ({"ribs": "5,--write"}, "Ribs to push"),
        ({"ribs": 5}, "Ribs to push"),
    ):
        with pytest.raises(OptionError, match=re.escape(words)):
            command_of("plan", wrong)


def test_a_plan_as_the_page_offers_it_is_the_usual_one():
    def usual(option):
        return next(iter(option.words)) if isinstance(option, Choice) else getattr(option, "usual", "")

    offered = {name: usual(option) for name, option in VERBS["plan"].options.items()}
    told = [offered[name] for name in ("target", "limit", "exposures", "side")]
    words = [offered[name] or None for name in ("ribs", "under")]
    assert wish_of(*told, *words, VERBS["plan"].options["limit"].high, offered["views"]) == Wish()


def test_a_plan_that_is_older_than_the_estimate_is_called_out_of_date(served, root):
    folder = root / "girl"
    push = PlannedPush(side="left", level=8.0, force_n=30.0, radiographs=2, expected_factor=1.4, factors={})
    plan = Plan(target="bending", limit_n=30.0, basis="population", taken=0, now={}, now_deg=None, estimated={},
                next=(push,), sequence=(PlanStep(push=push, exposures=2, pays=True),), taped=None)  # fmt: skip
    (folder / "results").mkdir()
    (folder / "results" / "estimate.json").write_text("{}", encoding="utf-8")
    subject = read_unannotated(folder)
    write_outcome(subject, plan)
    made_from = step_record(subject, ["results/estimate.json", "subject.json: supports"], {})
    record_step(subject, "plan", made_from, [folder / "results" / "plan.json"])
    address = f"/api/subjects/{served.key()}/results"
    found = served.good("GET", address)
    assert any(line.startswith("Best next: rib 8 left") for line in found["plan"]) and found["plan_stale"] == []
    (folder / "results" / "estimate.json").write_text("{} ", encoding="utf-8")
    write_json(folder / "subject.json", read_json(folder / "subject.json") | {"pelvis": "level"})
    assert served.good("GET", address)["plan_stale"] == ["the estimate", "values: supports"]


def test_a_study_of_parameters_is_told_as_long_as_it_holds(served, root):
    folder = root / "girl"
    (folder / "results").mkdir()
    (folder / "results" / "estimate.json").write_text("{}", encoding="utf-8")
    subject, address = read_unannotated(folder), f"/api/subjects/{served.key()}/results"
    assert served.good("GET", address)["parameters"] == []
    write_outcome(subject, STUDY)
    made_from = step_record(subject, ["results/estimate.json"], {})
    record_step(subject, "parameters", made_from, [folder / "results" / "parameters.json"])
    first, *others = served.good("GET", address)["parameters"]
    assert first.startswith("Ranking at the estimate: ") and len(others) >= 3
    (folder / "results" / "estimate.json").write_text("{} ", encoding="utf-8")
    assert served.good("GET", address)["parameters"] == []


def test_a_picture_of_what_has_changed_since_is_not_shown(served, root):
    folder = root / "girl"
    (folder / "results").mkdir()
    for name in ("estimate.json", "sensitivity.png", "frames.png", "parameters.png"):
        (folder / "results" / name).write_bytes(b"{}")
    subject = read_unannotated(folder)
    of_frames = ["subject.json: pushes", "subject.json: roles"]
    for step, inputs in (("sensitivity", ["results/estimate.json"]), ("frames", of_frames)):
        record_step(subject, step, step_record(subject, inputs, {}), [folder / "results" / f"{step}.png"])
    address = f"/api/subjects/{served.key()}/results"

    def shown():
        return [one["name"] for one in served.good("GET", address)["pictures"]]

    assert shown() == ["sensitivity.png", "frames.png"]
    (folder / "results" / "estimate.json").write_text("{} ", encoding="utf-8")
    assert shown() == ["frames.png"]
    # What it proposed was taken: it shows the same as before.
    values = read_json(folder / "subject.json")
    roles = values["pushes"][0]["roles"]
    roles[-1] = "validation" if roles[-1] != "validation" else "unused"
    write_json(folder / "subject.json", values)
    assert shown() == ["frames.png"]
    values["pushes"][0]["level"] += 1.0
    write_json(folder / "subject.json", values)
    assert shown() == []
    values["pushes"][0]["level"] -= 1.0
    write_json(folder / "subject.json", values)
    assert shown() == ["frames.png"]
    (folder / "results" / "frames.png").write_bytes(b"of another run")
    assert shown() == []


@pytest.mark.parametrize(
    ("words", "page"),
    [
        ("run spinestiff estimate /data/girl again", "run it again"),
        ("of track: lost; run spinestiff track again, or spinestiff run", "of track: lost; run it again"),
        ("run spinestiff personalise and spinestiff estimate again", "run it again"),
        ("run spinestiff estimate '/a b/girl' again; else", "run it again; else"),
        ("name it there or, if it is at rest, with --frontal", "name it there or, if it is at rest, choose it below"),
        (
            "rays; if it is at rest name it with --lateral, if it shows a push in --pushes",
            "rays; if it is at rest choose it below, if it shows a push mark it with the others of that push",
        ),
    ],
)
def test_what_a_terminal_says_is_whole_on_the_page(words, page):
    assert page_words(words) == page
