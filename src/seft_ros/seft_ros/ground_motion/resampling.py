"""Resampling of a record to the rate of the loop, without a loss of its peak.

A synthetic motion is linear between its samples. A recorded one is band-limited between them: lines
would take a share ``1 - sinc(f dt)^2`` off what it has at a frequency f. If the rate of the loop is
a multiple of the record's, each sample of the record is one of the test. At any other rate they
fall between two steps; the record is then shifted by less than a step, so that its largest sample
is one of the test.
"""

from dataclasses import dataclass

import numpy as np
from seft_msgs_py.arrays import Floats
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


@dataclass(frozen=True)
class Resampled:
    """A motion at the rate of the loop.

    Attributes
    ----------
    samples : ndarray
        Shape (N, c): every step within the record's duration, then the tail.
    done : str
        What was done, in words.
    """

    samples: Floats
    done: str


def resample(
    record: Floats,
    record_dt: float,
    timebase: Timebase,
    time_scale: float = 1.0,
    tail: float = 0.0,
    *,
    linear: bool = False,
) -> Resampled:
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
    return Resampled(np.pad(moving, ((0, round(tail * timebase.rate)), (0, 0))), done)


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
