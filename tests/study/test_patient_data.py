"""Nothing of a patient that stands in radiographs or in their files' names gets into results, pages or output."""

from __future__ import annotations

import shutil

import numpy as np
import pydicom
import pytest
from pydicom.datadict import DicomDictionary
from pydicom.tag import Tag

from canaries import CANARY, NUMBER, infest, traces
from spinestiff.errors import RadiographError
from spinestiff.imaging.projection import frontal_view
from spinestiff.imaging.radiograph import Geometry, read_radiographs, write_radiographs
from spinestiff.study.pipeline import run_steps
from spinestiff.study.report import write_report
from spinestiff.study.results import read_json, write_json
from spinestiff.study.viewer.files import write_view
from spinestiff.study.visit import open_visit


@pytest.fixture
def patient(subject):
    """The subject, with canaries in all radiographs, and the second push as single files named after the patient."""
    record = read_json(subject / "subject.json")
    series = pydicom.dcmread(subject / "pushes/second.dcm")
    second = read_radiographs(subject / "pushes/second.dcm")[0].view
    (subject / "pushes/second.dcm").unlink()
    (subject / "pushes/second").mkdir()
    for number, pixels in enumerate(series.pixel_array):
        write_radiographs(subject / f"pushes/second/{CANARY}_{number}.dcm", pixels, second, instance_number=number + 1)
    record["pushes"][1]["frames"] = "pushes/second"
    write_json(subject / "subject.json", record)
    shutil.rmtree(subject / "results")
    rng = np.random.default_rng(11)
    count = sum(infest(path, rng, 60) for path in sorted(subject.rglob("*.dcm")))
    assert count > 2000
    return subject


@pytest.mark.slow
def test_no_canary_gets_into_results(patient, finished, capfd):
    lines: list[str] = []
    visit = open_visit(patient)
    run_steps(visit, ("track", "personalise"), lines.append)
    # The steps in between read no radiographs; the report and the view show them.
    for name in ("estimate.json", "assessment.json"):
        shutil.copy(finished.folder / "results" / name, patient / "results")
    write_report(visit, lines.append)
    write_view(visit, lines.append)
    said = capfd.readouterr()
    written = {path.name for path in (patient / "results").iterdir()}
    assert written >= {"run.json", "tracked.json", "personalised.json", "report.html", "view.html"}
    assert not traces(patient / "results", said.out, said.err, *lines)
    assert len(traces(patient / "rest", patient / "pushes")) >= 6


KEPT_WORDS = ("PatientOrientation", "ViewPosition", "PixelSpacingCalibrationType", "AcquisitionDate", "AcquisitionTime")
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
