"""The workbench's server: its page, and what the page asks for."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from fastapi import FastAPI, Response
from fastapi.routing import Mount

from spinestiff import __version__
from spinestiff.loopback.asking import bare_application
from spinestiff.loopback.guard import Access, Guard
from spinestiff.loopback.serving import listening, run_server, shipped
from spinestiff.workbench.annotation_rooms import MOUNT, AnnotationRooms
from spinestiff.workbench.bench import Bench
from spinestiff.workbench.door import access_of, check_host
from spinestiff.workbench.intake_routes import add_intake
from spinestiff.workbench.job_routes import add_jobs
from spinestiff.workbench.page_words import page_words
from spinestiff.workbench.result_routes import add_results
from spinestiff.workbench.subject_routes import add_subjects

PAGE = {
    "/": ("index.html", "text/html; charset=utf-8"),
    "/workbench.js": ("workbench.js", "text/javascript; charset=utf-8"),
    "/workbench.css": ("workbench.css", "text/css; charset=utf-8"),
}


def application(bench: Bench) -> FastAPI:
    """The page and its data, still unguarded: what ``serve`` puts behind ``Guard``."""
    app = bare_application(page_words)
    for path in PAGE:
        app.add_api_route(path, _page(path), methods=["GET"])

    @app.get("/api/bench")
    def about() -> dict[str, object]:
        limit = bench.uploads.most_bytes
        return {"version": __version__, "read_only": bench.read_only, "upload_bytes": limit}

    add_subjects(app, bench)
    add_intake(app, bench)
    add_jobs(app, bench)
    add_results(app, bench)
    app.router.routes.append(Mount(MOUNT, app=AnnotationRooms(bench.root)))
    return app


def guarded_application(bench: Bench, access: Access) -> Guard:
    """The application behind its guard."""
    return Guard(application(bench), access)


def serve(
    bench: Bench,
    ready: Callable[[str], None],
    port: int = 0,
    host: str = "127.0.0.1",
    proxy: str | None = None,
    proxy_secret: Path | None = None,
) -> None:
    """Serve until interrupted; jobs that run go on.

    Parameters
    ----------
    ready : called with the page's address once requests are taken.
    port : 0 = any that is free. host : to listen on.
    proxy, proxy_secret : see ``door.access_of``.

    Raises
    ------
    OptionError : an address that others can reach, without a proxy that checks who asks.
    SubjectError : the port is taken.
    """
    check_host(host, proxy)
    with listening(port, "127.0.0.1" if host == "localhost" else host) as sock:
        number = sock.getsockname()[1]
        access = access_of(number, proxy, proxy_secret, bench.read_only)
        if not bench.read_only:
            bench.jobs.start()
        try:
            ready(f"{proxy.rstrip('/')}/" if proxy else f"http://127.0.0.1:{number}/#{access.token}")
            run_server(guarded_application(bench, access), sock)
        finally:
            bench.jobs.stop()
            bench.parcels.close()


def _page(path: str) -> Callable[[], Response]:
    name, kind = PAGE[path]
    content = shipped("spinestiff.workbench", name)

    def page() -> Response:
        return Response(content(), media_type=kind)

    return page
