"""Attenuation against tabulated values, and what a spectrum does to contrast."""

from __future__ import annotations

import numpy as np
import pytest

from spinestiff.errors import RadiographError
from spinestiff.imaging.synthetic.materials import Beam, Material, attenuations, monoenergetic, tube_beam


def test_attenuation_is_density_times_the_tables_mass_attenuation() -> None:
    tissue, bone, aluminium = attenuations(np.array([60.0]))[0]
    assert tissue == pytest.approx(0.1 * 1.06 * 0.2048)
    assert bone + tissue == pytest.approx(0.1 * 1.92 * 0.3148)
    assert aluminium == pytest.approx(0.1 * 2.70 * 0.2778)
    # Between the table's energies: a power law passes 70 keV at the geometric mean of what lies around.
    low, middle, high = attenuations(np.array([60.0, np.sqrt(60.0 * 80.0), 80.0]))[:, Material.ALUMINIUM]
    assert middle == pytest.approx(np.sqrt(low * high))


def test_all_materials_absorb_less_at_higher_energies_and_bone_stays_above_tissue() -> None:
    table = attenuations(np.linspace(20.0, 150.0, 60))
    assert (np.diff(table, axis=0) < 0.0).all()
    assert (table > 0.0).all()


def test_a_monoenergetic_beam_follows_beer_and_lambert() -> None:
    thickness = np.zeros((3, 2, 2))
    thickness[Material.SOFT_TISSUE] = [[0.0, 100.0], [200.0, 300.0]]
    thickness[Material.BONE, 1] = 10.0
    depth = -np.log(monoenergetic(50.0).transmitted(thickness))
    np.testing.assert_allclose(depth, np.tensordot(attenuations(np.array([50.0]))[0], thickness, 1), rtol=1e-12)


def test_a_spectrum_is_the_weighted_sum_of_its_energies_and_hardens() -> None:
    beam = Beam(np.array([40.0, 80.0]), np.array([0.25, 0.75]))
    behind = np.zeros((3, 1, 40))
    behind[Material.SOFT_TISSUE, 0] = np.linspace(0.0, 300.0, 40)
    parts = [monoenergetic(kev).transmitted(behind) for kev in (40.0, 80.0)]
    np.testing.assert_allclose(beam.transmitted(behind), 0.25 * parts[0] + 0.75 * parts[1])
    slope = -np.diff(np.log(tube_beam(75.0).transmitted(behind)[0]))
    assert (np.diff(slope) < 0.0).all()


def test_bone_contrast_falls_with_the_tube_voltage() -> None:
    """200 mm of tissue with and without 10 mm of cortical bone; an effective energy a little above half the kVp."""
    plain = np.array([200.0, 0.0, 0.0])[:, None, None]
    bone = np.array([200.0, 10.0, 0.0])[:, None, None]
    contrast, energy = [], []
    for kvp in (60.0, 75.0, 90.0, 120.0):
        beam = tube_beam(kvp)
        contrast.append(float(np.log(beam.transmitted(plain) / beam.transmitted(bone))[0, 0]))
        more = plain + np.array([1.0, 0.0, 0.0])[:, None, None]
        effective = np.log(beam.transmitted(plain) / beam.transmitted(more))[0, 0]
        kev = np.linspace(20.0, 150.0, 500)
        energy.append(float(np.interp(-effective, -attenuations(kev)[:, Material.SOFT_TISSUE], kev)) / kvp)
    assert all(a > 1.1 * b for a, b in zip(contrast, contrast[1:]))
    assert 0.3 < contrast[1] < 0.6
    assert all(0.5 < share < 0.85 for share in energy)


@pytest.mark.parametrize("kvp", [20.0, 200.0, np.nan])
def test_a_voltage_no_tube_is_used_at_is_refused(kvp: float) -> None:
    with pytest.raises(RadiographError, match="kVp; wanted 50 to 150"):
        tube_beam(kvp)


def test_a_beam_that_is_none_is_refused() -> None:
    with pytest.raises(RadiographError, match="wanted 20 to 150"):
        monoenergetic(10.0)
    with pytest.raises(RadiographError, match="sum to 1"):
        Beam(np.array([50.0, 60.0]), np.array([0.5, 0.6]))
