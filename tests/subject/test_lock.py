"""Two runs at once on one subject: the second is refused, a dead one holds nothing."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from spinestiff.errors import SubjectError
from spinestiff.subject.lock import sole_run

HOLD = """
import sys
from pathlib import Path
from spinestiff.subject.lock import sole_run
with sole_run(Path(sys.argv[1])):
    print("held", flush=True)
    sys.stdin.read()
"""


@pytest.mark.skipif(os.name == "nt", reason="locks of Unix")
def test_the_second_run_is_refused_until_the_first_has_died(tmp_path):
    words = f"^{tmp_path}: another run of spinestiff is at work here; wait for its end$"
    with subprocess.Popen(
        [sys.executable, "-c", HOLD, str(tmp_path)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as first:
        assert first.stdout.readline() == "held\n"
        with pytest.raises(SubjectError, match=words), sole_run(tmp_path):
            raise AssertionError("both hold the folder")
        first.kill()
    with sole_run(tmp_path), pytest.raises(SubjectError, match=words), sole_run(tmp_path):
        raise AssertionError("held twice")
    with sole_run(tmp_path):
        assert list(tmp_path.iterdir()) == []
