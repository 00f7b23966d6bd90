"""What may be held of ratios before a fit: that neighbouring levels are alike, and what other people's spines had.

Ratios are flat inside their bounds otherwise. Both are linear in the log ratios q, rows A q - b in standard deviations,
and join the residuals of the weighed fit (``weighed``).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri, stdtrit

from spinestiff.anatomy.regions import AT, levels_of
from spinestiff.anatomy.stiffness import INTERVERTEBRAL_BENDING, ParameterGroup, parameter_group
from spinestiff.arrays import Floats, ShortRepr, read_only
from spinestiff.errors import FitError
from spinestiff.normal import HALF_WIDTH_95

SMOOTHNESS = "level smoothness"
UPPER = 0.975  # of the ends of a 95 % interval


@dataclass(frozen=True, repr=False)
class RatioPrior(ShortRepr):
    """Rows (k, P) times the log ratios less ``values`` (k,) are N(0, 1) before the fit.

    ``texts`` : name -> what is held, for whoever reads the result.
    """

    rows: Floats
    values: Floats
    texts: Mapping[str, str]

    def __post_init__(self) -> None:
        object.__setattr__(self, "rows", read_only("rows", self.rows, (None, None), FitError))
        object.__setattr__(self, "values", read_only("values", self.values, (len(self.rows),), FitError))

    def residuals(self, log_ratios: Floats) -> Floats:
        """(k,) in standard deviations."""
        return np.asarray(self.rows @ log_ratios - self.values)


@dataclass(frozen=True)
class Population:
    """Ratios of intervertebral lateral bending that a study found.

    Attributes
    ----------
    source : the study. bending : (n,) one a subject.
    """

    source: str
    bending: tuple[float, ...]

    @property
    def mean(self) -> float:
        """Of the logs."""
        return float(np.mean(np.log(self.bending)))

    @property
    def sd(self) -> float:
        """Of a normal distribution with the 95 % limits of the next subject's log, which is distributed as Student's t:
        mean and scatter of these few have errors of their own."""
        count = len(self.bending)
        scatter = float(np.std(np.log(self.bending), ddof=1) * np.sqrt(1.0 + 1.0 / count))
        return scatter * float(stdtrit(count - 1, UPPER) / ndtri(UPPER))


# Koutras et al. 2025, Table 4. Its tissue ratios are no prior: they are over a default modulus that is not published.
POPULATIONS: Mapping[str, Population] = {
    "koutras2025": Population(
        "Koutras et al. 2025, Table 4, seven adolescents with scoliosis", (0.10, 0.19, 0.02, 0.05, 0.01, 0.06, 0.63)
    )
}


def check_population(name: str) -> None:
    """Raise FitError for a population that is not known."""
    if name not in POPULATIONS:
        raise FitError(f"unknown population '{name}'; known are {', '.join(POPULATIONS)}")


def ratio_prior(
    groups: Sequence[ParameterGroup], kinds: tuple[str, ...], smoothness: float, population: str | None
) -> RatioPrior | None:
    """All that is held of these ratios; None: nothing.

    Parameters
    ----------
    groups : of the ratios. kinds : (J,) of the torso's joints.
    smoothness : standard deviation of the difference of the logs of neighbouring levels' ratios; 0: none is held.
    population : of ``POPULATIONS``, if one is asked for.

    Raises
    ------
    FitError : an unknown population, or one of all levels' bending for ratios that leave some of them at the default.
    """
    parts = []
    if smoothness > 0.0:
        parts.append(_smooth([group.name for group in groups], smoothness))
    if population is not None:
        parts.append(_population(groups, kinds, population))
    found = [part for part in parts if part is not None]
    if not found:
        return None
    return RatioPrior(
        np.vstack([part.rows for part in found]),
        np.concatenate([part.values for part in found]),
        {name: text for part in found for name, text in part.texts.items()},
    )


def _smooth(names: Sequence[str], sd: float) -> RatioPrior | None:
    """Ratios of one group at single levels next to each other."""
    levels = [levels_of(name) for name in names]
    stems = [name.partition(AT)[0] for name in names]
    single = {(stem, own[0]): i for i, (stem, own) in enumerate(zip(stems, levels)) if len(own) == 1}
    rows = []
    for (stem, level), i in single.items():
        below = single.get((stem, level + 1))
        if below is not None:
            rows.append(np.eye(len(names))[below] - np.eye(len(names))[i])
    if not rows:
        return None
    text = f"the logs of neighbouring levels' ratios differ by {sd:g} (sd)"
    return RatioPrior(np.array(rows) / sd, np.zeros(len(rows)), {SMOOTHNESS: text})


def _population(groups: Sequence[ParameterGroup], kinds: tuple[str, ...], name: str) -> RatioPrior:
    """The geometric mean over the levels of what scales their lateral bending."""
    check_population(name)
    levels = parameter_group(INTERVERTEBRAL_BENDING, kinds).joints
    shares = np.array([group.joints[levels].mean() for group in groups])
    covered = np.any([group.joints[levels] for group in groups], axis=0)
    if not (len(covered) and covered.all()):
        raise FitError(
            f"population '{name}' is of the lateral bending of the whole spine; the ratios to fit leave "
            f"{int((~covered).sum())} of {len(covered)} levels at their default"
        )
    people = POPULATIONS[name]
    low, middle, high = (float(np.exp(people.mean + z * people.sd)) for z in (-HALF_WIDTH_95, 0.0, HALF_WIDTH_95))
    text = (
        f"the levels' lateral bending, as geometric mean, is {middle:.2g} (95 % {low:.2g} to {high:.2g}) times the "
        f"default ({people.source}); tissue has no such prior"
    )
    return RatioPrior(shares[None] / people.sd, np.array([people.mean / people.sd]), {f"population {name}": text})
