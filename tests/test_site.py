"""The documentation site builds without a warning, and keeps what it promises: links, pictures, no other host."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import zlib
from pathlib import Path

import pytest

import spinestiff
from chromium import Tab, browser

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
for package in ("sphinx", "furo", "myst_nb", "sphinx_copybutton", "latex2mathml", "ziamath"):
    pytest.importorskip(package, reason="the documentation site needs the extra [docs]")

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The built site; the notebooks are run on the way."""
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q", "-d", str(folder / "doctrees")]
    one = {"OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1", "SPINESTIFF_THREADS": "1"}
    done = subprocess.run(
        [*command, str(DOCS), str(folder / "html")], env=os.environ | one, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return folder / "html"


@pytest.fixture(scope="module")
def documented(site: Path) -> set[str]:
    """Names of all entries of the API reference."""
    inventory = (site / "objects.inv").read_bytes()
    start = inventory.index(b"zlib.\n") + len(b"zlib.\n")
    lines = zlib.decompress(inventory[start:]).decode().splitlines()
    return {line.split()[0] for line in lines if line.split()[1].startswith("py:")}


def pages(site: Path) -> list[Path]:
    return sorted(site.rglob("*.html"))


def test_every_page_is_there(site: Path) -> None:
    sources = [path for path in DOCS.rglob("*") if path.suffix in (".md", ".ipynb") and "checkpoint" not in path.name]
    assert len(sources) > 50
    missing = [path.name for path in sources if not (site / path.relative_to(DOCS)).with_suffix(".html").exists()]
    assert not missing


def test_the_reference_has_every_public_name(documented: set[str]) -> None:
    missing = [name for name in dir(spinestiff) if name != "__version__" and f"spinestiff.{name}" not in documented]
    assert not missing


def test_docstrings_read_as_they_are_written(site: Path) -> None:
    """Entries of sections are a list, what follows is text again, and indented equations stay as they stand."""
    text = (site / "api" / "equilibrium.html").read_text(encoding="utf-8")
    assert re.search(r"<li><p><strong>tolerance</strong> – residual to reach, N;", text)
    assert re.search(r"<p>Held degrees of freedom stay where the start has them", text)
    equations = re.findall(r"<pre>(.*?)</pre>", (site / "api" / "inside-mechanics.html").read_text("utf-8"), re.DOTALL)
    assert any("theta = log(Q_p^T Q_c)" in re.sub("<[^>]*>", "", block) for block in equations)


def test_the_page_on_commands_has_them_all(site: Path) -> None:
    from typer.main import get_group

    from spinestiff.app.cli import app

    text = (site / "commands.html").read_text(encoding="utf-8")
    missing = [name for name in get_group(app).commands if not re.search(rf'<section id="{name}\b', text)]
    assert not missing
    assert text.count("--mesh") >= 5


def test_every_name_in_the_text_is_a_link(site: Path) -> None:
    """A name of the package in code marks that is no link is one that docs/api lacks."""
    code = re.compile(r'(<a [^>]*>)?<code [^>]*><span class="pre">((?:spinestiff|ss)(?:\.\w+)+)</span></code>')
    linked, bare = 0, []
    for path in pages(site):
        if path.stem == "changelog" or "api" in path.parts:  # names of the past; signatures
            continue
        for link, name in code.findall(path.read_text(encoding="utf-8")):
            linked += bool(link)
            bare += [] if link else [f"{path.name}: {name}"]
    assert linked > 100
    assert not bare, bare


def test_equations_are_drawn_by_the_browser(site: Path) -> None:
    text = (site / "method" / "3-3-derivatives.html").read_text(encoding="utf-8")
    assert text.count("<math") > 10
    assert "$$" not in text
    assert (site / "_static" / "STIXTwoMath-Regular.ttf").stat().st_size > 100_000


@pytest.mark.parametrize(
    ("name", "said", "pictures"),
    [("push_a_torso", "by the derivative", 3), ("estimate_stiffness", "three pushes 0.", 2)],
)
def test_notebooks_have_been_run(site: Path, name: str, said: str, pictures: int) -> None:
    text = (site / "notebooks" / f"{name}.html").read_text(encoding="utf-8")
    assert text.count("<img") >= pictures
    assert said in text


def test_no_page_asks_another_host(site: Path) -> None:
    asked = re.compile(r'<(?:script|link|img|iframe|source)\b[^>]*(?:src|href)="(?:https?:)?//[^"]*"')
    wrong = [f"{path.name}: {found[:120]}" for path in pages(site) for found in asked.findall(path.read_text("utf-8"))]
    assert not wrong


# Elements that reach beyond the window and lie in nothing that scrolls.
CUT_OFF = """[...document.querySelectorAll("article *")].filter(element => {
  if (element.getBoundingClientRect().right <= innerWidth + 1) return false;
  for (let box = element.parentElement; box.tagName != "ARTICLE"; box = box.parentElement)
    if (["auto", "scroll"].includes(getComputedStyle(box).overflowX)) return false;
  return !["auto", "scroll"].includes(getComputedStyle(element).overflowX);
}).map(element => element.outerHTML.slice(0, 80))"""


@pytest.mark.skipif(browser() is None, reason="no Chromium")
def test_pages_fit_a_phone(site: Path, tmp_path: Path) -> None:
    shown = ("index", "tutorial", "credibility", "validation", "method/4-2-solver", "api/equilibrium", "protocol-sheet")
    with Tab(tmp_path / "profile", 390, 844) as tab:
        tab.size(390, 844)
        for name in shown:
            tab.open(site / f"{name}.html")
            tab.settle()
            assert tab.run(CUT_OFF) == [], f"{name} is wider than a phone"
        assert not tab.complaints
        assert not [address for address in tab.requests if not str(address).startswith(("file:", "data:"))]
