"""What the workbench must not do, whoever asks: thirteen attacks."""

from __future__ import annotations

import errno
import io
import json
import os
import socket
import sqlite3
import struct
import subprocess
import sys
import time
import tracemalloc
import zipfile
from pathlib import Path
from types import SimpleNamespace
from urllib.parse import quote

import pytest
from fastapi.routing import APIRoute

from asking import wait_for
from hospital import CANARY as PATIENT
from hospital import disc, headed
from spinestiff.errors import NotThere, OptionError, SubjectError
from spinestiff.formats import parse_json
from spinestiff.loopback import guard, serving
from spinestiff.loopback.guard import LARGEST_BODY, PROXY_HEADER, TOKEN_HEADER
from spinestiff.workbench import rooms, uploads
from spinestiff.workbench import unzip as unzipping
from spinestiff.workbench.door import access_of, check_host
from spinestiff.workbench.job_process import COMMAND, run_job
from spinestiff.workbench.names import Names, harmless
from spinestiff.workbench.rooms import OWN, SPARE_BYTES, open_root
from spinestiff.workbench.server import application
from spinestiff.workbench.unzip import unzip
from spinestiff.workbench.verbs import VERBS, command_of
from unannotated import CANARY

POSIX = pytest.mark.skipif(os.name == "nt", reason="process groups and links as POSIX has them")


def routes(served):
    """Method and path of every route, with the subject's key where one is wanted."""
    for route in application(served.bench).routes:
        if isinstance(route, APIRoute):
            for method in route.methods:
                path = route.path.replace("{number}", "0").replace("{at}", "0")
                yield method, path.replace("{key}", served.key()).replace("{name}", "x").replace("{ticket}", "x")


# 1. Somebody without the token.


def test_nothing_is_given_or_taken_without_the_token(served):
    found = [(method, path) for method, path in routes(served) if "/api/" in path]
    found += [("GET", f"/annotate/{served.key()}/api/session"), ("PUT", f"/annotate/{served.key()}/api/annotation")]
    assert len(found) > 25
    for method, path in found:
        for token in ("", "x" * len(served.token), served.token[:-1]):
            status, _, body = served.ask(method, path, {} if method != "GET" else None, token=token)
            assert (status, set(json.loads(body))) == (403, {"error"}), (method, path)
        assert served.ask(method, path, headers={TOKEN_HEADER: None})[0] == 403
    assert (served.bench.root.path / "girl").is_dir()
    rest = {path for _, path in routes(served) if "/api/" not in path}
    assert rest == {"/", "/workbench.js", "/workbench.css", "/shown/x/x", "/parcel/x"}


# 2. A foreign name that leads here (DNS rebinding).


def test_a_foreign_host_is_refused(served):
    for host in ("evil.example", "127.0.0.1", "localhost:1", "evil.example:{port}", "127.0.0.1:{port}.x"):
        for path in ("/", "/api/subjects", "/shown/x/report.html"):
            status, _, _ = served.ask("GET", path, headers={"Host": host.format(port=served.port)})
            assert status == 421, (host, path)


# 3. A page of another site in the same browser.


def test_a_foreign_page_is_refused_even_with_the_token(served):
    for headers in (
        {"Origin": "http://evil.example"},
        {"Origin": "null"},
        {"Origin": "http://127.0.0.1:1"},
        {"Sec-Fetch-Site": "cross-site"},
        {"Sec-Fetch-Site": "same-site"},
    ):
        assert served.ask("GET", "/api/subjects", headers=headers)[0] == 403, headers
        assert served.ask("POST", "/api/uploads", {}, headers)[0] == 403, headers
    assert served.ask("GET", "/api/subjects", headers={"Origin": f"http://127.0.0.1:{served.port}"})[0] == 200


# 4. Names that climb out of their folder.

NASTY = [
    "../../evil.dcm", "/etc/evil.dcm", "C:\\windows\\evil.dcm", "a/../../../evil.dcm", "..", ".", "", "a\0b.dcm",
    "\\\\host\\share\\x", "con.dcm", "a/.ssh/authorized_keys", "x" * 2000, "a/" * 500 + "b", "~/evil", "a\nb",
    "ä ö/ü.dcm", "%2e%2e/evil", "a..", ". .",
]  # fmt: skip


def test_names_of_files_are_no_paths(served):
    for number, name in enumerate(NASTY):
        path = Path(harmless(name))
        assert not path.is_absolute() and ".." not in path.parts, name
        assert not any(part.startswith(".") for part in path.parts), name
        assert path.name and len(str(path)) < 1100 and "\\" not in str(path) and ":" not in str(path), name
        content = b"%09d" % number
        place = served.bench.uploads.place(served.upload({name: content, "b.dcm": b"y"}))
        files = (one for one in served.bench.root.path.parent.rglob("*") if one.is_file())
        inside = [one for one in files if one.stat().st_size == len(content) and one.read_bytes() == content]
        assert len(inside) == 1 and inside[0].resolve().is_relative_to(place / "files"), name


def test_a_name_that_is_harmless_stays_as_it_is():
    for name in ("A&P #1 [30 N]~.dcm", "it's/100%; ok!.dcm", "Mu\u0308ller.dcm", f"{'1.2.840.113619.' * 8}zip"):
        assert harmless(name) == name
    assert harmless(f"{'1.2.840.' * 40}zip") == f"{('1.2.840.' * 40)[:196]}.zip"
    assert harmless('a<b>c:d"e|f?g*h\x1bi\u202ej\u00a0k') == "a_b_c_d_e_f_g_h_i_j_k"


LONG = "\U00020bb7" * 90
CLASHING = {LONG: b"0", "DICOM": b"1", "DICOM/IM1": b"2", "dicom/IM2": b"3", "a/b/c": b"4", "A/B": b"5", "a/b/d": b"6"}


@pytest.mark.parametrize("as_zip", [False, True])
def test_files_and_folders_of_one_name_stay_apart_and_names_fit_the_disk(served, as_zip):
    key = served.upload({"all.zip": packed(CLASHING.items())} if as_zip else CLASHING)
    places = served.bench.uploads.whole(key)
    found = {path.relative_to(places[-1]).as_posix(): path.read_bytes() for path in places[-1].rglob("*")
             if path.is_file()}  # fmt: skip
    found = {name.removeprefix("0/"): content for name, content in found.items()}
    assert found == {"\U00020bb7" * 50: b"0", "DICOM": b"1", "DICOM-2/IM1": b"2", "dicom-2/IM2": b"3",
                     "a/b/c": b"4", "A/B-2": b"5", "a/b/d": b"6"}  # fmt: skip


def test_a_folder_of_a_files_name_is_one_folder_in_a_later_announcement_too(served):
    handed = served.bench.uploads
    key = handed.begin()
    handed.announce(key, [("DICOM", 1), ("DICOM/IM1", 1)])
    paths = [one["path"] for one in handed.announce(key, [("DICOM/IM2", 1), ("DICOM/IM1", 1)])]
    assert paths == ["DICOM", "DICOM-2/IM1", "DICOM-2/IM2", "DICOM-2/IM1-2"]


def test_what_has_come_of_an_upload_needs_no_room_again(served, monkeypatch):
    handed = served.bench.uploads
    key = handed.begin()
    handed.announce(key, [("a.dcm", 1000)])
    handed.piece(key, 0, 0, bytes(700))
    monkeypatch.setattr(uploads, "room_bytes", lambda _: 400)
    assert [one["come"] for one in handed.announce(key, [("b.dcm", 100)])] == [700, 0]
    with pytest.raises(SubjectError, match="no room on the disk for 2 MB"):
        handed.announce(key, [("c.dcm", 2 * 2**20)])


def test_a_name_that_comes_thousands_of_times_is_counted_on(monkeypatch):
    class Counted(set):
        asked = 0

        def __contains__(self, name):
            Counted.asked += 1
            return super().__contains__(name)

    names = Names(["a.dcm", "A-3.dcm"])
    names._taken = Counted(names._taken)
    found = [names.new(name) for name in 500 * ["a.dcm", "A.DCM"]]
    assert found[:3] == ["a-2.dcm", "A-4.DCM", "a-5.dcm"] and len({one.casefold() for one in found}) == 1000
    assert Counted.asked < 4000


def test_keys_and_tickets_are_no_paths(served):
    (served.bench.root.path.parent / "outside").mkdir()
    for name in ("..", "../outside", "girl", ".workbench", "%2e%2e", "..%2f..", "x" * 500):
        for path in (
            f"/api/subjects/{name}/form", f"/api/subjects/{name}/results", f"/api/uploads/{name}",
            f"/shown/{name}/report.html", f"/parcel/{name}", f"/api/trash/{name}/restore", f"/api/jobs/{name}/log",
            f"/annotate/{name}/api/session",
        ):  # fmt: skip
            method = "DELETE" if "uploads" in path else "POST" if "restore" in path else "GET"
            status, _, body = served.ask(method, quote(path, safe="/%"), {} if method == "POST" else None)
            assert status in (404, 405, 307), (path, status, body)
    ticket = served.good("GET", f"/api/subjects/{served.key()}/results")["ticket"]
    for name in ("..%2fsubject.json", "subject.json", "run.json", "estimate.json", "%2e%2e", "report.html"):
        assert served.ask("GET", f"/shown/{ticket}/{name}")[0] == 404, name
    for name in ("../x", ".hidden", "", "a/b", "CON?", "a" * 65):
        look = {"origin": "source", "key": "0" * 16, "name": name, "person": {}}
        assert served.ask("POST", "/api/subjects", look)[0] in (404, 422)
    with pytest.raises(SubjectError):
        served.bench.root.new_subject("../x")


def test_the_form_sets_no_path(served):
    key = served.key()
    form = served.good("GET", f"/api/subjects/{key}/form")
    for change in (
        lambda values: values["pushes"][0].update(frames="../../secret.dcm"),
        lambda values: values["pushes"][0].update(frames="rest/frontal.dcm"),
        lambda values: values["pushes"][0].update(id="other"),
        lambda values: values.update(torso="rest/frontal.dcm"),
        lambda values: values.update(skin_scan={"file": "x.stl", "unit": "mm", "axes": {}}),
    ):
        values = json.loads(json.dumps(form["values"]))
        change(values)
        sent = {"values": values, "revision": form["revision"]}
        status, body = served.json("PUT", f"/api/subjects/{key}/form", sent)
        assert status == 422 and "can't be changed here" in body["error"]
    assert served.good("GET", f"/api/subjects/{key}/form")["values"] == form["values"]


# 5. Links that lead out of the served folder.


@POSIX
def test_links_out_of_the_folder_are_not_followed(served, pristine, tmp_path):
    root, key = served.bench.root.path, served.key()
    secret = tmp_path / "secret.html"
    secret.write_text("secret", encoding="utf-8")
    (root / "linked").symlink_to(pristine, target_is_directory=True)
    assert [card["name"] for card in served.good("GET", "/api/subjects")["subjects"]] == ["girl"]
    results = root / "girl" / "results"
    results.mkdir()
    (results / "report.html").symlink_to(secret)
    found = served.good("GET", f"/api/subjects/{key}/results")
    assert found["pages"] == []
    status, _, body = served.ask("GET", f"/shown/{found['ticket']}/report.html")
    assert status == 422 and b"secret" not in body.replace(b"secret.html", b"")
    (root / "girl" / "notes.txt").symlink_to(secret)
    ticket = served.good("POST", f"/api/subjects/{key}/zip", {"nameless": False})["ticket"]
    _, _, packed = served.ask("GET", f"/parcel/{ticket}")
    with zipfile.ZipFile(io.BytesIO(packed)) as zipped:
        assert "subject.json" in zipped.namelist() and not {"notes.txt", "results/report.html"} & set(zipped.namelist())
    (root / "girl" / "rest" / "frontal.dcm").unlink()
    (root / "girl" / "rest" / "frontal.dcm").symlink_to(pristine / "rest" / "frontal.dcm")
    assert served.ask("POST", f"/api/subjects/{key}/zip", {"nameless": True, "burned_in_ok": True})[0] == 422


# 6. A zip file that becomes a thousand times as large.


def packed(entries, **options):
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as zipped:
        for name, what in entries:
            zipped.writestr(name, what, **options)
    return content.getvalue()


def test_a_zip_bomb_is_refused_and_leaves_nothing(served, tmp_path):
    bomb = packed((f"{i}.dcm", bytes(4 * 2**20)) for i in range(12))
    assert len(bomb) < 100_000
    key = served.upload({"bomb.zip": bomb})
    status, body = served.json("POST", "/api/look", {"origin": "upload", "key": key})
    assert status == 422 and "more than radiographs do" in body["error"]
    assert not (served.bench.uploads.place(key) / "unpacked" / "0").exists()


def test_zip_files_share_one_limit_however_late_they_come(root, serve):
    archive = packed([("a", os.urandom(3 * 2**20))])
    with serve(root, upload_bytes=11 * 2**20) as served:
        key = served.upload({"a.zip": archive})
        uploads = served.bench.uploads
        uploads.whole(key)
        uploads.announce(key, [("b.zip", len(archive))])
        for at in range(0, len(archive), 2**20):
            uploads.piece(key, 1, at, archive[at : at + 2**20])
        with pytest.raises(SubjectError, match="becomes larger than 1 MB"):
            uploads.whole(key)
        assert not (uploads.place(key) / "unpacked" / "1").exists()


def test_a_zip_file_whose_unpacking_was_killed_is_unpacked_anew(root, serve, monkeypatch):
    archive = packed((name, os.urandom(2**20)) for name in "abc")
    with serve(root, upload_bytes=2 * len(archive) + 2**10) as served:
        key, uploads, new = served.upload({"a.zip": archive}), served.bench.uploads, Names.new

        def twice(names, name):
            if name == "c":
                raise KeyboardInterrupt
            return new(names, name)

        with monkeypatch.context() as killed:
            killed.setattr(Names, "new", twice)
            killed.setattr(unzipping.shutil, "rmtree", lambda *_, **__: None)  # which nobody does who is killed
            with pytest.raises(KeyboardInterrupt):
                uploads.whole(key)
        (_, unpacked) = uploads.whole(key)
        assert sorted(one.relative_to(unpacked).as_posix() for one in unpacked.rglob("*")) == ["0", "0/a", "0/b", "0/c"]


def test_a_zip_file_leaves_room_on_the_disk(served, monkeypatch):
    key = served.upload({"a.zip": packed([("a", os.urandom(3 * 2**20))])})
    free = SPARE_BYTES + 2 * 2**20
    monkeypatch.setattr(rooms.shutil, "disk_usage", lambda _: SimpleNamespace(free=free))
    with pytest.raises(SubjectError, match=r"becomes larger than 2 MB when it is unpacked, .* or there is room for"):
        served.bench.uploads.whole(key)
    free += 2**20
    assert len(served.bench.uploads.whole(key)) == 2


def test_a_zip_file_is_not_believed(tmp_path, monkeypatch):
    archive, target = tmp_path / "a.zip", tmp_path / "out"
    archive.write_bytes(packed([("../../evil.dcm", b"x"), ("a/../b", b"y"), ("/c", b"z")]))
    assert unzip(archive, target, 2**20) == 3
    assert (
        all(path.resolve().is_relative_to(target) for path in target.rglob("*"))
        and not (tmp_path / "evil.dcm").exists()
    )
    link = zipfile.ZipInfo("link")
    link.external_attr = 0o120777 << 16
    archive.write_bytes(packed([(link, "/etc/passwd"), ("a", b"x")]))
    assert unzip(archive, tmp_path / "two", 2**20) == 1
    archive.write_bytes(packed([("a", os.urandom(3 * 2**20))]))
    with pytest.raises(SubjectError, match="larger than 2 MB"):
        unzip(archive, tmp_path / "three", 2 * 2**20)
    monkeypatch.setattr(unzipping, "MOST_FILES", 3)
    archive.write_bytes(packed((str(i), b"x") for i in range(4)))
    with pytest.raises(SubjectError, match="more than 3 files"):
        unzip(archive, tmp_path / "four", 2**20)
    for content in (b"no zip", packed([("a", b"x" * 100)])[:60]):
        archive.write_bytes(content)
        with pytest.raises(SubjectError, match="damaged, or no zip file"):
            unzip(archive, tmp_path / "five", 2**20)
    # A damaged stream inside a sound list of entries; methods of which a piece is unpacked without limit.
    whole = bytearray(packed([("first", os.urandom(100)), ("second", bytes(range(256)) * 40)]))
    begin = whole.index(b"second") + len("second")
    whole[begin : begin + 20] = b"\xff" * 20
    archive.write_bytes(whole)
    with pytest.raises(SubjectError, match="damaged, or no zip file"):
        unzip(archive, tmp_path / "six", 2**20)
    for method in (zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA):
        with zipfile.ZipFile(archive, "w", method) as zipped:
            zipped.writestr("a", b"0" * 2**20)
        with pytest.raises(SubjectError, match="packed by an unusual method"):
            unzip(archive, tmp_path / "seven", 2**24)
    assert {path.name for path in tmp_path.iterdir()} == {"a.zip", "out", "two"}


def test_a_zip_file_that_can_not_be_unpacked_here_is_not_called_damaged(tmp_path, monkeypatch):
    def full(*_, **__):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    archive = tmp_path / "a.zip"
    archive.write_bytes(packed([("a", b"x")]))
    monkeypatch.setattr(Path, "mkdir", full)
    with pytest.raises(SubjectError, match=r"can't be unpacked \(the disk is full\)"):
        unzip(archive, tmp_path / "out", 2**20)


@pytest.mark.skipif(sys.platform == "win32", reason="folders of one account")
def test_its_own_folder_is_nobody_elses_to_read(root, serve):
    (root / OWN).mkdir(mode=0o755)
    with serve(root):
        assert (root / OWN).stat().st_mode & 0o777 == 0o700


@pytest.mark.skipif(sys.platform == "win32", reason="folders of one account")
def test_a_zip_file_is_nobody_elses_to_read_where_nothing_is_changed(root, serve):
    with serve(root, read_only=True) as served:
        served.good("POST", f"/api/subjects/{served.key()}/zip", {"nameless": False})
        assert served.bench.parcels.folder.stat().st_mode & 0o777 == 0o700


def test_many_keys_with_one_twice_are_refused_without_comparing_all():
    """Each with all others would take minutes, during which nobody else is answered."""
    keys = ", ".join(f'"{i}": 0' for i in range(200_000))
    with pytest.raises(SubjectError, match="key '199999' is given twice"):
        parse_json(f'{{{keys}, "199999": 1}}', "the request")


def test_a_list_of_entries_without_end_is_not_read(tmp_path):
    """A hundred thousand entries of 55 bytes each, more than there may be: refused before they are in memory."""
    entry = struct.pack("<4s6H3L5H2L", b"PK\x01\x02", 20, 20, 0, 0, 0, 0, 0, 0, 0, 9, 0, 0, 0, 0, 0, 0)
    listed = b"".join(entry + b"%09d" % number for number in range(100_000))
    end = struct.pack("<4s4H2LH", b"PK\x05\x06", 0, 0, 65535, 65535, len(listed), 0, 0)
    (tmp_path / "a.zip").write_bytes(listed + end)
    tracemalloc.start()
    try:
        with pytest.raises(SubjectError, match="larger than 5 MB, more than 20000 files need"):
            unzip(tmp_path / "a.zip", tmp_path / "out", 2**30)
        assert tracemalloc.get_traced_memory()[1] < 2**20
    finally:
        tracemalloc.stop()
    assert not (tmp_path / "out").exists()


# 7. More than anybody has radiographs.


def test_large_bodies_and_uploads_are_refused(served, root):
    assert served.ask("POST", "/api/check", None, {"Content-Length": str(LARGEST_BODY + 1)})[0] == 413
    key = served.good("POST", "/api/uploads", {})["key"]
    many = [{"name": str(i), "size": 0} for i in range(20_001)]
    assert served.ask("POST", f"/api/uploads/{key}/files", {"files": many})[0] == 422
    large = [{"name": f"{i}.zip", "size": served.bench.uploads.most_bytes // 2} for i in range(3)]
    assert "at most 8 GB" in served.json("POST", f"/api/uploads/{key}/files", {"files": large})[1]["error"]
    assert (
        "at most"
        in served.json("POST", f"/api/uploads/{key}/files", {"files": [{"name": "a", "size": 2**40}]})[1]["error"]
    )
    served.good("POST", f"/api/uploads/{key}/files", {"files": [{"name": "a", "size": 3}]})
    assert served.ask("PUT", f"/api/uploads/{key}/files/0/0", b"four")[0] == 422
    assert served.ask("PUT", f"/api/uploads/{key}/files/0/1", b"x")[0] == 409
    assert served.ask("PUT", f"/api/uploads/{key}/files/1/0", b"x")[0] == 404
    assert served.ask("PUT", f"/api/uploads/{key}/files/-1/0", b"x")[0] == 404
    assert served.ask("PUT", f"/api/uploads/{key}/files/0/0", b"x" * (2 * 2**20 + 1))[0] == 422


# 8. Requests that trickle.


def test_slow_heads_and_bodies_are_cut_off(root, serve, monkeypatch):
    monkeypatch.setattr(serving, "HEAD_S", 0.6)
    monkeypatch.setattr(guard, "BODY_S", 0.6)
    with serve(root) as served:
        began = time.monotonic()
        cut = pytest.raises((BrokenPipeError, ConnectionResetError, ConnectionAbortedError))
        with socket.create_connection(("127.0.0.1", served.port), timeout=10) as sock, cut:
            for letter in "GET / HTTP/1.1\r\nHost: " + "x" * 1000:
                sock.sendall(letter.encode())
                time.sleep(0.05)
        assert 0.4 < time.monotonic() - began < 5
        with socket.create_connection(("127.0.0.1", served.port), timeout=10) as sock:
            head = f"POST /api/check HTTP/1.1\r\nHost: 127.0.0.1:{served.port}\r\n{TOKEN_HEADER}: {served.token}\r\n"
            sock.sendall(f"{head}Content-Length: 1000\r\n\r\n{{".encode())
            assert sock.recv(1000).split()[1] == b"408"
        # Somebody who asks in time is answered, again and again on one connection, with pauses.
        with socket.create_connection(("127.0.0.1", served.port), timeout=10) as sock:
            for _ in range(3):
                sock.sendall(f"GET / HTTP/1.1\r\nHost: 127.0.0.1:{served.port}\r\n\r\n".encode())
                assert sock.recv(100).split()[1] == b"200"
                while sock.recv(2**16)[-8:] != b"</html>\n":
                    pass
                time.sleep(0.8)


def test_who_does_not_read_what_was_asked_for_is_let_go(root, serve, monkeypatch):
    """Two hundred answers in a row, more than any buffer between the two holds."""
    monkeypatch.setattr(serving, "UNREAD_S", 0.5)
    with serve(root) as served:
        request = f"GET /workbench.js HTTP/1.1\r\nHost: 127.0.0.1:{served.port}\r\n\r\n".encode()
        _, _, body = served.ask("GET", "/workbench.js")
        assert len(body) > 50_000
        with socket.create_connection(("127.0.0.1", served.port), timeout=20) as sock:
            sock.sendall(request * 200)
            time.sleep(3.0)
            received = 0
            try:
                while piece := sock.recv(2**20):
                    received += len(piece)
            except ConnectionResetError:
                pass
        assert 0 < received < 190 * len(body)
        assert served.ask("GET", "/workbench.js")[0] == 200


# 9. Options of a job that are more than options.


def test_jobs_take_no_arguments_but_their_own(served):
    path = f"/api/subjects/{served.key()}/jobs"
    for asked in (
        {"verb": "run; rm -rf .", "options": {}},
        {"verb": "deidentify", "options": {}},
        {"verb": "run", "options": {"mesh": "fine --truth=/etc/passwd"}},
        {"verb": "run", "options": {"mesh": "$(id)"}},
        {"verb": "run", "options": {"truth": "x"}},
        {"verb": "run", "options": {"redo": "yes"}},
        {"verb": "run", "options": {"mesh": True}},
        {"verb": "plan", "options": {"limit": "80"}},
        {"verb": "plan", "options": {"limit": 1e9}},
        {"verb": "plan", "options": {"exposures": 2.5}},
        {"verb": "plan", "options": {"limit": True}},
        {"verb": "run", "options": {}, "folder": "/etc"},
        {"verb": "run", "options": {"mesh": ["fine"]}},
    ):
        assert served.ask("POST", path, asked)[0] == 422, asked
    assert served.bench.jobs.table.jobs() == []
    assert command_of("run", {"mesh": "coarse", "redo": False}) == ["run", ".", "--mesh=coarse"]
    assert command_of("plan", {"limit": 60, "exposures": 4}) == ["plan", ".", "--limit=60.0", "--exposures=4"]
    with pytest.raises(OptionError):
        command_of("plan", {"limit": float("nan")})


@pytest.mark.parametrize("at", ["-1", str(2**63), str(2**63 - 1), "9" * 5000, "1.5", "end", "", "%00"])
@pytest.mark.parametrize("what", ["log", "events"])
def test_a_log_is_read_from_a_place_in_it_or_not_at_all(served, what, at):
    job = served.good("POST", f"/api/subjects/{served.key()}/jobs", {"verb": "run", "options": {}})["id"]
    served.good("POST", f"/api/jobs/{job}/cancel", {})
    log = served.bench.jobs.log(job)
    log.parent.mkdir(exist_ok=True)
    log.write_text("a line\nand another\n", encoding="utf-8")
    status, body = served.json("GET", f"/api/jobs/{job}/{what}?at={at}")
    assert (status, body["error"][:48]) == (422, "the request is not one of this page's: at: found")
    assert served.ask("GET", f"/api/jobs/{job}/{what}")[0] == 200
    assert served.good("GET", f"/api/jobs/{job}/log?at=7") == {"lines": ["and another"], "at": 19}
    assert served.good("GET", f"/api/jobs/{job}/log?at=4000000") == {"lines": [], "at": 4000000}


def test_every_verb_is_a_command_with_these_options():
    from typer.main import get_group

    from spinestiff.app.cli import app

    commands = get_group(app).commands
    for name, verb in VERBS.items():
        known = {option for parameter in commands[name].params for option in parameter.opts}
        assert {f"--{option}" for option in verb.options} <= known, name


# 10. Markup in names.


def test_no_page_runs_what_a_name_holds(served, root):
    page = served.ask("GET", "/")
    policy = page[1]["content-security-policy"]
    assert "script-src 'self';" in policy and "unsafe" not in policy and "frame-ancestors 'none'" in policy
    (root / "girl" / "results").mkdir()
    (root / "girl" / "results" / "report.html").write_text("<script>parent.document</script>", encoding="utf-8")
    ticket = served.good("GET", f"/api/subjects/{served.key()}/results")["ticket"]
    status, headers, _ = served.ask("GET", f"/shown/{ticket}/report.html", headers={TOKEN_HEADER: None})
    assert status == 200 and headers["content-security-policy"].startswith("sandbox allow-scripts")
    assert "allow-same-origin" not in headers["content-security-policy"]
    assert (
        "default-src 'none'" in headers["content-security-policy"]
        and "connect-src" not in headers["content-security-policy"]
    )
    (root / "<img src=x onerror=alert(1)>").mkdir()
    (root / "<img src=x onerror=alert(1)>" / "subject.json").write_text("{}", encoding="utf-8")
    _, headers, body = served.ask("GET", "/api/subjects")
    assert headers["content-type"] == "application/json" and headers["x-content-type-options"] == "nosniff"
    assert any(card["name"].startswith("<img") for card in json.loads(body)["subjects"])


# 11. Jobs whose children outlive them.

STUB = """
import subprocess, sys, time, signal
signal.signal(signal.SIGTERM, signal.SIG_IGN)
stubborn = 'import signal, time; signal.signal(signal.SIGTERM, signal.SIG_IGN); time.sleep(600)'
child = subprocess.Popen([sys.executable, '-c', stubborn])
print('ready', child.pid, flush=True)
time.sleep(600)
"""


WATCHED = """
import subprocess, time
import spinestiff.app.start as start

def main():
    print(subprocess.Popen(['sleep', '600']).pid, flush=True)
    time.sleep(600)

start.main = main
from spinestiff.app.job import main
main()
"""


def alive(pid):
    try:
        with open(f"/proc/{pid}/stat", encoding="utf-8") as file:
            return file.read().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="looks at /proc")
def test_a_cancelled_job_takes_its_children_along(served, root):
    import threading

    table, folder = served.bench.jobs.table, root / "girl"
    job = table.add(served.key(), "run", {})
    assert table.take(1).id == job.id
    log = root / "log"
    command = (sys.executable, "-c", STUB)
    work = (table, job.id, folder, [], log, command)
    thread = threading.Thread(target=run_job, args=work, daemon=True)
    thread.start()
    wait_for(lambda: log.exists() and b"ready" in log.read_bytes())
    child = int(log.read_text(encoding="utf-8").split()[1])
    assert alive(child)
    assert served.good("POST", f"/api/jobs/{job.id}/cancel", {})["cancel"]
    thread.join(timeout=30)
    assert table.job(job.id).state == "cancelled" and not alive(child)


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="looks at /proc")
def test_a_command_ends_with_the_process_that_watches_over_it(tmp_path):
    """Also where that is killed: the command's input ends, and it ends its group."""
    process = subprocess.Popen(
        [sys.executable, "-c", WATCHED], stdin=subprocess.PIPE, stdout=subprocess.PIPE, start_new_session=True
    )
    process.stdin.write(b"subject\n")
    process.stdin.flush()
    child = int(process.stdout.readline())
    assert alive(child)
    process.stdin.close()
    process.wait(timeout=20)
    process.stdout.close()
    wait_for(lambda: not alive(child))


# 12. A subject's folder with code and settings for the libraries that a job uses.


def test_a_job_reads_no_code_or_settings_from_its_subjects_folder(root, served):
    job = served.bench.jobs.table.add(served.key(), "run", {})
    assert served.bench.jobs.table.take(1).id == job.id
    folder, mark = root / "girl", root / "reached"
    for name in ("spinestiff", "json", "numpy", "matplotlib"):
        (folder / name).mkdir()
        (folder / name / "__init__.py").write_text(f"open({str(mark)!r}, 'w')", encoding="utf-8")
    (folder / "sitecustomize.py").write_text(f"open({str(mark)!r}, 'w')", encoding="utf-8")
    (folder / "matplotlibrc").write_text("backend: of_the_folder", encoding="utf-8")
    code = "import matplotlib; print('backend', matplotlib.rcParamsOrig['backend']); "
    command = (*COMMAND[:-2], "-c", code + "from spinestiff.app.job import main; main()")
    state = run_job(served.bench.jobs.table, job.id, folder, ["inspect", "."], root / "log", command)
    told = (root / "log").read_text(encoding="utf-8")
    assert not mark.exists() and "of_the_folder" not in told and "Traceback" not in told
    assert state in ("done", "failed") and told.startswith("backend ") and "rest/frontal" in told


# 13. Whose spine it is, in logs, addresses, the table, titles.


def test_nothing_of_the_patient_is_in_logs_addresses_or_the_table(root, serve, tmp_path):
    export = disc(tmp_path / PATIENT.replace("^", "_"))
    for path in (export / "DICOM").rglob("IM*"):
        headed(path, path, time=None, StudyDescription=PATIENT)
    with serve(root, jobs=True) as served:
        upload = served.upload_folder(export)
        look = served.good("POST", "/api/look", {"origin": "upload", "key": upload})
        assert len(look["files"]) == 4 and "DOE" not in json.dumps(look["studies"]).replace("DOE_JANE", "")
        asked = {"origin": "upload", "key": upload, "name": "DOE_JANE", "person": {}}
        key = served.good("POST", "/api/subjects", asked)["key"]
        assert "DOE" not in key and not served.bench.uploads.folder.joinpath(upload).exists()
        job = served.good("POST", f"/api/subjects/{key}/jobs", {"verb": "run", "options": {}})["id"]
        assert served.until(job, "failed").status == 2
        lines = served.good("GET", f"/api/jobs/{job}/log")["lines"]
        assert any("age is missing" in line for line in lines)
    own = root / OWN
    content = b"".join(path.read_bytes() for path in own.rglob("*") if path.is_file())
    assert (own / "logs" / f"{job}.log").stat().st_size > 100
    for word in (b"DOE", b"JANE", PATIENT.encode(), *(part.encode() for part in CANARY.split("^"))):
        assert word not in content, word
    with sqlite3.connect(own / "jobs.sqlite") as table:
        rows = table.execute("SELECT * FROM job").fetchall()
    table.close()
    assert len(rows) == 1 and key in rows[0] and "DOE" not in repr(rows)
    page = (Path(__file__).parents[2] / "src/spinestiff/workbench/page/index.html").read_text(encoding="utf-8")
    assert "<title>spinestiff workbench</title>" in page


# 13. Others in the network.


def test_a_public_address_is_refused_without_a_proxy(tmp_path):
    for host in ("0.0.0.0", "192.168.1.5", "::", "8.8.8.8"):
        with pytest.raises(OptionError, match=r"--host .*: others could reach it.*--proxy and"):
            check_host(host, None)
        check_host(host, "https://spine.example.org")
    for host in ("127.0.0.1", "localhost"):
        check_host(host, None)
    with pytest.raises(OptionError, match=r"wanted 127\.0\.0\.1 or localhost"):
        check_host("::1", None)
    with pytest.raises(OptionError, match="wanted an address"):
        check_host("spine.example.org", None)
    short = tmp_path / "secret"
    short.write_text("short", encoding="utf-8")
    for proxy, secret in (("https://spine.example.org", None), (None, short), ("https://spine.example.org", short)):
        with pytest.raises(OptionError):
            access_of(1, proxy, secret, False)
    short.write_text("s" * 40, encoding="utf-8")
    for proxy in (
        "spine.example.org",
        "ftp://x",
        "https://a/b",
        "https://a@b",
        "https://a?b",
        "https://a#b",
        "https://[",
    ):
        with pytest.raises(OptionError, match=r"wanted an origin|wanted a host"):
            access_of(1, proxy, short, False)


@pytest.mark.parametrize(
    ("proxy", "host", "origin"),
    [
        ("https://Spine.Example.org/", "spine.example.org", "https://spine.example.org"),
        ("HTTPS://spine.example.org:443", "spine.example.org", "https://spine.example.org"),
        ("http://spine.example.org:80", "spine.example.org", "http://spine.example.org"),
        ("https://spine.example.org:8443", "spine.example.org:8443", "https://spine.example.org:8443"),
    ],
)
def test_a_proxys_origin_is_as_browsers_send_it(tmp_path, proxy, host, origin):
    secret = tmp_path / "secret"
    secret.write_text("s" * 40, encoding="utf-8")
    assert access_of(1, proxy, secret, False).origins == {host: origin}


def test_behind_a_proxy_nobody_comes_past_it(root, serve, tmp_path):
    secret = tmp_path / "secret"
    secret.write_text("s" * 40 + "\n", encoding="utf-8")
    with serve(root, proxy="https://spine.example.org", secret=secret) as served:
        good = {"Host": "spine.example.org", PROXY_HEADER: "s" * 40, "Origin": "https://spine.example.org"}
        for path in ("/", "/api/subjects"):
            assert served.ask("GET", path, headers=good)[0] == 200
            assert served.ask("GET", path, headers={**good, PROXY_HEADER: None})[0] == 403
            assert served.ask("GET", path, headers={**good, PROXY_HEADER: "s" * 39})[0] == 403
            assert served.ask("GET", path, headers={**good, "Host": f"127.0.0.1:{served.port}"})[0] == 421
            assert served.ask("GET", path, headers={**good, "Origin": "http://spine.example.org"})[0] == 403
        # A form of another site can't send the page's header.
        assert served.ask("GET", "/api/subjects", headers={**good, TOKEN_HEADER: None})[0] == 403


# And somebody who may look, but change nothing.


def test_read_only_changes_nothing(root, serve):
    before = {path: path.stat().st_mtime_ns for path in root.rglob("*")}
    with serve(root, read_only=True) as served:
        key = served.key()
        for method, path in routes(served):
            if method in ("POST", "PUT", "DELETE") and not path.endswith(("/api/check", "/log", "/zip")):
                assert served.ask(method, path, {})[0] == 403, path
        assert served.ask("PUT", f"/annotate/{key}/api/annotation", {})[0] == 403
        for path in ("/api/subjects", f"/api/subjects/{key}/form", f"/api/subjects/{key}/jobs", "/api/trash"):
            assert served.ask("GET", path)[0] == 200, path
        assert served.ask("GET", f"/annotate/{key}/api/session")[0] == 200
    assert {path: path.stat().st_mtime_ns for path in root.rglob("*")} == before


def test_a_folder_that_is_a_subject_is_not_served(root):
    with pytest.raises(SubjectError, match="is a subject itself; wanted the folder around it"):
        open_root(root / "girl")
    with pytest.raises(NotThere):
        open_root(root).subject("0" * 16)
