"""What steps read of each other is never replaced by an output that a user names."""

from __future__ import annotations

from spinestiff.study.runner import MADE_BY
from spinestiff.subject.folder import READ_AGAIN
from spinestiff.subject.outcomes import OutcomeFile


def test_every_result_that_is_read_is_on_the_list():
    files = {kind.FILE for kind in OutcomeFile.__subclasses__()}
    assert len(files) >= 5 and len(MADE_BY) >= 5
    assert {*MADE_BY, *files, "run.json"} == set(READ_AGAIN)
