"""Actuator and specimen between samples: a linear model, nonlinear residuals, their integration.

The ideal and the pure-delay actuator represent an actuator with its force servo loop, as in the
paper's Eq. 5.2: they are driven by the reference force. The servo-hydraulic actuator is driven by
its valve, so that the loop closes over the controller.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Literal, NamedTuple

import numpy as np
from seft_msgs_py.arrays import Floats, Ints, clear, zeros
from seft_msgs_py.errors import InputError

from seft_plant_sim.compiled import compiled, multiply
from seft_plant_sim.lti import TransferFunction, first_order_hold
from seft_plant_sim.simulated import actuator, springs
from seft_plant_sim.simulated.actuator import Hydraulics, InnerLoop
from seft_plant_sim.simulated.specimen import Specimen

Drive = Literal["valve_command", "reference_force"]


@dataclass(frozen=True)
class Sensed:
    """What sensors show of a model, c z + d w + h r some time ago; with their filters.

    Attributes
    ----------
    c, d, outputs : ndarray
        Shapes (4n, s), (4n, n) and (4n, r).
    late : ndarray
        Lag of each, shape (4n,), s.
    """

    c: Floats
    d: Floats
    outputs: Floats
    late: Floats


@dataclass(frozen=True)
class ContinuousModel:
    """Actuator and specimen: z' = a z + b w + g r(z), y = c z + d w + h r(z).

    w is the delayed drive, and y contains displacement (m), velocity (m/s), acceleration (m/s^2)
    and force (N), each over the n axes. The residuals r are those of pistons, then those of
    springs; without them, this is the small-signal limit. The states begin with x and v; with
    pistons they begin with x, v, the oil's force p and the valve's opening w.

    Attributes
    ----------
    a, b, c, d : ndarray
        Shapes (s, s), (s, n), (4n, s), (4n, n).
    delay : ndarray
        Dead time of each drive, shape (n,), s.
    drive : str
        ``valve_command`` (V) or ``reference_force`` (N).
    inputs, outputs : ndarray
        g and h, shapes (s, r) and (4n, r). The residuals are, for each piston, the valve's
        effective opening minus its opening (V); for each piston, the force of friction and stops
        (N); for each spring, its force minus the elastic one (N).
    pistons : ndarray
        `piston_rows`; none if the actuators are linear.
    springs : tuple of Spring
        p of them.
    deformation : ndarray
        Of the springs per displacement of each axis, shape (p, n).
    drive_limit : ndarray
        Drive at which the actuators saturate, shape (n,).
    sensed : Sensed, optional
        What its sensors show; default y.
    """

    a: Floats
    b: Floats
    c: Floats
    d: Floats
    delay: Floats
    drive: Drive
    inputs: Floats
    outputs: Floats
    pistons: Floats
    springs: tuple[springs.Spring, ...]
    deformation: Floats
    drive_limit: Floats
    sensed: Sensed | None = None

    @classmethod
    def linear(
        cls, a: Floats, b: Floats, c: Floats, d: Floats, delay: Floats | float, drive: Drive
    ) -> "ContinuousModel":
        """Make a model without residuals."""
        n = b.shape[1]
        residuals = (
            np.zeros((len(a), 0)),
            np.zeros((len(c), 0)),
            np.zeros((0, actuator.COLUMNS)),
            (),
        )
        delays = np.broadcast_to(np.asarray(delay, dtype=np.float64), n)
        return cls(a, b, c, d, delays, drive, *residuals, np.zeros((0, n)), np.full(n, np.inf))

    @property
    def is_linear(self) -> bool:
        """Whether there are no residuals."""
        return not (len(self.pistons) or self.springs)

    @property
    def shown(self) -> Sensed:
        """What is seen of it: what its sensors show, or else y."""
        return self.sensed or Sensed(self.c, self.d, self.outputs, np.zeros(len(self.c)))


def with_springs(
    model: ContinuousModel, specimen: Specimen, *, imposed: bool = False
) -> ContinuousModel:
    """Add the springs' residuals to a model whose first states are x and v.

    They change the acceleration or, where the motion is imposed, the force.
    """
    n, p = specimen.axes, len(specimen.springs)
    if not p:
        return model
    inputs, outputs = np.zeros((len(model.a), p)), np.zeros((4 * n, p))
    if imposed:
        outputs[3 * n :] = specimen.deformation.T
    else:
        accelerations = -np.linalg.solve(specimen.mass, specimen.deformation.T)
        inputs[n : 2 * n] = outputs[2 * n : 3 * n] = accelerations
    return replace(
        model,
        inputs=np.hstack([model.inputs, inputs]),
        outputs=np.hstack([model.outputs, outputs]),
        springs=specimen.springs,
        deformation=specimen.deformation,
    )


def delayed_force(specimen: Specimen, delay: float) -> ContinuousModel:
    """Actuator that applies the reference force after a pure delay: f(t) = f_r(t - delay).

    The paper's Eq. 5.2; a delay of 0 is the ideal actuator.
    """
    n = specimen.axes
    a, b = specimen.state_matrices()
    c = np.vstack([np.eye(2 * n), a[n:], np.zeros((n, 2 * n))])
    d = np.vstack([np.zeros((2 * n, n)), b[n:], np.eye(n)])
    return with_springs(ContinuousModel.linear(a, b, c, d, delay, "reference_force"), specimen)


def imposed_motion(
    specimen: Specimen, responses: Sequence[TransferFunction], stroke: Floats
) -> ContinuousModel:
    """Displacement servos that the load does not move: x = G u, f = M x'' + C x' + K x + springs.

    The states are x, x' and the higher derivatives of each axis, of which the last follows from the
    poles; a command changes each by G's expansion in 1/s (observability canonical form).

    Parameters
    ----------
    specimen : Specimen
        n axes.
    responses : sequence of TransferFunction
        G of each axis, from command to displacement.
    stroke : ndarray
        Largest displacement that can be commanded, shape (n,), m.

    Raises
    ------
    InputError
        If a command would change a velocity at once.
    """
    n, orders = specimen.axes, [len(each.denominator) - 1 for each in responses]
    if any(len(g.numerator) > m - 1 for g, m in zip(responses, orders, strict=True)):
        raise InputError(
            "/**: actuator.response must have two poles more than zeros: without, a command would "
            "change the velocity at once"
        )
    size = sum(orders)
    a, b, first = np.zeros((size, size)), np.zeros((size, n)), 2 * n
    for i, (g, m) in enumerate(zip(responses, orders, strict=True)):
        unit = (g.denominator[-1] / g.denominator[0]) ** (1.0 / m)  # rad/s, for even sizes
        powers = g.denominator[0] * unit ** np.arange(m + 1)
        poles = np.array(g.denominator) / powers
        expansion = np.pad(g.numerator, (m + 1 - len(g.numerator), 0)) / powers
        for k in range(1, m + 1):
            expansion[k] -= poles[k:0:-1] @ expansion[:k]
        chain, scale = unit * np.eye(m, k=1), np.array([1.0, *[unit] * (m - 1)])
        chain[-1] = -unit * poles[:0:-1]
        own = [i, n + i, *range(first, first + m - 2)]
        a[np.ix_(own, own)] = chain * scale[:, np.newaxis] / scale
        b[own, i] = unit * scale * expansion[1:]
        first += m - 2
    motion, velocity = np.eye(2 * n, size), slice(n, 2 * n)
    c = np.vstack([motion, a[velocity], specimen.mass @ a[velocity]])
    c[3 * n :] += np.hstack([specimen.stiffness, specimen.damping]) @ motion
    d = np.vstack([np.zeros((2 * n, n)), b[velocity], specimen.mass @ b[velocity]])
    late = np.array([each.dead_time for each in responses])
    model = replace(ContinuousModel.linear(a, b, c, d, late, "valve_command"), drive_limit=stroke)
    return with_springs(model, specimen, imposed=True)


def servo_hydraulic(
    specimen: Specimen, hydraulics: Hydraulics, *, linear: bool = False
) -> ContinuousModel:
    """Servo-hydraulic actuator acting against the specimen.

    With the oil's force p, the valve opening w (in V), its rate w', the piston's velocity v and
    the force f on the specimen, which is what the load cell measures::

        p'  = k_oil (q g(w, p) - v) - lambda p
        w'' = wv^2 (u - w) - 2 zv wv w'
        f   = p - c_p v - friction(v) - stop(x, v)

    The piston moves with the specimen, so the specimen's poles are the zeros of the
    valve-to-force response (control-structure interaction, Dyke et al. 1995). The valve's flow
    g(w, p) = w sqrt(1 - sgn(w) p / F_s) is zero at the force at supply pressure; drive and opening
    are limited to the fully open valve. For small p and without Coulomb friction this is the
    linear model with g = w.

    Parameters
    ----------
    specimen : Specimen
        n axes.
    hydraulics : Hydraulics
        Of the n actuators.
    linear : bool
        Whether the actuator is linearised: the small-signal limit.
    """
    n = specimen.axes
    a_specimen, b_specimen = specimen.state_matrices()
    by_force = b_specimen[n:]
    viscous = np.diag(hydraulics.viscous_friction)
    a_specimen[n:, n:] -= by_force @ viscous
    wv = 2 * np.pi * hydraulics.valve_frequency
    one = np.eye(n)
    oil = hydraulics.oil_stiffness
    flow = np.diag(oil * hydraulics.flow_gain)
    _, v, p, w, rate = (slice(first, first + n) for first in range(0, 5 * n, n))
    a, b = np.zeros((5 * n, 5 * n)), np.zeros((5 * n, n))
    a[: 2 * n, : 2 * n], a[: 2 * n, p] = a_specimen, b_specimen
    a[p, v], a[p, p], a[p, w] = -np.diag(oil), -np.diag(hydraulics.leakage), flow
    a[w, rate] = one
    a[rate, w], a[rate, rate] = -np.diag(wv**2), -np.diag(2 * hydraulics.valve_damping * wv)
    b[rate] = np.diag(wv**2)
    c, d = np.zeros((4 * n, 5 * n)), np.zeros((4 * n, n))
    c[: 2 * n, : 2 * n] = np.eye(2 * n)
    c[2 * n : 3 * n] = a[v]
    c[3 * n :, v], c[3 * n :, p] = -viscous, one
    model = ContinuousModel.linear(a, b, c, d, hydraulics.dead_time, "valve_command")
    if not linear:
        inputs, outputs = np.zeros((5 * n, 2 * n)), np.zeros((4 * n, 2 * n))
        inputs[v, n:], inputs[p, :n] = -by_force, flow
        outputs[2 * n : 3 * n, n:], outputs[3 * n :, n:] = -by_force, -one
        model = replace(
            model,
            drive_limit=hydraulics.rated_voltage,
            pistons=actuator.piston_rows(hydraulics, np.diag(specimen.mass)),
            inputs=inputs,
            outputs=outputs,
        )
    return with_springs(model, specimen)


def with_inner_loop(model: ContinuousModel, loop: InnerLoop, stroke: Floats) -> ContinuousModel:
    """Let a displacement controller drive the valves of a `servo_hydraulic` model of n axes.

    The drive u becomes a displacement in m. Two states are added to each axis, i' = e and
    d' = w_d (e - d): the filtered derivative is w_d (e - d).

    Parameters
    ----------
    model : ContinuousModel
        Whose drive is that of the valves.
    loop : InnerLoop
        Of the n axes.
    stroke : ndarray
        Largest displacement that can be commanded, shape (n,), m.
    """
    n, size = model.b.shape[1], len(model.a)
    w = 2 * np.pi * loop.derivative_filter
    x, p = slice(n), slice(2 * n, 3 * n)
    # drive of the valves per state and per command
    by_state = np.zeros((n, size + 2 * n))
    by_error = np.diag(loop.proportional + loop.derivative * w)
    by_state[:, x], by_state[:, p] = -by_error, -np.diag(loop.delta_p)
    by_state[:, size : size + n] = np.diag(loop.integral)
    by_state[:, size + n :] = -np.diag(loop.derivative * w)
    gain = np.diag(loop.gain)
    a, b = np.zeros((size + 2 * n, size + 2 * n)), np.zeros((size + 2 * n, n))
    a[:size, :size] = model.a
    a[:size] += model.b @ by_state
    a[size : size + n, x], a[size + n :, x] = -np.eye(n), -np.diag(w)
    a[size + n :, size + n :] = -np.diag(w)
    b[:size] = model.b @ by_error @ gain
    b[size : size + n], b[size + n :] = gain, np.diag(w) @ gain
    return replace(
        model,
        a=a,
        b=b,
        c=np.hstack([model.c, np.zeros((4 * n, 2 * n))]),
        inputs=np.vstack([model.inputs, np.zeros((2 * n, model.inputs.shape[1]))]),
        drive="valve_command",
        drive_limit=stroke,
    )


LONGEST_STEP = 5e-4  # s
STEP_TIMES_RATE = 0.5  # of the fastest residual
_MAX_STEPS = 500


class Dynamics(NamedTuple):
    """A `ContinuousModel` of n axes, s states and r residuals over stretches of time.

    Within a stretch the drive does not change. The stretch is integrated in equal steps by the
    exponential Runge-Kutta scheme ETD2RK (Cox & Matthews 2002, Eq. 22). The linear part, with the
    fast oil column and the valve, is solved exactly, so that a linear model needs one step.

    Attributes
    ----------
    predict : ndarray
        Shape (m, s + n + r, s): takes (z, drive, residuals) to the state after one step if the
        residuals stay as they are.
    correct : ndarray
        Shape (m, r, s): effect of a change of the residuals in the step.
    steps : ndarray
        Number of steps of each of the m stretches, shape (m,); 0 for a stretch of no time.
    period : ndarray
        Length of a step, shape (m,), s.
    output : ndarray
        Takes (z, drive, residuals) to the outputs, transposed, shape (s + n + r, 4n).
    pistons, laws, deformation : ndarray
        Of the model.
    """

    predict: Floats
    correct: Floats
    steps: Ints
    period: Floats
    output: Floats
    pistons: Floats
    laws: Floats
    deformation: Floats


class Motion(NamedTuple):
    """State of a model: arrays of zeros, but for ``supply`` and ``left``."""

    work: Annotated[Floats, "work"]  # state, drive and residuals, s + n + r
    springs: Annotated[Floats, "p", springs.SPRING_MEMORY]  # their memory
    supply: Annotated[Floats, "n"]  # pressure of each axis, over that without a fault
    left: Annotated[Floats, "p"]  # stiffness of each spring, likewise
    slipped: Annotated[Floats, "p"]  # deformation at which each spring has its zero, m
    state: Annotated[Floats, "s"]  # room for the next state, residuals and memories
    residuals: Annotated[Floats, "r"]
    trial: Annotated[Floats, "p", springs.SPRING_MEMORY]


def dynamics_of(model: ContinuousModel, lengths: Sequence[float], longest: float = 0.0) -> Dynamics:
    """Make it from a model, for stretches of time in s, in steps of at most ``longest`` s.

    0 means `LONGEST_STEP`.

    Raises
    ------
    InputError
        If a residual is too fast to be integrated.
    """
    fastest, longest = _fastest(model), longest or LONGEST_STEP
    if fastest * longest > STEP_TIMES_RATE:
        longest = STEP_TIMES_RATE / fastest
        if max(lengths) > _MAX_STEPS * longest:
            raise InputError(
                f"rig: friction, end stops or springs answer at {fastest:.3g} 1/s, too fast to be "
                "followed; raise actuator.friction_velocity, or check mass, oil_stiffness and "
                "springs"
            )
    stretches = (_stretch(model, time, longest) for time in lengths)
    predict, correct, steps, periods = zip(*stretches, strict=True)
    output = np.hstack([model.c, model.d, model.outputs]).T
    arrays = (output, model.pistons, _laws(model), model.deformation)
    by_stretch = np.array(predict), np.array(correct), np.array(steps, dtype=np.int64)
    return Dynamics(*by_stretch, np.array(periods), *map(np.ascontiguousarray, arrays))


def at_rest(dynamics: Dynamics) -> Motion:
    """Motion of a model that has not been driven."""
    (p, n), (_, r, s) = dynamics.deformation.shape, dynamics.correct.shape
    sizes = {"work": len(dynamics.output), "n": n, "p": p, "r": r, "s": s}
    motion = zeros(Motion, sizes)
    begin_motion(motion)
    return motion


def begin_motion(motion: Motion) -> None:
    """Set a motion to rest, without faults."""
    clear(motion)
    motion.supply[:] = motion.left[:] = 1.0


@compiled
def integrate(dynamics: Dynamics, stretch: int, motion: Motion) -> None:
    """Take a motion through one of the stretches, under the drive that is in it."""
    work, state, residuals = motion.work, motion.state, motion.residuals
    s, r = len(state), len(residuals)
    start = len(work) - r
    predict, correct = dynamics.predict[stretch], dynamics.correct[stretch]
    for half in range(2 * dynamics.steps[stretch]):
        memory = motion.springs
        if half % 2 == 0:  # the next state if the residuals did not change
            multiply(predict, work, state)
            memory = motion.trial
            for j in range(len(memory)):
                for i in range(springs.SPRING_MEMORY):
                    memory[j, i] = motion.springs[j, i]
        else:  # the next state with the residuals' change
            for j in range(r):
                change = residuals[j] - work[start + j]
                for i in range(s):
                    state[i] += correct[j, i] * change
        if r:
            _residuals(dynamics, dynamics.period[stretch], motion, memory)
        if half % 2:
            for i in range(s):
                work[i] = state[i]
            for j in range(r):
                work[start + j] = residuals[j]


@compiled
def _residuals(dynamics: Dynamics, period: float, motion: Motion, memory: Floats) -> None:
    """Find the residuals at the next state; springs that turn in the step go there first."""
    last, z, residuals = motion.work, motion.state, motion.residuals
    n, m = dynamics.deformation.shape[1], len(dynamics.pistons)
    for i in range(m):
        w, p = z[3 * n + i], z[2 * n + i]
        residuals[i] = actuator.lost_opening(dynamics.pistons, i, w, p, motion.supply[i])
        residuals[m + i] = actuator.holding_force(dynamics.pistons, i, z[i], z[n + i])
    for j in range(len(dynamics.laws)):
        e = v_0 = v_1 = 0.0
        for i in range(n):
            factor = dynamics.deformation[j, i]
            e += factor * z[i]
            v_0 += factor * last[n + i]
            v_1 += factor * z[n + i]
        if v_0 * v_1 < 0.0:  # it turns where the velocity, taken as linear, is 0
            turn = memory[j, 0] + 0.5 * period * v_0 * v_0 / (v_0 - v_1)
            springs.spring_force(dynamics.laws, j, memory, turn)
        force = springs.spring_force(dynamics.laws, j, memory, e - motion.slipped[j])
        force *= motion.left[j]
        residuals[2 * m + j] = force - dynamics.laws[j, springs.STIFFNESS] * e


def _laws(model: ContinuousModel) -> Floats:
    return np.array([spring.law for spring in model.springs]).reshape(-1, springs.WIDTH)


def _fastest(model: ContinuousModel) -> float:
    """Largest rate at which a residual responds to a state, 1/s: a step must be shorter."""
    rates = model.pistons[:, actuator.FASTEST].tolist()
    n, first = model.b.shape[1], 2 * len(model.pistons)
    for j, law in enumerate(_laws(model)):
        if law[springs.SPRING_KIND] in (springs.SLIDER, springs.SPRING_GAP, springs.ONE_SIDED):
            stiffer = law[springs.SPRING_BESIDE] + law[springs.HYSTERETIC] - law[springs.STIFFNESS]
            per_force = -model.deformation[j] @ model.inputs[n : 2 * n, first + j]
            rates.append(math.sqrt(max(0.0, stiffer * per_force)))
    return max(rates, default=0.0)


def _stretch(
    model: ContinuousModel, time: float, longest: float
) -> tuple[Floats, Floats, int, float]:
    """Give predict, correct, steps and period of a stretch."""
    steps = math.ceil(time / longest * (1 - 1e-9))
    if model.is_linear:
        steps = min(steps, 1)
    h = time / max(1, steps)
    free, start, change = first_order_hold(model.a, np.hstack([model.b, model.inputs]), h)
    residuals = change[:, model.b.shape[1] :]
    predict = np.ascontiguousarray(np.hstack([free, start]).T)
    return predict, np.ascontiguousarray(residuals.T), steps, h
