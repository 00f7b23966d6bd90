"""Made-up outcomes of a study's subjects."""

from __future__ import annotations

from spinestiff.study.parameters import SIX
from spinestiff.subject.assessment_outcome import CobbChangeRecord
from spinestiff.subject.estimate_outcome import RatioEstimate
from spinestiff.subject.study_outcome import FrameOutcome, SubjectOutcome

PREDICTORS = {
    "rest": 1.2,
    "default": 1.0,
    "fit": 0.2,
    "forecast": 0.05,
    "fitted_supports": 0.19,
    "extrapolation": 0.25,
    "single_ratio": 0.3,
    "truth": 0.18,
}


def change(value: float) -> CobbChangeRecord:
    """The same in all three forms, but for the sign's jump of the first."""
    return CobbChangeRecord(
        signed=value + 10.0, fixed_levels=value, tilt=value - 1.0, levels=("T5", "T9"), tilt_levels=("T4", "L1")
    )


def frame(push: str, size: float = 10.0, cobb: float = -16.0, error: float = 1.0) -> FrameOutcome:
    """Errors in proportion to ``size``, mm; the estimate's Cobb angle is off by ``error``, the default's is 0."""
    return FrameOutcome(
        push=push,
        told_n=50.0,
        true_n=49.2,
        rmse_mm={name: size * share for name, share in PREDICTORS.items()},
        motion_mm={name: 0.5 * size * share for name, share in PREDICTORS.items() if name != "forecast"},
        cobb_deg={
            "measured": change(cobb),
            "default": change(0.0),
            "fit": change(cobb + error),
            "forecast": change(cobb + 0.5),
            "truth": change(cobb),
        },
        inside95=0.95,
    )


def outcome(number: int = 1, size: float = 10.0, name: str = "", **changed: object) -> SubjectOutcome:
    """A subject whose ratios are found 10 % too high."""
    truth = {"lateral_bending": 0.1 * number, "tissue": 0.02 * number}
    fields: dict[str, object] = {
        "program": "1",
        "settings": "digest",
        "mesh": "fine",
        "name": name or f"subject-{number}",
        "age": 11.0,
        "sex": "female",
        "height_cm": 157.0,
        "curve": "thoracic",
        "force_n": -59.0,
        "cobb_deg": 11.0,
        "change_deg": -20.0,
        "truth": truth,
        "ratios": {
            key: RatioEstimate.of(1.1 * value, (0.8 * value, 1.5 * value), (False, False), False)
            for key, value in truth.items()
        },
        "inside": True,
        "tissue_kpa": (3.0 * number, 3.3 * number, 2.4 * number, 4.5 * number),
        "status": "CONVERGED",
        "failed": (),
        "initial_mm": 2.3,
        "rest_cobb_deg": (11.2, 12.0),
        "training_mm": {"default": size, "fit": 0.2 * size},
        "gradient": {key: 100.0 * (rank + 1) for rank, key in enumerate(SIX)},
        "force_percent": {"lateral_bending": 8.0, "tissue": 11.0},
        "missing": (),
        "frames": tuple(frame(push, size) for push in ("main", "other-rib", "other-side")),
        "cpu_seconds": {"make": 50.0, "estimate": 90.0},
    }
    return SubjectOutcome.model_validate({**fields, **changed})
