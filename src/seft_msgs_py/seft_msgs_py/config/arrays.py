"""Parameters as arrays over the axes of a test."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from seft_msgs_py.errors import InputError

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]


def per_axis(value: float | Sequence[float], axes: Sequence[str], where: str) -> Floats:
    """One value for each of the n axes, shape (n,); a single number counts for all.

    Raises
    ------
    InputError
        If there are neither 1 nor n values; ``where`` names the parameter.
    """
    array = np.array(value, dtype=np.float64, ndmin=1)
    if array.size == len(axes):
        return array
    if array.size == 1:
        return np.full(len(axes), array[0])
    raise InputError(
        f"{where}: {array.size} values for {len(axes)} axes [{', '.join(axes)}]; "
        "give one, or one for each axis"
    )


def as_matrix(value: float | Sequence[float], axes: Sequence[str], where: str) -> Floats:
    """Matrix over n axes, shape (n, n): a number or n numbers are its diagonal.

    n * n numbers are its rows, one after the other.

    Raises
    ------
    InputError
        If there are neither 1, n nor n * n values.
    """
    count = len(axes)
    array = np.array(value, dtype=np.float64, ndmin=1)
    if array.size == count * count:
        return array.reshape(count, count)
    if array.size in (1, count):
        return np.diag(np.broadcast_to(array, count))
    raise InputError(
        f"{where}: {array.size} values for {count} axes [{', '.join(axes)}]; give 1, {count} "
        f"(a diagonal) or {count * count} (a matrix, row by row)"
    )


def mass_matrix(value: float | Sequence[float], axes: Sequence[str], where: str) -> Floats:
    """Mass matrix over n axes, shape (n, n); InputError if not symmetric positive definite."""
    matrix = symmetric_matrix(value, axes, where)
    if np.linalg.eigvalsh(matrix)[0] <= 0:
        raise InputError(f"{where} is {value}, but mass must be positive (definite) on every axis")
    return matrix


def symmetric_matrix(value: float | Sequence[float], axes: Sequence[str], where: str) -> Floats:
    """Matrix over n axes, shape (n, n), see `as_matrix`; InputError if it is not symmetric."""
    matrix = as_matrix(value, axes, where)
    if not (np.abs(matrix - matrix.T) <= 1e-9 * np.abs(matrix.T)).all():
        raise InputError(f"{where}: the matrix {matrix.tolist()} is not symmetric")
    return matrix
