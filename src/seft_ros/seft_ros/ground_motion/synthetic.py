"""Synthetic ground motions: filtered white noise under an envelope, the same for the same seed."""

import numpy as np
import numpy.typing as npt
from seft_msgs_py.errors import InputError

Floats = npt.NDArray[np.float64]


def motion_spectrum(frequencies: npt.ArrayLike, **filters: float) -> Floats:
    """Shape of the one-sided power spectrum that synthetic motions aim at.

    The Kanai-Tajimi spectrum times the high-pass of Clough and Penzien (Dynamics of
    Structures, section 28-3), relative to that of the white noise.

    Parameters
    ----------
    frequencies : array_like
        Shape (F,), in Hz.
    **filters : float
        ``ground_frequency`` (Hz) and ``ground_damping`` of the ground layer, and
        ``filter_frequency`` (Hz) and ``filter_damping`` of the high-pass.

    Returns
    -------
    ndarray
        Shape (F,), without unit; 0 at 0 Hz.
    """
    return np.abs(_frequency_response(np.asarray(frequencies, dtype=float), **filters)) ** 2


def _frequency_response(
    f: Floats,
    ground_frequency: float,
    ground_damping: float,
    filter_frequency: float,
    filter_damping: float,
) -> npt.NDArray[np.complex128]:
    ground = 2j * ground_damping * ground_frequency * f  # s = 2 pi i f; factors (2 pi)^2 cancel
    high = 2j * filter_damping * filter_frequency * f
    kanai_tajimi = (ground_frequency**2 + ground) / (ground_frequency**2 - f**2 + ground)
    clough_penzien = -(f**2) / (filter_frequency**2 - f**2 + high)
    return np.asarray(kanai_tajimi * clough_penzien)


def stationary_motion(seed: int, steps: int, dt: float, **filters: float) -> Floats:
    """Make stationary noise whose expected periodogram is `motion_spectrum`.

    White noise of unit variance is filtered in the frequency domain, exactly and without a
    transient: the motion is periodic over its length. ``abs(rfft(.))**2 / steps`` is
    `motion_spectrum` on average.

    Parameters
    ----------
    seed, steps : int
        Number of samples N.
    dt : float
        Sampling period in s.
    **filters : float
        As for `motion_spectrum`.
    """
    noise = np.random.Generator(np.random.PCG64(seed)).standard_normal(steps)
    response = _frequency_response(np.fft.rfftfreq(steps, dt), **filters)
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
    return np.asarray(risen * np.exp(-decay * np.maximum(times - plateau_end, 0.0)))


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

    Accelerations only: they are not corrected for a baseline, so that integrated twice they
    leave a displacement.

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
        As for `motion_spectrum`.

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
        raise InputError(
            f"ground_motion: synthetic.plateau_end is {plateau_end:g} s, but must not be before "
            f"the end of synthetic.rise ({rise:g} s)"
        )
    if duration < 10 * dt:
        raise InputError(
            f"ground_motion: synthetic.duration is {duration:g} s, but must be at least ten "
            f"times synthetic.dt ({dt:g} s)"
        )
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
        raise InputError(
            "ground_motion: synthetic.* make a motion that is zero; "
            "check synthetic.rise against synthetic.duration"
        )
    return np.asarray(motion * (peak / largest))
