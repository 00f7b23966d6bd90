"""What every command takes and leaves: a settings file, the library's log, JSON on its own, the log of a run."""

from __future__ import annotations

import json
import logging
import os
import re
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
from typer.main import get_command

from spinestiff.app import cli
from spinestiff.app.settings_file import settings_of
from spinestiff.errors import FitError, OptionError
from spinestiff.files import read_json
from spinestiff.observer import LOGGER
from spinestiff.run_log import run_log
from spinestiff.study import steps
from spinestiff.subject.program import program

STEPS = ("track", "response", "personalise", "estimate", "assess", "report")


@pytest.fixture
def toml(tmp_path):
    def write(text):
        path = tmp_path / "settings.toml"
        path.write_text(text, encoding="utf-8")
        return path

    return write


# Settings in a file


def asked(path, *words):
    return settings_of(path, get_command(cli.app), list(words))


def test_a_command_s_table_comes_before_what_is_for_all(toml):
    path = toml('mesh = "coarse"\nredo = true\n[run]\nmesh = "fine"\n[study.seven]\nworkers = 2\n')
    assert asked(path, "run") == {"mesh": "fine", "redo": True}
    assert asked(path, "personalise") == {"mesh": "coarse", "redo": True}
    assert asked(path, "study", "seven") == {"mesh": "coarse", "workers": 2}
    assert asked(path, "cobb") == {}


def test_names_are_those_of_the_options_and_lists_are_as_the_option_takes_them(toml):
    path = toml('[init]\nlog = ["a.csv", "b.csv"]\nlog-units = ["s", "N"]\n[cobb]\nnoise-px = 2\ncsv = "angles.csv"\n')
    assert asked(path, "init") == {"log": ["a.csv", "b.csv"], "log_units": "s,N"}
    assert asked(path, "cobb") == {"noise_px": 2, "table": "angles.csv"}


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("mesh = ", "no TOML: "),
        (f"mesh = {'[' * 5000}", "no TOML: nested too deeply"),
        (f"mesh = {'9' * 5000}", "no TOML: .*4300 digits"),
        ('mehs = "fine"', "no command has an option --mehs; did you mean mesh?"),
        ('[rum]\nmesh = "fine"', r"\[rum\]: no such command; did you mean run\?"),
        ("[study.eight]\nworkers = 1", r"\[study.eight\]: no such command; did you mean study seven\?"),
        ("[study]\nworkers = 1", r"\[study\]: no such command"),
        ("[plan]\nlimti = 5", "plan has no option --limti; did you mean limit?"),
        ("[plan]\nfolder = 'x'", "plan has no option --folder"),
        ("[run]\nsettings = 'x'", "run has no option --settings"),
        ("[run]\nredo = 'yes'", "redo: wanted true or false as for --redo"),
        ("[run]\nmesh = true", "mesh: wanted a value as for --mesh"),
    ],
)
def test_a_file_that_says_what_there_is_not_is_refused(toml, text, words):
    path = toml(text)
    with pytest.raises(OptionError, match=words) as caught:
        asked(path, "run")
        asked(path, "plan")
    assert str(caught.value).startswith(f"--settings {path}: ")


def test_the_command_line_comes_before_the_file(spinestiff, toml, tmp_path):
    path = toml('height = 150\nmesh = "coarse"\n')
    assert "height: 150 cm" in spinestiff("torso", "show", "--settings", path).out
    assert "height: 160 cm" in spinestiff("torso", "show", "--settings", path, "--height", 160).out
    refused = spinestiff("torso", "show", "--settings", toml("height = 400"))
    assert (refused.status, refused.lines) == (2, ["spinestiff: --height 400: wanted 120 to 200 cm"])
    lost = spinestiff("torso", "show", "--settings", tmp_path / "none.toml")
    assert (lost.status, lost.lines) == (2, [f"spinestiff: --settings {tmp_path / 'none.toml'}: no such file"])


# What is said


def test_quiet_leaves_the_result_alone_and_verbose_adds_the_log(spinestiff, subject):
    usual = spinestiff("response", subject)
    assert usual.lines and usual.out
    quiet = spinestiff("response", subject, "--quiet")
    assert (quiet.status, quiet.err, quiet.out) == (0, "", usual.out)
    verbose = spinestiff("response", subject, "--redo", "-v")
    said = [line for line in verbose.lines if line.startswith("spinestiff.study.runner: ")]
    assert [line.partition(": ")[2] for line in said] == [
        "response is made from what changed: ",
        "response begins",
        "response is done",
    ]
    # What progress shows is not shown again, and nothing is left behind.
    assert len([line for line in verbose.lines if "N per degree of the curve" in line]) == 2
    assert logging.getLogger("spinestiff").level == logging.NOTSET
    assert spinestiff("response", subject).lines[0].endswith("response: up to date")


def test_json_of_a_run_is_one_document_and_all_else_on_the_other_stream(spinestiff, subject, finished):
    ran = spinestiff("run", subject, "--mesh", "coarse", "--truth", finished.truth, "--json")
    assert ran.status == 0 and len(ran.lines) == len(STEPS)
    found, results = json.loads(ran.out), subject / "results"
    assert found["estimate"] == read_json(results / "estimate.json")
    assert found["response"] == read_json(results / "response.json")
    assert found["assessment"]["frames"] == read_json(results / "assessment.json")["frames"]
    assert found["assessment"]["comparison"] == read_json(results / "comparison.json")
    assert found["spinestiff"] == program() and found["settings"]["mesh"] == "coarse"
    assert str(results / "report.html") in found["files"] and str(results / "estimate.csv") in found["files"]
    estimate = spinestiff("estimate", subject, "--json")
    assert json.loads(estimate.out) == found["estimate"]
    assessed = json.loads(spinestiff("assess", subject, "--json").out)
    assert assessed["frames"] == found["assessment"]["frames"] and assessed["comparison"] is None


def test_json_of_doctor(spinestiff):
    ran = spinestiff("doctor", "--json")
    found = json.loads(ran.out)
    assert (ran.status, ran.err, found["spinestiff"]) == (0, "", program())
    assert set(found["extras"]["torch"]["installed"]) == {"torch"}


@pytest.mark.parametrize(
    ("words", "there"),
    [
        ("spinestiff pl", {"plan"}),
        ("spinestiff plan --li", {"--limit"}),
        ("spinestiff study s", {"seven"}),
        ("spinestiff plan girl --target ", {"bending", "tissue", "rotation", "cobb"}),
        ("spinestiff torso export --format m", {"mjcf", "mrk"}),
        ("spinestiff cohort study results g", {"group"}),
    ],
)
@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_the_shell_completes_commands_options_and_words(words, there, shell):
    """As each shell asks an installed program."""
    code = "import sys; sys.argv[0] = 'spinestiff'; from spinestiff.app.start import main; main()"
    asks = {"_SPINESTIFF_COMPLETE": f"complete_{shell}"}
    if shell == "bash":
        asks |= {"COMP_WORDS": words, "COMP_CWORD": str(words.count(" "))}
    else:
        asks |= {"_TYPER_COMPLETE_ARGS": words, "_TYPER_COMPLETE_FISH_ACTION": "get-args"}
    ended = subprocess.run(
        [sys.executable, "-c", code], env=os.environ | asks, capture_output=True, text=True, timeout=60, check=False
    )
    # Bash takes a word a line, zsh "word":"help" in an action of its own, fish word, tab and help.
    said = re.findall(r'^(?:.*\(\()?"([^"]+)"', ended.stdout, re.M) if shell == "zsh" else ended.stdout.splitlines()
    assert {line.split("\t")[0] for line in said} == there, ended.stdout + ended.stderr


# The log of a run


def logged(subject):
    (path,) = (subject / "results" / "logs").glob("*.jsonl")
    return path, [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]


def test_a_run_leaves_a_log_with_versions_and_settings(spinestiff, subject):
    assert spinestiff("response", subject, "--redo").status == 0
    path, lines = logged(subject)
    assert path.name.endswith("-response.jsonl")
    first, *between, last = lines
    assert (first["event"], first["command"], first["versions"]["spinestiff"]) == ("start", "response", program())
    assert first["versions"]["numpy"] and first["versions"]["python"]
    assert first["settings"]["mesh"] == "fine" and first["settings"]["redo"] is True
    events = [(line.get("event"), line.get("step")) for line in between if "event" in line]
    assert events == [("begin", "response"), ("end", "response")]
    assert next(line for line in between if line.get("event") == "end")["seconds"] > 0.0
    assert any("N per degree of the curve" in line["text"] for line in between)
    assert (last["event"], last["outcome"]) == ("end", "done")
    assert all(line["time"].endswith("Z") for line in lines)
    # What is up to date leaves none.
    assert spinestiff("response", subject).status == 0
    assert len(list(path.parent.iterdir())) == 1


def test_a_failed_run_says_so_in_its_log_and_names_nobody(spinestiff, subject, monkeypatch):
    named = subject.with_name("Doe_Jane")
    subject.rename(named)
    (named / "pushes" / "main.dcm").rename(named / "pushes" / "DOE^JANE.dcm")
    content = read_json(named / "subject.json")
    content["pushes"][0]["frames"], content["id"] = "pushes/DOE^JANE.dcm", "hospital-4711"
    (named / "subject.json").write_text(json.dumps(content))

    def fails(*args):
        raise FitError(f"{named}/pushes/DOE^JANE.dcm of hospital-4711, DOE^JANE.dcm: 0.57 of Doe_Jane in main is bad")

    monkeypatch.setattr(steps, "track", fails)
    assert spinestiff("track", named).status == 3
    path, lines = logged(named)
    assert (lines[-1]["event"], lines[-1]["outcome"]) == ("end", "FitError")
    assert lines[-1]["text"] == "…/… of …, …: 0.57 of … in main is bad"
    for word in ("Doe", "DOE", "4711", str(named)):
        assert word not in path.read_text(encoding="utf-8")


def test_names_that_are_no_utf8_are_in_the_log_by_their_codes(tmp_path, monkeypatch):
    # Nor in what pytest keeps of logs, which its workers send as UTF-8.
    monkeypatch.setattr(logging.getLogger(LOGGER), "propagate", False)
    name = os.fsdecode(b"M\xfcller")
    subject = SimpleNamespace(folder=tmp_path, results=tmp_path / "results", record=SimpleNamespace(id="girl"))
    with run_log(subject, "track", {"out": name}):
        logging.getLogger(LOGGER).info("track", extra={"event": "begin"})
        logging.getLogger(LOGGER).info(f"{name}: dark")
    _, lines = logged(tmp_path)
    assert (lines[0]["settings"], lines[2]["text"], lines[3]["outcome"]) == ({"out": name}, f"{name}: dark", "done")


@pytest.mark.parametrize("name", ["1", "12"])
def test_a_folder_whose_name_is_a_number_hides_no_number_of_the_log(tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    folder = Path(name)
    folder.mkdir()
    subject = SimpleNamespace(folder=folder, results=folder / "results", record=SimpleNamespace(id="girl"))
    with run_log(subject, "track", {}):
        logging.getLogger(LOGGER).info("track", extra={"event": "begin"})
        logging.getLogger(LOGGER).info(f"{folder.resolve()}: 12 frames, 1.5 mm")
    assert logged(folder)[1][2]["text"] == "…: 12 frames, 1.5 mm"


def test_an_interrupted_run_has_the_lines_so_far(spinestiff, subject, monkeypatch):
    def interrupted(*args):
        _, lines = logged(subject)
        assert [line.get("event") for line in lines] == ["start", None, "begin"][: len(lines)] or lines
        raise KeyboardInterrupt

    monkeypatch.setattr(steps, "track", interrupted)
    assert spinestiff("track", subject, "--redo").status == 130
    assert logged(subject)[1][-1]["outcome"] == "KeyboardInterrupt"
