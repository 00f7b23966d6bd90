"""``spinestiff serve``: the workbench, one page on this machine for all steps."""

from __future__ import annotations

from pathlib import Path

import typer

from spinestiff.app.annotate import opened
from spinestiff.errors import OptionError
from spinestiff.files import no_folder
from spinestiff.workbench.bench import open_bench
from spinestiff.workbench.door import check_host
from spinestiff.workbench.server import serve


def serve_folder(
    root: Path,
    sources: list[Path],
    port: int,
    host: str,
    browser: bool,
    read_only: bool,
    jobs: int,
    upload_gb: float,
    proxy: str | None,
    proxy_secret: Path | None,
) -> None:
    """Serve a folder of subjects until Ctrl-C. Raises OptionError, SubjectError."""
    check_host(host, proxy)
    for source in sources:
        if not source.is_dir():
            raise OptionError(f"--source {source}: {no_folder(source)}")
    bench = open_bench(root, tuple(sources), int(upload_gb * 2**30), jobs, read_only)

    def ready(address: str) -> None:
        typer.echo(f"serve: {address}\nCtrl-C ends it; jobs that run go on.")
        if browser and proxy is None and not opened(address):
            typer.echo("no browser was found to open it with; open this address in one")

    serve(bench, ready, port, host, proxy, proxy_secret)
