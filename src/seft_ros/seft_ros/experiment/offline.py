"""The experiment in one process, without ROS: the same blocks, called in a row."""

import time
from collections.abc import Callable

import numpy as np
from seft_msgs_py.experiment import Experiment
from seft_msgs_py.topics import GROUND_MOTION, REFERENCE_FORCE, RIG_STATE, VALVE_COMMAND

from seft_ros.experiment.blocks import Blocks
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
    blocks.reference_force.reset()
    interlock = Interlock.from_parameters(
        blocks.force_controller,
        experiment["force_controller"],
        experiment.axes,
        experiment.timebase,
    )
    sampler = EstimateSampler(blocks.reference_force, experiment.timebase)
    estimates = EstimateBuffer()
    force_step, valve_step = blocks.reference_force.step, interlock.step

    valve_driven = rig.drive == VALVE_COMMAND.name
    environment = describe_environment("simulate")
    start = time.perf_counter()
    state = rig.reset()
    step = 0
    with np.errstate(over="ignore", invalid="ignore"):  # the limits see what is not finite
        while True:
            force = force_step(known[step : step + window], state)
            command = valve_step(step, force, state)
            states[step] = state
            forces[step] = force
            commands[step] = command
            if step >= sampler.due:
                estimates.append(step, sampler.sample(step))
            step += 1
            if step == total or rig.violation is not None or interlock.reason:
                break
            if progress is not None and step % PROGRESS_STEPS == 0:
                progress(step)
            state = rig.step(command if valve_driven else force)
    wall = time.perf_counter() - start

    trip = None
    reason = rig.violation or interlock.reason
    if reason:
        trip = Trip(reason, step - 1, (step - 1) * experiment.timebase.dt)
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
        trip=trip,
        saturation=rig.saturation,
        wall_s=wall,
        environment=environment,
    )
