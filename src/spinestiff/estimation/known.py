"""What is known of a subject beside the radiographs of pushes."""

from __future__ import annotations

from dataclasses import dataclass, field

from spinestiff.arrays import Floats, ShortRepr
from spinestiff.estimation.priors import Priors


@dataclass(frozen=True, repr=False)
class Known(ShortRepr):
    """What a weighed fit is told beside its trials.

    Attributes
    ----------
    priors : of all that is not quite known.
    geometry : (6V, 6V) covariance of the vertebrae's rest poses (dt mm, dw rad); None: exact.
    taped : the trunk's size was measured.
    population : whose ratios are held as a prior (``ratio_priors.POPULATIONS``), by the weighed method only; None: the
        ratios are flat in log, up to the smoothness of neighbouring levels'.
    """

    priors: Priors = field(default_factory=Priors)
    geometry: Floats | None = None
    taped: bool = False
    population: str | None = None
