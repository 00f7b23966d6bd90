"""Files: told from pipes, devices and links, read and written whole, never over an input, hashes."""

from __future__ import annotations

import codecs
import errno
import hashlib
import os
import secrets
import shutil
import stat
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from spinestiff.errors import ChangedElsewhere, SpinestiffError, SubjectError
from spinestiff.formats import encodable, json_text, parse_json

LARGEST_JSON = 10 * 2**20
"""Bytes. A subject's files are a few kilobytes; anything larger is another file or an accident."""
_SPREADSHEETS = (b"PK\x03\x04", b"\xd0\xcf\x11\xe0")
"""How .xlsx and .ods, and .xls begin."""

_TROUBLE = {
    errno.ENOSPC: "the disk is full",
    errno.EDQUOT: "the disk quota is used up",
    errno.EFBIG: "the file would be larger than this system allows",
    errno.EROFS: "the file system is read-only",
    errno.EACCES: "no permission",
    errno.EPERM: "no permission",
    errno.ELOOP: "a link that leads to itself",
}

_KINDS = (
    (stat.S_ISDIR, "a folder"),
    (stat.S_ISFIFO, "a named pipe"),
    (stat.S_ISSOCK, "a socket"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
)


def read_json(path: Path) -> Any:
    """The content of a JSON file.

    Raises
    ------
    SubjectError : no such file, no regular one, over 10 MB, not UTF-8, not JSON, a key given twice, a number that is
        not finite.
    """
    return parse_json(read_text(path), path.name)


def read_text(path: Path, largest: int = LARGEST_JSON) -> str:
    """A text file of at most ``largest`` bytes, not yet parsed. Raises SubjectError as ``read_json`` does."""
    content = _content(path, largest)
    try:
        return _with_newlines(content.decode("utf-8-sig"))
    except UnicodeDecodeError as error:
        raise SubjectError(f"{path}: not UTF-8 text (byte {error.start}); save it as UTF-8") from None


def read_exported_text(path: Path, largest: int = LARGEST_JSON) -> str:
    """A text file as devices and spreadsheets write them: UTF-8, UTF-16 with its mark, else Windows' Western letters.

    For files whose meaning lies in numbers and plain English letters: another alphabet's letters may come out wrong.

    Raises
    ------
    SubjectError : as ``read_text``, but for its letters; what is no text.
    """
    content = _content(path, largest)
    if content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return _with_newlines(content.decode("utf-16", errors="replace"))
    if b"\0" in content:
        raise SubjectError(f"{path}: no text; export the table as CSV")
    try:
        return _with_newlines(content.decode("utf-8-sig"))
    except UnicodeDecodeError:
        return _with_newlines(content.decode("cp1252", errors="replace"))


def _with_newlines(text: str) -> str:
    """Lines as Unix ends them, whoever wrote them."""
    return text.replace("\r\n", "\n").replace("\r", "\n")


def _content(path: Path, largest: int) -> bytes:
    """Of what may be a text file: a spreadsheet's own format is refused by name."""
    regular_file(path, SubjectError, cap_bytes=largest)
    try:
        content = path.read_bytes()
    except OSError as error:
        raise SubjectError(f"{path}: can't be read ({error.strerror})") from None
    if content.startswith(_SPREADSHEETS):
        raise SubjectError(f"{path}: a spreadsheet program's own format, wanted text; export the table as CSV")
    return content


def write_json(path: Path, data: Any) -> None:
    """Write ``data`` as JSON: whole or not at all, so that an interrupted run leaves the old file.

    Keys are sorted; NumPy arrays and numbers are written as lists and numbers.

    Raises
    ------
    SpinestiffError : a number that is not finite, or a type that JSON lacks.
    SubjectError : the file can't be written.
    """
    try:
        text = json_text(data)
    except (ValueError, TypeError) as error:
        raise SpinestiffError(f"{path.name} is not written: {error}") from None
    write_text(path, text + "\n")


def write_text(path: Path, text: str) -> None:
    """Write a text file as UTF-8, whole or not at all. Raises SubjectError if it can't be written."""
    write_bytes(path, encodable(text).encode("utf-8"))


def check_writable(folder: Path, what: str) -> None:
    """Refuse a folder in which no file can be made before any work for it is done; nothing is left of the trial.

    Parameters
    ----------
    what : is to be written there, for the message.

    Raises
    ------
    SubjectError : no file can be made in it, or it can't be made itself.
    """
    if (problem := _try(folder)) is not None:
        raise SubjectError(
            f"{folder}: can't be written ({trouble(problem)}), but {what} go there; make it writable, or work on a copy"
        )


def _try(folder: Path) -> OSError | None:
    """What keeps a file from being made in a folder, or the folder itself; nothing is left of the trial."""
    new = [one for one in (folder, *folder.parents) if not os.path.exists(one)]
    probe = folder / f".{secrets.token_hex(8)}.tmp"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        probe.touch(exist_ok=False)
        probe.unlink()
    except OSError as problem:
        return problem
    finally:
        for one in new:
            with suppress(OSError):
                one.rmdir()
    return None


def write_bytes(
    path: Path,
    content: bytes,
    error: type[SpinestiffError] = SubjectError,
    *,
    name: str | None = None,
    private: bool = False,
) -> None:
    """Write a file whole or not at all, so that an interrupted run leaves the old one. Folders on the way are made.

    Who may read a file that is there may read the new one, and nobody else.

    Parameters
    ----------
    name : of the file in messages, if not the whole path.
    private : for its owner alone to read.

    Raises
    ------
    error : the file can't be written, or there is a folder, a named pipe, a socket or a device in its place.
    """
    named = str(path) if name is None else name
    try:
        kind = _kind(path.stat().st_mode) if path.exists() else None
        if kind is not None:
            raise error(f"{named}: found {kind}, wanted the name of a file to write")
        path.parent.mkdir(parents=True, exist_ok=True)
        _replace(path, content, private)
    except OSError as problem:
        raise error(f"{named}: can't be written ({trouble(problem)})") from None
    except ValueError:  # a zero byte in the name
        raise error(f"{named!r}: no name of a file") from None


def trouble(problem: OSError) -> str:
    """Why the file system refused, in words."""
    return _TROUBLE.get(problem.errno or 0) or problem.strerror or type(problem).__name__


def no_folder(path: Path) -> str:
    """What is wrong with a path at which there is no folder, in words."""
    return "no folder" if os.path.lexists(path) else "no such folder"


def check_output(
    path: Path,
    option: str,
    *,
    inputs: Iterable[Path] = (),
    closed: Path | None = None,
    but: Path | None = None,
    force: bool = False,
    error: type[SpinestiffError] = SubjectError,
) -> None:
    """Refuse a place for an output where something would be lost; nothing is opened or written.

    Parameters
    ----------
    path : where the output would go.
    option : that named it, for the message.
    inputs : files and folders that the same command reads: never written over, nor into, whatever ``force`` says.
    closed, but : folder into which nothing is written, but into this folder in it.
    force : whether another file there may be replaced.

    Raises
    ------
    error : a folder, named pipe, socket or device, or a link to one; an input; a place inside a closed folder; a file
        that is there, without ``force``.
    """
    try:
        place = Path(os.path.realpath(path))
        kind = _kind(path.stat().st_mode)
    except FileNotFoundError:
        kind = None
    except OSError as problem:
        raise error(f"{option} {path}: can't be written ({trouble(problem)})") from None
    except ValueError:  # a zero byte
        raise error(f"{option} {str(path)!r}: no name of a file") from None
    if kind is not None:
        raise error(f"{option} {path}: found {kind}, wanted the name of a file to write")
    for one in inputs:
        if place.is_relative_to(one.resolve()) or (path.exists() and one.exists() and path.samefile(one)):
            raise error(f"{option} {path}: this command reads it; name another file")
    inside = closed is not None and place.is_relative_to(closed.resolve())
    if inside and not (but is not None and place.is_relative_to(but.resolve())):
        beside = "" if but is None else f", or in {but}"
        raise error(f"{option} {path}: lies among the inputs in {closed}; name a file outside of it{beside}")
    if not force and os.path.lexists(path):
        raise error(f"{option} {path}: is there already; name another file, or replace it with --force")


def _replace(path: Path, content: bytes, private: bool) -> None:
    temporary = path.with_name(f".{path.name}.{secrets.token_hex(4)}.tmp")
    mode = None if private else _mode(path)
    try:
        with open(temporary, "xb", opener=None if mode is None and not private else _private) as file:
            if mode is not None:
                with suppress(OSError):  # a file system on which all files have the same
                    os.fchmod(file.fileno(), mode)
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def _mode(path: Path) -> int | None:
    """Who may read and write a file that is there; None on Windows, where its folder says that."""
    return stat.S_IMODE(path.stat().st_mode) & 0o777 if os.name != "nt" and path.exists() else None


def _private(path: str, flags: int) -> int:
    return os.open(path, flags, 0o600)


def file_digest(path: Path) -> str:
    """SHA-256 of a file's bytes; of a folder, of its files' digests in the order of their names, hidden ones aside.

    A folder's files aren't named anywhere: exported radiographs are named after patients.

    Raises
    ------
    SubjectError : something can't be read, or is no file: ``regular_file``, ``regular_files``.
    """
    if path.is_dir():
        inside = "".join(map(file_digest, regular_files(path, SubjectError)))
        return hashlib.sha256(inside.encode()).hexdigest()
    regular_file(path, SubjectError)
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise SubjectError(f"{path}: can't be read ({error.strerror})") from None


def copy_known(source: Path, place: Path, sha256: str, name: str) -> None:
    """Copy a file that has been read, and has to be the same still.

    Parameters
    ----------
    sha256 : of the file that was read. name : of the file in messages.

    Raises
    ------
    ChangedElsewhere : it is another file by now; there is no copy then.
    SubjectError : it is no regular file. OSError : it can't be read, or the copy can't be written.
    """
    regular_file(source, SubjectError, name=name)
    shutil.copyfile(source, place)
    if file_digest(place) != sha256:
        place.unlink()
        raise ChangedElsewhere(f"{name}: was changed after it was looked at; look at it again")


def regular_file(
    path: Path,
    error: type[SpinestiffError],
    *,
    within: Path | None = None,
    cap_bytes: int | None = None,
    name: str | None = None,
) -> os.stat_result:
    """What the file system says of a regular file; the file itself is not opened, so that a named pipe can't block.

    Parameters
    ----------
    path : of the file; links are followed.
    error : raised with one line that starts with the name.
    within : folder that the file has to lie in, links followed; None leaves its place open.
    cap_bytes : largest size.
    name : of the file in messages, if not the whole path.

    Raises
    ------
    error : no such file; a link to itself or to nothing; outside ``within``; a folder, named pipe, socket or device;
        a folder on the way that can't be entered; more bytes than ``cap_bytes``.
    """
    named = str(path) if name is None else name
    found = _status(path, error, named)
    if within is not None:
        check_within(path, within, error, name=named)
    kind = _kind(found.st_mode)
    if kind is not None:
        raise error(f"{named}: found {kind}, wanted a file")
    if cap_bytes is not None and found.st_size > cap_bytes:
        unit, by = ("MB", 2**20) if cap_bytes >= 2**20 else ("bytes", 1)
        raise error(f"{named}: {found.st_size / by:.1f} {unit}; at most {cap_bytes / by:g} {unit} are read")
    return found


def check_within(path: Path, within: Path, error: type[SpinestiffError], *, name: str | None = None) -> None:
    """Raise ``error`` unless a path that exists lies in the folder ``within``, links followed."""
    if not path.resolve().is_relative_to(within.resolve()):
        folder = within.name or str(within)
        raise error(f"{path if name is None else name}: leads out of the folder {folder}; copy the file into it")


def regular_files(
    folder: Path,
    error: type[SpinestiffError],
    *,
    within: Path | None = None,
    cap_bytes: int | None = None,
    but: Path | None = None,
) -> Iterator[Path]:
    """Every file of a folder and the folders in it, in the order of their paths, each checked by ``regular_file``.

    Hidden files and folders are passed by: systems and editors leave theirs (.DS_Store, .#subject.json). Links to
    folders are refused, so that a link to a folder around it can't make this endless.

    Parameters
    ----------
    but : what else is passed by, whatever it is.

    Raises
    ------
    error : as ``regular_file``, for the folder itself and whatever is in it; a folder that can't be listed.
    """
    found = _status(folder, error, str(folder))
    if not stat.S_ISDIR(found.st_mode):
        raise error(f"{folder}: found no folder, wanted a folder of files")
    if within is not None:
        check_within(folder, within, error)
    for path in listed(folder, error):
        if path.name.startswith(".") or path == but:
            continue
        if path.is_dir():
            if path.is_symlink():
                raise error(f"{path}: found a link to a folder, wanted files and folders; copy the folder here")
            yield from regular_files(path, error, within=within, cap_bytes=cap_bytes, but=but)
        else:
            regular_file(path, error, within=within, cap_bytes=cap_bytes)
            yield path


def listed(folder: Path, error: type[SpinestiffError], *, name: str | None = None) -> list[Path]:
    """What is in a folder, by name.

    Raises
    ------
    error : the folder can't be listed.
    """
    try:
        return sorted(folder.iterdir())
    except OSError as problem:
        raise error(f"{folder if name is None else name}: can't be listed ({problem.strerror})") from None


def _kind(mode: int) -> str | None:
    """What it is if no regular file, in words."""
    if stat.S_ISREG(mode):
        return None
    return next((words for is_kind, words in _KINDS if is_kind(mode)), "no regular file")


def _status(path: Path, error: type[SpinestiffError], named: str) -> os.stat_result:
    try:
        return path.stat()
    except FileNotFoundError:
        if path.is_symlink():
            raise error(f"{named}: a link to a file that is not there; copy the file itself here") from None
        raise error(f"{named}: no such file") from None
    except ValueError:  # a zero byte in the name
        raise error(f"{named!r}: no name of a file") from None
    except OSError as problem:
        if problem.errno == errno.ELOOP:
            raise error(f"{named}: a link that leads to itself; copy the file itself here") from None
        raise error(f"{named}: can't be opened ({problem.strerror})") from None


def check_whole_folder(folder: Path, error: type[SpinestiffError]) -> None:
    """Refuse a place where ``whole_folder`` can make no folder, before any work for it is done.

    Raises
    ------
    error : it holds something, is a link or no folder, or nothing can be made beside it.
    """
    if folder.name in ("", ".."):
        raise error(f"{folder}: is no folder that could be made anew; name a new one")
    if "\0" in str(folder):
        raise error(f"{str(folder)!r}: no name of a folder")
    if folder.is_symlink():
        raise error(f"{folder}: is a link; name a new folder")
    if os.path.lexists(folder) and not (folder.is_dir() and not listed(folder, error)):
        raise error(f"{folder}: exists and is no empty folder; name a new one")
    if (problem := _try(folder.parent)) is not None:
        raise error(f"{folder}: can't be written ({trouble(problem)}); name a new folder")


@contextmanager
def whole_folder(folder: Path, error: type[SpinestiffError]) -> Iterator[Path]:
    """A folder to write into that becomes ``folder``, new or empty until then, once all is written; else nothing does.

    Raises
    ------
    error : as ``check_whole_folder``; what is raised inside names ``folder``, not the draft.
    """
    check_whole_folder(folder, error)
    draft = folder.with_name(f".{folder.name}.{secrets.token_hex(4)}.tmp")
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        draft.mkdir()
        yield draft
        if folder.exists():
            folder.rmdir()
        draft.rename(folder)
    except OSError as problem:
        raise error(f"{folder}: can't be written ({trouble(problem)}); name a new folder") from None
    except SpinestiffError as problem:
        raise type(problem)(str(problem).replace(str(draft), str(folder))) from None
    finally:
        shutil.rmtree(draft, ignore_errors=True)
