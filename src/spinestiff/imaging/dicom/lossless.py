"""JPEG Lossless by GDCM (extra ``[dicom]``) in a child process with limits, since GDCM has had flaws of memory safety.

Run as a module this is the child: it reads a request from its input, decodes it, and writes the pixels.
"""

from __future__ import annotations

import importlib.util
import json
import os
import subprocess
import sys
from typing import TYPE_CHECKING

from spinestiff.errors import RadiographError

if TYPE_CHECKING:
    from spinestiff.imaging.dicom.layout import Layout

MOST_SECONDS = 120
MOST_CHILD_BYTES = 6 * 1024**3
"""Of the child's address space: the largest pictures thrice, and the interpreter."""


def decode_lossless(syntax: str, layout: Layout, frames: list[bytes]) -> bytes:
    """The pixels of JPEG Lossless frames, little-endian, as allocated.

    Raises
    ------
    RadiographError : GDCM is not installed, took too long, or failed.
    """
    if importlib.util.find_spec("gdcm") is None:
        raise RadiographError(
            "PixelData: JPEG Lossless needs GDCM, which is not installed; pip install "
            "'spinestiff[dicom]', or export it uncompressed"
        )
    request = {
        "syntax": syntax,
        "lengths": [len(frame) for frame in frames],
        "options": {
            "rows": layout.rows,
            "columns": layout.columns,
            "number_of_frames": layout.frames,
            "bits_allocated": layout.allocated,
            "bits_stored": layout.stored,
            "pixel_representation": int(layout.signed),
            "samples_per_pixel": 1,
            "photometric_interpretation": "MONOCHROME2",
            "pixel_keyword": "PixelData",
        },
    }
    try:
        done = subprocess.run(
            # -P: nothing is imported from the folder the user happens to be in.
            [sys.executable, "-P", "-m", __name__],
            input=json.dumps(request).encode() + b"\n" + b"".join(frames),
            capture_output=True,
            timeout=MOST_SECONDS,
            check=False,
            env={**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"},
        )
    except subprocess.TimeoutExpired:
        raise RadiographError(
            f"PixelData: JPEG Lossless took more than {MOST_SECONDS} s; export it uncompressed"
        ) from None
    wanted = layout.frames * layout.frame_bytes
    if done.returncode or len(done.stdout) != wanted:
        raise RadiographError(
            "PixelData: JPEG Lossless pixels that can't be decoded; copy it again, or export it uncompressed"
        )
    return done.stdout


def _limit() -> None:
    try:
        import resource
    except ImportError:  # Windows: the time limit is the parent's
        return
    for kind, most in ((resource.RLIMIT_AS, MOST_CHILD_BYTES), (resource.RLIMIT_CPU, MOST_SECONDS),
                       (resource.RLIMIT_FSIZE, 0), (resource.RLIMIT_CORE, 0)):  # fmt: skip
        _, hard = resource.getrlimit(kind)
        resource.setrlimit(kind, (most if hard == resource.RLIM_INFINITY else min(most, hard), hard))


def _decode() -> None:
    from pydicom.encaps import encapsulate
    from pydicom.pixels.decoders.base import get_decoder

    request = json.loads(sys.stdin.buffer.readline())
    frames = [sys.stdin.buffer.read(length) for length in request["lengths"]]
    pixels, _ = get_decoder(request["syntax"]).as_buffer(
        encapsulate(frames, has_bot=False), raw=True, decoding_plugin="gdcm", **request["options"]
    )
    sys.stdout.buffer.write(pixels)


if __name__ == "__main__":
    _limit()
    _decode()
