"""Parameters and state of the judge, whose step is `judge`: records, one of each axis."""

import math
from typing import Annotated, NamedTuple

import numpy as np
from seft_msgs_py.arrays import Floats, Ints, Record, zeros

from seft_plant_sim.channels import Derivation

RECENT_MEMORY, BRIEF_MEMORY, EVENT_MEMORY = 0.3, 0.05, 3.0
"""Time constants, s, of the memory of the largest force and motion of the oil, of the largest
change in a sample, and of what the test has shown: a quarter of a cycle at 1 Hz, ..., three cycles
at 1 Hz."""
LASTS, MOST, WINDOW = 0.006, 3, 0.05
"""Duration of wrong samples of an axis (as many at least) within a time, s, that ends the test; of
samples with several wrong channels, as many end it at any rate: what stands in for these is known
for as long."""
BIAS = 2.0
"""Largest constant error of a sensor that is no fault, over its RMS noise."""
ASSUMED = np.array([0.1 / 3.0, 0.1 / 3.0, 0.35 / 6.0])
"""Part of the motion that relations (1) to (3) leave, RMS, before the test has shown it: a
calibration error of 10 % as three standard deviations; the oil balance's tolerance as six."""
ANY = 2.0 / math.sqrt(2.0 * math.pi)
"""Standard deviation of a wrong value over its sensor's range: as dense as if all were alike."""
UNKNOWN = 1e9
"""Standard deviation of what nothing is known of, in any unit."""

SETS = np.array(
    [
        *(0, 0b000001, 0b000010, 0b000100, 0b001000, 0b010000, 0b100000, 0b110000),
        *(0b000011, 0b000101, 0b001001, 0b000110, 0b001010, 0b001100),
        *(0b000111, 0b001011, 0b001101, 0b001110, 0b001111),
        *(0b100001, 0b100010, 0b100100, 0b101000, 0b010001, 0b010010, 0b010100, 0b011000),
    ],
    dtype=np.int64,
)
"""The hypotheses: sets of unknowns. Bits: x, v, a, f wrong, events of oil and specimen."""
ALIVE = 6
"""Histories of an axis that are kept: the four channels, an event and the sound one."""
REVISED = 3
"""Samples after which a decision is final."""
CANDIDATES = ALIVE * len(SETS)
OIL_EVENT = 0b010000
"""Bit of the oil's event in a set."""
ANY_ROW, SEVERAL_ROW = 4, 5
"""Rows of the counts of samples of which any channel was replaced, and several."""

BRANCH = np.dtype(
    [
        ("weight", "f8"),  # logarithm of its likelihood over that of the first
        ("value", "f8", (2, 4)),  # the channels at the last sample and at the one before
        ("variance", "f8", (2, 4)),  # of these
        ("restoring", "f8", (2,)),  # r at these, N
        ("blur", "f8", (2,)),  # variance of r, N^2
        ("settling", "f8"),  # variance of r that an event has left, N^2
        ("event", "f8", (3,)),  # jumps of r at the last samples, N
        ("error", "f8", (4,)),  # of channels that were wrong at the last sample
        ("wrong", "i8", (1 + REVISED,)),  # sets at the last samples
    ]
)
"""A history of an axis that is possible."""
AXIS_STATE = np.dtype(
    [
        ("alive", BRANCH, (ALIVE,)),  # after the last sample, the likeliest first
        ("made", BRANCH, (ALIVE,)),  # by the present sample
        ("count", "i8"),  # of those alive
        ("travel", "f8"),  # largest recent dt |v|, m
        ("gained", "f8"),  # ... dt |a|, m/s
        ("turned", "f8"),  # ... second difference of a, m/s^2
        ("pressed", "f8"),  # ... change of the oil's force by flow or motion in a period, N
        ("strained", "f8"),  # ... |r|, N
        ("bent", "f8"),  # ... second difference of f, N
        ("rise", "f8", (2,)),  # last change of a, m/s^2, and f, N
        ("part", "f8", (3,)),  # mean square of what (1) to (3) leave, over that of the motion
        ("missed", "f8", (3,)),  # recent squares of what (1) to (3) leave, less noise
        ("motion", "f8", (3,)),  # ... of the motion that they describe
        ("usual", "f8", (2, 4)),  # variances of the channels of the last two samples
        ("blur", "f8", (4, 4)),  # covariance of the residuals by these
        ("root", "f8", (4, 4)),  # its Cholesky factor
        ("scatter", "f8"),  # recent variance of (4), N^2
        ("rises", "f8"),  # recent mean square of the change of r in a sample, N^2
        ("asked", "f8", (2,)),  # the last reference forces, N
        ("asked_jump", "f8"),  # their largest recent change, N
        ("asked_turn", "f8"),  # ... second difference, N
        ("known", "f8"),  # largest jump of r that a later sample has confirmed, of cycles, N
        ("lately", "f8"),  # likewise, of the last samples
    ]
)
"""State of an axis."""
AXIS_FACTS = np.dtype(
    [
        ("dt", "f8"),  # sampling period, s
        ("recent", "f8"),  # factors per step, see `RECENT_MEMORY`
        ("brief", "f8"),
        ("events", "f8"),
        ("late", "f8"),  # time by which a derived velocity is late, s; 0: it is measured
        ("gain", "f8"),  # of its `Derivation`, 1/s
        ("pole", "f8"),
        ("noise", "f8", (4,)),  # variance of the channels
        ("step", "f8", (4,)),  # of the converters; infinite if it is not known
        ("range", "f8", (4,)),  # largest value of each sensor; infinite if it is not known
        ("precision", "f8", (4,)),  # inverse variance of a wrong value, see `ANY`
        ("oil", "f8"),  # k_oil, N/m; 0: not known
        ("leak", "f8"),  # lambda, 1/s
        ("imposed", "i8"),  # whether a servo imposes the motion, whatever f is
        ("never", "i8"),  # unknowns that it has not: events of its oil; a velocity without sensor
        ("mass", "f8"),  # its own of the specimen, kg; 0: not known
        ("stiffness", "f8"),  # likewise, N/m
        ("now", "f8", (4, 4)),  # L of the relations, see `judge_step`
        ("before", "f8", (4, 4)),  # D
        ("orders", "f8"),  # logarithm of the orders of magnitude (factors of e) of an event
    ]
)
"""What is known of an axis."""
JUDGE_ROOM = np.dtype(
    [
        ("noise", "f8", (4,)),  # variance of the channels, with the converter's
        ("seen", "f8", (4,)),  # the sample
        ("forced", "i8"),  # channels without a number, and those at their ends four bits higher
        ("beside", "f8"),  # force by the acceleration of other axes, N
        ("doubt", "f8"),  # its variance, N^2
        ("most", "f8", (2,)),  # largest rise and fall of r by the motion, N; infinite: any
        ("off", "f8", (4,)),  # residuals e of the relations
        ("left", "f8", (4,)),  # their variance Q
        ("covariance", "f8", (4, 4)),  # S, of which the lower half is used
        ("root", "f8", (4, 4)),  # its Cholesky factor C
        ("whitened", "f8", (7, 4)),  # C^-1 times the columns of channels, events, and e
        ("gram", "f8", (7, 7)),  # products of these columns
        ("factor", "f8", (6, 6)),  # Cholesky factor of a set's part of them
        ("solution", "f8", (6,)),
        ("chosen", "i8", (6,)),  # places of the set's unknowns
        ("branch", "i8", (CANDIDATES,)),  # of a candidate
        ("which", "i8", (CANDIDATES,)),  # its set
        ("likelihood", "f8", (CANDIDATES,)),  # its weight
        ("amplitude", "f8", (CANDIDATES, 6)),  # its unknowns
        ("spread", "f8", (CANDIDATES, 6)),  # their variances
    ]
)
"""Room to compare a sample of an axis with a branch."""


class JudgeParameters(NamedTuple):
    """Parameters of the judge of n axes.

    Attributes
    ----------
    axes, rest : recarray
        `AXIS_FACTS` of each axis, and its `AXIS_STATE` before step 0; shape (n,).
    mass : ndarray
        Of the assumed specimen, shape (n, n), kg; 0: not known.
    springs : ndarray
        Stiffness between axes, of one (in the diagonal) to the ground, shape (n, n), N/m.
    most : int
        Wrong samples of an axis that end the test, see `LASTS`.
    """

    axes: Record
    rest: Record
    mass: Floats
    springs: Floats
    most: int


class JudgeState(NamedTuple):
    """State of the judge: arrays of zeros."""

    step: Annotated[Ints, 1]  # of the last sample
    place: Annotated[Ints, 1]  # of the last sample in ``sets``
    axes: Annotated[Record, AXIS_STATE, "n"]
    room: Annotated[Record, JUDGE_ROOM, 1]
    raw: Annotated[Floats, 4, "n"]  # the last sample as measured
    moved: Annotated[Floats, 4, "n"]  # magnitude of its change
    resolution: Annotated[Floats, 4, "n"]  # least change of a channel so far; infinite: none
    restoring: Annotated[Floats, "n"]  # r at the last judged sample, N
    sets: Annotated[Ints, "window", "n"]  # of the last samples, a ring buffer
    counts: Annotated[Ints, 6, "n"]  # of replaced values in these; of samples, see `ANY_ROW`


def judge_arrays(
    noise: Floats,
    rest: Floats,
    oil: Floats,
    mass: Floats,
    stiffness: Floats,
    ranges: Floats,
    steps: Floats,
    late: float,
    derivation: Derivation,
    imposed: Ints,
    dt: float,
) -> tuple[JudgeParameters, JudgeState]:
    """Put the judge of n axes into arrays.

    Parameters
    ----------
    noise : ndarray
        RMS noise of displacement, velocity, acceleration and force, shape (4, n).
    rest : ndarray
        Mean and standard deviation of the channels before step 0, shape (2, 4, n).
    oil : ndarray
        k_oil, N/m, and lambda, 1/s, shape (n, 2); k_oil 0: not known.
    mass, stiffness : ndarray
        Of the assumed specimen, shape (n, n), kg and N/m; 0: not known.
    ranges, steps, late, derivation, imposed, dt
        See `AXIS_FACTS`; the first two of shape (4, n).
    """
    n, half, bend = noise.shape[1], 0.5 * dt, dt * dt / 12.0
    state = zeros(JudgeState, {"n": n, "window": round(WINDOW / dt)})
    axes, begun = np.zeros(n, AXIS_FACTS), np.zeros(n, AXIS_STATE)  # records are slow in Python
    axes["dt"], axes["late"], axes["noise"], axes["range"] = dt, late, noise.T**2, ranges.T
    axes["step"], axes["imposed"], axes["never"] = steps.T, imposed, imposed * OIL_EVENT
    axes["recent"], axes["brief"] = math.exp(-dt / RECENT_MEMORY), math.exp(-dt / BRIEF_MEMORY)
    axes["events"], axes["oil"], axes["leak"] = math.exp(-dt / EVENT_MEMORY), *oil.T
    axes["mass"], axes["stiffness"] = np.diag(mass), np.diag(stiffness)
    axes["precision"] = (ANY * np.minimum(ranges.T, UNKNOWN)) ** -2.0
    axes["orders"] = np.log(1.0 + np.log(np.clip(2.0 * ranges[3] / noise[3], 1.0, UNKNOWN)))
    for one in range(n):
        k, m, leak = oil[one, 0], mass[one, one], oil[one, 1] * dt
        axes["now"][one] = (
            *((1.0, -half, bend, 0.0), (0.0, 1.0, -half, 0.0)),
            *((0.0, half * k, -bend * k, 1.0), (0.0, 0.0, -m, 1.0)),
        )
        axes["before"][one] = (
            *((1.0, half, bend, 0.0), (0.0, 1.0, half, 0.0)),
            *((0.0, -half * k, -bend * k, 1.0 - leak if k else 2.0), (0.0, 0.0, 0.0, 0.0)),
        )
    if derivation.gain:
        _derive(axes, *derivation)
    begun["count"], begun["part"], first = 1, ASSUMED**2, begun["alive"][:, 0]
    first["value"], first["variance"] = (rest[k].T[:, np.newaxis] ** (1 + k) for k in range(2))
    own = np.diag(mass)
    first["restoring"] = (rest[0, 3] - own * rest[0, 2])[:, np.newaxis]
    first["blur"] = (rest[1, 3] ** 2 + own**2 * rest[1, 2] ** 2)[:, np.newaxis]
    springs = np.diag(stiffness.sum(axis=1) + axes["stiffness"]) - stiffness
    most = max(MOST, math.ceil(LASTS / dt - 1e-9))
    records = axes.view(np.recarray), begun.view(np.recarray)
    return JudgeParameters(*records, mass, springs, most), state


def _derive(axes: Record, gain: float, pole: float) -> None:
    """Make the velocity follow from the displacement, v = pole v1 + gain (x - x1).

    Its noise is then gain times that of x, and m = pole m1 - gain (1 - pole) times that of x1.
    """
    now, before = axes["now"], axes["before"]
    axes["gain"], axes["pole"] = gain, pole
    axes["never"] |= 1 << 1
    axes["noise"][:, 1] = gain * gain * (1.0 - pole) / (1.0 + pole) * axes["noise"][:, 0]
    before[:, :, 0] += gain * (before[:, :, 1] + (1.0 - pole) * now[:, :, 1])
    before[:, :, 1] -= pole * now[:, :, 1]
    now[:, :, 0] += gain * now[:, :, 1]
    now[:, :, 1] = 0.0
