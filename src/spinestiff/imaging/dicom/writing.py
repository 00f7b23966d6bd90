"""Radiographs written as DICOM: uncompressed, without a patient, the same bytes from the same call."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from spinestiff.errors import RadiographError
from spinestiff.files import write_bytes
from spinestiff.imaging.dicom.orientation import BEAMS, letter
from spinestiff.imaging.projection import XRayView

if TYPE_CHECKING:
    from pydicom.dataset import Dataset

_RF_STORAGE = "1.2.840.10008.5.1.4.1.1.12.2"
_DX_STORAGE = "1.2.840.10008.5.1.4.1.1.1.1"


def write_radiographs(
    path: str | Path,
    pixels: ArrayLike,
    view: XRayView,
    *,
    frame_time_ms: float | Sequence[float] = 100.0,
    orientation: tuple[str, str] | None = None,
    patient_id: str = "synthetic",
    description: str = "",
    instance_number: int = 1,
    acquisition_time: str | None = None,
    kvp: float = 71.0,
) -> None:
    """Write uncompressed 16-bit DICOM: X-Ray Radiofluoroscopic for a series, Digital X-Ray for one frame.

    Parameters
    ----------
    pixels : (F, H, W) or (H, W) uint16, bone bright.
    view : its principal point must be the image's middle, as reading assumes.
    frame_time_ms : between frames, or the F increments (the first is 0).
    orientation : PatientOrientation, e.g. ("L", "F"); from the view if None.
    acquisition_time : "HHMMSS.ffffff".

    Unique identifiers are made from ``patient_id``, ``description``, ``instance_number`` and the pixels, so the same
    call writes the same bytes.

    Raises
    ------
    RadiographError : pixels that don't fit the view; a file that can't be written.
    """
    frames = np.asarray(pixels)
    frames = frames[None] if frames.ndim == 2 else frames
    if frames.dtype != np.uint16 or frames.shape[1:] != view.shape or not len(frames):
        wanted = f"(F, {view.shape[0]}, {view.shape[1]}) uint16"
        raise RadiographError(f"pixels are {frames.shape} {frames.dtype}, wanted {wanted}")
    middle = 0.5 * (np.array(view.shape[::-1]) - 1.0) * view.pixel_spacing
    if np.abs(view.principal_point - middle).max() > 0.5 * view.pixel_spacing.max():
        raise RadiographError("the view's principal point is off the image's middle; DICOM has no place for it")
    letters = orientation or (letter(view.detector_axes[0]), letter(view.detector_axes[1]))
    dataset = _new_dataset(frames, view, patient_id, description, instance_number)
    dataset.PatientOrientation = list(letters)
    beam = letter(view.normal)
    dataset.ViewPosition = {towards: name for name, towards in BEAMS.items()}.get(beam, "")
    dataset.KVP = f"{kvp:g}"
    if acquisition_time is not None:
        dataset.AcquisitionTime = acquisition_time
    if len(frames) > 1:
        _write_times(dataset, frame_time_ms, len(frames))
    stream = BytesIO()
    dataset.save_as(stream, enforce_file_format=True)
    write_bytes(Path(path), stream.getvalue(), RadiographError)


def _new_dataset(
    frames: NDArray[np.uint16], view: XRayView, patient_id: str, description: str, instance_number: int
) -> Dataset:
    from pydicom.dataset import Dataset, FileMetaDataset
    from pydicom.uid import UID, ExplicitVRLittleEndian, generate_uid

    content = np.ascontiguousarray(frames, dtype="<u2").tobytes()
    series = [patient_id, description]
    picture = [*series, str(instance_number), hashlib.sha256(content).hexdigest()]
    several = len(frames) > 1
    dataset = Dataset()
    dataset.file_meta = FileMetaDataset()
    dataset.file_meta.TransferSyntaxUID = ExplicitVRLittleEndian
    dataset.SOPClassUID = UID(_RF_STORAGE if several else _DX_STORAGE)
    dataset.SOPInstanceUID = generate_uid(entropy_srcs=[*picture, "instance"])
    dataset.StudyInstanceUID = generate_uid(entropy_srcs=[patient_id, "study"])
    dataset.SeriesInstanceUID = generate_uid(entropy_srcs=[*series, "series"])
    dataset.file_meta.MediaStorageSOPClassUID = dataset.SOPClassUID
    dataset.file_meta.MediaStorageSOPInstanceUID = dataset.SOPInstanceUID
    dataset.Modality = "RF" if several else "DX"
    dataset.ImageType = ["DERIVED", "PRIMARY", "SINGLE PLANE"] if several else ["DERIVED", "PRIMARY"]
    dataset.PatientID, dataset.PatientName = patient_id, patient_id
    for empty in ("PatientBirthDate", "PatientSex", "StudyDate", "StudyTime", "StudyID", "AccessionNumber",
                  "ReferringPhysicianName"):  # fmt: skip
        setattr(dataset, empty, "")
    dataset.Manufacturer = "spinestiff"
    dataset.PatientIdentityRemoved, dataset.BurnedInAnnotation = "YES", "NO"
    dataset.SeriesDescription = description[:64]
    dataset.SeriesNumber, dataset.InstanceNumber = 1, instance_number
    dataset.SamplesPerPixel, dataset.PhotometricInterpretation = 1, "MONOCHROME2"
    dataset.Rows, dataset.Columns = view.shape
    dataset.BitsAllocated, dataset.BitsStored, dataset.HighBit, dataset.PixelRepresentation = 16, 16, 15, 0
    dataset.PixelIntensityRelationship, dataset.PixelIntensityRelationshipSign = "LOG", -1
    low, high = np.percentile(frames[0][::4, ::4], [2.0, 99.5])
    dataset.WindowCenter, dataset.WindowWidth = f"{0.5 * (low + high):.0f}", f"{max(high - low, 1.0):.0f}"
    dataset.ImagerPixelSpacing = [f"{mm:.10g}" for mm in view.pixel_spacing[::-1]]
    dataset.DistanceSourceToDetector = f"{view.source_to_detector:.10g}"
    dataset.DistanceSourceToPatient = f"{view.source_to_patient:.10g}"
    if several:
        dataset.NumberOfFrames = len(frames)
        dataset.RadiationSetting = "SC"
    else:
        dataset.PresentationIntentType = "FOR PRESENTATION"
        dataset.RescaleSlope, dataset.RescaleIntercept, dataset.RescaleType = "1", "0", "US"
    dataset.PixelData = content
    dataset["PixelData"].VR = "OW"
    return dataset


def _write_times(dataset: Dataset, frame_time_ms: float | Sequence[float], frames: int) -> None:
    from pydicom.tag import Tag

    steps = np.asarray(frame_time_ms, dtype=float)
    if not np.isfinite(steps).all() or (steps < 0.0).any() or steps.shape not in ((), (frames,)):
        raise RadiographError(f"frame times {steps.shape}; wanted one number or {frames}, in ms and not negative")
    if steps.ndim == 0:
        dataset.FrameTime = f"{float(steps):.10g}"
        dataset.FrameIncrementPointer = Tag("FrameTime")
    else:
        dataset.FrameTimeVector = [f"{step:.10g}" for step in steps]
        dataset.FrameIncrementPointer = Tag("FrameTimeVector")
