"""All steps of the four blocks of a test in one compiled function.

It releases the interpreter's lock, so that threads run tests in parallel.
"""

from collections.abc import Callable, Hashable, Iterator
from typing import Any, NamedTuple, cast

import numpy as np
from numba.extending import overload
from seft_msgs_py.arrays import Floats, Ints
from seft_msgs_py.wire.topics import VALVE_COMMAND
from seft_plant_sim.compiled import OPTIONS, compiled, entry_point, is_at_hand, kind_of
from seft_plant_sim.judge.guard import ENDS_TEST, GuardParameters, GuardState, guard_step
from seft_plant_sim.rig import Rig
from seft_plant_sim.simulated.rig import SimulatedRig
from seft_plant_sim.simulated.rig_step import FORCE_NOW, RigParameters, RigState, rig_step
from seft_plant_sim.simulated.sensors import BLOCK

from seft_ros.force_controller import force_control, velocity_feedforward
from seft_ros.force_controller import interlock as force_interlock
from seft_ros.force_controller.force_control import ForceController, TransferParameters
from seft_ros.force_controller.interlock import Interlock, InterlockParameters, InterlockState
from seft_ros.force_controller.position_servo import PositionServo, ServoParameters, servo_step
from seft_ros.protection import protected_force
from seft_ros.protection.protected_force import ProtectionParameters, ProtectionState, protect
from seft_ros.reference_force.compensator import LinearCompensator, LinearParameters, linear_step
from seft_ros.reference_force.target_motion import TargetMotion
from seft_ros.reference_force.target_step import TargetParameters, target_estimates, target_step
from seft_ros.test_run.blocks import Blocks


def why_not_compiled(blocks: Blocks) -> str:
    """Say why a test can't run in the compiled loop; empty if it can."""
    method = blocks.reference_force.reference_force.compensator
    if not isinstance(blocks.rig, Rig) or not isinstance(blocks.force_controller, Interlock):
        return "several rigs"
    if not isinstance(blocks.rig.hardware, SimulatedRig):
        return "hardware of another package"
    if type(method) not in (LinearCompensator, TargetMotion):
        return "a compensation method of another package"
    if isinstance(method, TargetMotion) and method.command is not None:
        return "the target's force is sent ahead"
    if isinstance(method, TargetMotion) and method.model is not None:
        return "a computed model"
    if "step" in vars(method):
        return "the compensation has a step of its own"
    controller = type(blocks.force_controller.controller)
    if controller not in (ForceController, velocity_feedforward.VelocityFeedforward, PositionServo):
        return "a force controller of another package"
    if controller is not ForceController and type(method) is not TargetMotion:
        return "a controller that follows a target without target_motion"
    return ""


@compiled
def no_estimates(parameters: LinearParameters, state: Any, result: Floats) -> None:
    """Sample nothing: a linear compensation estimates nothing."""


def _by_parameters(steps: dict[Any, Any]) -> Any:
    """Give a step that the compiler takes from ``steps`` by the type of its parameters."""

    def step_of(parameters: Any, state: Any, *others: Any) -> Any:
        return steps[type(parameters)](parameters, state, *others)

    @overload(step_of, jit_options=cast("Any", OPTIONS))
    def _step_of(parameters, state, *others):  # type: ignore[no-untyped-def]
        step: Any = steps[parameters.instance_class]
        return lambda parameters, state, *others: step(parameters, state, *others)

    return step_of


respond = _by_parameters({LinearParameters: linear_step, TargetParameters: target_step})
"""Step of a compensation method: of parameters, state, ground, measured, progress and points."""
answer = _by_parameters(
    {
        TransferParameters: force_control.transfer_step,
        velocity_feedforward.FeedforwardParameters: velocity_feedforward.feedforward_step,
        ServoParameters: servo_step,
    }
)
"""Step of a force controller: of parameters, state, points, measured and command; a bool."""
estimate = _by_parameters({LinearParameters: no_estimates, TargetParameters: target_estimates})
"""Sample the estimates of a compensation method: of parameters, state and result (k, n)."""


class LoopSamples(NamedTuple):
    """Results of a test of N steps.

    Attributes
    ----------
    states, measured, forces, commands : ndarray
        Shapes (N, 6, n), (N, 4, n), (N, q, n) and (N, n), see `guard_step`.
    found, true_forces : ndarray
        Results of `rig_step` and `guard_step`, and largest true force of any axis (N), shape (N,).
    estimates : ndarray
        Estimates of the compensation method at the sampled steps, shape (M, k, n).
    """

    states: Floats
    measured: Floats
    forces: Floats
    commands: Floats
    found: Ints
    true_forces: Floats
    estimates: Floats


class LoopBlocks(NamedTuple):
    """The blocks as the loop sees them.

    Attributes
    ----------
    axes : tuple of int
        0 to n - 1: their number is known where the loop is compiled.
    rig, guard, protection, interlock : tuple
        Parameters and state of each.
    force, control : tuple
        Parameters and state of compensation method and controller.
    in_flight : ndarray
        Points of the last steps in turn, shape (1 + d, p, q, n), of a loop with a delay of d steps.
    drive : ndarray
        Input of the rig, shape (n,).
    is_valve_driven : bool
        Whether that is the valve command.
    window : int
        Samples of the ground motion that the compensation method gets.
    longest_ramp, period : int
        Steps of the ramp, and from one sample of the estimates to the next.
    """

    axes: tuple[int, ...]
    rig: tuple[RigParameters, RigState]
    guard: tuple[GuardParameters, GuardState]
    protection: tuple[ProtectionParameters, ProtectionState]
    interlock: tuple[InterlockParameters, InterlockState]
    force: tuple[Any, Any]
    control: tuple[Any, Any]
    in_flight: Floats
    drive: Floats
    is_valve_driven: bool
    window: int
    longest_ramp: int
    period: int


def _arguments(
    blocks: Blocks, samples: LoopSamples, loop_delay: int, period: int
) -> tuple[Hashable, tuple[Any, ...]]:
    """Give the arguments of the compiled steps, and what their types depend on; see there."""
    rig, protected, interlock = blocks.rig, blocks.reference_force, blocks.force_controller
    assert isinstance(rig, Rig) and isinstance(interlock, Interlock)
    method: Any = protected.reference_force.compensator
    control: Any = interlock.controller
    points, quantities = protected.reference_force.shape
    if quantities > 1:  # a controller keeps no more of the future motion
        points = min(points, loop_delay + control.shape[0])
    n = samples.commands.shape[1]
    parts: Any = rig.simulation, rig.guard, protected, interlock, method, control
    pairs = [(each.parameters, each.state) for each in parts]
    in_flight = np.zeros((1 + loop_delay, points, quantities, n))
    window = points if quantities > 1 else 1 + protected.preview
    of_test = rig.drive == VALVE_COMMAND.name, window, protected.ramp.whole, period
    loop = LoopBlocks._make((tuple(range(n)), *pairs, in_flight, np.zeros(n), *of_test))
    known = blocks.ground_motion.known.copy()  # of the type for which the steps are compiled
    kind = rig.kind, protected.kind, interlock.kind, kind_of((loop.axes, samples, known))
    return kind, (loop, samples, known, samples.states, 0, 0)


def is_compiled(blocks: Blocks, samples: LoopSamples, loop_delay: int, period: int) -> bool:
    """Say whether this machine has compiled the loop before; parameters as of `run_compiled`."""
    kind, arguments = _arguments(blocks, samples, loop_delay, period)
    return is_at_hand(run_steps, *arguments, kind=kind)


def run_compiled(
    blocks: Blocks, samples: LoopSamples, loop_delay: int, period: int
) -> Iterator[int]:
    """Run a test of blocks that have been reset; give the steps done: 0 first, all at the end.

    Parameters
    ----------
    blocks : Blocks
        For which there is no `why_not_compiled`.
    samples : LoopSamples
        The result.
    loop_delay : int
        Steps from a state to the first use of the force that is computed from it.
    period : int
        Steps from one sample of the estimates to the next.
    """
    kind, arguments = _arguments(blocks, samples, loop_delay, period)
    steps: Callable[..., int] = entry_point(run_steps, *arguments, kind=kind)
    yield 0  # it is compiled
    (loop, _, known, *_), total, rig = arguments, len(samples.commands), blocks.rig
    assert isinstance(rig, Rig)
    rig.begin()
    for first in range(0, total, BLOCK):
        last = min(first + BLOCK, total)
        noise = rig.simulation.sensors.noise_block(first // BLOCK, last - first)
        done = steps(loop, samples, known, noise, first, last)
        yield done
        if done < last or last == total:
            rig.take(samples.found[:done], samples.true_forces[:done])
            return


def _run_steps(
    loop: LoopBlocks, samples: LoopSamples, known: Floats, noise: Floats, first: int, last: int
) -> int:
    """Run steps of a test; give the number of steps done since its beginning.

    The order of the steps, and of what protects them, is that of `simulate`.

    Parameters
    ----------
    loop, samples
        See there.
    known : ndarray
        Ground motion, and what is known beyond its end, shape (N + lead, n), m/s^2.
    noise : ndarray
        Of sensors and faults from the first step on, shape (steps, 4 + faults, n).
    first, last : int
        The first step, and the one after the last.
    """
    # beyond 60 lines: the loop is one function for the compiler
    # each tuple is taken apart once: within the loop this takes the compiler three times as long
    rig, rig_state = loop.rig
    guard, guard_state = loop.guard
    protection, protection_state = loop.protection
    interlock, interlock_state = loop.interlock
    force, force_state = loop.force
    control, control_state = loop.control
    in_flight, drive, window = loop.in_flight, loop.drive, loop.window
    is_valve_driven, longest_ramp, period = loop.is_valve_driven, loop.longest_ramp, loop.period
    states, measured_states, forces, commands, found, true_forces, estimates = samples
    turns, _, quantities, _ = in_flight.shape
    is_target, n = quantities > 1, len(loop.axes)
    place, due = first % turns, -(-first // period) * period  # later without a division
    # what the compiler takes from these makes the loop nearly twice as fast
    assert states.shape[2] == n and commands.shape[1] == n
    assert measured_states.shape[2] == n
    assert known.shape[1] == n and noise.shape[2] == n and in_flight.shape[3] == n
    assert len(drive) == n
    for step in range(first, last):
        state, measured, command = states[step], measured_states[step], commands[step]
        saturated = rig_step(rig, rig_state, step, drive, noise[step - first], measured)
        true_forces[step] = rig_state.peaks[FORCE_NOW]
        found[step] = saturated | guard_step(guard, guard_state, step, measured, drive, state)
        force_interlock.check_limits(interlock, interlock_state, step, state)
        judged = state[:4]
        # reference force
        asked = in_flight[place]
        progress = protected_force.begin_step(protection, protection_state, True)
        if not protection_state.flags[protected_force.HOLDING]:
            respond(force, force_state, known[step : step + window], judged, progress, asked)
        protect(protection, protection_state, known[step], judged, True, progress, asked)
        place = place + 1 if place + 1 < turns else 0
        late = in_flight[place]
        sent = asked if is_target else late
        for row in range(quantities):
            for i in range(n):
                forces[step, row, i] = sent[0, row, i]
        applied = late[turns - 1 if is_target else 0 :]
        # force control
        if force_interlock.precheck(interlock, interlock_state, step, applied, state, command):
            plan, sample = interlock_state.plan, interlock_state.sample
            limited = answer(control, control_state, plan, sample, command)
            force_interlock.postcheck(interlock, interlock_state, step, limited, command)
        if step == due:
            estimate(force, force_state, estimates[step // period])
            due += period
        for i in range(n):
            drive[i] = command[i] if is_valve_driven else applied[0, quantities - 1, i]
        has_ended = protection_state.ramp[protected_force.TAKEN] >= longest_ramp
        has_tripped = interlock_state.flags[force_interlock.TRIP] != force_interlock.NO_TRIP
        if has_ended or has_tripped or found[step] & ENDS_TEST:
            return step + 1
    return last


run_steps = compiled(_run_steps, nogil=True)
