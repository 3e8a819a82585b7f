"""Names of array types, and states: NamedTuples of arrays, whose shapes stand beside them."""

from collections.abc import Callable, Mapping
from functools import cache
from typing import Any, get_type_hints

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]
Complexes = npt.NDArray[np.complex128]
Record = Any
"""A record of named numbers, or an array of them: numpy's types do not tell their fields."""


def zeros[T](of: Callable[..., T], sizes: Mapping[str, int], **given: Any) -> T:
    """Make a NamedTuple of arrays of zeros.

    A field is ``Annotated[Floats, 3, "n"]``, with its shape by numbers and names of ``sizes``; a
    type of records may precede them. Fields without a shape, and others, may be ``given``.
    """
    made = dict(given)
    for name, kind, shape in _shapes(of):
        if name not in given:
            values = np.zeros([sizes[k] if isinstance(k, str) else k for k in shape], kind)
            made[name] = values.view(np.recarray) if kind.names else values
    return of(**made)


@cache
def _shapes(of: Callable[..., Any]) -> list[tuple[str, np.dtype[Any], tuple[int | str, ...]]]:
    """Name, type of the numbers, and shape of each field that has a shape."""
    found = []
    for name, hint in get_type_hints(of, include_extras=True).items():
        if shape := getattr(hint, "__metadata__", ()):
            kind = np.dtype(np.int64 if hint.__origin__ is Ints else np.float64)
            if isinstance(shape[0], np.dtype):
                kind, *shape = shape
            found.append((name, kind, tuple(shape)))
    return found


def clear(state: Any) -> None:
    """Set all arrays of a state, and of the states in it, to 0."""
    for each in state:
        if isinstance(each, tuple):
            clear(each)
        else:
            each[...] = 0
