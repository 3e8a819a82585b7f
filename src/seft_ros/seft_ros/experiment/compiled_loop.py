"""All steps of a test in one compiled function: the steps of its blocks, called in a row.

It holds no lock of the interpreter, so that threads run tests side by side.
"""

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from seft_msgs_py.wire.topics import VALVE_COMMAND
from seft_plant_sim.compiled import compiled, entry_point
from seft_plant_sim.rig import Rig
from seft_plant_sim.rig_step import BLIND, LIMIT, RigParameters, RigState, rig_step
from seft_plant_sim.sensors import BLOCK

from seft_ros.experiment.block_steps import answer, estimate, respond
from seft_ros.experiment.blocks import Blocks
from seft_ros.force_controller.interlock import Interlock
from seft_ros.force_controller.interlock_step import (
    NOTHING,
    TRIP,
    InterlockParameters,
    InterlockState,
    begin_control,
    end_control,
)
from seft_ros.force_controller.velocity_feedforward import VelocityFeedforward
from seft_ros.interlock.protection import (
    HOLDING,
    ProtectionParameters,
    ProtectionState,
    begin_step,
    protect,
)
from seft_ros.interlock.ramp_down import TAKEN

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]


class Course(NamedTuple):
    """What a test of N steps leaves.

    Attributes
    ----------
    states, forces, commands : ndarray
        Shapes (N, 4, n), (N, q, n) and (N, n).
    found : ndarray
        What `rig_step` gave, shape (N,).
    estimates : ndarray
        Of the compensation method at the steps that are sampled, shape (M, k, n).
    """

    states: Floats
    forces: Floats
    commands: Floats
    found: Ints
    estimates: Floats


class LoopBlocks(NamedTuple):
    """The blocks as the loop sees them.

    Attributes
    ----------
    rig, protection, interlock : tuple
        Parameters and state of each.
    force, control : tuple
        Of compensation method and controller, see `seft_ros.experiment.block_steps`.
    under_way : ndarray
        Points of the last steps in turn, shape (1 + d, p, q, n), of a loop with a delay of d steps.
    drive : ndarray
        What drives the rig, shape (n,).
    is_valve_driven : bool
        Whether that is the command of the valve.
    window : int
        Samples of the ground motion that the compensation method sees.
    longest_ramp, period : int
        Steps of the ramp, and from one sample of the estimates to the next.
    """

    rig: tuple[RigParameters, RigState]
    protection: tuple[ProtectionParameters, ProtectionState]
    interlock: tuple[InterlockParameters, InterlockState]
    force: tuple[Any, Any]
    control: tuple[Any, Any]
    under_way: Floats
    drive: Floats
    is_valve_driven: bool
    window: int
    longest_ramp: int
    period: int


def run_compiled(blocks: Blocks, course: Course, loop_delay: int, period: int) -> Iterator[int]:
    """Run a test of blocks that have been reset; give the steps done: 0 first, all at the end.

    Parameters
    ----------
    blocks : Blocks
        To which there is no `obstacle`.
    course : Course
        The result.
    loop_delay : int
        Steps from a state to the first use of the force that is computed from it.
    period : int
        Steps from one sample of the estimates to the next.
    """
    rig, protected, interlock = blocks.rig, blocks.reference_force, blocks.force_controller
    assert isinstance(rig, Rig) and isinstance(interlock, Interlock)
    method: Any = protected.reference_force.compensator
    control: Any = interlock.controller
    points, quantities = protected.reference_force.shape
    if quantities > 1:  # a controller needs no more of the coming motion
        coming = isinstance(control, VelocityFeedforward) and control.parameters.inverse.shape[1]
        points = min(points, 1 + loop_delay + coming)
    n = course.commands.shape[1]
    loop = LoopBlocks(
        (rig.parameters, rig.state),
        (protected.parameters, protected.state),
        (interlock.parameters, interlock.state),
        (method.parameters, method.state),
        (control.parameters, control.state),
        np.zeros((1 + loop_delay, points, quantities, n)),
        np.zeros(n),
        rig.drive == VALVE_COMMAND.name,
        points if quantities > 1 else 1 + protected.preview,
        protected.longest_ramp,
        period,
    )
    known = np.ascontiguousarray(blocks.ground_motion.known)
    total = len(course.commands)
    steps: Callable[..., int] = entry_point(run_steps, loop, course, known, course.states, 0, 0)
    yield 0  # it is compiled
    for first in range(0, total, BLOCK):
        last = min(first + BLOCK, total)
        noise = rig.sensors.noise_block(first // BLOCK, last - first)
        done = steps(loop, course, known, noise, first, last)
        yield done
        if done < last or last == total:
            rig.take(course.found[:done])
            return


def _run_steps(
    loop: LoopBlocks, course: Course, known: Floats, noise: Floats, first: int, last: int
) -> int:
    """Run steps of a test; give the number of steps done since its beginning.

    The order of the steps, and of what protects them, is that of `simulate`.

    Parameters
    ----------
    loop, course
        See there.
    known : ndarray
        Ground motion, and what is known beyond its end, shape (N + lead, n), m/s^2.
    noise : ndarray
        Of the sensors from the first step on, shape (steps, 4, n).
    first, last : int
        The first step, and the one after the last.
    """
    rig, protection, interlock = loop.rig, loop.protection, loop.interlock
    force, control, drive = loop.force, loop.control, loop.drive
    turns, _, quantities, n = loop.under_way.shape
    window, is_target = loop.window, quantities > 1
    for step in range(first, last):
        measured, command = course.states[step], course.commands[step]
        found = rig_step(rig[0], rig[1], step, drive, noise[step - first], measured)
        course.found[step] = found
        # reference force
        asked = loop.under_way[step % turns]
        pace = begin_step(protection[0], protection[1], True)
        if not protection[1].flags[HOLDING]:
            respond(force[0], force[1], known[step : step + window], measured, pace, asked)
        protect(protection[0], protection[1], known[step], measured, True, pace, asked)
        late = loop.under_way[(step + 1) % turns]
        told = asked if is_target else late
        for row in range(quantities):
            for i in range(n):
                course.forces[step, row, i] = told[0, row, i]
        applied = late[turns - 1 if is_target else 0 :]
        # force control
        if begin_control(interlock[0], interlock[1], step, applied, measured, command):
            limited = answer(control[0], control[1], applied, measured, command)
            end_control(interlock[0], interlock[1], step, limited, command)
        if step % loop.period == 0:
            estimate(force[0], force[1], course.estimates[step // loop.period])
        for i in range(n):
            is_valve = loop.is_valve_driven
            drive[i] = command[i] if is_valve else applied[0, quantities - 1, i]
        has_ended = protection[1].ramp[TAKEN] >= loop.longest_ramp
        if has_ended or found & (LIMIT | BLIND) or interlock[1].flags[TRIP] != NOTHING:
            return step + 1
    return last


run_steps = compiled(_run_steps, nogil=True)
