"""A torso for other programs: VTU, GLB, OpenSim, MuJoCo, FEBio and Slicer markups; each says what it leaves out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path

from spinestiff.anatomy.state import TorsoState
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.errors import TorsoError
from spinestiff.files import write_bytes

__all__ = ["FORMATS", "ExportFormat", "export_torso"]

# Takes the torso and a state of it, gives the file's bytes.
Exporter = Callable[[TorsoModel, TorsoState], bytes]


@dataclass(frozen=True)
class ExportFormat:
    """One format: file ending, what it is for, what of a torso it leaves out or changes, whether it has stiffness."""

    suffix: str
    purpose: str
    leaves_out: str
    has_stiffness: bool = False


FORMATS = {
    "vtu": ExportFormat(".vtu", "ParaView", "joint stiffness (joints are points); mm"),
    "glb": ExportFormat(".glb", "any 3-D viewer", "everything but bones and skin as surfaces; m, y up, z to the front"),
    "osim": ExportFormat(
        ".osim",
        "OpenSim 4",
        "tissue and supports; a bushing's rotations are body-fixed x-y-z angles, ours a rotation vector: alike for "
        "small angles only; masses are those of the bones; m, N, N m",
        has_stiffness=True,
    ),
    "mjcf": ExportFormat(
        ".xml",
        "MuJoCo",
        "tissue and supports; the pelvis stands still; ribs' second joints are closed by welds; three hinges in turn "
        "instead of a rotation vector: alike for small angles only; m, N, N m",
        has_stiffness=True,
    ),
    "feb": ExportFormat(
        ".feb",
        "FEBio 4",
        "supports; each joint is nine springs that have its stiffness at rest; mm, N, MPa",
        has_stiffness=True,
    ),
    "mrk": ExportFormat(".mrk.json", "3D Slicer", "everything but points: joints, landmarks, box corners; LPS, mm"),
}


def export_torso(torso: TorsoModel, path: str | Path, kind: str, state: TorsoState | None = None) -> Path:
    """Write a torso, at rest or in a state, for another program; whole or not at all.

    Raises
    ------
    TorsoError : unknown format, a package that is not installed, or the file can't be written.
    """
    if kind not in FORMATS:
        raise TorsoError(f"unknown format '{kind}'; known are {', '.join(FORMATS)}")
    exporter: Exporter = import_module(f"{__name__}.{kind}").content
    content = exporter(torso, torso.rest_pose if state is None else state)
    path = Path(path)
    write_bytes(path, content, TorsoError)
    return path
