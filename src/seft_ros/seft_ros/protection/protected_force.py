"""The reference force with its protection: instability watch, plausibility, ramp-down."""

import math
from collections import deque
from collections.abc import Hashable, Sequence
from functools import cached_property
from typing import Annotated, Any, NamedTuple

import numpy as np
from seft_msgs_py.arrays import Floats, Ints, clear, zeros
from seft_msgs_py.config.facts import CHANNELS
from seft_msgs_py.config.parameter_table import group
from seft_msgs_py.wire.topics import Timebase
from seft_plant_sim.channels import FORCE
from seft_plant_sim.compiled import compiled, entry_point, is_finite, kind_of
from seft_plant_sim.limits import beyond_limit, largest_force_rate, span_steps
from seft_plant_sim.simulated.rig_step import left_open

from seft_ros.protection import instability
from seft_ros.reference_force.compensator import has_computed_model
from seft_ros.reference_force.reference_force_block import ReferenceForce, method_inputs

BRAKING = 0.03
"""Time constant of a target's braking, s. At a sudden stop the oil column would ring."""


@compiled
def extrapolate(points: Floats, age: int, dt: float, result: Floats) -> None:
    """Give points from a step on; points that were not sent are extrapolated.

    Parameters
    ----------
    points : ndarray
        The sent points, shape (p, q, n).
    age : int
        Steps after the first of them.
    dt : float
        Sampling period, s.
    result : ndarray
        The result, shape (count, q, n).
    """
    last, (_, quantities, n) = len(points) - 1, points.shape
    for index in range(len(result)):
        sent, beyond = min(age + index, last), max(age + index - last, 0)
        left = math.exp(-beyond * dt / BRAKING)
        for i in range(n):
            for row in range(quantities):
                result[index, row, i] = points[sent, row, i]
            if quantities > 1:
                result[index, 0, i] += BRAKING * (1.0 - left) * points[sent, 1, i]
                result[index, 1, i] *= left


def extrapolated(points: Floats, age: int, count: int, dt: float) -> Floats:
    """Give ``count`` points, see `extrapolate`."""
    result = np.empty((count, *points.shape[1:]))
    extrapolate(points, age, dt, result)
    return result


BEGUN, TAKEN = range(2)
"""Places of the state of `next_factor`: whether the ramp has begun, and its steps so far."""


@compiled
def next_factor(steps: int, ramp: Ints) -> float:
    """Factor of the next step: 1 before the ramp, 0 after it.

    Parameters
    ----------
    steps : int
        Steps of the ramp.
    ramp : ndarray
        See `BEGUN`, shape (2,); updated.
    """
    if not ramp[BEGUN]:
        return 1.0
    ramp[TAKEN] += 1
    return left_open(ramp[TAKEN], steps)


class RampDown:
    """Factor that falls from 1 to 0 as half a cosine, counted in steps of the test.

    Steps count, not time: if the loop stalls, the ramp continues after the stall.

    Parameters
    ----------
    steps : int
        Steps from the first scaled one to the one of factor 0, both included.
    rest : int
        Further steps of factor 0 until the ramp is finished.

    Attributes
    ----------
    steps : int
        As given.
    state : ndarray
        State of `next_factor`.
    """

    def __init__(self, steps: int, rest: int = 0) -> None:
        self.steps, self.whole = steps, steps + rest
        self.state = np.zeros(2, dtype=np.int64)
        self._next = entry_point(next_factor, steps, self.state)

    @classmethod
    def lasting(cls, duration: float, dt: float, rest: int = 0) -> "RampDown":
        """Make one from a duration and a sampling period, both in s."""
        return cls(max(1, round(duration / dt)), rest)

    @property
    def begun(self) -> bool:
        """Whether the ramp has begun."""
        return bool(self.state[BEGUN])

    @property
    def taken(self) -> int:
        """Number of factors given since then."""
        return int(self.state[TAKEN])

    @property
    def finished(self) -> bool:
        """Whether the factor 0 has been given, and then for `rest` steps."""
        return self.taken >= self.whole

    def reset(self) -> None:
        """Begin a new test."""
        self.state[:] = 0

    def begin(self) -> None:
        """Begin the ramp; a second call has no effect."""
        self.state[BEGUN] = 1

    def next(self) -> float:
        """Take the factor of the next step, see `next_factor`."""
        return self._next(self.steps, self.state)


@compiled
def is_plausible(limits: Floats, recent: Floats, force: Floats) -> bool:
    """Say whether a force is finite, not too large, and not changing too fast.

    Parameters
    ----------
    limits : ndarray
        Largest magnitude, and largest change in k steps, N, shape (2,).
    recent : ndarray
        The last k plausible forces, the oldest first, shape (k, n), N; updated.
    force : ndarray
        Shape (n,), N.
    """
    last, n = len(recent) - 1, len(force)
    for i in range(n):
        if not (abs(force[i]) <= limits[0] and abs(force[i] - recent[0, i]) <= limits[1]):
            return False
    for i in range(n):
        for k in range(last):
            recent[k, i] = recent[k + 1, i]
        recent[last, i] = force[i]
    return True


class PlausibleForce:
    """Limits of the reference force: finite, not too large, not changing too fast.

    Parameters
    ----------
    largest : float
        Largest magnitude on any axis, N.
    fastest : float
        Fastest change on any axis within `seft_plant_sim.limits.RATE_SPAN`, N/s.
    axes : sequence of str
        Names of the n axes.
    dt : float
        Sampling period, s.

    Attributes
    ----------
    limits, recent : ndarray
        Arguments of `is_plausible`; the plausible forces are zero before the first step.
    axes, dt
        As given.
    """

    def __init__(self, largest: float, fastest: float, axes: Sequence[str], dt: float) -> None:
        self._fastest, self.dt, self.axes = fastest, dt, tuple(axes)
        steps = span_steps(dt)
        self._span = steps * dt
        self.limits = np.array([largest, fastest * self._span * (1 + 1e-12)])
        self.recent = np.zeros((steps, len(self.axes)))

    def describe(self, force: Floats) -> str:
        """Say what is wrong with a force that is not plausible, shape (n,), after the last ones."""
        change = force - self.recent[0]
        axis = int(np.abs(change).argmax())
        most = f"beyond the limit of {self._fastest:g} N/s"
        fast = f"{change[axis] / self._span:.5g} N/s on axis {self.axes[axis]}, {most}"
        large = implausible_force(force, self.axes, self.limits[0])
        return large or f"reference force changes by {fast}"


def implausible_force(force: Floats, axes: Sequence[str], largest: float) -> str:
    """Say which reference force, shape (n,), is not finite or too large; empty if none is."""
    for axis, value in zip(axes, force.tolist(), strict=True):
        if not math.isfinite(value):
            return f"reference force is {value} N on axis {axis}"
        if abs(value) > largest:
            return f"reference {beyond_limit(FORCE, value, axis, largest)}"
    return ""


def not_finite(state: Floats, axes: Sequence[str]) -> str:
    """Say which value of a measured state, shape (4, n), is not finite; empty if all are."""
    bad = np.argwhere(~np.isfinite(state))
    if not len(bad):
        return ""
    row, axis = bad[0]
    return f"measured {CHANNELS[row]} is {state[row, axis]} on axis {axes[axis]}"


HOLDING, CAUSE, AGE = range(3)
"""Places of the flags: whether the last plausible point is used, the cause of the ramp, and the age
of that point in steps."""
NOTHING, IMPLAUSIBLE_FORCE, IMPLAUSIBLE_STATE, INSTABILITY = range(4)
"""Causes."""


class ProtectionParameters(NamedTuple):
    """Parameters of the protection of n axes.

    Attributes
    ----------
    limits : ndarray
        `PlausibleForce.limits`, shape (2,), N.
    ramp_steps : int
        `RampDown.steps`.
    provides_target : bool
        Whether the points are those of a target, which the ramp slows down.
    dt : float
        Sampling period, s.
    watch : WatchParameters
        Of the instability watch.
    """

    limits: Floats
    ramp_steps: int
    provides_target: bool
    dt: float
    watch: instability.WatchParameters


class ProtectionState(NamedTuple):
    """State of the protection: arrays of zeros, but for ``progress``."""

    flags: Annotated[Ints, 3]  # see `HOLDING`
    ramp: Ints  # `RampDown.state`
    recent: Floats  # `PlausibleForce.recent`
    point: Annotated[Floats, 1, "quantities", "n"]  # the last plausible one
    progress: Annotated[Floats, 1]  # pace of a target at that point; 1 at the beginning
    implausible_force: Annotated[Floats, "n"]  # force of the step of the fault, N
    implausible_state: Annotated[Floats, 4, "n"]  # its measured state
    watch: instability.WatchState  # of the instability watch


@compiled
def begin_step(parameters: ProtectionParameters, state: ProtectionState, is_known: bool) -> float:
    """Begin a step; give its progress: 1 in a test, less in the ramp.

    Parameters
    ----------
    parameters, state
        The state is updated.
    is_known : bool
        Whether there is ground motion; in the ramp it may be missing.
    """
    if not (is_known or parameters.provides_target):
        state.flags[HOLDING] = 1
    return next_factor(parameters.ramp_steps, state.ramp)


@compiled
def protect(
    parameters: ProtectionParameters,
    state: ProtectionState,
    ground: Floats,
    measured: Floats,
    is_known: bool,
    progress: float,
    points: Floats,
) -> None:
    """Check the points of a step, and replace them if necessary.

    Parameters
    ----------
    parameters, state
        The state is updated.
    ground : ndarray
        Ground acceleration of the step, shape (n,), m/s^2.
    measured : ndarray
        Displacement, velocity, acceleration and force, shape (4, n).
    is_known, progress
        See `begin_step`.
    points : ndarray
        Of the reference force, shape (p, q, n); not used if it is held. The permitted points are
        written here.
    """
    p, flags, factor = parameters, state.flags, progress
    last, n, cause = points.shape[1] - 1, points.shape[2], NOTHING
    if not flags[HOLDING] and not is_plausible(p.limits, state.recent, points[0, last]):
        flags[HOLDING], cause = 1, IMPLAUSIBLE_FORCE
    if flags[CAUSE] == NOTHING:
        if cause == NOTHING and is_known:
            if not is_finite(measured, 0):
                cause = IMPLAUSIBLE_STATE
            elif p.watch.ratio and instability.watch_step(p.watch, state.watch, ground, measured):
                cause = INSTABILITY
        if cause != NOTHING:
            flags[CAUSE] = cause
            for i in range(n):
                state.implausible_force[i] = points[0, last, i]
                for row in range(4):
                    state.implausible_state[row, i] = measured[row, i]
            if not state.ramp[BEGUN]:
                state.ramp[BEGUN] = 1
                factor = next_factor(p.ramp_steps, state.ramp)
    if flags[HOLDING]:
        flags[AGE] += 1
        extrapolate(state.point, flags[AGE], p.dt, points)
        scale_points(points, factor / state.progress[0] if state.progress[0] else 0.0)
        return
    for row in range(last + 1):
        for i in range(n):
            state.point[0, row, i] = points[0, row, i]
    if p.provides_target:
        state.progress[0] = progress
    elif state.ramp[BEGUN]:
        scale_points(points, factor)


@compiled
def scale_points(points: Floats, factor: float) -> None:
    """Multiply points, shape (p, q, n), by a factor."""
    for point in range(points.shape[0]):
        for row in range(points.shape[1]):
            for i in range(points.shape[2]):
                points[point, row, i] *= factor


class ProtectedForce:
    """A `ReferenceForce` that is checked in each step, and is ramped down after a fault.

    Without a fault or a ramp it gives exactly the force of the block. In the ramp the force
    continues to follow the test, scaled down; a target is slowed down to rest instead. An
    implausible force is never given: the last plausible one replaces it, extrapolated and scaled
    down.

    In a loop with a delay of d steps, the force that is computed from the state of step k is for
    step k + d, and the points are the final forces of the steps k to k + d: the next message
    replaces a late or lost one. A target's points contain its future motion in any case.

    Parameters
    ----------
    reference_force : ReferenceForce
        The block.
    plausible : PlausibleForce
        Limits of its force.
    watch : InstabilityWatch
        May begin the ramp, too.
    ramp : RampDown
        The ramp.
    loop_delay : int
        d.

    Attributes
    ----------
    preview : int
        Number of later steps whose ground motion `step` needs.
    reference_force : ReferenceForce
        As given.
    ramp : RampDown
        As given; at rest, the applied force is zero and stays there.
    parameters, state : ProtectionParameters, ProtectionState
        Arguments of `protect`, here and in a compiled loop.
    """

    def __init__(
        self,
        reference_force: ReferenceForce,
        plausible: PlausibleForce,
        watch: instability.InstabilityWatch,
        ramp: RampDown,
        loop_delay: int = 0,
    ) -> None:
        self.preview = reference_force.preview
        self.estimates = reference_force.estimates
        self.reference_force = reference_force
        self._plausible, self._watch, self.ramp = plausible, watch, ramp
        self._axes, provides_target = len(plausible.axes), reference_force.provides_target
        self._settled: deque[Floats] | None = None  # of the last steps
        if loop_delay and not provides_target:
            self._settled = deque(maxlen=1 + loop_delay)
        self._points = np.zeros((*reference_force.shape, self._axes))
        of_force = plausible.limits, ramp.steps, provides_target, plausible.dt
        self.parameters = ProtectionParameters(*of_force, watch.parameters)
        sizes = {"quantities": reference_force.shape[1], "n": self._axes}
        given = {"ramp": ramp.state, "recent": plausible.recent, "watch": watch.state}
        self.state = zeros(ProtectionState, sizes, **given)
        both = self.parameters, self.state
        self._begin_step = entry_point(begin_step, *both, True)
        measured = self.state.implausible_state
        arguments = self.state.implausible_force, measured, True, 1.0, self._points
        self._protect = entry_point(protect, *both, *arguments)
        self.reset()

    @classmethod
    def from_parameters(
        cls, section: dict[str, Any], axes: tuple[str, ...], timebase: Timebase
    ) -> "ProtectedForce":
        """Make it from the reference force's section of an experiment.

        Raises
        ------
        InputError
            See `ReferenceForce.from_parameters`.
        """
        fastest = largest_force_rate(group(section, "limits"))
        known, watch = method_inputs(section, axes, timebase), group(section, "instability")
        return cls(
            ReferenceForce.from_parameters(section, axes, timebase),
            PlausibleForce(section["limits.force"], fastest, axes, timebase.dt),
            instability.InstabilityWatch(known, axes, **watch),
            RampDown.lasting(section["ramp_down_time"], timebase.dt, section["loop_delay"]),
            section["loop_delay"],
        )

    @cached_property
    def kind(self) -> Hashable:
        """`kind_of` the arguments of a compiled loop: its own, and its compensation method's."""
        of: Any = self.reference_force.compensator
        return kind_of((self.parameters, self.state, of.parameters, of.state))

    @property
    def cause(self) -> str | None:
        """The first fault of this test; latched until `reset`."""
        code = self.state.flags[CAUSE]
        if code == NOTHING:
            return None
        method = self.reference_force.compensator
        if has_computed_model(method) and method.failure:
            return method.failure
        if code == IMPLAUSIBLE_FORCE:
            return self._plausible.describe(self.state.implausible_force)
        if code == IMPLAUSIBLE_STATE:
            return not_finite(self.state.implausible_state, self._plausible.axes)
        assert code == INSTABILITY
        return self._watch.describe()

    def reset(self) -> None:
        """Begin a new test."""
        self.reference_force.reset()
        clear(self.state)
        self.state.progress[:] = 1.0
        self._last_state: Floats | None = None
        if self._settled is not None:
            none = np.zeros((1, 1, self._axes))
            self._settled.extend([none] * (self._settled.maxlen or 0))

    def step(self, ground_motion: Floats | None, state: Floats) -> Floats:
        """Compute the points of one step, as `ReferenceForce.step` does.

        In the ramp the ground motion may be missing: then a target assumes none, and any other
        force is held and scaled down.
        """
        self._last_state = state
        points = self._answer(ground_motion, state)
        if self._settled is None:
            return points
        self._settled.append(points)
        return np.concatenate(self._settled)

    def ask_model(self) -> None:
        """Step a computed model, whose force is used from the next answer on."""
        method = self.reference_force.compensator
        if has_computed_model(method):
            method.ask_model()

    def bridge(self, ground_motion: Sequence[Floats | None], state: Floats) -> None:
        """Interpolate the lost states of steps before this one linearly.

        Parameters
        ----------
        ground_motion : sequence of ndarray or None
            Argument of `step` for each of them.
        state : ndarray
            The state that arrived after them, shape (4, n).
        """
        last = state if self._last_state is None else self._last_state
        for index, motion in enumerate(ground_motion, 1):
            part = index / (len(ground_motion) + 1)
            self.step(motion, (1.0 - part) * last + part * state)

    def _answer(self, ground_motion: Floats | None, state: Floats) -> Floats:
        both, is_known = (self.parameters, self.state), ground_motion is not None
        progress = self._begin_step(*both, is_known)
        none = np.zeros((1 + self.preview, self._axes))
        motion = none if ground_motion is None else ground_motion
        if not self.state.flags[HOLDING]:
            self._points[:] = self.reference_force.step(motion, state, progress)
        ground, state = (np.ascontiguousarray(each, np.float64) for each in (motion[0], state))
        self._protect(*both, ground, state, is_known, progress, self._points)
        return self._points.copy()
