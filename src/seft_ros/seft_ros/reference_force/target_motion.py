"""Compensation method ``target_motion``: the future motion of the whole structure.

A computed model takes a step after each sample, at the target's motion of that sample. Its force g
is then extrapolated linearly over displacement, velocity and time::

    g(x, v, t) = g_n + K (x - x_n) + C (v - v_n) + (t - t_n) g'

K and C are the tangents that the model gives, or those at rest; with g' the last line would have
given the force at the beginning of this one. If the force depends on displacements alone, K does
that instead, by Broyden's update (1965). An impulse corrects the error of the last line, so that
the impulse of g is that of the trapezoidal rule.
"""

import math

import numpy as np
from scipy.linalg import eigh
from seft_msgs_py.arrays import Floats, zeros
from seft_msgs_py.config.facts import FORCE_DRIVEN
from seft_plant_sim.channels import acceleration_is_derived
from seft_plant_sim.compiled import entry_point, places
from seft_plant_sim.computed.computed_model import ComputedModel, ModelError
from seft_plant_sim.computed.computed_substructure import ComputedSubstructure
from seft_plant_sim.computed.model_worker import ModelState
from seft_plant_sim.judge.servo_model import derived_noise, second_difference, smoothing_steps
from seft_plant_sim.lti import first_order_hold

from seft_ros.reference_force import reference_force_parameters, target_step
from seft_ros.reference_force.compensator import LinearFilter, MethodInputs, NotLinearError
from seft_ros.reference_force.force_command import command_arrays, command_step
from seft_ros.reference_force.observers import observer_gains, sensor_noise, steps_of_force
from seft_ros.reference_force.restoring_model import UNCERTAIN_STIFFNESS, model_arrays
from seft_ros.reference_force.target_step import TargetParameters, TargetState

MIN_MOTION = 1e-9  # m: the tangent of a smaller motion is rounding
_STIFFEST = 0.25
"""Largest tangent over the mass, times dt squared: the prediction is stable up to this value."""


class ModelLine:
    """Steps a computed model at each sample, and extrapolates its force.

    Parameters
    ----------
    computed : ComputedSubstructure
        With a model, which is made when it is first needed: the linear loops of preflight do not
        need it.
    inverse : ndarray
        Of the whole mass, shape (N, N), 1/kg.
    dt : float
        Sampling period, s.

    Attributes
    ----------
    values : ndarray
        Acceleration per displacement and velocity, constant acceleration, and its rate, shape
        (N, 2N + 2): of the force minus that of the tangents at rest. Time begins at the last
        sample.
    force : ndarray
        Of the model at the last sample, shape (N,), N.
    """

    def __init__(self, computed: ComputedSubstructure, inverse: Floats, dt: float) -> None:
        assert computed.model is not None
        size = len(inverse)
        self._source, self._inverse, self._dt = computed.model, inverse, dt
        self._every, self._by_axis = computed.model.every, computed.model.influence
        self._made: ComputedModel | None = None
        self._rest = np.hstack(computed.model.tangents)
        self.values, self.force = np.zeros((size, 2 * size + 2)), np.zeros(size)
        self.reset()

    def reset(self) -> None:
        """Begin a new test."""
        self._is_started, self._count = False, 0
        self.values[:], self.force[:] = 0.0, 0.0
        self._asked = np.zeros(0)  # the motion to which the model steps
        self._line = np.zeros_like(self.values)  # the line from the last answer on
        self._at: Floats | None = None  # the motion of the last answer
        self._tangent = self._source.probed.stiffness  # of the model's own axes, updated
        self._own = np.zeros(0), np.zeros(0)  # their displacement and force

    def step(self, motion: Floats, ground: Floats) -> None:
        """Step the model at a sample of the target.

        Parameters
        ----------
        motion : ndarray
            Displacements, then velocities, shape (2N,); the missed impulse is added to them.
        ground : ndarray
            Ground acceleration of the axes, shape (n,), m/s^2.

        Raises
        ------
        ModelError
            If the model fails.
        """
        model, count, size = self._model(), self._count, len(self.force)
        self._count += 1
        self.values[:, -2] += self._dt * self.values[:, -1]  # time begins here
        turn = count % self._every
        if turn == 0:
            x, v = motion[:size].copy(), motion[size:].copy()
            self._asked = motion.copy()
            model.ask(count * self._dt, x, v, self._by_axis @ ground)
        if turn == self._every - 1:
            self._take(model.answer(), motion, turn)

    def _model(self) -> ComputedModel:
        """Give the model, started for this test."""
        if self._made is None:
            self._made = ComputedModel(self._source)
        if not self._is_started:
            self._responses = self._made.start(self._every * self._dt).responses
            self._is_started = True
        return self._made

    def _take(self, found: ModelState, motion: Floats, late: int) -> None:
        """Make the new line, and correct the motion; the force is that of ``late`` samples ago."""
        force, at, self._responses = found.force, self._asked, found.responses
        size, span = len(force), self._every * self._dt
        acts = -self._inverse @ (force - self._rest @ at)
        line, before = np.zeros_like(self._line), self._line
        follows, own = self._source.probed.is_static, (found.stiffness, found.damping)
        for part, tangent in zip((slice(size), slice(size, 2 * size)), own, strict=True):
            if tangent is not None:
                line[:, part] = -self._inverse @ (tangent - self._rest[:, part])
                follows = False
        if follows:
            line[:, :size] = -self._follow(at, force)
        if self._at is not None:
            change = acts - before[:, : 2 * size] @ at - before[:, -2]
            if not follows:
                line[:, -1] = change / span
            missed = change - span * before[:, -1]
            # the error grew in proportion to the time, from the first use of the line until now
            begin = late * self._dt
            end = span + begin
            motion[size:] += 0.5 * (end**2 - begin**2) / span * missed
            motion[:size] += (end**3 / 6 - end * begin**2 / 2 + begin**3 / 3) / span * missed
        line[:, -2] = acts - line[:, : 2 * size] @ at
        self._line, self._at = line, at
        self.values[:] = line
        self.values[:, -2] += late * self._dt * line[:, -1]
        self.force[:] = force

    def _follow(self, at: Floats, force: Floats) -> Floats:
        """Update the tangent of a static model; give accelerations per displacement, (N, N)."""
        size, rows = len(force), self._model().rows
        own, own_force = rows @ at[:size], np.linalg.lstsq(rows.T, force, rcond=None)[0]
        own_force = own_force - self._source.probed.damping @ (rows @ at[size:])
        if self._at is not None:
            moved = own - self._own[0]
            span = float(moved @ moved)
            if span > MIN_MOTION**2:
                missed = own_force - self._own[1] - self._tangent @ moved
                self._tangent = self._tangent + np.outer(missed, moved) / span
        self._own = own, own_force
        stiffness = rows.T @ self._tangent @ rows
        beside = self._inverse @ (stiffness - self._rest[:, :size])
        largest = _STIFFEST / self._dt**2
        beside *= min(1.0, largest / max(float(np.linalg.norm(beside)), largest))
        return beside

    def failure_of(self, error: ModelError) -> str:
        """Describe a failure, with its step."""
        return f"{error} (step {self._count - 1})"

    def recorded(self, axes: int) -> dict[str, Floats]:
        """Give the model's motion, force and responses; shape (n,) each.

        Values that belong to no axis are given for each axis.
        """
        size, source, model = len(self.force), self._source, self._model()
        at = np.zeros(size) if self._at is None else self._at[:size]
        force = np.linalg.lstsq(model.rows.T, self.force, rcond=None)[0]
        found: dict[str, Floats] = {}
        of_model = reference_force_parameters.OF_MODEL
        for kind, values in (("displacement", model.rows @ at), ("force", force)):
            for place, value in zip(model.places, values.tolist(), strict=True):
                name = f"{of_model}{kind}"
                if place < axes:
                    found.setdefault(name, np.zeros(axes))[place] = value
                else:
                    found[f"{name}, {source.dofs[place]}"] = np.full(axes, value)
        more = {f"{of_model}{name}": np.full(axes, v) for name, v in self._responses.items()}
        return found | more


LONGEST_SUBSTEP = 0.001
"""s: a sticking specimen, 46 times as stiff as the paper's, swings at 48 Hz (mass ratio 1)."""


class TargetMotion:
    """Target of n axes, predicted over a horizon, as a compensation method.

    Parameters
    ----------
    known : MethodInputs
        Of the test; its damping and stiffness are initial values of the model of the restoring
        force.

    Attributes
    ----------
    preview : int
        Steps of the horizon.
    parameters, state : TargetParameters, TargetState
        Arguments of `target_step`, here and in a compiled loop.
    command : tuple of CommandParameters and CommandState, or None
        Of a rig that obeys forces, see `command_step`.
    progress : float
        See `target_step`.
    model : ModelLine or None
        Of the computed model.
    failure : str
        Reason of the model's failure; empty without a failure.
    """

    def __init__(self, known: MethodInputs) -> None:
        self.preview, n = steps_ahead(known), known.axes
        self.parameters, self.state, self.model = target_arrays(known)
        self._ground, self._measured = np.zeros((1 + self.preview, n)), np.zeros((4, n))
        self._points = np.zeros((1 + self.preview, 3, n))
        both = self.parameters, self.state
        arguments = self._ground, self._measured, 1.0, self._points
        self._step = entry_point(target_step.target_step, *both, *arguments)
        self._begin = entry_point(target_step.begin_target, *both)
        self._estimate = entry_point(target_step.target_estimates, *both, self._ground)
        obeys_force = known.options["actuator.kind"] in FORCE_DRIVEN
        self.command = command_arrays(known, self.preview) if obeys_force else None
        if self.command is not None:
            self._command_step = entry_point(command_step, *self.command, *both, self._points)
        self.reset()

    def reset(self) -> None:
        """Begin a new test."""
        self.progress, self.failure = 1.0, ""
        self._is_asked = True
        self._recorded: dict[str, Floats] = {}
        if self.model is not None:
            self.model.reset()
        self._begin(self.parameters, self.state)
        if self.command is not None:
            self.command[1].sent[:] = 0.0  # no force has been requested

    def step(self, ground_motion: Floats, state: Floats) -> Floats:
        """Update the target with a sample, see `target_step`; (1 + preview, 3, n).

        After a failure of the computed model all points are NaN.
        """
        self.ask_model()
        self._ground[:] = ground_motion
        self._measured[:] = state
        sample = self._ground, self._measured, self.progress, self._points
        self._step(self.parameters, self.state, *sample)
        if self.command is not None:
            self._command_step(*self.command, self.parameters, self.state, self._points)
        self._is_asked = False
        if self.failure:
            self._points[:] = np.nan
        return self._points.copy()

    def ask_model(self) -> None:
        """Step the computed model at the last sample, if there is one and it was not stepped yet.

        This is done at the latest before the next sample, and earlier if there is time.
        """
        model, state = self.model, self.state
        if model is None or self._is_asked or self.failure:
            return
        self._is_asked = True
        if not np.isfinite(self._points).all():
            return
        size = len(self.parameters.dofs)
        before = model.values.copy()
        try:
            model.step(state.target[: 2 * size], state.ground)
        except ModelError as error:
            self.failure = model.failure_of(error)
            return
        state.constant[1] += model.values[:, -2] - before[:, -2]
        state.by_state[1] += model.values[:, :-2] - before[:, :-2]

    def linear(self) -> LinearFilter:
        """Raise an error: there is none."""
        raise NotLinearError("reference_force", reference_force_parameters.TARGET_MOTION)

    def estimates(self) -> dict[str, Floats]:
        """Stiffness, damping and sliders' force of each spring, as identified on line.

        With a computed model also its motion, force and responses.
        """
        found = np.empty((len(target_step.ESTIMATE_NAMES), len(self.parameters.mass)))
        self._estimate(self.parameters, self.state, found)
        estimates: dict[str, Floats] = dict(zip(target_step.ESTIMATE_NAMES, found, strict=True))
        if self.model is None:
            return estimates
        self.ask_model()
        try:
            self._recorded = self.model.recorded(found.shape[1])
        except ModelError as error:
            self.failure = self.failure or self.model.failure_of(error)
        return estimates | self._recorded


def steps_ahead(known: MethodInputs) -> int:
    """Count the steps of the horizon, with those of a link."""
    return known.loop_delay + reference_force_parameters.horizon_steps(known.options, known.dt)


def target_arrays(known: MethodInputs) -> tuple[TargetParameters, TargetState, ModelLine | None]:
    """Put a target into arrays, from the known data of a test; make a computed model's line."""
    # beyond 60 lines: each array once, in the order in which they need each other
    n, computed, dt = known.axes, known.computed, known.dt
    size = n + computed.internal
    names = tuple(f"axis {index + 1}" for index in range(n))
    noise = sensor_noise(known.options, names)
    gains, left = observer_gains(noise, dt)
    smooth, preview = np.zeros((3, 0)), steps_ahead(known)
    if acceleration_is_derived(known.options):
        smooth = second_difference(smoothing_steps(known.options, names), dt)
        gains, left = np.tile(np.eye(2), (n, 1, 1)), derived_noise(known.options, names)[:2]
    late = smooth.shape[1] // 2

    deformation = spring_deformations(known)
    to_springs = np.linalg.inv(deformation.T)

    forces = to_springs**2 @ noise[3] ** 2 + (to_springs @ known.mass) ** 2 @ noise[2] ** 2
    white, deformed = np.sqrt(forces), np.sqrt(deformation**2 @ left.T**2)
    alike = 2.0 / gains[:, 0, 0].min() - 1.0  # the noise after the observer is correlated
    own = known.mass, known.damping, known.stiffness
    beside = computed.mass, computed.damping, computed.stiffness
    padded = (np.pad(one, (0, computed.internal)) for one in own)
    mass, damping, stiffness = (one + more for one, more in zip(padded, beside, strict=True))
    inverse = np.linalg.inv(mass)
    line = None if computed.model is None else ModelLine(computed, inverse, dt)
    none, one = np.zeros((size, size)), np.eye(size)
    a = np.block([[none, one], [-inverse @ stiffness, -inverse @ damping]])
    b = np.vstack([none, one])
    substeps = max(1, math.ceil(dt / LONGEST_SUBSTEP - 1e-9))
    free, start, change = first_order_hold(a, b, dt / substeps)
    by_spring = np.ascontiguousarray(inverse[:, :n] @ deformation.T)
    mass_of, damping_of, stiffness_of = (to_springs @ one @ to_springs.T for one in own)
    frequency = np.sqrt(np.abs(np.diag(deformation @ by_spring[:n]) * np.diag(stiffness_of)))
    axes, dofs = places(n, size)
    of_springs = mass_of, damping_of, stiffness_of, white, deformed, alike
    model, model_state = model_arrays(axes, *of_springs, frequency, dt)
    hold = np.ascontiguousarray(np.hstack([free, start]))
    deforming = deformation @ (hold[:n] - np.eye(n, 3 * size))
    accelerations = a[size : size + n]
    future = _of_prediction(known, deformation, by_spring, accelerations, hold, change, deforming)
    steady, force, rise, correction = future
    squares = np.linalg.eigvals(inverse @ stiffness).real
    parameters = TargetParameters(
        axes=axes,
        dofs=dofs,
        dt=dt,
        substeps=substeps,
        gains=gains,
        by_force=np.linalg.inv(known.mass),
        stepping=steps_of_force(known.options, known.late, dt),
        smooth=smooth,
        mass=np.ascontiguousarray(known.mass, dtype=np.float64),
        deformation=np.ascontiguousarray(deformation),
        to_springs=np.ascontiguousarray(to_springs),
        hold=hold,
        change=np.ascontiguousarray(change),
        deforming=deforming,
        steady=steady,
        force=force,
        influence=computed.by_axis,
        by_spring=by_spring,
        by_assumed=inverse[:, :n] @ np.hstack([known.stiffness, known.damping]),
        damper=2.0 * math.sqrt(max(float(squares.min()), 0.0)),  # critical for the slowest mode
        model=model,
    )
    sizes = {"n": n, "2n": 2 * n, "N": size, "2N": 2 * size, "3N": 3 * size, "s": len(steady)}
    sizes |= {"w": smooth.shape[1], "late": late, "ahead": late + 1 + preview}
    given = {"model": model_state, "rise": rise, "correction": correction, "force": force.copy()}
    given["line"] = np.zeros((0, 2 * size + 2)) if line is None else line.values
    state = zeros(TargetState, sizes | {"3N + n": 3 * size + n}, **given)
    return parameters, state, line


def _of_prediction(
    known: MethodInputs,
    deformation: Floats,
    by_spring: Floats,
    accelerations: Floats,
    hold: Floats,
    change: Floats,
    deforming: Floats,
) -> tuple[Floats, Floats, Floats, Floats]:
    """Constants of `predict`, transposed: parts of G and F, of the push's change and its effect."""
    n, size = known.axes, len(by_spring)
    ground, sliders = slice(3 * size, 3 * size + n), slice(3 * size + n + 1, None)  # 1 between them
    columns, results = 3 * size + 2 * n + 1, 3 * size + n
    steady, force = np.zeros((columns, results)), np.zeros((columns, n))
    stays = np.vstack([hold, np.eye(size, 3 * size, 2 * size)])
    steady[: 3 * size] = np.vstack([stays, deforming @ stays]).T
    force[: 3 * size] = (known.mass @ np.hstack([accelerations, np.eye(n, size)])).T
    force[sliders] = deformation
    rise, correction = np.zeros((size, columns)), np.zeros((size, results))
    rise[:, ground], rise[:, sliders] = -known.computed.by_axis, -by_spring
    correction[:, : 2 * size] = change.T
    return steady, force, rise, correction


def spring_deformations(known: MethodInputs) -> Floats:
    """Deformations in which the specimen's springs are not coupled, shape (n, n).

    They are those of the assumed springs, if these determine the displacements and the stiffness
    couples them by no more than it is uncertain (an identified one always does a little); otherwise
    the modal displacements of the elastic specimen, each in m of the axis that moves most.
    """
    springs = known.springs
    if springs is not None and np.linalg.matrix_rank(springs) == len(springs) == known.axes:
        own = np.linalg.solve(springs.T, np.linalg.solve(springs.T, known.stiffness).T)
        size = np.sqrt(np.abs(np.diag(own)))
        coupling = np.abs(own - np.diag(np.diag(own)))
        if (coupling <= UNCERTAIN_STIFFNESS * np.outer(size, size)).all():
            return springs
    _, modes = eigh(known.stiffness, known.mass)
    return np.linalg.inv(modes / np.abs(modes).max(axis=0))
