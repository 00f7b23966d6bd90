"""What the page asks of subjects: cards, the form, the trash."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from fastapi import FastAPI, Response
from pydantic import Field

from spinestiff.loopback.asking import Body, Sent, sendable, sent
from spinestiff.subject.folder import read_unannotated
from spinestiff.subject.intake.force_log import RATES_HZ
from spinestiff.workbench.bench import Bench
from spinestiff.workbench.cards import card
from spinestiff.workbench.form import form_record, judged, save_form
from spinestiff.workbench.gauge_log import LogWish, forces_of_log
from spinestiff.workbench.overview import overview_csv

Column = Annotated[str, Field(min_length=1, max_length=100)]


class Check(Sent):
    """Values to be judged, not saved."""

    values: dict[str, Any]


class Save(Sent):
    """Values, made on a revision of the file."""

    values: dict[str, Any]
    revision: Annotated[str, Field(max_length=64)]


class Push(Sent):
    """A push, by its id."""

    push: Annotated[str, Field(max_length=64)]


class Log(Sent):
    """A gauge's log of a push, and what somebody says of it."""

    push: Annotated[int, Field(ge=0, le=999)]
    text: str
    columns: Annotated[tuple[Column, ...], Field(strict=False, min_length=1, max_length=2)] | None = None
    time_unit: Literal["s", "ms"] | None = None
    force_unit: Literal["N", "kgf", "lbf"] | None = None
    offset_s: Annotated[float, Field(ge=-1e9, le=1e9)] | None = None
    rate_hz: Annotated[float, Field(ge=RATES_HZ[0], le=RATES_HZ[1])] | None = None


def add_subjects(app: FastAPI, bench: Bench) -> None:
    """Add the routes."""
    root = bench.root

    @app.get("/api/subjects")
    def subjects() -> dict[str, Any]:
        latest = bench.jobs.table.latest()
        return {"subjects": [card(key, folder, latest.get(key)) for key, folder in root.subjects()]}

    @app.get("/api/table.csv")
    def table() -> Response:
        found = [card(key, folder, None) for key, folder in root.subjects()]
        return Response(sendable(overview_csv(found)), media_type="text/csv; charset=utf-8")

    @app.get("/api/subjects/{key}")
    def subject(key: str) -> dict[str, Any]:
        return card(key, root.subject(key), bench.jobs.table.latest().get(key))

    @app.delete("/api/subjects/{key}")
    def remove(key: str) -> dict[str, Any]:
        folder = root.subject(key)
        bench.refuse_busy(key)
        return {"trash": bench.trash.remove(folder)}

    @app.post("/api/subjects/{key}/pushes/remove")
    def remove_push(key: str, body: Body) -> dict[str, Any]:
        asked, folder = sent(body, Push), root.subject(key)
        bench.refuse_busy(key)
        trash, lines = bench.trash.remove_push(folder, asked.push)
        return {"trash": trash, "lines": lines}

    @app.get("/api/subjects/{key}/form")
    def form(key: str) -> dict[str, Any]:
        return form_record(root.subject(key))

    @app.post("/api/check")
    def check(body: Body) -> dict[str, Any]:
        return judged(sent(body, Check).values)

    @app.put("/api/subjects/{key}/form")
    def save(key: str, body: Body) -> dict[str, Any]:
        asked = sent(body, Save)
        revision = save_form(root.subject(key), asked.values, asked.revision)
        return {"revision": revision, **judged(asked.values)}

    @app.post("/api/subjects/{key}/log")
    def log(key: str, body: Body) -> dict[str, Any]:
        asked, subject = sent(body, Log), read_unannotated(root.subject(key))
        wish = LogWish(asked.columns, asked.time_unit, asked.force_unit, asked.offset_s, asked.rate_hz)
        return forces_of_log(subject, asked.push, asked.text, wish)

    @app.get("/api/trash")
    def trash() -> dict[str, Any]:
        return {"trash": bench.trash.listed()}

    @app.post("/api/trash/{key}/restore")
    def restore(key: str) -> dict[str, Any]:
        if (subject := bench.trash.subject_of(key)) is not None:
            bench.refuse_busy(subject)
        subject, gone = bench.trash.restore(key)
        return {"key": subject, "trash": gone}

    @app.delete("/api/trash/{key}")
    def delete(key: str) -> dict[str, Any]:
        bench.trash.delete(key)
        return {}
