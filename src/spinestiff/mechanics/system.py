"""A torso on its supports as equations: what Newton's method, sensitivities and diagnosis ask of it (Eqs. 4-7).

The unknowns are those of ``anatomy.state.retract``; held ones are equations, too, with the identity as their tangent.
"""

from __future__ import annotations

import copy
from collections.abc import Iterator, Sequence
from typing import ClassVar, NamedTuple, Self

import numpy as np

from spinestiff.anatomy.state import TorsoState
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.arrays import Floats, ShortRepr
from spinestiff.errors import EquilibriumError, TorsoError
from spinestiff.mechanics.assembly import ROTATION_LENGTH, Law, Stiffness
from spinestiff.mechanics.factor import Analysis, Factor
from spinestiff.mechanics.kinematics import Kinematics
from spinestiff.mechanics.loads import LoadCase
from spinestiff.mechanics.mechanisms import require_no_mechanism
from spinestiff.mechanics.multilevel import MANY_DOFS, TWO_LEVEL, TwoLevelAnalysis, corner_prolongation
from spinestiff.mechanics.places import OBLIQUITY, SupportPlace, held_pelvis, shifted_shoulder, turned_with_pelvis
from spinestiff.mechanics.potential import Potential
from spinestiff.mechanics.supports import Reaction, SupportKind, Supports, switched
from spinestiff.mechanics.terms import Term

RELATIVE_TOLERANCE = 1e-10
ABSOLUTE_TOLERANCE = 1e-8  # N


class Factorised(NamedTuple):
    """The tangent stiffness of a state: its ``hessian``, values in the potential's pattern, and ``factor``.

    The Hessian has the rows and columns of held degrees of freedom; in the factor they are the identity's.
    """

    hessian: Floats
    factor: Factor


class System(ShortRepr):
    """The equations of a torso on its supports: pattern, symbolic analysis and constant data are built once.

    Parameters
    ----------
    torso, supports : what is solved.
    terms : further energies of single bones and nodes, e.g. image terms (``mechanics.terms.Term``).
    backend : sparse solver, see ``mechanics.factor.Analysis``, or "two-level" (``mechanics.multilevel``), which is also
        taken where none is named here, whatever the environment says, and ten-node elements have more than 80,000
        unknowns.
    laws : further energies that couple bones or nodes (``mechanics.assembly.Law``).

    Raises
    ------
    TorsoError : supports of another number of bones.

    Attributes
    ----------
    potential : energy, gradient and Hessian.
    kinematics : relative coordinates.
    held : indices of held degrees of freedom.
    place : where pelvis and shoulder are; None: what is held stays where a solve's start has it.
    """

    SHOWN_BY: ClassVar[str] = "spinestiff.mechanics.picture:html_of_problem"

    def __init__(
        self,
        torso: TorsoModel,
        supports: Supports,
        terms: Sequence[Term] = (),
        backend: str | None = None,
        laws: Sequence[Law] = (),
    ) -> None:
        _require_fitting(supports, len(torso.bone_names))
        self.torso = torso
        self.supports = supports
        self.terms, self.laws = tuple(terms), tuple(laws)
        self.place: SupportPlace | None = None
        self.potential = Potential(torso, laws)
        self.kinematics = Kinematics(torso, supports)
        scale = np.ones(self.potential.dofs)
        scale[: 6 * self.potential.bones].reshape(-1, 6)[:, 3:] /= ROTATION_LENGTH
        pattern = self.potential.pattern
        many = backend is None and self.potential.dofs > MANY_DOFS and torso.tissue.elements.shape[1] == 10
        self._analysis: Analysis | TwoLevelAnalysis
        if many or backend == TWO_LEVEL:
            prolongation = corner_prolongation(self.potential)
            self._analysis = TwoLevelAnalysis(pattern.indptr, pattern.indices, prolongation, scale)
        else:
            self._analysis = Analysis(pattern.indptr, pattern.indices, backend, scale)
        self.held = held = np.flatnonzero(supports.held.ravel())
        columns = np.repeat(np.arange(self.potential.dofs), np.diff(pattern.indptr))
        mask = np.zeros(self.potential.dofs, dtype=bool)
        mask[held] = True
        self._held_entries = np.flatnonzero(mask[columns] | mask[pattern.indices])
        self._held_diagonal = pattern.indptr[held]
        self._held_with: tuple[np.ndarray, np.ndarray] | None = None  # what was stiff when mechanisms were looked for

    @property
    def backend(self) -> str:
        """The linear solver in use."""
        return self._analysis.backend

    def with_terms(self, terms: Sequence[Term]) -> Self:
        """The same with other ``terms``; shares pattern and analysis."""
        other = copy.copy(self)
        other.terms = tuple(terms)
        other._held_with = None
        return other

    def with_supports(self, supports: Supports) -> Self:
        """The same on other springs, given as at rest; keeps the ``place``, shares pattern and analysis.

        Raises
        ------
        EquilibriumError : other degrees of freedom are held, or the place is of a pad that these springs lack.
        TorsoError : a spring on a bone that there is not.
        """
        if not np.array_equal(supports.held, self.supports.held):
            raise EquilibriumError("the supports hold other degrees of freedom than the problem's; build a new problem")
        _require_fitting(supports, len(self.torso.bone_names))
        return self._on(shifted_shoulder(supports, self.place.shoulder_mm) if self.place else supports)

    def with_acting(self, acting: np.ndarray) -> Self:
        """The same without the stiffness of springs that don't act; ``acting`` (S,) bool."""
        return self._on(switched(self.supports, acting))

    def _on(self, supports: Supports) -> Self:
        """The same on these springs as they are."""
        other = self.with_terms(self.terms)
        other.supports = supports
        return other

    def with_place(self, place: SupportPlace) -> Self:
        """The same with pelvis and shoulder elsewhere; shares pattern and analysis.

        Raises
        ------
        EquilibriumError : an obliquity is asked of a pelvis that is free to turn, or a place of a shoulder without pad.
        """
        if place.obliquity:
            held_pelvis(self.torso, self.supports)
        before = self.place.shoulder_mm if self.place else 0.0
        other = self._on(shifted_shoulder(self.supports, place.shoulder_mm - before))
        other.place, other._held_with = place, self._held_with  # what is held stays so in another place
        return other

    def placed(self, state: TorsoState) -> TorsoState:
        """The state with the pelvis where it is held; on a hinge it stands where the state has it."""
        if self.place is None or not self.supports.held[self.torso.bone("pelvis"), OBLIQUITY]:
            return state
        return turned_with_pelvis(self.torso, state, self.place.obliquity)

    def all_terms(self, load: LoadCase) -> tuple[Term, ...]:
        """Load, springs of the supports and further terms. Raises TorsoError for a load on what the torso lacks."""
        load.require_on(self.torso.rest_pose)
        return (load, self.supports.springs, *self.terms)

    def require_held(self, stiffness: Stiffness) -> None:
        """Raise EquilibriumError, naming it, if a part of the torso can move freely at rest; asked once a stiffness."""
        present = (stiffness.joints > 0.0, stiffness.mu > 0.0)
        if self._held_with is None or not all(map(np.array_equal, self._held_with, present)):
            require_no_mechanism(self.torso, self.supports, stiffness, self.terms, self.laws)
            self._held_with = present

    def free(self, values: Floats) -> Floats:
        """A copy of values (dofs,) or (dofs, k) with zero at held degrees of freedom."""
        values = np.array(values, dtype=float)
        values[self.held] = 0.0
        return values

    def tangent(self, state: TorsoState, stiffness: Stiffness, terms: Sequence[Term]) -> Factorised:
        """The tangent stiffness in a state, factorised, and the Hessian that it is made of."""
        hessian = self.potential.hessian(state, stiffness, terms)
        return Factorised(hessian, self.numeric_factor(hessian))

    def factorise(self, state: TorsoState, stiffness: Stiffness, terms: Sequence[Term]) -> Factor:
        """The factor of ``tangent`` alone."""
        return self.tangent(state, stiffness, terms).factor

    def numeric_factor(self, values: Floats) -> Factor:
        """Factor of a Hessian's values (in the potential's pattern) with held DoFs replaced by the identity."""
        values = values.copy()
        values[self._held_entries] = 0.0
        values[self._held_diagonal] = 1.0
        return self._analysis.factor(values)

    def tolerance(self, load: LoadCase) -> float:
        """Residual, N, at which a state counts as an equilibrium."""
        return max(RELATIVE_TOLERANCE * load.size, ABSOLUTE_TOLERANCE)

    def residual_norm(self, gradient: Floats) -> float:
        """Largest force of a gradient (dofs,), moments over ``ROTATION_LENGTH``."""
        bones = gradient[: 6 * self.potential.bones].reshape(-1, 6)
        turning = np.abs(bones[:, 3:]).max(initial=0.0) / ROTATION_LENGTH
        rest = np.abs(gradient[6 * self.potential.bones :]).max(initial=0.0)
        return float(np.max([np.abs(bones[:, :3]).max(initial=0.0), turning, rest]))  # not max(): it can lose a NaN

    def reactions(self, state: TorsoState, gradient: Floats) -> tuple[Reaction, ...]:
        """What the supports exert in ``state``, for the gradient there with held DoFs as they are."""
        reactions = []
        held = np.where(self.supports.held, gradient[: 6 * self.potential.bones].reshape(-1, 6), 0.0)
        for bone in np.flatnonzero(self.supports.held.any(1)):
            name = self.torso.bone_names[bone]
            force, moment = held[bone, :3], held[bone, 3:]
            reactions.append(Reaction(name, SupportKind.HELD, state.bone_positions[bone], force, moment))
        springs = self.supports.springs
        places, forces = springs.points.positions(state), springs.forces(state)
        names, kinds = self.supports.names, self.supports.kinds
        reactions += [Reaction(*own, np.zeros(3)) for own in zip(names, kinds, places, forces)]
        return tuple(reactions)

    def _facts(self) -> Iterator[str]:
        yield f"{self.potential.bones} bones"
        yield f"{self.potential.dofs} unknowns"
        yield f"{len(self.held)} held"
        yield f"{len(self.supports.names)} springs"
        yield f"{len(self.terms)} further terms"
        yield self.backend


def _require_fitting(supports: Supports, bones: int) -> None:
    if len(supports.held) != bones:
        raise TorsoError(f"supports hold {len(supports.held)} bones, but the torso has {bones}")
    last = supports.springs.points.bone.max(initial=-1)
    if last >= bones:
        raise TorsoError(f"a support's spring holds bone {last}, but the torso has {bones}")
