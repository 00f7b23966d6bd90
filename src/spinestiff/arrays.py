"""Read-only arrays with a checked shape, for the constructors of the data types.

What holds them is shown in a short text, and copied or sent to another process by its fields.
"""

from __future__ import annotations

import dataclasses
import enum
from collections.abc import Collection, Iterator, Mapping
from importlib import import_module
from types import MappingProxyType
from typing import Any, ClassVar

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


class ByFields:
    """A frozen dataclass that is copied and pickled by its fields, through its constructor.

    So what the constructor checks and protects is so again: an array may be written to once it was unpickled, and a
    read-only mapping can't be pickled.
    """

    def __reduce__(self) -> tuple[Any, ...]:
        fields = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}  # type: ignore[arg-type]
        kept = {name: dict(value) if isinstance(value, MappingProxyType) else value for name, value in fields.items()}
        return _made, (type(self), kept)


def _made(kind: type[Any], fields: Mapping[str, Any]) -> Any:
    return kind(**fields)


class ShortRepr:
    """A ``repr`` of one short line for what holds large arrays: of an array its shape, of a part its type.

    A dataclass says ``@dataclass(frozen=True, repr=False)``, so that this one stays. ``_facts`` may say less or more
    than its fields.
    """

    LONGEST = 160
    SHOWN_BY: ClassVar[str] = ""
    """"module:function" that makes HTML of it for notebooks; by name, since what draws a thing imports it. "": none."""

    def _repr_html_(self) -> str | None:
        if not self.SHOWN_BY:
            return None
        module, _, function = self.SHOWN_BY.partition(":")
        shown: str = getattr(import_module(module), function)(self)
        return shown

    def __repr__(self) -> str:
        line = f"{type(self).__name__}({', '.join(self._facts())})"
        return line if len(line) <= self.LONGEST else f"{line[: self.LONGEST - 5]} ...)"

    def _facts(self) -> Iterator[str]:
        for field in dataclasses.fields(self):  # type: ignore[arg-type]
            if field.repr:
                yield f"{field.name}={_brief(getattr(self, field.name))}"


def _brief(value: Any) -> str:
    if isinstance(value, np.ndarray):
        return repr(value.tolist()) if value.size <= 3 else f"<{'x'.join(map(str, value.shape))}>"
    if isinstance(value, enum.Enum):
        return value.name
    if isinstance(value, float):
        return f"{value:.6g}"
    if dataclasses.is_dataclass(value):
        return f"<{type(value).__name__}>"
    if isinstance(value, Collection) and not isinstance(value, str | bytes):
        if len(value) > 3 or isinstance(value, Mapping):
            return f"<{len(value)} of {type(value).__name__}>"
        return f"({', '.join(map(_brief, value))})"
    return repr(value)
