"""From the record's sampling period to the rate of the loop."""

import numpy as np
import numpy.typing as npt
from seft_msgs_py.errors import InputError
from seft_msgs_py.wire.timebase import Timebase

MOST_STEPS = 50_000_000
"""Longest motion that is accepted, in steps: beyond is a mistyped duration or rate."""

_SNAP = 1e-9  # of a record's step: rounding in k * dt must not move a sample off its knot


def resample(
    record: npt.NDArray[np.float64],
    record_dt: float,
    timebase: Timebase,
    time_scale: float = 1.0,
    tail: float = 0.0,
) -> npt.NDArray[np.float64]:
    """Sample a record at the rate of the loop, and append zeros.

    The record is piecewise linear in time between its samples at
    ``j * record_dt * time_scale``, and is evaluated at ``k * timebase.dt``; nothing is
    filtered. A sample of the record that falls between two steps is lost, and a peak with
    it: always in a loop slower than the record, sometimes in one that is no multiple of it.

    Parameters
    ----------
    record : ndarray
        Shape (M, c), M at least 2.
    record_dt : float
        Sampling period of the record in s.
    timebase : Timebase
        Of the loop.
    time_scale : float
        Factor on the record's duration; accelerations stay as they are.
    tail : float
        Duration of the zeros in s.

    Returns
    -------
    ndarray
        Shape (N, c): every step within the record's duration, then the tail.

    Raises
    ------
    InputError
        If that makes more than `MOST_STEPS` steps, or less than one.
    """
    duration = (len(record) - 1) * record_dt * time_scale
    if duration < timebase.dt:
        raise InputError(
            f"ground_motion: the motion lasts {duration:g} s, less than a step at "
            f"{timebase.rate:g} Hz; check dt and time_scale"
        )
    check_size(duration + tail, timebase.rate, f"time_scale {time_scale:g}, tail {tail:g} s")
    ratio = timebase.dt / (record_dt * time_scale)
    last = len(record) - 1
    positions = np.arange(int(last / ratio * (1 + 1e-12) + _SNAP) + 1) * ratio
    nearest = np.rint(positions)
    positions = np.where(np.abs(positions - nearest) <= _SNAP, nearest, positions)
    samples = np.zeros((len(positions) + round(tail * timebase.rate), record.shape[1]))
    for column in range(record.shape[1]):
        samples[: len(positions), column] = np.interp(
            positions, np.arange(len(record)), record[:, column]
        )
    return samples


def check_size(duration: float, rate: float, where: str) -> None:
    """Refuse motions of an absurd length, before memory is taken for them.

    Parameters
    ----------
    duration : float
        In s.
    rate : float
        In Hz.
    where : str
        Parameters it comes from.

    Raises
    ------
    InputError
        If there would be more than `MOST_STEPS` steps.
    """
    if not duration * rate <= MOST_STEPS:
        raise InputError(
            f"ground_motion: {duration:g} s at {rate:g} Hz are more than {MOST_STEPS:.0e} steps "
            f"({where}); check duration and rate"
        )
