"""Samples as a browser gets them: a header, and float32 values signal by signal."""

import struct

import numpy as np

from seft_ros.monitor.envelope import Envelope, Samples
from seft_ros.monitor.history import Stretch

_HEADER = struct.Struct("<4I2d")
SAMPLES, ENVELOPE, RECENT = range(3)
"""New samples; the whole test so far; its last stretch, which the envelope holds already."""


def samples_frame(test: int, stretch: Stretch, kind: int = SAMPLES) -> bytes:
    """Make a frame of consecutive samples.

    Parameters
    ----------
    test : int
        Number of the test they belong to.
    stretch : Stretch
        The samples.
    kind : int
        `SAMPLES` or `RECENT`.
    """
    count, columns = stretch.values.shape
    return _HEADER.pack(kind, test, columns, count, stretch.first, 1.0) + _bytes(stretch.values)


def envelope_frame(test: int, envelope: Envelope) -> bytes:
    """Make a frame of an envelope: all the lows, then all the highs."""
    low, high = envelope.low, envelope.high
    count, columns = low.shape
    header = _HEADER.pack(ENVELOPE, test, columns, count, envelope.origin, envelope.size)
    return header + _bytes(low) + _bytes(high)


def _bytes(values: Samples) -> bytes:
    return np.ascontiguousarray(values.T, "<f4").tobytes()
