"""What a test's own samples say of its channels, whatever the specimen's law is.

Acceleration and velocity are derivatives of the displacement. With the scale s and the lag tau of a
channel against the displacement, and in the first order of the lag::

    a_i(t) = sum_j s_ij x_j''(t) - s_ii tau_i x_i'''(t)                                    (1)

Off the diagonal s is the tilt of an accelerometer. Standard errors are those of correlated
residuals (Newey & West 1987). Of the mass and the force, see `seft_ros.analysis.mass_estimate`.

The zero of the acceleration may move, too. With a window w(t) that is smooth and zero at both ends
of a part of the test, integration by parts gives its mean error b, whatever the motion::

    b = (sum w a - sum w'' x) / sum w                                                      (2)

Slow motion is known better from the displacement, and fast motion from the acceleration. What the
latter lacks, c, makes c^2 / s_a^2 + (x - y)^2 / s_x^2 least over all samples, with noise s and the
motion y of the acceleration a + c (Whittaker 1923, Numerov 1924; D: second differences)::

    D y / dt^2 = c + N a,  so  (1 + (s_x / (s_a dt^2))^2 D D^T) c = D x / dt^2 - N a       (3)

with (N a)_k = (a_k-1 + 10 a_k + a_k+1) / 12, and y = x - (s_x / (s_a dt))^2 D^T c.

A valve's commands are steps, and what they excite above half the rate looks like the motion itself:
at 250 Hz 0.8 % of its acceleration, which the displacement has not. Of force and M a it is the same
part, so that the restoring force has none, and the equivalent ground motion all of it.
"""

import math
from dataclasses import dataclass

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft, rfftfreq
from scipy.linalg import solveh_banded
from seft_msgs_py.arrays import Complexes, Floats
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.config.facts import CHANNELS, FORCE_DRIVEN
from seft_msgs_py.errors import InputError
from seft_plant_sim.calibration import SIGNIFICANT, known_channels
from seft_plant_sim.channels import ACCELERATION, DISPLACEMENT, FORCE, VELOCITY
from seft_plant_sim.rig_parameters import filter_of

from seft_ros.design.planned_tests import choose_rig
from seft_ros.design.plant import held_relations
from seft_ros.ground_motion.conditioning import moved_ahead
from seft_ros.reference_force.yield_corner import STANDS_OUT

KINEMATIC_BAND = (0.3, 3.0)
"""Band of Eq. (1), over the frequency of the motion: where most of the motion is. Below, the
acceleration is lost in the bias and the noise of the displacement, above in those of x''."""
OF_SAMPLING = 0.22
"""The highest frequency of any band over the sampling rate: filters need some room below half."""
_APART = 1e6
"""Condition of the motion up to which its axes can be told apart: rounding alone gives 1e12."""
_SIXTH = 924.0  # sum of the squares of the binomials: a sixth difference's noise over a sample's
_NORMAL = 0.6745  # median of |z| of a normal variable


@dataclass(frozen=True)
class Relation:
    """A channel against a derivative of the displacement, Eq. (1), or the force against inertia.

    Attributes
    ----------
    scale, scale_error : ndarray
        s and its standard error, shape (n, n); the unit matrix for equal channels. A tilt within
        `SIGNIFICANT` standard errors is 0, of a velocity always. Of the force: the mass over the
        known one, (n,); a force that is as many times too large looks the same.
    lag, lag_error : ndarray
        tau of each axis, positive where the channel is behind the displacement, or the force behind
        the acceleration, and its standard error, shape (n,), s.
    """

    scale: Floats
    scale_error: Floats
    lag: Floats
    lag_error: Floats


def motion_frequency(states: Floats) -> float:
    """Frequency of a sine with this ratio of acceleration and displacement (RMS), Hz; NaN: none."""
    travel, _, rms, _ = np.sqrt(states.var(axis=0).mean(axis=1)).tolist()
    return math.sqrt(rms / travel) / (2 * np.pi) if travel > 0 else math.nan


def noise_of(y: Floats) -> Floats:
    """RMS of the white noise of smooth signals, shape (N, n): of their sixth differences, (n,).

    0 if they are too short to have any.
    """
    sixth = np.diff(y, 6, axis=0) if len(y) > 6 else np.zeros_like(y)
    size: Floats = np.median(np.abs(sixth), axis=0) / (_NORMAL * math.sqrt(_SIXTH))
    return size


def derivatives(
    y: Floats, orders: tuple[int, ...], band: tuple[float, float], dt: float, half: float
) -> list[Floats]:
    """Give derivatives of signals in a band of frequencies, without a shift in time.

    Parameters
    ----------
    y : ndarray
        Shape (N, c).
    orders : tuple of int
        Of the derivatives; 0: the signal itself.
    band : tuple of float
        Where the amplitude is half (0: no lower end), Hz.
    half : float
        Half the length of the filter's impulse response, s; so much is lost at both ends.

    Returns
    -------
    list of ndarray
        One for each order, shape (N - 2 round(half / dt), c).
    """
    k = max(1, round(half / dt))
    size = next_fast_len(len(y) + 2 * k, real=True)
    spectrum = rfft(y, size, axis=0)
    found = []
    for order in orders:
        response = rfft(_impulse_response(band, dt, order, k), size)
        found.append(irfft(spectrum * response[:, np.newaxis], size, axis=0)[2 * k : len(y)])
    return found


def _impulse_response(band: tuple[float, float], dt: float, order: int, k: int) -> Floats:
    """Impulse response of a smooth band-pass and a derivative of this order, shape (2k + 1,)."""
    n = 8 * k
    frequency, (low, high) = rfftfreq(n, dt), band
    fall = np.sin(np.pi / 2 * np.clip((1.2 * high - frequency) / (0.4 * high), 0.0, 1.0)) ** 2
    if low > 0:
        fall *= np.sin(np.pi / 2 * np.clip((frequency / low - 0.6) / 0.8, 0.0, 1.0)) ** 2
    shaped = np.roll(irfft(fall, n), k)[: 2 * k + 1] * np.hanning(2 * k + 3)[1:-1] ** 2
    centred = np.roll(np.pad(shaped, (0, n - len(shaped))), -k)
    derived = irfft(rfft(centred) * (2j * np.pi * frequency) ** order, n)
    return np.concatenate([derived[-k:], derived[: k + 1]])


def relation(
    y: Floats, x: Floats, order: int, dt: float, frequency: float, unsure: float | Floats = 0.0
) -> Relation | None:
    """Compare a channel with a derivative of the displacement, Eq. (1).

    Parameters
    ----------
    y, x : ndarray
        Channel and displacement of each axis, shape (N, n).
    order : int
        1: y is the velocity; 2: it is the acceleration.
    frequency : float
        Of the motion, Hz, see `motion_frequency`.
    unsure : float or ndarray
        Part of the motion of each axis, shape (n,), that a fault-free channel may show besides: it
        is part of the standard errors.

    Returns
    -------
    Relation or None
        None if the test is too short or too quiet: the derivatives of the displacement do not
        stand out from its noise in the band.
    """
    low, high = (factor * frequency for factor in KINEMATIC_BAND)
    band, half = (low, min(high, OF_SAMPLING / dt)), 0.4 / low
    n, k = x.shape[1], round(half / dt)
    if not 0 < 6 * k <= len(x):
        return None
    (seen,) = derivatives(y, (0,), band, dt, half)
    motion, change = derivatives(x, (order, order + 1), band, dt, half)
    passes, response = (_impulse_response(band, dt, each, k) for each in (0, order))
    if (np.sqrt(np.mean(motion**2, axis=0)) <= STANDS_OUT * noise_of(x) * _size(response)).any():
        return None
    noise = np.append(noise_of(x) * _size(response), 0.0)
    unsure = np.broadcast_to(unsure, n)
    apart = np.linalg.cond(motion / np.linalg.norm(motion, axis=0)) < _APART
    scale, scale_error = np.zeros((2, n, n))
    lag, lag_error = np.empty((2, n))
    for i in range(n):
        # floors move alike: without a tilt its own motion alone gives an axis' scale far better
        own = np.column_stack([motion[:, i], change[:, i]])
        used = np.array([i])
        b, error = _regressed(seen[:, i], own, 2 * k, passes)
        error = np.hypot(error, unsure[i] * np.array([1.0, 1.0 / (2 * np.pi * frequency)]))
        if n > 1 and order == 2 and apart:
            every, regressors = np.arange(n), np.column_stack([motion, change[:, i]])
            tilted, more = _regressed(seen[:, i], regressors, 2 * k, passes)
            # noise of floors that move alike, and what else is in their motion, look like a tilt
            cut = np.linalg.inv(regressors.T @ regressors)
            more = np.hypot(more, cut @ (len(regressors) * noise**2 * tilted))
            beside = unsure[i] * np.linalg.norm(motion[:, i])
            more = np.hypot(more, np.sqrt(cut.diagonal()) * beside)
            if (np.abs(tilted) > SIGNIFICANT * more)[:n][every != i].any():
                used, b, error = every, tilted, more
        scale[i, used], scale_error[i, used] = b[:-1], error[:-1]
        lag[i], lag_error[i] = -b[-1] / scale[i, i], error[-1] / abs(scale[i, i])
    return Relation(scale, scale_error, lag, lag_error)


def _regressed(y: Floats, regressors: Floats, lags: int, of: Floats) -> tuple[Floats, Floats]:
    """Regress a signal, shape (N,); give the coefficients and their standard errors, (k,).

    What is left is at least white noise, seen through the filter with the impulse response ``of``:
    where few cycles move most, the fit follows their noise, and correlated scores are too small.
    """
    cut = np.linalg.inv(regressors.T @ regressors)
    b = cut @ (regressors.T @ y)
    left = y - regressors @ b
    scores = regressors * left[:, np.newaxis]
    size = next_fast_len(len(y) + len(of), real=True)
    passed = rfft(regressors, size, axis=0) * rfft(of / _size(of), size)[:, np.newaxis]
    passed = irfft(passed, size, axis=0)
    white = cut @ (np.mean(left**2) * passed.T @ passed) @ cut
    correlated = cut @ summed_covariance(scores, lags) @ cut
    return b, np.sqrt(np.maximum(correlated.diagonal(), white.diagonal()))


def _size(response: Floats) -> float:
    return float(np.sqrt(response @ response))


def summed_covariance(scores: Floats, lags: int) -> Floats:
    """Covariance of the sum of correlated scores, shape (N, k) (Newey & West 1987)."""
    # the weights 1 - lag / lags are those of the sums over all windows of so many scores
    sums = np.cumsum(np.pad(scores, [(lags, lags), (0, 0)]), axis=0)
    windows = sums[lags:] - sums[:-lags]
    covariance: Floats = windows.T @ windows / lags
    return covariance


def without_folding(samples: Floats, mass: Floats, experiment: Experiment) -> Floats:
    """Take what is folded down out of acceleration and force, as of the motion's frequency.

    ``samples`` have shape (N, 4, n), ``mass`` is the specimen's, (n, n), kg. Where no actuator is
    known, or it is idealised, nothing is taken.
    """
    frequency = motion_frequency(samples)
    section = experiment.sections.get("reference_force", {})
    idealised = section.get("actuator.kind") in FORCE_DRIVEN
    known = frequency > 0 and not idealised
    expected = expected_relations(experiment, frequency) if known else None
    if expected is None:
        return samples
    own, a, dt = expected[0][1], samples[:, ACCELERATION], experiment.timebase.dt
    late = np.angle(own) / (2 * np.pi * frequency)
    folded = a - moved_ahead(a, -late, dt) / np.abs(own)
    found = samples.copy()
    found[:, ACCELERATION] -= folded
    found[:, FORCE] -= folded @ mass.T
    return found


def with_motion(samples: Floats, noise: Floats, dt: float) -> Floats:
    """Take what displacement and acceleration know better of each other, c and y of Eq. (3).

    Parameters
    ----------
    samples : ndarray
        Shape (N, 4, n).
    noise : ndarray
        RMS, shape (4, n), see `noise_of`. Without noise of the acceleration nothing is better
        known.
    """
    inner, found = max(len(samples) - 2, 0), samples.copy()
    of_x, of_a = noise[DISPLACEMENT], noise[ACCELERATION]
    for i in np.flatnonzero(of_a > 0.0) if inner else ():
        x, a = samples[:, DISPLACEMENT, i], samples[:, ACCELERATION, i]
        lacking = np.diff(x, 2) / dt**2 - (a[:-2] + 10.0 * a[1:-1] + a[2:]) / 12.0
        weight = (of_x[i] / (of_a[i] * dt**2)) ** 2
        if np.isfinite(weight):  # not of a test that went unstable
            bands = np.repeat([[weight], [-4.0 * weight], [1.0 + 6.0 * weight]], inner, axis=1)
            c = solveh_banded(bands, lacking, check_finite=False)
            found[1:-1, ACCELERATION, i] += c
            found[:, DISPLACEMENT, i] -= weight * dt**2 * np.diff(np.pad(c, 2), 2)
    return found


def expected_relations(experiment: Experiment, frequency: float) -> tuple[Complexes, Floats] | None:
    """Velocity and acceleration of fault-free channels over the derivatives of x.

    See `seft_ros.design.plant.held_relations`; it follows from the actuator that the test knows,
    on the specimen's model, and from what is known of the channels' lags.

    Parameters
    ----------
    experiment : Experiment
        Of the test.
    frequency : float
        Of the motion, Hz.

    Returns
    -------
    tuple of ndarray or None
        They, shape (2, n), and what is not known of them, (3, n); None if no actuator is known.
    """
    nodes = ("reference_force", "force_controller")
    if any(node not in experiment.sections for node in nodes):
        return None
    section = experiment["reference_force"]
    channels = known_channels(section, experiment.axes)
    filters = filter_of(channels["filter"], channels["filter_damping"])
    # what the samples wait for after the channels are read turns nothing that is folded down
    at_once = {f"calibration.{name}_{what}": 0.0 for name in CHANNELS for what in ("lag", "filter")}
    known = Experiment({node: experiment[node] | at_once for node in nodes})
    lag = channels["lag"]
    if section["sensors.velocity"] == "derived":
        for each in (lag, *filters):
            each[VELOCITY] = each[DISPLACEMENT]
    try:
        plant, dt = choose_rig(known).plant, experiment.timebase.dt
        held, unsure = held_relations(plant, np.array([frequency]), dt, lag, filters)
    except (InputError, KeyError):
        return None
    return held[0], unsure[0]


def acceleration_zero(x: Floats, a: Floats, dt: float) -> tuple[Floats, Floats]:
    """Mean error of the accelerations over these samples, Eq. (2), and its standard error, (n,).

    ``x`` and ``a`` have shape (N, n); the errors are those of white noise.
    """
    angle = np.pi * (np.arange(len(x)) + 0.5) / len(x)
    s, c = np.sin(angle), np.cos(angle)
    bend = (np.pi / (len(x) * dt)) ** 2 * (12 * s**2 * c**2 - 4 * s**4)
    whole = (s**4).sum()
    zero = (s**4 @ a - bend @ (x - x.mean(axis=0))) / whole
    noise = noise_of(a) ** 2 * (s**8).sum() + noise_of(x) ** 2 * (bend**2).sum()
    return zero, np.sqrt(noise) / whole
