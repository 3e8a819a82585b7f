"""Growth rates of many loops at once."""

import os
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import numpy.typing as npt
from scipy.sparse.csgraph import connected_components

Floats = npt.NDArray[np.float64]

CHUNK = 250
"""Matrices that a thread takes at a time."""


def growth_rates(matrices: Floats, dt: float) -> Floats:
    """Give ln|z| / dt of each loop's largest eigenvalue, 1/s, see `ClosedLoop.growth_rate`.

    States that act on each other in a circle in none of the loops are taken apart, as in
    `ClosedLoop.eigenvalues`; what is left goes to all processors, a thread to each.

    Parameters
    ----------
    matrices : ndarray
        Shape (..., N, N).
    dt : float
        Sampling period, s.

    Returns
    -------
    ndarray
        Shape (...).
    """
    size = matrices.shape[-1]
    flat = matrices.reshape(-1, size, size)
    count, block = connected_components((flat != 0).any(axis=0), connection="strong")
    largest = np.zeros(len(flat))
    with ThreadPoolExecutor(len(os.sched_getaffinity(0))) as pool:
        for index in range(count):
            part = np.flatnonzero(block == index)
            if len(part) == 1:
                found = np.abs(flat[:, part[0], part[0]])
            else:
                pieces = [
                    flat[start : start + CHUNK, part[:, np.newaxis], part]
                    for start in range(0, len(flat), CHUNK)
                ]
                found = np.concatenate(list(pool.map(_radius, pieces)))
            np.maximum(largest, found, out=largest)
    rates: Floats = np.log(np.maximum(largest, 1e-300)) / dt
    return rates.reshape(matrices.shape[:-2])


def _radius(matrices: Floats) -> Floats:
    return np.abs(np.linalg.eigvals(matrices)).max(axis=-1)
