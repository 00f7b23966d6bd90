"""The annotation page of each subject, under the workbench's own address: /annotate/<key>/."""

from __future__ import annotations

import threading
from collections import OrderedDict
from pathlib import Path

from fastapi import FastAPI
from fastapi.concurrency import run_in_threadpool

from spinestiff.annotate.radiographs import pictures_on_disk
from spinestiff.annotate.server import PAGE, application, page_of
from spinestiff.annotate.session import AnnotationSession
from spinestiff.errors import NotThere, SpinestiffError
from spinestiff.files import file_digest
from spinestiff.loopback.asking import Told, bare_application
from spinestiff.loopback.guard import App, Message, Receive, Send
from spinestiff.subject.records import SUBJECT_FILE
from spinestiff.workbench.rooms import Root

MOUNT = "/annotate"
MOST = 4
"""Subjects whose radiographs stay in memory."""


class AnnotationRooms:
    """An ASGI application that finds the subject in the path and hands the request to its annotation page."""

    def __init__(self, root: Root) -> None:
        self.root = root
        self._rooms: OrderedDict[Path, tuple[str, FastAPI]] = OrderedDict()
        self._lock = threading.Lock()
        self._page = bare_application()
        for path in PAGE:
            self._page.add_api_route(path, page_of(path), methods=["GET"])

    async def __call__(self, scope: Message, receive: Receive, send: Send) -> None:
        """Answer a request: the page is the same for all, data are the subject's."""
        _, key, rest = (scope["path"].removeprefix(MOUNT).split("/", 2) + ["", ""])[:3]
        app: App = self._page
        if rest.startswith("api/"):
            try:
                app = await run_in_threadpool(self._room, key)
            except SpinestiffError as error:
                words = {"error": " ".join(str(error).split())}
                app = Told(words, 404 if isinstance(error, NotThere) else 422)
        await app({**scope, "path": f"/{rest}", "root_path": ""}, receive, send)

    def _room(self, key: str) -> FastAPI:
        """The application of a subject, made anew where ``subject.json`` or a rest radiograph is another than it was.

        Raises SpinestiffError.
        """
        folder = self.root.subject(key)
        with self._lock:
            made_of = f"{file_digest(folder / SUBJECT_FILE)} {pictures_on_disk(folder)}"
            if folder not in self._rooms or self._rooms[folder][0] != made_of:
                self._rooms[folder] = made_of, application(AnnotationSession(folder))
            self._rooms.move_to_end(folder)
            while len(self._rooms) > MOST:
                self._rooms.popitem(last=False)
            return self._rooms[folder][1]
