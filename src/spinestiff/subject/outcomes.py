"""What the steps find, as files in ``results/``: their schemas, written and read in one place."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict


class Outcome(BaseModel):
    """What every record of a result is: frozen, without unknown keys, without NaN."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Check(Outcome):
    """Whether one thing about a result can be right.

    Attributes
    ----------
    name : of the check, e.g. "rest and push torso".
    value, limit : what was found and the largest that passes, in the unit of ``text``; None where there is none.
    passed : None = not possible, since the data for it are missing; ``text`` says which.
    text : one line; of a failed check the causes to look for, the most likely first.
    """

    name: str
    value: float | None
    limit: float | None
    passed: bool | None
    text: str
