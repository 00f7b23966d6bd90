"""From what a beam leaves behind the patient to grey values: scatter, haze, blur, quantum and electronic noise.

Order of events: geometric blur (focal spot), scatter and haze, Poisson noise of the photons that are absorbed, the
detector's own blur, which the noise shares, electronic noise, logarithm.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import ive

from spinestiff.arrays import Floats
from spinestiff.errors import RadiographError
from spinestiff.imaging.projection import XRayView
from spinestiff.imaging.synthetic.materials import Beam, tube_beam

GREY_PER_OPTICAL_DEPTH = 8000.0
AIR_GREY = 4000.0
_LIT = 0.5  # optical depth from which a pixel counts as behind the patient


@dataclass(frozen=True)
class Exposure:
    """How the beam and the detector turn thicknesses into grey values.

    Attributes
    ----------
    kvp : tube voltage.
    photons : mean count a mm2 of detector in the unattenuated beam. The default leaves about 1,300 behind 200 mm of
        tissue, scatter included: about an eighth of a standard exposure.
    factor : exposure of this frame relative to the series (tube output wanders from frame to frame).
    scatter_fraction : scattered photons among all that arrive behind thick tissue and a grid, 0 to below 1.
    scatter_width : mm at the detector, standard deviation of the scatter's blur.
    haze : constant fraction of the patient's mean signal (veiling glare, off-focus radiation).
    focal_spot : mm, width; blurs by its image at the patient plane's magnification, before the noise.
    detector_blur : mm, standard deviation s of the detector's blur; its MTF on pixels of p mm is
        exp(-(s / p)^2 (1 - cos(2 pi f p))), a Gaussian where f p is small; the noise's power falls with its square.
    electronic_noise : photons a pixel, standard deviation.
    beam : replaces the tube's beam, e.g. by a monoenergetic one.

    Raises
    ------
    RadiographError : a value is outside its range.
    """

    kvp: float = 75.0
    photons: float = 1.4e5
    factor: float = 1.0
    scatter_fraction: float = 0.4
    scatter_width: float = 25.0
    haze: float = 0.02
    focal_spot: float = 1.2
    detector_blur: float = 0.2
    electronic_noise: float = 4.0
    beam: Beam | None = None

    def __post_init__(self) -> None:
        if not (self.photons > 0.0 and self.factor > 0.0):
            raise RadiographError(f"exposure of {self.photons:g} photons times {self.factor:g}; wanted > 0")
        if not 0.0 <= self.scatter_fraction < 1.0:
            raise RadiographError(f"scatter fraction {self.scatter_fraction:g}; wanted 0 to below 1")
        for name in ("scatter_width", "haze", "focal_spot", "detector_blur", "electronic_noise"):
            if not getattr(self, name) >= 0.0:
                raise RadiographError(f"{name.replace('_', ' ')} {getattr(self, name):g}; wanted 0 or more")
        if self.beam is None:
            tube_beam(self.kvp)

    @property
    def spectrum(self) -> Beam:
        """The beam this exposure is made with."""
        return self.beam or tube_beam(self.kvp)


DEFAULT_EXPOSURE = Exposure()


def expose(
    thickness: Floats,
    view: XRayView,
    exposure: Exposure = DEFAULT_EXPOSURE,
    seed: int = 0,
    open_beam: Floats | None = None,
) -> NDArray[np.uint16]:
    """Grey values (H, W) behind thicknesses (materials, H, W) mm, bone bright.

    Parameters
    ----------
    thickness : mm of each ``Material``.
    open_beam : (H, W) share of the beam that the collimator lets through; all of it if None.
    seed : of the noise.
    """
    transmitted = exposure.spectrum.transmitted(thickness)
    return grey_values(detected(transmitted, view, exposure, seed, open_beam), view, exposure)


def arriving(transmitted: Floats, view: XRayView, exposure: Exposure, open_beam: Floats | None = None) -> Floats:
    """Mean photons a pixel (H, W), before any noise: primary, scattered and haze."""
    lit = np.ones_like(transmitted) if open_beam is None else open_beam
    primary = lit * transmitted
    # What is scattered is what met tissue, so free air beside the patient sends none.
    sent = primary * (1.0 - transmitted)
    scattered = wide_blur(sent, exposure.scatter_width, view) if exposure.scatter_fraction > 0.0 else 0.0
    behind = (transmitted < np.exp(-_LIT)) & (lit > 0.5)
    haze = exposure.haze * float(primary[behind].mean()) if behind.any() else 0.0
    ratio = exposure.scatter_fraction / (1.0 - exposure.scatter_fraction)
    spot = exposure.focal_spot * (view.magnification - 1.0) / np.sqrt(12.0)  # standard deviation of a uniform spot
    mean: Floats = _blurred(primary, spot, view) + ratio * scattered + haze
    return _photons_a_pixel(view, exposure) * exposure.factor * mean


def detected(
    transmitted: Floats, view: XRayView, exposure: Exposure, seed: int = 0, open_beam: Floats | None = None
) -> Floats:
    """Photons a pixel as the detector reports them (H, W): with both noises and its blur."""
    random = np.random.default_rng(seed)
    counts = random.poisson(arriving(transmitted, view, exposure, open_beam)).astype(np.float64)
    counts = _blurred(counts, exposure.detector_blur, view)
    counts += exposure.electronic_noise * random.standard_normal(counts.shape, dtype=np.float32)
    return counts


def grey_values(counts: Floats, view: XRayView, exposure: Exposure) -> NDArray[np.uint16]:
    """Logarithm: 8000 grey values an optical depth, 4000 in free air at the series' exposure."""
    absorbed = -np.log(np.maximum(counts, 0.5) / _photons_a_pixel(view, exposure))
    return np.clip(np.rint(AIR_GREY + GREY_PER_OPTICAL_DEPTH * absorbed), 0, 65535).astype(np.uint16)


def wide_blur(image: Floats, width: float, view: XRayView) -> Floats:
    """Gaussian blur by ``width`` mm at the detector, on a grid coarse enough to be quick."""
    step = max(1, int(width / float(view.pixel_spacing.max()) / 6.0))
    rows, columns = image.shape
    small = cv2.resize(image, (max(1, columns // step), max(1, rows // step)), interpolation=cv2.INTER_AREA)
    sigma = width / (view.pixel_spacing * np.array([columns, rows]) / np.array(small.shape[::-1]))
    small = cv2.GaussianBlur(small, (0, 0), sigmaX=float(sigma[0]), sigmaY=float(sigma[1]))
    return np.asarray(cv2.resize(small, (columns, rows), interpolation=cv2.INTER_LINEAR), dtype=np.float64)


def _blurred(image: Floats, width: float, view: XRayView) -> Floats:
    """Blur by the discrete Gaussian of standard deviation ``width`` mm, which may be less than a pixel.

    Its weights exp(-t) I_n(t), t the variance in pixels, are positive (Lindeberg 1990): beside free air, a Gaussian cut
    off at the pixels' own frequency would ring through everything dense.
    """
    if width <= 0.0:
        return image
    kernels = []
    for pixel in view.pixel_spacing:
        variance = (width / float(pixel)) ** 2
        reach = np.arange(int(np.ceil(5.0 * np.sqrt(variance))) + 3)
        half = ive(reach, variance)
        kernel = np.concatenate([half[:0:-1], half])
        kernels.append(kernel / kernel.sum())
    blurred = cv2.sepFilter2D(image, cv2.CV_64F, kernels[0], kernels[1], borderType=cv2.BORDER_REPLICATE)
    return np.asarray(blurred, dtype=np.float64)


def _photons_a_pixel(view: XRayView, exposure: Exposure) -> float:
    return exposure.photons * float(np.prod(view.pixel_spacing))
