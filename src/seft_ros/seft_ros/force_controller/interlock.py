"""Interlock of the force control: it keeps out implausible values, and trips at faults."""

import math
from collections.abc import Hashable, Sequence
from functools import cached_property
from typing import Annotated, Any, NamedTuple

import numpy as np
from seft_msgs_py.arrays import Floats, Ints, clear, zeros
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.config.facts import CHANNELS, POSITION_SERVO
from seft_msgs_py.config.parameter_table import Section
from seft_msgs_py.wire.topics import RigAxes, Timebase
from seft_plant_sim.channels import FORCE
from seft_plant_sim.compiled import compiled, copy, entry_point, kind_of
from seft_plant_sim.judge.detector_list import TRACKING, describe
from seft_plant_sim.judge.guard import DRIVE_ROW, SUSPECT_ROW
from seft_plant_sim.judge.known_rig import fastest_command
from seft_plant_sim.limits import beyond_limit, event_ring, is_exceeded
from seft_plant_sim.simulated.rig_step import left_open

from seft_ros.force_controller import target_distance
from seft_ros.force_controller.force_control import ForceControl, as_sample
from seft_ros.force_controller.methods import force_control
from seft_ros.protection.protected_force import extrapolate, implausible_force

TRIP, STEP, SATURATED, AXIS = range(4)
"""Places of the flags: reason and step of the trip, number of limited drives, and the axis that is
away from its target."""
NO_TRIP, IMPLAUSIBLE, IMPLAUSIBLE_COMMAND, SATURATION, OFF_TARGET, LIMIT, OUTSIDE = range(7)
"""Reasons of a trip; the last one is a reason from outside."""
VALID_CAUSES = NO_TRIP, IMPLAUSIBLE, LIMIT
"""With these, valves and controller are fault-free, so that a stop can follow the plan."""


class InterlockParameters(NamedTuple):
    """Parameters of an interlock.

    Attributes
    ----------
    window : int
        Steps of a second.
    closing : float
        Steps in which the valve closes after a trip; infinite: the last command is held.
    has_stop : bool
        Whether the controller can stop along its plan.
    limits : ndarray
        Largest displacement, velocity, acceleration and force, shape (4,).
    dt : float
        Sampling period, s.
    fastest : float
        Largest change of a command in a step.
    tracking : TrackingParameters
        Of the distance to the target.
    """

    window: int
    closing: float
    has_stop: bool
    limits: Floats
    dt: float
    fastest: float
    tracking: target_distance.TrackingParameters


class InterlockState(NamedTuple):
    """State of an interlock: arrays of zeros, but for ``tracking``."""

    flags: Annotated[Ints, 4]  # see `TRIP`
    saturated: Ints  # the last steps at which the drive was limited, see `is_exceeded`
    force: Annotated[Floats, "n"]  # reference force of the step of the trip, N
    measured: Annotated[Floats, 4, "n"]  # its sample
    odd: Annotated[Floats, "n"]  # its drive
    drive: Annotated[Floats, "n"]  # the last fault-free command, V
    plan: Annotated[Floats, "points", "quantities", "n"]  # points for the controller
    sample: Annotated[Floats, 4, "n"]  # for the controller
    tracking: target_distance.TrackingState  # of the distance to the target


@compiled
def check_limits(
    parameters: InterlockParameters, state: InterlockState, step: int, measured: Floats
) -> None:
    """Trip if a judged sample is beyond a limit: then the stop follows the plan."""
    if state.flags[TRIP] == NO_TRIP:
        for row in range(4):
            for i in range(measured.shape[1]):
                if abs(measured[row, i]) > parameters.limits[row]:
                    trip(state, LIMIT, step)
            copy(measured.shape[1], measured[row], state.measured[row])


@compiled
def precheck(
    parameters: InterlockParameters,
    state: InterlockState,
    step: int,
    points: Floats,
    measured: Floats,
    command: Floats,
) -> bool:
    """Say whether the controller answers a step; otherwise give its command.

    The controller answers `InterlockState.plan` and `InterlockState.sample`. While a sample is
    suspect, these are the motion that the last fault-free target has predicted for this step;
    without a target, the last fault-free command is held. At a trip the stop begins, see
    `Interlock.stop`.

    Parameters
    ----------
    parameters, state
        The state is updated.
    step : int
        The step.
    points : ndarray
        Of the reference force, shape (p, q, n).
    measured : ndarray
        The step's sample of rig/state, shape (6, n).
    command : ndarray
        Shape (n,), V.
    """
    last, n = points.shape[1] - 1, points.shape[2]
    if state.flags[TRIP] == NO_TRIP:
        fits, has_target, away = True, state.plan.shape[1] > 1 and last > 0, -1
        for i in range(n):
            fits &= abs(points[0, last, i]) <= parameters.limits[FORCE]
        if fits and has_target:  # a controller of forces reads them alone
            away = target_distance.off_target(
                parameters.tracking, state.tracking, step, points[0, 0], measured
            )
        if not fits or away >= 0:
            trip(state, OFF_TARGET if fits else IMPLAUSIBLE, step)
            state.flags[AXIS] = away
            copy(n, points[0, last], state.force)
        elif measured[SUSPECT_ROW, 0] == 0.0:
            take_plan(state, points, measured)
            return True
        elif has_target:  # it answers what was predicted before samples were suspect
            extrapolate(state.plan, 1, parameters.dt, state.plan)
            as_sample(state.plan, parameters.dt, state.sample)
            return True
    begin_stop(parameters, state, command)
    return False


@compiled
def take_plan(state: InterlockState, points: Floats, measured: Floats) -> None:
    """Let the controller answer a sample; store of its points what it follows.

    The force is the last row. It is alone while the nodes warm up; a controller of forces follows
    it alone also where there is a target.
    """
    count, quantities, n = state.plan.shape
    first = points.shape[1] - quantities
    if first == 0 and len(points) >= count:  # as they are: so they come in a test
        size = state.plan.size
        copy(size, points.reshape(points.size), state.plan.reshape(size))
        count = 0
    for point in range(count):
        sent = points[min(point, len(points) - 1)]
        for row in range(quantities):
            copy(n, sent[max(0, first + row)], state.plan[point, row])
    for row in range(4):
        copy(n, measured[row], state.sample[row])


@compiled
def postcheck(
    p: InterlockParameters, state: InterlockState, step: int, limited: bool, command: Floats
) -> None:
    """Check the command of a controller, and whether it is limited; trip if it is not finite.

    So it does if the command of a displacement servo jumps.
    """
    for i in range(len(command)):
        change = abs(command[i] - state.drive[i]) if step > 0 else 0.0
        if not np.isfinite(command[i]) or change > p.fastest:
            trip(state, IMPLAUSIBLE_COMMAND, step)
    if limited and p.tracking.limit < np.inf and state.flags[TRIP] == NO_TRIP:
        if is_exceeded(state.saturated, state.flags[SATURATED], step, p.window):
            trip(state, SATURATION, step)
        state.flags[SATURATED] += 1
    if state.flags[TRIP] == NO_TRIP:
        copy(len(command), command, state.drive)
    else:
        copy(len(command), command, state.odd)
        begin_stop(p, state, command)


@compiled
def begin_stop(parameters: InterlockParameters, state: InterlockState, command: Floats) -> None:
    """Give the command of the step of a trip; without a trip, hold the last one."""
    why, left = state.flags[TRIP], 1.0
    if why != NO_TRIP and not (parameters.has_stop and why in VALID_CAUSES):
        left = left_open(1, parameters.closing)
    for i in range(len(command)):
        command[i] = left * state.drive[i]


@compiled
def trip(state: InterlockState, why: int, step: int) -> None:
    """Stop from now on."""
    state.flags[TRIP] = why
    state.flags[STEP] = step


class Interlock:
    """A `ForceControl` that refuses implausible values, and does not stay at its limit for long.

    After a trip it brings the rig to rest, see `stop`, and then answers 0 V until the next test; of
    displacement servos, the last command.

    Parameters
    ----------
    controller : ForceControl
        Computes the valve drive.
    axes : sequence of str
        Names of the n axes.
    longest_saturation : float
        Time within one second that the valve drive may be at its limit, s.
    close_time : float
        Time in which it closes the valve, s; infinite: it holds the last command.
    limits : sequence of float
        Largest displacement, velocity, acceleration and force, also of the reference force.
    tracking : tuple of TrackingParameters and TrackingState
        Of the distance to the target, see `tracking_arrays`; with a limit if commands drive valves.
    dt : float
        Sampling period, s.
    fastest : float
        Largest change of a command in a step.

    Attributes
    ----------
    controller : ForceControl
        As given.
    parameters, state : InterlockParameters, InterlockState
        Arguments of `precheck` and `postcheck`, here and in a compiled loop.
    """

    def __init__(
        self,
        controller: ForceControl,
        axes: Sequence[str],
        longest_saturation: float,
        close_time: float,
        limits: Sequence[float],
        tracking: tuple[target_distance.TrackingParameters, target_distance.TrackingState],
        dt: float,
        fastest: float = math.inf,
    ) -> None:
        self.controller = controller
        self._axes, n = tuple(axes), len(axes)
        closing = close_time / dt
        left = [1.0]
        if closing < math.inf:
            left = [left_open(taken, closing) for taken in range(1, math.ceil(closing) + 1)] + [0.0]
        self._closing = np.array(left)  # of the last drive, step by step
        self._longest, (saturated, window) = longest_saturation, event_ring(longest_saturation, dt)
        known = window, closing, hasattr(controller, "stop"), np.array(limits), dt, fastest
        self.parameters = InterlockParameters(*known, tracking[0])
        points, quantities = controller.shape
        sizes = {"n": n, "points": points, "quantities": quantities}
        self.state = zeros(InterlockState, sizes, saturated=saturated, tracking=tracking[1])
        both, drive = (self.parameters, self.state), self.state.drive
        sent, sample = np.zeros((1, 1, n)), np.zeros((DRIVE_ROW + 1, n))
        self._look = entry_point(check_limits, *both, 0, sample)
        self._begin = entry_point(precheck, *both, 0, sent, sample, drive)
        self._end = entry_point(postcheck, *both, 0, False, drive)
        self.reset()

    @classmethod
    def from_parameters(
        cls, section: Section, axes: tuple[str, ...], timebase: Timebase, rig: RigAxes | None = None
    ) -> "Interlock":
        """Make it, and its controller, from its section of an experiment, see `force_control`."""
        own, dt = rig or RigAxes.whole(axes), timebase.dt
        controller = force_control(section, axes, timebase, rig)
        holds = section["actuator.kind"] == POSITION_SERVO
        closing = math.inf if holds else section["safe.close_time"]
        limits = [section[f"limits.{name}"] for name in CHANNELS]
        tracking = target_distance.tracking_detector(section, axes, own.places, dt)
        ends = section["watchdog.saturation_time"], closing, limits, tracking
        return cls(controller, own.axes, *ends, dt, fastest_command(section, dt))

    @cached_property
    def kind(self) -> Hashable:
        """`kind_of` the arguments of a compiled loop: its own, and its controller's."""
        of: Any = self.controller
        return kind_of((self.parameters, self.state, of.parameters, of.state))

    @property
    def reason(self) -> str:
        """Reason of its trip, one line; empty without a trip."""
        return self._outside or self._found()

    @property
    def step_index(self) -> int:
        """Step of its trip; -1 without a trip."""
        return int(self.state.flags[STEP]) if self.state.flags[TRIP] else -1

    @property
    def off_target(self) -> float:
        """Largest distance to the target in this test, over its threshold."""
        return float(self.state.tracking.shares.max())

    def reset(self) -> None:
        """Begin a new test; also after a trip."""
        self.controller.reset()
        clear(self.state)
        target_distance.begin_tracking(self.state.tracking)
        self._outside, self._stopping = "", np.zeros((0, len(self._axes)))

    def look(self, index: int, measured: Floats) -> None:
        """Look at the sample of a step, shape (6, n), before its reference force has come."""
        self._look(self.parameters, self.state, index, np.ascontiguousarray(measured, np.float64))

    def step(self, index: int, points: Floats, measured: Floats) -> Floats:
        """Compute the valve drive of one step.

        Parameters
        ----------
        index : int
            The step.
        points : ndarray
            See `ForceControl.step`.
        measured : ndarray
            Its sample of rig/state, shape (6, n).

        Returns
        -------
        ndarray
            Valve drive, shape (n,), V.
        """
        points, measured = (np.ascontiguousarray(each, np.float64) for each in (points, measured))
        assert measured.shape == (DRIVE_ROW + 1, len(self._axes))  # no bounds are checked below
        command = np.empty(len(self._axes))
        if self._begin(self.parameters, self.state, index, points, measured, command):
            command[:] = self.controller.step(self.state.plan, self.state.sample)
            self._end(self.parameters, self.state, index, self.controller.limited, command)
        elif 0 <= self.step_index < index:
            command[:] = self.stop(index)[0]
        return command

    def stop(self, index: int) -> Floats:
        """Give the commands of a stop, from a step on; shape (m, n), V.

        It goes along the plan of a controller that has a ``stop``, unless sensors, valves or the
        controller are at fault, or the plan takes a valve to its limit. Then, and else at once, the
        valve closes, in some time: a valve that closes at once on a moving mass makes a pressure
        surge in the oil. Before a trip, it is the stop that would begin at the last answered step;
        nothing where that is to close at once, which the rig does by itself.
        """
        state, first = self.state, self.step_index
        stopping, is_fault_free = self._stopping, state.flags[TRIP] in VALID_CAUSES
        if first < 0 or not len(stopping):
            last, stopping = state.drive, np.zeros((0, len(state.drive)))
            if is_fault_free and self.parameters.has_stop:
                controller: Any = self.controller
                own = controller.stop(state.plan)
                if first >= 0 and np.abs(own).max() >= self.parameters.tracking.limit:
                    own = own[:0]  # no valve can follow it: the target was led astray
                stopping = np.vstack([last, own])
                last = stopping[-1]
            elif first < 0:
                return stopping
            stopping = np.vstack([stopping, np.outer(self._closing, last)])
        if first < 0:
            return stopping
        self._stopping = stopping
        return stopping[min(index - first, len(stopping) - 1) :]

    def trip(self, index: int, reason: str) -> None:
        """Stop from now on; the first reason is kept."""
        if not self.reason:
            self._outside, self.state.flags[TRIP], self.state.flags[STEP] = reason, OUTSIDE, index

    def _found(self) -> str:
        """Describe the finding of the step of the trip."""
        code, state = self.state.flags[TRIP], self.state
        if code == NO_TRIP:
            return ""
        if code == IMPLAUSIBLE_COMMAND:
            for name, value in zip(self._axes, state.odd.tolist(), strict=True):
                if not math.isfinite(value):
                    return f"valve command on axis {name} is {value}"
            jump = f"{(state.odd - state.drive).tolist()} m"
            return f"the command jumps by more than /**: limits.displacement_rate allows: {jump}"
        if code == IMPLAUSIBLE:
            return implausible_force(state.force, self._axes, self.parameters.limits[FORCE])
        if code == LIMIT:
            limits, sample = self.parameters.limits, state.measured
            row, column = np.argwhere(np.abs(sample) > limits[:, np.newaxis])[0].tolist()
            return beyond_limit(row, sample[row, column], self._axes[column], limits[row])
        if code == OFF_TARGET:
            axis = int(state.flags[AXIS])
            return describe(TRACKING, state.tracking.found[:, axis], self._axes[axis])
        assert code == SATURATION
        most = f"{self._longest:g} s within one second: the force is out of control"
        return f"the valve command is at its limit for more than {most}"


class Interlocks:
    """The `Interlock` of each rig of a test, as the offline loop steps them.

    Parameters
    ----------
    rigs : sequence of (RigAxes, Interlock)
        The axes of each rig, and its interlock.
    """

    def __init__(self, rigs: Sequence[tuple[RigAxes, Interlock]]) -> None:
        self._rigs = [(list(of.places), interlock) for of, interlock in rigs]

    @property
    def reason(self) -> str:
        """Reason of the first of them that has tripped; empty without a trip."""
        return next((one.reason for _, one in self._rigs if one.reason), "")

    def reset(self) -> None:
        """Begin a new test; also after a trip."""
        for _, interlock in self._rigs:
            interlock.reset()

    def look(self, index: int, measured: Floats) -> None:
        """Look at the sample of a step, see `Interlock.look`."""
        for places, interlock in self._rigs:
            interlock.look(index, measured[:, places])

    def step(self, index: int, points: Floats, measured: Floats) -> Floats:
        """Compute the valve drives of one step, see `Interlock.step`."""
        drive = np.empty(measured.shape[1])
        for places, interlock in self._rigs:
            drive[places] = interlock.step(index, points[:, :, places], measured[:, places])
        return drive

    def stop(self, index: int) -> list[Floats]:
        """Give the commands of the stop of each rig, see `Interlock.stop`."""
        return [interlock.stop(index) for _, interlock in self._rigs]


def interlock_of(experiment: Experiment) -> Interlock | Interlocks:
    """Make the interlock of a test, which has those of all rigs.

    Raises
    ------
    InputError
        If the force controller of a rig can't be made.
    """
    section, axes, timebase = experiment["force_controller"], experiment.axes, experiment.timebase
    of_test = section, axes, timebase
    made = [(rig, Interlock.from_parameters(*of_test, rig)) for rig in experiment.rigs]
    return made[0][1] if len(made) == 1 else Interlocks(made)
