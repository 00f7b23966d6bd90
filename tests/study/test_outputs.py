"""What steps read of each other is never replaced by an output that a user names."""

from __future__ import annotations

import importlib
import pkgutil

from spinestiff import subject
from spinestiff.study.runner import MADE_BY
from spinestiff.subject.outcomes import OutcomeFile
from spinestiff.subject.output_places import READ_AGAIN


def test_every_result_that_is_read_is_on_the_list():
    for module in pkgutil.iter_modules(subject.__path__):
        importlib.import_module(f"{subject.__name__}.{module.name}")
    files = {kind.FILE for kind in OutcomeFile.__subclasses__()}
    assert len(files) >= 5 and len(MADE_BY) >= 5
    assert {*MADE_BY, *files, "run.json"} == set(READ_AGAIN)
