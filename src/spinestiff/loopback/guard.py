"""What stands before every request: this page, from this machine, with this start's token, and nothing large or slow.

The server listens on loopback, but every page of every site that the browser shows can send requests there. A foreign
Host (DNS rebinding) or Origin is refused, and data are given to, and taken from, nobody without the token.
"""

from __future__ import annotations

import asyncio
import json
import secrets
from collections.abc import Awaitable, Callable, Mapping, MutableMapping
from dataclasses import dataclass, field
from typing import Any

TOKEN_HEADER = "x-spinestiff-token"
PROXY_HEADER = "x-spinestiff-proxy"
LARGEST_BODY = 4_000_000
"""Bytes of a request. An annotation of many frames has some hundred kilobytes; larger files come in pieces."""
BODY_S = 60.0
"""Seconds that a body may take to arrive."""
DATA = "/api/"
HEADERS = {
    "content-security-policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src data:; connect-src 'self'; "
        "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    ),
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


@dataclass(frozen=True)
class Access:
    """Who may ask for what.

    Attributes
    ----------
    token : asked of every request for data, never for the page itself, which holds none.
    origins : of the page, by the Host of its requests.
    headers : that differ from ``HEADERS``, by the beginning of the path.
    read_only : nothing may be changed. harmless : ends of paths that change nothing when something is sent there.
    proxy_secret : of a reverse proxy that has checked who asks; asked of every request, the page's own included.
    command : that prints the page's address.
    """

    token: str
    origins: Mapping[str, str]
    headers: tuple[tuple[str, Mapping[str, str]], ...] = ()
    read_only: bool = False
    harmless: tuple[str, ...] = ()
    proxy_secret: str | None = field(default=None, repr=False)
    command: str = "spinestiff annotate"

    def headers_of(self, path: str) -> Mapping[str, str]:
        """The headers of an answer."""
        own = next((found for start, found in self.headers if path.startswith(start)), {})
        return {**HEADERS, **own}


def own_origins(port: int) -> dict[str, str]:
    """The origins of a page on this machine, by Host. Browsers leave the port out where it is that of HTTP."""
    end = "" if port == 80 else f":{port}"
    return {f"{host}{end}": f"http://{host}{end}" for host in ("127.0.0.1", "localhost")}


class Guard:
    """ASGI middleware that lets through what this page may ask.

    Parameters
    ----------
    app : what is guarded.
    """

    def __init__(self, app: App, access: Access) -> None:
        self.app, self.access = app, access

    @property
    def token(self) -> str:
        """Of this start."""
        return self.access.token

    async def __call__(self, scope: Message, receive: Receive, send: Send) -> None:
        if scope["type"] == "lifespan":
            return await self.app(scope, receive, send)
        if scope["type"] != "http":
            return await send({"type": "websocket.close", "code": 1008})
        refusal = self._refusal(scope)
        body = b""
        guarded = _guarded(send, self.access.headers_of(scope["path"]))
        if refusal is None:
            try:
                body, refusal = await asyncio.wait_for(_body(scope, receive), BODY_S)
            except TimeoutError:
                refusal = 408, f"the request took more than {BODY_S:g} s to arrive"
        if refusal is not None:
            return await _refuse(guarded, *refusal)
        return await self.app(scope, _replayed(body, receive), guarded)

    def _refusal(self, scope: Message) -> tuple[int, str] | None:
        access = self.access
        headers: dict[str, list[str]] = {}
        for key, value in scope["headers"]:
            headers.setdefault(key.decode("latin-1").lower(), []).append(value.decode("latin-1"))
        host = headers.get("host", [])
        if len(host) != 1 or host[0] not in access.origins:
            return 421, "this server does not answer to that name"
        if access.proxy_secret is not None and not _is(headers.get(PROXY_HEADER, []), access.proxy_secret):
            return 403, "requests come through the proxy, which checks who asks"
        if any(origin != access.origins[host[0]] for origin in headers.get("origin", [])):
            return 403, "requests of other pages are refused"
        if any(site not in ("same-origin", "none") for site in headers.get("sec-fetch-site", [])):
            return 403, "requests of other sites are refused"
        path: str = scope["path"]
        if DATA in path and not _is(headers.get(TOKEN_HEADER, []), access.token):
            return 403, f"this page is of another start; open the address that {access.command} printed last"
        harmless = scope["method"] in ("GET", "HEAD") or (scope["method"] == "POST" and path.endswith(access.harmless))
        if access.read_only and not harmless:
            return 403, "this server was started to be looked at only; nothing can be changed"
        return None


def _is(given: list[str], wanted: str) -> bool:
    return len(given) == 1 and secrets.compare_digest(given[0].encode(), wanted.encode())


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


def _guarded(send: Send, headers: Mapping[str, str]) -> Send:
    """``send`` with the headers that every answer has."""

    async def guarded(message: Message) -> None:
        if message["type"] == "http.response.start":
            kept = [(key, value) for key, value in message["headers"] if key.decode("latin-1").lower() not in headers]
            own = [(key.encode(), value.encode()) for key, value in headers.items()]
            message = {**message, "headers": [*kept, *own]}
        await send(message)

    return guarded


async def _refuse(send: Send, status: int, why: str) -> None:
    body = json.dumps({"error": why}).encode()
    headers = [(b"content-type", b"application/json"), (b"content-length", str(len(body)).encode())]
    if status in (408, 413):
        # The rest of the body stays unread.
        headers.append((b"connection", b"close"))
    await send({"type": "http.response.start", "status": status, "headers": headers})
    await send({"type": "http.response.body", "body": body})
