"""What a row of a log says of an estimate whose truth is known, as ``counted_intervals.py`` counts it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from counted_intervals import NAMES

from spinestiff.errors import EquilibriumError
from spinestiff.estimation.fitted import FitEnd, StiffnessFit
from spinestiff.estimation.profiles import WIDTH_FACTOR
from spinestiff.estimation.tracing import Profile
from spinestiff.study.fits import rise_of
from spinestiff.study.trials import PushSet


def solved_at_truth(pushes: PushSet, fit: StiffnessFit, truth: Mapping[str, float]) -> dict[str, Any]:
    """The rise at the true ratios with the model solved there: far outside a region the emulator says too much."""
    if fit.weighed is None or not fit.status.usable:
        return {}
    try:
        states = [one.state for one in fit.equilibria]
        rise = rise_of(pushes, FitEnd.of(fit), truth, rmse_mm=fit.rmse_mm, starts=states)
    except EquilibriumError:
        return {"joint_solved": None}
    return {"joint_solved": rise / WIDTH_FACTOR**2}


def told(fit: StiffnessFit, truth: Mapping[str, float]) -> dict[str, Any]:
    """What is asked of an estimate whose truth is known."""
    likely, weighed = fit.likely, fit.weighed
    if likely is None or weighed is None or likely.emulator is None:
        return {"status": fit.status.name, "evaluations": len(fit.history)}
    at = np.log([truth[name] for name in NAMES])
    best = np.log(fit.ratios.values)
    rises = [risen(profile, at[i]) for i, profile in enumerate(likely.profiles)]
    joint = float(likely.emulator.psi(at)[0] - likely.emulator.psi(best)[0])
    return {
        "status": fit.status.name,
        "estimate": fit.ratios.as_dict(),
        "low": np.exp(likely.low).tolist(),
        "high": np.exp(likely.high).tolist(),
        "open": (likely.open_low | likely.open_high).tolist(),
        "kinds": list(likely.kinds),
        "settled": likely.settled,
        # Signed root of twice the rise at the truth, in units of the intervals: standard normal, if all is well.
        "z": [float(np.sign(a - b) * np.sqrt(2.0 * max(r, 0.0)) / WIDTH_FACTOR) for a, b, r in zip(best, at, rises)],
        "joint": 2.0 * joint / WIDTH_FACTOR**2,
        "p_value": weighed.p_value,
        "tracking_factor": weighed.tracking_factor,
        "outlying": len(weighed.outlying),
        "rmse_mm": fit.rmse_mm,
        "evaluations": len(fit.history),
        "factorisations": fit.cost.factorisations,
    }


def risen(profile: Profile, at: float) -> float:
    """A profile's rise over its least, as a parabola between its places and beyond its ends, outside any interval."""
    where, root = profile.log_ratios, np.sqrt(profile.rise - profile.rise.min())
    if where[0] <= at <= where[-1]:
        return float(np.interp(at, where, root) ** 2)
    end, least = (0 if at < where[0] else -1), where[int(np.argmin(root))]
    return float((root[end] * (at - least) / (where[end] - least)) ** 2)
