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
from contextlib import AbstractContextManager
from io import BytesIO
from pathlib import Path
from threading import Lock
from typing import TYPE_CHECKING

from spinestiff.errors import RadiographError

if TYPE_CHECKING:
    from pydicom.dataset import Dataset, FileMetaDataset

MOST_BYTES = 512 * 1024**2
"""Of a file that is read whole: of what is stored and of decoded pixels."""
MOST_MAPPED_BYTES = 4 * 1024**3
"""Of pixels in an uncompressed file of which one frame at a time is read, and of all files of a folder together."""
MOST_HEADER_BYTES = 2**20
_DEFLATED = "1.2.840.10008.1.2.1.99"
_PICTURES = ((b"\x89PNG", "PNG"), (b"\xff\xd8\xff", "JPEG"), (b"II*\0", "TIFF"), (b"MM\0*", "TIFF"), (b"GIF8", "GIF"))
_ARCHIVES = ((b"PK\x03\x04", "zip"), (b"\x1f\x8b", "gzip"), (b"7z\xbc\xaf", "7z"), (b"Rar!", "rar"))
"""How the files begin that people have in place of DICOM."""
_DIRECTORY = "1.2.840.10008.1.3.10"
_MODALITY = 0x00080060
_PIXELS = 0x7FE00010
_PIXELS_LITTLE_ENDIAN = b"\xe0\x7f\x10\x00"
_IMPLICIT, _EXPLICIT = "1.2.840.10008.1.2", "1.2.840.10008.1.2.1"


@contextlib.contextmanager
def one_clear_line(name: str) -> Iterator[None]:
    """Turn every failure inside into one RadiographError with the file's name.

    pydicom and the codecs raise all sorts, at any access. Their messages may quote patient data, so nothing of them is
    passed on.
    """
    try:
        with quiet():
            yield
    except RadiographError as problem:
        raise type(problem)(f"{name}: {problem}") from None
    except MemoryError:
        raise RadiographError(f"{name}: not enough memory to read it; close other programs or crop it") from None
    except Exception as problem:
        if isinstance(problem, OSError) and problem.strerror:
            raise RadiographError(f"{name}: can't be read ({problem.strerror})") from None
        raise RadiographError(f"{name}: damaged or unsupported DICOM; export it again, uncompressed") from None


@contextlib.contextmanager
def named(what: str) -> Iterator[None]:
    """Turn what the DICOM library raises inside into one RadiographError that names the part of the file at fault."""
    try:
        yield
    except (RadiographError, MemoryError):
        raise
    except Exception as problem:
        if isinstance(problem, OSError) and problem.strerror:
            raise
        raise RadiographError(
            f"{what}: found bytes that can't be read, wanted valid DICOM; copy the file again, or export it again"
        ) from None


def quiet() -> AbstractContextManager[None]:
    """No warnings or log lines of the DICOM library and its codecs: they quote the file's values, patient data too.

    Filters and loggers are those of all threads, so nobody's warnings are heard until the last that asked has left.
    """
    return _QUIET


class _Quiet(AbstractContextManager[None]):
    """The first that enters silences, the last that leaves restores what was."""

    def __init__(self) -> None:
        self._lock, self._inside, self._restore = Lock(), 0, contextlib.ExitStack()

    def __enter__(self) -> None:
        with self._lock:
            if not self._inside:
                self._restore.enter_context(_silenced())
            self._inside += 1

    def __exit__(self, *_: object) -> None:
        with self._lock:
            self._inside -= 1
            if not self._inside:
                self._restore.close()


_QUIET = _Quiet()


@contextlib.contextmanager
def _silenced() -> Iterator[None]:
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
    """The dataset of a regular file, and the file's SHA-256.

    Raises
    ------
    RadiographError : empty, too large, no DICOM Part 10, damaged, a DICOMDIR.
    """
    from pydicom import dcmread
    from pydicom.errors import InvalidDicomError
    from pydicom.filereader import read_file_meta_info

    size = path.stat().st_size
    # A file of no size may still have no end, as those that a system makes up; it is not opened.
    if not size:
        raise RadiographError("found an empty file, wanted a DICOM file; copy it again")
    if size > MOST_BYTES + MOST_HEADER_BYTES:
        raise RadiographError(
            f"found {size / 2**20:.0f} MB, wanted at most {MOST_BYTES // 2**20} MB unless it is uncompressed DICOM, of "
            f"which {MOST_MAPPED_BYTES // 2**20} MB are read; export it uncompressed, or crop it"
        )
    content = path.read_bytes()
    sha256 = hashlib.sha256(content).hexdigest()
    with named("the file's header"):
        try:
            header = read_file_meta_info(path)
        except InvalidDicomError:
            raise RadiographError(_no_dicom(content)) from None
        kind, syntax = header.get("MediaStorageSOPClassUID"), header.get("TransferSyntaxUID")
    if kind == _DIRECTORY:
        raise RadiographError("found a DICOMDIR, wanted a radiograph; name the radiograph's own file")
    with named("the file's elements"):
        return (_inflated(header, content) if syntax == _DEFLATED else dcmread(BytesIO(content))), sha256


def read_header(path: Path) -> tuple[Dataset, int, int] | None:
    """A regular file without reading its pixels, or None where it has to be read whole: it is not uncompressed, little
    endian DICOM, it is coded otherwise than its header says, or its pixels begin far behind its start and it is small
    enough for that.

    Returns
    -------
    The dataset, in which an empty element stands for the pixels; the byte at which they begin; how many are there. 0
    and 0 where there is no such element.

    Raises
    ------
    RadiographError : damaged, or so large a file with a header longer than any.
    """
    from pydicom.dataelem import DataElement
    from pydicom.errors import InvalidDicomError
    from pydicom.filereader import read_file_meta_info, read_partial

    with named("the file's header"):
        try:
            syntax = str(read_file_meta_info(path).get("TransferSyntaxUID"))
        except InvalidDicomError:
            return None
    if syntax not in (_IMPLICIT, _EXPLICIT):
        return None
    with path.open("rb") as file, named("the file's elements"):
        dataset = read_partial(file, stop_when=lambda tag, vr, length: tag >= _PIXELS)
        at = file.tell()
        if at > MOST_HEADER_BYTES:
            if path.stat().st_size <= MOST_BYTES:
                return None
            raise RadiographError(f"found a header of {at / 2**20:.0f} MB, wanted a radiograph; export it again")
        head = file.read(12)
    told = head[4:8] if syntax == _IMPLICIT else head[8:12]
    if head[:4] != _PIXELS_LITTLE_ENDIAN or len(told) < 4:
        return dataset, 0, 0
    # As a length, which it is where no type stands before it, either would be odd.
    if (head[4:6] in (b"OB", b"OW")) != (syntax == _EXPLICIT):
        return None
    dataset.add(DataElement(_PIXELS, "OW", b""))
    start = at + (8 if syntax == _IMPLICIT else 12)
    return dataset, start, min(int.from_bytes(told, "little"), path.stat().st_size - start)


def read_tags_only(path: Path) -> Dataset:
    """The dataset of a regular file, for tags alone: of one too large to be read whole no pixel is read.

    Raises
    ------
    RadiographError : as ``read_header`` and ``read_dataset``.
    """
    header = read_header(path) if path.stat().st_size > MOST_BYTES else None
    return read_dataset(path)[0] if header is None else header[0]


def declared_modality(path: Path) -> str:
    """Modality as a regular file's first bytes declare it, without reading the rest: a coded word, "" if not told.

    Whatever keeps it from being told is left to ``read_dataset`` to say.
    """
    from pydicom.filereader import read_partial

    with contextlib.suppress(Exception), quiet(), path.open("rb") as file:
        start = BytesIO(file.read(MOST_HEADER_BYTES))
        return str(read_partial(start, stop_when=lambda tag, vr, length: tag > _MODALITY).get("Modality") or "").strip()
    return ""


def _no_dicom(content: bytes) -> str:
    """What a file is that is no DICOM, and what to do."""
    picture = next((kind for beginning, kind in _PICTURES if content.startswith(beginning)), None)
    if picture is not None:
        return (
            f"no DICOM file but a {picture} picture, which has no millimetres; export the radiograph as DICOM Part 10"
        )
    archive = next((kind for beginning, kind in _ARCHIVES if content.startswith(beginning)), None)
    if archive is not None:
        return f"no DICOM file but a {archive} archive; unpack it, and name the folder with what was in it"
    return "no DICOM file (its header is missing); export the radiograph as DICOM Part 10"


def _inflated(header: FileMetaDataset, content: bytes) -> Dataset:
    from pydicom.filereader import read_dataset as parse

    # Preamble, "DICM" and the element that holds the length of the rest of the header.
    start = 128 + 4 + 12 + int(header.FileMetaInformationGroupLength)
    most = MOST_BYTES + MOST_HEADER_BYTES
    machine = zlib.decompressobj(-zlib.MAX_WBITS)
    inflated = machine.decompress(content[start:], most)
    if machine.unconsumed_tail:
        raise RadiographError(f"found deflated DICOM of more than {most // 2**20} MB; export it uncompressed")
    if not machine.eof:
        raise RadiographError("found deflated DICOM that is cut short; copy the file again")
    dataset = parse(BytesIO(inflated), is_implicit_VR=False, is_little_endian=True)
    dataset.set_original_encoding(False, True)
    dataset.file_meta = header
    return dataset
