"""A push's forces from the log of its gauge: radiographs read, their motion measured, the log put beside them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from spinestiff.arrays import Floats
from spinestiff.errors import SubjectError
from spinestiff.imaging.dicom.millimetres import Geometry
from spinestiff.imaging.motion import motion_course
from spinestiff.imaging.radiograph import read_scans, times_of
from spinestiff.subject.intake.force_log import ForceLog
from spinestiff.subject.intake.log_match import LEAST_RISE_N, LogMatch, given_offset, match_log, outside
from spinestiff.words import push_named

MOST_OUTSIDE_S = 1.0
"""By which the frames may reach beyond a log whose offset is given."""


@dataclass(frozen=True)
class Logged:
    """A push's log beside its frames: times (F,), s since the first, and motion (F,), pixels (``imaging.motion``).

    ``by_content`` : times are those of the pictures' content, since no file tells when it was taken.
    """

    log: ForceLog
    times_s: Floats
    motion: Floats
    match: LogMatch
    by_content: bool = False

    @property
    def placed(self) -> bool:
        """Whether the frames' forces are known."""
        return self.match.given or self.match.determined

    @property
    def stretch_s(self) -> tuple[float, float]:
        """Times of the log between which the frames lie, by the offset."""
        first, last = float(self.times_s[0]), float(self.times_s[-1])
        return first + self.match.offset_s, last + self.match.offset_s

    def on_the_stretch_of(self, other: Logged) -> bool:
        """Whether the frames of both lie at one time of the log, by more than their offsets leave open."""
        (first, last), (begins, ends) = self.stretch_s, other.stretch_s
        open_s = sum(0.5 * (one.match.high_s - one.match.low_s) for one in (self, other))
        return min(last, ends) - max(first, begins) > open_s

    @property
    def forces_n(self) -> list[float | None]:
        """At the frames, to 0.1 N; None where the log tells none."""
        return [round(float(force), 1) + 0.0 if np.isfinite(force) else None for force in self.match.forces_n]

    @property
    def untold(self) -> tuple[str, ...]:
        """Which frames have no force though the offset is known, and why, in words."""
        match = self.match
        if not self.placed:
            return ()
        beyond = [i for i in np.flatnonzero(np.isnan(match.forces_n)).tolist() if i not in match.uncertain]
        found = []
        if beyond:
            lies = "lies" if len(beyond) == 1 else "lie"
            found.append(f"{_frames(beyond)} {lies} beyond the log, or in a gap of it, where it tells no force")
        if match.uncertain:
            wide = 0.5 * (match.forces_high_n - match.forces_low_n)[list(match.uncertain)].max()
            many = "the force" if len(match.uncertain) == 1 else "the forces"
            found.append(
                f"the offset, from {match.low_s:.2f} to {match.high_s:.2f} s, leaves {many} of "
                f"{_frames(match.uncertain)} open by up to ± {wide:.0f} N"
            )
        return tuple(found)

    @property
    def doubt(self) -> str:
        """What is doubtful of the frames' times, in words; empty if nothing."""
        if not self.by_content:
            return ""
        return "its radiographs tell no AcquisitionTime; their ContentTime, which may be that of processing, is taken"

    def table(self) -> str:
        """CSV, a row a frame; forces are empty where the offset is not determined, or the log tells none; of
        an uncertain frame the range is told alone."""
        lines = ["frame,time_s,log_time_s,force_n,force_low_n,force_high_n,motion_px"]
        for i, (time, motion) in enumerate(zip(self.times_s, self.motion)):
            forces = (self.match.forces_n[i], self.match.forces_low_n[i], self.match.forces_high_n[i])
            none = not np.isfinite(forces[0]) and i not in self.match.uncertain
            told = ["" if none or not np.isfinite(force) else f"{force:.2f}" for force in forces]
            shown = [f"{time + self.match.offset_s:.3f}", *told] if self.placed else [""] * 4
            lines.append(",".join([str(i), f"{time:.3f}", *shown, f"{motion:.2f}"]))
        return "\n".join(lines) + "\n"


def _frames(numbers: Sequence[int]) -> str:
    return f"frame{'s' if len(numbers) > 1 else ''} {', '.join(map(str, numbers))}"


def put_beside(log: ForceLog, files: Sequence[Path], name: str, offset_s: float | None) -> Logged:
    """A log beside the radiographs of a push.

    Parameters
    ----------
    files : one of several frames, or files of one frame each in order of time; or their folder.
    name : of the push, for messages.
    offset_s : time of the log at the first frame; None: found from the motion.

    Raises
    ------
    SubjectError : frames without times, or beyond a log whose offset is given. RadiographError : a file can't be read.
    """
    scans = [scan for file in files for scan in read_scans(file, Geometry())[0]]
    told = times_of(tuple(scans))
    times = np.array([np.nan if time is None else time for time in told])
    if not np.isfinite(times).all():
        raise SubjectError(
            f"{push_named(name)}: its radiographs tell no times of their frames (FrameTime, AcquisitionTime, "
            "ContentTime), so a force log can't be put beside them; give the forces by hand"
        )
    if (np.diff(times) <= 0.0).any():
        raise SubjectError(
            f"{push_named(name)}: times of its frames do not grow, so a force log can't be put beside them"
        )
    motion = motion_course(frame for scan in scans for frame in scan.pixels)
    by_content = len(scans) > 1 and all(scan.tags.clock is None for scan in scans)
    logged = Logged(log, times, motion, match_log(log, times, motion), by_content)
    return logged if offset_s is None else at_offset(logged, name, offset_s)


def at_offset(logged: Logged, name: str, offset_s: float) -> Logged:
    """A log of which the user gives the offset.

    Raises
    ------
    SubjectError : frames beyond the log, or all of them where it shows no push though there is one.
    """
    log, times = logged.log, logged.times_s
    beyond = outside(log, times, offset_s)
    if beyond > MOST_OUTSIDE_S:
        raise SubjectError(
            f"{push_named(name)}: with the first frame at {offset_s:g} s of the log frames lie {beyond:.1f} s beyond "
            f"its ends ({log.times_s[0]:g} and {log.times_s[-1]:g} s); wanted a log around them, "
            f"or at most {MOST_OUTSIDE_S:g} s beyond it"
        )
    match = given_offset(log, times, offset_s, logged.motion, logged.match)
    pushed = log.times_s[log.forces_n >= LEAST_RISE_N]
    if len(pushed) and np.nan_to_num(match.forces_n).max() < LEAST_RISE_N:
        raise SubjectError(
            f"{push_named(name)}: with the first frame at {offset_s:g} s of the log no frame has a force: the frames, "
            f"until {times[-1] + offset_s:g} s, lie beside its push, from {pushed[0]:g} to {pushed[-1]:g} s; give "
            "another offset"
        )
    return replace(logged, match=match)
