"""Default stiffness of joints and tissue, and the ratios that scale them (paper Table 1 and 4.3).

The only place that holds literature values of stiffness. Units inside: N/mm, N mm/rad, MPa.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from spinestiff.anatomy.names import INTERVERTEBRAL, JOINTS
from spinestiff.arrays import Floats, ShortRepr, read_only
from spinestiff.errors import TorsoError

# Paper Table 1, in its units: kN/m = N/mm for translation (x, y, z); its "N/rad" for rotation (alpha, beta, gamma)
# is read as N m/rad (docs/errata.md).
TABLE_1: dict[str, tuple[float, float, float, float, float, float]] = {
    "thoracic": (262.0, 1720.0, 262.0, 154.0, 137.0, 154.0),
    "lumbar": (245.0, 1720.0, 245.0, 143.0, 498.0, 149.0),
    "rib_vertebra": (53.9, 123.0, 123.0, 9.7, 6.87, 6.87),
    "rib_sternum": (51.85, 8.0, 8.0, 9.7, 2.29, 2.29),
    "sternum_clavicle": (1e4, 1e4, 1e4, 1e4, 1.0, 1.0),
    "clavicle_scapula": (1e4, 1e4, 1e4, 1.0, 1.0, 1.0),
    "scapula_humerus": (1e4, 1e4, 1e4, 1.0, 1.0, 1.0),
}
NMM_PER_NM = 1000.0
KINDS = tuple(joint.kind for joint in JOINTS)  # of the whole torso's joints, rows of Table 1

# Young's modulus of the default tissue, MPa. Calibrated by benchmarks/calibrate_tissue.py with the pelvis level, not a
# literature value: the paper delegates it to Koutras 2021, whose values are not public.
DEFAULT_YOUNG_MPA = 0.15
DEFAULT_POISSON = 0.45

# A joint's three shifts and three turns, as columns of the stiffness table.
JOINT_AXES = ("x", "y", "z", "alpha", "beta", "gamma")
# The six directions of an intervertebral joint (paper 3.1), clinical name -> column of the stiffness table.
DIRECTIONS = {
    "lateral_shear": 0,
    "separation": 1,
    "sagittal_shear": 2,
    "flexion_extension": 3,
    "axial_rotation": 4,
    "lateral_bending": 5,
}
# The paper's ratio of lateral bending. At the default, Table 1's rib cage stiffens the thorax about as cadavers show
# (+32 % of motion in lateral bending once it is open; Liebsch et al. 2017 find 16 to 42 %); left there while the ratio
# falls to 0.02, it would carry the thorax alone (+285 %). So "lateral_bending" scales the sternal joints along (+71 %;
# docs/validation.md).
INTERVERTEBRAL_BENDING = "intervertebral_bending"
# The ribs' turning on their vertebrae: bench values are a tenth of Table 1's.
RIB_ROTATION = "rib_rotation"
TISSUE_PARAMETERS = {"tissue": (True, True), "tissue_mu": (True, False), "tissue_lambda": (False, True)}
# "tissue": one ratio for both Lame parameters, so that Poisson's ratio stays (default). The paper's literal mode
# scales tissue_mu alone; it locks on linear tetrahedra (docs/errata.md).
# Between which a fit looks for a ratio: a third of the smallest and more than three times the largest that a subject of
# known stiffness has (bending 0.0075 to 0.84, tissue 0.0075 to 0.8), so that an interval may end before its bound.
RATIO_BOUNDS = (0.0025, 5.0)


def joint_stiffness() -> Floats:
    """Default stiffness of all joints, (67, 6): N/mm for x, y, z and N mm/rad for alpha, beta, gamma."""
    table = np.array([TABLE_1[joint.kind] for joint in JOINTS])
    table[:, 3:] *= NMM_PER_NM
    return table


def lame_parameters(young: float, poisson: float) -> tuple[float, float]:
    """Lame's mu and lambda (unit of ``young``) of an isotropic material."""
    if not young > 0.0 or not -1.0 < poisson < 0.5:
        raise TorsoError(f"Young's modulus {young} and Poisson's ratio {poisson}: wanted > 0 and in (-1, 0.5)")
    return young / (2.0 * (1.0 + poisson)), young * poisson / ((1.0 + poisson) * (1.0 - 2.0 * poisson))


@dataclass(frozen=True, repr=False)
class ParameterGroup(ShortRepr):
    """The stiffnesses that one ratio scales.

    Attributes
    ----------
    name : e.g. "lateral_bending".
    joints : (J, 6) bool, entries of the joints' stiffness table.
    mu, lambda_ : whether the tissue's Lame parameters belong to it.
    elements : (T,) bool, the mesh's elements in which they do; None: in all.
    """

    name: str
    joints: np.ndarray
    mu: bool = False
    lambda_: bool = False
    elements: np.ndarray | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "joints", read_only("joints", self.joints, (None, 6), TorsoError, bool))
        if self.elements is not None:
            object.__setattr__(self, "elements", read_only("elements", self.elements, (None,), TorsoError, bool))

    def joints_of(self, count: int) -> np.ndarray:
        """(J, 6) bool, the entries of a table of ``count`` joints; TorsoError if they are another torso's."""
        if len(self.joints) != count:
            raise TorsoError(f"'{self.name}' names {len(self.joints)} joints, the torso has {count}")
        return self.joints

    def elements_of(self, count: int) -> np.ndarray:
        """(T,) bool, the elements of a mesh of ``count`` elements; TorsoError if they are another mesh's."""
        if self.elements is None:
            return np.ones(count, dtype=bool)
        if len(self.elements) != count:
            raise TorsoError(f"'{self.name}' names {len(self.elements)} tissue elements, the mesh has {count}")
        return self.elements

    def within(self, name: str, joints: np.ndarray | None = None, elements: np.ndarray | None = None) -> ParameterGroup:
        """The part of this group at some ``joints`` (J,) bool and in some ``elements`` (T,) bool; None: all it has.

        ``TorsoModel.joints_among`` tells the joints of some levels.

        Raises
        ------
        TorsoError : a mask of another length than this group's.
        """
        at = np.ones(len(self.joints), dtype=bool) if joints is None else joints
        at = read_only("joints", at, (len(self.joints),), TorsoError, bool)
        inside = self.elements
        if elements is not None:
            count = None if inside is None else len(inside)
            inside = read_only("elements", elements, (count,), TorsoError, bool) & (True if inside is None else inside)
        return ParameterGroup(name, self.joints & at[:, None], self.mu, self.lambda_, inside)


def parameter_group(name: str, kinds: tuple[str, ...]) -> ParameterGroup:
    """The group of a parameter's name, for joints of the given ``kinds`` (J names of Table 1's rows).

    Names: the six directions of the intervertebral joints (``DIRECTIONS``), with lateral bending also the joints of
    ribs and sternum; "intervertebral_bending", the same without them (the paper's); "rib_rotation", the turning of the
    ribs on their vertebrae; "tissue", "tissue_mu", "tissue_lambda"; a row of Table 1 (all six directions of that kind);
    "everything".

    Raises
    ------
    TorsoError : unknown name.
    """
    mask = np.zeros((len(kinds), 6), dtype=bool)
    mu = lambda_ = False
    if name in DIRECTIONS or name == INTERVERTEBRAL_BENDING:
        column = DIRECTIONS.get(name, DIRECTIONS["lateral_bending"])
        mask[[kind in INTERVERTEBRAL for kind in kinds], column] = True
        if name == "lateral_bending":
            mask[[kind == "rib_sternum" for kind in kinds]] = True
    elif name in TISSUE_PARAMETERS:
        mu, lambda_ = TISSUE_PARAMETERS[name]
    elif name == RIB_ROTATION:
        mask[[kind == "rib_vertebra" for kind in kinds], 3:] = True
    elif name in TABLE_1:
        mask[[kind == name for kind in kinds]] = True
    elif name == "everything":
        mask[:] = mu = lambda_ = True
    else:
        known = ", ".join(
            (*DIRECTIONS, INTERVERTEBRAL_BENDING, RIB_ROTATION, *TISSUE_PARAMETERS, *TABLE_1, "everything")
        )
        raise TorsoError(f"unknown stiffness parameter '{name}'; known are {known}")
    return ParameterGroup(name, mask, mu, lambda_)


@dataclass(frozen=True, repr=False)
class StiffnessRatios(ShortRepr):
    """Ratios xi of stiffness over default (paper 3.1: k = xi * k_default); what is not named stays at 1.

    Attributes
    ----------
    groups : what each ratio scales. Groups may overlap; ratios then multiply.
    values : (R,) > 0.
    """

    groups: tuple[ParameterGroup, ...]
    values: Floats

    def __post_init__(self) -> None:
        values = read_only("ratios", self.values, (len(self.groups),), TorsoError)
        if (values <= 0.0).any():
            raise TorsoError(f"stiffness ratios must be positive, found {values.tolist()}")
        object.__setattr__(self, "values", values)

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(group.name for group in self.groups)

    def with_values(self, values: Iterable[float]) -> StiffnessRatios:
        return StiffnessRatios(self.groups, np.asarray(list(values)))

    def as_dict(self) -> dict[str, float]:
        return dict(zip(self.names, self.values.tolist()))

    def scale_joints(self, stiffness: Floats) -> Floats:
        """(J, 6) joint stiffness times every ratio that applies to an entry; TorsoError for a group of other joints."""
        scaled = np.array(stiffness)
        for group, value in zip(self.groups, self.values):
            scaled[group.joints_of(len(scaled))] *= value
        return scaled

    def scale_tissue(self, mu: Floats, lambda_: Floats) -> tuple[Floats, Floats]:
        """(T,) each, Lame's parameters of the mesh's elements times every ratio that applies to an element.

        Raises
        ------
        TorsoError : a group of another mesh's elements.
        """
        scaled = np.array(mu), np.array(lambda_)
        for group, value in zip(self.groups, self.values):
            inside = group.elements_of(len(scaled[0]))
            for modulus, belongs in zip(scaled, (group.mu, group.lambda_)):
                modulus[inside & belongs] *= value
        return scaled

    def _facts(self) -> Iterator[str]:
        yield from (f"{name}={value:.4g}" for name, value in self.as_dict().items())


def stiffness_ratios(ratios: Mapping[str, float], kinds: tuple[str, ...] = KINDS) -> StiffnessRatios:
    """Ratios by name, e.g. ``stiffness_ratios({"lateral_bending": 0.1, "tissue": 0.01})``."""
    groups = tuple(parameter_group(name, kinds) for name in ratios)
    return StiffnessRatios(groups, np.array(list(ratios.values()), dtype=float))
