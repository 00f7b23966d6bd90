"""The command line as the installed program runs it."""

from __future__ import annotations

import sys
from types import SimpleNamespace

import pytest

from spinestiff.app import cli


@pytest.fixture
def spinestiff(monkeypatch, capfd):
    """Run a command line as the installed program does; gives its exit status and output."""

    def call(*arguments):
        monkeypatch.setattr(sys, "argv", ["spinestiff", *map(str, arguments)])
        try:
            cli.main()
            status = 0
        except SystemExit as end:
            status = end.code or 0
        out, err = capfd.readouterr()
        assert "Traceback" not in out + err
        return SimpleNamespace(status=status, out=out, err=err, lines=err.splitlines())

    return call
