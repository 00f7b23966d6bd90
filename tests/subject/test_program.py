"""A result's key changes with the code that it comes from, and with no other."""

from __future__ import annotations

from pathlib import Path

import pytest

import spinestiff
from spinestiff.subject.program import ABOVE, program, sources_digest


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """A package with a room, data in it, what Python left, and a room above."""
    for name in (
        "__init__.py",
        "anatomy/torso.py",
        "anatomy/data/torso.npz",
        "app/cli.py",
        "anatomy/__pycache__/a.pyc",
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
    ],
)
def test_code_and_data_that_results_come_from_count(package: Path, name: str, counts: bool) -> None:
    before = sources_digest(package)
    assert sources_digest(package) == before
    (package / name).write_text("2")
    assert (sources_digest(package) != before) == counts


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
