"""Public test files have the outcome they should; damaged files give radiographs or one line, never worse."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pydicom.dataset import Dataset
from pydicom.sequence import Sequence

from spinestiff.errors import RadiographError
from spinestiff.imaging.radiograph import Geometry, read_radiographs

PUBLIC = Path(__file__).resolve().parents[3].parent / "shared" / "data" / "dicom"
GIVEN = Geometry(1000.0, 900.0, 0.2, "frontal")
MR = "modality MR is no projection radiograph"
HEADERLESS = "no DICOM file"
OUTCOMES = {
    "gdcm-CR-MONO1-10-chest.dcm": (440, 440),
    "RG3_J2KR_CR_extremity.dcm": (1760, 1760),
    "highdicom_dx_thorax.dcm": (169, 211),
    "emri_small.dcm": MR,
    "emri_small_RLE.dcm": MR,
    "MR_truncated.dcm": MR,
    "badVR.dcm": "NumberOfFrames is no number",
    "no_meta.dcm": HEADERLESS,
    "zipMR.gz": HEADERLESS,
    "README.md": HEADERLESS,
}


@pytest.mark.skipif(not PUBLIC.is_dir(), reason="needs the files of ../shared/data/dicom")
@pytest.mark.parametrize("name", OUTCOMES)
def test_public_files_have_their_outcome(name):
    wanted = OUTCOMES[name]
    given = Geometry(None, 900.0) if name.startswith("highdicom") else GIVEN
    if isinstance(wanted, str):
        with pytest.raises(RadiographError, match=f"^{name}: {wanted}"):
            read_radiographs(PUBLIC / name, geometry=given)
        return
    (radiograph,) = read_radiographs(PUBLIC / name, geometry=given)
    assert radiograph.pixels.shape == wanted
    # All three are MONOCHROME1 or say that larger values are more beam: the collimated or empty rim is dark.
    assert radiograph.provenance["grey values"].endswith("inverted")
    spacing = [1.201199999999, 1.2] if name.startswith("highdicom") else [0.2, 0.2]
    np.testing.assert_array_equal(radiograph.view.pixel_spacing, spacing)


@pytest.mark.skipif(not PUBLIC.is_dir(), reason="needs the files of ../shared/data/dicom")
def test_every_public_file_has_an_outcome():
    assert {path.name for path in PUBLIC.iterdir()} == set(OUTCOMES)


def test_a_share_of_the_campaign_finds_no_fault(campaign_module, tmp_path):
    path = tmp_path / "damaged.dcm"
    sound = campaign_module.seeds()
    sounds = {}
    for one in sound:
        path.write_bytes(one.content)
        sounds[one.name] = campaign_module.quantities(read_radiographs(path))
        assert campaign_module.judged(path, sounds[one.name]).outcome == "same"
    random = np.random.default_rng(11)
    rows = []
    for number in range(240):
        one = sound[number % len(sound)]
        way = campaign_module.WAYS[number // len(sound) % len(campaign_module.WAYS)]
        path.write_bytes(campaign_module.damaged(one, way, random))
        rows.append((one.name, way, campaign_module.judged(path, sounds[one.name]), 0.0))
    found = campaign_module.summary(rows)
    assert found["faults"] == {}, rows
    assert found["refused"] > 120
    assert found["refused by way"]["cut"] == "40 of 40"


@pytest.mark.parametrize(
    ("fault", "change"),
    [
        ("traceback", lambda m: m.setattr("spinestiff.imaging.dicom.reading.one_clear_line", _nothing)),
        ("size disagrees", lambda m: m.setattr("spinestiff.imaging.dicom.decoding.check_native", lambda *_: None)),
    ],
)
def test_the_campaign_would_see_a_fault(campaign_module, tmp_path, monkeypatch, fault, change):
    path = tmp_path / "damaged.dcm"
    one = campaign_module.seeds()[1]
    path.write_bytes(one.content)
    sound = campaign_module.quantities(read_radiographs(path))
    change(monkeypatch)
    random = np.random.default_rng(2)
    outcomes = set()
    for number in range(200):
        path.write_bytes(campaign_module.damaged(one, ("header", "sizes")[number % 2], random))
        outcomes.add(campaign_module.judged(path, sound).outcome)
    assert any(fault in outcome for outcome in outcomes), outcomes


class _nothing:
    """Stands in for the one place where failures become a line."""

    def __init__(self, name: str) -> None:
        pass

    def __enter__(self) -> None:
        pass

    def __exit__(self, *args: object) -> None:
        pass


def test_no_path_of_a_file_is_followed(file, tmp_path):
    secret = tmp_path / "secret.dcm"
    secret.write_bytes(b"\0" * 200)

    def refer(dataset: Dataset) -> None:
        record = Dataset()
        record.ReferencedFileID = ["..", "secret.dcm"]
        dataset.DirectoryRecordSequence = Sequence([record])

    assert len(read_radiographs(file(change=refer))) == 1
    directory = file(change=lambda d: setattr(d.file_meta, "MediaStorageSOPClassUID", "1.2.840.10008.1.3.10"))
    with pytest.raises(RadiographError, match="a DICOMDIR, no radiograph"):
        read_radiographs(directory)


def test_enhanced_files_keep_their_geometry_in_groups(file):
    def move(dataset: Dataset) -> None:
        inner, group = Dataset(), Dataset()
        inner.ImagerPixelSpacing = dataset.ImagerPixelSpacing
        inner.DistanceSourceToDetector = dataset.DistanceSourceToDetector
        del dataset.ImagerPixelSpacing, dataset.DistanceSourceToDetector
        group.FramePixelDataPropertiesSequence = Sequence([inner])
        dataset.SharedFunctionalGroupsSequence = Sequence([group])

    (radiograph,) = read_radiographs(file(change=move))
    np.testing.assert_array_equal(radiograph.view.pixel_spacing, [0.4, 0.4])

    def differ(dataset: Dataset) -> None:
        move(dataset)
        other, group = Dataset(), Dataset()
        other.ImagerPixelSpacing = ["0.3", "0.3"]
        group.FramePixelDataPropertiesSequence = Sequence([other])
        dataset.PerFrameFunctionalGroupsSequence = Sequence([group])

    with pytest.raises(RadiographError, match="ImagerPixelSpacing differs from frame to frame"):
        read_radiographs(file(change=differ))


def test_secondary_captures_are_read(file):
    (radiograph,) = read_radiographs(file(Modality="OT", SOPClassUID="1.2.840.10008.5.1.4.1.1.7"))
    assert radiograph.pixels.shape == (40, 36)
