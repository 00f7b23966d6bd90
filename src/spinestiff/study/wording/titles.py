"""What ratios, stiffnesses and unknowns are called, and the units they are told in."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from spinestiff.anatomy.regions import AT, is_beside_whole
from spinestiff.estimation.causes import Cause
from spinestiff.words import sentence

PLAIN = {
    "lateral_bending_thoracic": "lateral bending of a thoracic level",
    "lateral_bending_lumbar": "lateral bending of a lumbar level",
    "tissue_young": "Young's modulus of the trunk's soft tissue",
}
"""Stiffness in plain units (``plain``), in words."""
RATIO_TITLES = {
    "lateral_bending": "Lateral bending of the spine",
    "intervertebral_bending": "Lateral bending of the spine, rib cage as it is",
    "tissue": "Soft tissue of the trunk",
    "tissue_mu": "Soft tissue of the trunk, shear",
    "tissue_lambda": "Soft tissue of the trunk, bulk",
    "flexion_extension": "Flexion and extension of the spine",
    "axial_rotation": "Axial rotation of the spine",
    "lateral_shear": "Lateral shear of the spine",
    "sagittal_shear": "Sagittal shear of the spine",
    "separation": "Axial stiffness of the spine",
    "rib_rotation": "Turning of the ribs on their vertebrae",
    "everything": "All stiffnesses together",
}
"""What ratios scale, in words."""
BENDING_RATIOS = ("lateral_bending", "intervertebral_bending", "everything")
"""Ratios that scale a level's lateral bending as a whole."""
IN_PLAIN_UNITS = {
    "lateral_bending_thoracic": BENDING_RATIOS,
    "lateral_bending_lumbar": BENDING_RATIOS,
    "tissue_young": ("tissue", "everything"),
}
"""Ratios, of all or of a part of the torso, that scale these."""
TIMES_DEFAULT = "times the default stiffness"
TIMES_WHOLE = "times the ratio of the whole"


def ratio_unit(name: str, parameters: Sequence[str]) -> str:
    """What a ratio, one of ``parameters``, counts in."""
    return TIMES_WHOLE if is_beside_whole(name, parameters) else TIMES_DEFAULT


def ratio_title(name: str) -> str:
    """What a ratio scales, in words."""
    stem, _, part = name.partition(AT)
    title = RATIO_TITLES.get(stem, stem.replace("_", " "))
    return f"{title}, {part}" if part else title


def stiffness_title(name: str) -> str:
    """What ``told_stiffness`` tells of, in words: the same on report, cards and terminal."""
    return sentence(PLAIN[name]) if name in PLAIN else ratio_title(name)


def within_a_sentence(title: str) -> str:
    """A title without its capital letter; that of a name stays."""
    return title if title.startswith("Young") else title[:1].lower() + title[1:]


UNKNOWNS: Mapping[str, str] = {
    "tracking": "tracking's errors",
    "annotation": "corners set by hand",
    "marks set by hand": "corners and pedicles marked anew in a frame",
    "drag of tracking": "what takes tracking along",
    "place in the picture": "the patient's place in each picture",
    "stance": "where the patient stood in each sequence",
    "turn of the patient": "how far the patient stood turned",
    "pedicles' places": "where the pedicles are on the bones",
    "markers' own errors": "the cameras' errors at each marker",
    "markers' places": "where the markers are on the skin",
    "turn of the cameras": "the turn between cameras and radiographs",
    "sway before the cameras": "how the patient swayed before the cameras",
    "breath under the markers": "breath under the markers",
    "posture": "the spine's posture in each sequence",
    "rest geometry": "the spine's shape at rest",
    "model discrepancy": "what the model lacks",
    "force scale": "the gauge's scale",
    "force offset": "the gauge's zero",
    "push direction": "the push's direction",
    "push height": "the push's height",
    "push depth": "the push's place front to back",
    "obliquity by force": "how far the pelvis gives",
    "shoulder by force": "how far the shoulder gives",
    "breathing": "breath from frame to frame",
    "obliquity of a frame": "the pelvis' obliquity in each frame",
    "shoulder of a frame": "the shoulder's place in each frame",
    "trunk size": "the trunk's size",
    "rib joints": "the stiffness of the ribs' joints",
    "tissue's volume": "the tissue's resistance to a change of volume",
    "tissue mesh": "the tissue's mesh",
    "source distance": "the source's distance",
}
"""What is not quite known, by its name in the variance budget."""
UNMEASURABLE: tuple[Cause, ...] = ("model discrepancy", "rib joints", "tissue's volume", "tissue mesh")


def unknown_title(name: str) -> str:
    """An unknown of the variance budget in words."""
    return UNKNOWNS.get(name, name)
