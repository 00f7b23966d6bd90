"""All checks of the installed program, run by ``spinestiff check``."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from spinestiff.verification import derivatives, energies, equilibria, manufactured, places, solutions, solving, whole
from spinestiff.verification.outcome import Check, judged

# What is checked, by the number that the names of checks begin with. docs/validation.md has the tolerances.
ITEMS = {
    "A1": "gradient of every energy term against complex steps",
    "A2": "Hessian against dual numbers over complex steps; its symmetry",
    "A3": "objectivity: a torso moved as a whole has the same energy and turned forces",
    "A4": "internal forces have no resultant and no moment",
    "A5": "zero modes: six of a free torso, one more for each absent stiffness of a joint",
    "A6": "Hooke's law at small strain",
    "A7": "finite uniaxial stress, volume and energy of an affine map in closed form",
    "A8": "simple shear and hydrostatic stress in closed form",
    "A9": "inverted elements have infinite energy, and no step into them is accepted",
    "A10": "a joint's energy along each axis; logarithm and update of rotations",
    "B1": "patch test under a finite affine map, and under a rigid motion with a bone inside",
    "B2": "a bar under uniaxial stress",
    "B3": "a block of tissue, bones and a joint in series and in parallel",
    "B4": "chains of joints under an end moment, joints in series and in parallel",
    "B5": "a planar chain against another minimiser, and its limit, the elastica",
    "B6": "cantilevers against Timoshenko's beam",
    "B7": "orders of convergence to a manufactured solution at finite strain",
    "B8": "the three-point reactions",
    "C1": "quadratic convergence of Newton's method; the coordinates its steps are taken in",
    "C2": "energy never rises, the end is a minimum, and only a balanced one counts",
    "C3": "loads and reactions balance; a support with nothing to do changes nothing",
    "C4": "turned, shifted, mirrored, in other units: the same answer",
    "C5": "renumbered, or started elsewhere: the same answer",
    "C6": "reciprocity; no load, no displacement",
    "C7": "direct solvers against dense algebra and conjugate gradients",
    "C8": "twice as stiff, half as far; a joint without give is a weld",
    "D1": "adjoint, forward and dense sensitivities agree",
    "D2": "slope of the Taylor remainder",
    "D3": "sensitivities against differences of whole solves",
    "D4": "a gradient's error goes with the residual; it is refused above 1e-8 of the load",
    "D5": "shares of the force add up, and are its derivatives in the ratios",
    "D6": "image features and their derivatives",
    "D7": "Gauss-Newton matrix of a fit that leaves no residual",
    "gold": "numbers of the shipped model as stored; each beside independent checks",
}

Group = Callable[[], Iterator[Check]]
OnCheck = Callable[[Check], None]
# The quick ones first.
GROUPS: tuple[Group, ...] = (
    *energies.GROUPS,
    *solutions.GROUPS,
    *solving.GROUPS,
    *equilibria.GROUPS,
    *derivatives.GROUPS,
    *places.GROUPS,
    energies.sweep,
    solving.inverting_steps,
    *manufactured.GROUPS,
    *whole.GROUPS,
)


def run_checks(observer: OnCheck | None = None, groups: tuple[Group, ...] = GROUPS) -> list[Check]:
    """Every check, in order; ``observer`` sees each as it is done. About 30 s of one core.

    A group that fails to run counts as a failed check: a broken installation is to be reported, not thrown.
    """
    done: list[Check] = []
    for group in groups:
        for check in _guarded(group):
            done.append(check)
            if observer:
                observer(check)
    return done


def _guarded(group: Group) -> Iterator[Check]:
    try:
        yield from group()
    except Exception as error:  # any error at all is the finding
        yield judged(f"{group.__name__}: did not run ({type(error).__name__}: {error})", float("inf"), 0.0)
