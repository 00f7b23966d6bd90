"""What the page asks of jobs: start, cancel, history, and what they say while they run."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator
from typing import Annotated, Any

from fastapi import FastAPI, Query
from fastapi.concurrency import run_in_threadpool
from fastapi.responses import StreamingResponse
from pydantic import Field

from spinestiff.loopback.asking import Body, Sent, sent
from spinestiff.workbench.bench import Bench
from spinestiff.workbench.job_process import LARGEST_LOG
from spinestiff.workbench.job_table import OPEN
from spinestiff.workbench.verbs import VERBS

LOOK_S, PING_S = 0.4, 10.0
Place = Annotated[int, Query(ge=0, le=LARGEST_LOG)]
"""From which byte of a log on its lines are asked for."""


class Ask(Sent):
    """A job for a subject."""

    verb: Annotated[str, Field(max_length=20)]
    options: dict[Annotated[str, Field(max_length=20)], str | float | int | bool] = Field(default_factory=dict)


def add_jobs(app: FastAPI, bench: Bench) -> None:
    """Add the routes."""
    jobs = bench.jobs

    @app.get("/api/verbs")
    def verbs() -> dict[str, Any]:
        return {name: verb.record() for name, verb in VERBS.items()}

    @app.get("/api/jobs")
    def every() -> dict[str, Any]:
        return {"jobs": [job.record() for job in jobs.table.jobs()]}

    @app.get("/api/subjects/{key}/jobs")
    def history(key: str) -> dict[str, Any]:
        bench.root.subject(key)
        return {"jobs": [job.record() for job in jobs.table.jobs(key)]}

    @app.post("/api/subjects/{key}/jobs")
    def start(key: str, body: Body) -> dict[str, Any]:
        asked = sent(body, Ask)
        return jobs.ask(key, asked.verb, asked.options).record()

    @app.post("/api/jobs/{name}/cancel")
    def cancel(name: str) -> dict[str, Any]:
        jobs.table.job(name)
        jobs.table.ask_cancel(name)
        return jobs.table.job(name).record()

    @app.get("/api/jobs/{name}/log")
    def log(name: str, at: Place = 0) -> dict[str, Any]:
        jobs.table.job(name)
        lines, end = jobs.lines(name, at)
        return {"lines": lines, "at": end}

    @app.get("/api/jobs/{name}/events")
    async def events(name: str, at: Place = 0) -> StreamingResponse:
        await run_in_threadpool(jobs.table.job, name)
        headers = {"x-accel-buffering": "no"}
        return StreamingResponse(_events(bench, name, at), media_type="text/event-stream", headers=headers)


async def _events(bench: Bench, name: str, at: int) -> AsyncIterator[str]:
    """Server-sent events: the job where it has changed, lines of its log as they come; ends with the job."""
    before, quiet = None, 0.0
    while True:
        job = await run_in_threadpool(bench.jobs.table.job, name)
        lines, at = await run_in_threadpool(bench.jobs.lines, name, at)
        if lines:
            yield f"id: {at}\nevent: lines\ndata: {json.dumps(lines)}\n\n"
        if job != before:
            before = job
            yield f"event: job\ndata: {json.dumps(job.record())}\n\n"
        if job.state not in OPEN and not lines:
            return
        quiet = 0.0 if lines else quiet + LOOK_S
        if quiet >= PING_S:
            quiet = 0.0
            yield ": still there\n\n"
        await asyncio.sleep(LOOK_S)
