"""The documents are true: their code runs, the names and files they mention exist, the commands are the tested ones."""

from __future__ import annotations

import ast
import importlib
import json
import re
import shlex
from pathlib import Path
from typing import Any

import pytest

import spinestiff

ROOT = Path(__file__).parents[1]
DOCUMENTS = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
NOTEBOOKS = sorted((ROOT / "docs").rglob("*.ipynb"))
FENCE = re.compile(r"^```python\n(.*?)^```$", re.MULTILINE | re.DOTALL)
# Python blocks of each document. A block that a change of marking hides from this test would show here.
BLOCKS = {
    "README.md": 1,
    "docs/anatomy.md": 1,
    "docs/cobb.md": 1,
    "docs/conventions.md": 1,
    "docs/mechanics.md": 1,
    "docs/subject-folder.md": 1,
    "docs/synthetic-radiographs.md": 2,
}
COMMANDS = {
    "demo": "python3 -m venv .venv && .venv/bin/pip install -e . && .venv/bin/spinestiff demo",
    "test": 'python3 -m venv .venv && .venv/bin/pip install -e ".[test]" && .venv/bin/pytest',
}


def name_of(path: Path) -> str:
    """A document's name from the root, which is what tests are called by."""
    return path.relative_to(ROOT).as_posix()


def cells(notebook: Path) -> list[dict[str, Any]]:
    return list(json.loads(notebook.read_text(encoding="utf-8"))["cells"])


def blocks(document: Path) -> list[str]:
    return FENCE.findall(document.read_text(encoding="utf-8"))


def test_every_python_block_is_collected() -> None:
    assert {name_of(path): len(blocks(path)) for path in DOCUMENTS if blocks(path)} == BLOCKS
    for path in DOCUMENTS:
        marked = len(re.findall(r"```\s*(?:python|py|pycon)\b", path.read_text(encoding="utf-8"), re.IGNORECASE))
        assert marked == BLOCKS.get(name_of(path), 0), f"{name_of(path)}: a block of Python that is not executed"


EXAMPLES = sorted((ROOT / "examples").glob("*.py"))


@pytest.mark.parametrize("path", [*DOCUMENTS, *EXAMPLES, *NOTEBOOKS], ids=name_of)
def test_examples_and_documents_import_public_names_alone(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".ipynb":
        sources = ["".join(cell["source"]) for cell in cells(path) if cell["cell_type"] == "code"]
    else:
        sources = [text] if path.suffix == ".py" else blocks(path)
    for source in sources:
        for node in ast.walk(ast.parse(source)):
            if isinstance(node, ast.Import):
                assert not [alias.name for alias in node.names if alias.name.startswith("spinestiff.")]
            elif isinstance(node, ast.ImportFrom):
                assert not str(node.module).startswith("spinestiff."), node.module
    hidden = [name for name in re.findall(r"\bss\.(\w+)", text) if name not in dir(spinestiff)]
    assert not hidden, f"no public names: {hidden}"


def test_the_page_of_public_names_has_them_all() -> None:
    page = (ROOT / "docs" / "public-names.md").read_text(encoding="utf-8")
    listed = re.findall(r"^\| `(\w+)` \|", page, re.MULTILINE)
    assert sorted(listed) == sorted(set(dir(spinestiff)) - {"__version__"})


def write_documented_subject(folder: Path) -> None:
    """The subject folder that docs/subject-folder.md shows, with empty radiographs."""
    document = (ROOT / "docs" / "subject-folder.md").read_text(encoding="utf-8")
    subject, annotation = re.findall(r"^```json\n(.*?)^```$", document, re.MULTILINE | re.DOTALL)
    for name in ("rest/frontal.dcm", "rest/lateral.dcm", "pushes/right-8.dcm"):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).touch()
    (folder / "subject.json").write_text(subject, encoding="utf-8")
    (folder / "annotation.json").write_text(annotation, encoding="utf-8")


@pytest.mark.parametrize("name", sorted(BLOCKS))
def test_python_blocks_run(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    write_documented_subject(tmp_path / "03")
    (document,) = [path for path in DOCUMENTS if name_of(path) == name]
    namespace: dict[str, object] = {"__name__": "__document__"}
    for number, block in enumerate(blocks(document), 1):
        exec(compile(block, f"{name}, block {number}", "exec"), namespace)  # one after the other, as a reader would


@pytest.mark.parametrize("document", DOCUMENTS, ids=name_of)
def test_named_objects_exist(document: Path) -> None:
    text = document.read_text(encoding="utf-8")
    missing = [name for name in re.findall(r"`(spinestiff(?:\.\w+)+)`", text) if not resolves(name)]
    assert not missing, missing


def resolves(name: str) -> bool:
    parts = name.split(".")
    for cut in range(len(parts), 0, -1):
        try:
            found: object = importlib.import_module(".".join(parts[:cut]))
        except ModuleNotFoundError:
            continue
        for attribute in parts[cut:]:
            if not hasattr(found, attribute):
                return False
            found = getattr(found, attribute)
        return True
    return False


@pytest.mark.parametrize("document", DOCUMENTS, ids=name_of)
def test_named_files_and_links_exist(document: Path) -> None:
    text = re.sub(r"^```.*?^```$", "", document.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    named = re.findall(r"`((?:\w+/)+[\w.-]+\.(?:py|md|png|toml|ipynb|css))`", text)
    bases = (ROOT, ROOT / "src", ROOT / "src" / "spinestiff")
    missing = [name for name in named if not any((base / name).exists() for base in bases)]
    links = [link.split("#")[0] for link in re.findall(r"\]\(([^)\s]+)\)", text) if "://" not in link]
    missing += [link for link in links if link and not (document.parent / link).exists()]
    assert not missing, missing


def test_architecture_lists_every_module() -> None:
    source = ROOT / "src" / "spinestiff"
    real = {path.relative_to(source).as_posix() for path in source.rglob("*.py") if path.stat().st_size}
    listed, folder = set(), ""
    document = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    (tree,) = re.findall(r"^```text\n(\(top\).*?)^```$", document, re.MULTILINE | re.DOTALL)
    for line in tree.splitlines():
        name = line.split()[0]
        if not line.startswith(" "):
            folder = name if name.endswith("/") else ""
        else:
            listed.add(folder + name)
    # What only holds a sentence about its folder needs no line of its own.
    packages = {f"{package.name}/__init__.py" for package in source.iterdir() if package.is_dir()}
    assert listed - packages == real - packages


def test_readme_names_the_commands_that_exist() -> None:
    from typer.main import get_group

    from spinestiff.app.cli import app

    real = set(get_group(app).commands)
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    shown = set(re.findall(r"(?:^|`|/)spinestiff ([a-z]+)", readme, re.MULTILINE))
    assert shown <= real, shown - real
    assert not [verb for verb in real if not re.search(rf"`{verb}`|spinestiff {verb}\b", readme)]


@pytest.mark.parametrize("document", DOCUMENTS, ids=name_of)
def test_commands_shown_exist_with_their_options(document: Path) -> None:
    """Lines of shell blocks that begin with spinestiff, up to a comment or a redirection."""
    from typer.main import get_group

    from spinestiff.app.cli import app

    text = document.read_text(encoding="utf-8")
    shown = [
        line.replace("\\n", " ")
        for block in re.findall(r"^```sh\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
        for line in block.splitlines()
        if line.startswith("spinestiff ")
    ]
    wrong = []
    for line in shown:
        command: Any = get_group(app)
        words = shlex.split(line, comments=True)[1:]
        while words and hasattr(command, "commands"):
            name = words.pop(0)
            if name not in command.commands:
                wrong.append(f"{line}: no command {name}")
                break
            command = command.commands[name]
        else:
            known = {option for parameter in command.params for option in parameter.opts}
            wrong += [f"{line}: no option {word}" for word in words if word.startswith("-") and word not in known]
    assert not wrong, wrong


@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=name_of)
def test_notebooks_are_stored_without_outputs(notebook: Path) -> None:
    """Each build of the site runs them, so that what is shown is never old."""
    assert any(cell["cell_type"] == "code" for cell in cells(notebook))
    assert not any(cell.get("outputs") or cell.get("execution_count") for cell in cells(notebook))


def test_the_page_on_performance_has_the_stored_figures() -> None:
    page = (ROOT / "docs" / "performance.md").read_text(encoding="utf-8")
    stored = json.loads((ROOT / "benchmarks" / "results" / "equilibrium.json").read_text(encoding="utf-8"))
    rows = {row["nodes"]: row for row in stored["rows"] if row["solver"] == "rslab"}
    for name, nodes in (("coarse", 3041), ("fine", 10309)):
        (cells_of,) = re.findall(rf"^\| {name} \| {nodes:,} \| (.+) \|$", page, re.MULTILINE)
        shown = [float(cell.strip(" %")) for cell in cells_of.split("|")]
        row = rows[nodes]
        found = (
            row["factorisation_cpu_s"],
            row["rest_cpu_s"],
            row["soft_cpu_s"],
            100.0 * (1.0 - row["other"]),
            row["peak_gb"],
        )
        assert shown == pytest.approx(found, rel=0.03)
    search = json.loads((ROOT / "benchmarks" / "results" / "estimator_work.json").read_text(encoding="utf-8"))
    seconds = search["fit"]["cpu_s"]
    assert f"| CPU s until the estimate | {seconds['median']:.1f} | {seconds['worst']:.1f} |" in page


def test_the_credibility_table_has_all_factors() -> None:
    """ASME V&V 40 has five factors of verification, six of validation and two of applicability."""
    page = (ROOT / "docs" / "credibility.md").read_text(encoding="utf-8")
    found = {
        title: len(re.findall(r"^\| .+ \| (?:none|low|medium|high) \|$", part, re.MULTILINE))
        for title, part in re.findall(r"^## (\w+)[^\n]*\n(.*?)(?=^## |\Z)", page, re.MULTILINE | re.DOTALL)
    }
    assert {name: found[name] for name in ("Verification", "Validation", "Applicability")} == {
        "Verification": 5,
        "Validation": 6,
        "Applicability": 2,
    }


def test_readme_gives_the_two_commands_that_ci_runs() -> None:
    readme = (ROOT / "README.md").read_text(encoding="utf-8").splitlines()
    script = (ROOT / ".ci" / "run").read_text(encoding="utf-8").splitlines()
    position = 0
    for command in (COMMANDS["demo"], COMMANDS["test"]):
        assert command in readme, f"the README does not give: {command}"
        for step in command.split(" && "):
            assert step in script[position:], f".ci/run does not run, in this order: {step}"
            position += script[position:].index(step) + 1


def test_the_table_of_priors_has_those_that_a_fit_takes() -> None:
    from dataclasses import fields

    from spinestiff.estimation.priors import Priors

    page = (ROOT / "docs" / "subject-folder.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| `(\w+)` \| ([\d.]+) \| [\w ]+ \| \S", page, re.MULTILINE)
    usual = {field.name: field.default for field in fields(Priors) if field.name != "trunk_power"}
    assert {name: float(value) for name, value in rows} == usual
