"""The report as a PDF, printed by a browser that is installed: what its print dialogue would make."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from pathlib import Path

from spinestiff.errors import OptionError
from spinestiff.files import read_text, write_bytes, write_text

BROWSERS = (
    "chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome", "microsoft-edge",
    "microsoft-edge-stable", "msedge",
)  # fmt: skip
"""Names of browsers that print without a window."""
PAPERS = {"a4": ("A4", "271mm"), "letter": ("letter", "253mm")}
"""By option: its name in CSS, and what it leaves for the first page."""
LONGEST_S = 120.0
LARGEST_PAGE = 200_000_000  # bytes
PDF_FILE = "report.pdf"
_FLAGS = (
    "--headless", "--no-first-run", "--disable-sync", "--disable-background-networking", "--disable-component-update",
    "--disable-extensions", "--no-proxy-server", "--enable-unsafe-swiftshader", "--no-pdf-header-footer",
)  # fmt: skip


def check_paper(paper: str) -> tuple[str, str]:
    """A paper of ``PAPERS``. Raises OptionError for one that there is not."""
    if paper.lower() not in PAPERS:
        raise OptionError(f"--paper {paper}: wanted {' or '.join(PAPERS)}")
    return PAPERS[paper.lower()]


def installed_browser() -> str | None:
    """Path of the first of ``BROWSERS`` on PATH."""
    return next((found for name in BROWSERS if (found := shutil.which(name))), None)


def print_report(page: Path, paper: str) -> Path:
    """Print a page to ``report.pdf`` beside it, whole or not at all; returns its path.

    The browser gets a copy of the page, an empty profile and no network; it prints itself, so nothing is asked of
    anybody.

    Raises
    ------
    OptionError : no browser, another paper, or the browser made no PDF.
    """
    (size, height), browser = check_paper(paper), installed_browser()
    if browser is None:
        raise OptionError(
            f"--pdf: no browser on PATH (looked for {', '.join(BROWSERS)}); install one, or open {page} and print"
        )
    # Beside the page: browsers in a sandbox of their own (snap, flatpak) see no temporary folder of the system.
    with tempfile.TemporaryDirectory(dir=page.parent, prefix="pdf-", ignore_cleanup_errors=True) as folder:
        copy, made = Path(folder).resolve() / "report.html", Path(folder).resolve() / PDF_FILE
        style = f"<style>@page {{ size: {size}; }} :root {{ --sheet: {height}; }}</style>"
        write_text(copy, read_text(page, LARGEST_PAGE).replace("</head>", f"{style}\n</head>", 1))
        command = [browser, *_FLAGS, f"--user-data-dir={folder}/profile", f"--print-to-pdf={made}", copy.as_uri()]
        if hasattr(os, "geteuid") and os.geteuid() == 0:
            # No browser has its sandbox for root.
            command.insert(1, "--no-sandbox")
        try:
            done = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, timeout=LONGEST_S)
        except subprocess.TimeoutExpired:
            raise OptionError(f"--pdf: {browser} made no PDF within {LONGEST_S:g} s; open {page} and print") from None
        except OSError as error:
            raise OptionError(f"--pdf: {browser} can't be run ({error.strerror}); open {page} and print") from None
        content = made.read_bytes() if made.is_file() else b""
        if not content.startswith(b"%PDF"):
            raise OptionError(
                f"--pdf: {browser} made no PDF (exit status {done.returncode}); open {page} in a browser and print"
            )
        target = page.with_name(PDF_FILE)
        write_bytes(target, content)
    return target
