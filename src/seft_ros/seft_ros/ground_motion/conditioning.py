"""From a record to the motion of a test: its baseline corrected, and at the rate of the loop.

An offset of 1 mm/s^2 makes 0.8 m of displacement in 40 s: what drifts in an instrument's record is
mostly its bias. ``offset`` takes off the mean. ``baseline`` takes off the mean, filters by a
Butterworth high-pass, and then takes off the parabola with which velocity and displacement end at
zero, and the mean square of the velocity is least.

A synthetic motion is linear between its samples. A recorded one is band-limited between them: lines
would take a share ``1 - sinc(f dt)^2`` off what it has at a frequency f. If the rate of the loop is
a multiple of the record's, each sample of the record is one of the test. At any other rate they
fall between two steps; the record is then shifted by less than a step, so that its largest sample
is one of the test.
"""

from collections.abc import Callable

import numpy as np
from seft_msgs_py.arrays import Complexes, Floats
from seft_msgs_py.errors import InputError
from seft_msgs_py.wire.topics import Timebase

MAX_STEPS = 50_000_000
"""Longest accepted motion, in steps: a longer one is a mistyped duration or rate."""

_SNAP = 1e-9  # of a record's step: rounding in k * dt must not move a sample off its knot
_ZEROS = 32  # zeros of the sinc on either side
_BETA = 8.0  # of the Kaiser window: 80 dB; its transition is 8 % of the band on either side
_BELOW = 0.92  # of half the loop's rate: the band's edge, so that nothing is folded
_PHASE_DIGITS = 9  # of a record's step; positions between two samples repeat
_BLOCK = 4096


def resample(
    record: Floats,
    record_dt: float,
    timebase: Timebase,
    time_scale: float = 1.0,
    tail: float = 0.0,
    *,
    linear: bool = False,
) -> tuple[Floats, str]:
    """Sample a record at the rate of the loop, and append zeros.

    Parameters
    ----------
    record : ndarray
        Shape (M, c), M at least 2.
    record_dt : float
        Sampling period of the record in s.
    timebase : Timebase
        Of the loop.
    time_scale : float
        Factor on the record's duration; accelerations do not change.
    tail : float
        Duration of the zeros in s.
    linear : bool
        The motion is linear between its samples at any rate.

    Returns
    -------
    samples : ndarray
        Shape (N, c): every step within the record's duration, then the tail.
    done : str
        What was done, in words.

    Raises
    ------
    InputError
        If that makes more than `MAX_STEPS` steps, or less than one.
    """
    last = len(record) - 1
    duration = last * record_dt * time_scale
    if duration < timebase.dt:
        raise InputError(
            f"ground_motion: the motion lasts {duration:g} s, less than a step at "
            f"{timebase.rate:g} Hz; check dt and time_scale"
        )
    check_size(duration + tail, timebase.rate, f"time_scale {time_scale:g}, tail {tail:g} s")
    ratio = timebase.dt / (record_dt * time_scale)
    multiple = 1 / ratio
    on_knots = round(multiple) >= 1 and abs(multiple - round(multiple)) <= _SNAP * multiple
    peak = 0 if linear or on_knots else int(np.abs(record).max(axis=1).argmax())
    shift = max(peak - ratio * np.floor(peak / ratio + _SNAP), 0.0)
    steps = np.arange(int((last - shift) / ratio * (1 + 1e-12) + _SNAP) + 1, dtype=np.float64)
    positions = shift + steps * ratio
    if linear or (on_knots and multiple < 1.5):
        moving = _linear(record, positions)
        done = "linear between its samples" if linear else "each of its samples is a step"
    else:
        band, period = _BELOW / ratio if ratio > 1 else 1.0, record_dt * time_scale
        moving = band_limited(record, positions, band)
        kept = "each of its samples" if on_knots else "its largest sample"
        done = f"band-limited to {0.5 * band / period:.4g} Hz; {kept} is a step"
        if shift:
            done += f", it begins {1e3 * shift * period:.3g} ms later"
    return np.pad(moving, ((0, round(tail * timebase.rate)), (0, 0))), done


def _linear(record: Floats, positions: Floats) -> Floats:
    nearest = np.rint(positions)
    places = np.where(np.abs(positions - nearest) <= _SNAP, nearest, positions)
    knots = np.arange(len(record))
    return np.stack([np.interp(places, knots, values) for values in record.T], axis=1)


def band_limited(record: Floats, positions: Floats, band: float) -> Floats:
    """Interpolate with a sinc in a Kaiser window; before and after the record its ends hold.

    Parameters
    ----------
    record : ndarray
        Shape (M, c).
    positions : ndarray
        Shape (N,), in samples of the record.
    band : float
        Edge of the band, as a part of half the record's rate.

    Returns
    -------
    ndarray
        Shape (N, c).
    """
    reach = _ZEROS / band
    taps = np.arange(-int(np.ceil(reach)) + 1, int(np.ceil(reach)) + 1)
    found = np.empty((len(positions), record.shape[1]))
    for start in range(0, len(positions), _BLOCK):
        block = positions[start : start + _BLOCK]
        first = np.floor(block).astype(int)
        phases, which = np.unique(np.round(block - first, _PHASE_DIGITS), return_inverse=True)
        off = (phases[:, np.newaxis] - taps) / reach
        window = np.i0(_BETA * np.sqrt(np.clip(1 - off**2, 0.0, None))) * (np.abs(off) <= 1)
        weights = np.sinc(off * _ZEROS) * window
        weights /= weights.sum(axis=1, keepdims=True)
        values = record[np.clip(first[:, np.newaxis] + taps, 0, len(record) - 1)]
        found[start : start + _BLOCK] = np.einsum("nk,nkc->nc", weights[which], values)
    return found


def check_size(duration: float, rate: float, where: str) -> None:
    """Refuse motions of an implausible length, before memory is reserved for them.

    ``duration`` in s, ``rate`` in Hz; ``where`` names their parameters.

    Raises
    ------
    InputError
        If there would be more than `MAX_STEPS` steps.
    """
    if not duration * rate <= MAX_STEPS:
        raise InputError(
            f"ground_motion: {duration:g} s at {rate:g} Hz are more than {MAX_STEPS:.0e} steps "
            f"({where}); check duration and rate"
        )


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
        ``none``, ``offset`` or ``baseline``.
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
        need = f"must be below half the record's rate ({0.5 / dt:g} Hz)"
        raise InputError(f"ground_motion: filter.corner is {corner:g} Hz, but {need}")
    filtered = high_pass(centred, dt, corner, order, both_ways) if corner else centred
    return filtered - _parabola(filtered, dt)


def high_pass(a: Floats, dt: float, corner: float, order: int, both_ways: bool) -> Floats:
    """Filter by a Butterworth high-pass, exactly in the frequency domain, with zeros around.

    ``|H|^2 = 1 / (1 + (corner / f)^(2 order))``; both ways, this is the response itself.
    """
    from scipy.signal import butter, freqs_zpk  # 20 MB that others need not have

    pad = int(np.ceil(_PADS * order / corner / dt))
    length = len(a) + 2 * pad
    spectrum = np.fft.rfft(np.pad(a, ((pad, pad), (0, 0))), axis=0)
    filtered = butter(order, corner, "highpass", analog=True, output="zpk")
    _, response = freqs_zpk(*filtered, np.fft.rfftfreq(length, dt))
    if both_ways:
        response = np.abs(response) ** 2
    found: Floats = np.fft.irfft(spectrum * response[:, np.newaxis], length, axis=0)
    return found[pad : pad + len(a)]


def _parabola(a: Floats, dt: float) -> Floats:
    """Find the parabola for each column of ``a``, shape (N, n), which `correct` takes off."""
    powers = np.linspace(0.0, 1.0, len(a))[:, np.newaxis] ** np.arange(3)
    v, d = velocity_and_displacement(a, dt)
    by_v, by_d = velocity_and_displacement(powers, dt)
    ends = np.stack([by_v[-1], by_d[-1]])
    # least squares of v - by_v c, with ends c = (v, d) at the end
    system = np.block([[by_v.T @ by_v, ends.T], [ends, np.zeros((2, 2))]])
    wanted = np.vstack([by_v.T @ v, v[-1], d[-1]])
    return powers @ np.linalg.solve(system, wanted)[:3]


def moved_ahead(
    y: Floats, lead: Floats, dt: float, passed: Callable[[Floats], Complexes] | None = None
) -> Floats:
    """Give y(t + lead) of signals of shape (N, n) that are band-limited, and 0 before and after.

    The leads, in s, have shape (n,); negative ones delay. ``passed`` gives the response of what
    the signals pass beside, shape (m, n), at frequencies of shape (m,), rad/s.
    """
    from scipy.fft import irfft, next_fast_len, rfft, rfftfreq  # most commands need not load it

    room = int(np.ceil(np.abs(lead).max() / dt)) + 64  # so that the ends do not meet
    size = next_fast_len(len(y) + room, real=True)
    w = 2j * np.pi * rfftfreq(size, dt)
    turned = np.exp(np.outer(w, lead)) * (1.0 if passed is None else passed(w.imag))
    return irfft(rfft(y, size, axis=0) * turned, size, axis=0)[: len(y)]
