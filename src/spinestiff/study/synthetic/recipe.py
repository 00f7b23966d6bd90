"""What kind of synthetic subject to make: body, curve, stiffness, and the pushes and radiographs of its visit."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Literal

import numpy as np

from spinestiff.anatomy.stiffness import RATIO_BOUNDS
from spinestiff.anatomy.template import OWN_MESH
from spinestiff.errors import SubjectError
from spinestiff.imaging.synthetic.acquisition import LATERAL, Acquisition
from spinestiff.imaging.synthetic.detector import Exposure
from spinestiff.personalise.rebuild import NODES
from spinestiff.study.synthetic.elastic_supports import SyntheticSupports
from spinestiff.study.synthetic.stiffening import Stiffening
from spinestiff.subject.marker_table import FEWEST, MOST
from spinestiff.subject.records import GAUGE_LIMIT_N, Role


@dataclass(frozen=True)
class SyntheticPush:
    """One push of a synthetic subject, frame by frame.

    Attributes
    ----------
    id : name in ``subject.json``.
    level : rib level of the push point, 1 to 12.
    shares : force of each frame over the recipe's largest. The first is 0: corners are marked in an unloaded frame.
    roles : of each frame.
    other_side : from the side opposite the recipe's other pushes.

    Raises
    ------
    SubjectError : the first share is not 0, one is outside 0 to 1, or shares and roles are not as many.
    """

    id: str
    level: float
    shares: tuple[float, ...]
    roles: tuple[Role, ...]
    other_side: bool = False

    def __post_init__(self) -> None:
        if not self.shares or self.shares[0] != 0.0 or not all(0.0 <= share <= 1.0 for share in self.shares):
            raise SubjectError(f"push '{self.id}': shares {self.shares}; wanted 0 first, then 0 to 1")
        if len(self.roles) != len(self.shares):
            raise SubjectError(
                f"push '{self.id}': {len(self.shares)} shares and {len(self.roles)} roles; wanted one of each a frame"
            )


PAPER_PUSHES = (
    SyntheticPush(
        "main",
        level=8.0,
        shares=(0.0, 1 / 6, 1 / 3, 1 / 2, 2 / 3, 5 / 6, 1.0),
        roles=("unused", "unused", "training", "unused", "training", "unused", "validation"),
    ),
    SyntheticPush(
        "second", level=6.0, shares=(0.0, 1 / 3, 2 / 3, 1.0), roles=("unused", "unused", "unused", "validation")
    ),
)
PLANNED_PUSHES = (
    SyntheticPush("rib-5", level=5.0, shares=(0.0, 1 / 2, 1.0), roles=("unused", "training", "training")),
    SyntheticPush("rib-9", level=9.0, shares=(0.0, 1.0), roles=("unused", "training")),
    SyntheticPush("rib-7", level=7.0, shares=(0.0, 2 / 3, 1.0), roles=("unused", "validation", "validation")),
)
ACQUISITIONS: Mapping[str, tuple[SyntheticPush, ...]] = {"planned": PLANNED_PUSHES, "paper": PAPER_PUSHES}
"""Of a visit: three loaded frames at two ribs far apart, as ``spinestiff plan`` proposes them on the convex side, with
another rib held out; and the paper's, a third and two thirds of the force at one rib, with the whole of it and another
rib held out."""


@dataclass(frozen=True)
class Recipe:
    """What kind of subject to make.

    Attributes
    ----------
    seed : of everything random.
    height_cm, cobb_deg, curve : body and rest curve (Cobb above 0: left-convex).
    force_n : largest push.
    ratios : true lateral bending and tissue ratio; drawn from Table 4's range if None.
    spine : table and id of a real spine as rest shape, instead of ``cobb_deg`` and ``curve``.
    pushes : their rib levels, frames and roles; ids differ.
    shape : rows, columns of a radiograph; the detector keeps its width.
    mesh : of the subject's tissue, carried to its shape: "own", which shares nothing with the estimator's, or one of
        these, "coarse" or "fine", which is no test of an estimate on the same.
    nodes : about how many (``rebuild.NODES``; 0.8 to 1.5 times that) of a mesh built for this subject alone, in its
        shape and with points drawn by ``seed`` (extra [mesh]); goes with "own".
    acquisition : how the radiographs are taken; four a second (paper 2.1).
    lateral_exposure : of the lateral rest radiograph.
    supports : how much belt and shoulder's pad give under ``force_n``; drawn from 0 to 4 degrees and 0 to 4 mm if None.
    biplanar : each frame of a push has a lateral radiograph, too, and pedicles are marked in all frontal ones.
    markers : on the skin of front and flanks, seen by cameras in each frame of a push; 0 = none.
    age, sex : whose body it is, with ``height_cm`` and the usual mass; years, 8 to 100.
    side : that is pushed; None: the convex one, which straightens the curve.
    secondary : deflection of a second curve to the other side, over the first one's (``spines.curved_spine``).
    stiffening : of the discs; None: linear, as the estimator's.
    misread : forces are told as a gauge with the errors of ``estimation.priors.Priors`` reads them, and rib levels as
        somebody feels them, instead of as they are.
    """

    seed: int = 0
    height_cm: float = 157.0
    cobb_deg: float = 12.0
    curve: str = "thoracic"
    force_n: float = 60.0
    ratios: tuple[float, float] | None = None
    spine: tuple[Path, str] | None = None
    pushes: tuple[SyntheticPush, ...] = PAPER_PUSHES
    shape: tuple[int, int] = (1024, 1024)
    mesh: str = OWN_MESH
    nodes: int | None = None
    acquisition: Acquisition = field(default_factory=Acquisition)
    lateral_exposure: Exposure = LATERAL
    supports: SyntheticSupports | None = None
    biplanar: bool = False
    markers: int = 0
    age: float = 13.0
    sex: Literal["female", "male"] = "female"
    side: Literal["left", "right"] | None = None
    secondary: float = 0.0
    stiffening: Stiffening | None = None
    misread: bool = False

    def __post_init__(self) -> None:
        if self.seed < 0:
            raise SubjectError(f"seed {self.seed}; wanted 0 or more")
        if not 0.0 < self.force_n <= GAUGE_LIMIT_N:
            raise SubjectError(f"force {self.force_n} N; wanted above 0 and at most {GAUGE_LIMIT_N:g}")
        if self.nodes is not None and not NODES[0] <= self.nodes <= NODES[1]:
            raise SubjectError(f"{self.nodes} nodes; wanted {NODES[0]} to {NODES[1]}")
        if self.nodes is not None and self.mesh != OWN_MESH:
            raise SubjectError(f"nodes {self.nodes} of mesh '{self.mesh}'; wanted mesh '{OWN_MESH}', or no nodes")
        if self.markers and not FEWEST <= self.markers <= MOST:
            raise SubjectError(f"{self.markers} markers; wanted 0, or {FEWEST} to {MOST}")
        low, high = RATIO_BOUNDS
        for value in self.ratios or ():
            if not low <= value <= high:
                raise SubjectError(f"stiffness ratio {value}; wanted {low} to {high}")
        if self.pushes and all(push.other_side for push in self.pushes):
            raise SubjectError("all pushes are from the other side; wanted at least one that isn't")
        ids = [push.id for push in self.pushes]
        if not ids or len(set(ids)) < len(ids):
            raise SubjectError(f"pushes {', '.join(ids) or 'none'}; wanted at least one, each with an id of its own")

    def as_record(self) -> dict[str, object]:
        """As written into the truth file."""
        own = {f.name: getattr(self, f.name) for f in fields(self)}
        spine = None if self.spine is None else [self.spine[0].name, self.spine[1]]
        return {
            **own,
            "ratios": None if self.ratios is None else list(self.ratios),
            "shape": list(self.shape),
            "spine": spine,
            "pushes": [
                {
                    "id": push.id,
                    "level": push.level,
                    "shares": list(push.shares),
                    "roles": list(push.roles),
                    "other_side": push.other_side,
                }
                for push in self.pushes
            ],
            "acquisition": asdict(self.acquisition, dict_factory=_plain),
            "lateral_exposure": asdict(self.lateral_exposure, dict_factory=_plain),
            "supports": None if self.supports is None else asdict(self.supports),
            "stiffening": None if self.stiffening is None else asdict(self.stiffening),
        }


def _plain(items: list[tuple[str, object]]) -> dict[str, object]:
    return {key: value.tolist() if isinstance(value, np.ndarray) else value for key, value in items}
