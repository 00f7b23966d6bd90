"""Read-only arrays with a checked shape, for the constructors of the data types."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from spinestiff.errors import SpinestiffError

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


def read_only(
    name: str,
    values: Any,
    shape: tuple[int | None, ...],
    error: type[SpinestiffError],
    dtype: type = np.float64,
) -> NDArray[Any]:
    """A contiguous, write-protected copy of ``values``.

    Parameters
    ----------
    name : what the array is, for the message.
    values : array-like.
    shape : wanted shape; ``None`` leaves an axis open.
    error : raised if the shape differs or a float is not finite.
    dtype : element type.
    """
    array: NDArray[Any] = np.array(values, dtype=dtype, order="C")
    if array.ndim != len(shape) or any(w is not None and w != n for w, n in zip(shape, array.shape)):
        wanted = "(" + ", ".join("n" if w is None else str(w) for w in shape) + ")"
        raise error(f"{name} has shape {array.shape}, wanted {wanted}")
    if array.dtype.kind == "f" and not np.isfinite(array).all():
        raise error(f"{name} holds a value that is not finite")
    array.flags.writeable = False
    return array
