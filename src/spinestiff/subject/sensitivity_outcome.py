"""How an estimate changes with what it was made from, as a file in ``results/``: its schema."""

from __future__ import annotations

from typing import ClassVar, Literal

from pydantic import Field

from spinestiff.anatomy.template import Mesh
from spinestiff.subject.outcome_parts import Outcome, OutcomeFile

Series = Literal["weighed", "tied", "kept", "everything"]
"""Of refits: by the weighed fit, the estimate's own ratios; by the paper's, bending and tissue with lambda tied to mu,
the same with lambda kept at its default, and one ratio for every stiffness."""
Change = Literal["nothing", "start", "force", "push level", "corners", "mesh", "default modulus", "geometry"]


class Refit(Outcome):
    """An estimate made again with one thing changed.

    Attributes
    ----------
    what, by : what was changed, and by how much in words, e.g. "force" by "+10 %". With "start" only where the search
        begins: what it changes, the search leaves open.
    ratios : name -> estimate; empty where there is none, ``note`` says why.
    percent : name -> change of the ratio against the series' refit with nothing changed.
    stiffness_percent : the same of the stiffness, which is another where the default that it is a ratio to was changed.
    at_bound : names at a bound of the fit.
    """

    series: Series
    what: Change
    by: str
    ratios: dict[str, float]
    percent: dict[str, float]
    stiffness_percent: dict[str, float]
    at_bound: tuple[str, ...] = ()
    note: str = ""


class Sensitivity(OutcomeFile):
    """``sensitivity.json``: refits with force, push level, corners, mesh, default modulus and geometry changed.

    Attributes
    ----------
    basis : digest of the estimate that was refitted and of the mesh, so that refits that are there need not be redone.
    mesh : of the refits.
    parameters : the estimate's ratios. estimate : their values.
    interval95 : name -> ends of the estimate's interval; None where it has none.
    open_ends : name -> whether its lower and its upper end are the fit's bounds, of those of which one is.
    refits : in the order in which they are made; with ``complete`` all of them.
    force_percent : series -> name -> change for 10 % of force, mean of both signs (Table 7); without a series, or a
        name in it, that has no refit for one of the signs.
    notes : what could not be changed, and why.
    """

    FILE: ClassVar[str] = "sensitivity.json"
    STEP: ClassVar[str] = "sensitivity"
    basis: str
    mesh: Mesh
    parameters: tuple[str, ...]
    estimate: dict[str, float]
    interval95: dict[str, tuple[float, float] | None]
    open_ends: dict[str, tuple[bool, bool]] = Field(default={})
    refits: tuple[Refit, ...]
    force_percent: dict[Series, dict[str, float]]
    complete: bool
    notes: tuple[str, ...] = ()
