"""A small picture of a fit, for notebooks: its ratios with their intervals."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from spinestiff.estimation.fitted import StiffnessFit
from spinestiff.shown import as_html

ESTIMATE, DEFAULT = "#D55E00", "#6E6E6E"
ROW_IN, WIDTH_IN = 0.32, 3.6


def fit_figure(fit: StiffnessFit) -> Figure:
    """A row a ratio on a logarithmic axis, as far as the fit was allowed; the default is 1."""
    figure = Figure(figsize=(WIDTH_IN, 0.8 + ROW_IN * len(fit.names)), layout="constrained")
    axis = figure.add_subplot()
    axis.axvline(1.0, color=DEFAULT, linewidth=1.0, linestyle=(0, (5, 2)))
    for row, (name, value) in enumerate(fit.ratios.as_dict().items()):
        low, high = fit.intervals95[name]
        if np.isfinite([low, high]).all():
            axis.plot([low, high], [row, row], color=ESTIMATE, linewidth=2.2, solid_capstyle="butt")
        axis.plot(value, row, "o", color=ESTIMATE, markersize=5.0)
    axis.set_xscale("log")
    axis.set_xlim(*fit.bounds)
    axis.set_yticks(range(len(fit.names)), fit.names, fontsize=8)
    axis.set_ylim(len(fit.names) - 0.5, -0.5)
    axis.set_xlabel("ratio to the default stiffness", fontsize=8)
    axis.tick_params(axis="x", labelsize=8)
    return figure


def html_of(fit: StiffnessFit) -> str:
    """As a notebook shows it."""
    rows = [("status", fit.status.name)]
    for name, value in fit.ratios.as_dict().items():
        low, high = fit.intervals95[name]
        known = f"{value:.4g}, 95 % {low:.3g} to {high:.3g}" if low == low else f"{value:.4g}"
        rows.append((name, known + (", at its bound" if fit.at_bound[name] else "")))
    rows.append(("training RMSE", f"{fit.rmse_mm:.2f} mm, {fit.default_words}"))
    return as_html("Fit of stiffness", [*rows, *(("warning", text) for text in fit.warnings)], fit_figure(fit))
