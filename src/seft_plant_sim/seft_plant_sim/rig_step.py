"""One sampling period of the rig, compiled: the same function in a node and in a loop."""

from typing import NamedTuple

from seft_msgs_py.arrays import Floats, Ints

from seft_plant_sim.actuator import OPENING, PER_CAPACITY
from seft_plant_sim.actuator import STROKE_COLUMN as STROKE_COLUMN
from seft_plant_sim.compiled import compiled, multiply
from seft_plant_sim.continuous_model import Dynamics, Motion, integrate
from seft_plant_sim.limits import exceeds, is_exceeded
from seft_plant_sim.sensors import CHANNELS, Channels, measure_channels

_STROKE, FORCE_CAPACITY, _VALVE = 16, 32, 64
PERSISTENT = 3
"""Samples in a row beyond a limit that end the test: fewer are wrong samples, which the force
controller judges."""
RIG_LIMIT, BLIND = 128, 256
"""Bits of a step's result: 1 to 8 for saturated sensors, then other saturated parts, then the
reasons to end the test: a limit, or sensors that are saturated for too long."""
ENDS = {f"{name}_range": 1 << row for row, name in enumerate(CHANNELS)}
ENDS |= {"stroke": _STROKE, "force_capacity": FORCE_CAPACITY, "valve": _VALVE}
"""Bits of saturated parts, by name."""


class RigParameters(NamedTuple):
    """Parameters of a rig of n axes.

    Attributes
    ----------
    dynamics : Dynamics
        Of actuator and specimen: from the last sample to the drive's change, and after it.
    drive_limit : ndarray
        Drive at which the actuators saturate, shape (n,).
    changes_between : bool
        Whether the delayed drive changes between the samples.
    channels : Channels
        Of the sensors.
    limits : ndarray
        `Limits.values`, shape (8,).
    window : int
        Steps of a second.
    """

    dynamics: Dynamics
    drive_limit: Floats
    changes_between: bool
    channels: Channels
    limits: Floats
    window: int


class RigState(NamedTuple):
    """State of a rig.

    Attributes
    ----------
    motion : Motion
        Of actuator and specimen.
    true : ndarray
        Displacement (m), velocity (m/s), acceleration (m/s^2) and force (N) at the sample, (4n,).
    line : ndarray
        Ring buffer of the drives during the dead time, shape (whole periods + 2, n).
    counts : ndarray
        Place of the oldest drive, number of blind samples, and of samples in a row beyond a limit;
        shape (3,).
    measured, change : ndarray
        The sample as measured, and its change since the last one, shape (4, n).
    largest : ndarray
        Largest magnitudes of both so far, shape (8,).
    blind : ndarray
        Ring buffer of the last steps at which a sensor was at its range.
    """

    motion: Motion
    true: Floats
    line: Floats
    counts: Ints
    measured: Floats
    change: Floats
    largest: Floats
    blind: Ints


@compiled
def rig_step(
    parameters: RigParameters,
    state: RigState,
    step: int,
    command: Floats,
    noise: Floats,
    measured: Floats,
) -> int:
    """Apply a command and take the next sample; step 0 sets the rig to rest instead.

    Parameters
    ----------
    state : RigState
        Is updated.
    step : int
        Step of the sample.
    command : ndarray
        Drive of the actuators after the last sample, shape (n,), V or N.
    noise, measured : ndarray
        Noise of the sensors at this step, and the sample, which is written; shape (4, n).

    Returns
    -------
    int
        Bits `RIG_LIMIT` or `BLIND` if the test must end, and those of `ENDS`.
    """
    if step == 0:
        rest(state)
    else:
        move(parameters, state, command)
    found = measure_channels(parameters.channels, step, state.true, noise, state.measured, measured)
    blind = found > 0
    beyond = exceeds(parameters.limits, step, state.measured, measured, state.largest)
    state.counts[2] = state.counts[2] + 1 if beyond else 0
    if state.counts[2] >= PERSISTENT:
        found |= RIG_LIMIT
    elif blind:
        if is_exceeded(state.blind, state.counts[1], step, parameters.window):
            found |= BLIND
        state.counts[1] += 1
    n = len(command)
    for row in range(4):
        for i in range(n):
            state.change[row, i] = measured[row, i] - state.measured[row, i] if step else 0.0
            state.measured[row, i] = measured[row, i]
    z, pistons = state.motion.work, parameters.dynamics.pistons
    for i in range(len(pistons)):
        if abs(z[i]) >= pistons[i, STROKE_COLUMN]:
            found |= _STROKE
        if abs(z[2 * n + i]) * pistons[i, PER_CAPACITY] >= 1.0:
            found |= FORCE_CAPACITY
        if abs(z[3 * n + i]) >= pistons[i, OPENING]:
            found |= _VALVE
    return found


@compiled
def move(parameters: RigParameters, state: RigState, command: Floats) -> None:
    """Advance the true state by one sampling period, with a command from the new sample on.

    If the actuator responds to its drive without delay (the ideal one), the new sample already
    contains the response.
    """
    dynamics, motion, line = parameters.dynamics, state.motion, state.line
    n, places, oldest = len(command), len(line), state.counts[0]
    drive = len(motion.state)
    after = (oldest + 1) % places
    for stretch in range(2):
        place = after if stretch else oldest
        for i in range(n):
            motion.work[drive + i] = line[place, i]
        integrate(dynamics, stretch, motion)
    for i in range(n):
        limit, asked = parameters.drive_limit[i], command[i]
        line[oldest, i] = limit if asked > limit else -limit if asked < -limit else asked
    now = after if parameters.changes_between else (oldest + 2) % places
    for i in range(n):
        motion.work[drive + i] = line[now, i]
    multiply(dynamics.output, motion.work, state.true)
    state.counts[0] = after


@compiled
def rest(state: RigState) -> None:
    """Set the rig to rest, without drive."""
    state.motion.work[:] = 0.0
    state.motion.springs[:] = 0.0
    state.true[:] = 0.0
    state.line[:] = 0.0
    state.counts[:] = 0
    state.largest[:] = 0.0
