"""``spinestiff frames``: what each frame of a subject is good for, as a table, as JSON and as a picture."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from spinestiff.app import tables
from spinestiff.files import write_bytes, write_json
from spinestiff.study.frame_selection import Proposal, frame_qualities, propose
from spinestiff.study.pipeline import run_steps
from spinestiff.study.report.figures import as_png
from spinestiff.study.report.frame_strip import Row, draw_strip
from spinestiff.study.visit import Visit, load_tracked
from spinestiff.subject.folder import image_supports, read_push
from spinestiff.subject.roles import write_roles

SCHEMA_VERSION = 1


def select_frames(visit: Visit, say: Callable[[str], None], write: bool) -> list[dict[str, Any]]:
    """Propose roles for all frames; writes ``results/frames.json`` and ``frames.png``, and with ``write`` the roles.

    Raises
    ------
    SpinestiffError : tracking failed, or something can't be written.
    """
    run_steps(visit, ("track",), say)
    subject, tracked = visit.subject, load_tracked(visit)
    qualities, frames = [], []
    for push in subject.pushes:
        say(f"frames: looking at push '{push.id}'")
        frames.append(read_push(subject, push))
        points = image_supports(subject, push.image)
        qualities.append(frame_qualities(push, frames[-1], tracked[push.id].frames, points))
    proposals = propose(qualities)
    say("frames: drawing")
    rows = [
        Row(push, frames[i], tracked[push.id].frames, proposals[i]) for i, push in enumerate(subject.pushes)
    ]  # fmt: skip
    write_bytes(visit.file("frames.png"), as_png(draw_strip(rows)))
    records = [
        frame_record(proposal, push.side, push.level, push.roles[proposal.quality.frame])
        for push, found in zip(subject.pushes, proposals)
        for proposal in found
    ]
    write_json(visit.file("frames.json"), {"schema_version": SCHEMA_VERSION, "frames": records})
    if write:
        roles = {push.id: [p.role for p in found] for push, found in zip(subject.pushes, proposals)}
        write_roles(subject.folder, roles)
    return records


def frame_record(proposal: Proposal, side: str, level: float, role: str) -> dict[str, Any]:
    """A frame as ``--json`` prints it; ``role`` is the one in ``subject.json``."""
    quality = proposal.quality
    return {
        "push": quality.push,
        "side": side,
        "level": level,
        "frame": quality.frame,
        "force_n": quality.force_n,
        "sharpness": _rounded(quality.image.sharpness, 3),
        "contrast_to_noise": _rounded(quality.image.contrast_to_noise, 2),
        "saturated": _rounded(quality.image.saturated, 4),
        "vertebrae": quality.vertebrae,
        "tracking_mm": _rounded(quality.tracking_mm, 2),
        "supports": {
            name: {"mm": _rounded(motion.mm, 2), "degrees": _rounded(motion.degrees, 2)}
            for name, motion in quality.supports.items()
        },
        "role": role,
        "proposed": proposal.role,
        "reason": proposal.reason,
    }


def show_frames(records: list[dict[str, Any]], strip: Path, written: bool) -> None:
    """Print the table, below it the reasons, where the picture is, and what to do with the proposal."""
    tables.show(tables.frames_table(records))
    for record in records:
        print(f"push '{record['push']}' frame {record['frame']}: {record['reason']}")
    print(f"picture: {strip}")
    if written:
        print("the proposed roles are in subject.json now")
    elif any(record["role"] != record["proposed"] for record in records):
        print("subject.json is as it was; --write puts the proposed roles in")


def _rounded(value: float | None, digits: int) -> float | None:
    return None if value is None or not np.isfinite(value) else round(float(value), digits)
