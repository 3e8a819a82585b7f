"""Linear systems sampled exactly, for inputs that are linear between samples."""

import numpy as np
import numpy.typing as npt
from scipy.linalg import expm

Floats = npt.NDArray[np.float64]


def first_order_hold(a: Floats, b: Floats, dt: float) -> tuple[Floats, Floats, Floats]:
    """Sample s' = a s + b u with u linear in between (Van Loan 1978).

    Parameters
    ----------
    a, b : ndarray
        Shapes (s, s) and (s, p).
    dt : float
        Sampling period, s.

    Returns
    -------
    free, start, change : ndarray
        Shapes (s, s), (s, p), (s, p): the next s is free s + start u + change (next u - u).
    """
    size, inputs = b.shape
    augmented = np.zeros((size + 2 * inputs,) * 2)
    augmented[:size, :size], augmented[:size, size : size + inputs] = a * dt, b * dt
    augmented[size : size + inputs, size + inputs :] = np.eye(inputs)
    exponential = expm(augmented)
    return (
        np.ascontiguousarray(exponential[:size, :size]),
        exponential[:size, size : size + inputs],
        exponential[:size, size + inputs :],
    )
