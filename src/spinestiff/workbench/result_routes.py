"""What the page asks of results: what there is, pages and pictures by ticket, and subjects as zip files."""

from __future__ import annotations

import re
from typing import Any

from fastapi import BackgroundTasks, FastAPI, Response
from fastapi.responses import FileResponse

from spinestiff.errors import NotThere
from spinestiff.loopback.asking import Body, Sent, sent
from spinestiff.workbench.bench import Bench
from spinestiff.workbench.parcel import PARCEL_S, nameless_parcel, whole_parcel
from spinestiff.workbench.results import TYPES, result_file, results_record
from spinestiff.workbench.visits import visits_record


class Pack(Sent):
    """A subject as a zip file. ``burned_in_ok``: somebody has looked for text in the pictures."""

    nameless: bool
    burned_in_ok: bool = False


def add_results(app: FastAPI, bench: Bench) -> None:
    """Add the routes."""

    @app.get("/api/subjects/{key}/results")
    def results(key: str) -> dict[str, Any]:
        folder = bench.root.subject(key)
        return {**results_record(folder), "ticket": bench.tickets.issue(folder)}

    @app.get("/api/visits/{first}/{second}")
    def visits(first: str, second: str) -> dict[str, Any]:
        return visits_record(bench.root.subject(first), bench.root.subject(second))

    @app.get("/shown/{ticket}/{name}")
    def shown(ticket: str, name: str) -> Response:
        folder = bench.tickets.place(ticket)
        if not folder.is_dir() or not re.fullmatch(r"[a-z-]{1,40}\.(html|png)", name):
            raise NotThere("there is no such page")
        path = result_file(folder, name)
        return Response(path.read_bytes(), media_type=TYPES[path.suffix])

    @app.post("/api/subjects/{key}/zip")
    def pack(key: str, body: Body) -> dict[str, Any]:
        asked, folder = sent(body, Pack), bench.root.subject(key)
        if asked.nameless:
            place = bench.parcels.pack(lambda place: nameless_parcel(folder, place, asked.burned_in_ok))
        else:
            place = bench.parcels.pack(lambda place: whole_parcel(folder, place))
        return {"ticket": bench.tickets.issue(place, PARCEL_S), "bytes": place.stat().st_size}

    @app.get("/parcel/{ticket}")
    def fetch(ticket: str, after: BackgroundTasks) -> Response:
        place = bench.tickets.place(ticket, once=True)
        if place.suffix != ".zip" or not place.is_file():
            raise NotThere("there is no such file")
        after.add_task(place.unlink, missing_ok=True)
        return FileResponse(place, media_type="application/zip", filename="subject.zip")
