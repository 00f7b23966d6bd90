"""Synthetic radiographs: bodies that absorb, and what is left of a beam behind them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from spinestiff.arrays import Floats, Ints
from spinestiff.errors import RadiographError
from spinestiff.imaging.projection import XRayView
from spinestiff.imaging.synthetic.detector import wide_blur
from spinestiff.imaging.synthetic.materials import Material
from spinestiff.imaging.synthetic.path_length import Shadow, Surface, cast, closed_surface, shrunk
from spinestiff.imaging.synthetic.texture import Texture, pattern

_COARSE = 4.0  # pixels that the smoothing of a body keeps on a coarser detector


@dataclass(frozen=True)
class Absorber:
    """A body that absorbs X-rays.

    Attributes
    ----------
    vertices, faces : closed surface in the world, (n, 3) mm and (m, 3) outward.
    material : what it is made of.
    density : relative to the material's own, on top of what surrounds the body; negative for air in tissue.
    shell : mm, thickness of a denser shell, one number or one a vertex (n,); 0 for none.
    shell_density : what the shell has more than the inside.
    texture : density pattern of the inside, or None.
    smoothing : mm at the detector, blur of the path length; hides the facets of a coarse skin.
    """

    vertices: Floats
    faces: Ints
    material: Material = Material.SOFT_TISSUE
    density: float = 1.0
    shell: Floats | float = 0.0
    shell_density: float = 0.0
    texture: Texture | None = None
    smoothing: float = 0.0


def thicknesses(absorbers: Sequence[Absorber], view: XRayView, samples: int = 1) -> Floats:
    """mm of each ``Material`` that the rays of a view meet, (materials, H, W).

    A pixel is the mean of ``samples`` x ``samples`` rays; one ray a pixel leaves steps on thin slanting edges.
    """
    if samples < 1:
        raise RadiographError(f"{samples} samples a pixel; wanted at least 1")
    maps = np.zeros((len(Material), *view.shape))
    for absorber in absorbers:
        _add_absorber(maps[absorber.material], absorber, view, samples)
    return maps


def _add_absorber(out: Floats, absorber: Absorber, view: XRayView, samples: int) -> None:
    surface = closed_surface(absorber.vertices, absorber.faces)
    step = int(absorber.smoothing / float(view.pixel_spacing.max()) / _COARSE)
    if step > 1:
        # What is smoothed afterwards needs no fine detector.
        coarse = coarser(view, step)
        smooth = np.zeros(coarse.shape)
        _add_sharp(smooth, absorber, surface, coarse, 1)
        smooth = wide_blur(smooth, absorber.smoothing, coarse)
        rows, columns = view.shape
        size = (coarse.shape[1] * step, coarse.shape[0] * step)
        out += cv2.resize(smooth, size, interpolation=cv2.INTER_CUBIC)[:rows, :columns]
    elif absorber.smoothing > 0.0:
        smooth = np.zeros(view.shape)
        _add_sharp(smooth, absorber, surface, view, samples)
        out += wide_blur(smooth, absorber.smoothing, view)
    else:
        _add_sharp(out, absorber, surface, view, samples)


def _add_sharp(out: Floats, absorber: Absorber, surface: Surface, view: XRayView, samples: int) -> None:
    fine = _finer(view, samples)
    shadow = cast(surface, fine, samples)
    if shadow is None:
        return
    inside = absorber.density * shadow.length
    if absorber.texture is not None:
        inside *= 1.0 + absorber.texture.amplitude * pattern(shadow, absorber.texture, fine)
    _add(out, shadow, inside, samples)
    if np.any(absorber.shell):
        _add(out, shadow, absorber.shell_density * shadow.length, samples)
        core = cast(shrunk(surface, absorber.shell), fine, samples)
        if core is not None:
            _add(out, core, -absorber.shell_density * core.length, samples)


def _add(out: Floats, shadow: Shadow, values: Floats, samples: int) -> None:
    """Add the means of blocks of rays to the pixels they belong to."""
    rows, columns = (slice(s.start // samples, s.stop // samples) for s in (shadow.rows, shadow.columns))
    h, w = values.shape
    out[rows, columns] += cv2.resize(values, (w // samples, h // samples), interpolation=cv2.INTER_AREA)


def _finer(view: XRayView, samples: int) -> XRayView:
    """The same detector with ``samples`` x ``samples`` pixels in the place of each."""
    spacing = view.pixel_spacing / samples
    first = view.detector_origin - 0.5 * (samples - 1) * spacing @ view.detector_axes
    rows, columns = view.shape
    return replace(view, detector_origin=first, pixel_spacing=spacing, shape=(rows * samples, columns * samples))


def coarser(view: XRayView, step: int) -> XRayView:
    """A detector of pixels ``step`` times as large that starts at the same edges and covers no less."""
    first = view.detector_origin + 0.5 * (step - 1) * view.pixel_spacing @ view.detector_axes
    rows, columns = (-(-n // step) for n in view.shape)
    return replace(view, detector_origin=first, pixel_spacing=view.pixel_spacing * step, shape=(rows, columns))
