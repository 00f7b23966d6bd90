"""Zip files of uploads opened with limits: on their number, their size, and how much larger than packed they become."""

from __future__ import annotations

import errno
import io
import os
import shutil
import zipfile
import zlib
from pathlib import Path

from spinestiff.errors import SubjectError
from spinestiff.files import trouble
from spinestiff.subject.folder import MOST_INPUT_BYTES
from spinestiff.subject.intake.collecting import MOST_FILES
from spinestiff.workbench.names import Names

MOST_TIMES = 100
"""How many times larger than packed a zip file may become; radiographs shrink to a third at best."""
SPARED_BYTES = 10 * 2**20
"""Below it, the factor is not asked: black pictures are small."""
LARGEST_LIST = 256 * MOST_FILES
"""Bytes of the list of entries (the central directory), which is read whole before an entry can be counted: 46 an entry
and its name."""
_PIECE = 2**20
# Of other methods all that was read is unpacked at once, however large it becomes.
_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
_DAMAGED = (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError, ValueError, OSError)


class _Bounded(io.BufferedReader):
    """A zip file of which no more than ``LARGEST_LIST`` bytes are read at once, whatever its headers ask for."""

    def read(self, size: int | None = -1, /) -> bytes:
        """As of a file. Raises SubjectError for more than that."""
        if size is None or size < 0:
            size = os.fstat(self.fileno()).st_size - self.tell()
        if size > LARGEST_LIST:
            raise SubjectError(
                f"the list of entries of a zip file of the upload is larger than {LARGEST_LIST / 2**20:.0f} MB, more "
                f"than {MOST_FILES} files need; upload a part of it"
            )
        return super().read(size)


def unzip(archive: Path, target: Path, most_bytes: int) -> int:
    """Unpack a zip file into a new folder; returns the bytes that were written.

    What its headers promise is not trusted: bytes are counted as they come. Folders, links and zip files inside are
    not followed. The folder is there once all is; a file that is refused leaves nothing behind, and what a process that
    was killed has left is taken away by the next try.

    Raises
    ------
    SubjectError : no zip file, damaged or encrypted, packed by a method that is not read; too many files, or too large;
        what is in it can't be written.
    """
    draft = target.with_name(f".{target.name}")
    try:
        if draft.is_dir():
            shutil.rmtree(draft)
        draft.mkdir(parents=True)
        written = _unzip(archive, draft, most_bytes)
        draft.rename(target)
        return written
    except BaseException as problem:
        shutil.rmtree(draft, ignore_errors=True)
        if not isinstance(problem, _DAMAGED):
            raise
        if isinstance(problem, OSError) and problem.errno not in (None, errno.EINVAL):  # a place that is none: damaged
            raise SubjectError(f"a zip file of the upload can't be unpacked ({trouble(problem)})") from None
        what = "is encrypted" if isinstance(problem, RuntimeError) else "is damaged, or no zip file"
        raise SubjectError(f"a zip file of the upload {what}; unpack it yourself and upload the folder") from None


def _unzip(archive: Path, target: Path, most_bytes: int) -> int:
    packed = archive.stat().st_size
    limit = min(most_bytes, max(MOST_TIMES * packed, SPARED_BYTES))
    written, names = 0, Names()
    with _Bounded(io.FileIO(archive)) as packed_file, zipfile.ZipFile(packed_file) as zipped:
        entries = [entry for entry in zipped.infolist() if not entry.is_dir() and not _is_link(entry)]
        if len(entries) > MOST_FILES:
            raise SubjectError(f"a zip file of the upload holds more than {MOST_FILES} files; upload a part of it")
        for entry in entries:
            if entry.compress_type not in _METHODS:
                raise SubjectError(
                    "a zip file of the upload is packed by an unusual method; unpack it yourself and upload the folder"
                )
            place = target / names.new(entry.filename)
            place.parent.mkdir(parents=True, exist_ok=True)
            size = 0
            with zipped.open(entry) as source, place.open("xb") as file:
                while piece := source.read(_PIECE):
                    size += len(piece)
                    written += len(piece)
                    if written > limit:
                        raise SubjectError(
                            f"a zip file of the upload becomes larger than {limit // 2**20} MB when it is unpacked, "
                            "more than radiographs do or there is room for; unpack it yourself and upload the folder"
                        )
                    if size > MOST_INPUT_BYTES:
                        raise SubjectError(
                            "a file in a zip file of the upload is larger than any radiograph that is read"
                        )
                    file.write(piece)
    return written


def _is_link(entry: zipfile.ZipInfo) -> bool:
    return (entry.external_attr >> 16) & 0o170000 == 0o120000
