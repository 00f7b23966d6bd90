"""``posterior.csv``: equally probable ratios and nuisances of an estimate, one draw a row."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from io import StringIO
from pathlib import Path

import numpy as np

from spinestiff.arrays import Floats
from spinestiff.errors import SubjectError
from spinestiff.estimation.fitted import StiffnessFit
from spinestiff.files import read_text, write_bytes

DRAWS_FILE = "posterior.csv"


def write_draws(path: Path, fit: StiffnessFit) -> None:
    """Ratios and nuisances; without any draws an earlier file is taken away.

    Nuisances are in standard deviations before the fit.
    """
    if fit.likely is None or fit.weighed is None:
        path.unlink(missing_ok=True)
        return
    ratios, nuisances = fit.likely.draws
    rows = StringIO()
    writer = csv.writer(rows, lineterminator="\n")
    writer.writerow([*fit.names, *(one.name for one in fit.weighed.nuisances)])
    writer.writerows([f"{value:.6g}" for value in row] for row in np.hstack([np.exp(ratios), nuisances]))
    write_bytes(path, rows.getvalue().encode())


def read_draws(path: Path, names: Sequence[str]) -> Floats:
    """(D, P) columns of these names, as they stand. Raises SubjectError where the file has none of them."""
    rows = list(csv.DictReader(read_text(path).splitlines()))
    try:
        return np.array([[float(row[name]) for name in names] for row in rows]).reshape(-1, len(names))
    except (KeyError, TypeError, ValueError):
        raise SubjectError(f"{path}: no draws of {', '.join(names)}; run spinestiff estimate again") from None
