"""A result's key changes with the code that it comes from, and with no other."""

from __future__ import annotations

from pathlib import Path

import pytest

import spinestiff
from spinestiff.subject.program import ABOVE, BESIDE, TOLD, program, program_of_numbers, sources_digest


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """A package with a room, data in it, what Python left, and a room above."""
    for name in (
        "__init__.py",
        "anatomy/torso.py",
        "anatomy/data/torso.npz",
        "app/cli.py",
        "anatomy/__pycache__/a.pyc",
        "study/assessment.py",
        "study/wording/numbers.py",
        "study/report/page.py",
        "study/report/report.html.j2",
    ):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("1")
    return tmp_path


@pytest.mark.parametrize(
    ("name", "counts"),
    [
        ("__init__.py", True),
        ("anatomy/torso.py", True),
        ("anatomy/data/torso.npz", True),
        ("anatomy/new.py", True),
        ("app/cli.py", False),
        ("anatomy/__pycache__/a.pyc", False),
        ("anatomy/.torso.py.swp", False),
        ("study/wording/numbers.py", True),
        ("study/report/report.html.j2", True),
    ],
)
def test_code_and_data_that_results_come_from_count(package: Path, name: str, counts: bool) -> None:
    before = sources_digest(package)
    assert sources_digest(package) == before
    (package / name).write_text("2")
    assert (sources_digest(package) != before) == counts


@pytest.mark.parametrize(
    ("name", "counts"),
    [
        ("anatomy/torso.py", True),
        ("anatomy/data/torso.npz", True),
        ("study/assessment.py", True),
        ("study/wording/numbers.py", False),
        ("study/report/page.py", False),
        ("study/report/report.html.j2", False),
        ("app/cli.py", False),
    ],
)
def test_sentences_and_pages_do_not_count_for_numbers(package: Path, name: str, counts: bool) -> None:
    without = (*ABOVE, *TOLD)
    before = sources_digest(package, without)
    (package / name).write_text("2")
    assert (sources_digest(package, without) != before) == counts


def test_a_file_by_another_name_counts(package: Path) -> None:
    before = sources_digest(package)
    (package / "anatomy" / "torso.py").rename(package / "anatomy" / "body.py")
    assert sources_digest(package) != before


def test_the_program_is_its_version_and_sources() -> None:
    version, _, digest = program().partition("+")
    assert version == spinestiff.__version__
    folder = Path(spinestiff.__file__).parent
    assert sources_digest(folder).startswith(digest) and len(digest) == 12
    assert {path.name for path in folder.iterdir()} >= set(ABOVE)
    assert program_of_numbers() == f"{version}+{sources_digest(folder, (*ABOVE, *TOLD, *BESIDE))[:12]}" != program()
