"""Parameters and state of the judge, whose step is `judge`."""

import math
from typing import NamedTuple

import numpy as np
from seft_msgs_py.arrays import Floats, Ints

RECENT_MEMORY, BRIEF_MEMORY, EVENT_MEMORY = 0.3, 0.05, 3.0
"""Time constants, s, of the memory of the largest force and difference, of the largest change in a
sample, and of the jumps of a specimen: a quarter of a cycle at 1 Hz, ..., three cycles at 1 Hz."""
LASTS, WINDOW = 0.006, 0.05
"""Duration of wrong samples (three at least) within a time, s, that ends the test."""


class JudgeParameters(NamedTuple):
    """Parameters of the judge of n axes.

    Attributes
    ----------
    dt : float
        Sampling period, s.
    recent, brief, events : float
        Factors per step, see `RECENT_MEMORY`.
    late : float
        Time by which a derived velocity is late, s; 0: it is measured.
    noise : ndarray
        Largest difference of (1) to (4) by noise alone, shape (4, n), m, m/s, N, N.
    oil : ndarray
        k_oil, N/m, and lambda, 1/s, shape (n, 2); k_oil 0: not known.
    mass, inverse : ndarray
        M and its inverse, shape (n, n), kg and 1/kg; 0: not known.
    stiffness : ndarray
        Of the assumed specimen, shape (n, n), N/m.
    range : ndarray
        Largest value that each sensor can measure, shape (4, n); infinite if it is not known.
    window : int
        Steps in which so many wrong samples end the test as `JudgeState.wrong` has places.
    """

    dt: float
    recent: float
    brief: float
    events: float
    late: float
    noise: Floats
    oil: Floats
    mass: Floats
    inverse: Floats
    stiffness: Floats
    range: Floats
    window: int


class JudgeState(NamedTuple):
    """State of the judge.

    Attributes
    ----------
    judged : ndarray
        The last two judged samples, the newest first, shape (2, 4, n).
    restoring : ndarray
        r at these, shape (2, n), N.
    usual : ndarray
        Largest recent differences of (3) and (4) that were accepted, shape (2, n), N.
    asked : ndarray
        The last two reference forces, the newest first, and their largest recent second
        difference; shape (3, n), N.
    moves : ndarray
        Largest recent dt |v| and dt |a|, and the largest recent |r|; shape (3, n).
    doubt : ndarray
        Largest error of the last force if it was replaced, shape (n,), N.
    jump : ndarray
        Largest recent jump of the acceleration that the velocity has confirmed, shape (n,), m/s^2.
    off : ndarray
        Difference of (4), N, the expected acceleration, its jump beyond the gate, and that of the
        sample before if it was replaced, m/s^2; shape (4, n).
    verdict : ndarray
        Whether each value of the last sample was replaced, shape (4, n).
    wrong : ndarray
        Steps of the last replaced values, ring buffers, shape (4, n, m).
    counts : ndarray
        Number of replaced values so far, shape (4, n).
    resolution : ndarray
        Least change of a channel so far, shape (4, n); infinite at the beginning.
    raw, moved : ndarray
        The last sample as measured, and the magnitude of its change; shape (4, n).
    taken : ndarray
        Step of the last sample, number of samples in a row, and step of the last sample in which an
        acceleration was at the end of its range; shape (3,).
    """

    judged: Floats
    restoring: Floats
    usual: Floats
    asked: Floats
    moves: Floats
    doubt: Floats
    jump: Floats
    off: Floats
    verdict: Ints
    wrong: Ints
    counts: Ints
    resolution: Floats
    raw: Floats
    moved: Floats
    taken: Ints


def judge_arrays(
    noise: Floats,
    oil: Floats,
    mass: Floats,
    stiffness: Floats,
    ranges: Floats,
    late: float,
    sigmas: float,
    dt: float,
) -> tuple[JudgeParameters, JudgeState]:
    """Put the judge of n axes into arrays.

    Parameters
    ----------
    noise : ndarray
        RMS noise of displacement, velocity, acceleration and force, shape (4, n).
    oil, mass, stiffness, late, ranges
        See `JudgeParameters`.
    sigmas : float
        Largest noise over its RMS.
    dt : float
        Sampling period, s.
    """
    n, (x, v, a, f) = noise.shape[1], noise
    known = oil[:, 0] > 0.0
    by_oil = np.hypot(math.sqrt(2.0) * f, np.where(known, oil[:, 0] * dt * v / math.sqrt(2.0), 0.0))
    by_noise = [
        np.hypot(math.sqrt(2.0) * x, dt * v / math.sqrt(2.0)),
        np.hypot(math.sqrt(2.0) * v, dt * a / math.sqrt(2.0)),
        np.where(known, by_oil, math.sqrt(6.0) * f),
        np.sqrt(6.0 * (f**2 + mass**2 @ a**2)),
    ]
    parameters = JudgeParameters(
        dt=dt,
        recent=math.exp(-dt / RECENT_MEMORY),
        brief=math.exp(-dt / BRIEF_MEMORY),
        events=math.exp(-dt / EVENT_MEMORY),
        late=late,
        noise=sigmas * np.array(by_noise),
        oil=np.ascontiguousarray(oil),
        mass=mass,
        inverse=np.linalg.inv(mass) if mass.any() else np.zeros_like(mass),
        stiffness=stiffness,
        range=ranges,
        window=round(WINDOW / dt),
    )
    state = JudgeState(
        judged=np.zeros((2, 4, n)),
        restoring=np.zeros((2, n)),
        usual=np.zeros((2, n)),
        asked=np.zeros((3, n)),
        moves=np.zeros((3, n)),
        doubt=np.zeros(n),
        jump=np.zeros(n),
        off=np.zeros((4, n)),
        verdict=np.zeros((4, n), dtype=np.int64),
        wrong=np.zeros((4, n, max(3, math.ceil(LASTS / dt - 1e-9))), dtype=np.int64),
        counts=np.zeros((4, n), dtype=np.int64),
        resolution=np.zeros((4, n)),
        raw=np.zeros((4, n)),
        moved=np.zeros((4, n)),
        taken=np.zeros(3, dtype=np.int64),
    )
    return parameters, state
