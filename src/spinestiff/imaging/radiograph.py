"""Radiographs from and to DICOM, with millimetres that are never guessed (paper 2.1; docs/radiographs.md).

A radiograph doesn't say where the patient stood, so a view is placed with its principal ray through a given ``centre``
and the image's middle.
"""

from __future__ import annotations

import warnings
from collections import OrderedDict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from spinestiff.arrays import ByFields, read_only
from spinestiff.errors import RadiographError
from spinestiff.files import listed, regular_file
from spinestiff.imaging.dicom.files import MOST_BYTES, MOST_MAPPED_BYTES, declared_modality
from spinestiff.imaging.dicom.greys import DisplayCurve
from spinestiff.imaging.dicom.layout import MODALITIES, MOST_FRAMES
from spinestiff.imaging.dicom.millimetres import AGREEMENT, Geometry, Scale
from spinestiff.imaging.dicom.ordering import dated, ordered, times_told
from spinestiff.imaging.dicom.orientation import lps_from_world, world_from_lps
from spinestiff.imaging.dicom.reading import FramesOnDisk, Scan, read_frames, read_scan
from spinestiff.imaging.dicom.tags import coded_word, shown
from spinestiff.imaging.dicom.writing import write_radiographs
from spinestiff.imaging.projection import XRayView

__all__ = [
    "Geometry",
    "Radiograph",
    "Scale",
    "candidates",
    "check_files",
    "in_order",
    "lps_from_world",
    "open_radiographs",
    "read_radiographs",
    "read_scans",
    "shrunk",
    "times_of",
    "world_from_lps",
    "write_radiographs",
]

SQUARE = 1e-3
"""Share by which the two pitches of a picture may differ and its pixels still count as square."""
KEPT = 4
"""Frames of a large file that stay in memory."""


@dataclass(frozen=True)
class Radiograph(ByFields):
    """One picture with its geometry.

    Attributes
    ----------
    pixels : (H, W) float32, bone bright.
    view : the X-ray view it was taken in.
    source : name of the file.
    sha256 : of the file.
    frame : index in its file or folder, from 0.
    time_s : since the first frame; None if the file doesn't tell.
    provenance : where the millimetres, the directions and the grey values came from.
    display : how the file wants grey values shown; None if it doesn't tell.
    """

    pixels: NDArray[np.float32]
    view: XRayView
    source: str = ""
    sha256: str = ""
    frame: int = 0
    time_s: float | None = None
    provenance: Mapping[str, str] = field(default_factory=dict)
    display: DisplayCurve | None = None

    def __post_init__(self) -> None:
        pixels = read_only("pixels", self.pixels, self.view.shape, RadiographError, np.float32)
        object.__setattr__(self, "pixels", pixels)
        object.__setattr__(self, "provenance", MappingProxyType(dict(self.provenance)))

    def shown(self) -> NDArray[np.float32]:
        """(H, W) from 0 (black) to 1 (white, bone): by the file's own window or table, else by the pixels' spread."""
        if self.display is not None:
            return self.display(self.pixels)
        black, white = np.percentile(self.pixels, (0.5, 99.5))
        shown: NDArray[np.float32] = np.clip((self.pixels - black) / max(white - black, 1e-6), 0.0, 1.0)
        return shown

    def squared(self) -> Radiograph:
        """The same picture with square pixels of the finer pitch: in it turns and distances are as on the detector.

        Millimetres on the detector stay what they are. Itself where its pixels are square.
        """
        import cv2

        side = float(self.view.pixel_spacing.min())
        stretch = self.view.pixel_spacing / side
        if stretch.max() - 1.0 < SQUARE:
            return self
        # The first pixel's centre stays, and with it what millimetres are counted from.
        columns, rows = (np.floor((np.array(self.view.shape[::-1]) - 1.0) * stretch + 1e-6) + 1.0).astype(int)
        back = np.diag(1.0 / stretch)
        pixels = cv2.warpAffine(
            self.pixels, np.hstack([back, np.zeros((2, 1))]), (int(columns), int(rows)),
            flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP, borderMode=cv2.BORDER_REPLICATE,
        )  # fmt: skip
        view = replace(self.view, pixel_spacing=np.array([side, side]), shape=(int(rows), int(columns)))
        return replace(self, pixels=np.asarray(pixels, dtype=np.float32), view=view)


def read_radiographs(
    path: str | Path,
    *,
    geometry: Geometry | None = None,
    centre: ArrayLike = (0.0, 200.0, 0.0),
    within: Path | None = None,
) -> Sequence[Radiograph]:
    """The frames of a DICOM file, or of a folder of single-frame files, in order of time.

    Frames of an uncompressed file of more than 512 MB, and of a folder of as much, are read when they are asked for.

    Parameters
    ----------
    path : file or folder. In a folder the ``.dcm`` files are taken, or all files if there are none.
    geometry : what the files lack.
    centre : (3,) mm, the world point that the principal ray passes in the patient plane.
    within : folder that every file has to lie in, links followed.

    Warns
    -----
    UserWarning : what is odd about the order of a folder's files, or of how a file's picture was taken.

    Raises
    ------
    RadiographError : whatever is wrong with a file, in one line with its name.
    """
    scans, odd = read_scans(Path(path), geometry or Geometry(), within)
    if odd:
        warnings.warn(odd, stacklevel=2)
    _warn_of(scans[0], Path(path).name)
    return _radiographs(scans, centre)


def open_radiographs(
    path: str | Path,
    *,
    geometry: Geometry | None = None,
    centre: ArrayLike = (0.0, 200.0, 0.0),
    within: Path | None = None,
) -> Sequence[Radiograph]:
    """Like ``read_radiographs``, but every frame of an uncompressed file of 16 MB or more is read when it is asked for,
    and its radiographs carry no hash of it.

    Warns
    -----
    UserWarning : as ``read_radiographs``.

    Raises
    ------
    RadiographError : as ``read_radiographs``; of single frames when they are read.
    """
    path = Path(path)
    scan = None if path.is_dir() else read_frames(path, geometry or Geometry(), within)
    if scan is None:
        return read_radiographs(path, geometry=geometry, centre=centre, within=within)
    _warn_of(scan, path.name)
    return _radiographs((scan,), centre)


def _warn_of(scan: Scan, name: str) -> None:
    if scan.doubt:
        warnings.warn(f"{name} {scan.doubt}", stacklevel=3)


class _OneByOne(Sequence[Radiograph]):
    """Radiographs of which each is read when it is asked for; the last few are kept."""

    def __init__(self, scans: Sequence[Scan], centre: ArrayLike) -> None:
        self._where = [(scan, frame) for scan in scans for frame in range(len(scan.pixels))]
        self._times = times_of(tuple(scans))
        self._centre = centre
        self._kept: OrderedDict[int, Radiograph] = OrderedDict()

    def __len__(self) -> int:
        return len(self._where)

    @overload
    def __getitem__(self, index: int) -> Radiograph: ...
    @overload
    def __getitem__(self, index: slice) -> tuple[Radiograph, ...]: ...
    def __getitem__(self, index: int | slice) -> Radiograph | tuple[Radiograph, ...]:
        if isinstance(index, slice):
            return tuple(self[i] for i in range(*index.indices(len(self))))
        index = range(len(self))[index]
        if index not in self._kept:
            found = _radiograph(*self._where[index], self._centre, index, self._times[index])
            self._kept[index] = found
            while len(self._kept) > KEPT:
                self._kept.popitem(last=False)
            return found
        return self._kept[index]


def shrunk(pixels: NDArray[np.float32], wide: int, tall: int) -> NDArray[np.float32]:
    """Pixels (H, W) as means over equal cells, ``wide`` columns and ``tall`` rows at most, in the same proportions."""
    import cv2

    share = min(wide / pixels.shape[1], tall / pixels.shape[0])
    if share >= 1.0:
        return pixels
    size = (max(1, round(pixels.shape[1] * share)), max(1, round(pixels.shape[0] * share)))
    return np.asarray(cv2.resize(pixels, size, interpolation=cv2.INTER_AREA), dtype=np.float32)


def times_of(scans: tuple[Scan, ...]) -> tuple[float | None, ...]:
    """Seconds since the first frame, of the frames of one file or of single-frame files in order."""
    if len(scans) == 1:
        return scans[0].tags.times
    clocks = dated(times_told(*_clocks(scans)))
    if clocks is None or any(clock is None for clock in clocks):
        return (None,) * len(scans)
    return tuple((clock or 0.0) - (clocks[0] or 0.0) for clock in clocks)


def read_scans(path: Path, given: Geometry, within: Path | None = None) -> tuple[tuple[Scan, ...], str]:
    """One file, or the single-frame files of a folder in their order, and what is odd about that, "" if nothing; like
    ``read_radiographs``, but what the user can give may be missing.

    Raises
    ------
    RadiographError : a file that can't be read, files that are no series.
    """
    if not path.is_dir():
        return (read_scan(path, given, within),), ""
    files = candidates(path)
    for file in files:
        regular_file(file, RadiographError, within=within, name=file.name)
    large = check_files(path.name, files) > MOST_BYTES
    scans: list[Scan] = []
    for file in files:
        scan = read_scan(file, given, within, one_by_one=large)
        if len(files) > 1 and scan.layout.frames > 1:
            count = scan.layout.frames
            raise RadiographError(
                f"{file.name}: found {count} frames, wanted 1, as it lies among {len(files)} files; keep it apart"
            )
        scans.append(scan)
        if sum(_in_memory(scan) for scan in scans) > MOST_BYTES:
            raise RadiographError(
                f"{path.name}: found more than {MOST_BYTES // 2**20} MB of pixels in {len(files)} files, wanted less "
                "of files that are compressed; export them uncompressed, or crop them"
            )
    return in_order(path.name, scans)


def in_order(folder: str, scans: list[Scan]) -> tuple[tuple[Scan, ...], str]:
    """Single-frame files as one sequence, and what is odd about its order, "" if nothing.

    Raises
    ------
    RadiographError : they are none, or their order is unknown.
    """
    if len(scans) == 1:
        return tuple(scans), ""
    _check_series(scans)
    order, odd = ordered(folder, [scan.name for scan in scans], *_clocks(scans))
    return tuple(scans[i] for i in order), odd


def _clocks(scans: Sequence[Scan]) -> tuple[list[float | None], list[int | None], list[float | None]]:
    """Times of acquisition, numbers and times of content, as the headers have them."""
    tags = [scan.tags for scan in scans]
    return [one.clock for one in tags], [one.instance for one in tags], [one.content_clock for one in tags]


def candidates(folder: Path) -> list[Path]:
    """What may be the radiographs of a folder, by name: its ``.dcm`` files, or all that is no folder if there are none.

    Hidden files are passed by. Nothing is opened.

    Raises
    ------
    RadiographError : there are none, or the folder can't be listed.
    """
    inside = [path for path in listed(folder, RadiographError, name=folder.name) if not path.name.startswith(".")]
    files = [path for path in inside if not path.is_dir()]
    files = [path for path in files if path.suffix.lower() == ".dcm"] or files
    if not files:
        deeper = f"but in it the folder {inside[0].name}; name the one that holds them" if inside else "wanted some"
        raise RadiographError(f"{folder.name}: found no radiographs in this folder, {deeper}")
    return files


def check_files(folder: str, files: Sequence[Path]) -> int:
    """Bytes of the regular files of a folder together.

    Raises
    ------
    RadiographError : they can be no radiographs, or are more than are read.

    What they are goes before how many they are: a CT series is a CT series, of whatever size.
    """
    told: set[str] = set()
    for file in files[:MOST_FRAMES]:
        told |= {coded_word(declared_modality(file))} - {""}
        if told & set(MODALITIES):
            break
    if told and not told & set(MODALITIES):
        words = ", ".join(shown(word) for word in sorted(told))
        raise RadiographError(
            f"{folder}: Modality: found {words} in {len(files)} files, wanted projection radiographs "
            f"({', '.join(MODALITIES)})"
        )
    if len(files) > MOST_FRAMES:
        raise RadiographError(f"{folder}: found {len(files)} files, wanted at most {MOST_FRAMES}; take fewer")
    size = sum(file.stat().st_size for file in files)
    if size > MOST_MAPPED_BYTES:
        raise RadiographError(
            f"{folder}: found {size / 2**20:.0f} MB in {len(files)} files, wanted at most "
            f"{MOST_MAPPED_BYTES // 2**20} MB; take fewer"
        )
    return size


def _check_series(scans: list[Scan]) -> None:
    """Raise RadiographError for files that can't be frames of one sequence."""
    first = scans[0]
    seen: dict[str, str] = {}
    for scan in scans:
        layout, other = (scan.layout.rows, scan.layout.columns), (first.layout.rows, first.layout.columns)
        if layout != other:
            found, wanted = ("{} x {}".format(*size) for size in (layout, other))
            raise RadiographError(f"{scan.name}: found {found}, wanted {wanted} like {first.name}; keep them apart")
        if not scan.whose.may_be_of(first.whose):
            raise RadiographError(f"{scan.name}: found another patient than in {first.name}; keep them apart")
        if scan.directions is not None and first.directions is not None:
            mine, its = np.array(scan.directions.axes), np.array(first.directions.axes)
            if (mine != its).any():
                what = "orientation" if (mine[:2] != its[:2]).any() else "direction of the beam"
                raise RadiographError(f"{scan.name}: found another {what} than that of {first.name}; keep them apart")
        if not _same_geometry(scan, first):
            raise RadiographError(
                f"{scan.name}: found another X-ray geometry than that of {first.name}; keep them apart"
            )
        if scan.tags.identity and scan.tags.identity in seen:
            raise RadiographError(
                f"{scan.name}: found the same image as {seen[scan.tags.identity]}; remove one of them"
            )
        seen[scan.tags.identity] = scan.name


def _same_geometry(one: Scan, other: Scan) -> bool:
    numbers = [
        None if scan.distances is None or scan.spacing is None
        else (scan.distances.detector, scan.distances.patient, scan.spacing.row, scan.spacing.column)
        for scan in (one, other)
    ]  # fmt: skip
    if numbers[0] is None or numbers[1] is None:
        return True
    return all(abs(a - b) <= AGREEMENT * b for a, b in zip(numbers[0], numbers[1]))


def _in_memory(scan: Scan) -> int:
    """Bytes of pixels, as uncompressed in the file, of what is in memory."""
    return 0 if isinstance(scan.pixels, FramesOnDisk) else scan.layout.frames * scan.layout.frame_bytes


def _radiographs(scans: tuple[Scan, ...], centre: ArrayLike) -> Sequence[Radiograph]:
    """The frames of one file, or of single-frame files in order; in memory where their pixels are."""
    found = _OneByOne(scans, centre)
    return found if any(isinstance(scan.pixels, FramesOnDisk) for scan in scans) else tuple(found)


def _radiograph(scan: Scan, frame: int, centre: ArrayLike, number: int, time_s: float | None) -> Radiograph:
    try:
        return Radiograph(
            scan.pixels[frame], scan.view(centre), scan.name, scan.sha256, number, time_s, scan.provenance, scan.display
        )
    except RadiographError as problem:
        if str(problem).startswith(f"{scan.name}: "):
            raise
        raise RadiographError(f"{scan.name}: {problem}") from None
