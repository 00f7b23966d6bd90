"""DICOM files as datasets, within limits: Part 10 header, size on disk, size when inflated.

No path that stands in a file is ever followed: neither DICOMDIR nor referenced files are opened.
"""

from __future__ import annotations

import contextlib
import hashlib
import logging
import warnings
import zlib
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING

from spinestiff.errors import RadiographError

if TYPE_CHECKING:
    from pydicom.dataset import Dataset, FileMetaDataset

MOST_BYTES = 512 * 1024**2
"""Of decoded pixels in a file, and of all files of a folder together."""
MOST_HEADER_BYTES = 2**20
_DEFLATED = "1.2.840.10008.1.2.1.99"
_DIRECTORY = "1.2.840.10008.1.3.10"


@contextlib.contextmanager
def one_clear_line(name: str) -> Iterator[None]:
    """Turn every failure inside into one RadiographError with the file's name.

    pydicom and the codecs raise all sorts, at any access. Their messages may quote patient data, so only the kind of
    problem is passed on.
    """
    try:
        with quiet():
            yield
    except RadiographError as problem:
        raise type(problem)(f"{name}: {problem}") from None
    except FileNotFoundError:
        raise RadiographError(f"{name}: no such file") from None
    except OSError as problem:
        reason = problem.strerror or type(problem).__name__
        raise RadiographError(f"{name}: can't be opened or decoded ({reason})") from None
    except MemoryError:
        raise RadiographError(f"{name}: not enough memory to read it; close other programs or crop it") from None
    except Exception as problem:
        kind = type(problem).__name__
        raise RadiographError(f"{name}: damaged or unsupported DICOM ({kind}); export it again, uncompressed") from None


@contextlib.contextmanager
def quiet() -> Iterator[None]:
    """No warnings or log lines of the DICOM library and its codecs: they quote the file's values, patient data too."""
    loggers = [logging.getLogger(name) for name in ("pydicom", "PIL", "pylibjpeg")]
    were = [logger.disabled for logger in loggers]
    for logger in loggers:
        logger.disabled = True
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        for logger, was in zip(loggers, were):
            logger.disabled = was


def read_dataset(path: Path) -> tuple[Dataset, str]:
    """The dataset of a file, and the file's SHA-256.

    Raises
    ------
    RadiographError : empty, too large, no DICOM Part 10, a DICOMDIR. Whatever pydicom raises passes: callers read
        inside ``one_clear_line``.
    """
    from pydicom import dcmread
    from pydicom.errors import InvalidDicomError
    from pydicom.filereader import read_file_meta_info

    size = path.stat().st_size
    if size > MOST_BYTES + MOST_HEADER_BYTES:
        raise RadiographError(f"{size / 2**20:.0f} MB; at most {MOST_BYTES // 2**20} MB are read")
    if not path.is_file():
        raise RadiographError("no file; wanted a DICOM file or a folder of them")
    content = path.read_bytes()
    sha256 = hashlib.sha256(content).hexdigest()
    if not content:
        raise RadiographError("the file is empty")
    try:
        header = read_file_meta_info(path)
    except InvalidDicomError:
        raise RadiographError("no DICOM file (its header is missing); export the radiograph as DICOM Part 10") from None
    if header.get("MediaStorageSOPClassUID") == _DIRECTORY:
        raise RadiographError("a DICOMDIR, no radiograph; name the radiograph's own file")
    if header.get("TransferSyntaxUID") == _DEFLATED:
        return _inflated(header, content), sha256
    return dcmread(BytesIO(content)), sha256


def _inflated(header: FileMetaDataset, content: bytes) -> Dataset:
    from pydicom.filereader import read_dataset as parse

    # Preamble, "DICM" and the element that holds the length of the rest of the header.
    start = 128 + 4 + 12 + int(header.FileMetaInformationGroupLength)
    most = MOST_BYTES + MOST_HEADER_BYTES
    machine = zlib.decompressobj(-zlib.MAX_WBITS)
    inflated = machine.decompress(content[start:], most)
    if machine.unconsumed_tail:
        raise RadiographError(f"deflated DICOM of more than {most // 2**20} MB; export it uncompressed")
    if not machine.eof:
        raise RadiographError("deflated DICOM cut short; copy the file again")
    dataset = parse(BytesIO(inflated), is_implicit_VR=False, is_little_endian=True)
    dataset.set_original_encoding(False, True)
    dataset.file_meta = header
    return dataset
