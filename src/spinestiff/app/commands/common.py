"""What every command takes: ``--quiet``, ``-v`` and ``--settings``; and how all read the numbers of their options."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import Annotated, Any, get_type_hints

import typer
from typer.core import TyperCommand

from spinestiff.app.options import check_plain
from spinestiff.app.settings_file import settings_option
from spinestiff.app.volume import Volume, speaking

Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="No progress; warnings and errors alone.")]
Verbose = Annotated[bool, typer.Option("--verbose", "-v", help="What the library logs, too.")]
SettingsFile = Annotated[
    Path | None,
    typer.Option("--settings", callback=settings_option, is_eager=True, help="Options in a TOML file, by their names."),
]
COMMON: dict[str, tuple[Any, Any]] = {
    "quiet": (Quiet, False),
    "verbose": (Verbose, False),
    "settings": (SettingsFile, None),
}


class PlainNumbers(TyperCommand):
    """A command whose numbers are written as people write them: for Python alone "1_0" would be 10.

    Raises
    ------
    OptionError : a number on the command line that is none, or has an underscore in it.
    """

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """As any command; looks at the texts before they become numbers."""
        if not ctx.resilient_parsing:  # as when a shell completes words
            texts, _, _ = self.make_parser(ctx).parse_args(args=list(args))
            check_plain(self, texts)
        return super().parse_args(ctx, args)


def common(command: Callable[..., Any]) -> Callable[..., Any]:
    """The command with the options of ``COMMON``."""
    hints = get_type_hints(command, include_extras=True)
    own = [
        parameter.replace(annotation=hints[name]) for name, parameter in inspect.signature(command).parameters.items()
    ]
    added = [
        inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=hint)
        for name, (hint, default) in COMMON.items()
    ]

    @wraps(command)
    def with_common(
        *args: Any, quiet: bool = False, verbose: bool = False, settings: Path | None = None, **kw: Any
    ) -> Any:
        with speaking(Volume(quiet, verbose)):
            return command(*args, **kw)

    del with_common.__wrapped__  # type: ignore[attr-defined]
    with_common.__signature__ = inspect.Signature([*own, *added])  # type: ignore[attr-defined]
    with_common.__annotations__ = {**hints, **{name: hint for name, (hint, _) in COMMON.items()}}
    return with_common
