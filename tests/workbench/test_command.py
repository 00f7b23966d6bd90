"""``spinestiff serve`` as a program: it prints its address, serves, ends at Ctrl-C, and refuses in one line."""

from __future__ import annotations

import http.client
import re
import signal
import subprocess
import sys

import pytest

from spinestiff.app.cli import main

PROGRAM = [sys.executable, "-c", "from spinestiff.app.cli import main; main()", "serve"]


@pytest.mark.skipif(sys.platform == "win32", reason="no Ctrl-C to send to a program")
def test_it_serves_until_ctrl_c_whoever_listens(root, tmp_path):
    running = subprocess.Popen(
        [*PROGRAM, str(root), "--no-browser"], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    try:
        line = running.stdout.readline()
        port, token = re.fullmatch(r"serve: http://127\.0\.0\.1:(\d+)/#([\w-]{40,})\n", line).groups()
        headers = {"x-spinestiff-token": token}
        connection = http.client.HTTPConnection("127.0.0.1", int(port), timeout=30)
        connection.request("GET", "/api/subjects", headers=headers)
        answer = connection.getresponse()
        assert answer.status == 200 and b'"girl"' in answer.read()
        assert "Ctrl-C ends it; jobs that run go on" in running.stdout.readline()
        running.send_signal(signal.SIGINT)
        _, err = running.communicate(timeout=30)
        connection.close()
    finally:
        running.kill()
    assert running.returncode == 0 and err == ""


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--host", "0.0.0.0"), "others could reach it"),
        (("--proxy", "https://spine.example.org"), "belong together"),
        (("--source", "{root}/nothing"), "no such folder"),
        (("{root}/girl",), "is a subject itself"),
        (("--read-only", "{root}/nothing"), "no such folder"),
        (("{root}/girl/subject.json",), "subject.json: no folder; wanted one with subject folders in it"),
    ],
)
def test_what_can_not_be_served_is_refused_in_one_line(root, arguments, words, monkeypatch, capsys):
    found = [one.format(root=root) for one in arguments]
    place = [] if str(root) in found[-1] and found[0] != "--source" else [str(root)]
    monkeypatch.setattr(sys, "argv", ["spinestiff", "serve", *found, *place, "--no-browser"])
    with pytest.raises(SystemExit) as end:
        main()
    out, err = capsys.readouterr()
    assert (end.value.code, out) == (2, "")
    assert err.count("\n") == 1 and words in err
