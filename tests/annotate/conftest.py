"""The page's server over a small subject folder that nobody has annotated yet."""

from __future__ import annotations

import shutil
import threading
from pathlib import Path

import pytest

from spinestiff.annotate.server import guarded_application
from spinestiff.annotate.session import AnnotationSession
from spinestiff.loopback.serving import listening, server_of
from unannotated import Served, write_folder


@pytest.fixture(scope="session")
def pristine(tmp_path_factory):
    return write_folder(tmp_path_factory.mktemp("annotate") / "girl")


@pytest.fixture
def unannotated(pristine, tmp_path):
    """Subject and radiographs, no annotation: a copy to change."""
    return Path(shutil.copytree(pristine, tmp_path / "girl"))


@pytest.fixture
def session(unannotated):
    return AnnotationSession(unannotated)


@pytest.fixture
def served(session):
    with listening(0) as sock:
        port = sock.getsockname()[1]
        guarded, address = guarded_application(session, port)
        server = server_of(guarded)
        thread = threading.Thread(target=server.run, kwargs={"sockets": [sock]}, daemon=True)
        thread.start()
        yield Served(port, address.partition("#")[2], session)
        server.should_exit = True
        thread.join(timeout=20)
        assert not thread.is_alive()
