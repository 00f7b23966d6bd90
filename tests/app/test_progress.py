"""Progress lines: all of them in a log, a live one on a terminal, none when quiet."""

from __future__ import annotations

import io

import pytest
import rich.console

from spinestiff.app.progress import progress

LINES = ("track: frame 1", "track: frame 2", "warning: 80 N", "estimate: [1] of [/2]", "report: up to date")


def test_a_log_gets_every_line_with_its_time(capsys):
    with progress() as say:
        for line in LINES:
            say(line)
    out, err = capsys.readouterr()
    assert out == ""
    lines = err.splitlines()
    assert len(lines) == len(LINES)
    for found, line in zip(lines, LINES):
        seconds, unit, text = found.split(maxsplit=2)
        assert (float(seconds) >= 0.0, unit, text) == (True, "s", line)


def test_a_long_line_stays_one(capsys):
    with progress() as say:
        say("estimate: " + "x" * 400)
    assert len(capsys.readouterr().err.splitlines()) == 1


def test_quiet_says_nothing(capsys):
    with progress(quiet=True) as say:
        say("track: frame 1")
    assert capsys.readouterr() == ("", "")


def test_a_terminal_keeps_the_last_line_of_a_step_and_every_warning(monkeypatch):
    written = io.StringIO()
    console = rich.console.Console

    def terminal(**kwargs):
        return console(file=written, force_terminal=True, width=100, color_system=None, highlight=False)

    monkeypatch.setattr(rich.console, "Console", terminal)
    with progress() as say:
        for line in LINES:
            say(line)
    kept = [line for line in written.getvalue().splitlines() if " s  " in line]
    assert [line.split(" s  ")[1].strip() for line in kept] == [
        "track: frame 2",
        "warning: 80 N",
        "estimate: [1] of [/2]",
        "report: up to date",
    ]


def test_an_error_passes_through(capsys):
    with pytest.raises(ValueError, match="mine"), progress() as say:
        say("track: frame 1")
        raise ValueError("mine")
    assert "frame 1" in capsys.readouterr().err
