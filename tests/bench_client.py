"""Questions to a workbench's server, as its page asks them."""

from __future__ import annotations

import http.client
import json
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from spinestiff.loopback.guard import TOKEN_HEADER
from spinestiff.workbench.bench import Bench
from spinestiff.workbench.uploads import LARGEST_PIECE


@dataclass
class Client:
    """A running server."""

    bench: Bench
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

    def good(self, method, path, body=None) -> Any:
        status, content = self.json(method, path, body)
        assert status == 200, content
        return content

    def key(self, name="girl"):
        return self.bench.root.key_of(name)

    def upload(self, files: dict[str, bytes]) -> str:
        """Send files by name, as the page does; the upload's key."""
        key = self.good("POST", "/api/uploads", {})["key"]
        listed = [{"name": name, "size": len(content)} for name, content in files.items()]
        self.good("POST", f"/api/uploads/{key}/files", {"files": listed})
        for number, content in enumerate(files.values()):
            for at in range(0, len(content), LARGEST_PIECE):
                self.good("PUT", f"/api/uploads/{key}/files/{number}/{at}", content[at : at + LARGEST_PIECE])
        return str(key)

    def upload_folder(self, folder: Path) -> str:
        files = sorted(path for path in folder.rglob("*") if path.is_file())
        return self.upload({path.relative_to(folder.parent).as_posix(): path.read_bytes() for path in files})

    def until(self, job, *states, seconds=60.0):
        end = time.monotonic() + seconds
        while (found := self.bench.jobs.table.job(job)).state not in states:
            assert time.monotonic() < end, found
            time.sleep(0.05)
        return found
