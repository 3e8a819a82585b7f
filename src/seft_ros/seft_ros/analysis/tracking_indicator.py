"""Tracking indicator: the area that a measured signal encloses over its command."""

import numpy as np
import numpy.typing as npt

from seft_ros.analysis.columns import paired_columns, peaks

Floats = npt.NDArray[np.float64]


def tracking_indicator(commanded: Floats, measured: Floats) -> Floats:
    """Accumulate the tracking indicator TI.

    TI = (A - TA) / 2, where from one sample to the next A grows by (c' + c) / 2 (m' - m) and TA
    by (m' + m) / 2 (c' - c) (Mercan & Ricles 2007, Earthquake Engineering & Structural Dynamics
    36, 1523-1543). It grows while the measured signal lags and falls while it leads; a wrong
    amplitude alone leaves it at zero. A sine of amplitudes C and M whose measured signal lags by
    phi adds pi C M sin(phi) in each cycle.

    Parameters
    ----------
    commanded, measured : ndarray
        Shape (N, n) or (N,).

    Returns
    -------
    ndarray
        TI so far at each sample, of the same shape, in the square of the unit; 0 at the first.

    Raises
    ------
    ValueError
        If the shapes differ.
    """
    c, m = paired_columns(commanded, measured)
    indicator = np.zeros_like(c)
    with np.errstate(invalid="ignore", over="ignore"):
        # A and TA have the products c' m' and c m in common, which this leaves out
        indicator[1:] = np.cumsum(0.5 * (c[:-1] * m[1:] - c[1:] * m[:-1]), axis=0)
    return indicator.reshape(np.shape(commanded))


def relative_tracking_indicator(commanded: Floats, measured: Floats) -> Floats:
    """TI at the end over the square of the command's peak, shape (n,) or ().

    NaN where the command is zero throughout, where there are fewer than two samples, or
    anything is not finite.
    """
    c, m = paired_columns(commanded, measured)
    if len(c) < 2:
        return np.full(np.shape(commanded)[1:], np.nan)
    with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
        most = peaks(c)
        end = tracking_indicator(c / most, m / most)[-1]
    return np.where(np.isfinite(end), end, np.nan).reshape(np.shape(commanded)[1:])
