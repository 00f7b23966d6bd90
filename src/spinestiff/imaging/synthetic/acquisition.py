"""Synthetic sequences: everything that differs from one radiograph of a push to the next."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from spinestiff.anatomy.points import PointsOnBones
from spinestiff.anatomy.state import TorsoState
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.arrays import Floats
from spinestiff.errors import RadiographError
from spinestiff.imaging.projection import XRayView
from spinestiff.imaging.synthetic.bowel import bowel
from spinestiff.imaging.synthetic.breathing import Breathing, breathed
from spinestiff.imaging.synthetic.collimation import Collimation
from spinestiff.imaging.synthetic.detector import Exposure, expose
from spinestiff.imaging.synthetic.gauge import gauge_pad
from spinestiff.imaging.synthetic.rendering import thicknesses
from spinestiff.imaging.synthetic.torso_absorbers import torso_absorbers
from spinestiff.parallel import in_parallel


@dataclass(frozen=True)
class Acquisition:
    """How a sequence is taken.

    Attributes
    ----------
    exposure : beam and detector.
    exposure_drift : standard deviation of the logarithm of a frame's exposure relative to the series.
    frame_time : s from frame to frame.
    breathing : None for a held breath.
    gas : amount of gas in the bowel, 1 for a common picture, 0 for none.
    bowel_motion : mm, standard deviation of the place of the bowel's contents and bubbles from frame to frame.
    collimation : blades.
    samples : rays a pixel along each axis.

    Raises
    ------
    RadiographError : a value is outside its range.
    """

    exposure: Exposure = field(default_factory=Exposure)
    exposure_drift: float = 0.06
    frame_time: float = 0.25
    breathing: Breathing | None = field(default_factory=Breathing)
    gas: float = 1.0
    bowel_motion: float = 2.0
    collimation: Collimation = field(default_factory=Collimation)
    samples: int = 2

    def __post_init__(self) -> None:
        for name in ("exposure_drift", "frame_time", "gas", "bowel_motion"):
            if not getattr(self, name) >= 0.0:
                raise RadiographError(f"{name.replace('_', ' ')} {getattr(self, name):g}; wanted 0 or more")


DEFAULT_ACQUISITION = Acquisition()
LATERAL = Exposure(kvp=88.0, photons=4.2e5)
"""The exposure of a lateral radiograph, whose way through the body is longer: more voltage and three times as much."""


@dataclass(frozen=True)
class Gauge:
    """The force gauge: points of the push on the ribs, and the forces (n, 3) on them, of whatever size."""

    points: PointsOnBones
    forces: Floats


def acquire(
    torso: TorsoModel,
    states: Sequence[TorsoState],
    view: XRayView,
    acquisition: Acquisition = DEFAULT_ACQUISITION,
    *,
    person: int = 0,
    seed: int = 0,
    gauge: Gauge | None = None,
) -> list[NDArray[np.uint16]]:
    """Radiographs (H, W) of a torso's states, one a frame, bone bright.

    What a torso's vertebrae do is in the states alone; breathing moves ribs, sternum and diaphragm on top of them.
    The same seeds give the same frames.

    Parameters
    ----------
    person : decides textures, vessels and where gas lies.
    seed : decides noise, drift, phase of breathing, the gas's motion.
    gauge : its pad is in the pictures; None for rest radiographs.
    """
    random = np.random.default_rng(seed)
    start = float(random.uniform(0.0, 2.0 * np.pi))
    breathing = acquisition.breathing or Breathing(rise=0.0, diaphragm=0.0)
    open_beam = acquisition.collimation.open_beam(view)

    def frame(number: int) -> NDArray[np.uint16]:
        state = states[number]
        own = np.random.default_rng([seed, number])
        phase = breathing.phase(number * acquisition.frame_time, start)
        shown = breathed(torso, state, breathing.rise * phase) if breathing.rise > 0.0 else state
        bodies = [*torso_absorbers(torso, shown, person, breathing.diaphragm * phase)]
        bodies += bowel(torso, shown, person, acquisition.gas, acquisition.bowel_motion, own)
        if gauge is not None:
            bodies += gauge_pad(torso, shown, gauge.points, gauge.forces)
        drift = float(np.exp(acquisition.exposure_drift * own.standard_normal()))
        exposure = replace(acquisition.exposure, factor=acquisition.exposure.factor * drift)
        noise = int(own.integers(2**31))
        return expose(thicknesses(bodies, view, acquisition.samples), view, exposure, noise, open_beam)

    return in_parallel(frame, range(len(states)))
