"""Every example runs and shows what it says; each keeps its result in module variables."""

from __future__ import annotations

import math
import re
import runpy
from pathlib import Path

import pytest

from spinestiff.estimation.fitted import StiffnessFit

ROOT = Path(__file__).parents[1]
EXAMPLES = sorted((ROOT / "examples").glob("*.py"))
NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?")


def run(name: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, object]:
    monkeypatch.chdir(folder)
    (path,) = [path for path in EXAMPLES if path.name == name]
    return runpy.run_path(str(path), run_name="__main__")


def assert_as_documented(name: str, printed: str) -> None:
    """docs/examples.md shows this output: the same words, and numbers within a tenth or 0.02."""
    page = (ROOT / "docs" / "examples.md").read_text(encoding="utf-8")
    (shown,) = re.findall(rf"examples/{name}\n[^`]*```\n.*?^```text\n(.*?)^```$", page, re.MULTILINE | re.DOTALL)
    words, numbers = ([of(text) for text in (shown, printed)] for of in (words_of, numbers_of))
    assert words[0] == words[1], f"docs/examples.md shows another output of {name}"
    assert numbers[0] == pytest.approx(numbers[1], rel=0.1, abs=0.02)


def words_of(text: str) -> list[str]:
    return NUMBER.sub("#", text).split()


def numbers_of(text: str) -> list[float]:
    return [float(number) for number in NUMBER.findall(text)]


def test_every_example_has_a_test() -> None:
    assert [path.name for path in EXAMPLES] == [
        "01_push_a_torso.py",
        "02_recover_ratios.py",
        "03_your_own_model.py",
        "04_fit_with_pytorch.py",
        "05_fit_with_jax.py",
    ]
    for path in EXAMPLES:
        assert f"test_{path.stem[3:]}(" in Path(__file__).read_text(encoding="utf-8")


def test_push_a_torso(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    result = run("01_push_a_torso.py", tmp_path, monkeypatch)
    change = result["tilt_change_deg"]
    assert isinstance(change, float)
    assert change > 1.0  # a push from the right makes the spine convex to the left
    printed = capsys.readouterr().out
    assert f"{change:.1f}" in printed
    assert_as_documented("01_push_a_torso.py", printed)


def test_recover_ratios(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    result = run("02_recover_ratios.py", tmp_path, monkeypatch)
    truth, found, fit = result["truth"], result["found"], result["fit"]
    assert isinstance(truth, dict)
    assert isinstance(found, dict)
    assert isinstance(fit, StiffnessFit)
    assert fit.status.usable
    assert set(found) == {"lateral_bending", "tissue"}
    printed = capsys.readouterr().out
    for name, value in truth.items():
        # Noise-free and on the same mesh: a part of what it allows for is in between.
        low, high = fit.intervals95[name]
        assert abs(math.log(found[name] / value)) < 0.15 * math.log(high / low)
        assert name in printed
    assert_as_documented("02_recover_ratios.py", printed)


def test_your_own_model(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    result = run("03_your_own_model.py", tmp_path, monkeypatch)
    error, truth, found = result["gradient_error"], result["truth"], result["found"]
    assert isinstance(error, float)
    assert isinstance(truth, dict)
    assert isinstance(found, dict)
    assert error < 1e-6  # second-order differences with h = 1e-4
    for name, value in truth.items():
        assert found[name] == pytest.approx(value, rel=1e-4)
    assert (tmp_path / "your_own_model.png").stat().st_size > 10_000
    printed = capsys.readouterr().out
    assert "lower joint: true ratio 2, found 2.0000" in printed
    assert_as_documented("03_your_own_model.py", printed)


@pytest.mark.parametrize("framework", ["torch", "jax"])
def test_fit_with_a_framework_s_optimiser(
    framework: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """test_fit_with_pytorch( and test_fit_with_jax( at once."""
    pytest.importorskip(framework, reason=f'pip install "spinestiff[{framework}]"')
    result = run({"torch": "04_fit_with_pytorch.py", "jax": "05_fit_with_jax.py"}[framework], tmp_path, monkeypatch)
    truth, found = result["truth"], result["found"]
    assert isinstance(truth, dict)
    assert isinstance(found, dict)
    for name, value in truth.items():
        # Noise-free and on the same mesh: nothing but the optimiser's stopping rule is in between.
        assert found[name] == pytest.approx(value, rel=1e-3)
    # Progress: a line an evaluation, each with its loss.
    losses = [float(one) for one in re.findall(r"loss +([0-9.e+-]+) mm\^2, ", capfd.readouterr().out)]
    assert len(losses) > 5
    assert min(losses) < 1e-6 * losses[0]
