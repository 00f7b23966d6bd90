"""A small subject folder that nobody has annotated yet, and the server of its page."""

from __future__ import annotations

import json
from dataclasses import dataclass

import numpy as np

from asking import Asker
from phantoms import phantom, sixteen_bit
from spinestiff.annotate.session import AnnotationSession
from spinestiff.imaging.projection import frontal_view, lateral_view
from spinestiff.imaging.radiograph import write_radiographs

# Words that stand in the DICOM files and must not come out.
CANARY = "Canary^Patient"
MM = 0.72
BENDS = (16.0, 14.0, 12.0)


def drawn(image):
    """What the radiographs of the folder show, by name of the annotation."""
    if image == "rest/lateral":
        return phantom(kind="lateral", bend=-20.0)
    return phantom(bend=BENDS[0] if image == "rest/frontal" else BENDS[int((image.split("/") + ["0"])[2])])


def write_folder(folder):
    pixel = MM * 1500.0 / 1340.0
    frontal = frontal_view(shape=(640, 448), pixel=pixel)
    for name, view in (("rest/frontal", frontal), ("rest/lateral", lateral_view(shape=(640, 448), pixel=pixel))):
        path = folder / f"{name}.dcm"
        path.parent.mkdir(parents=True, exist_ok=True)
        write_radiographs(path, sixteen_bit(drawn(name).pixels), view, patient_id=CANARY, description=CANARY)
    (folder / "pushes").mkdir()
    series = np.stack([sixteen_bit(phantom(bend=bend).pixels) for bend in BENDS])
    write_radiographs(folder / "pushes/a.dcm", series, frontal, patient_id=CANARY, description=CANARY)
    record = {
        "schema_version": 1,
        "id": "girl",
        "age": 13,
        "sex": "female",
        "height_cm": 157,
        "pushes": [
            {
                "id": "a",
                "side": "right",
                "level": 8,
                "d21_mm": 400,
                "d31_mm": 200,
                "frames": "pushes/a.dcm",
                "forces_n": [0, 20, 40],
                "roles": ["unused", "training", "validation"],
            }
        ],
    }
    (folder / "subject.json").write_text(json.dumps(record), encoding="utf-8")
    return folder


@dataclass
class Served(Asker):
    """A running annotation page."""

    session: AnnotationSession
