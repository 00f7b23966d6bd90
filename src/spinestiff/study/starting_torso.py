"""The torso that a subject's radiographs shape, and what it is shaped to beside them."""

from __future__ import annotations

import numpy as np

from spinestiff.anatomy.axes import body_axes
from spinestiff.anatomy.files import read_torso
from spinestiff.anatomy.names import BONES
from spinestiff.anatomy.template import template_torso
from spinestiff.anatomy.template.body import AGE_RANGE_YEARS
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.errors import SubjectError, TorsoError
from spinestiff.personalise.scan import SkinScan, read_scan
from spinestiff.study.visit import START, Visit
from spinestiff.subject.geometry_outcome import GeometryRecord
from spinestiff.subject.records import SUBJECT_FILE, SubjectRecord

OWN_HEIGHT = 0.1  # share by which an own torso's height may differ from the subject's


def subject_template(record: SubjectRecord, mesh: str) -> TorsoModel:
    """The torso that a subject's radiographs shape: the body of this height, age and sex, with the subject's mass or,
    where that is not known, the usual one. Younger and older people than the template has are as its youngest and
    oldest.

    Raises
    ------
    TorsoError : the template has no such body.
    """
    age = float(np.clip(record.age, *AGE_RANGE_YEARS))
    try:
        return template_torso(record.height_cm, mesh, age_years=age, sex=record.sex, mass_kg=record.mass_kg)
    except TorsoError as error:
        mass = "" if record.mass_kg is None else f", {record.mass_kg:g} kg"
        raise TorsoError(
            f"the template has no body of {record.age:g} years, {record.sex}, {record.height_cm:g} cm{mass}: {error}; "
            f"see whether {SUBJECT_FILE} has them right"
        ) from None


def body_notes(record: SubjectRecord) -> list[str]:
    """What the template takes otherwise than it is told."""
    youngest, oldest = AGE_RANGE_YEARS
    if youngest <= record.age <= oldest:
        return []
    return [
        f"age {record.age:g}: the template's body is one of {youngest if record.age < youngest else oldest:g} years"
    ]


def outputs_of_shape(visit: Visit) -> tuple[str, ...]:
    """The files that ``personalise_step`` writes for this visit."""
    found = ["torso.npz", GeometryRecord.FILE]
    if visit.subject.scan_path:
        found.append("skin_scan.png")
    if visit.subject.torso_path is None and visit.settings.mesh == "fine":
        found.append(START)
    return tuple(found)


def skin_scan(visit: Visit) -> SkinScan | None:
    """The subject's skin scan in mm along the body's axes, if there is one.

    Raises
    ------
    SubjectError : it can't be read, or its stated unit or axes contradict the body.
    """
    record, path = visit.subject.record.skin_scan, visit.subject.scan_path
    if record is None or path is None:
        return None
    axes = body_axes(record.axes.left, record.axes.up, record.axes.front)
    return read_scan(path, record.unit, axes, visit.subject.record.height_cm)


def starting_torso(visit: Visit) -> TorsoModel:
    """The torso that is shaped to the radiographs: of the subject's own bones, or the template.

    Raises
    ------
    SubjectError : the own torso isn't of the subject's height or bones.
    """
    record, own = visit.subject.record, visit.subject.torso_path
    if own is None:
        return subject_template(record, visit.settings.mesh)
    torso = read_torso(own)
    if torso.bone_names != BONES:
        raise SubjectError(f"{own}: has {len(torso.bone_names)} bones; wanted the 49 of spinestiff torso import")
    if not abs(torso.height_cm / record.height_cm - 1.0) < OWN_HEIGHT:
        raise SubjectError(
            f"{own}: is of a body of {torso.height_cm:.0f} cm, but subject.json says {record.height_cm:g} cm; "
            "import it with --height, or use the right bones"
        )
    return torso
