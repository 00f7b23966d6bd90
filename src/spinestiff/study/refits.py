"""What refits of a subject's estimate begin with: the estimate, and its trials on the mesh that is asked for."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from spinestiff.anatomy.torso import TorsoModel
from spinestiff.arrays import ShortRepr
from spinestiff.errors import FitError, SubjectError
from spinestiff.estimation.asked import Start
from spinestiff.estimation.fitted import Method, StiffnessFit
from spinestiff.study.fits import fit_pushes
from spinestiff.study.trials import PushSet
from spinestiff.study.visit import Manner, Visit, pushes_on, torso_on
from spinestiff.subject.estimate_outcome import Estimate
from spinestiff.subject.run_record import read_outcome


@dataclass(frozen=True, repr=False)
class Basis(ShortRepr):
    """A visit with its estimate by the weighed fit, and its torso on the mesh of the visit's settings."""

    visit: Visit
    estimate: Estimate
    torso: TorsoModel

    @property
    def names(self) -> tuple[str, ...]:
        """Of the estimate's ratios."""
        return self.estimate.parameters

    @property
    def nuisances(self) -> dict[str, float]:
        """As the estimate found them, in prior standard deviations."""
        return {one.name: one.standard for one in self.estimate.nuisances}

    def pushes(self, method: Method = "weighed") -> PushSet:
        """The trials as the estimate had them."""
        return pushes_on(self.visit, self.torso, replace(Manner.of(self.estimate), method=method))

    def refit(self, pushes: PushSet, start: Mapping[str, float] | None = None) -> StiffnessFit:
        """The estimate's ratios fitted to other trials, begun at ``start`` or at the estimate; no intervals.

        Raises
        ------
        FitError : no fit, or one that ended without a minimum.
        """
        return converged(
            fit_pushes(
                pushes,
                self.names,
                Start(start or self.estimate.values, self.nuisances),
                extent="estimate",
            )
        )


def basis_of(visit: Visit) -> Basis:
    """What refits begin with.

    Raises
    ------
    SubjectError : no estimate, or one by the paper's method; no torso on the mesh.
    """
    estimate = read_outcome(visit.subject, Estimate)
    if estimate.method != "weighed":
        raise SubjectError(
            f"{visit.file(Estimate.FILE)}: is by the paper's method, and refits are compared with an estimate by the "
            "weighed one; run spinestiff estimate with --method weighed"
        )
    return Basis(visit, estimate, torso_on(visit, visit.settings.mesh))


def converged(fit: StiffnessFit) -> StiffnessFit:
    """The fit itself; FitError where it ended without a minimum."""
    if not fit.status.usable:
        raise FitError(fit.status.value)
    return fit
