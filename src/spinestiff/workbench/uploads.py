"""Files on their way from a browser: in pieces, counted and limited, beside the subjects until one is made of them."""

from __future__ import annotations

import re
import secrets
import shutil
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from spinestiff.errors import ChangedElsewhere, NotThere, SubjectError
from spinestiff.files import read_json, write_json
from spinestiff.subject.folder import MOST_INPUT_BYTES
from spinestiff.subject.intake.collecting import MOST_FILES
from spinestiff.words import counted
from spinestiff.workbench.names import Names
from spinestiff.workbench.rooms import KEY, Root, room_bytes
from spinestiff.workbench.unzip import unzip

LARGEST_PIECE = 2 * 2**20
MOST_UPLOADS = 20
LEFT_S = 24 * 3600.0
"""Seconds since files of an upload were last told, after which its page is gone."""
FILES, UNPACKED = "files", "unpacked"


class Uploads:
    """The uploads of a served folder.

    Parameters
    ----------
    most_bytes : of one upload, zip files counted as they are and unpacked.
    """

    def __init__(self, root: Root, most_bytes: int) -> None:
        self.folder, self.most_bytes = root.own / "uploads", most_bytes
        self._lock = threading.RLock()
        self._lists: dict[str, list[dict[str, Any]]] = {}

    def begin(self) -> str:
        """A new upload's name."""
        with self._lock:
            self.clear(MOST_UPLOADS - 1)
            name = secrets.token_hex(8)
            (self.folder / name / FILES).mkdir(parents=True)
            self._put(name, [])
            return name

    def clear(self, most: int = MOST_UPLOADS) -> None:
        """Forget what pages that are gone have left: uploads older than ``LEFT_S``, and of more than ``most`` the
        oldest."""
        with self._lock:
            folders = [one for one in self.folder.glob("*") if re.fullmatch(KEY, one.name) and one.is_dir()]
            there = sorted((one.stat().st_mtime, one.name) for one in folders)
            late = time.time() - LEFT_S
            for number, (told, name) in enumerate(there):
                if told < late or number < len(there) - most:
                    self.discard(name)

    def place(self, name: str) -> Path:
        """The folder of an upload. Raises NotThere."""
        if not re.fullmatch(KEY, name) or not (self.folder / name).is_dir():
            raise NotThere("this upload is not there, or no longer; begin anew")
        return self.folder / name

    def announce(self, name: str, files: Sequence[tuple[str, int]]) -> list[dict[str, Any]]:
        """Take files, name and size of each, into an upload; returns all of them with the bytes that have come.

        Raises
        ------
        SubjectError : too many, too large, or the disk is too full.
        """
        with self._lock:
            listed = list(self._list(name))
            names = Names(one["path"] for one in listed)
            for given, size in files:
                if size > MOST_INPUT_BYTES and not given.lower().endswith(".zip"):
                    most = f"{MOST_INPUT_BYTES // 2**20} MB"
                    raise SubjectError(f"{given[-60:]}: {size // 2**20} MB; radiographs of at most {most} are read")
                listed.append({"path": names.new(given), "size": size})
            total = sum(one["size"] for one in listed)
            if len(listed) > MOST_FILES:
                raise SubjectError(f"{counted(len(listed), 'file')}; at most {MOST_FILES} in one upload")
            if total > self.most_bytes:
                raise SubjectError(
                    f"{total / 2**30:.1f} GB; at most {self.most_bytes / 2**30:g} GB in one upload (--upload-limit)"
                )
            come = sum(self._come(name, number) for number in range(len(self._list(name))))
            wanted = total - come
            if room_bytes(self.folder) < wanted:
                raise SubjectError(f"there is no room on the disk for {wanted / 2**20:.0f} MB")
            self._put(name, listed)
            return [{**one, "come": self._come(name, number)} for number, one in enumerate(listed)]

    def piece(self, name: str, number: int, at: int, content: bytes) -> int:
        """Take a piece of a file; returns how much of it has come.

        Raises
        ------
        ChangedElsewhere : it does not follow what has come, which the message tells.
        SubjectError : no such file, or more than was announced.
        """
        if len(content) > LARGEST_PIECE:
            raise SubjectError(f"a piece of {len(content)} bytes; at most {LARGEST_PIECE} at a time")
        with self._lock:
            listed = self._list(name)
            if not 0 <= number < len(listed):
                raise NotThere("this file was not announced")
            come = self._come(name, number)
            if at != come:
                raise ChangedElsewhere(f"go on at {come}")
            if come + len(content) > listed[number]["size"]:
                raise SubjectError("more bytes than the file was said to have")
            place = self._file(name, number)
            place.parent.mkdir(parents=True, exist_ok=True)
            with place.open("ab") as file:
                file.write(content)
            return come + len(content)

    def whole(self, name: str) -> list[Path]:
        """The folders of an upload that has come, zip files unpacked.

        Raises
        ------
        SubjectError : a file has not come, none has, or a zip file can't be unpacked.
        """
        with self._lock:
            listed, place = self._list(name), self.place(name)
            if not listed:
                raise SubjectError("no file was uploaded")
            for number, one in enumerate(listed):
                if self._come(name, number) != one["size"]:
                    raise SubjectError(f"{one['path']} has not come whole; upload it again")
            packed = {
                number: target
                for number, one in enumerate(listed)
                if one["path"].lower().endswith(".zip") and not (target := place / UNPACKED / str(number)).is_dir()
            }
            if packed:
                room = self.most_bytes - sum(one["size"] for one in listed) - _bytes_in(place / UNPACKED)
                for number, target in packed.items():
                    most = min(room, room_bytes(self.folder))
                    room -= unzip(self._file(name, number), target, max(most, 0))
            return [one for one in (place / FILES, place / UNPACKED) if one.is_dir() and any(one.iterdir())]

    def discard(self, name: str) -> None:
        """Forget an upload."""
        with self._lock:
            shutil.rmtree(self.place(name), ignore_errors=True)
            self._lists.pop(name, None)

    def _list(self, name: str) -> list[dict[str, Any]]:
        if name not in self._lists:
            self._lists[name] = read_json(self.place(name) / "list.json")
        return self._lists[name]

    def _put(self, name: str, listed: list[dict[str, Any]]) -> None:
        write_json(self.place(name) / "list.json", listed)
        self._lists[name] = listed

    def _file(self, name: str, number: int) -> Path:
        return self.place(name) / FILES / str(self._list(name)[number]["path"])

    def _come(self, name: str, number: int) -> int:
        place = self._file(name, number)
        return place.stat().st_size if place.is_file() else 0


def _bytes_in(unpacked: Path) -> int:
    """Of what was unpacked whole; what a process that was killed has left is hidden, and goes before the next try."""
    return sum(one.stat().st_size for one in unpacked.glob("[0-9]*/**/*") if one.is_file())
