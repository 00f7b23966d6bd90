"""``spinestiff parameters``: which stiffness parameters the radiographs tell of, as tables and as JSON."""

from __future__ import annotations

from spinestiff.app import tables
from spinestiff.study.visit import Visit
from spinestiff.study.wording.numbers import fixed, number
from spinestiff.study.wording.parameters import TITLES, gradient_rows, model_title, parameter_lines
from spinestiff.subject.parameters_outcome import ParameterStudy
from spinestiff.subject.run_record import read_outcome


def read_parameters(visit: Visit) -> ParameterStudy:
    """What was found of a visit whose parameters were looked at."""
    return read_outcome(visit.subject, ParameterStudy)


def show_parameters(found: ParameterStudy) -> None:
    """Print it."""
    columns: tuple[str, ...] = ("parameter", "default", "estimate", "share, %")
    made = tables.table(f"Motion of the corners per e-fold, mm ({found.mesh} mesh)", *columns)
    for effect in found.effects:
        cells = (number(effect.default_mm, 2), number(effect.estimate_mm, 2), fixed(100.0 * effect.share, 0))
        made.add_row(TITLES[effect.name], *cells)
    tables.show(made)
    optimum = ", ".join(f"{name} {number(value, 2)}" for name, value in found.optimum.items())
    title = f"Gradient of the paper's objective (Eq. 10, Table 3), mm² per e-fold; equal weights' optimum: {optimum}"
    made = tables.table(title, "parameter", "default", "optimum", "paper, mean of |default|")
    for row in gradient_rows(found):
        made.add_row(*row)
    tables.show(made)
    columns = ("ratios", "estimate", "training", "left out", "held out", "AIC", "extreme")
    made = tables.table("Ratios, weighed fit: corner RMSE, mm", *columns)
    for model in found.models:
        errors = (model.training_rmse_mm, model.left_out_rmse_mm, model.held_out_rmse_mm)
        made.add_row(
            model_title(model).replace("_", " "),  # words can be broken
            ", ".join(number(model.ratios.get(name), 2) for name in model.parameters),
            *[fixed(error, 2) for error in errors],
            fixed(model.aic),
            ", ".join(model.extreme),
        )
    tables.show(made)
    for line in parameter_lines(found):
        print(line)
    for model in found.models:
        if model.note:
            print(f"note: {model_title(model)}: {model.note}")
