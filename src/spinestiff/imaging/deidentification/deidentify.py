"""DICOM radiographs without the patient: a new file of about forty attributes, each with a rule its value must keep.

Nothing is deleted from a file; a new one is built from an allow-list (``allow_list.KEPT``), so that what nobody thought
of is not in it: private attributes, overlays, thumbnails, free text. The method follows the Basic Application Level
Confidentiality Profile of PS3.15 Annex E with the option to retain modified dates; cleaning pixel data is not claimed
(``burned_in`` shows them to a person).
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from io import BytesIO
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from spinestiff import __version__
from spinestiff.errors import RadiographError
from spinestiff.imaging.deidentification.allow_list import CLASSES, ENHANCED, KEPT, VIEW_CODES, listed, one_of, ruled
from spinestiff.imaging.deidentification.codestreams import without_comments
from spinestiff.imaging.deidentification.pseudonyms import Key, moment
from spinestiff.imaging.dicom.decoding import coded_frames, uncoded
from spinestiff.imaging.dicom.files import MOST_BYTES, quiet
from spinestiff.imaging.dicom.layout import MODALITIES, Layout
from spinestiff.imaging.dicom.tags import BIG_ENDIAN, little_endian
from spinestiff.words import counted

if TYPE_CHECKING:
    from pydicom.dataset import Dataset

NO_DICOM = "no DICOM file (its header is missing)"
_PLAIN = ("1.2.840.10008.1.2", "1.2.840.10008.1.2.1", BIG_ENDIAN)
_RLE = "1.2.840.10008.1.2.5"
# JPEG baseline, extended, lossless; JPEG-LS; JPEG 2000.
_CODED = tuple(f"1.2.840.10008.1.2.4.{number}" for number in (50, 51, 57, 70, 80, 81, 90, 91))
_SIZES = ("SamplesPerPixel", "PhotometricInterpretation", "NumberOfFrames", "Rows", "Columns", "BitsAllocated",
          "BitsStored", "HighBit", "PixelRepresentation")  # fmt: skip
_EMPTY = ("PatientBirthDate", "PatientSex", "StudyID", "AccessionNumber", "ReferringPhysicianName", "Manufacturer")
_MOMENTS = ("Study", "Series", "Acquisition", "Content")


@dataclass(frozen=True)
class Deidentified:
    """A radiograph without its patient.

    Attributes
    ----------
    content : a whole DICOM file.
    patient : the pseudonym that is in it.
    frames : (F, H, W) stored values, for a person to look for burned-in text.
    left_out : attributes of the allow-list whose values kept no rule.
    burned_in : BurnedInAnnotation of the file: "YES", "NO" or "" where it doesn't say.
    """

    content: bytes
    patient: str
    frames: NDArray[Any]
    left_out: tuple[str, ...]
    burned_in: str


def deidentify(content: bytes, key: Key, *, burned_in_ok: bool = False) -> Deidentified:
    """A new DICOM file with the picture, its geometry and its relative times, and nothing of the patient.

    Parameters
    ----------
    content : the bytes of a DICOM Part 10 file.
    key : makes patient, UIDs and the shift of dates.
    burned_in_ok : take a file that says of itself that text is burned into its pixels, since a person has looked.

    Raises
    ------
    RadiographError : no radiograph, a damaged one, or one that can't be freed of its patient; never quotes the file.
    """
    from pydicom import dcmread

    if content[128:132] != b"DICM":
        raise RadiographError(NO_DICOM)
    # pydicom raises all sorts, at any access, and its messages may quote the file.
    try:
        with quiet():
            return _deidentified(dcmread(BytesIO(content)), key, burned_in_ok)
    except RadiographError:
        raise
    except Exception as problem:
        kind = type(problem).__name__
        raise RadiographError(f"damaged or unsupported DICOM ({kind}); export it again, uncompressed") from None


def _deidentified(old: Dataset, key: Key, burned_in_ok: bool) -> Deidentified:
    from pydicom.dataset import Dataset
    from pydicom.uid import UID

    _check_kind(old)
    new, left_out = Dataset(), []
    for keyword, rule in KEPT.items():
        value = _value(old, keyword)
        if value is None:
            continue
        kept = ruled(rule, value)
        if kept is None:
            left_out.append(keyword)
        else:
            setattr(new, keyword, kept)
    _check_size(new, left_out)
    burned_in = new.get("BurnedInAnnotation", "")
    if burned_in == "YES" and not burned_in_ok:
        raise RadiographError(
            "says that text is burned into its pixels; look at it, and use --burned-in-ok if that text names nobody"
        )
    for keyword, more in (("ModalityLUTSequence", "ModalityLUTType"), ("VOILUTSequence", None)):
        if old.get(keyword):
            _add_tables(new, keyword, old, more, left_out)
    _add_view(new, old, left_out)
    identity = _identity(old)
    frames = _add_pixels(new, old)
    new.SOPClassUID = UID(str(old.SOPClassUID))
    for keyword in ("SOPInstanceUID", "SeriesInstanceUID", "StudyInstanceUID"):
        if not old.get(keyword):
            raise RadiographError(f"{keyword} is missing")
        setattr(new, keyword, UID(key.uid(str(old[keyword].value).strip())))
    _add_times(new, old, key, identity, left_out)
    _add_method(new, key.patient(identity))
    new.file_meta.MediaStorageSOPClassUID = new.SOPClassUID
    new.file_meta.MediaStorageSOPInstanceUID = new.SOPInstanceUID
    written = BytesIO()
    new.save_as(written, enforce_file_format=True)
    return Deidentified(written.getvalue(), str(new.PatientID), frames, tuple(left_out), burned_in)


def _check_kind(old: Dataset) -> None:
    """Only kinds of files that are pictures, so that reports, documents and mixtures never pass."""
    if str(old.get("SOPClassUID", "")) not in CLASSES:
        if str(old.get("SOPClassUID", "")) in ENHANCED:
            raise RadiographError("an enhanced file; export it as the plain kind, XA or RF")
        raise RadiographError("no radiograph; wanted CR, DX, RF, XA or grey secondary capture")
    if str(old.file_meta.TransferSyntaxUID) not in (*_PLAIN, *_CODED, _RLE):
        raise RadiographError("its transfer syntax isn't supported; export it uncompressed")
    if "EncapsulatedDocument" in old or "ContentSequence" in old:
        raise RadiographError("holds a document beside the picture; export the radiograph alone")
    if ruled(one_of(*MODALITIES), old.get("Modality", "")) is None:
        raise RadiographError(f"no modality of a radiograph; wanted one of {', '.join(MODALITIES)}")


def _value(old: Dataset, keyword: str) -> Any:
    """None for what is absent or empty."""
    try:
        value = old.get(keyword)
    except Exception:  # a value that its VR doesn't allow; the rule refuses it
        return object()
    empty = value is None or (isinstance(value, str) and not value.strip()) or value == []
    return None if empty else value


def _check_size(new: Dataset, left_out: list[str]) -> None:
    """Before any decoding: a size within the caps."""
    wrong = [keyword for keyword in _SIZES if keyword in left_out]
    if wrong:
        raise RadiographError(f"{wrong[0]} isn't what a grey radiograph of usual size has; export the original")
    for keyword in ("PhotometricInterpretation", "Rows", "Columns", "BitsAllocated", "BitsStored"):
        if keyword not in new:
            raise RadiographError(f"{keyword} is missing")
    if new.BitsStored > new.BitsAllocated or new.get("HighBit", new.BitsStored - 1) != new.BitsStored - 1:
        raise RadiographError("the bits of its pixels contradict each other; export it again")
    if _pixel_bytes(new) > MOST_BYTES:
        raise RadiographError(f"declares {_pixel_bytes(new) / 2**20:.0f} MB of pixels; at most {MOST_BYTES // 2**20}")


def _pixel_bytes(new: Dataset) -> int:
    return int(new.get("NumberOfFrames", 1)) * int(new.Rows) * int(new.Columns) * int(new.BitsAllocated) // 8


def _identity(old: Dataset) -> str:
    """What tells one patient from another: ID, else name, else the study."""
    for keyword in ("PatientID", "PatientName", "StudyInstanceUID"):
        if identity := str(old.get(keyword) or "").strip():
            return f"{keyword} {identity}"
    raise RadiographError("no patient and no study in it; export it again")


def _add_pixels(new: Dataset, old: Dataset) -> NDArray[Any]:
    """Pixel data with nothing beside the picture; gives its stored values (F, H, W)."""
    from pydicom.dataset import FileMetaDataset
    from pydicom.encaps import encapsulate
    from pydicom.uid import UID, ExplicitVRLittleEndian

    syntax = UID(str(old.file_meta.TransferSyntaxUID))
    count = int(new.get("NumberOfFrames", 1))
    shape = (count, int(new.Rows), int(new.Columns))
    if "PixelData" not in old:
        raise RadiographError("no picture in it (PixelData is missing); is the file complete?")
    new.file_meta = FileMetaDataset()
    new.file_meta.TransferSyntaxUID = syntax
    new.add_new("PixelData", old["PixelData"].VR, old.PixelData)
    # Decoded from what the new file holds: nothing else in the old one can disturb it, and what is passed on is seen to
    # work.
    if syntax in _PLAIN:
        if len(old.PixelData) < _pixel_bytes(new):
            raise RadiographError("pixel data cut short; copy the file again")
        frames = _native(new)
    else:
        coded = coded_frames(old, count)
        if len(coded) != count:
            raise RadiographError(
                f"{counted(len(coded), 'coded frame')}, but {count} are declared; copy the file again"
            )
        if syntax in _CODED:
            streams = [without_comments(frame) for frame in coded]
            if any((stream.rows, stream.columns, stream.components) != (*shape[1:], 1) for stream in streams):
                raise RadiographError("a coded frame has another size than the file declares; export it uncompressed")
            coded = [stream.content for stream in streams]
            new.PixelData = encapsulate(coded)
        frames = _decoded(new, coded)
    frames = frames.reshape(shape)
    clean = _stored_bits(frames, int(new.BitsStored), bool(new.get("PixelRepresentation", 0)))
    if syntax in _CODED:
        # Of signed values some decoders leave the bits above clear, as they are in the stream; others extend the sign.
        above = frames.view(f"u{frames.dtype.itemsize}") >> int(new.BitsStored)
        if above.any() and (clean != frames).any():
            raise RadiographError("bits above those stored are in use, as old overlays did; export it uncompressed")
        new["PixelData"].VR = "OB"
        new["PixelData"].is_undefined_length = True
    else:
        # RLE goes uncompressed too: the same pixels, and no room for anything between its segments.
        new.file_meta.TransferSyntaxUID = ExplicitVRLittleEndian
        content = clean.astype(clean.dtype.newbyteorder("<")).tobytes()
        new.PixelData = content + b"\0" * (len(content) % 2)
        new["PixelData"].VR = "OW" if new.BitsAllocated == 16 else "OB"
    return clean


def _native(new: Dataset) -> NDArray[Any]:
    """All bits that are there, those above the stored ones too."""
    new.pixel_array_options(correct_unused_bits=False)
    pixels = np.asarray(new.pixel_array)
    return pixels.astype(pixels.dtype.newbyteorder("="))


def _decoded(new: Dataset, coded: list[bytes]) -> NDArray[Any]:
    """The same of coded frames, by the decoders that read radiographs."""
    allocated, signed = int(new.BitsAllocated), bool(new.get("PixelRepresentation", 0))
    # All of them as stored: GDCM would clear what lies above.
    layout = Layout(len(coded), int(new.Rows), int(new.Columns), allocated, allocated, signed)
    try:
        return uncoded(new.file_meta.TransferSyntaxUID, layout, coded)
    except (RadiographError, MemoryError):
        raise
    except Exception:  # codecs have no error of their own
        raise RadiographError(
            "its pixels can't be decoded, so nobody could look for burned-in text; export it uncompressed"
        ) from None


def _stored_bits(frames: NDArray[Any], stored: int, signed: bool) -> NDArray[Any]:
    """The values without the bits above those stored, where old files keep overlays."""
    kind = np.dtype(f"{'i' if signed else 'u'}{frames.dtype.itemsize}")
    unused = 8 * kind.itemsize - stored
    return (frames.view(kind) << unused) >> unused


def _add_tables(new: Dataset, keyword: str, old: Dataset, more: str | None, left_out: list[str]) -> None:
    from pydicom.dataset import Dataset
    from pydicom.sequence import Sequence

    tables = []
    for item in old[keyword].value[:4]:
        found = ruled(lambda item: _table(item, str(old.file_meta.TransferSyntaxUID)), item)
        if found is None:
            left_out.append(keyword)
            return
        table = Dataset()
        table.add_new("LUTDescriptor", "SS" if found[0][1] < 0 else "US", list(found[0]))
        table.add_new("LUTData", "OW", found[1])
        if more:
            setattr(table, more, ruled(one_of("US", "OD", "HU"), item.get(more, "")) or "US")
        tables.append(table)
    setattr(new, keyword, Sequence(tables))


def _add_view(new: Dataset, old: Dataset, left_out: list[str]) -> None:
    """The coded view, with the meaning that its code has and not what the file says."""
    from pydicom.sequence import Sequence

    if not old.get("ViewCodeSequence"):
        return
    value = ruled(lambda sequence: str(sequence[0].CodeValue).strip(), old.ViewCodeSequence)
    if value in VIEW_CODES:
        new.ViewCodeSequence = Sequence([_code(value, *VIEW_CODES[value])])
    else:
        left_out.append("ViewCodeSequence")


def _code(value: str, scheme: str, meaning: str) -> Dataset:
    from pydicom.dataset import Dataset

    code = Dataset()
    code.CodeValue, code.CodingSchemeDesignator, code.CodeMeaning = value, scheme, meaning
    return code


def _table(item: Dataset, syntax: str) -> tuple[tuple[int, int, int], bytes] | None:
    """Descriptor and data of a look-up table: as many entries as it declares, in words."""
    entries, first, bits = (int(value) for value in item.LUTDescriptor)
    data, number = item.LUTData, (entries % 65536) or 65536
    if isinstance(data, bytes):
        data = little_endian(data, syntax)
        words = np.frombuffer(data, "<u2" if len(data) >= 2 * number else "u1")
    else:
        words = np.asarray(listed(data))
    if len(words) < number or not 8 <= bits <= 16 or (words[:number].astype(int) >> bits).any():
        return None
    return (entries % 65536, first, bits), words[:number].astype("<u2").tobytes()


def _add_times(new: Dataset, old: Dataset, key: Key, identity: str, left_out: list[str]) -> None:
    """All dates and times of a patient moved by the same span, so that what lies between them stays."""
    shift = key.shift(identity)
    new.StudyDate, new.StudyTime = "", ""
    for name in _MOMENTS:
        date, time = (str(_value(old, f"{name}{part}") or "") for part in ("Date", "Time"))
        both = str(_value(old, "AcquisitionDateTime") or "") if name == "Acquisition" else ""
        both = re.sub(r"[+-]\d{4}$", "", both.strip())
        if len(both) > 8 or not (date or time):
            date, time = both[:8], both[8:]
        date = date or both[:8]
        if not date and not time:
            continue
        # A time without a date of its own is one of the study's day.
        found = moment(date or str(_value(old, "StudyDate") or ""), time)
        try:
            moved = found - shift if found is not None else None
        except OverflowError:
            moved = None
        if moved is None:
            left_out.append(f"{name}Date")
            continue
        setattr(new, f"{name}Date", f"{moved:%Y%m%d}")
        if time:
            setattr(new, f"{name}Time", f"{moved:%H%M%S.%f}")
    new.LongitudinalTemporalInformationModified = "MODIFIED"


def _add_method(new: Dataset, patient: str) -> None:
    from pydicom.sequence import Sequence

    new.PatientName, new.PatientID = patient, patient
    for keyword in _EMPTY:
        setattr(new, keyword, "")
    new.PatientIdentityRemoved = "YES"
    new.DeidentificationMethod = [
        f"spinestiff {__version__}: allow-list of attributes",
        "patient and UIDs by keyed hash, dates and times shifted",
        "pixels unchanged; burned-in text is for a person to look for",
    ]
    # PS3.16, context group 7050.
    new.DeidentificationMethodCodeSequence = Sequence([
        _code("113100", "DCM", "Basic Application Confidentiality Profile"),
        _code("113107", "DCM", "Retain Longitudinal Temporal Information Modified Dates Option"),
    ])  # fmt: skip
