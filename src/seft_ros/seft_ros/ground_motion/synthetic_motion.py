"""Synthetic ground motions, and an excitation for identification; the same seed gives the same."""

import numpy as np
import numpy.typing as npt
from seft_msgs_py.arrays import Floats
from seft_msgs_py.errors import InputError

_EDGE = 1.25  # beyond the band the spectrum falls to zero within this factor
_RAMP = 0.02  # of the duration, at either end
_LONGEST_RAMP = 2.0  # s
_FEWEST_PERIODS = 4  # of the band's lowest frequency


def motion_filter(
    f: Floats,
    ground_frequency: float,
    ground_damping: float,
    filter_frequency: float,
    filter_damping: float,
) -> npt.NDArray[np.complex128]:
    """Frequency response of the filter that makes synthetic motions of white noise.

    That of Kanai and Tajimi times the high-pass of Clough and Penzien (Dynamics of Structures,
    section 28-3). Its squared magnitude is the shape of their one-sided power spectrum.

    Parameters
    ----------
    f : ndarray
        Shape (F,), frequencies in Hz.
    ground_frequency, ground_damping : float
        Of the ground layer; Hz.
    filter_frequency, filter_damping : float
        Of the high-pass; Hz.

    Returns
    -------
    ndarray
        Shape (F,), without unit; 0 at 0 Hz.
    """
    ground = 2j * ground_damping * ground_frequency * f  # s = 2 pi i f; factors (2 pi)^2 cancel
    high = 2j * filter_damping * filter_frequency * f
    kanai_tajimi = (ground_frequency**2 + ground) / (ground_frequency**2 - f**2 + ground)
    clough_penzien = -(f**2) / (filter_frequency**2 - f**2 + high)
    return kanai_tajimi * clough_penzien


def stationary_motion(seed: int, steps: int, dt: float, **filters: float) -> Floats:
    """Make stationary noise whose expected periodogram is that of `motion_filter`.

    White noise of unit variance is filtered in the frequency domain, exactly and without a
    transient: the motion is periodic over its length. ``abs(rfft(.))**2 / steps`` is
    ``abs(motion_filter(.))**2`` on average.

    Parameters
    ----------
    seed, steps : int
        Number of samples N.
    dt : float
        Sampling period in s.
    **filters : float
        As for `motion_filter`.
    """
    noise = np.random.Generator(np.random.PCG64(seed)).standard_normal(steps)
    response = motion_filter(np.fft.rfftfreq(steps, dt), **filters)
    return np.fft.irfft(np.fft.rfft(noise) * response, steps)


def envelope(times: npt.ArrayLike, rise: float, plateau_end: float, decay: float) -> Floats:
    """Envelope of Jennings, Housner and Tsai (1968): quadratic rise, plateau, exponential decay.

    Parameters
    ----------
    times : array_like
        Shape (N,), in s.
    rise, plateau_end : float
        Ends of the rise (0: none) and of the plateau, in s.
    decay : float
        Rate of the decay in 1/s.

    Returns
    -------
    ndarray
        Shape (N,), between 0 and 1.
    """
    times = np.asarray(times, dtype=float)
    risen = np.minimum(times / rise, 1.0) ** 2 if rise > 0 else np.ones_like(times)
    return risen * np.exp(-decay * np.maximum(times - plateau_end, 0.0))


def synthetic_motion(
    seed: int,
    duration: float,
    dt: float,
    peak: float,
    rise: float,
    plateau_end: float,
    decay: float,
    **filters: float,
) -> Floats:
    """Make a synthetic ground motion.

    The accelerations have no baseline correction: integrated twice they leave a displacement.

    Parameters
    ----------
    seed : int
        Not negative.
    duration, dt : float
        From the first sample to the last, and sampling period, in s.
    peak : float
        Largest absolute acceleration in m/s^2.
    rise, plateau_end, decay : float
        As for `envelope`.
    **filters : float
        As for `motion_filter`.

    Returns
    -------
    ndarray
        Shape (N,), in m/s^2; sample k is at time ``k * dt``, N = duration / dt + 1.

    Raises
    ------
    InputError
        If values contradict each other; names the parameter.
    """
    if plateau_end < rise:
        need = f"must not be before the end of synthetic.rise ({rise:g} s)"
        raise InputError(f"ground_motion: synthetic.plateau_end is {plateau_end:g} s, but {need}")
    if duration < 10 * dt:
        need = f"must be at least ten times synthetic.dt ({dt:g} s)"
        raise InputError(f"ground_motion: synthetic.duration is {duration:g} s, but {need}")
    if filters["ground_frequency"] >= 0.5 / dt:
        raise InputError(
            f"ground_motion: synthetic.ground_frequency is {filters['ground_frequency']:g} Hz, but "
            f"must be below half the sampling rate ({0.5 / dt:g} Hz); make synthetic.dt smaller"
        )
    steps = int(duration / dt * (1 + 1e-12)) + 1
    motion = stationary_motion(seed, steps, dt, **filters)
    motion *= envelope(dt * np.arange(steps), rise, plateau_end, decay)
    largest = np.abs(motion).max()
    if not largest > 0:
        mend = "check synthetic.rise against synthetic.duration"
        raise InputError(f"ground_motion: synthetic.* make a motion that is zero; {mend}")
    return motion * (peak / largest)


def excitation(
    steps: int,
    axes: int,
    dt: float,
    band: tuple[float, float],
    seed: int,
    constant_velocity: bool = False,
) -> Floats:
    """Make Gaussian noise with a flat spectrum in a band, independent on each axis, of unit RMS.

    Its spectrum below the band is almost zero, so that the piston does not drift: the valve
    integrates to displacement.

    Parameters
    ----------
    steps, axes : int
        N and n.
    dt : float
        Sampling period, s.
    band : tuple of float
        Lowest and highest frequency, Hz.
    constant_velocity : bool
        Whether its derivative has that spectrum instead: it is the displacement of a servo.

    Returns
    -------
    ndarray
        Shape (N, n), first and last sample zero, mean zero.

    Raises
    ------
    InputError
        If the band does not fit rate and duration.
    """
    low, high = band
    if not 0 < low < high < 0.5 / dt:
        need = f"must rise, and lie within 0 and half the rate, {0.5 / dt:g} Hz"
        raise InputError(f"--band is {low:g} to {high:g} Hz, but {need}")
    shortest = shortest_duration(band)
    if steps * dt < shortest - dt:
        raise InputError(
            f"--duration is {steps * dt:g} s, but a signal from {low:g} Hz on needs "
            f"{shortest:g} s; raise it, or the band's lower end"
        )
    raw = _random(steps, axes, dt, band, seed, constant_velocity)
    window = np.hanning(steps)[:, np.newaxis]
    centred = raw - window * (raw.mean(axis=0) / window.mean())  # the ends still at rest
    return centred / np.sqrt(np.mean(centred**2, axis=0))


def shortest_duration(band: tuple[float, float]) -> float:
    """Shortest duration of an excitation for its band, s."""
    return _FEWEST_PERIODS / band[0]


def _random(
    steps: int, axes: int, dt: float, band: tuple[float, float], seed: int, falling: bool
) -> Floats:
    frequencies, (low, high) = np.fft.rfftfreq(steps, dt), band
    upper = min(high * _EDGE, 0.5 / dt)
    passed = _rise(frequencies, low / _EDGE, low) * (1.0 - _rise(frequencies, high, upper))
    if falling:
        passed = passed / np.maximum(frequencies, low / _EDGE)
    white = [np.random.default_rng([seed, axis]).standard_normal(steps) for axis in range(axes)]
    columns = [np.fft.irfft(np.fft.rfft(noise) * passed, steps) for noise in white]
    return np.stack(columns, axis=1) * _ramp(steps, dt)[:, np.newaxis]


def _ramp(steps: int, dt: float) -> Floats:
    """Window of ones, with half a cosine from zero at the start and to zero at the end."""
    length = min(_RAMP * steps * dt, _LONGEST_RAMP)
    distance = dt * np.minimum(np.arange(steps), np.arange(steps)[::-1])
    return _rise(distance, 0.0, length)


def _rise(x: Floats, start: float, end: float) -> Floats:
    """Half a cosine from zero at ``start`` to one at ``end``."""
    return 0.5 - 0.5 * np.cos(np.pi * np.clip((x - start) / (end - start), 0.0, 1.0))
