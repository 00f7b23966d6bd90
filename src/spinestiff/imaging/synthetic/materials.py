"""How strongly materials absorb, and the energies of the beam that meets them.

A radiograph depends on three numbers a pixel: mm of soft tissue, mm of bone mineral over the tissue whose place it
takes, and mm of aluminium (the gauge). Lung and bowel gas are soft tissue that is missing.

Mass attenuation coefficients are those of Hubbell and Seltzer (NISTIR 5632; ICRU-44 soft tissue and cortical bone),
written down from memory to three or four digits; between them attenuation is a power of the energy.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from functools import cache

import numpy as np

from spinestiff.arrays import Floats, read_only
from spinestiff.errors import RadiographError


class Material(IntEnum):
    """What a thickness map counts; also the row of the map."""

    SOFT_TISSUE = 0
    BONE = 1  # cortical, as what it adds to the soft tissue in its place
    ALUMINIUM = 2


_KEV = np.array([20.0, 30.0, 40.0, 50.0, 60.0, 80.0, 100.0, 150.0])
_MASS_ATTENUATION = {  # cm2/g
    "soft tissue": np.array([0.823, 0.379, 0.2688, 0.2264, 0.2048, 0.1823, 0.1693, 0.1492]),
    "cortical bone": np.array([4.001, 1.331, 0.6655, 0.4242, 0.3148, 0.2229, 0.1855, 0.1480]),
    "aluminium": np.array([3.441, 1.128, 0.5685, 0.3681, 0.2778, 0.2018, 0.1704, 0.1378]),
}
_DENSITY = {"soft tissue": 1.06, "cortical bone": 1.92, "aluminium": 2.70}  # g/cm3
KVP_LIMITS = (50.0, 150.0)
_FILTER_MM = 3.0  # of aluminium: the least that a diagnostic tube has (IEC 60601-1-3), and a little more
_BIN_KEV = 10.0


@dataclass(frozen=True)
class Beam:
    """A beam as the detector weighs it.

    Attributes
    ----------
    energies : (E,) keV.
    weights : (E,) share of the detector's signal in the open beam; they sum to 1.

    Raises
    ------
    RadiographError : energies outside 20 to 150 keV, or weights that are no shares.
    """

    energies: Floats
    weights: Floats

    def __post_init__(self) -> None:
        object.__setattr__(self, "energies", read_only("energies", self.energies, (None,), RadiographError))
        shape = (len(self.energies),)
        object.__setattr__(self, "weights", read_only("weights", self.weights, shape, RadiographError))
        if not len(self.energies) or self.energies.min() < _KEV[0] or self.energies.max() > _KEV[-1]:
            raise RadiographError(f"beam of {self.energies.tolist()} keV; wanted {_KEV[0]:g} to {_KEV[-1]:g}")
        if self.weights.min() < 0.0 or abs(self.weights.sum() - 1.0) > 1e-9:
            raise RadiographError(f"weights of the beam {self.weights.tolist()}; wanted shares that sum to 1")

    def transmitted(self, thickness: Floats) -> Floats:
        """Share of the open beam's signal left behind thicknesses (materials, ...) mm, by Beer and Lambert."""
        flat = thickness.reshape(len(thickness), -1)
        signal = np.zeros(flat.shape[1])
        for weight, attenuation in zip(self.weights, attenuations(self.energies)):
            signal += weight * np.exp(-attenuation @ flat)
        return signal.reshape(thickness.shape[1:])


def attenuations(energies: Floats) -> Floats:
    """Linear attenuation of each material, (E, 3) 1/mm, at energies (E,) keV."""
    linear = {
        name: 0.1 * _DENSITY[name] * np.exp(np.interp(np.log(energies), np.log(_KEV), np.log(mass)))
        for name, mass in _MASS_ATTENUATION.items()
    }
    tissue = linear["soft tissue"]
    return np.stack([tissue, linear["cortical bone"] - tissue, linear["aluminium"]], -1)


def monoenergetic(kev: float) -> Beam:
    """A beam of one energy."""
    return Beam(np.array([kev]), np.ones(1))


@cache
def tube_beam(kvp: float) -> Beam:
    """The beam of a tungsten tube: Kramers' spectrum behind 3 mm of aluminium, weighed by a detector of energy.

    Kramers: N(E) ~ kVp / E - 1. The tube's characteristic lines (58 to 69 keV, at most a tenth of the signal) and the
    detector's falling efficiency at high energies are left out.

    Raises
    ------
    RadiographError : kVp outside 50 to 150.
    """
    low, high = KVP_LIMITS
    if not low <= kvp <= high:
        raise RadiographError(f"tube voltage {kvp:g} kVp; wanted {low:g} to {high:g}")
    edges = np.append(np.arange(_KEV[0], kvp, _BIN_KEV), kvp)
    energies = 0.5 * (edges[:-1] + edges[1:])
    photons = (kvp / energies - 1.0) * np.diff(edges)
    behind = photons * np.exp(-_FILTER_MM * attenuations(energies)[:, Material.ALUMINIUM])
    signal = energies * behind
    return Beam(energies, signal / signal.sum())
