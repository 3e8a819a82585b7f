"""Signals of one axis or several, taken together as columns."""

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]


def paired_columns(commanded: Floats, measured: Floats) -> tuple[Floats, Floats]:
    """Both signals with an axis in each column, shape (N, n).

    Parameters
    ----------
    commanded, measured : ndarray
        Of the same shape, (N, n) or (N,).

    Raises
    ------
    ValueError
        If the shapes differ, or are of other dimensions.
    """
    one, other = (np.asarray(signal, dtype=np.float64) for signal in (commanded, measured))
    if one.shape != other.shape or one.ndim not in (1, 2):
        raise ValueError(
            f"two signals of the same shape (N,) or (N, n) are needed, not {one.shape} "
            f"and {other.shape}"
        )
    return (one[:, np.newaxis], other[:, np.newaxis]) if one.ndim == 1 else (one, other)


def peaks(y: Floats) -> Floats:
    """Largest magnitude of each column, shape (n,); NaN of no samples, or if one is NaN."""
    return np.abs(y).max(axis=0) if len(y) else np.full(y.shape[1:], np.nan)
