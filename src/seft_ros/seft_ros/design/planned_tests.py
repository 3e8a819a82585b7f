"""A planned test as a closed loop, sampled exactly, and the loop with other values than planned."""

import cmath
import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import Any

import numpy as np
from scipy.linalg import eig
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components
from seft_msgs_py.arrays import Complexes, Floats
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.errors import InputError
from seft_msgs_py.wire.topics import VALVE_COMMAND
from seft_plant_sim.judge.valve_following import LARGEST_DELAY_ERROR, LARGEST_GAIN_ERROR
from seft_plant_sim.simulated.continuous_model import Drive
from seft_plant_sim.simulated.specimen import Specimen
from seft_plant_sim.whole_structure import tested_specimen

from seft_ros.design.plant import Plant, rig_model
from seft_ros.force_controller.force_control import LinearControl
from seft_ros.force_controller.force_controller_parameters import VELOCITY_FEEDFORWARD
from seft_ros.force_controller.methods import force_control
from seft_ros.force_controller.velocity_feedforward import VelocityFeedforward, feedforward_step
from seft_ros.reference_force.compensator import Compensator, LinearFilter
from seft_ros.reference_force.reference_force_block import compensator, method_inputs
from seft_ros.reference_force.reference_force_parameters import TARGET_MOTION
from seft_ros.reference_force.target_motion import TargetMotion
from seft_ros.reference_force.target_step import FORCE_ROW, begin_target, target_step

LARGE = 60
"""Number of states from which on it pays to split a loop."""


@dataclass(frozen=True)
class SampledLoop:
    """States q of a whole test over n axes: q[k+1] = matrix q[k] + ground g[k...], x = c q.

    Attributes
    ----------
    matrix : ndarray
        Shape (N, N).
    ground : ndarray
        Shape (N, (1 + preview) n), from the ground accelerations of this and the next steps.
    displacement : ndarray
        c, shape (n, N).
    """

    matrix: Floats
    ground: Floats
    displacement: Floats

    def eigenvalues(self) -> Complexes:
        """All N eigenvalues z; the test is stable where every |z| < 1.

        A large loop is first split into its strongly connected parts: they have the same
        eigenvalues and cost less.
        """
        if len(self.matrix) < LARGE:
            return np.linalg.eigvals(self.matrix).astype(np.complex128)
        _, block = connected_components(csr_array(self.matrix), connection="strong")
        sizes = np.bincount(block)
        found = [np.diag(self.matrix)[sizes[block] == 1]]
        for index in np.flatnonzero(sizes > 1):
            part = np.flatnonzero(block == index)
            found.append(np.linalg.eigvals(self.matrix[np.ix_(part, part)]))
        return np.concatenate(found).astype(np.complex128)

    def dominant(self) -> complex:
        """Eigenvalue of the largest magnitude, of a pair the upper."""
        found = self.eigenvalues()
        z = complex(found[np.abs(found).argmax()])
        return complex(z.real, abs(z.imag))

    def modes(self) -> tuple[Complexes, Complexes]:
        """Eigenvalues z, shape (N,), and their residues, shape (N, n, n).

        The residues are those of the transfer function from ground acceleration to displacement.
        """
        z, left, right = eig(self.matrix, left=True)
        known_ahead = self.ground.reshape(len(z), -1, len(self.displacement))
        powers = z[:, np.newaxis] ** np.arange(known_ahead.shape[1])
        entering = np.einsum("si,spn,ip->in", left.conj(), known_ahead, powers)
        scale = np.einsum("si,si->i", left.conj(), right)
        leaving = (self.displacement @ right).T
        with np.errstate(divide="ignore", invalid="ignore"):  # of delays, which are defective
            return z, leaving[:, :, np.newaxis] * (entering / scale[:, np.newaxis])[:, np.newaxis]


def closed_loop(
    rig: tuple[Floats, Floats, Floats], compensation: LinearFilter, control: LinearControl
) -> SampledLoop:
    """Close the loop as the blocks run it.

    The rig with states q (a, b, c of `LoopRig.sampled`) gives y = (x, v, a, f) = c q at sample k;
    the compensation gives p = c s + d y + e g, the reference force or other inputs of the
    controller, which makes the drive u of p and y; u acts on the rig from sample k+1 on. The
    states are those of the rig, the compensation and the controller.
    """
    a, b, c = rig
    size, axes = len(compensation.d), b.shape[1]
    # what p and y do to the rig, and to the states of the controller
    rig_by_p, rig_by_y = np.split(b @ control.d, [size], axis=1)
    control_by_p, control_by_y = np.split(control.b, [size], axis=1)
    p_by_rig = compensation.d @ c
    none = np.zeros((len(compensation.a), len(control.a)))
    matrix = np.block(
        [
            [a + rig_by_p @ p_by_rig + rig_by_y @ c, rig_by_p @ compensation.c, b @ control.c],
            [compensation.b @ c, compensation.a, none],
            [control_by_p @ p_by_rig + control_by_y @ c, control_by_p @ compensation.c, control.a],
        ]
    )
    ground = np.vstack([rig_by_p @ compensation.e, compensation.h, control_by_p @ compensation.e])
    displacement = np.pad(c[:axes], ((0, 0), (0, len(matrix) - len(b))))
    return SampledLoop(matrix, ground, displacement)


CERTAIN = 1e30
"""Variance, or evidence, beside which all others are negligible."""
_BOUNDS = itertools.product(
    (-LARGEST_GAIN_ERROR, LARGEST_GAIN_ERROR), (-LARGEST_DELAY_ERROR, LARGEST_DELAY_ERROR)
)
_ERRORS = ((0.0, 0.0), *_BOUNDS)  # of a valve, that a controller assumes: at the start, at most


def frozen_target(method: TargetMotion, measured: bool) -> LinearFilter:
    """Linear filter from the measured state to all points of the target; the method is reset.

    The output has the shape ((1 + preview) 3 n,). ``measured``: the restoring force is the
    measured one, as after a change of the specimen: r* = r + K (x* - x) + C (v* - v). Else it is
    K x* + C v*, as at the start of a test. The parameters are such that the method adapts nothing.
    """
    state, model = method.state, method.parameters.model
    nothing = np.zeros_like(model.prior)
    model = model._replace(prior=nothing, drift=nothing, change=nothing, surprise=np.inf)
    model = model._replace(stuck=np.zeros_like(model.stuck))
    parameters = method.parameters._replace(model=model)
    n = len(parameters.mass)
    y, points = np.zeros((4, n)), np.zeros((1 + method.preview, 3, n))
    ground = np.zeros((1 + method.preview, n))
    motion = state.target[: 2 * len(parameters.influence)]  # the push on it is made anew
    states = [state.measured, motion, state.ground]
    if measured:
        states.append(state.constant[1])  # the push of the offset, which the next step starts from

    def begin() -> None:
        begin_target(parameters, state)
        state.is_running[0] = 1.0
        if measured:  # the offset follows at once; the assumed stiffness has no weight
            state.model.covariance[:, 0, 0] = CERTAIN
            state.model.sums.evidence = -CERTAIN

    step = partial(target_step, parameters, state, ground, y, 1.0, points)
    (c, d, e), (a, b, h) = _system(begin, step, states, [y, ground], points)
    method.reset()
    return LinearFilter(a, b, h, c, d, e)


def frozen_feedforward(control: VelocityFeedforward) -> list[tuple[Floats, LinearControl]]:
    """Linear controllers from points and measured state to the valves; the controller is reset.

    As it starts, then with the errors of the valves (of the flow gain and of the delay) at the
    bounds to which it may adapt them. The pressure drop under load is left out: it is of second
    order in the motion.

    Each is a matrix of few rows, (q, points), and a controller that reads its q products with the
    points in place of the reference force: they are all that it needs of the points.
    """
    parameters, state = control.parameters, control.state
    actuator = parameters.actuator.copy()
    actuator[:, 3] = np.inf
    parameters = parameters._replace(limit=np.inf, actuator=actuator)
    n = len(actuator)
    y, command = np.zeros((4, n)), np.zeros(n)
    points = np.zeros((2 + state.coming.shape[1], 3, n))

    def begin(errors: tuple[float, float]) -> None:
        control.reset()
        state.errors[:, : len(errors)] = errors  # an error of the oil changes the plan alone
        state.covariance[:] = 0.0
        state.steps[0] = 1.0

    step = partial(feedforward_step, parameters, state, points, y, command)
    states, found = [state.measured, state.sent, state.flows], []
    for errors in _ERRORS:
        outputs, next_states = _system(partial(begin, errors), step, states, [points, y], command)
        (c, d_points, d_state), (a, b_points, b_state) = outputs, next_states
        by_points = np.vstack([d_points, b_points])
        used = np.flatnonzero(by_points.any(axis=1))
        handed_on = np.eye(len(by_points))[:, used]
        d, b = np.hstack([handed_on[:n], d_state]), np.hstack([handed_on[n:], b_state])
        found.append((by_points[used], LinearControl(a, b, c, d)))
    control.reset()
    return found


def _system(
    begin: Callable[[], None],
    step: Callable[[], object],
    states: Sequence[Floats],
    inputs: Sequence[Floats],
    output: Floats,
) -> tuple[list[Floats], list[Floats]]:
    """Find the matrices of a linear step, which ``begin`` prepares and ``step`` runs in place.

    The compiled step is applied to each unit vector of states and inputs; it writes the output
    and the next states. Returned are the matrices of the outputs, then those of the next states:
    by the states, then by each input.
    """
    columns = []
    for array in (*states, *inputs):
        for place in np.ndindex(array.shape):
            begin()
            for other in (*states, *inputs):
                other[...] = 0.0
            array[place] = 1.0
            step()
            columns.append(np.concatenate([part.ravel() for part in (output, *states)]))
    sizes = [sum(part.size for part in states), *(part.size for part in inputs)]
    outputs, next_states = np.split(np.array(columns).T, [output.size])
    ends = np.cumsum(sizes)[:-1]
    return np.split(outputs, ends, axis=1), np.split(next_states, ends, axis=1)


NEUTRAL = 1e-6
"""Growth rate up to which a loop counts as stable, 1/s: rounding makes this of zero."""


@dataclass(frozen=True)
class LoopRig:
    """The rig as a linear system: actuators, specimen and sensors of n axes.

    Attributes
    ----------
    plant : Plant
        From the drive to (x, v, a, f), each over the n axes: c and d have 4n rows.
    drive : str
        ``valve_command``, or ``reference_force`` of an idealised actuator.
    specimen : Specimen
        On the rig, as far as it is known.
    velocity_cutoff : float or None
        Cutoff of the filter that derives the velocity from the displacement, Hz; None: the
        velocity is measured.
    small_signal : bool
        Whether the rig is not linear and this is its limit for small motions.
    """

    plant: Plant
    drive: Drive
    specimen: Specimen
    velocity_cutoff: float | None = None
    small_signal: bool = False

    def sampled(self, dt: float, dead_time: float, gain: float) -> tuple[Floats, Floats, Floats]:
        """Matrices a, b, c from the drive that answers sample k to (x, v, a, f) of sample k.

        ``dead_time``, in s, replaces that of the plant, ``gain`` is a factor on the drive.
        An InputError says if the dead time is many samples long.
        """
        plant = replace(self.plant, b=gain * self.plant.b, d=gain * self.plant.d, delay=dead_time)
        a, b, c = plant.sampled(dt)
        if self.velocity_cutoff is None:
            return a, b, c
        # v = g x + s, s' = p s + g (p - 1) x, as `Differentiator` runs it
        n, half = b.shape[1], np.pi * self.velocity_cutoff * dt
        g, p = 2 * half / dt / (1 + half), (1 - half) / (1 + half)
        displacement, one = c[:n], np.eye(n)
        a = np.block([[a, np.zeros((len(a), n))], [g * (p - 1) * displacement, p * one]])
        b = np.vstack([b, np.zeros((n, n))])
        c = np.hstack([c, np.zeros((4 * n, n))])
        c[n : 2 * n] = np.hstack([g * displacement, one])
        return a, b, c


def choose_rig(experiment: Experiment, stiffness: float = 1.0) -> LoopRig:
    """Rig of an experiment, with a factor on the stiffness of the specimen.

    The simulated one or, where there is none, that of the facts: actuators and specimen. An
    InputError says if they are not known.
    """
    source, model = rig_model(experiment, stiffness)
    section, specimen = experiment["reference_force"], tested_specimen(experiment)
    derived = section["sensors.velocity"] == "derived"
    cutoff = section["sensors.velocity_cutoff"] if derived else None
    plant = Plant.of_model(source, model, motion=True)
    return LoopRig(plant, model.drive, specimen, cutoff, small_signal=not model.is_linear)


class PlannedTest:
    """The loop of an experiment, and the loop with other values; see `choose_rig`.

    Attributes
    ----------
    rig : LoopRig
        As planned.
    mass_ratio, dead_time : float
        As planned; the dead time, of the rig's drive, in s.
    dt : float
        Sampling period, s.
    follows, follows_valves : bool
        Whether the method adapts to the specimen's local stiffness, the controller to the valves.

    An InputError says if there is no model of the rig, or parameters contradict each other.
    """

    def __init__(self, experiment: Experiment) -> None:
        for node in ("reference_force", "force_controller"):
            if node not in experiment.sections:
                raise InputError(f"{node}: runs elsewhere, so its parameters are not known here")
        self.experiment = experiment
        self.axes, self.dt = experiment.axes, experiment.timebase.dt
        self.rig = choose_rig(experiment)
        self.section = experiment["reference_force"]
        self.mass_ratio = float(self.section["mass_ratio"])
        self.dead_time = self.rig.plant.delay
        self.follows = self.section["compensation.method"] == TARGET_MOTION
        self._controllers = self._linear_controllers()
        self.follows_valves = len(self._controllers) > 1
        self._filter = lru_cache(maxsize=256)(self.compensation)
        self._sampled = lru_cache(maxsize=256)(self._sample)

    def compensator(
        self, mass_ratio: float | None = None, stiffness: float = 1.0, delay_error: float = 0.0
    ) -> Compensator:
        """Make the compensation method as in the test, but for the changes, see `loops`.

        ``stiffness`` is a factor on the assumed stiffness.
        """
        section = dict(self.section)
        if mass_ratio is not None:
            section["mass_ratio"] = mass_ratio
        scaled = stiffness * np.atleast_1d(section["specimen.stiffness"])
        section["specimen.stiffness"] = scaled.tolist()
        known = method_inputs(section, self.axes, self.experiment.timebase)
        known = replace(known, late=known.late + delay_error)
        return compensator(section["compensation.method"], known)

    @property
    def assumed_delay(self) -> float:
        """Delay from reference force to measured force that a method may compensate, s."""
        return method_inputs(self.section, self.axes, self.experiment.timebase).assumed_delay

    def compensation(self, measured: bool = False, **changes: Any) -> LinearFilter:
        """Give the method as a linear filter; changes as of `compensator`.

        The output of `target_motion` is all points, see `frozen_target`; ``measured``: as it is
        with the restoring force as measured.
        """
        made = self.compensator(**changes)
        return frozen_target(made, measured) if isinstance(made, TargetMotion) else made.linear()

    def loops(
        self,
        mass_ratio: float | None = None,
        dead_time: float | None = None,
        gain: float = 1.0,
        delay_error: float = 0.0,
        stiffness: float = 1.0,
        followed: bool = False,
        any_valve: bool = False,
    ) -> list[SampledLoop]:
        """Close the loop, as planned but for the changes.

        Parameters
        ----------
        mass_ratio : float, optional
            alpha; the method is made for it.
        dead_time : float, optional
            Of the rig's drive, s; the method does not know it.
        gain : float
            Factor on the rig's drive; the method does not know it.
        delay_error : float
            Added to the delay that the method assumes, s.
        stiffness : float
            Factor on the stiffness of the specimen on the rig.
        followed : bool
            Whether the method has adapted to that factor.
        any_valve : bool
            Whether to include the bounds of what a controller that adapts to the valves may
            assume.

        Returns
        -------
        list of ClosedLoop
            As the test starts; of a method that adapts to the specimen also with the restoring
            force as measured, as it is when the specimen differs from the assumed one.

        An InputError says if the method can't be made like this, or the dead time is many samples
        long.
        """
        rig = self._sampled(stiffness, self.dead_time if dead_time is None else dead_time, gain)
        assumed = {"stiffness": stiffness if followed else 1.0, "delay_error": delay_error}
        late, loops = self.section["loop_delay"], []
        for read, control in self._controllers if any_valve else self._controllers[:1]:
            for measured in (False, True) if self.follows else (False,):
                part = self._filter(measured, mass_ratio=mass_ratio, **assumed)
                if read is not None:  # of the points from the one that the loop's delay leads to
                    first = 3 * len(self.axes) * late
                    of = slice(first, first + read.shape[1])
                    c, d, e = (read @ matrix[of] for matrix in (part.c, part.d, part.e))
                    part = replace(part, c=c, d=d, e=e)
                loops.append(closed_loop(rig, part.delayed(late), control))
        return loops

    def worst(self, **changes: Any) -> complex:
        """Eigenvalue of all `loops` with the largest magnitude."""
        return max((loop.dominant() for loop in self.loops(**changes)), key=abs)

    def hz(self, **changes: Any) -> float:
        """Frequency of that mode, Hz."""
        return abs(cmath.phase(self.worst(**changes))) / (2 * np.pi * self.dt)

    def growth_rate(self, **changes: Any) -> float:
        """Growth rate ln|z| / dt of that mode, 1/s: positive if the test is unstable."""
        return float(np.log(max(abs(self.worst(**changes)), 1e-300)) / self.dt)

    def is_stable(self, **changes: Any) -> bool:
        """Whether none of `loops` grows."""
        return self.growth_rate(**changes) <= NEUTRAL

    def _sample(self, stiffness: float, *drive: float) -> tuple[Floats, Floats, Floats]:
        """Sample the rig with this specimen, and a dead time and gain of its drive."""
        rig = self.rig if stiffness == 1.0 else choose_rig(self.experiment, stiffness)
        return rig.sampled(self.dt, *drive)

    def _linear_controllers(self) -> Sequence[tuple[Floats | None, LinearControl]]:
        """Make the controller as it starts, then at the bounds to which it may adapt.

        Before each is the matrix from the points to what it reads; None: the method has no points.
        """
        n, section = len(self.axes), self.experiment["force_controller"]
        control = LinearControl.none(n)
        if self.rig.drive == VALVE_COMMAND.name:
            made = force_control(section, self.axes, self.experiment.timebase)
            if isinstance(made, VelocityFeedforward) and self.follows:
                return frozen_feedforward(made)
            if isinstance(made, VelocityFeedforward):
                mend = f"set reference_force: compensation.method to {TARGET_MOTION}"
                text = f"force_controller: {VELOCITY_FEEDFORWARD} needs a target motion"
                raise InputError(f"{text}: {mend}")
            control = made.linear()
        return [(np.eye(n, 3 * n, k=FORCE_ROW * n) if self.follows else None, control)]
