"""tools/seeded_faults.py: its faults still fit the program, and it puts them into a copy."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def tool():
    spec = importlib.util.spec_from_file_location("seeded_faults", ROOT / "tools" / "seeded_faults.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    yield spec.loader.exec_module(module) or module
    del sys.modules[spec.name]


def test_every_fault_still_fits_the_program(tool):
    assert tool.misfits() == []
    assert len(tool.FAULTS) >= 50
    assert len({fault.name for fault in tool.FAULTS}) == len(tool.FAULTS)
    for fault in tool.FAULTS:
        assert fault.before != fault.after
        assert (ROOT / "tests" / fault.tests).exists(), fault.name


def test_a_fault_whose_text_is_gone_is_named(tool):
    gone = tool.Fault("gone", "mechanics/joints.py", "no such text", "", tool.CHECKS)
    assert tool.misfits((gone,)) == ["'gone': its text occurs 0 times in mechanics/joints.py, wanted once"]


def test_faults_go_into_a_copy_and_come_out_again(tool, tmp_path, monkeypatch):
    fault = tool.FAULTS[0]
    own = ROOT / "src" / "spinestiff" / fault.file
    before, seen = own.read_bytes(), []
    copy = tool.Copy(tmp_path)
    target = copy.package / fault.file

    def passes(tests):
        seen.append((tests, target.read_text(encoding="utf-8"), own.read_bytes()))
        return False

    monkeypatch.setattr(copy, "passes", passes)
    assert copy.caught(fault)
    ((tests, faulty, meanwhile),) = seen
    assert tests == fault.tests and fault.after in faulty and faulty != before.decode()
    assert meanwhile == before == own.read_bytes() == target.read_bytes()
