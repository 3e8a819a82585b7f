"""The scale of a motion from the force it is to make."""

import numpy as np
import numpy.typing as npt
from seft_msgs_py.errors import InputError

Floats = npt.NDArray[np.float64]


def force_scale(samples: Floats, mass: Floats, peak_force: float) -> float:
    """Factor on a motion that makes the largest |(M a_g)_i| a given force.

    Parameters
    ----------
    samples : ndarray
        Shape (N, n), accelerations in m/s^2.
    mass : ndarray
        Shape (n, n), in kg.
    peak_force : float
        In N.

    Raises
    ------
    InputError
        If the motion makes no force.
    """
    largest = float(np.abs(samples @ mass.T).max())
    if not largest > 0:
        raise InputError(
            f"ground_motion: a motion of zeros can't be scaled to peak_force {peak_force:g} N; "
            "check column and influence, or set peak_force to 0"
        )
    return peak_force / largest
