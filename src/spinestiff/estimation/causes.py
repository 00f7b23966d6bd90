"""What an estimate's uncertainty comes from, by name: the rows of the variance budget."""

from __future__ import annotations

from typing import Literal

Cause = Literal[
    "tracking",
    "drag of tracking",
    "model discrepancy",
    "annotation",
    "marks set by hand",
    "place in the picture",
    "posture",
    "stance",
    "turn of the patient",
    "rest geometry",
    "pedicles' places",
    "markers' own errors",
    "markers' places",
    "turn of the cameras",
    "sway before the cameras",
    "breath under the markers",
    "force scale",
    "force offset",
    "push direction",
    "push height",
    "push depth",
    "obliquity by force",
    "shoulder by force",
    "breathing",
    "obliquity of a frame",
    "shoulder of a frame",
    "trunk size",
    "rib joints",
    "tissue's volume",
    "tissue mesh",
    "source distance",
]
"""Up to the markers' causes what is added to what is seen, by ``noise``, ``marker_noise`` and ``moving``; from the
force's on what moves an equilibrium (``unknowns``)."""

TRACKING: Cause = "tracking"
DRAG: Cause = "drag of tracking"
DISCREPANCY: Cause = "model discrepancy"
STANCE: Cause = "stance"
PERSONAL: tuple[Cause, ...] = (
    DISCREPANCY,
    "trunk size",
    "rib joints",
    "tissue's volume",
    "tissue mesh",
    "pedicles' places",
)
"""What a person has at every visit, beside ratios: an error that two estimates of one person share."""
ANNOTATED: tuple[Cause, ...] = ("annotation", "marks set by hand", "rest geometry")
"""What is anew where the same radiographs are annotated again."""
