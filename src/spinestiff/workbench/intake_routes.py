"""What the page asks of radiographs: uploads in pieces, folders on this machine, what lies in them, and what is made
of it: a new subject, or more of one that is there."""

from __future__ import annotations

import json
import threading
from collections import OrderedDict
from pathlib import Path
from typing import Annotated, Any, Literal

from fastapi import FastAPI, Response
from pydantic import Field

from spinestiff.errors import NotThere, SubjectError
from spinestiff.loopback.asking import Body, Sent, sent
from spinestiff.subject.intake.adding import Standing, add_markers, inputs_of, read_standing
from spinestiff.workbench.additions import add, add_side, add_skin_scan, looked_at_beside, radiographs_record
from spinestiff.workbench.bench import Bench
from spinestiff.workbench.newcomer import Export, Wish, looked_at, make_newcomer, read_export
from spinestiff.workbench.replacing import chosen_instead, looked_at_instead
from spinestiff.workbench.thumbnails import thumbnail

Name = Annotated[str, Field(max_length=2000)]
Key = Annotated[str, Field(max_length=32)]
Number = Annotated[int, Field(ge=0, le=999)]


class File(Sent):
    """A file that is going to come."""

    name: Name
    size: Annotated[int, Field(ge=0)]


class Announce(Sent):
    """Files that are going to come."""

    files: Annotated[list[File], Field(max_length=20_000)]


class Look(Sent):
    """An upload, a folder on this machine or, with a table of pushes, neither, and what somebody says of it.

    ``joined`` : names of radiographs of one frame each that are one push, a list a push.
    ``subject`` : key of the one that it is to be added to; None: a new one.
    ``replaces`` : the radiograph at rest of that subject whose place one of them takes; None: all are added.
    """

    origin: Literal["upload", "source", "none"]
    key: Key = ""
    study: Annotated[str, Field(max_length=40)] | None = None
    frontal: Name | None = None
    lateral: Name | None = None
    table: str | None = None
    joined: Annotated[list[Annotated[list[Name], Field(max_length=1000)]], Field(max_length=100)] = Field(
        default_factory=list
    )
    subject: Key | None = None
    replaces: Literal["rest/frontal", "rest/lateral"] | None = None

    @property
    def wish(self) -> Wish:
        return Wish(self.study, self.frontal, self.lateral, self.table, tuple(map(tuple, self.joined)))


class Make(Look):
    """The same, to make a subject of it."""

    name: Annotated[str, Field(max_length=64)]
    person: dict[str, Any] = Field(default_factory=dict)


class Picture(Look):
    """The same, and the name of the radiograph whose picture is wanted."""

    name: Name


class Side(Look):
    """The same, and the names of the radiographs that show a push from another side; the rest as in ``subject.json``,
    which is judged there."""

    names: Annotated[list[Name], Field(min_length=1, max_length=1000)]
    push: Number
    view: dict[str, Any]


class Markers(Sent):
    """Skin markers of a push, as in ``subject.json``, where they are judged, and the text of their table."""

    push: Number
    markers: dict[str, Any]
    text: str


class Scan(Sent):
    """An upload with a surface scan, and its unit and axes as in ``subject.json``, where they are judged."""

    upload: Key
    scan: dict[str, Any]


class Exports:
    """What was read of uploads, folders and subjects lately: reading takes a while, and is asked for again at each
    choice."""

    def __init__(self, bench: Bench) -> None:
        self.bench = bench
        self._lock = threading.Lock()
        self._read: OrderedDict[tuple[Path, ...], Export] = OrderedDict()
        self._standing: tuple[object, Standing] | None = None

    def standing(self, key: str) -> Standing:
        """A subject and its radiographs. Raises NotThere, SubjectError."""
        folder = self.bench.root.subject(key)
        with self._lock:
            seen = tuple((path, (status := path.stat()).st_mtime_ns, status.st_size) for path in inputs_of(folder))
            if self._standing is None or self._standing[0] != seen:
                self._standing = seen, read_standing(folder)
            return self._standing[1]

    def of(self, asked: Look) -> Export:
        """What is in an upload or folder. Raises SpinestiffError."""
        if asked.origin == "none":
            return Export()
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
        if asked.subject is None:
            return looked_at(exports.of(asked), asked.wish)
        standing, export = exports.standing(asked.subject), exports.of(asked)
        if asked.replaces is not None:
            return looked_at_instead(standing, export, asked.wish, asked.replaces)
        return looked_at_beside(standing, export, asked.wish)

    @app.post("/api/look/picture")
    def picture(body: Body) -> Response:
        asked = sent(body, Picture)
        found = next((one for one in exports.of(asked).found if one.name == asked.name), None)
        if found is None:
            raise NotThere("this radiograph is not there, or no longer")
        content, about = thumbnail(found)
        return Response(content, media_type="application/octet-stream", headers={"x-radiograph": json.dumps(about)})

    @app.post("/api/subjects")
    def make(body: Body) -> dict[str, Any]:
        asked = sent(body, Make)
        key = make_newcomer(bench.root, asked.name, exports.of(asked), asked.wish, asked.person)
        if asked.origin == "upload":
            bench.uploads.discard(asked.key)
        exports.forget()
        return {"key": key}

    @app.get("/api/subjects/{key}/radiographs")
    def radiographs(key: str) -> dict[str, Any]:
        return radiographs_record(exports.standing(key))

    @app.get("/api/subjects/{key}/radiograph")
    def radiograph(key: str, image: str, wide: int, tall: int, part: str = "") -> Response:
        standing = exports.standing(key)
        one = next((one for one in standing.files if standing.images[one.name] == image), None)
        if one is None:
            raise NotThere("this radiograph is not there, or can't be read")
        content, about = thumbnail(one, wide, tall, part)
        return Response(content, media_type="application/octet-stream", headers={"x-radiograph": json.dumps(about)})

    @app.post("/api/subjects/{key}/radiographs")
    def extend(key: str, body: Body) -> dict[str, Any]:
        asked = sent(body, Look)
        return {"changes": add(exports.standing(key), exports.of(asked), asked.wish)}

    @app.post("/api/subjects/{key}/rest")
    def replace(key: str, body: Body) -> dict[str, Any]:
        asked, folder = sent(body, Look), bench.root.subject(key)
        if asked.replaces is None:
            raise SubjectError("the request: wanted replaces, the radiograph at rest that is replaced")
        bench.refuse_busy(key)
        one = chosen_instead(exports.standing(key), exports.of(asked), asked.wish, asked.replaces)
        return {"trash": bench.trash.replace(folder, asked.replaces, one.path, one.scan.sha256)}

    @app.post("/api/subjects/{key}/views")
    def extend_views(key: str, body: Body) -> dict[str, Any]:
        asked = sent(body, Side)
        add_side(exports.standing(key), exports.of(asked), asked.names, asked.push, asked.view)
        return {}

    @app.post("/api/subjects/{key}/scan")
    def extend_skin(key: str, body: Body) -> dict[str, Any]:
        asked = sent(body, Scan)
        add_skin_scan(exports.standing(key), asked.scan, bench.uploads.whole(asked.upload))
        bench.uploads.discard(asked.upload)
        return {}

    @app.post("/api/subjects/{key}/markers")
    def extend_markers(key: str, body: Body) -> dict[str, Any]:
        asked = sent(body, Markers)
        add_markers(exports.standing(key), asked.push, asked.markers, asked.text)
        return {}
