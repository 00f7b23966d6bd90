"""One small synthetic subject for all tests that need a whole one: coarse mesh, few frames, small radiographs."""

from __future__ import annotations

import os
import pickle
import shutil
import signal
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

if "PYTEST_XDIST_WORKER" in os.environ:
    # A process a core: more threads would only stand in each other's way. Read when NumPy and numba are imported.
    for setting in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"):
        os.environ.setdefault(setting, "1")

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    # Started in a script's background a process is deaf to SIGINT, and so is all that it starts; tests send it some.
    signal.signal(signal.SIGINT, signal.default_int_handler)

import numpy as np
import pytest

from canaries import infest

LONGEST_WAIT_S = 900.0
TRUTH = {"lateral_bending": 0.2, "tissue": 0.05}


@dataclass(frozen=True)
class Finished:
    """A subject folder with all results, its truth file, the fit behind ``estimate.json`` and what was said."""

    folder: Path
    truth: Path
    fit: object
    lines: tuple[str, ...]


@dataclass(frozen=True)
class Viewed:
    """The finished subject's estimate, what the models made of its frames, and what the viewer shows of them."""

    estimate: object
    predictions: object
    scene: object


def made_once(temporary: pytest.TempPathFactory, name: str, make: Callable[[Path], Any]) -> Any:
    """What ``make`` returns for a new folder. Of pytest's processes one makes it; the others wait, and read a copy."""
    if "PYTEST_XDIST_WORKER" not in os.environ:
        return make(temporary.mktemp(name))
    folder = temporary.getbasetemp().parent / name
    done, failed = folder / "made.pickle", folder / "failed"
    try:
        folder.mkdir()
    except FileExistsError:
        latest = time.monotonic() + LONGEST_WAIT_S
        while not done.exists():
            if failed.exists() or time.monotonic() > latest:
                pytest.fail(f"another process could not make '{name}', which this test needs, too")
            time.sleep(0.2)
        return pickle.loads(done.read_bytes())
    try:
        made = make(folder)
        partly = folder / "partly.pickle"
        partly.write_bytes(pickle.dumps(made))
        partly.replace(done)
    except BaseException:
        failed.touch()
        raise
    return made


def stub_report(visit, predictions, say):
    """Stands in for the report, which has tests of its own and takes longer than all other steps."""
    say("writing")
    for name in ("report.html", "view.html"):
        visit.file(name).write_text("page", encoding="utf-8")


def pytest_collection_modifyitems(items):
    """Files with slow tests first: a file's tests stay together, so that a long file at the end leaves cores idle."""
    slow = {item.path for item in items if item.get_closest_marker("slow")}
    items.sort(key=lambda item: item.path not in slow)


@pytest.fixture(scope="session")
def cheap_recipe():
    from spinestiff.imaging.synthetic.acquisition import Acquisition
    from spinestiff.study.synthetic.recipe import Recipe, SyntheticPush

    main = SyntheticPush("main", 8.0, (0.0, 0.5, 0.75, 1.0), ("unused", "training", "training", "validation"))
    second = SyntheticPush("second", 6.0, (0.0, 1.0), ("unused", "validation"))
    return Recipe(
        seed=3,
        force_n=30.0,
        ratios=tuple(TRUTH.values()),
        shape=(512, 512),
        mesh="coarse",
        pushes=(main, second),
        acquisition=Acquisition(samples=1),
    )


@pytest.fixture(scope="session")
def radiographed(tmp_path_factory, cheap_recipe):
    """The subject's folder before any step, its truth beside it; shared by all tests, so only to be read."""
    from spinestiff.study.synthetic.subject import synthesise

    def make(folder):
        synthesise(folder / "girl", cheap_recipe)
        return folder / "girl"

    return made_once(tmp_path_factory, "radiographed", make)


@pytest.fixture(scope="session")
def finished(tmp_path_factory, radiographed):
    """The finished subject; shared by all tests, so only to be read (``subject`` is a copy to change)."""
    return Finished(*made_once(tmp_path_factory, "synthetic", lambda folder: finish(folder / "girl", radiographed)))


def finish(folder, radiographed):
    """A copy of a subject folder taken through all steps: the fields of ``Finished``."""
    from spinestiff.study import runner, steps
    from spinestiff.study.synthetic.subject import truth_path
    from spinestiff.study.visit import Settings, open_visit

    fits, lines, truth = [], [], truth_path(folder)
    shutil.copytree(radiographed, folder)
    shutil.copy(truth_path(radiographed), truth)
    # Whatever the steps write and say of this subject, none of it may come from a patient's words in DICOM.
    for number, path in enumerate(sorted(folder.rglob("*.dcm"))):
        infest(path, np.random.default_rng(number), 60)

    def fit_and_keep(*args, **kwargs):
        fits.append(fit_from_coarse(*args, **kwargs))
        return fits[-1]

    fit_from_coarse = steps.fit_from_coarse
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(steps, "fit_from_coarse", fit_and_keep)
        patch.setattr("spinestiff.study.report.page.write_report", stub_report)
        ran = runner.run_steps(open_visit(folder, Settings(mesh="coarse"), truth), observer=lines.append)
    assert ran == list(runner.STEPS)
    return folder, truth, fits[0], tuple(lines)


@pytest.fixture
def subject(finished, tmp_path):
    """A copy of the finished subject folder, with its truth beside it."""
    shutil.copy(finished.truth, tmp_path / finished.truth.name)
    return Path(shutil.copytree(finished.folder, tmp_path / finished.folder.name))


@pytest.fixture
def no_report(monkeypatch):
    monkeypatch.setattr("spinestiff.study.report.page.write_report", stub_report)


@pytest.fixture(scope="session")
def viewed(finished):
    """The finished subject's trials with what default and estimated stiffness make of them, and its viewer's scene."""
    from spinestiff.study.report.viewer.files import scene_of
    from spinestiff.study.steps import stored_predictions
    from spinestiff.study.visit import open_visit
    from spinestiff.subject.estimate_outcome import Estimate
    from spinestiff.subject.run_record import read_outcome

    visit = open_visit(finished.folder)
    predictions = stored_predictions(visit)
    return Viewed(read_outcome(visit.subject, Estimate), predictions, scene_of(visit, predictions))
