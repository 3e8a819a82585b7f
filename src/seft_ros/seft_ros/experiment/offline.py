"""The experiment in one process, without ROS: the same blocks, called in a row."""

import time
from collections import deque
from collections.abc import Callable

import numpy as np
import numpy.typing as npt
from seft_msgs_py.experiment import Experiment
from seft_msgs_py.timebase import Timebase
from seft_msgs_py.topics import GROUND_MOTION, REFERENCE_FORCE, RIG_STATE, VALVE_COMMAND

from seft_ros.experiment.blocks import Blocks
from seft_ros.experiment.state_machine import while_ramping_down
from seft_ros.recording.environment import describe_environment
from seft_ros.recording.record import Record, Series, Trip
from seft_ros.recording.samples import EstimateBuffer
from seft_ros.reference_force.estimate_sampler import EstimateSampler

Floats = npt.NDArray[np.float64]

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
    forces = np.empty((total, blocks.reference_force.reference_force.shape[1], axes))
    commands = np.empty((total, axes))
    reference_force = blocks.reference_force
    reference_force.reset()
    interlock = blocks.force_controller
    interlock.reset()
    sampler = EstimateSampler(reference_force, experiment.timebase)
    estimates = EstimateBuffer()
    force_step, valve_step = reference_force.step, interlock.step
    loop_delay = experiment["reference_force"]["loop_delay"]
    under_way = deque([np.zeros((1 + loop_delay, 1, axes))] * loop_delay)

    valve_driven = rig.drive == VALVE_COMMAND.name
    environment = describe_environment("simulate")
    start = time.perf_counter()
    state = rig.reset()
    step = 0
    with np.errstate(over="ignore", invalid="ignore"):  # the limits see what is not finite
        while True:
            points = force_step(known[step : step + window], state)
            states[step] = state
            forces[step] = points[0]
            if loop_delay:
                under_way.append(points)
                points = under_way.popleft()[loop_delay:]
            command = valve_step(step, points, state)
            commands[step] = command
            if step >= sampler.due:
                estimates.append(step, sampler.sample(step))
            step += 1
            ended = rig.violation is not None or interlock.reason or reference_force.at_rest
            if step == total or ended:
                break
            if progress is not None and step % PROGRESS_STEPS == 0:
                progress(step)
            state = rig.step(command if valve_driven else points[0, -1])
    wall = time.perf_counter() - start

    return Record(
        experiment=experiment,
        series=loop_series(motion[:step], states[:step], forces[:step], commands[:step]),
        estimates=estimates.series(),
        trip=trip_of(
            rig.violation or interlock.reason,
            reference_force.cause,
            step - 1,
            step - reference_force.steps_ramped,
            experiment.timebase,
        ),
        saturation=rig.saturation,
        wall_s=wall,
        environment=environment,
    )


def loop_series(
    motion: Floats, states: Floats, forces: Floats, commands: Floats
) -> dict[str, Series]:
    """Order the samples of a test by topic, from step 0 on.

    Parameters
    ----------
    motion, commands : ndarray
        Shape (N, n).
    states, forces : ndarray
        Shape (N, 4, n), and (N, q, n) as on the topic.
    """
    steps = np.arange(len(states), dtype=np.int64)
    return {
        GROUND_MOTION.name: Series(steps, motion[:, np.newaxis, :]),
        RIG_STATE.name: Series(steps, states),
        REFERENCE_FORCE.name: Series(steps, forces),
        VALVE_COMMAND.name: Series(steps, commands[:, np.newaxis, :]),
    }


def trip_of(
    violation: str | None, cause: str | None, last: int, begun: int, timebase: Timebase
) -> Trip | None:
    """Tell what ended a test before the record did, as supervisor and rig would.

    Parameters
    ----------
    violation : str or None
        Why rig or force controller ended it at once; empty or None: they did not.
    cause : str or None
        Why the reference force was brought down.
    last, begun : int
        The last step, and the one at which the ramp began.
    timebase : Timebase
        Sampling clock.
    """
    if violation:
        reason = violation if cause is None else while_ramping_down(violation, cause)
        return Trip(reason, last, timebase.stamp_ns(last) / 1e9)
    return None if cause is None else Trip(cause, begun, timebase.stamp_ns(begun) / 1e9)
