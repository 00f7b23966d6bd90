"""Results as their step would have left them: named in ``run.json`` with their hashes, corners to the last digit."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from spinestiff.imaging.features import VertebraCorners
from spinestiff.imaging.projection import XRayView
from spinestiff.subject.folder import Subject, read_subject
from spinestiff.subject.outcome_parts import OutcomeFile, ViewRecord
from spinestiff.subject.outcomes import TrackedPush
from spinestiff.subject.run_record import StepRecord, record_step, recorded_steps


def register(subject: Subject, step: str, *names: str) -> None:
    """Say in ``run.json`` that a step wrote what lies in ``results/`` under these names, and keep the rest of it."""
    known = recorded_steps(subject).get(step, StepRecord(digest="by hand"))
    others = [subject.folder / path for path in known.outputs]
    record_step(subject, step, known, sorted({*others, *(subject.results / name for name in names)}))


def altered(folder: Path, kind: type[OutcomeFile], change: Callable[[Any], None]) -> Subject:
    """A subject folder whose result was changed by ``change(content)``, as if its step had written it so."""
    subject = read_subject(folder)
    path = subject.results / kind.FILE
    content = json.loads(path.read_text(encoding="utf-8"))
    change(content)
    path.write_text(json.dumps(content), encoding="utf-8")
    register(subject, kind.STEP, kind.FILE)
    return subject


def tracked_push(
    view: XRayView,
    forces_n: Sequence[float],
    corners: Sequence[VertebraCorners],
    notes: Mapping[int, str] | None = None,
) -> TrackedPush:
    """A push of corners on the detector, unrounded; what a frame lacks of the vertebrae is there with quality 0.

    Parameters
    ----------
    corners : of a frame each, the most complete among them with all vertebrae. notes : on supports, by frame.
    """
    most = max(corners, key=len)
    frames = []
    for index, (force, found) in enumerate(zip(forces_n, corners, strict=True)):
        rows = [most.vertebrae.index(name) for name in found.vertebrae]
        points, quality = most.corners.copy(), np.zeros((len(most), 4))
        points[rows], quality[rows] = found.corners, found.quality
        frames.append(
            {
                "force_n": force,
                "corners_px": view.pixels(points).tolist(),
                "quality": quality.tolist(),
                "support_note": (notes or {}).get(index, ""),
            }
        )
    return TrackedPush.model_validate({"view": ViewRecord.of(view), "vertebrae": most.vertebrae, "frames": frames})
