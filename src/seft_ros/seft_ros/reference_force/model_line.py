"""The force of a computed model on the target: a line through what the model gave last.

The model is asked after a sample, at the target's motion there, and its force g is followed from
there on as a line over displacement, velocity and time::

    g(x, v, t) = g_n + K (x - x_n) + C (v - v_n) + (t - t_n) g'

K and C are its tangents as it tells them, or as they were at rest, and g' makes the line before
this one right where this one begins. If the force depends on displacements alone, K does that
instead, by Broyden's update (1965). What the line before had missed is made good by an impulse, so
that the impulse of g is that of the trapezoidal rule.
"""

from collections import deque

import numpy as np
from seft_msgs_py.config.parameter_table import Floats
from seft_plant_sim.computed_model import ComputedModel, ModelError
from seft_plant_sim.computed_substructure import ComputedSubstructure

from seft_ros.reference_force.reference_force_parameters import OF_MODEL

LEAST_MOTION = 1e-9  # m: rounding makes the tangent of less
STIFFEST = 0.25
"""Of a followed tangent over the mass, times dt squared: the prediction is stable up to there."""


class ModelLine:
    """Follows a computed model, one sample after the other.

    Parameters
    ----------
    computed : ComputedSubstructure
        With a model, which is made when it is first needed: the linear loops that preflight looks
        at do without.
    inverse : ndarray
        Of the whole mass, shape (N, N), 1/kg.
    dt : float
        Sampling period, s.

    Attributes
    ----------
    values : ndarray
        Acceleration by displacement and velocity, by 1, and its rate, shape (N, 2N + 2): of what
        the force differs from that of the tangents at rest. Time begins at the last sample.
    force : ndarray
        Of the model at the last sample, shape (N,), N.
    """

    def __init__(self, computed: ComputedSubstructure, inverse: Floats, dt: float) -> None:
        assert computed.model is not None
        size = len(inverse)
        self._source, self._inverse, self._dt = computed.model, inverse, dt
        self._every = computed.model.every
        self._by_axis = computed.model.influence
        self._made: ComputedModel | None = None
        self._rest = np.hstack(computed.model.tangents)
        self.values = np.zeros((size, 2 * size + 2))
        self.force = np.zeros(size)
        self.reset()

    def reset(self) -> None:
        """Begin a new test."""
        self._is_started = False
        self.values[:], self.force[:] = 0.0, 0.0
        self._count = 0
        self._asked: deque[Floats] = deque()
        self._line = np.zeros_like(self.values)  # that of the last answer, from there on
        self._at: Floats | None = None  # which was this motion
        self._tangent = self._source.own_tangents[0]  # of the model's own axes, followed
        self._own = np.zeros(0), np.zeros(0)  # their displacement and force

    def step(self, motion: Floats, ground: Floats) -> None:
        """Take in a sample of the target.

        Parameters
        ----------
        motion : ndarray
            Displacements, then velocities, shape (2N,); they get the impulse that was missed.
        ground : ndarray
            Ground acceleration of the axes, shape (n,), m/s^2.

        Raises
        ------
        ModelError
            If the model fails.
        """
        model, count, size = self._model(), self._count, len(self.force)
        self._count += 1
        self.values[:, -2] += self._dt * self.values[:, -1]  # the time begins here
        turn = count % self._every
        if turn == 0:
            x, v = motion[:size].copy(), motion[size:].copy()
            now = count * self._dt, x, v, self._by_axis @ ground
            self._asked.append(motion.copy())
            if self._every > 1 and model.is_apart:
                model.ask(*now)
            else:
                self._take(model.step(*now), motion, 0)
        if turn == self._every - 1 and self._asked:
            self._take(model.answer(), motion, turn)

    def _model(self) -> ComputedModel:
        """Give the model, in the test that has begun."""
        if self._made is None:
            self._made = self._source.make()
        if not self._is_started:
            self._made.start(self._every * self._dt)
            self._is_started = True
        return self._made

    def _take(self, force: Floats, motion: Floats, late: int) -> None:
        """Draw the new line, and mend the motion; the force is that ``late`` samples ago."""
        at, size, span = self._asked.popleft(), len(force), self._every * self._dt
        acts = -self._inverse @ (force - self._rest @ at)
        line, before = np.zeros_like(self._line), self._line
        follows, told = self._source.is_static, self._model().tangents()
        for part, tangent in zip((slice(size), slice(size, 2 * size)), told, strict=True):
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
            # it grew in proportion to the time, from when the line came into use until now
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
        """Follow the force of a static model; give accelerations per displacement, (N, N)."""
        size, rows = len(force), self._model().rows
        own, own_force = rows @ at[:size], np.linalg.lstsq(rows.T, force, rcond=None)[0]
        own_force = own_force - self._source.own_tangents[1] @ (rows @ at[size:])
        if self._at is not None:
            before, force_before = self._own
            moved = own - before
            span = float(moved @ moved)
            if span > LEAST_MOTION**2:
                missed = own_force - force_before - self._tangent @ moved
                self._tangent = self._tangent + np.outer(missed, moved) / span
        self._own = own, own_force
        stiffness = rows.T @ self._tangent @ rows
        beside = self._inverse @ (stiffness - self._rest[:, :size])
        largest = STIFFEST / self._dt**2
        beside *= min(1.0, largest / max(float(np.linalg.norm(beside)), largest))
        return beside

    def failure_of(self, error: ModelError) -> str:
        """Say what has failed, and when."""
        return f"{error} (step {self._count - 1})"

    def recorded(self, axes: int) -> dict[str, Floats]:
        """Give the model's motion and force, and what else it tells; shape (n,) each.

        What belongs to no axis stands at each of them.
        """
        size, source, model = len(self.force), self._source, self._model()
        at = np.zeros(size) if self._at is None else self._at[:size]
        force = np.linalg.lstsq(model.rows.T, self.force, rcond=None)[0]
        found: dict[str, Floats] = {}
        for kind, values in (("displacement", model.rows @ at), ("force", force)):
            for place, value in zip(model.places, values.tolist(), strict=True):
                name = f"{OF_MODEL}{kind}"
                if place < axes:
                    found.setdefault(name, np.zeros(axes))[place] = value
                else:
                    found[f"{name}, {source.dofs[place]}"] = np.full(axes, value)
        told = model.responses()
        return found | {f"{OF_MODEL}{name}": np.full(axes, value) for name, value in told.items()}
