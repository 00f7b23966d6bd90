"""What a synthetic radiograph costs, and what the default exposure gives.

The reference body at rest is radiographed ``--frames`` times from the front with all defaults, 1024 × 1024 pixels,
after a frame that compiles and keeps kernels: CPU seconds a frame on one thread. Of the default exposure:
photons a mm² behind 200 mm of soft tissue, scatter and haze included, and the detector's transfer of one period a mm
on its pixels, which is the formula of ``imaging.synthetic.detector.Exposure``. ``docs/synthetic-radiographs.md`` quotes
it.

    python benchmarks/rendered_frames.py [--frames 5] [--write]
    python benchmarks/rendered_frames.py --json
"""

from __future__ import annotations

import os

ONE_THREAD = {f"{name}_NUM_THREADS": "1" for name in ("OMP", "OPENBLAS", "NUMBA", "RAYON")} | {
    "SPINESTIFF_THREADS": "1"
}
os.environ.update(ONE_THREAD)

import time  # noqa: E402
from pathlib import Path  # noqa: E402
from typing import Any  # noqa: E402

import numpy as np  # noqa: E402
from kept_rows import measure_once  # noqa: E402

from spinestiff.anatomy.template import template_torso  # noqa: E402
from spinestiff.imaging.projection import frontal_view  # noqa: E402
from spinestiff.imaging.synthetic.acquisition import Acquisition, acquire  # noqa: E402
from spinestiff.imaging.synthetic.detector import DEFAULT_EXPOSURE, arriving  # noqa: E402
from spinestiff.imaging.synthetic.materials import Material  # noqa: E402

RESULTS = Path(__file__).parent / "results" / "rendered_frames.json"
SHAPE = (1024, 1024)
DETECTOR_MM, TISSUE_MM = 427.0, 200.0


def seconds(frames: int, shape: tuple[int, int] = SHAPE) -> float:
    """CPU seconds a frame of a sequence, after a first sequence of one."""
    torso = template_torso(157.0)
    spine = torso.rest_pose.bone_positions[torso.vertebra_bones]
    centre = np.array([0.0, 0.5 * (spine[0, 1] + spine[-1, 1]), 0.0])
    view = frontal_view(shape=shape, pixel=DETECTOR_MM / shape[1], centre=centre)

    def taken(number: int) -> float:
        begun = time.process_time()
        made = list(acquire(torso, [torso.rest_pose] * number, view, Acquisition(), person=1, seed=1))
        assert len(made) == number
        return (time.process_time() - begun) / number

    taken(1)
    return taken(frames)


def photons_a_mm2() -> float:
    """Behind ``TISSUE_MM`` of soft tissue that fills the picture."""
    view = frontal_view(shape=(64, 64))
    thickness = np.zeros((len(Material), *view.shape))
    thickness[Material.SOFT_TISSUE] = TISSUE_MM
    transmitted = DEFAULT_EXPOSURE.spectrum.transmitted(thickness)
    return float(arriving(transmitted, view, DEFAULT_EXPOSURE).mean() / np.prod(view.pixel_spacing))


def transfer(periods_a_mm: float) -> float:
    """Of the detector's blur, on the default view's pixels."""
    pixel = float(frontal_view().pixel_spacing[0])
    share = DEFAULT_EXPOSURE.detector_blur / pixel
    return float(np.exp(-(share**2) * (1.0 - np.cos(2.0 * np.pi * periods_a_mm * pixel))))


def measured(frames: int) -> dict[str, Any]:
    """All of it."""
    return {
        "cpu_s_a_frame": round(seconds(frames), 2),
        "photons_a_mm2": round(photons_a_mm2(), 0),
        "transfer_at_1_period_a_mm": round(transfer(1.0), 3),
    }


if __name__ == "__main__":
    measure_once(__doc__, RESULTS, measured, frames=5)
