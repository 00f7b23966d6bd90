"""Canaries: values that give themselves away, in files and their names, and a search for them in what comes out."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pydicom
from pydicom.datadict import DicomDictionary
from pydicom.dataset import Dataset
from pydicom.sequence import Sequence
from pydicom.tag import Tag

from spinestiff.imaging.deidentification.allow_list import KEPT

CANARY = "ZQXJ"
"""Begins all canaries; numbers cannot hold it, so they have one of their own."""
NUMBER, UID, DATE = "735194682", "1.2.735194682", "73519468"
TEXT = {"AE", "AS", "CS", "LO", "LT", "PN", "SH", "ST", "UC", "UR", "UT"}
BYTES = {"OB", "OW", "UN", "OF", "OD", "OL", "OV"}
# What is looked for in everything that is written or printed: in ASCII, in UTF-16 and as a number.
TRACES = (CANARY.encode(), CANARY.encode("utf-16-le"), DATE.encode())


def canary(vr: str, number: int) -> object:
    """A value of a VR that gives itself away; None for binary numbers."""
    if vr in TEXT:
        return f"{CANARY}{number:05d}"
    if vr in BYTES:
        return f"{CANARY}{number:07d}".encode()
    return {"UI": f"{UID}.{number}", "DA": DATE, "TM": NUMBER, "DT": f"{DATE}{NUMBER}", "IS": NUMBER,
            "DS": f"{NUMBER}.{number}"}.get(vr)  # fmt: skip


def fill(dataset: Dataset, rng: np.random.Generator, spared: set[int], most: int = 10) -> int:
    """Put canaries into attributes of every VR."""
    by_vr: dict[str, list[int]] = {}
    for tag, entry in DicomDictionary.items():
        if tag not in spared and tag >> 16 not in (0x0000, 0x0002, 0xFFFE) and tag & 0xFFFF:
            by_vr.setdefault(entry[0][:2], []).append(tag)
    count = 0
    for vr, tags in by_vr.items():
        for tag in rng.choice(tags, min(most, len(tags)), replace=False):
            if (value := canary(vr, count)) is not None:
                dataset.add_new(int(tag), vr, value)
                count += 1
    return count


def infest(path: Path, rng: np.random.Generator, most: int, in_kept: bool = False) -> int:
    """Fill a radiograph with canaries wherever text may stand; gives their number.

    ``most`` attributes of each VR, and with ``in_kept`` also those that a reader needs, which spoils some of them.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # DICOM's library says that these are no dates, ages, addresses
        return _infest(path, rng, most, in_kept)


def _infest(path: Path, rng: np.random.Generator, most: int, in_kept: bool) -> int:
    dataset = pydicom.dcmread(path)
    sizes = {Tag(word) for word in KEPT} | {Tag("PixelData"), Tag("SOPClassUID"), Tag("NumberOfFrames")}
    # Whether a picture holds a document or another table isn't this test's question.
    others = {Tag(word) for word in ("ContentSequence", "EncapsulatedDocument", "FloatPixelData",
                                     "DoubleFloatPixelData", "PixelDataProviderURL")}  # fmt: skip
    count = fill(dataset, rng, sizes | others, most)
    for keyword in ("PatientName", "PatientID", "SOPInstanceUID", "StudyInstanceUID", "SeriesInstanceUID", "StudyDate",
                    "StudyTime", "AcquisitionDateTime", "ContentDate", "ContentTime"):  # fmt: skip
        vr = DicomDictionary[Tag(keyword)][0]
        setattr(dataset, keyword, canary(vr, 99990))
    nested = Dataset()
    for depth in range(3):
        inner = Dataset()
        fill(inner, rng, sizes | others)
        inner.PatientComments = f"{CANARY} {depth}"
        inner.ReferencedImageSequence = Sequence([nested])
        nested = inner
    dataset.IconImageSequence = Sequence([nested])
    if in_kept:
        # Words and numbers in attributes of the allow-list itself: their rules must tell.
        dataset.ImageType = ["ORIGINAL", "PRIMARY", CANARY]
        dataset.ViewPosition, dataset.Laterality, dataset.BurnedInAnnotation = CANARY, CANARY, CANARY
        dataset.PatientOrientation = ["L", CANARY]
        dataset.SeriesNumber, dataset.AcquisitionNumber = NUMBER, NUMBER
        dataset.ModalityLUTSequence = Sequence([nested])
        dataset.PixelData += f"{CANARY}{CANARY}".encode()
    for group in (0x6000, 0x6002, 0x5000):
        dataset.add_new((group, 0x0022), "LO", f"{CANARY} overlay")
        dataset.add_new((group, 0x3000), "OW", f"{CANARY}{CANARY}".encode())
    block = dataset.private_block(0x0009, f"{CANARY} MAKER", create=True)
    for offset, vr in enumerate(("LO", "UN", "PN", "OB", "DS")):
        block.add_new(offset, vr, canary(vr, offset) or "")
    dataset.file_meta.SourceApplicationEntityTitle = f"{CANARY}AE"
    dataset.file_meta.PrivateInformationCreatorUID = UID
    dataset.file_meta.PrivateInformation = f"{CANARY}{CANARY}".encode()
    dataset.preamble = f"{CANARY} preamble".encode().ljust(128, b" ")
    dataset.save_as(path, enforce_file_format=True)
    return count


def traces(*places: object) -> list[str]:
    """Where a canary came out: names and bytes of folders, and texts."""
    found = []
    for place in places:
        texts = [(str(place)[:60], str(place).encode())]
        if isinstance(place, Path):
            files = sorted(place.rglob("*"))
            assert files
            texts = [(file.name, str(file.relative_to(place)).encode()) for file in files]
            texts += [(file.name, file.read_bytes()) for file in files if file.is_file()]
        found += [name for name, content in texts if any(trace in content for trace in TRACES)]
    return found
