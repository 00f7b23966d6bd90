"""The command line as installed: what it prints, what it refuses, and how it ends."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys

import numpy as np
import pydicom
import pytest

from spinestiff import __version__
from spinestiff.app import cli
from spinestiff.errors import EquilibriumError, FitError
from spinestiff.files import file_digest, read_json, write_json
from spinestiff.mechanics import equilibrium
from spinestiff.mechanics.equilibrium import EquilibriumProblem
from spinestiff.study import steps
from spinestiff.study.wording.estimate import combination_lines, factor_lines, headline, pelvis_lines
from spinestiff.study.wording.numbers import estimated
from spinestiff.study.wording.steps import response_lines
from spinestiff.subject.assessment_outcome import Assessment
from spinestiff.subject.estimate_outcome import Estimate
from spinestiff.subject.folder import read_subject
from spinestiff.subject.outcomes import Responses
from spinestiff.subject.run_record import read_outcome
from spinestiff.verification.outcome import Check

COMMANDS = {
    "synth": (
        "--seed",
        "--height",
        "--age",
        "--sex",
        "--cobb",
        "--curve",
        "--force",
        "--ratios",
        "--spine",
        "--spine-id",
        "--acquisition",
        "--nodes",
        "--biplanar",
        "--markers",
    ),
    "init": (
        "--pushes",
        "--id",
        "--age",
        "--sex",
        "--height",
        "--mass",
        "--trunk",
        "--side",
        "--level",
        "--d21",
        "--d31",
        "--log",
        "--log-columns",
        "--log-units",
        "--log-rate",
        "--log-offset",
        "--study",
        "--frontal",
        "--lateral",
        "--source-detector",
        "--source-patient",
        "--imager-pixel",
        "--orientation",
        "--beam",
        "--no-questions",
    ),
    "inspect": ("--json",),
    "annotate": ("--port", "--no-browser"),
    "serve": (
        "--source",
        "--port",
        "--host",
        "--no-browser",
        "--read-only",
        "--jobs",
        "--upload-limit",
        "--proxy",
        "--proxy-secret",
    ),
    "track": ("--redo",),
    "response": ("--redo",),
    "frames": ("--write", "--json"),
    "personalise": ("--mesh", "--redo"),
    "estimate": ("--method", "--orientation", "--parameters", "--population", "--redo", "--json"),
    "plan": (
        "--target",
        "--limit",
        "--exposures",
        "--dose",
        "--frame-dose",
        "--lateral-dose",
        "--side",
        "--ribs",
        "--views",
        "--under",
        "--json",
        "--json-all",
    ),
    "parameters": ("--mesh", "--redo", "--json"),
    "sensitivity": ("--mesh", "--redo", "--json"),
    "assess": ("--truth", "--redo", "--json"),
    "repeat": ("--annotators", "--out", "--json"),
    "report": ("--truth", "--pdf", "--paper", "--redo"),
    "view": ("--torso", "--out", "--force", "--no-open"),
    "run": ("--mesh", "--method", "--orientation", "--parameters", "--population", "--truth", "--redo", "--json"),
    "demo": (
        "--out",
        "--seed",
        "--height",
        "--cobb",
        "--curve",
        "--force",
        "--ratios",
        "--spine",
        "--spine-id",
        "--acquisition",
    ),
    "cobb": ("--definition", "--json", "--csv", "--noise-px", "--patient-left", "--picture", "--force"),
    "cohort": (
        "--mesh",
        "--method",
        "--orientation",
        "--parameters",
        "--population",
        "--jobs",
        "--index",
        "--scheduler",
        "--minutes",
        "--memory",
        "--difference",
    ),
    "check": ("--table", "--json"),
    "phantom": ("--json",),
    "deidentify": ("--key", "--burned-in-ok"),
    "doctor": ("--json",),
}
COMMON = ("--quiet", "--verbose", "--settings", "--help")
# Not pydantic: typer itself may import it.
HEAVY = (
    "numba",
    "scipy",
    "cv2",
    "matplotlib",
    "skimage",
    "pydicom",
    "rslab",
    "numpy",
    "fastapi",
    "uvicorn",
    "distributed",
)


def digests(folder):
    """Of all files but the logs of runs."""
    files = [p for p in sorted(folder.rglob("*")) if p.is_file() and p.suffix != ".jsonl"]
    return {p.relative_to(folder).as_posix(): file_digest(p) for p in files}


def refused(result, words, status=2):
    """The command ended with one line that says why."""
    assert result.status == status
    complaints = [line for line in result.lines if line.startswith("spinestiff: ")]
    assert complaints == result.lines[-1:]
    assert re.search(words, complaints[0]), complaints[0]


def refused_at_once(result, words):
    refused(result, words)
    assert len(result.lines) == 1
    assert result.out == ""


# Help


def test_help_lists_every_command_and_option(spinestiff):
    overview = spinestiff("--help")
    assert overview.status == 0
    assert {command.name or command.callback.__name__ for command in cli.app.registered_commands} == set(COMMANDS)
    for command, options in COMMANDS.items():
        assert re.search(rf"^ +{command} ", overview.out, re.M), command
        shown = spinestiff(command, "--help")
        assert shown.status == 0
        assert set(re.findall(r"^ +(?:-\w, )?(--[a-z0-9-]+)", shown.out, re.M)) == {*options, *COMMON}
        assert spinestiff(command, "-h").out == shown.out


def test_help_imports_nothing_heavy():
    """In a fresh interpreter, all help texts one after the other."""
    code = f"""
import sys
from spinestiff.app.cli import main
for command in {[[], *([name] for name in COMMANDS)]!r}:
    sys.argv = ["spinestiff", *command, "--help"]
    try:
        main()
    except SystemExit as end:
        assert not end.code, command
print([name for name in {HEAVY!r} if name in sys.modules], file=sys.stderr)
"""
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True)
    assert ended.stderr.strip() == "[]"
    assert ended.stdout.count("Usage: ") == 1 + len(COMMANDS)


def test_the_module_runs_as_a_program(tmp_path):
    def run(*arguments):
        command = [sys.executable, "-m", "spinestiff.app.cli", *arguments]
        return subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)

    version = run("--version")
    assert (version.returncode, version.stdout.strip()) == (0, __version__)
    missing = run("run", tmp_path / "nobody")
    assert (missing.returncode, missing.stdout) == (2, "")
    wanted = f"spinestiff: {tmp_path / 'nobody'}: no such folder; wanted a subject folder with subject.json\n"
    assert missing.stderr == wanted


@pytest.mark.parametrize("arguments", [("fly",), ("run",), ("run", "--fast", "x")])
def test_wrong_usage_ends_with_2(spinestiff, arguments):
    result = spinestiff(*arguments)
    assert result.status == 2
    assert "Error: " in result.lines[-1]


def test_a_number_that_is_none_ends_with_2_in_one_line(spinestiff):
    result = spinestiff("synth", "x", "--seed", "few")
    assert (result.status, result.lines) == (2, ["spinestiff: --seed few: wanted a whole number, in digits"])


# What goes well


def test_run_on_a_finished_subject_prints_the_result(spinestiff, subject, finished):
    before = digests(subject)
    result = spinestiff("run", subject, "--mesh", "coarse", "--truth", finished.truth)
    assert result.status == 0
    assert [line.split(maxsplit=2)[2] for line in result.lines] == [
        f"{step}: up to date" for step in ("track", "response", "personalise", "estimate", "assess", "report")
    ]
    lines = response_lines(read_outcome(read_subject(subject), Responses))
    assert len(lines) == 6 and all(f"{line}\n" in result.out for line in lines)
    assert digests(subject) == before
    estimate = read_outcome(read_subject(subject), Estimate)
    for name, value in finished.fit.ratios.as_dict().items():
        assert re.search(rf"ratio: {name} +{estimated(estimate.ratios[name])} ", result.out)
        assert float(estimated(estimate.ratios[name])) == pytest.approx(value, rel=0.05)
    told = [*lines, *combination_lines(estimate), *headline(estimate), *factor_lines(estimate), *pelvis_lines(estimate)]
    assert [line for line in result.out.splitlines() if line in told] == told
    notes = (*estimate.notes, *read_outcome(read_subject(subject), Assessment).notes)
    assert any(note.startswith("a quick look: the tissue's mesh is coarse") for note in notes)
    assert [f"note: {text}" in result.out for text in notes] == [True] * len(notes)
    assert re.search(r"main 3 .*30 ", result.out)
    assert re.search(r"true ratios inside the joint 95 % region: (yes|no)\n", result.out)
    assert f"report: {subject / 'results' / 'report.html'}" in result.out


def test_every_step_runs_by_its_own_name(spinestiff, subject, finished, no_report):
    """For real, up to the estimate: with other settings, on the copy."""
    answered = spinestiff("track", subject, "--redo")
    assert answered.status == 0
    assert [line.partition(", ")[0] for line in answered.out.splitlines()] == [
        "push 'main': 4 frames", "push 'second': 2 frames", f"to look at them: spinestiff annotate {subject}",
    ]  # fmt: skip
    answered = spinestiff("response", subject, "--redo")
    assert answered.status == 0
    assert answered.out.splitlines()[1:] == response_lines(read_outcome(read_subject(subject), Responses))
    result = spinestiff("personalise", subject, "--mesh", "coarse", "--redo")
    assert result.status == 0
    assert "corner sd 16.00 mm" in result.err
    assert re.match(r"torso against the radiographs at rest, RMSE: frontal \d+\.\d\d mm, lateral ", result.out)
    assessed = spinestiff("assess", subject, "--truth", finished.truth)
    assert assessed.status == 0
    assert "Held-out frames" in assessed.out
    assert "true ratios inside" in assessed.out
    reported = spinestiff("report", subject, "--truth", finished.truth)
    assert (reported.status, reported.out) == (0, f"report: {subject / 'results' / 'report.html'}\n")


def test_a_push_from_the_wrong_side_is_told_by_the_response(spinestiff, subject):
    assert "doubtful" not in spinestiff("response", subject).out
    edit("subject.json", lambda content: content["pushes"][0].update(side="right"))(subject)
    (line,) = [line for line in spinestiff("response", subject).out.splitlines() if line.startswith("doubtful: ")]
    assert re.match(r"doubtful: push 'main': at 30 N the spine has moved by \d+\.\d mm against the push from the", line)
    assert "look for the wrong side in subject.json" in line


def test_without_truth_there_is_none_in_the_assessment(spinestiff, subject, monkeypatch):
    """The baseline's fit is left out: what counts is what reaches the file."""
    monkeypatch.setattr(steps, "single_ratio", lambda *args: None)
    result = spinestiff("assess", subject, "--redo")
    assert result.status == 0
    assert "true ratios inside" not in result.out
    frames = read_outcome(read_subject(subject), Assessment).frames
    assert len(frames) == 2
    for frame in frames:
        assert frame.rmse_mm["truth"] is frame.rmse_mm["single_ratio"] is None
        assert frame.rmse_mm["rest"] > 0.0
        assert "truth" not in frame.cobb_change_deg
    # The comparison was with an earlier estimate.
    assert not (subject / "results" / "comparison.json").exists()


def test_a_report_with_another_truth_asks_for_its_comparison(spinestiff, subject, tmp_path):
    other = tmp_path / "other.truth.json"
    write_json(other, {"ratios": {"lateral_bending": 0.3, "tissue": 0.05}})
    words = f"comparison.json: compares with other true ratios .*; run spinestiff assess {subject} --truth {other}"
    refused(spinestiff("report", subject, "--truth", other), words)


def test_redo_reaches_the_step(spinestiff, subject, finished, monkeypatch):
    asked = []

    def fit(coarse, pushes, names, start, method, observer, say):
        asked.append((method, pushes.orientation))
        return finished.fit

    monkeypatch.setattr(steps, "fit_from_coarse", fit)
    assert spinestiff("estimate", subject).status == 0
    assert asked == []
    assert spinestiff("estimate", subject, "--redo").status == 0
    assert spinestiff("estimate", subject, "--method", "paper", "--orientation", "covariance").status == 0
    assert asked == [("weighed", "procrustes"), ("paper", "covariance")]


def test_parameters_and_population_reach_the_fit(spinestiff, subject, finished, monkeypatch):
    asked = []

    def fit(coarse, pushes, names, *args):
        asked.append((names, pushes.known.population))
        return finished.fit

    monkeypatch.setattr(steps, "fit_from_coarse", fit)
    chosen = ("--parameters", "lateral_bending@thoracic, lateral_bending@lumbar", "--population", "koutras2025")
    assert spinestiff("estimate", subject, *chosen).status == 0
    assert asked == [(("lateral_bending@thoracic", "lateral_bending@lumbar"), "koutras2025")]
    result = spinestiff("estimate", subject, "--parameters", "lateral_bending@neck")
    assert result.status == 2
    assert result.err.startswith("spinestiff: unknown part 'neck' in 'lateral_bending@neck'; wanted one of thoracic")
    assert len(asked) == 1


@pytest.fixture
def browsers(monkeypatch):
    """A desktop whose browser only notes what it is asked to open."""
    seen = []
    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setattr("webbrowser.open", lambda address: seen.append(address) or True)
    return seen


def test_view_opens_what_the_report_left(spinestiff, subject, browsers):
    page = subject / "results" / "view.html"
    result = spinestiff("view", subject)
    assert (result.status, result.out) == (0, f"view: {page}\n")
    assert browsers == [page.as_uri()]
    assert spinestiff("view", subject, "--no-open").status == 0
    assert len(browsers) == 1


def test_view_needs_predictions_but_no_report(spinestiff, subject, browsers, tmp_path):
    """For real: the page is made again, and goes where it is wanted as well."""
    for name in ("view.html", "report.html"):
        (subject / "results" / name).unlink()
    out = tmp_path / "pages" / "girl.html"
    result = spinestiff("view", subject, "--out", out)
    assert (result.status, result.out) == (0, f"view: {out}\n")
    assert browsers == [out.as_uri()]
    page = out.read_text(encoding="utf-8")
    assert page == (subject / "results" / "view.html").read_text(encoding="utf-8")
    assert "Torso of synthetic-3" in page and "main: 30 N from the" in page
    again = spinestiff("view", subject, "--no-open")
    assert "view: up to date" in again.err


def test_view_of_stale_results_is_refused(spinestiff, subject, browsers):
    edit("subject.json", lambda content: content.update(height_cm=158.0))(subject)
    words = r"torso\.npz: was made before subject\.json: body changed; run spinestiff personalise again"
    refused(spinestiff("view", subject), words)
    assert browsers == []


def test_view_of_an_estimate_without_predictions_says_what_to_run(spinestiff, subject, browsers):
    (subject / "results" / "predictions.npz").unlink()
    refused(spinestiff("view", subject), rf"predictions\.npz: no such file; .*\(spinestiff assess {subject}\)")
    assert browsers == []


@pytest.mark.parametrize(
    ("lacking", "words"),
    [
        (("estimate.json",), "the subject’s torso at rest"),
        (("estimate.json", "torso.npz"), "the template of the subject’s sizes"),
    ],
)
def test_view_before_an_estimate_shows_rest_and_says_what_to_run(spinestiff, subject, browsers, lacking, words):
    for name in lacking:
        (subject / "results" / name).unlink()
    result = spinestiff("view", subject)
    assert result.status == 0
    assert re.match(rf"no estimate yet: shows {words}.*: spinestiff run {subject}\nview: ", result.out)
    page = (subject / "results" / "view.html").read_text(encoding="utf-8")
    assert words in page and "<input id" not in page
    assert len(browsers) == 1


def test_view_of_a_torso_file(spinestiff, subject, browsers, tmp_path):
    torso = subject / "results" / "torso.npz"
    result = spinestiff("view", "--torso", torso)
    assert (result.status, result.out) == (0, f"view: {torso.with_suffix('.html')}\n")
    assert "Torso of torso.npz" in torso.with_suffix(".html").read_text(encoding="utf-8")
    assert spinestiff("view", "--torso", torso, "--out", tmp_path / "t.html", "--no-open").status == 0
    assert (tmp_path / "t.html").is_file() and len(browsers) == 1
    torso.write_bytes(b"PK")
    again = ("view", "--torso", torso, "--out", tmp_path / "t.html")
    refused_at_once(spinestiff(*again), r"t\.html: is there already; name another file, or replace it with --force")
    refused_at_once(spinestiff(*again, "--force"), "torso.npz is no torso file, or it is damaged")


def test_view_wants_one_thing(spinestiff, subject, browsers):
    refused_at_once(spinestiff("view"), "a subject folder or a --torso file; give one")
    refused_at_once(spinestiff("view", subject, "--torso", "t.npz"), "give one of them")
    refused_at_once(spinestiff("view", subject / "nobody"), "no such folder")
    assert browsers == []


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="a display is a matter of Linux")
def test_view_without_a_display_says_so(spinestiff, subject, browsers, monkeypatch):
    """Else a browser in the terminal might take it."""
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    result = spinestiff("view", subject)
    assert result.status == 0 and "open this file in one" in result.out
    assert browsers == []


def test_cobb_prints_three_forms(spinestiff, subject):
    result = spinestiff("cobb", subject)
    assert (result.status, result.err) == (0, "")
    for words in ("signed", "fixed levels", "tilt", "rest/frontal", "endplates", "left-convex)", "main frame 3, 30 N"):
        assert words in result.out
    forms = re.search(r"main frame 3, 30 N +\d+\.\d° ± \d+\.\d°" + 3 * r" +−\d+\.\d° ± \d+\.\d°", result.out)
    assert forms is not None
    lines = response_lines(read_outcome(read_subject(subject), Responses))
    assert result.out.splitlines()[-len(lines) :] == lines
    (subject / "results" / "tracked.json").unlink()
    assert "N per degree" not in spinestiff("cobb", subject).out


def test_cobb_of_a_folder_as_json(spinestiff, subject):
    result = spinestiff("cobb", subject, "--json", "--definition", "midline")
    rest, *frames = json.loads(result.out)
    assert (rest["image"], rest["status"], rest["change_deg"]) == ("rest/frontal", "ok", None)
    assert rest["convexity"] == "convex to the patient's left" and rest["definition"] == "midline"
    pushed = next(frame for frame in frames if frame["image"] == "main frame 3, 30 N")
    assert pushed["change_deg"]["tilt"] < -1.0


def test_doctor_prints_solver_and_versions(spinestiff):
    result = spinestiff("doctor")
    assert (result.status, result.err) == (0, "")
    for words in ("sparse solver in use", "numpy", np.__version__, __version__, "template mesh 'fine'"):
        assert words in result.out


def checks(*passed):
    def run(observer=None):
        done = [
            Check(f"check {i}", "independent", 0.0 if ok else float("inf"), 1e-9, ok) for i, ok in enumerate(passed)
        ]
        for check in done:
            if observer:
                observer(check)
        return done

    return run


@pytest.mark.parametrize(("passed", "status"), [((True, True), 0), ((True, False), 1)])
def test_check(spinestiff, monkeypatch, passed, status):
    monkeypatch.setattr("spinestiff.verification.checks.run_checks", checks(*passed))
    result = spinestiff("check", "--json")
    assert result.status == status and len(result.lines) == 2
    records = json.loads(result.out)
    assert [record["passed"] for record in records] == list(passed)
    assert all(set(record) == {"name", "kind", "error", "tolerance", "passed"} for record in records)
    verdict = f"{'FAILED' if status else 'passed'}: {sum(passed)} of 2 independent checks passed"
    plain = spinestiff("check")
    assert plain.status == status
    assert plain.out.splitlines()[-1] == verdict
    # Without being asked for, only what failed is listed.
    assert ("check 1" in plain.out, "check 0" in plain.out) == (not all(passed), False)
    table = spinestiff("check", "--table")
    assert table.status == status
    assert table.out.splitlines()[-1] == verdict
    assert "check 0" in table.out and "check 1" in table.out
    assert len(table.lines) == 2


def test_synth_and_demo_hand_their_options_on(spinestiff, tmp_path, monkeypatch):
    from spinestiff.study.synthetic import subject as synthetic
    from spinestiff.study.synthetic.recipe import PLANNED_PUSHES, Recipe

    asked = []

    def synthesise(folder, recipe, say):
        asked.append((folder, recipe))
        say("done")
        raise FitError("far enough")

    monkeypatch.setattr(synthetic, "synthesise", synthesise)
    options = ("--seed", 4, "--height", 150, "--cobb", -20, "--curve", "lumbar", "--force", 80)
    refused(spinestiff("synth", tmp_path / "x", *options, "--ratios", "0.2,0.03"), "far enough", 3)
    refused(spinestiff("demo", "--out", tmp_path / "y"), "far enough", 3)
    assert asked[0] == (tmp_path / "x", Recipe(4, 150.0, -20.0, "lumbar", 80.0, (0.2, 0.03)))
    assert asked[1] == (tmp_path / "y", Recipe(ratios=(0.1, 0.04), pushes=PLANNED_PUSHES))
    refused(spinestiff("demo", "--out", tmp_path / "w", "--acquisition", "paper"), "far enough", 3)
    assert asked.pop() == (tmp_path / "w", Recipe(ratios=(0.1, 0.04)))
    refused(spinestiff("synth", tmp_path / "z", "--age", 30, "--sex", "male"), "far enough", 3)
    assert asked.pop() == (tmp_path / "z", Recipe(age=30.0, sex="male"))
    refused(spinestiff("synth", tmp_path / "z", "--nodes", 4000), "far enough", 3)
    assert asked[2] == (tmp_path / "z", Recipe(nodes=4000))
    refused(spinestiff("synth", tmp_path / "z", "--biplanar"), "far enough", 3)
    assert asked[3] == (tmp_path / "z", Recipe(biplanar=True))
    refused(spinestiff("synth", tmp_path / "z", "--markers", 12), "far enough", 3)
    assert asked[4] == (tmp_path / "z", Recipe(markers=12))


# What is refused


def edit(name, change):
    def apply(subject):
        content = read_json(subject / name)
        change(content)
        write_json(subject / name, content)

    return apply


def write_raw(name, old, new):
    def apply(subject):
        text = (subject / name).read_text()
        assert old in text
        (subject / name).write_text(text.replace(old, new, 1))

    return apply


def few_vertebrae(content):
    image = content["images"]["push/main"]["vertebrae"]
    for name in list(image)[7:]:
        del image[name]


BAD_JSON = {
    "unknown key": (edit("subject.json", lambda c: c.update(colour="red")), r"subject\.json: colour: unknown key"),
    "NaN": (write_raw("subject.json", "157.0", "NaN"), r"subject\.json: found NaN"),
    "not JSON": (write_raw("subject.json", "{", ""), r"subject\.json: not JSON"),
    "zero force": (
        edit("subject.json", lambda c: c["pushes"][0].update(forces_n=[0.0] * 4)),
        r"all forces are zero|all training forces are zero",
    ),
    "negative force": (
        edit("subject.json", lambda c: c["pushes"][0].update(forces_n=[0.0, -1.0, 2.0, 3.0])),
        "forces are magnitudes",
    ),
    "no subject.json": (lambda subject: (subject / "subject.json").unlink(), r"subject\.json: no such file"),
    "no annotation": (lambda subject: (subject / "annotation.json").unlink(), r"annotation\.json: no annotation"),
    "few vertebrae": (edit("annotation.json", few_vertebrae), "found 7 vertebrae, wanted at least 8"),
    "no radiograph": (lambda subject: (subject / "rest" / "frontal.dcm").unlink(), r"frontal\.dcm: no such file"),
}


@pytest.mark.parametrize("case", BAD_JSON)
@pytest.mark.parametrize("command", ["run", "estimate", "cobb"])
def test_bad_folders_are_refused_at_once(spinestiff, subject, case, command):
    spoil, words = BAD_JSON[case]
    spoil(subject)
    before = digests(subject)
    refused_at_once(spinestiff(command, subject), words)
    assert digests(subject) == before


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("run", "nobody"), "nobody: no such folder"),
        (("synth", "new", "--ratios", "0.1"), "--ratios 0.1: wanted two numbers BENDING,TISSUE"),
        (("synth", "new", "--ratios", "a,b"), "--ratios a,b: wanted two numbers"),
        (("synth", "new", "--ratios", "0.1,0.1,0.1"), "wanted two numbers"),
        (("synth", "new", "--ratios", "0.1,0"), "stiffness ratio 0.0; wanted"),
        (("synth", "new", "--ratios", "nan,0.1"), "--ratios nan,0.1: wanted two numbers"),
        (("synth", "new", "--force", "0"), "--force 0: wanted above 0 and at most 500 N"),
        (("synth", "new", "--seed", "-3"), "seed -3"),
        (("demo", "--acquisition", "mine"), "--acquisition mine: wanted planned or paper"),
        (("synth", "new", "--spine", "t.csv"), "--spine and --spine-id belong together"),
        (("demo", "--out", "new", "--spine-id", "a"), "--spine and --spine-id belong together"),
        (("synth", "new", "--spine", "t.csv", "--spine-id", "a", "--cobb", "30"), "--cobb 30.0: the table of --spine"),
        (("demo", "--spine", "t.csv", "--spine-id", "a", "--curve", "lumbar"), "--curve lumbar: the table of --spine"),
        (("demo", "--out", "new", "--ratios", "soft"), "--ratios soft"),
    ],
)
def test_bad_arguments_are_refused_at_once(spinestiff, tmp_path, monkeypatch, arguments, words):
    monkeypatch.chdir(tmp_path)
    refused_at_once(spinestiff(*arguments), words)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--curve", "zigzag"), "unknown curve 'zigzag'; wanted one of"),
        (("--cobb", "90"), "--cobb 90: wanted -80 to 80 degrees"),
        (("--height", "90"), "--height 90: wanted 120 to 200 cm"),
        (("--spine", "none.csv", "--spine-id", "a"), r"none\.csv: no such file"),
    ],
)
def test_impossible_subjects_are_refused(spinestiff, tmp_path, monkeypatch, arguments, words):
    monkeypatch.chdir(tmp_path)
    refused(spinestiff("synth", "new", *arguments), words)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("run", "--mesh", "huge"), "unknown mesh 'huge'; wanted one of coarse, fine"),
        (("personalise", "--mesh", ""), "unknown mesh ''"),
        (("run", "--method", "guess"), "unknown method 'guess'; wanted one of weighed, paper"),
        (("estimate", "--orientation", "up"), "unknown orientation 'up'"),
        (("assess", "--truth", "none.json"), r"none\.json: no such file"),
        (("run", "--truth", "subject.json"), r"subject\.json: holds no true ratios"),
    ],
)
def test_bad_settings_are_refused_before_any_step(spinestiff, subject, monkeypatch, arguments, words):
    monkeypatch.chdir(subject)
    before = digests(subject)
    refused_at_once(spinestiff(arguments[0], ".", *arguments[1:]), words)
    assert digests(subject) == before


def test_a_folder_in_use_is_not_overwritten(spinestiff, subject):
    before = digests(subject)
    refused_at_once(spinestiff("synth", subject), "is not empty; choose another folder, nothing was written")
    refused_at_once(spinestiff("demo", "--out", subject), "holds another subject")
    file = subject / "subject.json"
    assert spinestiff("synth", file).status == 2
    assert digests(subject) == before


@pytest.mark.parametrize(
    ("place", "words"),
    [
        ("{subject}/subject.json", "lies among the inputs"),
        ("{subject}/rest/frontal.dcm", "lies among the inputs"),
        ("{subject}/results/../annotation.json", "lies among the inputs"),
        ("{subject}/new.html", "lies among the inputs"),
        ("{subject}/results/tracked.json", "this command reads it"),
        ("{subject}/results/torso.npz", "this command reads it"),
        ("linked", "lies among the inputs"),
        ("hard", "this command reads it|is there already"),
        ("itself", "a link that leads to itself"),
        ("pipe", "found a named pipe"),
        ("/dev/null", "found a device"),
        ("{subject}", "found a folder"),
        ("", "found a folder"),
    ],
)
@pytest.mark.skipif(os.name == "nt", reason="pipes, devices and links of Unix")
def test_an_output_never_replaces_what_is_read_nor_a_device(spinestiff, subject, browsers, monkeypatch, place, words):
    monkeypatch.chdir(subject.parent)
    os.mkfifo("pipe")
    os.symlink(subject / "subject.json", "linked")
    os.symlink("itself", "itself")
    os.link(subject / "results" / "estimate.json", "hard")
    before = digests(subject)
    place = place.format(subject=subject)
    for command in (("view", subject, "--out", place), ("cobb", subject, "--picture", place)):
        refused_at_once(spinestiff(*command, "--force"), words)
    assert digests(subject) == before
    assert browsers == []


def test_only_force_replaces_a_file(spinestiff, subject, browsers, tmp_path):
    old = tmp_path / "old.html"
    old.write_text("mine", encoding="utf-8")
    refused_at_once(spinestiff("view", subject, "--out", old), r"--out .*old\.html: is there already")
    assert old.read_text(encoding="utf-8") == "mine"
    assert spinestiff("view", subject, "--out", old, "--force", "--no-open").status == 0
    assert old.read_text(encoding="utf-8").startswith("page")


def test_a_truth_is_not_overwritten(spinestiff, tmp_path):
    (tmp_path / "new.truth.json").write_text("mine", encoding="utf-8")
    refused_at_once(spinestiff("synth", tmp_path / "new"), r"new\.truth\.json: is there already")
    assert [path.name for path in tmp_path.iterdir()] == ["new.truth.json"]


def without_spacing(subject):
    path = subject / "pushes" / "main.dcm"
    dataset = pydicom.dcmread(path)
    for key in ("ImagerPixelSpacing", "PixelSpacing"):
        if key in dataset:
            delattr(dataset, key)
    dataset.save_as(path)


def truncated(name):
    def apply(subject):
        path = subject / name
        path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])

    return apply


def more_forces(content):
    content["pushes"][1].update(forces_n=[0.0, 15.0, 30.0], roles=["unused", "unused", "validation"])


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (edit("subject.json", more_forces), r"push 'second' has 3 forces_n, but pushes/second\.dcm holds 2 frames"),
        (without_spacing, r"main\.dcm: .*[Ss]pacing"),
        (truncated("pushes/main.dcm"), r"main\.dcm: "),
        (truncated("rest/lateral.dcm"), r"lateral\.dcm: "),
        (lambda subject: (subject / "pushes" / "main.dcm").write_bytes(b""), r"main\.dcm: "),
        (lambda subject: (subject / "pushes" / "main.dcm").write_bytes(b"no DICOM" * 99), r"main\.dcm: "),
    ],
)
def test_bad_radiographs_keep_all_results(spinestiff, subject, spoil, words):
    spoil(subject)
    before = digests(subject)
    refused(spinestiff("run", subject), words)
    after = digests(subject)
    # Steps before the one that fails may have been redone, to the same bytes; the record says so.
    assert {k: v for k, v in after.items() if k != "results/run.json"} == {
        k: v for k, v in before.items() if k != "results/run.json"
    }


def test_a_stale_tracking_is_refused(spinestiff, subject):
    edit("subject.json", more_forces)(subject)
    refused(
        spinestiff("estimate", subject),
        r"was made before subject\.json: frames changed; run spinestiff track again",
    )


def test_steps_ask_for_those_before(spinestiff, subject):
    for path in (subject / "results").iterdir():
        path.unlink()
    words = rf"run the step that makes it first \(spinestiff track {subject}\)"
    refused_at_once(spinestiff("estimate", subject), words)
    refused_at_once(spinestiff("report", subject), words)
    assert list((subject / "results").iterdir()) == []


@pytest.mark.parametrize("error", [FitError("no minimum here"), EquilibriumError("no\nequilibrium here")])
def test_a_failed_computation_ends_with_3_and_keeps_the_estimate(spinestiff, subject, monkeypatch, error):
    def fails(*args, **kwargs):
        raise error

    monkeypatch.setattr(steps, "fit_from_coarse", fails)
    monkeypatch.setattr(steps, "fit_pushes", fails)
    before = digests(subject)
    refused(spinestiff("estimate", subject, "--redo"), " here$", 3)
    assert digests(subject) == before


def test_an_absurd_force_ends_with_3_and_keeps_the_estimate(spinestiff, subject, monkeypatch):
    """For real: 500 N, more than Newton's method settles within the few steps that are left to it here."""

    def short(self, *args, solve=EquilibriumProblem.solve, **kwargs):
        return solve(self, *args, **{**kwargs, "max_iterations": 2})

    edit("subject.json", lambda c: c["pushes"][0].update(forces_n=[0.0, 400.0, 450.0, 500.0]))(subject)
    spinestiff("track", subject)
    spinestiff("personalise", subject, "--mesh", "coarse")
    monkeypatch.setattr(EquilibriumProblem, "solve", short)
    monkeypatch.setattr(equilibrium, "MAX_ITERATIONS", 2)
    before = digests(subject)
    refused(spinestiff("estimate", subject), r"equilibrium", 3)
    assert digests(subject) == before


def test_the_systems_own_refusals_are_one_line(spinestiff, subject, monkeypatch):
    def full(*args):
        raise OSError(28, "No space left on device", "tracked.json")

    monkeypatch.setattr(steps, "track", full)
    refused(spinestiff("track", subject, "--redo"), r"tracked\.json: can't be read or written \(the disk is full\)")


def test_an_interruption_is_one_line(spinestiff, subject, monkeypatch):
    def interrupted(*args):
        raise KeyboardInterrupt

    monkeypatch.setattr(steps, "track", interrupted)
    refused(spinestiff("track", subject, "--redo"), "stopped; results of finished steps are kept", 130)
