"""Samples of a channel as they were a little earlier or later, at each frequency."""

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft, rfftfreq
from seft_msgs_py.arrays import Floats


def moved_ahead(y: Floats, lead: Floats, dt: float) -> Floats:
    """Give y(t + lead) of signals of shape (N, n) that are band-limited, and 0 before and after.

    The leads, in s, have shape (n,); negative ones delay.
    """
    room = int(np.ceil(np.abs(lead).max() / dt)) + 64  # so that the ends do not meet
    size = next_fast_len(len(y) + room, real=True)
    w = 2j * np.pi * rfftfreq(size, dt)
    return irfft(rfft(y, size, axis=0) * np.exp(np.outer(w, lead)), size, axis=0)[: len(y)]
