"""Questions to a workbench's server, as its page asks them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from asking import Asker, wait_for
from spinestiff.workbench.bench import Bench
from spinestiff.workbench.uploads import LARGEST_PIECE


@dataclass
class Client(Asker):
    """A running workbench."""

    bench: Bench

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
        """The job once it is in one of the states."""
        table = self.bench.jobs.table
        wait_for(lambda: table.job(job).state in states, seconds, lambda: table.job(job))
        return table.job(job)
