"""Progress lines: all of them in a log, a live one on a terminal, none when quiet."""

from __future__ import annotations

import io
import time

import pytest
import rich.console

from spinestiff.app.progress import LONGEST_SILENCE_S, beating, progress
from spinestiff.app.volume import Volume, speaking

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
    with speaking(Volume(quiet=True)), progress() as say:
        say("track: frame 1")
        say("warning: 80 N")
    out, err = capsys.readouterr()
    assert out == "" and err.split(maxsplit=2)[2] == "warning: 80 N\n"


def test_a_log_hears_of_a_step_that_takes_long(capsys, monkeypatch):
    monkeypatch.setattr("spinestiff.app.progress.LONGEST_SILENCE_S", 0.2)
    with progress() as say:
        time.sleep(0.3)
        say("estimate: evaluation 0")
        time.sleep(0.5)
    lines = [line.split(maxsplit=2)[2] for line in capsys.readouterr().err.splitlines()]
    assert lines[0] == "still at it for 0 s: starting"
    at = lines.index("estimate: evaluation 0")
    assert len(lines) - at > 2
    assert set(lines[at + 1 :]) <= {f"still at it for {count} s: estimate: evaluation 0" for count in (0, 1)}


def test_nothing_is_silent_longer_than_promised(capsys):
    """The longest silence between lines that are 5 s apart at most; here in hundredths of it."""
    kept = []
    with beating(lambda line: kept.append(time.perf_counter()), lambda: "still", 0.1) as say:
        say("first")
        time.sleep(0.55)
    gaps = [later - earlier for earlier, later in zip(kept, kept[1:])]
    assert len(gaps) >= 4 and min(gaps) > 0.05
    assert LONGEST_SILENCE_S == 5.0


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
