"""JSON is written whole or not at all, digests tell every change, and what may be read is told before it is opened."""

from __future__ import annotations

import errno
import json
import math
import os
import re
import socket
import time
from pathlib import Path

import numpy as np
import pytest

from spinestiff.errors import RadiographError, SpinestiffError, SubjectError, TorsoError
from spinestiff.files import (
    check_output,
    check_whole_folder,
    check_writable,
    file_digest,
    read_exported_text,
    read_json,
    read_text,
    regular_file,
    regular_files,
    whole_folder,
    write_bytes,
    write_json,
    write_text,
)
from spinestiff.formats import parse_csv, parse_json, plain_number, plain_word

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
    with pytest.raises(SubjectError, match=r"a: 5\.0 bytes; at most 4 bytes are read"):
        list(regular_files(inside, SubjectError, cap_bytes=4))


@pytest.mark.skipif(os.name == "nt", reason="links of Unix")
def test_what_systems_and_editors_leave_hidden_in_a_folder_is_passed_by(inside):
    (inside / "c" / ".trash").mkdir(parents=True)
    (inside / "c" / "1").write_bytes(b"1")
    before = file_digest(inside)
    (inside / "c" / ".DS_Store").write_bytes(b"where icons lie")
    (inside / "c" / ".trash" / "2").write_bytes(b"2")
    (inside / ".#a").symlink_to("somebody@host.1234")
    (inside / ".links").symlink_to(inside)
    assert [path.relative_to(inside).as_posix() for path in regular_files(inside, SubjectError)] == ["a", "c/1"]
    assert file_digest(inside) == before
    assert [path.name for path in regular_files(inside, SubjectError, but=inside / "c")] == ["a"]


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


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (
            '{\n "height_cm": 157,5\n}',
            r"a.json: not JSON at line 2, column \d+: found 157,5, wanted a decimal point \(157.5\)$",
        ),
        ('{\n "a": 1\n "b": 2}', r"line 3, column 2: a comma is missing before"),
        ('{"a": 1,}', r"line 1, column \d: .*comma.* too many"),
        ('{"a": .5}', "line 1, column 7: wanted a value: a number with"),
        ("{}}", "line 1, column 3: the file goes on after its end"),
        ('{"a', "line 1, column 2: the text that begins here has no closing"),
        ("", "a.json: is empty, wanted JSON$"),
        (" \n", "a.json: is empty, wanted JSON$"),
        ('{"a": 1, // years\n "b": 2}', "line 1, column 10: found a comment, which JSON has not; take it out"),
        ('# my subject\n{"a": 1}', "line 1, column 1: found a comment"),
        ('{"a": 1 /* years */}', "line 1, column 9: found a comment"),
        ("{\u201ca\u201d: 1}", "line 1, column 2: found \u201c, wanted straight double quotes"),
    ],
)
def test_what_is_no_json_is_told_in_words_of_the_file(text, words):
    with pytest.raises(SubjectError, match=words):
        parse_json(text, "a.json")


@pytest.mark.parametrize("text", ['{"a": "%s" "b"}', '{"a": 1 %s', '{"a": "1",%s}', '{"a": "%s,%s'])
def test_a_text_of_many_digits_is_refused_as_fast_as_it_is_read(text):
    began = time.process_time()
    with pytest.raises(SubjectError, match=r"^a\.json: not JSON at line 1"):
        parse_json(text.replace("%s", "1" * 10**5), "a.json")
    # Milliseconds where each digit is looked at once; a minute where each is looked at from all before it.
    assert time.process_time() - began < 2.0


@pytest.mark.parametrize("digits", [20, 21])
def test_a_decimal_comma_is_told_in_numbers_that_somebody_types(digits):
    number = f"{'1' * digits},{'2' * digits}"
    with pytest.raises(SubjectError) as caught:
        parse_json(f'{{"a": {number}}}', "a.json")
    told = f"found {number}, wanted a decimal point ({number.replace(',', '.')})"
    assert (told in str(caught.value)) == (digits == 20) and str(caught.value).count("\n") == 0


@pytest.mark.parametrize("read", [read_text, read_exported_text])
def test_a_spreadsheets_own_format_is_told_from_text(tmp_path, read):
    path = tmp_path / "pushes.csv"
    for beginning in (b"PK\x03\x04\x14\x00", b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1"):
        path.write_bytes(beginning + bytes(range(256)))
        with pytest.raises(SubjectError, match=r"pushes\.csv: a spreadsheet program's own format, wanted text; export"):
            read(path)


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_lines_end_alike_whoever_wrote_them(tmp_path, end):
    path = tmp_path / "table.csv"
    path.write_bytes(end.join(["a,b", "1,2", ""]).encode())
    assert read_text(path) == read_exported_text(path) == "a,b\n1,2\n"


@pytest.mark.parametrize(
    "lines",
    [
        ("name;x;y", "a,b;1,5;2", "c;-3,25;,5"),
        ("y\tx\tname", "2\t1,5\ta,b", ",5\t-3,25\tc"),
        ("name,x,y", '"a,b",1.5,2', "c,-3.25,.5"),
    ],
)
def test_a_csv_may_have_semicolons_tabs_and_decimal_commas(lines):
    rows = parse_csv("\r\n".join(lines), "a.csv", ("name", "x"), ("y",), numbers=("x", "y"))
    assert [row for _, row in rows] == [("a,b", "1.5", "2"), ("c", "-3.25", ".5")]


@pytest.mark.parametrize(
    "text",
    [
        "sep=;\r\nname;x\r\na;1,5\r\nb;2\r\n",
        '"sep=,"\nname,x\na,1.5\nb,2\n',
        "name,x\na,1.5\n,\nb,2\n,\n , \n",
        "name;x;;\na;1,5;;\nb;2;;\n;;;\n",
        "\n\nName,X\na,1.5\nb,2\n",
    ],
    ids=["separator", "quoted separator", "empty rows", "empty columns", "capitals"],
)
def test_what_spreadsheets_add_to_a_table_is_passed_by(text):
    rows = list(parse_csv(text, "a.csv", ("name", "x"), numbers=("x",)))
    assert [row for _, row in rows] == [("a", "1.5"), ("b", "2")]
    assert [text.splitlines()[line - 1][0] for line, _ in rows] == ["a", "b"]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "a.csv: is empty, wanted a row with the columns name,x and perhaps y and rows below it"),
        ("a,1\nb,2\n", "row 1: columns a,1, wanted name,x and perhaps y; the first row has to name the columns"),
        ("name\n", "row 1: columns name, wanted name,x and perhaps y; lacking: x"),
        ("name,x,score\n", "row 1: columns name,x,score, wanted name,x and perhaps y; leave out: score"),
        ("name,x\na,1,2\n", "row 2: 3 fields, wanted 2"),
    ],
)
def test_a_table_of_other_columns_is_refused_by_what_is_odd_in_it(text, words):
    with pytest.raises(SubjectError) as caught:
        list(parse_csv(text, "a.csv", ("name", "x"), ("y",)))
    assert words in str(caught.value)


@pytest.mark.parametrize("text", ["1_000", "6_0.5", "٣", "nan", "inf", "1e9999", "", "0x10", "1,5", "1 2", "60 N"])
def test_what_no_table_writes_for_a_number_is_none(text):
    assert math.isnan(plain_number(text))


def test_a_number_without_end_is_refused_at_once():
    """In a time that grows with its digits; with their square it would be a quarter of an hour."""
    assert math.isnan(plain_number("9" * 100_000 + "x"))


def test_numbers_as_people_write_them():
    texts = ("1", "-1.5", "+.5", "2.", "1e-3", " 4 ")
    assert [plain_number(text) for text in texts] == [1.0, -1.5, 0.5, 2.0, 0.001, 4.0]


def test_words_as_people_write_them():
    words = ("left", "right", "rear")
    texts = ("left", "Left", "L", "ri", "r", "", "x", "lefty")
    assert [plain_word(text, words) for text in texts] == ["left", "left", "left", "right", None, None, None, None]


def test_decimal_commas_among_commas_are_told():
    with pytest.raises(
        SubjectError, match=r"row 2: 3 fields, wanted 2 \(x,y\); numbers with decimal commas need semico"
    ):
        list(parse_csv("x,y\n1,5,2\n", "a.csv", ("x", "y")))


def test_written_json_is_sorted_and_plain(tmp_path):
    path = tmp_path / "results/estimate.json"
    write_json(path, {"b": np.array([1.5, 2.0]), "a": {"z": np.float64(0.1), "y": np.int64(3)}, "c": (1, None)})
    assert read_json(path) == {"a": {"y": 3, "z": 0.1}, "b": [1.5, 2.0], "c": [1, None]}
    assert list(json.loads(path.read_text())) == ["a", "b", "c"]


def test_names_that_are_no_utf8_are_written_by_their_codes(tmp_path):
    name = os.fsdecode(b"M\xfcller \xc3\xa4.dcm")
    write_json(tmp_path / "a.json", {"frames": name})
    assert "M\\udcfcller ä.dcm" in (tmp_path / "a.json").read_text(encoding="utf-8")
    assert read_json(tmp_path / "a.json") == {"frames": name}
    write_text(tmp_path / "a.csv", f"file\n{name}\n")
    assert read_text(tmp_path / "a.csv") == "file\nM\\udcfcller ä.dcm\n"


@pytest.mark.parametrize("bad", [float("nan"), np.array([1.0, np.inf]), {1, 2}, object()])
def test_what_json_lacks_leaves_the_old_file(tmp_path, bad):
    path = tmp_path / "a.json"
    write_json(path, {"old": 1})
    with pytest.raises(SpinestiffError, match=r"a\.json is not written"):
        write_json(path, {"new": bad})
    assert read_json(path) == {"old": 1}
    assert [p.name for p in tmp_path.iterdir()] == ["a.json"]


def test_an_interrupted_write_leaves_the_old_file(tmp_path, monkeypatch):
    path = tmp_path / "a.json"
    write_json(path, {"old": 1})

    def fail(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("spinestiff.files.os.fsync", fail)
    with pytest.raises(SubjectError, match=r"a\.json: can't be written \(the disk is full\)"):
        write_json(path, {"new": 1})
    assert read_json(path) == {"old": 1}
    assert [p.name for p in tmp_path.iterdir()] == ["a.json"]


def test_a_folder_in_the_way_is_one_line(tmp_path):
    (tmp_path / "results").write_text("a file")
    with pytest.raises(SubjectError, match="can't be written"):
        write_json(tmp_path / "results/run.json", {})


def test_a_trial_whether_a_folder_can_be_written_leaves_nothing(tmp_path, monkeypatch):
    (tmp_path / "there").mkdir()
    for folder in (tmp_path / "a" / "b" / "c", tmp_path / "there", tmp_path / "there" / "d" / "e"):
        check_writable(folder, "results")
        assert [path.name for path in tmp_path.rglob("*")] == ["there"]

    with pytest.raises(SubjectError, match="File name too long"):
        check_writable(tmp_path / "a" / "b" / ("x" * 300), "results")
    assert [path.name for path in tmp_path.rglob("*")] == ["there"]

    def fail(*_, **__):
        raise OSError(errno.ENOSPC, "full")

    monkeypatch.setattr(Path, "touch", fail)
    with pytest.raises(SubjectError, match=r"c: can't be written \(the disk is full\), but results go there"):
        check_writable(tmp_path / "a" / "b" / "c", "results")
    assert [path.name for path in tmp_path.rglob("*")] == ["there"]


def test_digests_tell_every_change(tmp_path):
    (tmp_path / "pushes/a").mkdir(parents=True)
    (tmp_path / "pushes/a/Doe^Jane2.dcm").write_bytes(b"two")
    (tmp_path / "pushes/a/Doe^Jane1.dcm").write_bytes(b"one")
    (tmp_path / "subject.json").write_bytes(b"")
    assert file_digest(tmp_path / "subject.json") == "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855"
    with pytest.raises(SubjectError, match="no such file"):
        file_digest(tmp_path / "missing.json")
    # A file more, another content and another order are all changes of the folder.
    first = file_digest(tmp_path / "pushes/a")
    (tmp_path / "pushes/a/3.dcm").write_bytes(b"three")
    second = file_digest(tmp_path / "pushes/a")
    (tmp_path / "pushes/a/3.dcm").write_bytes(b"other")
    third = file_digest(tmp_path / "pushes/a")
    (tmp_path / "pushes/a/3.dcm").rename(tmp_path / "pushes/a/Z.dcm")
    assert len({first, second, third, file_digest(tmp_path / "pushes/a")}) == 4


@pytest.mark.skipif(os.name == "nt", reason="pipes, devices and links of Unix")
@pytest.mark.parametrize(
    ("name", "force", "words"),
    [
        ("a", False, "a: is there already; name another file, or replace it with --force"),
        ("read", True, "this command reads it; name another file"),
        ("same", True, "this command reads it"),
        ("link", True, "this command reads it"),
        ("frames/new", True, "this command reads it"),
        ("closed/new", True, "lies among the inputs in closed; name a file outside of it, or in closed/open"),
        ("closed/open/../new", True, "lies among the inputs"),
        (".", True, "found a folder, wanted the name of a file to write"),
        ("pipe", True, "found a named pipe"),
        ("to pipe", True, "found a named pipe"),
        (os.devnull, True, "found a device"),
        ("itself", True, "can't be written \\(a link that leads to itself\\)"),
        ("n" * 5000, True, "can't be written \\(File name too long\\)"),
        ("a\0b", True, "no name of a file"),
    ],
)
def test_outputs_go_where_nothing_is_lost(inside, monkeypatch, name, force, words):
    monkeypatch.chdir(inside)
    for folder in ("frames", "closed/open"):
        Path(folder).mkdir(parents=True)
    Path("read").write_bytes(b"1")
    os.link("read", "same")
    os.symlink("read", "link")
    os.symlink("itself", "itself")
    os.mkfifo("pipe")
    os.symlink("pipe", "to pipe")
    with pytest.raises(SubjectError, match=rf"^--out .*{words}"):
        check_output(
            Path(name), "--out", inputs=[Path("read"), Path("frames")], closed=Path("closed"), but=Path("closed/open"),
            force=force,
        )  # fmt: skip


def test_outputs_that_lose_nothing_pass(inside):
    inputs = [inside / "read", inside / "frames"]
    check_output(inside / "b", "--out", inputs=inputs)
    check_output(inside / "a", "--out", inputs=inputs, force=True)
    check_output(inside / "closed" / "open" / "b", "--out", closed=inside / "closed", but=inside / "closed" / "open")


@pytest.mark.skipif(os.name == "nt", reason="pipes and devices of Unix")
def test_nothing_is_written_over_a_pipe_or_a_device(inside):
    os.mkfifo(inside / "pipe")
    for path, kind in ((inside / "pipe", "a named pipe"), (inside, "a folder"), (Path(os.devnull), "a device")):
        with pytest.raises(TorsoError, match=f"{path}: found {kind}, wanted the name of a file to write"):
            write_bytes(path, b"1", TorsoError)
    assert sorted(path.name for path in inside.iterdir()) == ["a", "pipe"]


@pytest.mark.skipif(os.name == "nt", reason="modes of Unix")
def test_a_private_file_is_its_owners_alone(inside):
    write_bytes(inside / "key", b"1", private=True)
    assert (inside / "key").stat().st_mode & 0o777 == 0o600


@pytest.mark.skipif(os.name == "nt", reason="modes of Unix")
@pytest.mark.parametrize("mode", [0o600, 0o640, 0o664])
def test_who_may_read_a_file_stays_as_it_was(inside, mode):
    write_bytes(inside / "subject.json", b"1")
    (inside / "subject.json").chmod(mode)
    write_bytes(inside / "subject.json", b"2")
    assert (inside / "subject.json").stat().st_mode & 0o777 == mode


@pytest.mark.parametrize(
    ("number", "words"),
    [
        (errno.ENOSPC, "the disk is full"),
        (errno.EROFS, "the file system is read-only"),
        (errno.EACCES, "no permission"),
        (errno.EISDIR, os.strerror(errno.EISDIR)),
    ],
)
def test_why_a_file_can_not_be_written_is_said_with_its_own_path(inside, monkeypatch, number, words):
    def fail(*_):
        raise OSError(number, os.strerror(number), "temporary")

    monkeypatch.setattr("spinestiff.files.os.fsync", fail)
    with pytest.raises(SubjectError, match=re.escape(f"{inside / 'b'}: can't be written ({words})")):
        write_bytes(inside / "b", b"1")
    assert [path.name for path in inside.iterdir()] == ["a"]


@pytest.mark.skipif(os.name == "nt", reason="pipes of Unix")
def test_a_pipe_is_not_waited_for(inside):
    """Read or hashed, alone or in a folder."""
    os.mkfifo(inside / "pipe")
    for ask in (read_text, read_json, file_digest):
        with pytest.raises(SubjectError, match="pipe: found a named pipe, wanted a file"):
            ask(inside / "pipe")
    with pytest.raises(SubjectError, match="pipe: found a named pipe, wanted a file"):
        file_digest(inside)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        (".", "^.: is no folder that could be made anew; name a new one$"),
        ("..", "^..: is no folder that could be made anew; name a new one$"),
        ("full", "^full: exists and is no empty folder; name a new one$"),
        ("full/file", "^full/file: exists and is no empty folder; name a new one$"),
        ("link", "^link: is a link; name a new folder$"),
        ("full/file/new", r"^full/file/new: can't be written \(.*\); name a new folder$"),
        ("closed/new", r"^closed/new: can't be written \(no permission\); name a new folder$"),
        ("a\0b", r"^'a\\x00b': no name of a folder$"),
    ],
)
def test_a_place_for_no_new_folder_is_refused_beforehand(tmp_path, monkeypatch, name, message):
    monkeypatch.chdir(tmp_path)
    for folder in ("full", "empty", "closed"):
        Path(folder).mkdir()
    Path("full/file").touch()
    Path("link").symlink_to("empty")
    Path("closed").chmod(0o500)
    if name.startswith("closed") and os.access("closed", os.W_OK):
        pytest.skip("for this user no folder is closed")
    with pytest.raises(TorsoError, match=message):
        check_whole_folder(Path(name), TorsoError)
    with pytest.raises(TorsoError, match=message), whole_folder(Path(name), TorsoError):
        raise AssertionError("is not begun")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["closed", "empty", "full", "link"]


def test_a_place_for_a_new_folder_is_left_as_it_is(tmp_path):
    (tmp_path / "empty").mkdir()
    for folder in (tmp_path / "empty", tmp_path / "far" / "new"):
        check_whole_folder(folder, TorsoError)
    assert list(tmp_path.rglob("*")) == [tmp_path / "empty"]


def test_a_folder_is_there_whole_or_not_at_all(tmp_path, monkeypatch):
    with whole_folder(tmp_path / "new", TorsoError) as draft:
        (draft / "a").write_text("a")
        assert not (tmp_path / "new").exists()
    assert [path.name for path in tmp_path.iterdir()] == ["new"]
    other = tmp_path / "other"
    with (
        pytest.raises(SubjectError, match=f"^{re.escape(str(other))}/b: no$"),
        whole_folder(other, TorsoError) as draft,
    ):
        raise SubjectError(f"{draft}/b: no")
    assert [path.name for path in tmp_path.iterdir()] == ["new"]
    monkeypatch.chdir(tmp_path)
    with pytest.raises(TorsoError, match="no folder that could be made anew"), whole_folder(Path("."), TorsoError):
        pass
