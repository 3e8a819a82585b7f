"""Force control: the interface of all controllers, that by transfer functions, and followers."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, NamedTuple, Protocol

import numpy as np
from seft_msgs_py.arrays import Floats, clear, zeros
from seft_msgs_py.config.parameter_table import Section, as_matrix
from seft_msgs_py.errors import InputError
from seft_msgs_py.wire.topics import RigAxes, Timebase
from seft_plant_sim.compiled import bounded, compiled, copy, entry_point, multiply
from seft_plant_sim.judge.known_rig import command_limit, read_specimen
from seft_plant_sim.lti import bilinear
from seft_plant_sim.rig_parameters import common_lag

from seft_ros.force_controller.stop_path import planned_acceleration, stop_path
from seft_ros.reference_force.compensator import NotLinearError
from seft_ros.reference_force.reference_force_parameters import HORIZON_PER_LAG, horizon_steps


@dataclass(frozen=True)
class ControlInputs:
    """The known data of a test for a controller.

    Attributes
    ----------
    axes : int
        Number of axes n.
    dt : float
        Sampling period, s.
    voltage_limit : float
        Largest valve drive, in both directions, V; larger drives are cut off.
    """

    axes: int
    dt: float
    voltage_limit: float


@dataclass(frozen=True)
class LinearControl:
    """A controller as a linear system with p states w, over n axes.

    Its input s is the reference force, then the measured displacement, velocity, acceleration
    and force: 5 n values. u = c w + d s, w[k+1] = a w + b s.

    Attributes
    ----------
    a, b, c, d : ndarray
        Shapes (p, p), (p, 5n), (n, p) and (n, 5n).
    """

    a: Floats
    b: Floats
    c: Floats
    d: Floats

    @classmethod
    def of_error(
        cls, a: Floats, b: Floats, c: Floats, d: Floats, feedback: bool = True
    ) -> "LinearControl":
        """Make one with the input f_r - f (force error); without feedback, f_r.

        Parameters
        ----------
        a, b, c, d : ndarray
            Shapes (p, p), (p, n), (n, p) and (n, n).
        feedback : bool
            Whether the measured force is fed back.
        """
        error = np.eye(len(d), 5 * len(d))
        if feedback:
            error -= np.eye(len(d), 5 * len(d), k=4 * len(d))
        return cls(a, b @ error, c, d @ error)

    @classmethod
    def none(cls, axes: int) -> "LinearControl":
        """Make one that passes on the reference force."""
        one = np.eye(axes)
        return cls.of_error(np.zeros((0, 0)), one[:0], one[:, :0], one, feedback=False)


class ForceControl(Protocol):
    """The interface of a force controller.

    A controller that identifies may also have ``estimates()``: each quantity by name, shape (n,).
    The node publishes them in its diagnostics. One that follows a target may have ``stop(plan)``,
    as `VelocityFeedforward` has: the commands that bring the rig to rest.

    Attributes
    ----------
    limited : bool
        Whether the last drive was at its limit on any axis.
    shape : tuple of int
        Number of points that it needs, and of quantities of each: 1, the force, or 3, of a target.
    """

    limited: bool
    shape: tuple[int, int]

    def reset(self) -> None:
        """Forget the test so far."""

    def step(self, points: Floats, state: Floats) -> Floats:
        """Compute the valve drive of one step.

        Parameters
        ----------
        points : ndarray
            Points of this step and future ones, shape (p, q, n): the last quantity is the reference
            force, N; for a target, displacement and velocity precede it.
        state : ndarray
            Measured displacement (m), velocity (m/s), acceleration (m/s^2) and force (N),
            shape (4, n).

        Returns
        -------
        ndarray
            Valve drive within the limit, shape (n,), V.
        """

    def linear(self) -> LinearControl:
        """Linear system of the controller within its limits.

        Raises
        ------
        InputError
            If the controller does not give one.
        """


class TransferParameters(NamedTuple):
    """Parameters of a controller of n axes with d delays.

    Attributes
    ----------
    matrix : ndarray
        Shape (d + n, n + d), transposed: takes (delays, error) to (drive, delays) without a limit.
    from_drive : ndarray
        Change of the delays by a change of the drive, negative, shape (d, n).
    limit : float
        Largest magnitude of the drive, V.
    feedback : bool
        Whether the measured force is fed back.
    """

    matrix: Floats
    from_drive: Floats
    limit: float
    feedback: bool


class TransferState(NamedTuple):
    """State of the controller: arrays of zeros."""

    work: Annotated[Floats, "size"]  # delays and error, d + n
    result: Annotated[Floats, "size"]  # the matrix times these


@compiled
def transfer_step(
    p: TransferParameters, state: TransferState, points: Floats, measured: Floats, command: Floats
) -> bool:
    """Find the drive that answers a sample.

    Parameters
    ----------
    p, state
        The state is updated.
    points : ndarray
        Of the reference force, shape (p, q, n).
    measured : ndarray
        Displacement, velocity, acceleration and force, shape (4, n).
    command : ndarray
        The result, shape (n,), V.

    Returns
    -------
    bool
        Whether the drive is at its limit on any axis.
    """
    work, result, n = state.work, state.result, len(command)
    delays, last, limited = len(work) - n, points.shape[1] - 1, False
    for i in range(n):
        error = points[0, last, i]
        work[delays + i] = error - measured[3, i] if p.feedback else error
    multiply(p.matrix, work, result)
    for i in range(n):
        drive = result[i]
        limited |= abs(drive) >= p.limit
        command[i] = bounded(drive, p.limit)
    copy(delays, result[n:], work)
    if limited:
        for j in range(delays):
            for i in range(n):
                work[j] -= p.from_drive[j, i] * (command[i] - result[i])
    return limited


class ForceController:
    """Force servo of n axes: u = G C(s) (f_r - f), limited to the valve's range.

    C is a transfer function on each axis, the same for all or one for each; G combines their
    outputs, for valves of different gain or to decouple axes. Without feedback it is
    u = G C(s) f_r, which drives the valves by a signal of the user.

    C is discretised with the bilinear (Tustin) transform. Its recursion uses the limited outputs,
    as the valve does, and so cannot wind up: the anti-windup of Astrom & Wittenmark
    (Computer-Controlled Systems, 3rd ed., sec. 9.4) with a dead-beat observer. Within the limit it
    is the linear controller itself.

    Parameters
    ----------
    controllers : sequence of (sequence of float, sequence of float)
        Numerator and denominator of each axis in s, highest power first; proper, and of one order
        on all axes.
    voltage_limit : float
        Largest magnitude of the valve drive, V.
    dt : float
        Sampling period, s.
    feedback : bool
        Whether the measured force is fed back.
    gain : ndarray, optional
        G, shape (n, n), invertible; default 1.

    Attributes
    ----------
    limited : bool
        Whether the last drive was at its limit on any axis.
    shape : tuple of int
        See `ForceControl`.
    parameters, state : TransferParameters, TransferState
        Arguments of `transfer_step`, here and in a compiled loop.

    Raises
    ------
    InputError
        If a C is improper, has no denominator, can't be discretised at this rate, or has another
        order than the others, or if G is singular.
    """

    shape = 1, 1

    def __init__(
        self,
        controllers: Sequence[tuple[Sequence[float], Sequence[float]]],
        voltage_limit: float,
        dt: float,
        feedback: bool = True,
        gain: Floats | None = None,
    ) -> None:
        axes = len(controllers)
        sampled = [bilinear(*each, dt) for each in controllers]
        orders = {len(a) - 1 for _, a in sampled}
        if len(orders) > 1:
            mend = "give them the same, with leading zeros in the numerator"
            degrees = f"{min(orders)} and {max(orders)}"
            raise InputError(f"force_controller: denominators of degree {degrees}; {mend}")
        order = orders.pop()
        # transposed direct form II on the vector (w, e), w the order * n delays:
        # u = b0 e + w[0],  w' = shift(w) + b e - a u; with that u put in, in one matrix
        size = (order + 1) * axes
        matrix, from_drive = np.zeros((size, size)), np.zeros((order * axes, axes))
        for axis, (b, a) in enumerate(sampled):
            output = np.eye(1, order + 1)
            output[0, order] = b[0]
            update = np.column_stack([np.eye(order, k=1), b[1:]]) - np.outer(a[1:], output)
            matrix[axis::axes, axis::axes] = np.vstack([output, update])
            from_drive[axis::axes, axis] = a[1:]
        if gain is not None:
            matrix[:axes] = gain @ matrix[:axes]
            try:
                from_drive = np.ascontiguousarray(from_drive @ np.linalg.inv(gain))
            except np.linalg.LinAlgError:
                why = "a valve or a combination of valves would never be driven"
                text = f"force_controller: gain {gain.tolist()} is singular: {why}"
                raise InputError(text) from None
        transposed, limit = np.ascontiguousarray(matrix.T), float(voltage_limit)
        self.parameters = TransferParameters(transposed, from_drive, limit, bool(feedback))
        self.state = zeros(TransferState, {"size": size})
        self._axes, self.limited = axes, False
        points, measured = np.zeros((1, 1, axes)), np.zeros((4, axes))
        arguments = points, measured, measured[0]
        self._step = entry_point(transfer_step, self.parameters, self.state, *arguments)

    @classmethod
    def from_parameters(
        cls, section: Section, axes: tuple[str, ...], timebase: Timebase, rig: RigAxes | None = None
    ) -> "ForceController":
        """Make it from its section of an experiment, see `force_control`."""
        own = (rig or RigAxes.whole(axes)).places
        gain = as_matrix(section["gain"], axes, "force_controller: gain")
        if np.delete(gain[list(own)], own, axis=1).any():
            why = "axes of different rigs, whose force controllers do not know each other's forces"
            raise InputError(f"force_controller: gain {gain.tolist()} mixes {why}")
        numerators = _polynomials(section, "numerator", axes)
        denominators = _polynomials(section, "denominator", axes)
        controllers = [(numerators[place], denominators[place]) for place in own]
        limits = command_limit(section), timebase.dt, section["feedback"]
        return cls(controllers, *limits, gain[np.ix_(own, own)])

    def reset(self) -> None:
        """Forget the test so far."""
        clear(self.state)

    def linear(self) -> LinearControl:
        """Give its matrices; the states are the delays."""
        n, matrix = self._axes, self.parameters.matrix.T
        by_delays, by_error = matrix[:, :-n], matrix[:, -n:]
        (c, a), (d, b) = np.split(by_delays, [n]), np.split(by_error, [n])
        return LinearControl.of_error(a, b, c, d, self.parameters.feedback)

    def step(self, points: Floats, state: Floats) -> Floats:
        """See `seft_ros.force_controller.force_control.ForceControl.step`."""
        points, state = (np.ascontiguousarray(values, np.float64) for values in (points, state))
        command = np.empty(self._axes)
        self.limited = self._step(self.parameters, self.state, points, state, command)
        return command


def _polynomials(section: Section, name: str, axes: Sequence[str]) -> list[list[float]]:
    """Give the polynomial of each axis, numerator or denominator."""
    coefficients: list[float] = np.atleast_1d(section[name]).tolist()
    if not section["per_axis"]:
        return [coefficients] * len(axes)
    each, remainder = divmod(len(coefficients), len(axes))
    if remainder:
        many = f"{len(coefficients)} coefficients for {len(axes)} axes {list(axes)}"
        raise InputError(
            f"force_controller: per_axis, but {name} has {many}; give each axis as many"
        )
    return [coefficients[each * axis : each * (axis + 1)] for axis in range(len(axes))]


def horizon_of(section: dict[str, Any], dt: float, needed: int, driven: str) -> int:
    """Count the future steps; an InputError says how many what is driven needs, if too few."""
    horizon = horizon_steps(section, dt)
    if horizon < needed:
        needs = needed * dt - HORIZON_PER_LAG * common_lag(section)
        why = f"but the {driven} need {needs:.3g} s of the future motion; make it longer"
        horizon_s = section["compensation.horizon"]
        raise InputError(f"reference_force: compensation.horizon is {horizon_s:g} s, {why}")
    return horizon


@compiled
def as_sample(points: Floats, dt: float, sample: Floats) -> None:
    """Give the sample that a specimen on its target would show.

    Parameters
    ----------
    points : ndarray
        Displacement, velocity and force of the target at a step and the coming ones, (p, 3, n).
    dt : float
        Sampling period, s.
    sample : ndarray
        Displacement, velocity, acceleration and force, shape (4, n). The result.
    """
    for i in range(sample.shape[1]):
        sample[0, i], sample[1, i] = points[0, 0, i], points[0, 1, i]
        sample[2, i] = planned_acceleration(points, i, dt)
        sample[3, i] = points[0, 2, i]


GAIN_ERROR, DELAY_ERROR = range(2)
"""First columns of ``errors`` of a `TargetFollower`."""


class TargetFollower:
    """Force controller of n axes that follows a target by its future motion.

    A subclass has ``method``, its name, ``names`` of its errors with their standard deviations at
    the beginning, ``uncertain``, and ``functions``, compiled: step(parameters, state, points,
    measured, command), and stop(parameters, state, path, plan, slowed, commands).

    Parameters
    ----------
    section, axes, timebase, rig
        See `seft_ros.force_controller.methods.force_control`.

    Raises
    ------
    InputError
        If what it drives is not known, or the horizon is too short for that.

    Attributes
    ----------
    limited, shape
        See `ForceControl`.
    parameters, state : NamedTuple
        Arguments of the step, here and in a compiled loop. The state has ``errors`` of shape (n,
        number of errors), and their ``covariance``.
    """

    method: str
    names: tuple[str, ...]
    uncertain: tuple[float, ...]
    functions: tuple[Callable[..., Any], Callable[..., Any]]

    def __init__(
        self,
        section: Section,
        axes: tuple[str, ...],
        timebase: Timebase,
        rig: RigAxes | None = None,
    ) -> None:
        own, dt = list((rig or RigAxes.whole(axes)).places), timebase.dt
        parameters, state, horizon, needed = self._known(section, axes, own, dt)
        self.parameters, self.state = parameters, state
        path = stop_path(*read_specimen(section, axes, own), horizon, dt)
        n, steps, (step, stop) = len(state.errors), path.steps, self.functions
        self.shape = 1 + horizon, 3
        self._points, self._measured = np.zeros((1 + horizon, 3, n)), np.zeros((4, n))
        self._command, both, self._path = np.zeros(n), (parameters, state), path
        self._room = np.zeros((steps + needed + 2, 3, n)), np.zeros((steps, n))
        self._used_up = type(state)(*(np.zeros_like(each) for each in state))
        self._step = entry_point(step, *both, self._points, self._measured, self._command)
        self._stop = entry_point(stop, *both, path, self._points, *self._room)
        self.reset()

    def _known(
        self, section: Section, axes: tuple[str, ...], own: list[int], dt: float
    ) -> tuple[Any, Any, int, int]:
        """Give parameters and state, the future steps that are known, and those that a step needs.

        ``own`` are the places of the rig's axes.
        """
        raise NotImplementedError

    def reset(self) -> None:
        """Begin a new test."""
        self.limited = False
        clear(self.state)
        self.state.covariance[:] = np.diag(np.square(self.uncertain))

    def estimates(self) -> dict[str, Floats]:
        """Give the errors that are followed, by name."""
        return dict(zip(self.names, self.state.errors.T, strict=True))

    def linear(self) -> LinearControl:
        """Raise an error: there is none."""
        raise NotLinearError("force_controller", self.method)

    def step(self, points: Floats, state: Floats) -> Floats:
        """Find the commands that answer a sample; shape (n,)."""
        known = points[: len(self._points)]
        self._points[: len(known)], self._points[len(known) :] = known, known[-1]
        self._measured[:] = state
        both = self.parameters, self.state
        self.limited = self._step(*both, self._points, self._measured, self._command)
        return self._command.copy()

    def stop(self, plan: Floats) -> Floats:
        """Give the commands that bring the rig to rest, from the next step on; shape (N, n).

        ``plan`` has the target's points of the last step and the coming ones, shape `shape` and n.
        """
        for used, own in zip(self._used_up, self.state, strict=True):
            used[...] = own
        self._stop(self.parameters, self._used_up, self._path, plan, *self._room)
        return self._room[-1].copy()
