"""``spinestiff deidentify``: radiographs without their patients, and pictures to look for burned-in text in.

Neither names of files and folders nor anything a file holds is printed or written: a file is told by its number in the
order of names, which is also in its new name.
"""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any, NoReturn

from spinestiff.errors import RadiographError
from spinestiff.files import trouble, write_bytes
from spinestiff.imaging.deidentification.burned_in import inspection_row, sheet
from spinestiff.imaging.deidentification.deidentify import NO_DICOM, deidentify
from spinestiff.imaging.deidentification.pseudonyms import key_of, random_key
from spinestiff.imaging.dicom.files import MOST_BYTES
from spinestiff.words import counted

MOST_FILES = 10_000
ROWS_A_SHEET = 4
SHEETS = "-look-for-burned-in-text"


def deidentify_files(
    source: Path, out: Path, key_file: Path | None, burned_in_ok: bool, say: Callable[[str], None]
) -> tuple[list[str], int]:
    """Write the radiographs of a file or folder without their patients.

    Returns what to print, and how many radiographs were refused.

    Raises
    ------
    RadiographError : OUT isn't a new or empty folder, nothing to read or nothing that can be, no DICOM, a key that is
        none; no radiograph has been written.
    """
    if not out.name:
        raise RadiographError("OUT is no name of a folder; name a new folder")
    beside = out.with_name(out.name + SHEETS)
    try:
        _check_places(source, out, beside, key_file)
        files = _files(source)
    except OSError as problem:
        # The problem's own words name a file.
        raise RadiographError(f"IN or OUT, or something in them, can't be read ({trouble(problem)})") from None
    key, is_new = (random_key(), False) if key_file is None else key_of(key_file)
    folders = {folder: number for number, folder in enumerate(dict.fromkeys(file.parent for file in files), 1)}
    refused: dict[str, list[int]] = {}
    left_out, patients, burned_in = Counter[str](), set(), Counter[str]()
    with _Sheets(beside) as sheets:
        for number, file in enumerate(files, 1):
            say(f"deidentify: file {number} of {len(files)}")
            try:
                found = deidentify(_content(file), key, burned_in_ok=burned_in_ok)
            except RadiographError as problem:
                refused.setdefault(str(problem), []).append(number)
                continue
            name = Path(found.patient, f"folder-{folders[file.parent]:03d}", f"image-{number:05d}.dcm")
            _write(out / name, found.content)
            sheets.add(inspection_row(found.frames, name.as_posix()))
            left_out.update(found.left_out)
            patients.add(found.patient)
            burned_in[found.burned_in] += 1
    if not patients and refused.keys() == {NO_DICOM}:
        raise RadiographError(
            f"IN: {counted(len(files), 'file')}, none of them DICOM; name the folder of the radiographs, exported as "
            "DICOM Part 10"
        )
    lines = [f"{burned_in.total()} of {counted(len(files), 'file')} written to {out.name}; patients: {len(patients)}"]
    for why, numbers in refused.items():
        what = "left out" if why == NO_DICOM else "refused"
        lines.append(f"{what}: {why}: number {', '.join(map(str, numbers))} in the order of names")
    lines += [f"not kept, since its value isn't a usual one: {name}, files: {n}" for name, n in left_out.items()]
    if is_new:
        lines.append("key: a new one was written; keep it secret, and give it again to get the same pseudonyms")
    if burned_in:
        lines.append(_burned_in(burned_in, beside.name))
    return lines, sum(len(numbers) for why, numbers in refused.items() if why != NO_DICOM)


class _Sheets:
    """Pictures of the images written so far, on disk however the work ends."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.rows, self.number = folder, [], 0  # type: Path, list[Any], int

    def __enter__(self) -> _Sheets:
        return self

    def add(self, row: Any) -> None:
        self.rows.append(row)
        if len(self.rows) == ROWS_A_SHEET:
            self.flush()

    def flush(self) -> None:
        if self.rows:
            self.number += 1
            _write(self.folder / f"sheet-{self.number:03d}.png", sheet(self.rows))
            self.rows = []

    def __exit__(self, *_: object) -> None:
        self.flush()


def _burned_in(found: Counter[str], folder: str) -> str:
    says = [f"{found[word]} {what}" for word, what in (("NO", "say there is none"), ("YES", "say there is"),
                                                       ("", "don't say")) if found[word]]  # fmt: skip
    return f"burned-in text: {', '.join(says)}; look at every picture in {folder}, then delete that folder"


def _check_places(source: Path, out: Path, beside: Path, key_file: Path | None) -> None:
    if not source.exists():
        raise RadiographError("IN: no such file or folder")
    for place, name in ((out, "OUT"), (beside, f"OUT{SHEETS}")):
        if place.is_file() or (place.is_dir() and any(place.iterdir())):
            raise RadiographError(f"{name} is there already and not empty; name a new folder, nothing is overwritten")
        if os.path.lexists(place) and not place.is_dir():
            raise RadiographError(f"{name} is there already and no folder; name a new folder")
    for inner, outer, what in (
        (out, source, "OUT lies in IN"), (source, out, "IN lies in OUT"), (key_file, out, "the key lies in OUT")
    ):  # fmt: skip
        if inner is not None and Path(os.path.realpath(inner)).is_relative_to(os.path.realpath(outer)):
            raise RadiographError(f"{what}; name a place outside of it")


def _files(source: Path) -> list[Path]:
    """In the order of their names; hidden files and links are passed by."""
    if source.is_file():
        return [source]
    files: list[Path] = []
    for folder, folders, names in os.walk(source, onerror=_refuse):
        folders[:] = [name for name in folders if not name.startswith(".")]
        paths = (Path(folder, name) for name in names if not name.startswith("."))
        files += [path for path in paths if path.is_file() and not path.is_symlink()]
        if len(files) > MOST_FILES:
            raise RadiographError(f"IN holds more than {MOST_FILES} files; take a part of it at a time")
    if not files:
        raise RadiographError("IN holds no files")
    return sorted(files, key=Path.as_posix)


def _refuse(problem: OSError) -> NoReturn:
    raise RadiographError(f"a folder in IN can't be opened ({problem.strerror})") from None


def _content(file: Path) -> bytes:
    try:
        if file.stat().st_size > MOST_BYTES + 2**20:
            raise RadiographError(f"over {MOST_BYTES // 2**20} MB")
        return file.read_bytes()
    except OSError as problem:
        raise RadiographError(f"can't be opened ({trouble(problem)})") from None


def _write(path: Path, content: bytes) -> None:
    write_bytes(path, content, RadiographError, name="OUT")
