"""How pixels are stored, checked before any is decoded: declared sizes against caps and against what is there."""

from __future__ import annotations

from dataclasses import dataclass

from spinestiff.errors import RadiographError
from spinestiff.imaging.dicom.files import MOST_BYTES
from spinestiff.imaging.dicom.streams import StreamHeader, stream_header
from spinestiff.imaging.dicom.tags import Tags
from spinestiff.words import counted

MODALITIES = ("CR", "DX", "RF", "XA", "SC", "OT")
MOST_PIXELS_A_SIDE = 8192
MOST_FRAMES = 128

NATIVE = ("1.2.840.10008.1.2", "1.2.840.10008.1.2.1", "1.2.840.10008.1.2.2", "1.2.840.10008.1.2.1.99")
RLE = "1.2.840.10008.1.2.5"
JPEG_BASELINE = "1.2.840.10008.1.2.4.50"
JPEG_EXTENDED = "1.2.840.10008.1.2.4.51"
JPEG_LOSSLESS = ("1.2.840.10008.1.2.4.57", "1.2.840.10008.1.2.4.70")
JPEG_LS = ("1.2.840.10008.1.2.4.80", "1.2.840.10008.1.2.4.81")
JPEG_2000 = ("1.2.840.10008.1.2.4.90", "1.2.840.10008.1.2.4.91")
# What a coded frame has to be, by transfer syntax.
_CODINGS = {
    JPEG_BASELINE: "JPEG", JPEG_EXTENDED: "JPEG", **dict.fromkeys(JPEG_LOSSLESS, "JPEG Lossless"),
    **dict.fromkeys(JPEG_LS, "JPEG-LS"), **dict.fromkeys(JPEG_2000, "JPEG 2000"),
}  # fmt: skip


@dataclass(frozen=True)
class Layout:
    """How the pixel data are stored, checked."""

    frames: int
    rows: int
    columns: int
    allocated: int
    stored: int
    signed: bool

    @property
    def frame_bytes(self) -> int:
        """Of one frame, not compressed."""
        return self.rows * self.columns * self.allocated // 8


def checked_layout(tags: Tags) -> Layout:
    """The layout that a file declares.

    Raises
    ------
    RadiographError : no projection radiograph, colours, sizes outside the caps, bits that contradict each other.
    """
    if tags.modality not in MODALITIES:
        named = f"modality {tags.modality}" if tags.modality else "no modality"
        raise RadiographError(f"{named} is no projection radiograph; wanted one of {', '.join(MODALITIES)}")
    if tags.samples != 1 or tags.photometric not in ("MONOCHROME1", "MONOCHROME2"):
        raise RadiographError(f"colour picture ({tags.photometric or 'unknown'}); export the original, no screenshot")
    if tags.syntax not in (*NATIVE, RLE, *_CODINGS):
        raise RadiographError(f"pixels coded as {tags.syntax_name} can't be decoded; export it uncompressed")
    layout = Layout(tags.frames, tags.rows, tags.columns, tags.allocated, tags.stored, tags.signed)
    size = f"{layout.frames} frames of {layout.rows} x {layout.columns}"
    if min(layout.frames, layout.rows, layout.columns) < 1:
        raise RadiographError(f"declares {size}; wanted at least one pixel")
    if max(layout.rows, layout.columns) > MOST_PIXELS_A_SIDE or layout.frames > MOST_FRAMES:
        most = f"{MOST_FRAMES} frames of {MOST_PIXELS_A_SIDE} x {MOST_PIXELS_A_SIDE}"
        raise RadiographError(f"declares {size}; at most {most}")
    if layout.allocated not in (8, 16) or not 0 < layout.stored <= layout.allocated:
        raise RadiographError(f"{layout.stored} bits stored in {layout.allocated}; wanted 8 or 16 bits a pixel")
    if tags.high_bit != layout.stored - 1:
        raise RadiographError(f"high bit other than the last of {layout.stored} bits stored; export it again")
    count = layout.frames * layout.frame_bytes
    if count > MOST_BYTES:
        raise RadiographError(f"declares {size}, {count / 2**20:.0f} MB; at most {MOST_BYTES // 2**20} MB are read")
    return layout


def check_native(layout: Layout, there: int) -> None:
    """Raise RadiographError unless uncompressed pixels fill what is declared, up to one byte of padding."""
    count = layout.frames * layout.frame_bytes
    if there < count:
        raise RadiographError(f"pixel data cut short: {there} of {count} bytes; copy the file again")
    if there > count + count % 2:
        raise RadiographError(f"{there} bytes of pixels, but {count} are declared; export it again")


def check_coded(layout: Layout, tags: Tags, frames: list[bytes]) -> None:
    """Raise RadiographError unless each coded frame is whole and of the declared size, depth and coding."""
    if len(frames) != layout.frames:
        raise RadiographError(
            f"{counted(len(frames), 'coded frame')}, but {layout.frames} are declared; export it again"
        )
    if tags.syntax == RLE:
        return  # its size shows only in decoding, which stops at the declared one
    for frame in frames:
        header = stream_header(frame)
        if (header.rows, header.columns) != (layout.rows, layout.columns):
            declared = f"{layout.rows} x {layout.columns} is declared"
            raise RadiographError(f"a coded frame is {header.rows} x {header.columns}, but {declared}")
        if header.components != 1:
            raise RadiographError(f"a coded frame has {header.components} colours; export the original, no screenshot")
        _check_coding(layout, tags, header)


def _check_coding(layout: Layout, tags: Tags, header: StreamHeader) -> None:
    wanted = _CODINGS[tags.syntax]
    if header.coding != wanted:
        raise RadiographError(f"a coded frame is {header.coding}, but {tags.syntax_name} is declared; export it again")
    if wanted == "JPEG" and header.precision != 8:
        raise RadiographError(f"JPEG of {header.precision} bits can't be decoded; export it uncompressed")
    if header.precision not in (layout.stored, layout.allocated):
        raise RadiographError(f"a coded frame has {header.precision} bits a pixel, but {layout.stored} are declared")
