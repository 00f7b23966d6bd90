"""``spinestiff annotate``: the page for vertebra corners, served to this machine alone."""

from __future__ import annotations

import os
import sys
import webbrowser
from pathlib import Path

import typer


def annotate_folder(folder: Path, port: int, browser: bool) -> None:
    """Serve the annotation of a subject folder until Ctrl-C. Raises SubjectError."""
    from spinestiff.annotate.server import serve
    from spinestiff.annotate.session import AnnotationSession
    from spinestiff.files import check_writable

    session = AnnotationSession(folder)
    check_writable(folder, "marks")

    def ready(address: str) -> None:
        typer.echo(f"annotate: {address}\nEvery change is saved at once. Ctrl-C ends it.")
        if browser and not opened(address):
            typer.echo("no browser was found to open it with; open this address in one")

    serve(session, port, ready)


def opened(address: str) -> bool:
    """Whether a browser took the address; never one that runs in this terminal."""
    if sys.platform.startswith("linux") and not any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY")):
        return False
    return webbrowser.open(address)
