"""The template's body of a subject: of its age, sex, height and, where that is known, mass."""

from __future__ import annotations

import numpy as np

from spinestiff.anatomy.template import template_torso
from spinestiff.anatomy.template.body import AGE_RANGE_YEARS, Sex
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.errors import TorsoError
from spinestiff.subject.records import SUBJECT_FILE, SubjectRecord


def subject_template(record: SubjectRecord, mesh: str) -> TorsoModel:
    """The torso that a subject's radiographs shape: the body of this height, age and sex, with the subject's mass or,
    where that is not known, the usual one. Younger and older people than the template has are as its youngest and
    oldest.

    Raises
    ------
    TorsoError : the template has no such body.
    """
    try:
        return template_body(record.age, record.sex, record.height_cm, mesh, record.mass_kg)
    except TorsoError as error:
        raise TorsoError(f"{error}; see whether {SUBJECT_FILE} has them right") from None


def template_body(age: float, sex: Sex, height_cm: float, mesh: str, mass_kg: float | None = None) -> TorsoModel:
    """As ``subject_template``, of a body that no record tells of."""
    years = float(np.clip(age, *AGE_RANGE_YEARS))
    try:
        return template_torso(height_cm, mesh, age_years=years, sex=sex, mass_kg=mass_kg)
    except TorsoError as error:
        mass = "" if mass_kg is None else f", {mass_kg:g} kg"
        raise TorsoError(f"the template has no body of {age:g} years, {sex}, {height_cm:g} cm{mass}: {error}") from None


def body_notes(record: SubjectRecord) -> list[str]:
    """What the template takes otherwise than it is told."""
    youngest, oldest = AGE_RANGE_YEARS
    if youngest <= record.age <= oldest:
        return []
    return [
        f"age {record.age:g}: the template's body is one of {youngest if record.age < youngest else oldest:g} years"
    ]
