"""What the values of ``subject.json`` are called, their units, and which picture shows what they mean."""

from __future__ import annotations

from typing import Final

WORDS: Final[dict[str, dict[str, str]]] = {
    "id": {"title": "Subject", "help": "A name that is no person's: letters, digits, '.', '_' or '-'."},
    "age": {"title": "Age", "unit": "years", "help": "When the radiographs were taken."},
    "sex": {"title": "Sex"},
    "height_cm": {"title": "Standing height", "unit": "cm", "picture": "height"},
    "mass_kg": {
        "title": "Body mass",
        "unit": "kg",
        "help": "If known: the torso takes the sizes of such a body.",
    },
    "pushes": {"title": "Pushes"},
    "pushes.side": {"title": "Side that is pushed", "help": "The patient's.", "picture": "side"},
    "pushes.level": {
        "title": "Rib that is pushed",
        "unit": "rib",
        "help": "8.5 lies between ribs 8 and 9.",
        "picture": "level",
    },
    "pushes.d21_mm": {
        "title": "Shoulder support to pelvis support (d21)",
        "unit": "mm",
        "help": "Vertical distance.",
        "picture": "d21",
    },
    "pushes.d31_mm": {
        "title": "Shoulder support to push (d31)",
        "unit": "mm",
        "help": "Vertical distance; shorter than d21.",
        "picture": "d31",
    },
    "pushes.forces_n": {"title": "Force", "unit": "N", "help": "Of each frame, without sign.", "picture": "force"},
    "pushes.roles": {
        "title": "Use",
        "help": "Estimate from it (training), predict it and compare (validation), or leave it out (unused). "
        "An estimate needs a frame under force for training.",
    },
    "xray": {"title": "X-ray geometry", "help": "Only where the DICOM files lack it."},
    "xray.source_detector_mm": {"title": "X-ray source to detector", "unit": "mm", "picture": "source_detector"},
    "xray.source_patient_mm": {"title": "X-ray source to patient", "unit": "mm", "picture": "source_patient"},
    "xray.imager_pixel_mm": {"title": "Pixel at the detector", "unit": "mm"},
    "xray.orientation": {"title": "Orientation of radiographs that don't tell theirs"},
    "pelvis": {"title": "How the model holds the pelvis"},
    "wall": {"title": "What the back wall can do"},
    "priors": {"title": "What is not quite known", "help": "Standard deviations that differ from the usual ones."},
    "trunk": {"title": "Sizes of the trunk", "help": "By tape or caliper, at the height of a vertebra."},
    "trunk.breadth_mm": {"title": "Side to side", "unit": "mm"},
    "trunk.depth_mm": {"title": "Front to back", "unit": "mm"},
    "population": {"title": "Whose ratios are held as a prior"},
    "parameters": {"title": "Ratios to estimate", "help": "Lateral bending and tissue unless others are named."},
}
"""By the place in the schema, without numbers of list entries."""
