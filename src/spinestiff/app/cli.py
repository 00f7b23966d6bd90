"""``spinestiff``: from radiographs and a force log to a stiffness report, a verb a step.

The list of commands; each lies in a module of ``commands``. Heavy imports stay inside them, so that ``--help`` is
quick. Exit status: 0 done, 1 a check failed, 2 bad input, 3 no equilibrium or no estimate.
"""

from __future__ import annotations

import sys
import warnings
from typing import Annotated

import typer

from spinestiff import __version__
from spinestiff.app import INTERRUPTED, STOPPED
from spinestiff.app.commands import asking, machine, many, showing, steps, subjects, synthetic
from spinestiff.app.commands.common import PlainNumbers, common
from spinestiff.app.study import study
from spinestiff.app.torso import torso
from spinestiff.errors import SpinestiffError, SubjectGaps

app = typer.Typer(
    name="spinestiff",
    help="Stiffness of spine and torso, with its uncertainty, from radiographs taken under measured pushes.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
)
for command in (
    synthetic.synth,
    subjects.inspect,
    subjects.init,
    subjects.annotate,
    subjects.serve,
    steps.track,
    subjects.frames,
    steps.response,
    steps.personalise,
    steps.estimate,
    asking.plan,
    asking.parameters,
    asking.sensitivity,
    steps.assess,
    asking.repeat,
    steps.report,
    showing.view,
    steps.run,
    synthetic.demo,
    many.cohort,
    showing.cobb,
    machine.check,
    machine.phantom,
    subjects.deidentify,
    machine.doctor,
):
    app.command(cls=PlainNumbers)(common(command))
app.add_typer(torso, name="torso")
app.add_typer(study, name="study")


def main() -> None:
    """Run the command line; every known failure ends in one line and its exit status."""
    warnings.showwarning = lambda message, *_, **__: _complain(f"warning: {message}")
    try:
        app()
    except SubjectGaps as error:
        for line in error.lines:
            _complain(line)
        sys.exit(error.exit_status)
    except SpinestiffError as error:
        _complain(str(error))
        sys.exit(error.exit_status)
    except SystemExit as end:
        # Typer turns Ctrl-C into this status without a word.
        if end.code == INTERRUPTED:
            _complain(STOPPED)
        raise
    except OSError as error:
        from spinestiff.files import trouble

        if error.filename is None:  # of the output: whoever reads or writes files names them
            raise
        _complain(f"{error.filename}: can't be read or written ({trouble(error)})")
        sys.exit(2)


def _complain(message: str) -> None:
    print("spinestiff: " + " ".join(message.split()), file=sys.stderr)


def _version(wanted: bool) -> None:
    if wanted:
        typer.echo(__version__)
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    pass


if __name__ == "__main__":
    main()
