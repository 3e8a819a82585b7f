"""A relation of two channels, and how far gain, delay and bias of one of them are off.

Sums of both sides, which forget in a time T, are compared::

    sum of changes = (1 + g) sum of integrals + d sum of changes per delay + b sum of periods

Gain error g, delay error d and bias b are estimated recursively, so what is left of the difference
is noise, the uncertainty of the estimates, and what the three do not describe. That part of the
motion is estimated, too. So no threshold is larger than what the test has shown so far.
"""

import math

from seft_msgs_py.arrays import Floats

from seft_plant_sim.compiled import compiled

GAIN, DELAY, BIAS_OF = range(3)
"""Places of the estimates."""
CHANGE, INTEGRAL, PER_DELAY, PERIODS = range(4)
"""Places of the sums."""
SCATTER, WEIGHT = range(2)
"""Places of the mean square of what is left over that of the motion, and of its weight."""

NOISE_SIGMAS = 6.0
"""Threshold over the RMS of the noise alone."""
CORRELATION_TIME = 0.05
"""Correlation time of the effects that a relation leaves out, s: within it, samples count as
one."""
REMEMBERED = 60.0
"""Largest weight of the mean square of what is left: that of 3 s."""
MOTION_TO_NOISE = 20.0
"""Least motion over its noise for the estimate of gain and delay, and that which counts by half for
what is left."""
ESTIMATE_DRIFT = 0.003
"""Undetected slow change of an estimate in a second, over its deviation at the beginning."""


@compiled
def expected(found: Floats, i: int, integral: float, per_delay: float, periods: float) -> float:
    """Give the change that the estimates expect."""
    change = integral + found[GAIN, i] * integral + found[DELAY, i] * per_delay
    return change + found[BIAS_OF, i] * periods


@compiled
def uncertain(covariance: Floats, integral: float, per_delay: float, periods: float) -> float:
    """Give the variance of what is expected by that of the estimates, shape (3, 3)."""
    gain, delay, bias = covariance[GAIN], covariance[DELAY], covariance[BIAS_OF]
    variance = integral * (integral * gain[0] + 2.0 * (per_delay * gain[1] + periods * gain[2]))
    variance += per_delay * (per_delay * delay[1] + 2.0 * periods * delay[2])
    return max(variance + periods * periods * bias[2], 0.0)


@compiled
def follow(
    found: Floats,
    covariance: Floats,
    sums: Floats,
    largest: Floats,
    drift: Floats,
    i: int,
    off: float,
    doubt: float,
    moves: bool,
) -> None:
    """Update the estimates of an axis with a difference.

    Parameters
    ----------
    found : ndarray
        Estimates, shape (3, n); updated.
    covariance : ndarray
        Of those of the axis, shape (3, 3); updated.
    sums : ndarray
        Shape (4, n).
    largest, drift : ndarray
        Bounds of the estimates, and the growth of their variances; shape (3, n).
    i : int
        Place of the axis.
    off : float
        Measured sum of changes less the expected one.
    doubt : float
        Its variance without that of the estimates.
    moves : bool
        Whether the motion stands out of noise and resolution; else the bias alone is changed
        (Schmidt-Kalman), because regression on a noisy motion underestimates the gain.
    """
    one = two = three = 0.0
    for row in range(3):
        covariance[row, row] += drift[row, i]
        one += covariance[0, row] * sums[1 + row, i]
        two += covariance[1, row] * sums[1 + row, i]
        three += covariance[2, row] * sums[1 + row, i]
    variance = doubt + sums[1, i] * one + sums[2, i] * two + sums[3, i] * three
    if not 0.0 < variance < math.inf:
        return
    by_sum = (one, two, three)
    per, moved = 1.0 / variance, 1.0 if moves else 0.0
    taken = (one * per * moved, two * per * moved, three * per)
    left = (variance * taken[0] - one, variance * taken[1] - two, variance * taken[2] - three)
    for row in range(3):
        value = found[row, i] + taken[row] * off
        found[row, i] = min(max(value, -largest[row, i]), largest[row, i])
        for k in range(3):
            covariance[row, k] += taken[row] * left[k] - by_sum[row] * taken[k]


@compiled
def remember(
    scatter: Floats, i: int, off: float, usual: float, whole: float, noise: float, dt: float
) -> None:
    """Update the mean square of the part of the motion that the estimates do not describe.

    Parameters
    ----------
    scatter : ndarray
        See `SCATTER`, shape (2, n); updated. Its weight at the beginning is that of one sample.
    i : int
        Place of the axis.
    off, usual : float
        Difference of the sums, and its expected RMS: twice that counts at most, so that a fault
        that grows slowly does not become usual before it is found.
    whole, noise : float
        Largest recent value of the sums, and the RMS noise of the difference.
    dt : float
        Sampling period, s.
    """
    size = whole * whole + (MOTION_TO_NOISE * noise) ** 2
    if not 0.0 < size < math.inf:
        return
    per = 1.0 / size
    counts = whole * whole * per * (dt * (1.0 / CORRELATION_TIME))
    weight = min(scatter[WEIGHT, i] + counts, REMEMBERED)
    scatter[WEIGHT, i] = weight
    beyond_noise = (min(off * off, 4.0 * usual * usual) - noise * noise) * per
    scatter[SCATTER, i] += counts / weight * (beyond_noise - scatter[SCATTER, i])
