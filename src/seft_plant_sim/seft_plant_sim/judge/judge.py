"""Parameters and state of the judge, whose step is `judge`."""

import math
from typing import NamedTuple

import numpy as np
from seft_msgs_py.arrays import Floats, Ints

RECENT_MEMORY, BRIEF_MEMORY, EVENT_MEMORY = 0.3, 0.05, 3.0
"""Time constants, s, of the memory of the largest force and motion of the oil, of the largest
change in a sample, and of what the test has shown: a quarter of a cycle at 1 Hz, ..., three cycles
at 1 Hz."""
LASTS, WINDOW = 0.006, 0.05
"""Duration of wrong samples (three at least) within a time, s, that ends the test."""
BIAS = 2.0
"""Largest constant error of a sensor that is no fault, over its RMS noise."""
UNKNOWN = 1e9
"""Standard deviation of what nothing is known of, in any unit."""

SETS = np.array(
    [
        *(0b000001, 0b000010, 0b000100, 0b001000, 0b010000, 0b100000, 0b110000),
        *(0b000011, 0b000101, 0b001001, 0b000110, 0b001010, 0b001100),
        *(0b000111, 0b001011, 0b001101, 0b001110, 0b001111),
        *(0b100001, 0b100010, 0b100100, 0b101000, 0b010001, 0b010010, 0b010100, 0b011000, 0),
    ],
    dtype=np.int64,
)
"""The hypotheses: sets of unknown amplitudes. Bits: x, v, a, f wrong, events of oil and specimen."""
ALIVE = 6
"""Histories of an axis that are kept: the four channels, an event and the sound one."""
REVISED = 3
"""Samples after which a decision is final."""


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
        RMS noise of displacement, velocity, acceleration and force, shape (4, n).
    rest : ndarray
        Mean and standard deviation of the channels at rest, before step 0; shape (2, 4, n).
    oil : ndarray
        k_oil, N/m, and lambda, 1/s, shape (n, 2); k_oil 0: not known.
    mass, stiffness : ndarray
        Of the assumed specimen, shape (n, n), kg and N/m; 0: not known.
    range : ndarray
        Largest value that each sensor can measure, shape (4, n); infinite if it is not known.
    now, before : ndarray
        Matrices L and D of the relations, see `judge_step`, shape (n, 4, 4).
    spread : ndarray
        Logarithm of the orders of magnitude (factors of e) of an event, shape (n,).
    window : int
        Steps in which so many wrong samples end the test as `JudgeState.wrong` has places.
    """

    dt: float
    recent: float
    brief: float
    events: float
    late: float
    noise: Floats
    rest: Floats
    oil: Floats
    mass: Floats
    stiffness: Floats
    range: Floats
    now: Floats
    before: Floats
    spread: Floats
    window: int


class Branches(NamedTuple):
    """The histories of each axis that are still possible, the likeliest first, in m places.

    Attributes
    ----------
    weight : ndarray
        Logarithm of the likelihood over that of the first, shape (n, m).
    value, variance : ndarray
        The channels at the last sample and at the one before, shape (n, m, 2, 4).
    restoring, blur : ndarray
        r at these, N, and its variance, N^2; shape (n, m, 2).
    settling : ndarray
        Variance of r that an event has left, N^2, shape (n, m).
    event : ndarray
        Jumps of r, N, at the last three samples, shape (n, m, 3).
    wrong : ndarray
        Sets of channels that were wrong at the last samples, shape (n, m, 1 + REVISED).
    """

    weight: Floats
    value: Floats
    variance: Floats
    restoring: Floats
    blur: Floats
    settling: Floats
    event: Floats
    wrong: Ints


class Comparison(NamedTuple):
    """A sample of an axis compared with one branch: room for the calculation.

    Attributes
    ----------
    noise : ndarray
        Variance of each channel, shape (4,).
    seen : ndarray
        The channels, shape (4,).
    off, left : ndarray
        Residuals e of the relations, and their variance Q without that of the channels; (4,).
    covariance, root : ndarray
        S of these, and its Cholesky factor; shape (4, 4).
    whitened : ndarray
        C^-1 (L, 1, 1, e): columns of channels, events and the residual, shape (4, 7).
    gram : ndarray
        Products of these columns with each other, (7, 7).
    factor, solution : ndarray
        Cholesky factor of a set's part of these, and its forward solution; shapes (6, 6), (6,).
    chosen : ndarray
        Places of the set's unknowns, shape (6,).
    amplitude, spread : ndarray
        Of the unknowns of each candidate, and their variances; shape (c, 6).
    candidate, likelihood : ndarray
        Branch and set of each candidate, shape (c, 2), and its logarithmic weight, (c,).
    """

    noise: Floats
    seen: Floats
    off: Floats
    left: Floats
    covariance: Floats
    root: Floats
    whitened: Floats
    gram: Floats
    factor: Floats
    solution: Floats
    chosen: Ints
    amplitude: Floats
    spread: Floats
    candidate: Ints
    likelihood: Floats


class JudgeState(NamedTuple):
    """State of the judge.

    Attributes
    ----------
    step : ndarray
        Of the last sample, shape (1,).
    raw, moved : ndarray
        The last sample as measured, and the magnitude of its change; shape (4, n).
    resolution : ndarray
        Least change of a channel so far, shape (4, n); infinite at the beginning.
    restoring : ndarray
        r at the last judged sample, shape (n,), N.
    verdict : ndarray
        Whether each value of the last sample was replaced, shape (4, n).
    wrong : ndarray
        Steps of the last replaced values, ring buffers, shape (4, n, m).
    counts : ndarray
        Number of replaced values so far, shape (4, n).
    told : ndarray
        Sets that were replaced at the last samples, shape (n, 1 + REVISED).
    alive, made : Branches
        After the last sample, and those that the present one makes.
    count : ndarray
        Number of those alive, shape (n,).
    travel, gained, rise, turned : ndarray
        Largest recent dt |v| and dt |a|, last change of a, and largest recent change of that, (n,).
    pressed : ndarray
        Largest recent change of the oil's force by flow or motion in a period, shape (n,), N.
    strained : ndarray
        Largest recent |r|, shape (n,), N.
    missed, motion : ndarray
        Recent sums of squares of what relations (1) to (3) leave, less noise, and of the motion
        that they describe; shape (3, n).
    scatter : ndarray
        Recent variance of (3), where the oil is not known, and of (4), less noise; shape (2, n).
    asked : ndarray
        The last two reference forces, the newest first, shape (2, n), N.
    asked_jump, asked_turn : ndarray
        Their largest recent change, and second difference, shape (n,), N.
    known : ndarray
        Largest recent jump of r that later samples have confirmed, shape (n,), N.
    compared : Comparison
        Room.
    """

    step: Ints
    raw: Floats
    moved: Floats
    resolution: Floats
    restoring: Floats
    verdict: Ints
    wrong: Ints
    counts: Ints
    told: Ints
    alive: Branches
    made: Branches
    count: Ints
    travel: Floats
    gained: Floats
    rise: Floats
    turned: Floats
    pressed: Floats
    strained: Floats
    missed: Floats
    motion: Floats
    scatter: Floats
    asked: Floats
    asked_jump: Floats
    asked_turn: Floats
    known: Floats
    compared: Comparison


def judge_arrays(
    noise: Floats,
    rest: Floats,
    oil: Floats,
    mass: Floats,
    stiffness: Floats,
    ranges: Floats,
    late: float,
    dt: float,
) -> tuple[JudgeParameters, JudgeState]:
    """Put the judge of n axes into arrays; see `JudgeParameters`.

    A channel of rest without noise has that of its sensor, and the bias that is no fault.
    """
    n, half, bend = noise.shape[1], 0.5 * dt, dt * dt / 12.0
    now, before = np.zeros((2, n, 4, 4))
    for i in range(n):
        k, leak, m = oil[i, 0], oil[i, 1] * dt, mass[i, i]
        now[i] = (
            *((1.0, -half, bend, 0.0), (0.0, 1.0, -half, 0.0)),
            *((0.0, half * k, -bend * k, 1.0), (0.0, 0.0, -m, 1.0)),
        )
        before[i] = (
            *((1.0, half, bend, 0.0), (0.0, 1.0, half, 0.0)),
            *((0.0, -half * k, -bend * k, 1.0 - leak if k else 2.0), (0.0, 0.0, 0.0, 0.0)),
        )
    orders = 2.0 * ranges[3] / noise[3]
    finite = np.isfinite(orders)
    parameters = JudgeParameters(
        dt=dt,
        recent=math.exp(-dt / RECENT_MEMORY),
        brief=math.exp(-dt / BRIEF_MEMORY),
        events=math.exp(-dt / EVENT_MEMORY),
        late=late,
        noise=noise,
        rest=np.ascontiguousarray(rest),
        oil=np.ascontiguousarray(oil),
        mass=mass,
        stiffness=stiffness,
        range=ranges,
        now=now,
        before=before,
        spread=np.log(1.0 + np.log(np.where(finite, orders, UNKNOWN))),
        window=round(WINDOW / dt),
    )

    def numbers(*shape: int) -> Floats:
        return np.zeros(shape)

    def integers(*shape: int) -> Ints:
        return np.zeros(shape, dtype=np.int64)

    def branches() -> Branches:
        one, two = (n, ALIVE), (n, ALIVE, 2)
        floats = (one, (*two, 4), (*two, 4), two, two, one, (*one, 3))
        return Branches(*(np.zeros(shape) for shape in floats), integers(*one, 1 + REVISED))

    candidates = ALIVE * len(SETS)
    state = JudgeState(
        step=integers(1),
        raw=numbers(4, n),
        moved=numbers(4, n),
        resolution=numbers(4, n),
        restoring=numbers(n),
        verdict=integers(4, n),
        wrong=integers(4, n, max(3, math.ceil(LASTS / dt - 1e-9))),
        counts=integers(4, n),
        told=integers(n, 1 + REVISED),
        alive=branches(),
        made=branches(),
        count=integers(n),
        travel=numbers(n),
        gained=numbers(n),
        rise=numbers(n),
        turned=numbers(n),
        pressed=numbers(n),
        strained=numbers(n),
        missed=numbers(3, n),
        motion=numbers(3, n),
        scatter=numbers(2, n),
        asked=numbers(2, n),
        asked_jump=numbers(n),
        asked_turn=numbers(n),
        known=numbers(n),
        compared=Comparison(
            *(numbers(4) for _ in range(4)),
            *(numbers(4, 4), numbers(4, 4), numbers(4, 7), numbers(7, 7)),
            *(numbers(6, 6), numbers(6), integers(6)),
            *(numbers(candidates, 6), numbers(candidates, 6)),
            *(integers(candidates, 2), numbers(candidates)),
        ),
    )
    return parameters, state
