"""Questions to a server of this machine, as its page asks them, and how a test waits for what it started."""

from __future__ import annotations

import http.client
import json
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from spinestiff.loopback.guard import TOKEN_HEADER


def wait_for(condition: Callable[[], Any], seconds: float = 30.0, what: Callable[[], Any] = lambda: "") -> Any:
    """What a condition gives once it holds; ``what`` is told where it never does."""
    end = time.monotonic() + seconds
    while not (found := condition()):
        assert time.monotonic() < end, f"not within {seconds:g} s: {what()}"
        time.sleep(0.02)
    return found


@dataclass
class Asker:
    """A running server, asked as its page asks."""

    port: int
    token: str

    @property
    def address(self):
        return f"http://127.0.0.1:{self.port}/#{self.token}"

    def ask(self, method, path, body=None, headers=None, token=None):
        """Status, headers and body of an answer; ``headers`` over those that the page sends."""
        sent = {TOKEN_HEADER: self.token if token is None else token, **(headers or {})}
        sent = {key: value for key, value in sent.items() if value is not None}
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=20)
        try:
            data = body if body is None or isinstance(body, bytes) else json.dumps(body).encode()
            connection.request(method, path, data, sent)
            answer = connection.getresponse()
            return answer.status, dict(answer.getheaders()), answer.read()
        finally:
            connection.close()

    def json(self, method, path, body=None) -> tuple[int, Any]:
        status, _, content = self.ask(method, path, body)
        return status, json.loads(content)
