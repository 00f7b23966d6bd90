"""Scatter, blur and noise against what they are defined as."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from spinestiff.errors import RadiographError
from spinestiff.imaging.projection import XRayView, frontal_view
from spinestiff.imaging.synthetic.detector import AIR_GREY, GREY_PER_OPTICAL_DEPTH, Exposure, arriving, detected, expose
from spinestiff.imaging.synthetic.materials import monoenergetic

PIXEL = 0.4
QUIET = Exposure(photons=1e12, scatter_fraction=0.0, haze=0.0, focal_spot=0.0, detector_blur=0.0, electronic_noise=0.0)


def plate(size: int = 256) -> XRayView:
    return frontal_view(shape=(size, size), pixel=PIXEL, centre=(0.0, 0.0, 0.0))


def uniform(millimetres: float, size: int = 256) -> np.ndarray:
    thickness = np.zeros((3, size, size))
    thickness[0] = millimetres
    return thickness


def mtf(sigma: float, fx: np.ndarray | float, fy: np.ndarray | float = 0.0) -> np.ndarray | float:
    waves = 2.0 - np.cos(2.0 * np.pi * PIXEL * fx) - np.cos(2.0 * np.pi * PIXEL * fy)
    return np.exp(-((sigma / PIXEL) ** 2) * waves)


def test_more_exposure_is_less_grey_and_more_tissue_more() -> None:
    image = expose(uniform(100.0), plate(), QUIET).astype(float)
    assert (expose(uniform(120.0), plate(), QUIET) > image).all()
    brighter = expose(uniform(100.0), plate(), replace(QUIET, factor=2.0)).astype(float)
    np.testing.assert_allclose(image - brighter, GREY_PER_OPTICAL_DEPTH * np.log(2.0), atol=1.01)
    assert expose(uniform(0.0), plate(), QUIET) == pytest.approx(AIR_GREY, abs=1)


@pytest.mark.parametrize("photons", [1e4, 1e5])
def test_the_variance_of_the_noise_is_one_over_the_photons_plus_the_electronics(photons: float) -> None:
    exposure = replace(QUIET, photons=photons, electronic_noise=20.0, beam=monoenergetic(60.0))
    image = expose(uniform(80.0), plate(), exposure, seed=4).astype(float)
    count = float(arriving(exposure.spectrum.transmitted(uniform(80.0)), plate(), exposure).mean())
    assert count == pytest.approx(photons * PIXEL**2 * np.exp(-80.0 * 0.1 * 1.06 * 0.2048))
    wanted = GREY_PER_OPTICAL_DEPTH**2 * (count + 20.0**2) / count**2
    assert image.var() == pytest.approx(wanted, rel=0.04)


def test_noise_depends_on_the_grey_level_and_the_seed_decides_it() -> None:
    thickness = uniform(50.0)
    thickness[0, :, 128:] = 250.0
    exposure = Exposure(focal_spot=0.0, scatter_fraction=0.0)
    image = expose(thickness, plate(), exposure, seed=1).astype(float)
    assert image[:, 140:].std() > 4.0 * image[:, :116].std()
    np.testing.assert_array_equal(image, expose(thickness, plate(), exposure, seed=1))
    assert (image != expose(thickness, plate(), exposure, seed=2)).mean() > 0.5


def test_noise_is_correlated_by_the_detectors_blur() -> None:
    """Its power falls with the square of the MTF."""
    exposure = replace(QUIET, photons=1e6, detector_blur=0.3)
    open_field = np.ones((512, 512))
    noise = detected(open_field, plate(512), exposure, seed=3)
    power = np.abs(np.fft.fft2(noise / noise.mean() - 1.0)) ** 2 * PIXEL**2 / noise.size
    axes = np.meshgrid(*[np.fft.fftfreq(512, PIXEL)] * 2)
    f = np.hypot(*axes)
    for low, high in ((0.05, 0.15), (0.45, 0.55), (0.85, 0.95)):
        band = (f > low) & (f < high)
        wanted = np.mean(mtf(0.3, *axes)[band] ** 2) / 1e6
        assert power[band].mean() == pytest.approx(wanted, rel=0.06)


@pytest.mark.parametrize(("what", "width"), [("detector_blur", 0.25), ("focal_spot", 3.0)])
def test_the_transfer_function_is_the_one_promised(what: str, width: float) -> None:
    """A sine of 0.5 and 1 periods a mm comes out weaker by the MTF, also where the blur is below a pixel."""
    exposure = replace(QUIET, **{what: width})
    sigma = width if what == "detector_blur" else width * (plate().magnification - 1.0) / np.sqrt(12.0)
    x = np.arange(256) * PIXEL
    assert mtf(sigma, 0.1) == pytest.approx(np.exp(-2.0 * (np.pi * sigma * 0.1) ** 2), abs=0.001)  # Gaussian
    for frequency in (0.5, 1.0):
        wave = np.cos(2.0 * np.pi * frequency * x)
        signal = np.broadcast_to(0.5 + 0.1 * wave, (256, 256))
        seen = detected(signal, plate(), exposure)[128] / (1e12 * PIXEL**2)
        inside = slice(20, 236)
        amplitude = 2.0 * np.mean((seen[inside] - seen[inside].mean()) * wave[inside])
        plain = 2.0 * np.mean(0.1 * (wave[inside] - wave[inside].mean()) * wave[inside])
        assert amplitude / plain == pytest.approx(mtf(sigma, frequency), abs=0.004)


def test_blur_does_not_ring_beside_free_air() -> None:
    signal = np.full((64, 64), 1e-4)
    signal[:, 32:] = 1.0
    seen = detected(signal, plate(64), replace(QUIET, detector_blur=0.15)) / (1e12 * PIXEL**2)
    np.testing.assert_allclose(seen[:, :26], 1e-4, rtol=1e-3)
    assert (np.diff(seen[32]) > -2e-5).all()  # noise of 1e12 photons


def test_the_edges_of_a_picture_do_not_leak_to_the_other_side() -> None:
    signal = np.ones((64, 64))
    signal[:, 32:] = 0.1
    seen = detected(signal, plate(64), replace(QUIET, detector_blur=0.8)) / (1e12 * PIXEL**2)
    np.testing.assert_allclose(seen[:, [0, -1]], np.tile([1.0, 0.1], (64, 1)), rtol=1e-4)


def test_the_scatter_fraction_is_that_behind_a_thick_slab() -> None:
    primary = np.full((256, 256), 0.01)
    for fraction in (0.0, 0.3, 0.6):
        both = arriving(primary, plate(), replace(QUIET, scatter_fraction=fraction))
        scattered = both - arriving(primary, plate(), QUIET)
        np.testing.assert_allclose(scattered / both, fraction, atol=0.005)


def test_scatter_spreads_and_free_air_sends_none() -> None:
    transmitted = np.ones((256, 256))
    transmitted[:, 128:] = 0.05
    exposure = replace(QUIET, scatter_fraction=0.5, scatter_width=10.0)
    extra = (arriving(transmitted, plate(), exposure) - arriving(transmitted, plate(), QUIET)) / (1e12 * PIXEL**2)
    assert extra[128, 20] < 1e-4 < 0.01 < extra[128, 110] < extra[128, 230]


def test_scatter_and_haze_veil_contrast() -> None:
    thickness = uniform(150.0)
    thickness[0, :, 120:136] = 190.0
    clear = expose(thickness, plate(), QUIET).astype(float)
    veiled = expose(thickness, plate(), replace(QUIET, scatter_fraction=0.35, haze=0.05)).astype(float)
    assert np.ptp(veiled) < 0.8 * np.ptp(clear)


@pytest.mark.parametrize("change", [
    {"photons": 0.0}, {"factor": -1.0}, {"photons": np.nan}, {"scatter_fraction": 1.0}, {"detector_blur": -0.1},
    {"haze": np.nan}, {"kvp": 10.0},
])  # fmt: skip
def test_an_impossible_exposure_is_refused(change: dict[str, float]) -> None:
    with pytest.raises(RadiographError, match="wanted"):
        Exposure(**change)
