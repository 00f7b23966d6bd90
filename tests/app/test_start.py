"""How the program ends when its surroundings do: Ctrl-C while it starts, outputs that are closed, full or left."""

from __future__ import annotations

import io
import os
import subprocess
import sys

import pytest

from hospital import export
from spinestiff.app.start import _open_standard_files

pytestmark = pytest.mark.skipif(os.name == "nt", reason="signals, pipes and devices of Unix")
PROGRAM = [sys.executable, "-c", "from spinestiff.app.start import main; main()"]


def shell(line: str) -> subprocess.CompletedProcess[str]:
    """A line of shell in which "$@" is the program."""
    return subprocess.run(
        ["bash", "-c", f"set -o pipefail; {line}", "bash", *PROGRAM], capture_output=True, text=True, timeout=60,
        check=False,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("line", "status", "err"),
    [
        # A reader that has left before the first line: what is written has nowhere to go.
        ('(sleep 1; "$@" torso show) | true', 141, ""),
        ('(sleep 1; "$@" doctor) | true', 141, ""),
        ('"$@" torso show >&-', 0, ""),
        ('"$@" doctor >&-', 0, ""),
        ('"$@" run nobody >&- 2>&-', 2, ""),
        ('"$@" torso show <&-', 0, ""),
        ('"$@" torso show > /dev/full', 2, "spinestiff: the output: can't be written (the disk is full)\n"),
        ('"$@" --version > /dev/full', 2, "spinestiff: the output: can't be written (the disk is full)\n"),
    ],
)
def test_an_output_that_takes_nothing(line, status, err):
    if "/dev/full" in line and not os.path.exists("/dev/full"):
        pytest.skip("a device of Linux")
    ended = shell(line)
    assert (ended.returncode, ended.stderr) == (status, err)


@pytest.mark.skipif(sys.platform == "darwin", reason="names of files are UTF-8 there")
@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("inspect in", r"not one sequence: M\udcfcller b.dcm"),
        ("init girl in --no-questions", r"M\udcfcller a.dcm 1 0 rest, frontal"),
        ('init "$(printf "M\\374ller")" in --no-questions --id girl', r"next: spinestiff annotate M\udcfcller"),
    ],
)
def test_names_of_files_that_are_no_text_are_told_by_their_codes(tmp_path, line, words):
    """As in the UTF-8 locale of a country, where Python refuses to print such a name."""
    for name, kind in ((b"M\xfcller a.dcm", "frontal"), (b"M\xfcller b.dcm", "lateral")):
        export(tmp_path / "in" / kind, kind).rename(tmp_path / "in" / os.fsdecode(name))
    ended = shell(f"cd '{tmp_path}'; export PYTHONIOENCODING=utf-8:strict; \"$@\" {line}")
    assert (ended.returncode, "Traceback" in ended.stderr) == (0, False)
    assert words in " ".join(ended.stdout.split())


@pytest.mark.parametrize(
    ("encoding", "errors", "written"),
    [
        ("ascii", "surrogateescape", b"12\\xb0 M\\udcfcller"),
        ("latin-1", "strict", b"12\xb0 M\\udcfcller"),
        ("utf-8", "surrogateescape", b"12\xc2\xb0 M\xfcller"),
    ],
)
def test_signs_that_an_output_lacks_are_told_by_their_codes(monkeypatch, encoding, errors, written):
    """The first as Python has it where ``LC_ALL`` is C and its UTF-8 mode is off."""
    taken = io.BytesIO()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(taken, encoding=encoding, errors=errors))
    _open_standard_files()
    print("12° M\udcfcller", end="", flush=True)
    assert taken.getvalue() == written


def test_an_output_that_is_no_file_stays_as_it_is(monkeypatch):
    """As where another program takes what is printed."""

    class Taking:
        def write(self, text):
            return len(text)

    taking = Taking()
    monkeypatch.setattr(sys, "stdout", taking)
    _open_standard_files()
    assert sys.stdout is taking


@pytest.mark.parametrize("place", ["typer", "numpy", "scipy.sparse"])
def test_ctrl_c_while_something_is_imported_is_one_line(place):
    """The import of one package is where the signal comes."""
    code = f"""
import importlib.abc, os, signal, sys
class Interrupting(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name == {place!r}:
            os.kill(os.getpid(), signal.SIGINT)
sys.meta_path.insert(0, Interrupting())
sys.argv = ["spinestiff", "doctor"]
from spinestiff.app.start import main
main()
"""
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False)
    assert (ended.returncode, ended.stdout) == (130, "")
    assert ended.stderr == "spinestiff: stopped; results of finished steps are kept\n"


def test_python_runs_it_by_its_name():
    """Where the installed program is not on the path."""
    found = subprocess.run(
        [sys.executable, "-m", "spinestiff", "--version"], capture_output=True, text=True, check=True
    )
    assert found.stdout == subprocess.run([*PROGRAM, "--version"], capture_output=True, text=True, check=True).stdout
