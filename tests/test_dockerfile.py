"""The container's recipe without Docker: what it copies makes the wheel, and the wheel has the program it starts."""

from __future__ import annotations

import fnmatch
import json
import os
import re
import shutil
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
TEXT = (ROOT / "Dockerfile").read_text(encoding="utf-8")


def steps() -> list[tuple[str, str]]:
    """Instruction and its words, in order; comments and continued lines are taken care of."""
    lines = [line for line in TEXT.splitlines() if line.strip() and not line.lstrip().startswith("#")]
    whole = re.sub(r"\\\n\s*", "", "\n".join(lines))
    return [(line.split(maxsplit=1)[0], line.split(maxsplit=1)[1]) for line in whole.splitlines()]


def of(instruction: str) -> list[str]:
    return [words for name, words in steps() if name == instruction]


def copied() -> list[str]:
    """What is taken from the repository."""
    return [word for words in of("COPY") if not words.startswith("--from=") for word in words.split()[:-1]]


def offered(command: str) -> list[list[str]]:
    """Words of the program in the calls of ``docker run`` that the header and the documents show."""
    header = re.sub(r"\s*\\\n#\s*", " ", TEXT)
    calls = re.findall(rf"docker run .* spinestiff ({command}\b.*)", header)
    page = (ROOT / "docs" / "command-line.md").read_text(encoding="utf-8")
    assert calls == re.findall(rf"docker run .* spinestiff ({command}\b.*)", page)
    return [call.split() for call in calls]


def test_it_holds_only_known_steps() -> None:
    assert {name for name, _ in steps()} == {
        "FROM",
        "WORKDIR",
        "COPY",
        "RUN",
        "ARG",
        "ENV",
        "USER",
        "ENTRYPOINT",
        "CMD",
    }
    python = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    for base in of("FROM"):
        found = re.match(r"python:(3\.\d+)-slim-bookworm\b", base)
        assert found, f"{base}: no fixed version of Python"
        assert f"Programming Language :: Python :: {found.group(1)}" in python["classifiers"]


def test_it_runs_as_nobody_and_starts_the_program() -> None:
    names = [name for name, _ in steps()]
    # From here on nothing is root's: neither what is run to see that it works, nor the program.
    assert of("USER") == ["65532:65532"]
    assert names.index("USER") < max(i for i, (name, words) in enumerate(steps()) if words == "spinestiff doctor")
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    (program,) = json.loads(of("ENTRYPOINT")[0])
    assert program in project["scripts"]
    assert json.loads(of("CMD")[0]) == ["--help"]


def test_nothing_but_what_the_wheel_needs_is_sent_to_the_builder() -> None:
    lines = (ROOT / ".dockerignore").read_text(encoding="utf-8").splitlines()
    rules = [line for line in lines if line and not line.startswith("#")]
    assert rules[0] == "*"
    assert {rule[1:] for rule in rules if rule[0] == "!"} == set(copied())
    for name in copied():
        assert (ROOT / name).exists()
        assert not any(fnmatch.fnmatch(name, rule.removeprefix("**/")) for rule in rules[1:] if rule[0] != "!")


def test_extras_that_are_offered_exist() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    offered = re.findall(r'EXTRAS="\[(\w+)\]"', TEXT)
    assert offered and set(offered) <= set(project["optional-dependencies"])
    assert of("ARG") == ['EXTRAS=""']


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What the first stage makes of what is copied, unpacked."""
    pytest.importorskip("hatchling", reason="builds the wheel")
    source = tmp_path_factory.mktemp("source")
    for name in copied():
        if (ROOT / name).is_dir():
            shutil.copytree(ROOT / name, source / name, ignore=shutil.ignore_patterns("__pycache__", ".*"))
        else:
            shutil.copy(ROOT / name, source / name)
    subprocess.run([sys.executable, "-m", "hatchling", "build", "-t", "wheel"], cwd=source, check=True, timeout=300)
    (wheel,) = (source / "dist").glob("*.whl")
    place = tmp_path_factory.mktemp("site")
    with zipfile.ZipFile(wheel) as content:
        content.extractall(place)
    return place


def test_the_wheel_has_the_program_and_all_it_reads(installed: Path, tmp_path: Path) -> None:
    scripts = next(installed.glob("*.dist-info")) / "entry_points.txt"
    assert "spinestiff = spinestiff.app.start:main" in scripts.read_text(encoding="utf-8")
    tracked = subprocess.run(
        ["git", "ls-files", "src/spinestiff"], cwd=ROOT, capture_output=True, text=True, check=False
    ).stdout.split()
    missing = [name for name in tracked if not (installed / name.removeprefix("src/")).exists()]
    assert not [name for name in missing if (ROOT / name).exists()]
    given = dict(pair.split("=", 1) for pair in of("ENV")[0].split())
    home = {name: value.replace("/tmp", str(tmp_path)) for name, value in given.items()}
    code = "import sys; sys.argv[0] = 'spinestiff'; from spinestiff.app.start import main; main()"

    def run(*words: str) -> subprocess.CompletedProcess[str]:
        env = {**os.environ, **home, "PYTHONPATH": str(installed)}
        command = [sys.executable, "-c", code, *words]
        return subprocess.run(command, cwd=tmp_path, env=env, capture_output=True, text=True, timeout=300, check=False)

    seen = run("doctor", "--json")
    assert seen.returncode == 0, seen.stderr
    assert json.loads(seen.stdout)["meshes"]["fine"]["nodes"] > 1000
    assert run("cohort", "--help").returncode == run("--help").returncode == 0
    refused = run("cohort", "study", "results")
    assert refused.returncode == 2
    assert refused.stderr.startswith("spinestiff: ") and refused.stderr.count("\n") == 1

    # The workbench as the recipe's header starts it, on any port that is free.
    (tmp_path / "secret.txt").write_text("s" * 40, encoding="utf-8")
    for words in offered("serve"):
        words = [re.sub(r"^\d{4,5}$", "0", word) for word in words]
        env = {**os.environ, **home, "PYTHONPATH": str(installed)}
        running = subprocess.Popen(
            [sys.executable, "-c", code, *words], cwd=tmp_path, env=env, stdout=subprocess.PIPE, text=True
        )
        try:
            address = running.stdout.readline()
            assert re.match(r"serve: https?://", address), address
        finally:
            running.kill()
            running.communicate()
    assert len(offered("serve")) == 2 and len(offered("cohort")) == 1
