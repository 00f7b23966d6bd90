"""What stands before every request: this page, from this machine, with this start's token, and nothing large.

The server listens on loopback only, but every page of every site that the browser shows can send requests there. A
foreign Host (DNS rebinding) or Origin is refused, and data are given to, and taken from, nobody without the token.
"""

from __future__ import annotations

import json
import secrets
from collections.abc import Awaitable, Callable, MutableMapping
from typing import Any

TOKEN_HEADER = "x-spinestiff-token"
LARGEST_BODY = 4_000_000
"""Bytes of a request. An annotation of many frames has some hundred kilobytes."""
DATA = "/api/"
POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src data:; connect-src 'self'; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
HEADERS = {
    "content-security-policy": POLICY,
    "x-content-type-options": "nosniff",
    "x-frame-options": "DENY",
    "referrer-policy": "no-referrer",
    "cross-origin-opener-policy": "same-origin",
    "cross-origin-resource-policy": "same-origin",
    # Radiographs are not left behind in the browser's cache.
    "cache-control": "no-store",
}

Message = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[Message]]
Send = Callable[[Message], Awaitable[None]]
App = Callable[[Message, Receive, Send], Awaitable[None]]


class Guard:
    """ASGI middleware that lets through what this page may ask.

    Parameters
    ----------
    app : what is guarded.
    token : of this start; asked of every request for data, never for the page itself, which holds none.
    port : at which the server listens.
    """

    def __init__(self, app: App, token: str, port: int) -> None:
        self.app, self.token = app, token
        self.hosts = (f"127.0.0.1:{port}", f"localhost:{port}")

    async def __call__(self, scope: Message, receive: Receive, send: Send) -> None:
        if scope["type"] == "lifespan":
            return await self.app(scope, receive, send)
        if scope["type"] != "http":
            return await send({"type": "websocket.close", "code": 1008})
        refusal = self._refusal(scope)
        body = b""
        if refusal is None:
            body, refusal = await _body(scope, receive)
        if refusal is not None:
            return await _refuse(_guarded(send), *refusal)
        return await self.app(scope, _replayed(body, receive), _guarded(send))

    def _refusal(self, scope: Message) -> tuple[int, str] | None:
        headers: dict[str, list[str]] = {}
        for key, value in scope["headers"]:
            headers.setdefault(key.decode("latin-1").lower(), []).append(value.decode("latin-1"))
        host = headers.get("host", [])
        if len(host) != 1 or host[0] not in self.hosts:
            return 421, "this server answers to 127.0.0.1 and localhost only"
        if any(origin != f"http://{host[0]}" for origin in headers.get("origin", [])):
            return 403, "requests of other pages are refused"
        if any(site not in ("same-origin", "none") for site in headers.get("sec-fetch-site", [])):
            return 403, "requests of other sites are refused"
        if scope["path"].startswith(DATA):
            token = headers.get(TOKEN_HEADER, [])
            if len(token) != 1 or not secrets.compare_digest(token[0].encode(), self.token.encode()):
                return 403, "this page is of another start; open the address that spinestiff annotate printed last"
        return None


async def _body(scope: Message, receive: Receive) -> tuple[bytes, tuple[int, str] | None]:
    """The whole body, read before anybody acts on it, or why it is refused."""
    refusal = 413, f"more than {LARGEST_BODY} bytes; the server takes no such request"
    declared = [value for key, value in scope["headers"] if key.lower() == b"content-length"]
    if any(not value.isdigit() or int(value) > LARGEST_BODY for value in declared):
        return b"", refusal
    body = bytearray()
    while True:
        message = await receive()
        if message["type"] != "http.request":
            return b"", (400, "the request broke off")
        body += message.get("body", b"")
        if len(body) > LARGEST_BODY:
            return b"", refusal
        if not message.get("more_body", False):
            return bytes(body), None


def _replayed(body: bytes, receive: Receive) -> Receive:
    given = False

    async def replay() -> Message:
        nonlocal given
        if given:
            return await receive()
        given = True
        return {"type": "http.request", "body": body, "more_body": False}

    return replay


def _guarded(send: Send) -> Send:
    """``send`` with the headers that every answer has."""

    async def guarded(message: Message) -> None:
        if message["type"] == "http.response.start":
            kept = [(key, value) for key, value in message["headers"] if key.decode("latin-1").lower() not in HEADERS]
            own = [(key.encode(), value.encode()) for key, value in HEADERS.items()]
            message = {**message, "headers": [*kept, *own]}
        await send(message)

    return guarded


async def _refuse(send: Send, status: int, why: str) -> None:
    body = json.dumps({"error": why}).encode()
    headers = [(b"content-type", b"application/json"), (b"content-length", str(len(body)).encode())]
    if status == 413:
        # The rest of the body stays unread.
        headers.append((b"connection", b"close"))
    await send({"type": "http.response.start", "status": status, "headers": headers})
    await send({"type": "http.response.body", "body": body})
