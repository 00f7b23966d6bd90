"""What a cohort does with each participant: all steps from radiographs to report, and the participant's row."""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite, sqrt
from pathlib import Path
from typing import Any

import numpy as np

from spinestiff.cohort.places import LOGS, ROW_FILE
from spinestiff.cohort.row import CurveKind, HeldOut, Row, Stiffness, write_row
from spinestiff.curves.cobb import REGIONS
from spinestiff.curves.pushes import rest_reading
from spinestiff.observer import Observer
from spinestiff.run_log import run_log
from spinestiff.study.runner import STEPS, run_steps
from spinestiff.study.visit import Settings, Visit, open_visit
from spinestiff.study.wording.estimate import has_intervals
from spinestiff.study.wording.numbers import NO_INTERVALS
from spinestiff.study.wording.titles import ratio_unit
from spinestiff.subject.assessment_outcome import Assessment, HeldOutFrame
from spinestiff.subject.estimate_outcome import Estimate
from spinestiff.subject.outcome_parts import Quantity
from spinestiff.subject.run_record import read_outcome

RUNNER = f"{__name__}:run_subject"
SMALLEST_COBB_DEG = 10.0
"""From here a curve is a scoliosis (Scoliosis Research Society)."""


def settings_of(asked: dict[str, Any]) -> Settings:
    """The steps' settings from those of a cohort. Raises SubjectError for values that there are not."""
    chosen = dict(asked)
    if chosen.get("parameters") is not None:
        chosen["parameters"] = tuple(chosen["parameters"])
    return Settings(**chosen)


def run_subject(folder: Path, participant: str, settings: dict[str, Any], say: Observer) -> None:
    """All steps of one subject folder; those that are up to date are left out, the others are logged.

    Parameters
    ----------
    folder : the private one, ``Place.work``; the log goes to ``Place.logs``.

    Raises
    ------
    SpinestiffError : the first step that fails.
    """
    visit = open_visit(folder, settings_of(settings))
    asked = visit.settings.as_record()
    with run_log(visit.subject, "cohort", asked, folder=folder.parent / LOGS, names=(participant,)):
        for warning in visit.subject.warnings:
            say(f"warning: {warning}")
        run_steps(visit, STEPS, say)
        write_row(visit.file(ROW_FILE), row_of(visit, participant))


def row_of(visit: Visit, participant: str) -> Row:
    """The row of a subject that has been assessed.

    Raises
    ------
    SubjectError : a result is missing or not as its step left it.
    """
    subject = visit.subject
    record = subject.record
    estimate = read_outcome(subject, Estimate)
    frames = read_outcome(subject, Assessment).frames
    reading = rest_reading(subject)
    cobb, kind = 0.0, "none"
    if reading.largest is not None:
        cobb = reading.largest.angle.degrees
        kind = REGIONS[reading.largest.region][1] if abs(cobb) >= SMALLEST_COBB_DEG else "none"
    curve: CurveKind = kind  # type: ignore[assignment]
    ratios = {
        name: _stiffness(ratio, ratio_unit(name, tuple(estimate.ratios)), estimate, name)
        for name, ratio in estimate.ratios.items()
    }
    plain = {
        name: _stiffness(found, found.unit, estimate, found.ratio)
        for name, found in estimate.plain.items()
        if found.ratio is not None or found.low is not None
    }
    forces = [force for push in record.pushes for force, role in zip(push.forces_n, push.roles) if role != "unused"]
    return Row(
        participant=participant,
        id=record.id,
        age=record.age,
        sex=record.sex,
        height_cm=record.height_cm,
        mass_kg=record.mass_kg,
        cobb_deg=round(cobb, 3) + 0.0,
        curve=curve,
        population=estimate.population,
        status=estimate.status,
        determined=estimate.determined if has_intervals(estimate) else NO_INTERVALS,
        failed_checks=tuple(dict.fromkeys(check.name for check in estimate.failed)),
        stiffness={**ratios, **plain},
        training_rmse_mm=estimate.training_rmse_mm.fit,
        p_value=estimate.p_value,
        held_out=_held_out(frames),
        largest_force_n=max(forces),
        report="report.html",
    )


def _stiffness(found: Quantity, unit: str, estimate: Estimate, ratio: str | None) -> Stiffness:
    """``ratio`` : that scales it; None where several do."""
    sd = found.sd_log
    at_bound = ratio is not None and estimate.ratios[ratio].at_bound
    return Stiffness(
        value=found.value,
        unit=unit,
        low=found.low,
        high=found.high,
        open_low=found.open_low,
        open_high=found.open_high,
        sd_log=sd if isfinite(sd) and sd > 0.0 and not at_bound else None,
        # 0 of a ratio that the radiographs say nothing of: it stays at its start at each visit.
        visit_sd_log=(estimate.visit_sd_log.get(ratio) or None) if ratio is not None else None,
    )


def _held_out(frames: Sequence[HeldOutFrame]) -> HeldOut | None:
    if not frames:
        return None
    rmse: dict[str, list[float]] = {}
    for frame in frames:
        for name, value in frame.rmse_mm.items():
            if value is not None:
                rmse.setdefault(name, []).append(value)
    forecasts = [frame.forecast for frame in frames if frame.forecast is not None]
    errors = [abs(found.cobb_error_deg) for found in forecasts if found.cobb_error_deg is not None]
    return HeldOut(
        frames=len(frames),
        rmse_mm={name: sqrt(float(np.mean(np.square(values)))) for name, values in sorted(rmse.items())},
        cobb_error_deg=float(np.mean(errors)) if errors else None,
        inside95=float(np.mean([found.inside95 for found in forecasts])) if forecasts else None,
    )
