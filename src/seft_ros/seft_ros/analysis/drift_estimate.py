"""What a test's own samples say of channels whose zero moves while it runs.

The acceleration is held against the displacement. With a window w(t) that is smooth and zero at
both ends of a part of the test, integration by parts gives its mean error b, whatever the motion::

    b = (sum w a - sum w'' x) / sum w                                                      (1)

The zero of the force is in the restoring force r = f - M a, beside the specimen's law::

    r = law(x) + b g(t)                                                                    (2)

The law is a sum of stop operators, a curve and a damper of the spring's deformation. Where it
leaves little but noise, g is (1 - cos(pi t / T)) / 2 in the time T of the test, or a step at one of
`STEPS` times: what explains most. The standard error is that of correlated residuals (Newey & West
1987), wider by `LARGEST_OF_STEPS`. Any other law leaves slow residuals. They are fitted by cosines
of k = 1 to `MODES` half periods. Those of a random walk, which has no drift, are independent with
standard deviations that fall as 1/k: the standard error is k times the amplitude of the faster ones
(RMS).
"""

import numpy as np
from seft_msgs_py.arrays import Floats

from seft_ros.analysis.channel_estimates import noise_of, summed_covariance
from seft_ros.reference_force.restoring_model import slide

_STOPS, _CORNERS = 48, 30  # so close that the corner of a bilinear law is within its noise
_ROWS = 1 << 13  # of samples that are fitted, at equal distances
STEPS = 16
"""Parts of a test, between which a force may step."""
LARGEST_OF_STEPS = float(np.sqrt(2.0 * np.log(STEPS)))
"""Standard errors that the largest of so many steps has by chance."""
MODES = 10
"""Cosines of Eq. (2)."""
_SLOW = 3  # of them, in which a drift may be
_DESCRIBED = 1.2  # what the law leaves, over the noise
_MEMORY = 8  # parts of a test over which residuals may be correlated
_RIDGE, _SMOOTH = 1e-3, 1e-2  # of a law's parameters, and of its curve's bends, as in SpecimenLaw


def acceleration_zero(x: Floats, a: Floats, dt: float) -> tuple[Floats, Floats]:
    """Mean error of the accelerations over these samples, Eq. (1), and its standard error, (n,).

    ``x`` and ``a`` have shape (N, n); the errors are those of white noise.
    """
    angle = np.pi * (np.arange(len(x)) + 0.5) / len(x)
    s, c = np.sin(angle), np.cos(angle)
    bend = (np.pi / (len(x) * dt)) ** 2 * (12 * s**2 * c**2 - 4 * s**4)
    whole = (s**4).sum()
    zero = (s**4 @ a - bend @ (x - x.mean(axis=0))) / whole
    noise = noise_of(a) ** 2 * (s**8).sum() + noise_of(x) ** 2 * (bend**2).sum()
    return zero, np.sqrt(noise) / whole


def force_drift(deformation: Floats, rate: Floats, force: Floats) -> tuple[float, float, Floats]:
    """Fit the zero of a spring's force, Eq. (2); give b, N, its standard error, and g, (N,).

    Parameters
    ----------
    deformation, rate, force : ndarray
        Of the spring, shape (N,).
    """
    count, here = len(force), slice(None, None, 1 + len(force) // _ROWS)
    law, y = _law(deformation, rate, here), force[here]
    slow = 0.5 - 0.5 * np.cos(np.pi * np.arange(count) / count)
    steps = np.arange(count)[:, np.newaxis] >= count * np.arange(1, STEPS) / STEPS
    shapes = np.column_stack([slow, steps])
    q, _ = np.linalg.qr(law)
    beside = shapes[here] - q @ (q.T @ shapes[here])
    gained = np.abs(y @ beside) / np.maximum(np.linalg.norm(beside, axis=0), 1e-9)
    shape = shapes[:, np.argmax(gained)]
    values, errors, left = _fitted(shape[here, np.newaxis], law, y)
    if np.sqrt(np.mean(left**2)) <= _DESCRIBED * noise_of(force[:, np.newaxis])[0]:
        return float(values[0]), float(LARGEST_OF_STEPS * errors[0]), shape
    modes = np.arange(1, MODES + 1)
    cosines = np.cos(np.pi * np.outer(np.arange(count)[here] / count, modes))
    values, _, _ = _fitted(cosines, law, y)
    error = np.sqrt(np.mean((modes * values)[_SLOW:] ** 2))
    return float(-2.0 * values[0]), float(2.0 * error), slow


def _law(e: Floats, rate: Floats, here: slice) -> Floats:
    """Regressors of a spring of any law at some samples, shape (m, q)."""
    least, most = 4 * noise_of(e[:, np.newaxis])[0], max(np.abs(e).max(), 1e-300)
    thresholds = np.geomspace(max(least, most / 1000), most, _STOPS)
    stops = np.zeros((len(e), _STOPS))
    slide(np.ascontiguousarray(e), thresholds, stops)
    place = (e[here] - e.min()) / max(np.ptp(e), 1e-300) * (_CORNERS - 1)
    hats = np.maximum(0.0, 1.0 - np.abs(place[:, np.newaxis] - np.arange(_CORNERS)))
    linear = np.column_stack([rate, e])[here]
    linear /= np.sqrt(np.mean(linear**2, axis=0)) + 1e-300
    return np.hstack([hats, stops[here] / thresholds, linear])


def _fitted(drift: Floats, law: Floats, y: Floats) -> tuple[Floats, Floats, Floats]:
    """Fit Eq. (2); give the q values of the drift, their standard errors, and what is left."""
    regressors, q = np.hstack([drift, law]), drift.shape[1]
    bends = np.zeros((_CORNERS - 2, regressors.shape[1]))
    bends[:, q : q + _CORNERS] = np.diff(np.eye(_CORNERS), 2, axis=0)
    prior = len(y) * (_SMOOTH**2 * bends.T @ bends + _RIDGE**2 * np.eye(regressors.shape[1]))
    prior[:q] = 0.0
    inverse = np.linalg.inv(regressors.T @ regressors + prior)
    values = inverse @ (regressors.T @ y)
    left = y - regressors @ values
    spread = summed_covariance(regressors * left[:, np.newaxis], max(2, len(y) // _MEMORY))
    return values[:q], np.sqrt((inverse @ spread @ inverse).diagonal()[:q]), left
