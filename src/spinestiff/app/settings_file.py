"""``--settings FILE``: options of commands in a TOML file, by their own names.

What stands at the top is for every command that has such an option, what stands under a command's name ([plan],
[study.seven]) for that one. An option on the command line comes before the file, a command's own table before the top.
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import typer

from spinestiff.app.options import check_plain
from spinestiff.errors import OptionError, SpinestiffError
from spinestiff.files import read_text
from spinestiff.words import did_you_mean

NEVER = ("help", "settings", "version")
LARGEST_BYTES = 2**20


def settings_option(context: typer.Context, path: Path | None) -> Path | None:
    """The callback of ``--settings``: what the file says becomes the defaults of the command's options.

    Raises
    ------
    OptionError : the file can't be read, is no TOML, or names a command or an option that there is not; what
        stands in quotes for a number is none, or has an underscore in it.
    """
    if path is not None and not context.resilient_parsing:
        root = context.find_root()
        words = context.command_path.split()[len(root.command_path.split()) :]
        found = settings_of(path, root.command, words)
        check_plain(context.command, found)
        context.default_map = found
    return path


def settings_of(path: Path, program: Any, words: list[str]) -> dict[str, Any]:
    """What a settings file says for one command: values by the names of the command's parameters.

    Parameters
    ----------
    program : the whole program, with all its commands.
    words : that name the command, e.g. ["study", "seven"].

    Raises
    ------
    OptionError : see ``settings_option``; also for what the file says to other commands.
    """
    try:
        content = tomllib.loads(read_text(path, LARGEST_BYTES))
    except ValueError as error:  # also for a number of more digits than Python reads
        raise OptionError(f"--settings {path}: no TOML: {error}") from None
    except RecursionError:
        raise OptionError(f"--settings {path}: no TOML: nested too deeply") from None
    except SpinestiffError as error:
        raise OptionError(f"--settings {error}") from None
    known = {" ".join(names): _options(command) for names, command in _commands(program)}
    everywhere = {option for options in known.values() for option in options}
    tables, top = _parted(content)
    for key in top:
        if key not in everywhere:
            raise OptionError(f"--settings {path}: no command has an option --{key}{did_you_mean(key, everywhere)}")
    own: dict[str, Any] = {}
    for name, options in _under(tables, set(known)):
        if name not in known:
            raise OptionError(
                f"--settings {path}: [{name.replace(' ', '.')}]: no such command{did_you_mean(name, known)}"
            )
        for key in options:
            if key not in known[name]:
                raise OptionError(f"--settings {path}: {name} has no option --{key}{did_you_mean(key, known[name])}")
        if name == " ".join(words):
            own = dict(options)
    mine = known.get(" ".join(words), {})
    asked = {key: value for key, value in top.items() if key in mine} | own
    return {mine[key].name: _value(path, key, value, mine[key]) for key, value in asked.items()}


def _value(path: Path, key: str, value: Any, option: Any) -> Any:
    """As the option takes it: a list as such where the option may be given often, else joined by commas."""
    if isinstance(value, dict) or (isinstance(value, bool) != bool(option.is_flag)):
        wanted = "true or false" if option.is_flag else "a value"
        raise OptionError(f"--settings {path}: {key}: wanted {wanted} as for --{key}")
    several = list(value) if isinstance(value, list) else [value]
    if option.multiple:
        return [str(one) for one in several]
    return ",".join(str(one) for one in several) if isinstance(value, list) else value


def _commands(group: Any, words: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Any]]:
    for name, command in group.commands.items():
        if hasattr(command, "commands"):
            yield from _commands(command, (*words, name))
        else:
            yield (*words, name), command


def _options(command: Any) -> dict[str, Any]:
    """The options of a command by the names that they have on the command line, without dashes."""
    found = {
        word.removeprefix("--"): one
        for one in command.params
        if one.param_type_name == "option"
        for word in one.opts
        if word.startswith("--")
    }
    return {name: one for name, one in found.items() if name not in NEVER}


def _parted(content: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    tables = {key: value for key, value in content.items() if isinstance(value, dict)}
    return tables, {key: value for key, value in content.items() if key not in tables}


def _under(tables: Mapping[str, Any], known: set[str], before: str = "") -> Iterator[tuple[str, dict[str, Any]]]:
    for name, content in tables.items():
        words = f"{before} {name}".strip()
        if any(command.startswith(f"{words} ") for command in known):  # a group: its commands are tables inside
            inner, loose = _parted(content)
            yield from _under(inner, known, words)
            if loose:
                yield words, loose
        else:
            yield words, dict(content)
