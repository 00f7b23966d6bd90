"""How a page is served: uvicorn on a socket of ours, and connections that don't say what they want are closed."""

from __future__ import annotations

import asyncio
import os
import socket
from collections.abc import Callable
from contextlib import suppress
from importlib.resources import files
from typing import Any

import uvicorn
from uvicorn.protocols.http.h11_impl import H11Protocol

from spinestiff.errors import SubjectError
from spinestiff.loopback.guard import Guard

LOOPBACK = "127.0.0.1"
HEAD_S = 15.0
"""Seconds in which the head of a request has to arrive."""
UNREAD_S = 60.0
"""Seconds in which some of an answer has to be read."""
MOST_CONNECTIONS = 100


class PatientProtocol(H11Protocol):
    """HTTP/1.1 that waits ``HEAD_S`` for the head of a request, however slowly it trickles in, and no longer.

    Who reads nothing of an answer for ``UNREAD_S`` is let go, too: a connection is one of ``MOST_CONNECTIONS``.
    """

    _timer: asyncio.TimerHandle | None = None
    _unread: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Begin to wait."""
        super().connection_made(transport)
        self._wait()

    def data_received(self, data: bytes) -> None:
        """Wait for the next head, or stop waiting where one is there."""
        super().data_received(data)
        if self.cycle is not None and not self.cycle.response_complete:
            self._stop()
        elif self._timer is None:
            self._wait()

    def on_response_complete(self) -> None:
        """From here on a pause is the keep-alive's, until the next request begins."""
        self._stop()
        super().on_response_complete()

    def connection_lost(self, exc: Exception | None) -> None:
        """Wait no longer."""
        self._stop()
        self._is_read()
        super().connection_lost(exc)

    def pause_writing(self) -> None:
        """What was sent last waits to be read."""
        super().pause_writing()
        self._is_read()
        self._unread = self.loop.call_later(UNREAD_S, self.transport.abort)

    def resume_writing(self) -> None:
        """It was read."""
        self._is_read()
        super().resume_writing()

    def _is_read(self) -> None:
        if self._unread is not None:
            self._unread.cancel()
            self._unread = None

    def _wait(self) -> None:
        self._timer = self.loop.call_later(HEAD_S, self.transport.close)

    def _stop(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None


def server_of(guarded: Guard) -> uvicorn.Server:
    """The server of a guarded page: no log of requests, no name of the program."""
    config = uvicorn.Config(
        guarded, http=PatientProtocol, log_level="error", access_log=False, lifespan="off", server_header=False,
        limit_concurrency=MOST_CONNECTIONS, timeout_graceful_shutdown=2,
    )  # fmt: skip
    return uvicorn.Server(config)


def run_server(guarded: Guard, sock: socket.socket) -> None:
    """Serve until interrupted."""
    # uvicorn stops in order at Ctrl-C and raises it once more afterwards.
    with suppress(KeyboardInterrupt):
        server_of(guarded).run(sockets=[sock])


def listening(port: int, host: str = LOOPBACK) -> socket.socket:
    """A socket that listens. Raises SubjectError if the port is taken, or the address is none of this machine's."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    sock = socket.socket(family, socket.SOCK_STREAM)
    # A server that was killed leaves connections behind that hold its port for a minute; elsewhere than on Windows this
    # takes it over, and never from a server that listens.
    if os.name != "nt":
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        sock.bind((host, port))
        sock.listen()
    except (OSError, OverflowError):
        sock.close()
        raise SubjectError(f"port {port} can't be used on {host}; choose another with --port, or 0 for any") from None
    return sock


def shipped(package: str, name: str) -> Callable[[], Any]:
    """A function that gives the bytes of a file of a page that ships in the folder ``page`` of a package."""
    return lambda: files(package).joinpath("page", name).read_bytes()
