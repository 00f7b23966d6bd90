"""spinestiff.anatomy.mmg: a mesher that may crash, and on some meshes does not end."""

from __future__ import annotations

import os
import subprocess
import sys
import time

import numpy as np
import pytest
from scipy.spatial import Delaunay

from spinestiff.anatomy import mmg as module
from spinestiff.anatomy.mmg import mmg, remeshed
from spinestiff.anatomy.tetrahedra import least_angles
from spinestiff.errors import TorsoError

HEAD = """
class MmgMesh3D:
    def __getattr__(self, name):
        return lambda *given, **named: None
    def get_vertices(self):
        return self.points
    def get_tetrahedra(self):
        return self.tetrahedra
    def set_vertices(self, points):
        self.points = points
    def set_tetrahedra(self, tetrahedra):
        self.tetrahedra = tetrahedra
    def remesh(self, **options):
"""


@pytest.fixture
def meshed():
    points = np.random.default_rng(0).uniform(0.0, 100.0, (60, 3))
    return points, Delaunay(points).simplices.astype(np.int64), np.arange(5)


@pytest.fixture
def stands_in(tmp_path, monkeypatch):
    """Another mmgpy, whose ``remesh`` does this."""

    def does(*lines):
        (tmp_path / "mmgpy.py").write_text(HEAD + "".join(f"        {line}\n" for line in lines), encoding="utf-8")
        monkeypatch.syspath_prepend(tmp_path)
        monkeypatch.setenv("PYTHONPATH", str(tmp_path))
        monkeypatch.delitem(sys.modules, "mmgpy", raising=False)
        monkeypatch.setattr(module, "LONGEST_S", 1.5)

    yield does
    sys.modules.pop("mmgpy", None)


def running():
    """Processes of the mesher that this one has begun; other tests may mesh beside it."""
    own = ["ps", "--ppid", str(os.getpid()), "-o", "args"]
    said = subprocess.run(own, capture_output=True, text=True).stdout  # fails where it finds none
    return [line for line in said.splitlines() if "spinestiff.anatomy.mmg" in line]


def test_tetrahedra_get_better_and_required_points_stay(meshed):
    pytest.importorskip("mmgpy", reason="needs MMG (extra [mesh])")
    points, tetrahedra, required = meshed
    found, elements = mmg(points, tetrahedra, required)
    assert least_angles(found[elements]).min() > 2.0 * least_angles(points[tetrahedra]).min()
    away = np.linalg.norm(found[None] - points[required][:, None], axis=-1).min(axis=1)
    assert away == pytest.approx(0.0, abs=1e-9)


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="asks ps")
def test_what_does_not_end_is_ended(meshed, stands_in):
    stands_in("while True:", "    pass")
    began = time.monotonic()
    with pytest.raises(TorsoError, match="MMG has not ended within 2 s of the processor"):
        mmg(*meshed)
    assert time.monotonic() - began < 30.0
    assert running() == []


@pytest.mark.skipif(sys.platform == "win32", reason="Windows tells no process's time")
def test_on_a_busy_machine_it_may_take_longer_by_the_clock(meshed, stands_in):
    """So that which pass is the last, and with it the mesh, does not depend on what else is at work."""
    stands_in("import time; time.sleep(4.0)")
    found, elements = remeshed(*meshed, {})
    assert found == pytest.approx(meshed[0]) and (elements == meshed[1]).all()


def test_what_waits_for_ever_is_ended_by_the_clock(meshed, stands_in, monkeypatch):
    monkeypatch.setattr(module, "BY_CLOCK", 1.5)
    stands_in("import time; time.sleep(60.0)")
    began = time.monotonic()
    with pytest.raises(TorsoError, match=r"MMG has not ended within [23] s$"):
        mmg(*meshed)
    assert time.monotonic() - began < 30.0


def test_a_later_pass_that_does_not_end_leaves_the_earlier_ones(meshed, stands_in):
    stands_in("while 'ar' in options:", "    pass")
    found, elements = mmg(*meshed)
    assert found == pytest.approx(meshed[0])
    assert (elements == meshed[1]).all()


@pytest.mark.parametrize(
    ("lines", "told"),
    [
        (("raise RuntimeError('no\\nvolume')",), r"MMG failed \(no volume\)"),
        (("import os", "os.abort()"), r"MMG failed \(.*\)"),
        (("import os", "os._exit(7)"), r"MMG failed \(status 7\)"),
    ],
)
def test_what_fails_is_told_in_one_line(meshed, stands_in, lines, told):
    stands_in(*lines)
    with pytest.raises(TorsoError, match=told) as error:
        remeshed(*meshed, {})
    assert "\n" not in str(error.value)
