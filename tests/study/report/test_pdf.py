"""The report as a PDF: with a browser, without one, and with one that prints nothing."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import pytest

from chromium import browser
from spinestiff.errors import OptionError
from spinestiff.study.report.pdf import PDF_FILE, check_paper, installed_browser, print_report

PAGE = "<!DOCTYPE html><html><head><title>x</title></head><body><p>one</p></body></html>"


@pytest.fixture
def page(tmp_path: Path) -> Path:
    path = tmp_path / "results" / "report.html"
    path.parent.mkdir()
    path.write_text(PAGE, encoding="utf-8")
    return path


def stand_in(folder: Path, script: str) -> None:
    """A program that is found as a browser."""
    folder.mkdir()
    program = folder / "chromium"
    program.write_text(f"#!/bin/sh\n{script}\n")
    program.chmod(0o755)


def test_without_a_browser_one_line_says_so(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    said = r"--pdf: no browser on PATH \(looked for chromium, .*msedge\); install one, or open .*report\.html"
    with pytest.raises(OptionError, match=said) as error:
        print_report(page, "a4")
    assert "\n" not in str(error.value)
    assert [path.name for path in page.parent.iterdir()] == ["report.html"]


@pytest.mark.parametrize(("paper", "size"), [("a4", (595, 842)), ("letter", (612, 792))])
@pytest.mark.skipif(browser() is None, reason="no Chromium to print with")
def test_a_browser_prints_it_on_the_paper_asked_for(page: Path, paper: str, size: tuple[int, int]) -> None:
    made = print_report(page, paper)
    assert made == page.with_name(PDF_FILE)
    content = made.read_bytes()
    assert content.startswith(b"%PDF") and len(re.findall(rb"/Type\s*/Page\b", content)) == 1
    box = [float(value) for value in re.search(rb"/MediaBox\s*\[([^\]]*)\]", content)[1].split()]
    assert box[2:] == pytest.approx(size, abs=1.5)
    # Nothing is left beside it, and the page is as it was.
    assert sorted(path.name for path in page.parent.iterdir()) == ["report.html", PDF_FILE]
    assert page.read_text(encoding="utf-8") == PAGE


@pytest.mark.skipif(sys.platform == "win32", reason="a shell script stands in for the browser")
def test_a_browser_that_prints_nothing_is_told(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    stand_in(tmp_path / "bin", "exit 7")
    monkeypatch.setenv("PATH", str(tmp_path / "bin"))
    page.with_name(PDF_FILE).write_bytes(b"old")
    with pytest.raises(OptionError, match=r"--pdf: .*chromium made no PDF \(exit status 7\); open .* and print"):
        print_report(page, "a4")
    # What was there is neither lost nor half written.
    assert page.with_name(PDF_FILE).read_bytes() == b"old"
    assert sorted(path.name for path in page.parent.iterdir()) == ["report.html", PDF_FILE]


@pytest.mark.skipif(sys.platform == "win32", reason="a shell script stands in for the browser")
def test_the_browser_gets_a_copy_an_empty_profile_and_no_patient_s_name(
    page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "asked"
    print_it = 'for a in "$@"; do case "$a" in --print-to-pdf=*) echo %PDF > "${a#*=}";; esac; done'
    stand_in(tmp_path / "bin", f'echo "$@" > {out}\n{print_it}')
    monkeypatch.setenv("PATH", f"{tmp_path / 'bin'}:/bin:/usr/bin")
    assert installed_browser() == str(tmp_path / "bin" / "chromium")
    assert print_report(page, "letter").read_bytes().startswith(b"%PDF")
    asked = out.read_text()
    assert "--headless" in asked and "--user-data-dir=" in asked and str(page) not in asked


def test_paper_is_one_of_two() -> None:
    assert check_paper("A4") == check_paper("a4")
    with pytest.raises(OptionError, match="--paper a5: wanted a4 or letter"):
        check_paper("a5")
