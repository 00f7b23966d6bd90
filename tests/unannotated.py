"""A small subject folder that nobody has annotated yet, and questions to the server of its page."""

from __future__ import annotations

import http.client
import json
from dataclasses import dataclass

import numpy as np

from phantoms import phantom, sixteen_bit
from spinestiff.annotate.session import AnnotationSession
from spinestiff.imaging.projection import frontal_view, lateral_view
from spinestiff.imaging.radiograph import write_radiographs
from spinestiff.loopback.guard import TOKEN_HEADER

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
class Served:
    """A running server."""

    session: AnnotationSession
    address: str
    port: int
    token: str

    def ask(self, method, path, body=None, headers=None, token=None):
        """Status, headers and body of an answer; ``headers`` over those that the page sends."""
        sent = {TOKEN_HEADER: self.token if token is None else token, **(headers or {})}
        sent = {key: value for key, value in sent.items() if value is not None}
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=20)
        try:
            data = body if body is None or isinstance(body, bytes) else json.dumps(body).encode()
            connection.request(method, path, data, sent)
            answer = connection.getresponse()
            return answer.status, dict(answer.getheaders()), answer.read()
        finally:
            connection.close()

    def json(self, method, path, body=None):
        status, _, content = self.ask(method, path, body)
        return status, json.loads(content)
