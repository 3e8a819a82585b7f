"""Samples of a channel as they were a little earlier or later, at each frequency."""

from collections.abc import Callable

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft, rfftfreq
from seft_msgs_py.arrays import Complexes, Floats


def moved_ahead(
    y: Floats, lead: Floats, dt: float, passed: Callable[[Floats], Complexes] | None = None
) -> Floats:
    """Give y(t + lead) of signals of shape (N, n) that are band-limited, and 0 before and after.

    The leads, in s, have shape (n,); negative ones delay. ``passed`` gives the response of what
    the signals pass beside, shape (m, n), at frequencies of shape (m,), rad/s.
    """
    room = int(np.ceil(np.abs(lead).max() / dt)) + 64  # so that the ends do not meet
    size = next_fast_len(len(y) + room, real=True)
    w = 2j * np.pi * rfftfreq(size, dt)
    turned = np.exp(np.outer(w, lead)) * (1.0 if passed is None else passed(w.imag))
    return irfft(rfft(y, size, axis=0) * turned, size, axis=0)[: len(y)]
