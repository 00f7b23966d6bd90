"""The folder that is served: its subjects, each by a key that says nothing of it, and the workbench's own files."""

from __future__ import annotations

import hashlib
import hmac
import os
import re
import secrets
import shutil
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from spinestiff.errors import NotThere, SubjectError
from spinestiff.files import listed, no_folder, trouble, write_bytes
from spinestiff.subject.record_reading import IDENTIFIER, WANTED_ID
from spinestiff.subject.records import SUBJECT_FILE

OWN = ".workbench"
"""Folder of the workbench's own files, beside the subjects."""
KEY = r"[0-9a-f]{16}"
"""Of subjects, uploads, jobs and what lies in the trash."""
SPARE_BYTES = 500 * 2**20
"""Of the disk, that uploads and zip files leave free."""


def room_bytes(folder: Path) -> int:
    """What may still be written where a folder lies; below 0 where less than ``SPARE_BYTES`` is free."""
    return shutil.disk_usage(folder).free - SPARE_BYTES


@dataclass(frozen=True)
class Root:
    """The folder that is served.

    Attributes
    ----------
    path : of it. secret : makes keys from names, so that no name stands in an address, a table or a log.
    """

    path: Path
    secret: bytes = field(repr=False)

    @property
    def own(self) -> Path:
        """The workbench's own files."""
        return self.path / OWN

    def key_of(self, name: str) -> str:
        """The key of a subject's folder, the same at every start."""
        return hmac.new(self.secret, os.fsencode(name), hashlib.sha256).hexdigest()[:16]

    def subjects(self) -> Iterator[tuple[str, Path]]:
        """Key and folder of each subject, in the order of names; links are no subjects, wherever they lead."""
        for folder in listed(self.path, SubjectError):
            hidden = folder.name.startswith(".") or folder.is_symlink()
            if not hidden and os.path.lexists(folder / SUBJECT_FILE):
                yield self.key_of(folder.name), folder

    def subject(self, key: str) -> Path:
        """The folder of a subject. Raises NotThere."""
        for found, folder in self.subjects():
            if hmac.compare_digest(found.encode(), key.encode()):
                return folder
        raise NotThere("this subject is not there, or no longer; go back to all subjects")

    def new_subject(self, name: str) -> Path:
        """Where a new subject goes. Raises SubjectError for what is no name of one, or is taken."""
        if not re.fullmatch(IDENTIFIER, name):
            raise SubjectError(f"name: found {name[:64]!r}, wanted {WANTED_ID}")
        return self.free(name)

    def free(self, name: str) -> Path:
        """The place of a folder of this name, which any file system's folder may have. Raises SubjectError where it is
        taken, or is a path."""
        if Path(name).name != name:
            raise SubjectError(f"name: found {name[:64]!r}, wanted the name of a folder")
        if any(one.name.casefold() == name.casefold() for one in listed(self.path, SubjectError)):
            raise SubjectError("name: there is a folder of that name already; wanted another name")
        return self.path / name


def open_root(path: Path, read_only: bool = False) -> Root:
    """A folder to be served; it is made if it is not there.

    Raises
    ------
    SubjectError : it is a subject itself, or can't be read or written.
    """
    if (path / SUBJECT_FILE).exists():
        raise SubjectError(f"{path}: is a subject itself; wanted the folder around it: {path.resolve().parent}")
    try:
        if not read_only and not os.path.lexists(path):
            path.mkdir(parents=True, exist_ok=True)
        if not path.is_dir():
            raise SubjectError(f"{path}: {no_folder(path)}; wanted one with subject folders in it")
    except OSError as problem:
        raise SubjectError(f"{path}: can't be written ({trouble(problem)})") from None
    place = path.resolve() / OWN / "key"
    if place.is_symlink() or place.parent.is_symlink():
        raise SubjectError(f"{place.parent}: a link; the workbench keeps its own files in the folder itself")
    try:
        secret = place.read_bytes() if place.is_file() else b""
    except OSError as problem:
        raise SubjectError(f"{place}: can't be read ({trouble(problem)})") from None
    try:
        if not read_only:
            # Uploads and parcels lie there: nobody else's to read.
            place.parent.mkdir(exist_ok=True)
            place.parent.chmod(0o700)
    except OSError as problem:
        raise SubjectError(f"{place.parent}: can't be written ({trouble(problem)})") from None
    if len(secret) != 32:
        secret = secrets.token_bytes(32)
        if not read_only:
            write_bytes(place, secret, private=True)
    return Root(path.resolve(), secret)
