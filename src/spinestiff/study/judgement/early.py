"""What is told of a subject's pushes as soon as they are tracked, before there is a torso of its own."""

from __future__ import annotations

from spinestiff.errors import SpinestiffError
from spinestiff.study.judgement import failed, judge_motion
from spinestiff.study.subject_body import subject_template
from spinestiff.study.trials import push_set, rig_of
from spinestiff.study.visit import Visit
from spinestiff.subject.outcomes import Tracked
from spinestiff.subject.run_record import read_outcome


def motion_doubts(visit: Visit) -> tuple[str, ...]:
    """What the motion in tracked pushes says against their forces and sides, before there is a torso of the subject;
    nothing where the tracking can't be put beside the template.
    """
    record = visit.subject.record
    try:
        template = subject_template(record, "coarse")
        tracked = read_outcome(visit.subject, Tracked).pushes
        pushes = push_set(template, visit.subject.pushes, tracked, rig=rig_of(record))
    except SpinestiffError:
        return ()
    return tuple(check.text for check in failed(judge_motion(record, pushes)))
