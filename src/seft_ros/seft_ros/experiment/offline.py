"""The experiment in one process, without ROS: the same blocks, called in a row."""

import time
from collections import deque
from collections.abc import Callable

import numpy as np
from seft_msgs_py.experiment import Experiment
from seft_msgs_py.timebase import Timebase
from seft_msgs_py.topics import GROUND_MOTION, REFERENCE_FORCE, RIG_STATE, VALVE_COMMAND

from seft_ros.experiment.blocks import Blocks
from seft_ros.experiment.state_machine import while_ramping_down
from seft_ros.force_controller.interlock import Interlock
from seft_ros.recording.environment import describe_environment
from seft_ros.recording.record import Record, Series, Trip
from seft_ros.recording.samples import EstimateBuffer
from seft_ros.reference_force.estimate_sampler import EstimateSampler

PROGRESS_STEPS = 5000


def simulate(
    experiment: Experiment,
    blocks: Blocks,
    progress: Callable[[int], None] | None = None,
) -> Record:
    """Run a test offline.

    Parameters
    ----------
    experiment : Experiment
        Its resolved configuration.
    blocks : Blocks
        Made of it by `build_blocks`.
    progress : callable, optional
        Called with the number of steps done, now and then.

    Returns
    -------
    Record
        Bit for bit what nodes over DDS give where no command is missed.
    """
    motion, rig = blocks.ground_motion.samples, blocks.rig
    total, axes = motion.shape
    known, window = blocks.ground_motion.known, 1 + blocks.reference_force.preview
    states = np.empty((total, 4, axes))
    forces = np.empty((total, axes))
    commands = np.empty((total, axes))
    reference_force = blocks.reference_force
    reference_force.reset()
    interlock = Interlock.from_parameters(
        blocks.force_controller,
        experiment["force_controller"],
        experiment.axes,
        experiment.timebase,
    )
    sampler = EstimateSampler(reference_force, experiment.timebase)
    estimates = EstimateBuffer()
    force_step, valve_step = reference_force.step, interlock.step
    loop_delay = experiment["reference_force"]["loop_delay"]
    coming = deque([np.zeros(axes)] * loop_delay)  # forces that were computed before their step

    valve_driven = rig.drive == VALVE_COMMAND.name
    environment = describe_environment("simulate")
    start = time.perf_counter()
    state = rig.reset()
    step = 0
    with np.errstate(over="ignore", invalid="ignore"):  # the limits see what is not finite
        while True:
            coming.append(force_step(known[step : step + window], state))
            force = coming.popleft()
            command = valve_step(step, force, state)
            states[step] = state
            forces[step] = force
            commands[step] = command
            if step >= sampler.due:
                estimates.append(step, sampler.sample(step))
            step += 1
            ended = rig.violation is not None or interlock.reason or reference_force.at_rest
            if step == total or ended:
                break
            if progress is not None and step % PROGRESS_STEPS == 0:
                progress(step)
            state = rig.step(command if valve_driven else force)
    wall = time.perf_counter() - start

    steps = np.arange(step, dtype=np.int64)
    return Record(
        experiment=experiment,
        series={
            GROUND_MOTION.name: Series(steps, motion[:step, np.newaxis, :]),
            RIG_STATE.name: Series(steps, states[:step]),
            REFERENCE_FORCE.name: Series(steps, forces[:step, np.newaxis, :]),
            VALVE_COMMAND.name: Series(steps, commands[:step, np.newaxis, :]),
        },
        estimates=estimates.series(),
        trip=_trip(blocks, interlock, step - 1, experiment.timebase),
        saturation=rig.saturation,
        wall_s=wall,
        environment=environment,
    )


def _trip(blocks: Blocks, interlock: Interlock, last: int, timebase: Timebase) -> Trip | None:
    """Tell what ended the test before the record did, as supervisor and rig would."""
    violation, cause = blocks.rig.violation or interlock.reason, blocks.reference_force.cause
    if violation:
        reason = violation if cause is None else while_ramping_down(violation, cause)
        return Trip(reason, last, timebase.stamp_ns(last) / 1e9)
    if cause is None:
        return None
    step = last + 1 - blocks.reference_force.steps_ramped
    return Trip(cause, step, timebase.stamp_ns(step) / 1e9)
