"""What stands for a study's subject; processes import this file by its name."""

from __future__ import annotations

import os

from spinestiff.errors import EquilibriumError
from spinestiff.files import write_json
from spinestiff.parallel import threads
from spinestiff.study.seven.subject import result_file, settings_digest
from spinestiff.subject.program import program_of_numbers
from study_outcomes import outcome


def made(folder, participant, settings, say):
    """Stands for a whole chain: the second subject can't be made, and the number of threads is told as its age."""
    say("making")
    if participant.name == "subject-2":
        raise EquilibriumError("no equilibrium")
    found = outcome(int(participant.name[-1]), age=float(threads()))
    found = found.model_copy(
        update={"program": program_of_numbers(), "settings": settings_digest(participant, settings)}
    )
    write_json(result_file(folder, participant), found.model_dump(mode="json"))
    return found


def one_killed(folder, participant, settings, say):
    """The first subject's process ends each time, the second's only the first time."""
    before = folder / f"{participant.name}.before"
    if participant.name == "subject-1" or (participant.name == "subject-2" and not before.exists()):
        before.touch()
        os._exit(9)
    return outcome(int(participant.name[-1]))


def without_memory(folder, participant, settings, say):
    if participant.name == "subject-1":
        raise MemoryError("no room\nfor an array")
    return made(folder, participant, settings, say)


def unforeseen(folder, participant, settings, say):
    if participant.name == "subject-2":
        raise OSError(28, "No space left on device")
    return without_memory(folder, participant, settings, say)
