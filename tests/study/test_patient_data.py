"""Nothing of a patient that stands in radiographs or in their files' names gets into results, pages or output."""

from __future__ import annotations

import os
import shutil

import numpy as np
import pydicom
import pytest
from pydicom.datadict import DicomDictionary
from pydicom.tag import Tag

from canaries import CANARY, NUMBER, traces
from spinestiff.errors import RadiographError
from spinestiff.files import read_json, write_json
from spinestiff.imaging.projection import frontal_view
from spinestiff.imaging.radiograph import Geometry, read_radiographs, write_radiographs
from spinestiff.study.runner import run_steps
from spinestiff.study.visit import open_visit


def test_no_canary_gets_into_results(finished):
    """All radiographs of the shared subject are full of canaries (tests/conftest.py)."""
    written = {path.name for path in (finished.folder / "results").iterdir()}
    assert written >= {"run.json", "tracked.json", "torso.npz", "personalised.json", "estimate.json", "assessment.json"}
    assert not traces(finished.folder / "results", *finished.lines)
    assert len(traces(finished.folder / "rest", finished.folder / "pushes")) == 4


def test_names_of_frames_get_nowhere(subject, capfd):
    """A push of single files named after the patient, as X-ray systems export them."""
    record = read_json(subject / "subject.json")
    series = pydicom.dcmread(subject / "pushes/second.dcm")
    view = read_radiographs(subject / "pushes/second.dcm")[0].view
    (subject / "pushes/second.dcm").unlink()
    (subject / "pushes/second").mkdir()
    for number, pixels in enumerate(series.pixel_array):
        write_radiographs(subject / f"pushes/second/{CANARY}_{number}.dcm", pixels, view, instance_number=number + 1)
    record["pushes"] = [{**record["pushes"][1], "frames": "pushes/second", "roles": ["unused", "training"]}]
    write_json(subject / "subject.json", record)
    annotation = read_json(subject / "annotation.json")
    del annotation["images"]["push/main"]
    write_json(subject / "annotation.json", annotation)
    shutil.rmtree(subject / "results")
    lines: list[str] = []
    visit = open_visit(subject)
    run_steps(visit, ("track",), lines.append)
    said = capfd.readouterr()
    assert not traces(subject / "results", said.out, said.err, *lines)
    # A change of a frame is still seen.
    os.truncate(subject / f"pushes/second/{CANARY}_1.dcm", 5000)
    with pytest.raises(RadiographError):
        run_steps(visit, ("track",))


KEPT_WORDS = (
    "PatientOrientation", "ViewPosition", "PixelSpacingCalibrationType", "AcquisitionDate", "AcquisitionTime",
    "Modality", "PhotometricInterpretation",
)  # fmt: skip
NUMBERS = (
    "Rows", "Columns", "BitsAllocated", "BitsStored", "HighBit", "SamplesPerPixel", "NumberOfFrames", "FrameTime",
    "ImagerPixelSpacing", "DistanceSourceToDetector", "DistanceSourceToPatient", "RescaleSlope", "RescaleIntercept",
    "WindowCenter", "InstanceNumber", "PixelIntensityRelationshipSign",
)  # fmt: skip


@pytest.mark.parametrize("keyword", [*KEPT_WORDS, *NUMBERS, "TransferSyntaxUID"])
def test_a_broken_value_is_not_quoted(tmp_path, capfd, monkeypatch, keyword):
    path = tmp_path / "rest.dcm"
    view = frontal_view(sid=1500.0, source_to_patient=1340.0, shape=(40, 36), pixel=(0.3, 0.4))
    write_radiographs(path, np.full(view.shape, 7, np.uint16), view)
    dataset = pydicom.dcmread(path)
    if keyword == "TransferSyntaxUID":
        dataset.file_meta.TransferSyntaxUID = f"1.2.{NUMBER}"
        dataset.save_as(path)
    else:
        # Text under the VR that belongs there, which only raw bytes can hold.
        text, tag = f"{CANARY}\\{CANARY}_".encode(), Tag(keyword)
        monkeypatch.setattr(pydicom.config, "replace_un_with_known_vr", False)
        dataset[keyword] = pydicom.DataElement(tag, "UN", text)
        dataset.save_as(path)
        monkeypatch.undo()
        content = path.read_bytes()
        head = tag.group.to_bytes(2, "little") + tag.element.to_bytes(2, "little")
        start, body, end = content.partition(head + b"UN\0\0" + len(text).to_bytes(4, "little"))
        assert body
        vr = DicomDictionary[tag][0][:2].encode()
        path.write_bytes(start + head + vr + len(text).to_bytes(2, "little") + end)
    said = ""
    try:
        found = read_radiographs(path, geometry=Geometry(view="frontal"))
        said = repr([picture.provenance for picture in found])
    except RadiographError as problem:
        said = str(problem)
    printed = capfd.readouterr()
    assert said
    assert not traces(said, printed.out, printed.err)
