"""Correction of a record's baseline, and the numbers that show whether it needs one.

An offset of 1 mm/s^2 makes 0.8 m of displacement in 40 s: what drifts in an instrument's record is
mostly its bias. ``offset`` takes off the mean. ``baseline`` takes off the mean, filters by a
Butterworth high-pass, and then takes off the parabola with which velocity and displacement end at
zero, and the mean square of the velocity is least.
"""

import numpy as np
import numpy.typing as npt
from seft_msgs_py.arrays import Floats
from seft_msgs_py.errors import InputError

METHODS = ("none", "offset", "baseline")

_PADS = 1.5  # zeros at either end, in orders of the filter over its corner (Boore, 2005)


def velocity_and_displacement(accelerations: Floats, dt: float) -> tuple[Floats, Floats]:
    """Integrate a motion that is linear between its samples, from rest; each of shape (N, n)."""
    a = accelerations
    v, d = np.zeros_like(a), np.zeros_like(a)
    np.cumsum(dt / 2 * (a[:-1] + a[1:]), axis=0, out=v[1:])
    np.cumsum(dt * v[:-1] + dt**2 / 6 * (2 * a[:-1] + a[1:]), axis=0, out=d[1:])
    return v, d


def baseline_numbers(accelerations: Floats, dt: float) -> dict[str, list[float]]:
    """Numbers that show the drift of a motion.

    Parameters
    ----------
    accelerations : ndarray
        Shape (N, n), in m/s^2.
    dt : float
        Sampling period in s.

    Returns
    -------
    dict
        Lists with one number per axis: ``offset`` (the mean) and ``peak_acceleration`` in m/s^2;
        ``peak_velocity`` and ``residual_velocity`` in m/s; ``peak_displacement`` and
        ``residual_displacement`` in m. Residual is what is left at the end.
    """
    v, d = velocity_and_displacement(accelerations, dt)
    return {
        "offset": accelerations.mean(axis=0).tolist(),
        "peak_acceleration": np.abs(accelerations).max(axis=0).tolist(),
        "peak_velocity": np.abs(v).max(axis=0).tolist(),
        "peak_displacement": np.abs(d).max(axis=0).tolist(),
        "residual_velocity": v[-1].tolist(),
        "residual_displacement": d[-1].tolist(),
    }


def correct(
    accelerations: Floats, dt: float, method: str, corner: float, order: int, both_ways: bool
) -> Floats:
    """Correct the baseline of a record.

    Parameters
    ----------
    accelerations : ndarray
        Shape (N, n), in m/s^2.
    dt : float
        Sampling period in s.
    method : str
        One of `METHODS`.
    corner : float
        Of the high-pass, -3 dB one way, Hz; 0: no filter.
    order : int
        Of the high-pass.
    both_ways : bool
        Filter forwards and backwards: no shift of phase, twice the attenuation.

    Raises
    ------
    InputError
        If the corner is not below half the record's rate.
    """
    if method == "none":
        return accelerations
    centred = accelerations - accelerations.mean(axis=0)
    if method == "offset":
        return centred
    if corner >= 0.5 / dt:
        raise InputError(
            f"ground_motion: filter.corner is {corner:g} Hz, but must be below half the record's "
            f"rate ({0.5 / dt:g} Hz)"
        )
    filtered = high_pass(centred, dt, corner, order, both_ways) if corner else centred
    return filtered - _parabola(filtered, dt)


def high_pass(a: Floats, dt: float, corner: float, order: int, both_ways: bool) -> Floats:
    """Filter by a Butterworth high-pass, exactly in the frequency domain, with zeros around.

    ``|H|^2 = 1 / (1 + (corner / f)^(2 order))``; both ways, this is the response itself.
    """
    pad = int(np.ceil(_PADS * order / corner / dt))
    length = len(a) + 2 * pad
    spectrum = np.fft.rfft(np.pad(a, ((pad, pad), (0, 0))), axis=0)
    response = butterworth(np.fft.rfftfreq(length, dt), corner, order, both_ways)
    found: Floats = np.fft.irfft(spectrum * response[:, np.newaxis], length, axis=0)
    return found[pad : pad + len(a)]


def butterworth(
    f: Floats, corner: float, order: int, both_ways: bool
) -> npt.NDArray[np.complex128]:
    """Frequency response of the high-pass at frequencies in Hz, shape (F,)."""
    angles = np.pi * (2 * np.arange(1, order + 1) + order - 1) / (2 * order)
    factors = 1j * f[:, np.newaxis] / (1j * f[:, np.newaxis] - corner * np.exp(1j * angles))
    once: npt.NDArray[np.complex128] = factors.prod(axis=1)
    return once * once.conj() if both_ways else once


def _parabola(a: Floats, dt: float) -> Floats:
    """Find the parabola for each column of ``a``, shape (N, n), which `correct` takes off."""
    powers = np.linspace(0.0, 1.0, len(a))[:, np.newaxis] ** np.arange(3)
    v, d = velocity_and_displacement(a, dt)
    by_v, by_d = velocity_and_displacement(powers, dt)
    ends = np.stack([by_v[-1], by_d[-1]])
    # least squares of v - by_v c, with ends c = (v, d) at the end
    system = np.block([[by_v.T @ by_v, ends.T], [ends, np.zeros((2, 2))]])
    wanted = np.vstack([by_v.T @ v, v[-1], d[-1]])
    found: Floats = powers @ np.linalg.solve(system, wanted)[:3]
    return found
