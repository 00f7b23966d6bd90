"""What the page asks for a new subject: uploads in pieces, folders on this machine, what lies in them, the making."""

from __future__ import annotations

import threading
from collections import OrderedDict
from pathlib import Path
from typing import Annotated, Any, Literal

from fastapi import FastAPI
from pydantic import Field

from spinestiff.loopback.asking import Body, Sent, sent
from spinestiff.workbench.bench import Bench
from spinestiff.workbench.newcomer import Export, Wish, looked_at, make_newcomer, read_export

Name = Annotated[str, Field(max_length=2000)]


class File(Sent):
    """A file that is going to come."""

    name: Name
    size: Annotated[int, Field(ge=0)]


class Announce(Sent):
    """Files that are going to come."""

    files: Annotated[list[File], Field(max_length=20_000)]


class Look(Sent):
    """An upload or a folder on this machine, and what somebody says of it."""

    origin: Literal["upload", "source"]
    key: Annotated[str, Field(max_length=32)]
    study: Annotated[str, Field(max_length=40)] | None = None
    frontal: Name | None = None
    lateral: Name | None = None

    @property
    def wish(self) -> Wish:
        return Wish(self.study, self.frontal, self.lateral)


class Make(Look):
    """The same, to make a subject of it."""

    name: Annotated[str, Field(max_length=64)]
    person: dict[str, Any] = Field(default_factory=dict)


class Exports:
    """What was read of uploads and folders lately: reading takes a while, and is asked for again at each choice."""

    def __init__(self, bench: Bench) -> None:
        self.bench = bench
        self._lock = threading.Lock()
        self._read: OrderedDict[tuple[Path, ...], Export] = OrderedDict()

    def of(self, asked: Look) -> Export:
        """What is in an upload or folder. Raises SpinestiffError."""
        if asked.origin == "upload":
            places = tuple(self.bench.uploads.whole(asked.key))
        else:
            places = (self.bench.sources.place(asked.key),)
        with self._lock:
            if places not in self._read:
                self._read[places] = read_export(places)
                while len(self._read) > 2:
                    self._read.popitem(last=False)
            return self._read[places]

    def forget(self) -> None:
        """Read anew from here on."""
        with self._lock:
            self._read.clear()


def add_intake(app: FastAPI, bench: Bench) -> None:
    """Add the routes."""
    exports = Exports(bench)

    @app.post("/api/uploads")
    def begin() -> dict[str, Any]:
        return {"key": bench.uploads.begin()}

    @app.post("/api/uploads/{key}/files")
    def announce(key: str, body: Body) -> dict[str, Any]:
        asked = sent(body, Announce)
        exports.forget()
        return {"files": bench.uploads.announce(key, [(one.name, one.size) for one in asked.files])}

    @app.put("/api/uploads/{key}/files/{number}/{at}")
    def piece(key: str, number: int, at: int, body: Body) -> dict[str, Any]:
        return {"come": bench.uploads.piece(key, number, at, body)}

    @app.delete("/api/uploads/{key}")
    def discard(key: str) -> dict[str, Any]:
        exports.forget()
        bench.uploads.discard(key)
        return {}

    @app.get("/api/sources")
    def sources() -> dict[str, Any]:
        return {"sources": [{"key": key, "name": name} for key, name, _ in bench.sources.offered()]}

    @app.post("/api/look")
    def look(body: Body) -> dict[str, Any]:
        asked = sent(body, Look)
        if asked.origin == "source":
            exports.forget()
        return looked_at(exports.of(asked), asked.wish)

    @app.post("/api/subjects")
    def make(body: Body) -> dict[str, Any]:
        asked = sent(body, Make)
        key = make_newcomer(bench.root, asked.name, exports.of(asked), asked.wish, asked.person)
        if asked.origin == "upload":
            bench.uploads.discard(asked.key)
        exports.forget()
        return {"key": key}
