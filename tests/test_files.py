"""What may be read is told from what may not before it is opened: a pipe that nobody writes to would block."""

from __future__ import annotations

import os
import re
import socket
from pathlib import Path

import pytest

from spinestiff.errors import RadiographError, SubjectError
from spinestiff.files import regular_file, regular_files

FOREIGN = {
    "missing": "no such file",
    "link to itself": "a link that leads to itself",
    "link in a circle": "a link that leads to itself",
    "link to nothing": "a link to a file that is not there",
    "link out": "leads out of the folder inside; copy the file into it",
    "file beside": "leads out of the folder inside",
    "folder": "found a folder, wanted a file",
    "named pipe": "found a named pipe, wanted a file",
    "device": "found a device, wanted a file",
    "socket": "found a socket, wanted a file",
    "behind a file": "can't be opened (Not a directory)",
    "long name": "can't be opened (File name too long)",
    "large": "3.0 MB; at most 2 MB are read",
}


@pytest.fixture
def inside(tmp_path, monkeypatch) -> Path:
    folder = tmp_path / "inside"
    folder.mkdir()
    (folder / "a").write_bytes(b"12345")
    (tmp_path / "beside").write_bytes(b"1")
    monkeypatch.chdir(tmp_path)  # the name of a socket is short
    return folder


def foreign(folder: Path, kind: str) -> Path:
    path = folder / kind
    match kind:
        case "link to itself":
            path.symlink_to(path)
        case "link in a circle":
            path.symlink_to(folder / "other")
            (folder / "other").symlink_to(path)
        case "link to nothing":
            path.symlink_to(folder / "gone")
        case "link out":
            path.symlink_to(folder.parent / "beside")
        case "file beside":
            return folder / ".." / "beside"
        case "folder":
            path.mkdir()
        case "named pipe":
            os.mkfifo(path)
        case "device":
            return Path(os.devnull)
        case "socket":
            with socket.socket(socket.AF_UNIX) as listener:
                listener.bind(str(path.relative_to(Path.cwd())))
        case "behind a file":
            return folder / "a" / "b"
        case "long name":
            return folder / ("n" * 5000)
        case "large":
            with path.open("wb") as file:
                file.truncate(3 * 2**20)
    return path


@pytest.mark.skipif(os.name == "nt", reason="pipes, devices and links of Unix")
@pytest.mark.parametrize("kind", FOREIGN)
def test_what_is_no_file_to_read_is_named_unopened(inside, monkeypatch, kind):
    path = foreign(inside, kind)
    monkeypatch.setattr(os, "open", None)
    monkeypatch.setattr("io.open", None)
    within = None if kind == "device" else inside
    with pytest.raises(SubjectError, match=f"^{re.escape(f'{path}: {FOREIGN[kind]}')}"):
        regular_file(path, SubjectError, within=within, cap_bytes=2 * 2**20)


def test_a_file_is_told_by_its_status(inside):
    (inside / "link").symlink_to(inside / "a")
    for name in ("a", "link"):
        assert regular_file(inside / name, RadiographError, within=inside, cap_bytes=5).st_size == 5
    with pytest.raises(RadiographError, match=r"^front: no such file"):
        regular_file(inside / "b", RadiographError, name="front")
    with pytest.raises(RadiographError, match="no name of a file"):
        regular_file(inside / "a\0b", RadiographError)


def test_files_of_nested_folders_come_in_the_order_of_their_paths(inside):
    for name in ("c/2", "c/1", "b/3", "d"):
        (inside / name).parent.mkdir(exist_ok=True)
        (inside / name).write_bytes(b"1")
    found = [path.relative_to(inside).as_posix() for path in regular_files(inside, SubjectError)]
    assert found == ["a", "b/3", "c/1", "c/2", "d"]
    with pytest.raises(SubjectError, match=r"a: 0\.0 MB; at most"):
        list(regular_files(inside, SubjectError, cap_bytes=4))


@pytest.mark.skipif(os.name == "nt", reason="pipes and links of Unix")
def test_what_is_no_file_in_a_folder_is_refused(inside):
    (inside / "c").mkdir()
    os.mkfifo(inside / "c" / "pipe")
    with pytest.raises(SubjectError, match=r"c/pipe: found a named pipe, wanted a file"):
        list(regular_files(inside, SubjectError))
    (inside / "c" / "pipe").unlink()
    (inside / "c" / "up").symlink_to(inside)
    with pytest.raises(SubjectError, match=r"c/up: found a link to a folder"):
        list(regular_files(inside, SubjectError))
    with pytest.raises(SubjectError, match=r"inside/c: leads out of the folder other"):
        list(regular_files(inside / "c", SubjectError, within=inside / "other"))
    with pytest.raises(SubjectError, match="found no folder"):
        list(regular_files(inside / "a", SubjectError))
