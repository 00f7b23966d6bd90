"""Every number that a command takes as an option: what is none, or no size of anything, ends it before it computes."""

from __future__ import annotations

from typing import Annotated, get_args, get_type_hints

import pytest
import typer

from spinestiff.anatomy.export import FORMATS
from spinestiff.anatomy.importing.orienting import UNITS
from spinestiff.anatomy.template import MESHES, OWN_MESH
from spinestiff.anatomy.template.body import Sex
from spinestiff.app.cli import app
from spinestiff.app.cohort import LEVELS
from spinestiff.app.options import within
from spinestiff.app.plan import TARGETS
from spinestiff.curves.cobb import DEFINITIONS
from spinestiff.errors import OptionError
from spinestiff.estimation.fitted import METHODS
from spinestiff.estimation.ratio_priors import POPULATIONS
from spinestiff.imaging.features import ORIENTATIONS
from spinestiff.study.planning.wish import SIDES, VIEWS
from spinestiff.study.report.pdf import PAPERS
from spinestiff.study.synthetic.recipe import ACQUISITIONS
from spinestiff.study.synthetic.spines import CURVES
from spinestiff.study.visit import NOBODY

ANNOTATED = Annotated[int, 0].__class__


def numbers(typed=app, words=(), kinds=frozenset({float})):
    """(words of the command, option) of every option that takes a number of these kinds."""
    found = []
    for group in typed.registered_groups:
        found += numbers(group.typer_instance, (*words, group.name), kinds)
    for command in typed.registered_commands:
        name = command.name or command.callback.__name__
        for parameter, hint in get_type_hints(command.callback, include_extras=True).items():
            inner, *extras = get_args(hint) if hint.__class__ is ANNOTATED else (hint,)
            if kinds & {inner, *get_args(inner)}:
                declared = [word for extra in extras for word in extra.param_decls or ()]
                found.append(((*words, name), declared[0] if declared else "--" + parameter.replace("_", "-")))
    return found


# What stands before the options; nothing of it is ever looked at.
ARGUMENTS = {
    ("synth",): ("new",),
    ("init",): ("new", "none"),
    ("cobb",): ("none",),
    ("plan",): ("none",),
    ("cohort",): ("none", "new"),
    ("serve",): ("new",),
    ("torso", "import"): ("none", "--out", "new"),
}
NUMBERS = numbers()


def test_all_commands_were_walked():
    assert len(NUMBERS) == 35
    assert {words for words, _ in NUMBERS} == {
        ("synth",), ("init",), ("demo",), ("cobb",), ("torso", "import"), ("torso", "export"), ("torso", "show"),
        ("plan",), ("cohort",), ("serve",),
    }  # fmt: skip


@pytest.mark.parametrize(("words", "option"), NUMBERS)
def test_no_number_and_no_size_is_refused_at_once(spinestiff, tmp_path, monkeypatch, words, option):
    monkeypatch.chdir(tmp_path)
    for value in ("nan", "inf", "-inf", "-1e6", "1e9", "1e308"):
        result = spinestiff(*words, *ARGUMENTS.get(words, ()), option, value)
        assert (result.status, result.out) == (2, "")
        assert len(result.lines) == 1
        assert result.lines[0].startswith(f"spinestiff: {option} {float(value):g}: wanted "), result.lines
    assert list(tmp_path.iterdir()) == []


WHOLE_NUMBERS = numbers(kinds=frozenset({int}))


def test_all_whole_numbers_are_known():
    assert {words for words, _ in WHOLE_NUMBERS} == {
        ("synth",), ("demo",), ("annotate",), ("serve",), ("plan",), ("cohort",), ("study", "seven"),
        ("torso", "export"),
    }  # fmt: skip


@pytest.mark.parametrize(("words", "option"), NUMBERS + WHOLE_NUMBERS)
def test_an_underscore_makes_no_number(spinestiff, tmp_path, monkeypatch, words, option):
    """Which Python takes "1_0" for: 10."""
    monkeypatch.chdir(tmp_path)
    settings = tmp_path.with_suffix(".toml")
    settings.write_text(f"[{'.'.join(words)}]\n{option[2:]} = '1_0'\n", encoding="utf-8")
    for given in ((option, "1_0"), (f"{option}=1_0",), ("--settings", settings)):
        result = spinestiff(*words, *ARGUMENTS.get(words, ()), *given)
        assert (result.status, result.out) == (2, "")
        assert result.lines == [f"spinestiff: {option} 1_0: wanted a number, without underscores"]
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(("words", "option"), NUMBERS + WHOLE_NUMBERS)
def test_what_is_no_number_is_named_with_its_option(spinestiff, tmp_path, monkeypatch, words, option):
    monkeypatch.chdir(tmp_path)
    settings = tmp_path.with_suffix(".toml")
    whole = (words, option) in WHOLE_NUMBERS
    number = "a whole number, in digits" if whole else "a number"
    wanted = {"80,5": f"{number} (a decimal point, no comma)", "many": number}
    if whole:
        wanted |= {"1.5": number, "1e3": number}
    for text, words_of_it in wanted.items():
        settings.write_text(f"[{'.'.join(words)}]\n{option[2:]} = '{text}'\n", encoding="utf-8")
        for given in ((option, text), (f"{option}={text}",), ("--settings", settings)):
            result = spinestiff(*words, *ARGUMENTS.get(words, ()), *given)
            assert (result.status, result.out) == (2, "")
            assert result.lines == [f"spinestiff: {option} {text}: wanted {words_of_it}"]
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("words", "option", "text", "wanted"),
    [
        (("init", "new", "none"), "--source-detector", "1_500", "wanted MM, or PICTURE=MM"),
        (("init", "new", "none"), "--source-detector", "rest/lateral=1_500", "wanted MM, or PICTURE=MM"),
        (("synth", "new"), "--ratios", "0.1_0,0.04", "wanted two numbers BENDING,TISSUE"),
        (("synth", "new"), "--ratios", "0.10", "wanted two numbers BENDING,TISSUE"),
    ],
)
def test_an_underscore_makes_no_number_in_a_text_either(spinestiff, tmp_path, monkeypatch, words, option, text, wanted):
    monkeypatch.chdir(tmp_path)
    result = spinestiff(*words, option, text)
    assert (result.status, result.out, len(result.lines)) == (2, "", 1)
    assert result.lines[0].startswith(f"spinestiff: {option} {text}: {wanted}"), result.lines
    assert list(tmp_path.iterdir()) == []


class Param:
    opts = ("--size",)


def test_limits_pass_themselves_unless_the_least_is_excluded():
    closed, open_ = (within("mm", lambda: (2.0, 5.0), above) for above in (False, True))
    assert [closed(Param, value) for value in (None, 2.0, 3.5, 5.0)] == [None, 2.0, 3.5, 5.0]
    assert [open_(Param, value) for value in (None, 2.0001, 5.0)] == [None, 2.0001, 5.0]
    with pytest.raises(OptionError, match=r"^--size 1\.9: wanted 2 to 5 mm$"):
        closed(Param, 1.9)
    with pytest.raises(OptionError, match=r"^--size 2: wanted above 2 and at most 5 mm$"):
        open_(Param, 2.0)


def test_each_option_has_the_limits_of_its_quantity(spinestiff, tmp_path):
    wanted = {
        ("torso", "show", "--height", 119): "120 to 200 cm",
        ("torso", "show", "--age", 5): "8 to 100 years",
        ("torso", "show", "--mass", 17): "17.28 to 160 kg",
        ("torso", "show", "--kyphosis", 70): "20 to 50 degrees",
        ("torso", "show", "--lordosis", 5): "35 to 60 degrees",
        ("torso", "import", "none", "--out", "new", "--height", 80): "90 to 230 cm",
        ("torso", "import", "none", "--out", "new", "--spacing", 1): "9 to 60 mm",
        ("synth", "new", "--age", 7): "8 to 100 years",
        ("synth", "new", "--cobb", -81): "-80 to 80 degrees",
        ("synth", "new", "--nodes", 2999): "3000 to 65000 nodes",
        ("synth", "new", "--markers", 2): "3 to 60 markers",
        ("synth", "new", "--force", 501): "above 0 and at most 500 N",
        ("plan", "none", "--limit", 501): "5 to 500 N",
        ("plan", "none", "--dose", 0): "above 0 and at most 1e+06 of any unit",
        ("plan", "none", "--lateral-dose", 0): "above 0 and at most 1e+06 of any unit",
        ("serve", "new", "--upload-limit", 0): "above 0 and at most 1000 GB",
        ("cobb", "none", "--noise-px", 0): "above 0 and at most 1000 pixels",
    }
    for arguments, limits in wanted.items():
        assert spinestiff(*arguments).lines == [f"spinestiff: {arguments[-2]} {arguments[-1]}: wanted {limits}"]


# Options of a few words, which the shell completes


def offered(group, words=()):
    """Every option and argument that takes text, by its command: what the shell offers for it."""
    found = {}
    for name, command in group.commands.items():
        if hasattr(command, "commands"):
            found |= offered(command, (*words, name))
            continue
        for param in command.params:
            if param.type_descriptor.annotation in (str, list[str]):
                items = param.shell_complete(typer.Context(command), "")
                found[" ".join((*words, name)), param.opts[0]] = tuple(item.value for item in items)
    return found


@pytest.mark.parametrize("option", ["--source-detector", "--source-patient", "--imager-pixel"])
@pytest.mark.parametrize(
    "text", ["nan", "inf", "-5", "0", "1e30", "0.0015", "rest/lateral=nan", "rest/lateral=0", "=5", "far"]
)
def test_lengths_of_pictures_that_make_no_sense_are_refused(spinestiff, tmp_path, monkeypatch, option, text):
    monkeypatch.chdir(tmp_path)
    result = spinestiff("init", *ARGUMENTS.get(("init",), ()), option, text)
    assert (result.status, result.out) == (2, "")
    assert len(result.lines) == 1
    assert result.lines[0].startswith(f"spinestiff: {option} {text}: wanted "), result.lines
    assert list(tmp_path.iterdir()) == []


def test_the_shell_offers_all_words_that_an_option_takes_and_no_other():
    def both(words):
        return {*words, "both"}

    known = {
        "--mesh": MESHES,
        "--method": METHODS,
        "--orientation": ORIENTATIONS,
        "--population": (*POPULATIONS, NOBODY),
        "--curve": CURVES,
        "--acquisition": ACQUISITIONS,
        "--target": TARGETS,
        "--side": both(SIDES),
        "--views": both(VIEWS),
        "--definition": DEFINITIONS,
        "--patient-left": SIDES,
        "--paper": PAPERS,
        "--sex": get_args(Sex),
        "--unit": UNITS,
        "--beam": ("AP", "PA"),
        "--format": FORMATS,
        "level": LEVELS,
    }
    # Of a command whose option takes other words, and those that take any text, or several words at once.
    special = {("init", "--side"): SIDES, ("init", "--orientation"): ("standard",)}
    special |= {(f"torso {name}", "--mesh"): (*MESHES, OWN_MESH) for name in ("show", "export")}
    open_ = {
        "--ratios", "--spine-id", "--id", "--log", "--log-columns", "--log-units", "--log-offset", "--study",
        "--frontal", "--lateral", "--host", "--proxy", "--parameters", "--ribs", "--under", "--scheduler", "--axes",
        "--mesher", "--source-detector", "--source-patient", "--imager-pixel", "--trunk",
    }  # fmt: skip
    found = offered(typer.main.get_command(app))
    assert {option for _, option in found} == known.keys() | open_
    for (command, option), words in found.items():
        wanted = special.get((command, option), known.get(option, ()))
        assert set(words) == set(wanted) and len(words) == len(wanted), (command, option)
