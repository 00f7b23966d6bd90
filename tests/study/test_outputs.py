"""What steps read of each other is never replaced by an output that a user names."""

from __future__ import annotations

import importlib
import pkgutil

from spinestiff import subject
from spinestiff.study.runner import ALL_STEPS
from spinestiff.study.summary import ASSESSMENT_FILE, ESTIMATE_FILE, RESPONSE_FILE
from spinestiff.subject.outcomes import OutcomeFile
from spinestiff.subject.output_places import READ_AGAIN


def test_every_result_that_is_read_is_on_the_list():
    for module in pkgutil.iter_modules(subject.__path__):
        importlib.import_module(f"{subject.__name__}.{module.name}")
    files = {kind.FILE for kind in OutcomeFile.__subclasses__()}
    made = {name for step in ALL_STEPS.values() for name in step.makes}
    read = {name for step in ALL_STEPS.values() for name in step.results}
    for_people = {RESPONSE_FILE, ESTIMATE_FILE, ASSESSMENT_FILE}
    for_people |= {name for name in made if name.endswith((".png", ".html"))}
    assert len(files) >= 5 and read <= made and for_people < made
    assert {*files, *made - for_people, "run.json"} == set(READ_AGAIN)
