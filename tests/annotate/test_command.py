"""``spinestiff annotate`` as a program: it prints its address, serves, ends at Ctrl-C, and refuses in one line."""

from __future__ import annotations

import errno
import http.client
import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from spinestiff.app import annotate as command
from spinestiff.errors import SubjectError
from spinestiff.loopback.serving import listening

PROGRAM = [sys.executable, "-c", "from spinestiff.app.cli import main; main()", "annotate"]


@pytest.mark.skipif(sys.platform == "win32", reason="no Ctrl-C to send to a program")
def test_it_serves_until_ctrl_c(unannotated):
    # Output to a pipe must come line by line, or whoever waits for the address waits for ever.
    running = subprocess.Popen(
        [*PROGRAM, str(unannotated), "--no-browser"], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    try:
        line = running.stdout.readline()
        port, token = re.fullmatch(r"annotate: http://127\.0\.0\.1:(\d+)/#([\w-]{40,})\n", line).groups()
        connection = http.client.HTTPConnection("127.0.0.1", int(port), timeout=20)
        connection.request("GET", "/api/session", headers={"x-spinestiff-token": token})
        assert connection.getresponse().status == 200
        connection.close()
        assert "saved at once" in running.stdout.readline()
        running.send_signal(signal.SIGINT)
        _, err = running.communicate(timeout=20)
    finally:
        running.kill()
    assert running.returncode == 0 and err == ""


def test_what_can_not_be_served_is_refused_in_one_line(unannotated):
    with listening(0) as taken:
        port = str(taken.getsockname()[1])
        done = subprocess.run(
            [*PROGRAM, str(unannotated), "--no-browser", "--port", port], capture_output=True, text=True, timeout=60
        )
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.count("\n") == 1 and f"port {port} can't be used" in done.stderr
    (unannotated / "subject.json").unlink()
    done = subprocess.run([*PROGRAM, str(unannotated)], capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.count("\n") == 1 and "subject.json: no such file; write one" in done.stderr


def test_a_browser_is_opened_only_where_there_is_one(monkeypatch):
    asked = []
    monkeypatch.setattr(command.webbrowser, "open", lambda address: asked.append(address) or True)
    monkeypatch.setattr(command.sys, "platform", "linux")
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    assert not command.opened("http://127.0.0.1:1/") and asked == []
    monkeypatch.setitem(os.environ, "DISPLAY", ":0")
    assert command.opened("http://127.0.0.1:1/") and asked == ["http://127.0.0.1:1/"]


def test_a_folder_that_can_not_be_written_is_refused_before_anything_is_served(unannotated, monkeypatch):
    def refuse(self, *args, **kwargs):
        raise OSError(errno.EROFS, "x", str(self))

    def serve(*args):
        raise AssertionError("it was served")

    monkeypatch.setattr(Path, "touch", refuse)
    monkeypatch.setattr("spinestiff.annotate.server.serve", serve)
    with pytest.raises(SubjectError, match=r"girl: can't be written \(the file system is read-only\), but marks go"):
        command.annotate_folder(unannotated, 0, False)


def test_without_marks_the_template_is_shown(unannotated, tmp_path):
    out = tmp_path / "page of a girl.html"
    folder = unannotated.rename(tmp_path / "a girl")
    done = subprocess.run(
        [*PROGRAM[:-1], "view", str(folder), "--out", str(out), "--no-open"], capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 0, done.stderr
    assert "the template of the subject’s sizes, at rest" in done.stdout
    # The command stands there as a terminal takes it.
    page = out.read_text(encoding="utf-8")
    assert f'spinestiff run "{folder}"' in done.stdout and "spinestiff run &#34;a girl&#34;" in page
    assert str(tmp_path) not in page
