"""``spinestiff inspect``: what the reader sees in radiographs, for people and for programs."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from spinestiff.errors import RadiographError, SpinestiffError
from spinestiff.subject.records import SUBJECT_FILE
from spinestiff.words import counted

if TYPE_CHECKING:
    from spinestiff.subject.inspection import Inspection


def show_inspection(path: Path, as_json: bool) -> None:
    """Print what is in a file or folder.

    Raises
    ------
    RadiographError : the only file can't be used.
    typer.Exit : with status 2, after everything was printed, if an image of a folder can't be used.
    """
    from spinestiff.app.tables import show_json
    from spinestiff.subject.inspection import inspect

    found = inspect(path)
    if (path / SUBJECT_FILE).is_file() and not any(one.reason for one in found):
        found += tuple(_other_persons(path))
        if all(one.status == "ok" for one in found):
            found += tuple(_odd_settings(path))
    refused = [one for one in found if one.reason]
    if as_json:
        show_json([one.record() for one in found])
    elif len(refused) < len(found) or len(found) > 1:
        for one in found:
            for line in _lines(one):
                typer.echo(line)
    if len(found) == 1 and refused:
        raise RadiographError(refused[0].reason)
    if refused:
        raise typer.Exit(2)


def _other_persons(folder: Path) -> Iterator[Inspection]:
    """Radiographs of another patient or visit, of which an estimate would say that it is doubtful."""
    from spinestiff.study.judgement import failed
    from spinestiff.study.judgement.identity import identity
    from spinestiff.study.judgement.limits import LIMITS
    from spinestiff.subject.folder import read_identities, read_unannotated
    from spinestiff.subject.inspection import Inspection

    wrong = failed(tuple(identity(read_identities(read_unannotated(folder)), LIMITS)))
    if wrong:
        yield Inspection(SUBJECT_FILE, warnings=tuple(check.text for check in wrong))


def _odd_settings(folder: Path) -> Iterator[Inspection]:
    """What the steps would refuse of a subject each of whose radiographs they take: priors, population, markers, a
    radiograph that counts twice, body, torso, scan."""
    from spinestiff.study.starting_torso import skin_scan, starting_torso
    from spinestiff.study.visit import open_visit
    from spinestiff.subject.inspection import Inspection
    from spinestiff.subject.marks import check_marks

    try:
        visit = open_visit(folder)
        check_marks(visit.subject)
        starting_torso(visit)
        skin_scan(visit)
    except SpinestiffError as problem:
        yield Inspection(SUBJECT_FILE, str(problem))


def _lines(one: Inspection) -> Iterator[str]:
    yield f"{one.image}: {one.status}"
    if one.reason:
        yield f"  refused      {one.reason}"
        return
    if one.seen:
        yield from _seen(one.seen)
    for line in one.warnings:
        yield f"  warning      {line}"
    for line in one.missing:
        yield f"  missing      {line}"


def _seen(seen: dict[str, Any]) -> Iterator[str]:
    sources = seen["sources"]
    yield f"  file         {seen['file']}" + (f" and {seen['files'] - 1} more" if seen["files"] > 1 else "")
    yield f"  modality     {seen['modality']}, {seen['kind']}"
    frames = counted(seen["frames"], "frame")
    depth = f"{seen['bits']} bit" + (" signed" if seen["signed"] else "")
    yield f"  picture      {frames} of {seen['rows']} x {seen['columns']} (rows x columns), {depth}"
    yield f"  coding       {seen['transfer_syntax']}; {sources['grey values']}"
    yield f"  pixel pitch  {_pitch(seen)}"
    for key, name in (("detector", "source_detector_mm"), ("patient", "source_patient_mm")):
        known = "unknown" if seen[name] is None else f"{seen[name]:g} mm ({sources[f'source to {key}']})"
        yield f"  to {key:<9} {known}"
    yield f"  orientation  {_orientation(seen)}"
    yield f"  times        {_times(seen['times_s'])}"


def _pitch(seen: dict[str, Any]) -> str:
    at_detector, at_patient = seen["pixel_mm_at_detector"], seen["pixel_mm_at_patient"]
    if at_detector is None:
        return "unknown"
    pitch = "{:.4g} x {:.4g} mm at the detector".format(*at_detector)
    if at_patient is not None:
        pitch += ", {:.4g} x {:.4g} mm at the patient".format(*at_patient)
    return f"{pitch} ({seen['sources']['pixel spacing']})"


def _orientation(seen: dict[str, Any]) -> str:
    if seen["view"] is None:
        return "unknown"
    sources = seen["sources"]
    axes = f"columns grow to {seen['columns_to']}, rows to {seen['rows_to']}"
    return f"{seen['view']}, {axes} ({sources['orientation']}), beam to {seen['beam_to']} ({sources['beam']})"


def _times(times: list[float | None]) -> str:
    if len(times) == 1:
        return "one frame"
    return "unknown" if times[-1] is None else f"{len(times)} frames in {times[-1]:g} s"
