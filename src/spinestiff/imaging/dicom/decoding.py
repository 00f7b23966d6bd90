"""Stored pixel values of every transfer syntax that is read, each by one known decoder."""

from __future__ import annotations

import struct
from collections.abc import Callable
from io import BytesIO
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from spinestiff.errors import RadiographError
from spinestiff.imaging.dicom.files import named
from spinestiff.imaging.dicom.layout import (
    JPEG_2000,
    JPEG_BASELINE,
    JPEG_EXTENDED,
    JPEG_LOSSLESS,
    JPEG_LS,
    NATIVE,
    RLE,
    Layout,
    check_native,
    checked_frames,
)
from spinestiff.imaging.dicom.lossless import decode_lossless
from spinestiff.imaging.dicom.runlength import decode_rle
from spinestiff.imaging.dicom.streams import starts_stream
from spinestiff.imaging.dicom.tags import Tags

if TYPE_CHECKING:
    from pydicom.dataset import Dataset


def decoded(dataset: Dataset, tags: Tags, layout: Layout) -> NDArray[Any]:
    """(F, H, W) stored values, unsigned or signed as declared, without what lies above the stored bits.

    Raises
    ------
    RadiographError : pixels that are not of the declared size, or no decoder for them. Whatever a decoder raises
        passes: callers read inside ``files.one_clear_line``.
    """
    if tags.syntax in NATIVE:
        check_native(layout, len(dataset.PixelData))
        with named("PixelData"):
            pixels = np.asarray(dataset.pixel_array)
    else:
        frames = checked_frames(layout, tags, coded_frames(dataset, layout.frames))
        try:
            pixels = uncoded(tags.syntax, layout, frames)
        except (RadiographError, MemoryError):
            raise
        except Exception:  # codecs have no error of their own
            raise RadiographError(
                f"PixelData: {tags.syntax_name} pixels that can't be decoded; copy it again, or export it uncompressed"
            ) from None
    return whole_bits(pixels, layout)


def whole_bits(pixels: NDArray[Any], layout: Layout) -> NDArray[Any]:
    """Stored values (F, H, W) without what lies above the stored bits. Raises RadiographError for another number."""
    shape = (layout.frames, layout.rows, layout.columns)
    if pixels.size != np.prod(shape):
        raise RadiographError(f"PixelData: found {pixels.size} pixels, wanted {np.prod(shape)}; export it uncompressed")
    # What lies above the stored bits (old overlays) goes; the sign comes back by the same shift.
    unused = pixels.dtype.itemsize * 8 - layout.stored
    pixels = pixels.reshape(shape)
    return (pixels << unused) >> unused if unused else pixels


def coded_frames(dataset: Dataset, count: int) -> list[bytes]:
    """The coded frames of the pixel data, with what is behind their ends.

    Frames of several fragments are told apart by the table of offsets, or else by how streams start. Their ends would
    not do: an encoder may put filler behind them.

    Parameters
    ----------
    count : of the frames that are declared.

    Raises
    ------
    RadiographError : pixel data that are no sequence of fragments.
    """
    from pydicom.encaps import generate_fragments, generate_frames, parse_basic_offsets

    buffer = BytesIO(dataset.PixelData)
    try:
        if parse_basic_offsets(buffer):
            return list(generate_frames(dataset.PixelData, number_of_frames=count))
        fragments = list(generate_fragments(buffer))
    except (ValueError, struct.error):
        raise RadiographError(
            f"PixelData: found coded frames that can't be told apart, wanted {count}; export it again"
        ) from None
    if count == 1:
        return [b"".join(fragments)]
    starts = [i for i, fragment in enumerate(fragments) if starts_stream(fragment)]
    if not starts or starts[0]:
        return fragments
    return [b"".join(fragments[first:end]) for first, end in zip(starts, [*starts[1:], len(fragments)])]


def uncoded(syntax: str, layout: Layout, frames: list[bytes]) -> NDArray[Any]:
    """All bits of coded frames, those above the stored ones too, in the width and sign that are declared.

    Raises
    ------
    RadiographError : GDCM or our own decoder refuses them. Whatever another codec raises passes.
    """
    kind = f"{'i' if layout.signed else 'u'}{layout.allocated // 8}"
    if syntax in JPEG_LOSSLESS:
        return np.frombuffer(decode_lossless(syntax, layout, frames), dtype=f"<{kind}")
    if syntax == RLE:
        found = [decode_rle(frame, layout.rows, layout.columns, layout.allocated // 8) for frame in frames]
    else:
        found = [_DECODERS[syntax](frame) for frame in frames]
    # Codecs differ in width and sign of what they return; the bits are those that are stored.
    bits = [pixels.astype(np.int32) & (2**layout.allocated - 1) for pixels in found]
    return np.stack(bits).astype(f"u{layout.allocated // 8}").view(kind)


def _jpeg(frame: bytes) -> NDArray[Any]:
    from PIL import Image

    # Nothing but JPEG: Pillow would try every format it knows.
    with Image.open(BytesIO(frame), formats=("JPEG",)) as picture:
        return np.asarray(picture)


def _jpeg_ls(frame: bytes) -> NDArray[Any]:
    from jpeg_ls import decode_buffer

    pixels, header = decode_buffer(frame)
    return np.frombuffer(pixels, dtype="u1" if header["bits_per_sample"] <= 8 else "<u2")


def _jpeg_2000(frame: bytes) -> NDArray[Any]:
    from openjpeg.utils import decode

    pixels: NDArray[Any] = decode(frame)
    return pixels


_DECODERS: dict[str, Callable[[bytes], NDArray[Any]]] = {
    JPEG_BASELINE: _jpeg, JPEG_EXTENDED: _jpeg, **dict.fromkeys(JPEG_LS, _jpeg_ls),
    **dict.fromkeys(JPEG_2000, _jpeg_2000),
}  # fmt: skip
