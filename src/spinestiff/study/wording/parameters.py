"""Which stiffness parameters the radiographs tell of, in words."""

from __future__ import annotations

from collections.abc import Mapping

from spinestiff.study.parameters import table_3_average
from spinestiff.study.wording.numbers import fixed, number
from spinestiff.subject.parameters_outcome import ModelScore, ParameterStudy

TITLES: Mapping[str, str] = {
    "lateral_shear": "lateral translation k_v,x",
    "flexion_extension": "flexion/extension k_v,α",
    "axial_rotation": "axial rotation k_v,β",
    "intervertebral_bending": "lateral bending k_v,γ",
    "tissue_mu": "Lamé's μ",
    "tissue_lambda": "Lamé's λ",
}
LEFT_OUT = {"push": "training pushes", "frame": "training frames", "nothing": "nothing"}
# Of Akaike's criterion: models closer than that are about as good (Burnham and Anderson 2002).
CLOSE = 2.0
# Of an error that counts as less.
LESS = 0.97
# Of lambda's standard deviation, over that before the fit, above which the data say next to nothing.
UNSEEN = 0.9


def gradient_rows(found: ParameterStudy) -> list[tuple[str, str, str, str]]:
    """Title, gradient at the default, at the optimum, and the paper's mean of absolute values."""
    return [
        (TITLES[row.name], fixed(row.default, 2), fixed(row.optimum, 2), fixed(table_3_average(row.name)))
        for row in found.gradient
    ]


def parameter_lines(found: ParameterStudy) -> list[str]:
    """What was found, in sentences."""
    first, second, third = (TITLES[effect.name] for effect in found.effects[:3])
    rest = found.effects[2].estimate_mm / found.effects[1].estimate_mm
    others = 100.0 * (1.0 - sum(effect.share for effect in found.effects))
    lines = [
        f"ranking at the estimate: {', '.join(TITLES[effect.name] for effect in found.effects)}",
        f"{first} and {second} move the spine most; {third}, the next, does {number(rest, 2)} times what {second} does",
        f"shares of what all stiffnesses do together: {_shares(found)}; the remaining "
        f"{fixed(others, 0)} % are ribs, girdle and other joints",
    ]
    two, three = found.models
    lines += _compared(two, three, found.left_out)
    if found.lambda_sd is not None and found.lambda_prior_sd:
        left = found.lambda_sd / found.lambda_prior_sd
        why = "these radiographs say next to nothing of lambda" if left > UNSEEN else "the radiographs tell some of it"
        lines.append(
            f"about the estimate, the log of lambda at a given mu is known to ± {number(found.lambda_prior_sd, 2)} "
            f"before the fit and to ± {number(found.lambda_sd, 2)} after it: {why}"
        )
    return lines


def _shares(found: ParameterStudy) -> str:
    return ", ".join(f"{TITLES[effect.name]} {fixed(100.0 * effect.share, 0)} %" for effect in found.effects)


def model_title(model: ModelScore) -> str:
    """Its ratios."""
    return ", ".join(model.parameters)


def _compared(two: ModelScore, three: ModelScore, left_out: str) -> list[str]:
    if not three.ratios:
        return [f"no estimate of {model_title(three)}: {three.note}"]
    lines = []
    if three.extreme:
        lines.append(
            f"with lambda on its own, {' and '.join(three.extreme)} ends within 5 % of a bound, in log: so it was in "
            "four of the paper's seven subjects"
        )
    for what, a, b in (
        ("training frames", two.training_rmse_mm, three.training_rmse_mm),
        (f"{LEFT_OUT[left_out]} left out", two.left_out_rmse_mm, three.left_out_rmse_mm),
        ("frames held out", two.held_out_rmse_mm, three.held_out_rmse_mm),
    ):
        if a is not None and b is not None:
            change = 100.0 * (b / a - 1.0)
            both = f"{fixed(a, 2)} mm as estimated, {fixed(b, 2)} mm with lambda on its own"
            lines.append(f"{what}: {both} ({fixed(change, 1, True)} %)")
    if two.aic is not None and three.aic is not None:
        gain = two.aic - three.aic
        verdict = "about as good" if abs(gain) < CLOSE else "better" if gain > 0.0 else "worse"
        lines.append(f"Akaike's criterion: {fixed(-gain, 1, True)} with lambda on its own ({verdict}; less is better)")
    against = [
        *([f"{' and '.join(three.extreme)} at the edge of what a fit allows"] if three.extreme else []),
        *_unless(_forecasts_better(two, three), "frames left out are forecast no better", "no frame could be left out"),
        *_unless(_likelier(two, three), "Akaike's criterion does not ask for it", "Akaike's criterion is not known"),
    ]
    worth = f"is not worth a ratio here: {'; '.join(against)}" if against else "is worth a ratio here"
    return [*lines, f"lambda on its own {worth}"]


def _unless(better: bool | None, no_better: str, unknown: str) -> list[str]:
    return [] if better else [unknown if better is None else no_better]


def _forecasts_better(two: ModelScore, three: ModelScore) -> bool | None:
    if two.left_out_rmse_mm is None or three.left_out_rmse_mm is None:
        return None
    return three.left_out_rmse_mm < LESS * two.left_out_rmse_mm


def _likelier(two: ModelScore, three: ModelScore) -> bool | None:
    return None if two.aic is None or three.aic is None else two.aic - three.aic > CLOSE
