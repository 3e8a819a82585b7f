"""A polynomial in s as weights of the steps to come."""

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]

_BAND = 18.0  # Hz up to which they are alike
_END = 35.0  # Hz from which on the sum is to be small: no loop is inverted there
_LAST = 100.0  # Hz
_SHARE = 0.3  # of the errors there, beside those in the band
_SPAN = 0.024  # s of steps
_POINTS = 200
_EFFORT = 3e-3  # error in the band (RMS) that counts as much as one weight of 1


def coming_weights(polynomial: Floats, dt: float) -> Floats:
    """Weigh the steps to come of a signal so that the sum is a polynomial in s of it now.

    Differences of neighbouring steps would be exact for slow signals alone, and large. These
    weights are the best over the band, and small; beyond the band so is their sum, which would
    else feed back modes that the prediction does not know in time.

    Parameters
    ----------
    polynomial : ndarray
        Highest power first.
    dt : float
        Sampling period, s.

    Returns
    -------
    ndarray
        From this step on, shape (m,).
    """
    s = 2j * np.pi * np.linspace(0.0, min(_BAND, 0.1 / dt), _POINTS)
    count = 1 + int(np.ceil(_SPAN / dt - 1e-9))
    beyond = 2j * np.pi * np.linspace(_END, max(_END, min(_LAST, 0.4 / dt)), _POINTS)
    ahead = dt * np.arange(count)
    steps, others = np.exp(np.outer(s, ahead)), _SHARE * np.exp(np.outer(beyond, ahead))
    wanted = np.polyval(polynomial, s)
    effort = _EFFORT * np.sqrt(_POINTS) * np.eye(count)
    weights: Floats = np.linalg.lstsq(
        np.vstack([steps.real, steps.imag, others.real, others.imag, effort]),
        np.concatenate([wanted.real, wanted.imag, np.zeros(2 * _POINTS + count)]),
        rcond=None,
    )[0]
    return weights
