"""``spinestiff frames``: what each frame of a subject is good for, as a table, as JSON and as a picture."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from spinestiff.app import tables
from spinestiff.study.runner import run_steps
from spinestiff.study.visit import Visit
from spinestiff.subject.outcomes import FrameProposal, FrameProposals
from spinestiff.subject.roles import write_roles
from spinestiff.subject.run_record import read_outcome


def select_frames(visit: Visit, say: Callable[[str], None], write: bool) -> tuple[FrameProposal, ...]:
    """Propose roles for all frames; writes ``results/frames.json`` and ``frames.png``, and with ``write`` the roles.

    Raises
    ------
    SpinestiffError : tracking failed, or something can't be written.
    """
    run_steps(visit, ("track", "frames"), say)
    frames = read_outcome(visit.subject, FrameProposals).frames
    if write:
        roles = {push.id: [f.proposed for f in frames if f.push == push.id] for push in visit.subject.pushes}
        write_roles(visit.subject.folder, roles)
    return frames


def show_frames(frames: tuple[FrameProposal, ...], strip: Path, written: bool) -> None:
    """Print the table, below it the reasons, where the picture is, and what to do with the proposal."""
    tables.show(tables.frames_table(frames))
    for frame in frames:
        print(f"push '{frame.push}' frame {frame.frame}: {frame.reason}")
    print(f"picture: {strip}")
    if written:
        print("the proposed roles are in subject.json now")
    elif any(frame.role != frame.proposed for frame in frames):
        print("subject.json is as it was; --write puts the proposed roles in")
