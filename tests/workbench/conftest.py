"""A workbench over a folder with one small subject, served as it is for people."""

from __future__ import annotations

import shutil
import threading
from contextlib import contextmanager
from pathlib import Path

import pytest

from bench_client import Client
from chromium import Tab
from spinestiff.loopback.serving import listening, server_of
from spinestiff.workbench.bench import open_bench
from spinestiff.workbench.door import access_of
from spinestiff.workbench.server import guarded_application
from unannotated import write_folder


@pytest.fixture(scope="session")
def pristine(tmp_path_factory):
    return write_folder(tmp_path_factory.mktemp("bench") / "girl")


@pytest.fixture
def root(pristine, tmp_path):
    """A folder with a subject that nobody has annotated: a copy to change."""
    shutil.copytree(pristine, tmp_path / "root" / "girl")
    return Path(tmp_path / "root")


@contextmanager
def serving(root, jobs=False, proxy=None, secret=None, **options):
    bench = open_bench(root, **options)
    with listening(0) as sock:
        port = sock.getsockname()[1]
        access = access_of(port, proxy, secret, bench.read_only)
        server = server_of(guarded_application(bench, access))
        thread = threading.Thread(target=server.run, kwargs={"sockets": [sock]}, daemon=True)
        thread.start()
        if jobs:
            bench.jobs.start()
        yield Client(port, access.token, bench)
        bench.jobs.stop()
        server.should_exit = True
        thread.join(timeout=20)
        assert not thread.is_alive()


@pytest.fixture
def serve():
    return serving


@pytest.fixture
def served(root):
    """Without anybody who starts jobs."""
    with serving(root) as client:
        yield client


@pytest.fixture(scope="module")
def tab(tmp_path_factory):
    """A browser of its own, for tests that skip where there is none."""
    with Tab(tmp_path_factory.mktemp("profile")) as opened:
        opened.call("Emulation.setFocusEmulationEnabled", enabled=True)
        opened.call("DOM.enable")
        yield opened
