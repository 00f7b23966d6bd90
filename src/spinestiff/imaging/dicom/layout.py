"""How pixels are stored, checked before any is decoded: declared sizes against caps and against what is there."""

from __future__ import annotations

from dataclasses import dataclass

from spinestiff.errors import RadiographError
from spinestiff.imaging.dicom.files import MOST_BYTES
from spinestiff.imaging.dicom.streams import StreamHeader, stream_header
from spinestiff.imaging.dicom.tags import Tags, shown

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


def check_modality(modality: str) -> None:
    """Raise RadiographError unless a file's Modality (a coded word) is that of a projection radiograph."""
    if modality not in MODALITIES:
        raise RadiographError(
            f"Modality: found {shown(modality)}, wanted a projection radiograph ({', '.join(MODALITIES)})"
        )


def checked_layout(tags: Tags, most_bytes: int = MOST_BYTES) -> Layout:
    """The layout that a file declares; of pixels in ``most_bytes`` at most.

    Raises
    ------
    RadiographError : colours, sizes outside the caps, bits that contradict each other.
    """
    if tags.photometric not in ("MONOCHROME1", "MONOCHROME2"):
        raise RadiographError(
            f"PhotometricInterpretation: found {shown(tags.photometric)}, wanted MONOCHROME1 or MONOCHROME2; export "
            "the original, no screenshot"
        )
    if tags.samples != 1:
        raise RadiographError(
            f"SamplesPerPixel: found {tags.samples}, wanted 1, since PhotometricInterpretation is {tags.photometric}; "
            "export the original, no screenshot"
        )
    if tags.syntax not in (*NATIVE, RLE, *_CODINGS):
        raise RadiographError(f"TransferSyntaxUID: found {tags.syntax_name}, which is not read; export it uncompressed")
    layout = Layout(tags.frames, tags.rows, tags.columns, tags.allocated, tags.stored, tags.signed)
    size = f"{layout.frames} frames of {layout.rows} x {layout.columns}"
    if min(layout.frames, layout.rows, layout.columns) < 1:
        raise RadiographError(f"NumberOfFrames, Rows, Columns: found {size}, wanted 1 or more; export it again")
    if layout.frames > MOST_FRAMES:
        raise RadiographError(
            f"NumberOfFrames: found {layout.frames}, wanted at most {MOST_FRAMES}; export fewer frames, e.g. a part of "
            "the series"
        )
    if max(layout.rows, layout.columns) > MOST_PIXELS_A_SIDE:
        raise RadiographError(
            f"Rows, Columns: found {layout.rows} x {layout.columns}, wanted at most {MOST_PIXELS_A_SIDE} x "
            f"{MOST_PIXELS_A_SIDE}; crop it"
        )
    if layout.allocated not in (8, 16) or not 0 < layout.stored <= layout.allocated:
        raise RadiographError(
            f"BitsStored, BitsAllocated: found {layout.stored} bits in {layout.allocated}, wanted up to 8 in 8 or up "
            "to 16 in 16; export it again"
        )
    if tags.high_bit != layout.stored - 1:
        raise RadiographError(
            f"HighBit: found {tags.high_bit}, wanted {layout.stored - 1} as BitsStored says; export it again"
        )
    count = layout.frames * layout.frame_bytes
    if count > most_bytes:
        raise RadiographError(
            f"NumberOfFrames, Rows, Columns: found {size}, {count / 2**20:.0f} MB, wanted at most "
            f"{most_bytes // 2**20} MB; crop it"
        )
    return layout


def check_native(layout: Layout, there: int) -> None:
    """Raise RadiographError unless uncompressed pixels fill what is declared, up to one byte of padding."""
    count = layout.frames * layout.frame_bytes
    if there < count:
        raise RadiographError(f"PixelData: found {there} bytes, wanted {count}: cut short; copy the file again")
    if there > count + count % 2:
        raise RadiographError(f"PixelData: found {there} bytes, wanted {count} as declared; export it again")


def checked_frames(layout: Layout, tags: Tags, frames: list[bytes]) -> list[bytes]:
    """Coded frames without filler behind their ends.

    Raises
    ------
    RadiographError : a frame that is not whole, or not of the declared size, depth and coding.
    """
    if len(frames) != layout.frames:
        raise RadiographError(
            f"PixelData: found {len(frames)} coded frames, wanted {layout.frames} as declared; export it again"
        )
    if tags.syntax == RLE:
        return frames  # their size shows only in decoding, which stops at the declared one
    streams = []
    for frame in frames:
        header = stream_header(frame)
        if (header.rows, header.columns) != (layout.rows, layout.columns):
            found, declared = f"{header.rows} x {header.columns}", f"{layout.rows} x {layout.columns}"
            raise RadiographError(f"PixelData: found a coded frame of {found}, wanted {declared}; export it again")
        if header.components != 1:
            raise RadiographError(
                f"PixelData: found a coded frame of {header.components} colours, wanted 1; export the original, no "
                "screenshot"
            )
        _check_coding(layout, tags, header)
        streams.append(frame[: header.length])
    return streams


def _check_coding(layout: Layout, tags: Tags, header: StreamHeader) -> None:
    wanted = _CODINGS[tags.syntax]
    if header.coding != wanted:
        raise RadiographError(
            f"PixelData: found a coded frame of {header.coding}, wanted {tags.syntax_name}; export it again"
        )
    if wanted == "JPEG" and header.precision != 8:
        raise RadiographError(f"PixelData: found JPEG of {header.precision} bits, wanted 8; export it uncompressed")
    if header.precision not in (layout.stored, layout.allocated):
        raise RadiographError(
            f"PixelData: found a coded frame of {header.precision} bits, wanted {layout.stored}; export it again"
        )
