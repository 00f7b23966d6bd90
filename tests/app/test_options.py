"""Every number that a command takes as an option: what is none, or no size of anything, ends it before it computes."""

from __future__ import annotations

from typing import Annotated, get_args, get_type_hints

import pytest

from spinestiff.app.cli import app
from spinestiff.app.options import within
from spinestiff.errors import OptionError

ANNOTATED = Annotated[int, 0].__class__


def numbers(typed=app, words=()):
    """(words of the command, option) of every option that takes a float."""
    found = []
    for group in typed.registered_groups:
        found += numbers(group.typer_instance, (*words, group.name))
    for command in typed.registered_commands:
        name = command.name or command.callback.__name__
        for parameter, hint in get_type_hints(command.callback, include_extras=True).items():
            inner, *extras = get_args(hint) if hint.__class__ is ANNOTATED else (hint,)
            if float in (inner, *get_args(inner)):
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
