"""One sampling period of the simulated rig, compiled."""

import math
from typing import Annotated, NamedTuple

from seft_msgs_py.arrays import Floats, Ints

from seft_plant_sim.compiled import bounded, compiled, multiply
from seft_plant_sim.simulated.actuator import OPENING, PER_CAPACITY, STROKE_COLUMN
from seft_plant_sim.simulated.continuous_model import Dynamics, Motion, integrate
from seft_plant_sim.simulated.faults import Faults, obey, show_fault, wear
from seft_plant_sim.simulated.sensors import Channels, Sensing, measure_channels, read_sensors

_STROKE, FORCE_CAPACITY, _VALVE = 16, 32, 64
SATURATED_PARTS = {"stroke": _STROKE, "force_capacity": FORCE_CAPACITY, "valve": _VALVE}
"""Bits of a step's result, by what is saturated; smaller ones are those of the guard."""
LARGEST_TRAVEL, FORCE_NOW = range(2)
"""Places of `RigState.peaks`."""
_AT_REST = 1e-4  # m/s
RESTS = 10  # steps below that, so that the turning point of a vibration does not count as rest


class RigParameters(NamedTuple):
    """Parameters of a rig of n axes.

    Attributes
    ----------
    dynamics : Dynamics
        Of actuator and specimen, over the stretches of a sampling period.
    drive_limit : ndarray
        Drive at which the actuators saturate, shape (n,).
    newer : ndarray
        Samples by which the drive that acts is newer than the oldest one in the line, shape (n,).
    change : ndarray
        The last stretch before the delayed drive changes, shape (n,); -1: it changes at the sample.
    sensing : Sensing
        What the sensors show.
    channels : Channels
        Of the sensors.
    faults : Faults
        Of the rig.
    """

    dynamics: Dynamics
    drive_limit: Floats
    newer: Ints
    change: Ints
    sensing: Sensing
    channels: Channels
    faults: Faults


class RigState(NamedTuple):
    """State of a rig: arrays of zeros, but for ``motion``."""

    motion: Motion  # of actuator and specimen
    true: Annotated[Floats, "channels"]  # displacement (m), velocity, acceleration and force (N)
    read: Annotated[Floats, "periods", "read"]  # what the sensors have read in the last periods, a
    # ring buffer over the channels; (0, 0) if they show the true state
    shown: Annotated[Floats, "read"]  # what of it they show at the sample
    asked: Annotated[Floats, "n"]  # last command, within the limits of the drive
    line: Annotated[Floats, "line", "n"]  # ring buffer of the drives during the dead time
    oldest: Annotated[Ints, 1]  # place of the oldest drive in it
    faulty: Annotated[Floats, "faults", "memory"]  # memory of the faults
    peaks: Annotated[Floats, 2]  # largest true displacement so far (m), and force now (N), any axis


@compiled
def rig_step(
    parameters: RigParameters,
    state: RigState,
    step: int,
    command: Floats,
    noise: Floats,
    measured: Floats,
) -> int:
    """Apply a command and take the next sample; step 0 is at rest.

    Parameters
    ----------
    state : RigState
        Is updated.
    step : int
        Step of the sample.
    command : ndarray
        Drive of the actuators after the last sample, shape (n,), V or N.
    noise, measured : ndarray
        Noise of the sensors at this step, shape (4, n), and that of faults below it; what the
        sensors show, which is written, shape (4, n).

    Returns
    -------
    int
        Bits of `SATURATED_PARTS`.
    """
    if step:
        move(parameters, state, step - 1, command)
    shown, places = state.true, len(state.read)
    if places:
        shown = state.shown
        for i in range(len(shown)):
            shown[i] = state.read[(step - parameters.sensing.whole[i]) % places, i]
    measure_channels(parameters.channels, shown, noise, measured)
    if len(parameters.faults.numbers):
        show_fault(parameters.faults, step, noise, state.faulty, measured)
    n, found = len(command), 0
    z, pistons = state.motion.work, parameters.dynamics.pistons
    for i in range(len(pistons)):
        if abs(z[i]) >= pistons[i, STROKE_COLUMN]:
            found |= _STROKE
        if abs(z[2 * n + i]) * pistons[i, PER_CAPACITY] >= state.motion.supply[i]:
            found |= FORCE_CAPACITY
        if abs(z[3 * n + i]) >= pistons[i, OPENING]:
            found |= _VALVE
    return found


@compiled
def move(parameters: RigParameters, state: RigState, step: int, command: Floats) -> None:
    """Advance the true state by one sampling period, with the command after the sample of a step.

    If the actuator responds to its drive without delay (the ideal one), the new sample already
    contains the response.
    """
    dynamics, motion, line = parameters.dynamics, state.motion, state.line
    n, places, oldest = len(command), len(line), state.oldest[0]
    drive = len(motion.state)
    newer, change = parameters.newer, parameters.change
    if len(parameters.faults.numbers):
        wear(parameters.faults, step, dynamics, motion)
    last, senses = len(dynamics.steps) - 1, len(state.read)
    for stretch in range(last + 1):
        for i in range(n):
            place = oldest + newer[i] + (1 if stretch > change[i] else 0)
            motion.work[drive + i] = line[place if place < places else place - places, i]
        integrate(dynamics, stretch, motion)
        if senses and stretch < last:
            for i in range(n):
                place = oldest + newer[i] + (1 if stretch >= change[i] else 0)
                motion.work[drive + i] = line[place if place < places else place - places, i]
            read = state.read[(step + 1) % senses]
            read_sensors(parameters.sensing, motion, stretch, read)
    for i in range(n):
        state.asked[i] = bounded(command[i], parameters.drive_limit[i])
        line[oldest, i] = state.asked[i]
        if len(parameters.faults.numbers):
            obeyed = obey(parameters.faults, step, state.faulty, i, state.asked[i])
            line[oldest, i] = bounded(obeyed, parameters.drive_limit[i])
    for i in range(n):
        place = oldest + newer[i] + (2 if change[i] < 0 else 1)
        motion.work[drive + i] = line[place if place < places else place - places, i]
    multiply(dynamics.output, motion.work, state.true)
    if senses:
        read = state.read[(step + 1) % senses]
        read_sensors(parameters.sensing, motion, last, read)
    state.oldest[0] = oldest + 1 if oldest + 1 < places else 0
    _note_peaks(n, state.true, state.peaks)


@compiled
def _note_peaks(n: int, true: Floats, peaks: Floats) -> None:
    """Update `RigState.peaks`."""
    peaks[FORCE_NOW] = 0.0
    for i in range(n):
        peaks[LARGEST_TRAVEL] = max(peaks[LARGEST_TRAVEL], abs(true[i]))
        peaks[FORCE_NOW] = max(peaks[FORCE_NOW], abs(true[3 * n + i]))


@compiled
def come_to_rest(
    parameters: RigParameters,
    state: RigState,
    step: int,
    plan: Floats,
    offset: Floats,
    last: Floats,
    safe: Floats,
    closing: int,
    longest: int,
    command: Floats,
) -> tuple[int, float]:
    """Follow the commands of a plan, then move to the safe value, until the rig is at rest.

    The offset of the last command from the plan goes in the time in which a valve closes.

    Parameters
    ----------
    parameters, state
        The state is updated.
    step : int
        Of the last sample.
    plan : ndarray
        Shape (m, n); m is 0 without a plan.
    offset, last : ndarray
        How much more the last command is than planned, and that command, shapes (n,).
    safe, closing, longest
        See `seft_plant_sim.hardware.safe_stop.Safe`; the last counts from the end of the plan on.
    command : ndarray
        Room, shape (n,).

    Returns
    -------
    tuple of int and float
        Number of steps, and the largest true force, N.
    """
    n, planned = len(safe), len(plan)
    steps, resting, peak = 0, 0, 0.0
    while steps < planned + longest and resting < RESTS:
        stop_command(steps, plan, offset, last, safe, closing, command)
        move(parameters, state, step + steps, command)
        peak = max(peak, state.peaks[FORCE_NOW])
        steps, fastest = steps + 1, 0.0
        for i in range(n):
            fastest = max(fastest, abs(state.true[n + i]))
        resting = resting + 1 if fastest < _AT_REST and steps > planned else 0
    return steps, peak


@compiled
def stop_command(
    taken: int,
    plan: Floats,
    offset: Floats,
    last: Floats,
    safe: Floats,
    closing: int,
    command: Floats,
) -> None:
    """Give a command of a stop: along a plan, and then to the safe value.

    Parameters
    ----------
    taken : int
        Commands of the stop before it.
    plan, offset, last, safe, closing
        See `come_to_rest`.
    command : ndarray
        The result, shape (n,), V.
    """
    planned = len(plan)
    for i in range(len(safe)):
        if taken < planned:
            command[i] = plan[taken, i] + left_open(taken + 1, closing) * offset[i]
        else:
            end = plan[planned - 1, i] if planned else last[i]
            command[i] = safe[i] + left_open(taken - planned + 1, closing) * (end - safe[i])


@compiled
def left_open(taken: int, steps: float) -> float:
    """Fraction of the last command that is left after some of the steps in which a valve closes.

    A valve that closes at once on a mass M with velocity v makes a force peak of v sqrt(k M) in
    oil of stiffness k. Half a cosine has no corner that would excite the oil column.
    """
    if taken >= steps:
        return 0.0
    return 0.5 * (1.0 + math.cos(math.pi * taken / steps))
