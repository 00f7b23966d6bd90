"""One base error; children by cause.

A message names what is wrong, where (file, bone, frame, value) and what to try.
The command line prints it in one line and exits with ``exit_status``.
"""

from __future__ import annotations


class SpinestiffError(Exception):
    """Any failure that is the input's or the computation's, not the program's."""

    exit_status = 2


class OptionError(SpinestiffError):
    """An option of a command is no value that the command takes."""


class SubjectError(SpinestiffError):
    """A subject folder, or a file in it, can't be used."""


class SubjectGaps(SubjectError):
    """A subject lacks values that a step needs.

    Attributes
    ----------
    lines : one for each.
    """

    def __init__(self, *lines: str) -> None:
        super().__init__("; ".join(lines))
        self.lines = lines


class InUseError(SubjectError):
    """A folder that another run holds; it can be used once that has ended."""


class ChangedElsewhere(SubjectError):
    """What is on disk, or a page's copy of it, is no longer what was read."""


class NotThere(SubjectError):
    """What a page asks for is not there, or no longer."""


class RadiographError(SpinestiffError):
    """A radiograph can't be read, or lacks what a measurement in millimetres needs."""


class TrackingError(SpinestiffError):
    """Vertebra corners can't be followed through a sequence."""


class TorsoError(SpinestiffError):
    """Anatomy that is no torso: shapes, frames, meshes, unknown names."""


class EquilibriumError(SpinestiffError):
    """No static equilibrium was found."""

    exit_status = 3


class FitError(SpinestiffError):
    """Stiffness ratios can't be estimated from these trials."""

    exit_status = 3


class NoMinimum(FitError):
    """The search for stiffness ratios found nowhere to start, or ended where the loss has no minimum."""


class OutsideWarning(UserWarning):
    """Something is asked of the model that lies far outside what it was made for and compared with."""
