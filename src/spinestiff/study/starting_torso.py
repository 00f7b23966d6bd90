"""The torso that a subject's radiographs shape, and what it is shaped to beside them."""

from __future__ import annotations

from spinestiff.anatomy.axes import body_axes
from spinestiff.anatomy.files import read_torso
from spinestiff.anatomy.names import BONES
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.errors import SubjectError
from spinestiff.personalise.scan import SkinScan, read_scan
from spinestiff.study.subject_body import subject_template
from spinestiff.study.visit import START, Visit

OWN_HEIGHT = 0.1  # share by which an own torso's height may differ from the subject's
SCAN_PICTURE = "skin_scan.png"


def left_of_shape(visit: Visit) -> set[str]:
    """The files of ``personalise_step`` that this visit has none of: no scan, or no coarse torso to start from."""
    left = set() if visit.subject.scan_path else {SCAN_PICTURE}
    return left if visit.subject.torso_path is None and visit.settings.mesh == "fine" else {*left, START}


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
