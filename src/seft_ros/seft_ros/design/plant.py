"""The plant of the force loop, in continuous time and sampled; its poles and zeros."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
from scipy.linalg import eigvals
from seft_msgs_py.arrays import Complexes, Floats
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.config.facts import FORCE_DRIVEN, POSITION_SERVO
from seft_msgs_py.errors import InputError
from seft_plant_sim import lti
from seft_plant_sim.calibration import as_published
from seft_plant_sim.channels import ACCELERATION, FORCE
from seft_plant_sim.judge.known_rig import known_actuators, known_responses
from seft_plant_sim.rig_parameters import common_lag
from seft_plant_sim.simulated.actuator import Hydraulics
from seft_plant_sim.simulated.continuous_model import (
    ContinuousModel,
    delayed_force,
    imposed_motion,
    servo_hydraulic,
)
from seft_plant_sim.simulated.rig import continuous_model
from seft_plant_sim.simulated.specimen import Specimen
from seft_plant_sim.whole_structure import is_simulated, tested_specimen

LIGHTLY_DAMPED = 0.5
"""Damping ratio up to which a pair counts as lightly damped: it shows in the magnitude."""

_CANCELLED = 0.01  # distance of a pole and a zero, over the decay rate, that nobody sees


@dataclass(frozen=True)
class Root:
    """A real pole or zero, or a conjugate pair of them.

    Attributes
    ----------
    hz : float
        Natural frequency of a pair, corner frequency of a real one (0: at the origin), Hz;
        negative for a real one in the right half-plane.
    damping : float or None
        Damping ratio of a pair; None: it is real.
    """

    hz: float
    damping: float | None = None


def roots_of(values: npt.ArrayLike) -> list[Root]:
    """Poles or zeros given in rad/s, complex; lowest first."""
    values = np.asarray(values, dtype=np.complex128)
    # an imaginary part from rounding makes no pair
    real = np.abs(values.imag) <= 1e-9 * np.abs(values)
    found = [Root(float(-value.real / (2 * np.pi)) or 0.0) for value in values[real]]
    for value in values[~real & (values.imag > 0)]:
        damping = round(float(-value.real / abs(value)), 12) or 0.0  # no -1e-17 of an undamped one
        found.append(Root(float(abs(value) / (2 * np.pi)), damping))
    return sorted(found, key=lambda root: abs(root.hz))


def lightly_damped(roots: Iterable[Root]) -> list[Root]:
    """Pairs in the left half-plane, or on its edge, that are lightly damped; same order."""
    return [r for r in roots if r.damping is not None and 0 <= r.damping <= LIGHTLY_DAMPED]


def uncancelled(roots: Complexes, others: Complexes) -> Complexes:
    """Poles (or zeros) in rad/s that no zero (or pole) cancels."""
    kept, others = [], others[np.isfinite(others)]
    for root in roots[np.isfinite(roots)]:
        near = np.abs(others - root) <= _CANCELLED * abs(root.real) + 1e-9 * abs(root)
        if near.any():
            others = np.delete(others, near.argmax())
        else:
            kept.append(root)
    return np.array(kept, dtype=np.complex128)


MAX_DELAY_STEPS = 500
"""Longest dead time in samples: the closed loop's eigenvalues are still found in a second."""


@dataclass(frozen=True)
class Plant:
    """Valves to actuator forces of n axes: z' = a z + b u(t - delay), f = c z + d u(t - delay).

    Attributes
    ----------
    source : str
        ``rig``: the simulated rig's linear model; ``identified``: fitted to measured data.
    a, b, c, d : ndarray
        Shapes (s, s), (s, n), (n, s), (n, n); u in V, f in N.
    delay : float
        Dead time, s.
    late : ndarray
        Lag of the sensor of each output, s.
    """

    source: Literal["rig", "identified"]
    a: Floats
    b: Floats
    c: Floats
    d: Floats
    delay: float
    late: Floats

    @classmethod
    def of_model(
        cls, source: Literal["rig", "identified"], model: ContinuousModel, motion: bool = False
    ) -> "Plant":
        """Make it of actuators and specimen, to the forces or, with motion, to (x, v, a, f).

        The dead time is that of the slowest actuator.
        """
        first, shown, delay = 0 if motion else 3 * model.b.shape[1], model.shown, model.delay.max()
        outputs = shown.c[first:], shown.d[first:], float(delay), shown.late[first:]
        return cls(source, model.a, model.b, *outputs).without_idle_states()

    def axis(self, index: int) -> "Plant":
        """Plant of one axis alone, the valves of the others closed."""
        one = slice(index, index + 1)
        own = replace(self, b=self.b[:, one], c=self.c[one], d=self.d[one, one])
        return replace(own, late=self.late[one]).without_idle_states()

    def without_idle_states(self) -> "Plant":
        """Remove states that no valve reaches or no output shows, as those of idle springs."""
        links = self.a != 0
        reached, shown = self.b.any(axis=1), self.c.any(axis=0)
        for _ in self.a:
            reached, shown = reached | links @ reached, shown | shown @ links
        kept = np.flatnonzero(reached & shown)
        return replace(self, a=self.a[np.ix_(kept, kept)], b=self.b[kept], c=self.c[:, kept])

    def response(self, frequencies_hz: Floats) -> Complexes:
        """Frequency response H_fu(jw) of the first axis, shape (N,), N/V."""
        s = np.asarray(2j * np.pi * frequencies_hz, dtype=np.complex128)
        forces = lti.state_space_response(self.a, self.b, self.c, self.d, s)
        return forces[:, 0, 0] * np.exp(-s * (self.delay + self.late[0]))

    def sampled(self, dt: float) -> tuple[Floats, Floats, Floats]:
        """Sample the plant exactly: zero-order hold, dead time and the loop's step of latency.

        The drive u_k answers sample k and holds from step k+1 on; the dead time is m whole samples
        and a remainder, during which the drive before still acts.

        Returns
        -------
        a, b, c : ndarray
            State space from u_k to the outputs of sample k. The states are those of the plant,
            then the drives of the last m + 2 samples, newest first, and what sensors have read that
            are late.

        Raises
        ------
        InputError
            If the dead time is many samples long.
        """
        whole, remainder = lti.split_dead_time(self.delay, dt)
        if whole > MAX_DELAY_STEPS:
            found = f"is {whole} samples long, but at most {MAX_DELAY_STEPS} are allowed"
            raise InputError(f"the plant's dead time of {self.delay:g} s {found}")
        early, forced_early, _ = lti.first_order_hold(self.a, self.b, remainder)
        late, forced_late, _ = lti.first_order_hold(self.a, self.b, dt - remainder)
        size, n = self.b.shape
        line = (whole + 2) * n
        a = np.zeros((size + line, size + line))
        a[:size, :size] = late @ early
        a[:size, -2 * n :] = np.hstack([forced_late, late @ forced_early])
        a[size + n :, size:-n] = np.eye(line - n)
        b = np.eye(size + line, n, k=-size)
        c = np.zeros((len(self.c), size + line))
        c[:, :size] = self.c
        newest = size + (whole + (remainder > 0)) * n
        c[:, newest : newest + n] = self.d
        return self._behind_lags(a, b, c, remainder, dt) if self.late.any() else (a, b, c)

    def _behind_lags(
        self, a: Floats, b: Floats, c: Floats, remainder: float, dt: float
    ) -> tuple[Floats, Floats, Floats]:
        """Put the lags behind a sampled plant; its drive changes ``remainder`` s after a sample."""
        (size, n), known = self.b.shape, len(a)
        rows, lines = [], []
        for row, late in enumerate(self.late.tolist()):
            whole, part = lti.split_dead_time(late, dt)
            after = dt - part  # of the sample before: the time at which the sensor is read
            old, new = slice(known - n, known), slice(known - 2 * n, known - n)
            state, drive = np.eye(size, known), old
            for begin, end, acts in ((0.0, remainder, old), (remainder, dt, new)):
                if part and begin <= after:
                    free, forced, _ = lti.first_order_hold(self.a, self.b, min(after, end) - begin)
                    state, drive = free @ state, acts
                    state[:, acts] += forced
            read = self.c[row] @ state if part else c[row].copy()
            read[drive] += self.d[row] if part else 0.0
            rows.append(read)
            lines.append(whole + (part > 0))
        more = sum(lines)
        a = np.block([[a, np.zeros((known, more))], [np.zeros((more, known + more))]])
        b = np.vstack([b, np.zeros((more, n))])
        c = np.hstack([c, np.zeros((len(c), more))])
        first = known
        for row, (read, line) in enumerate(zip(rows, lines, strict=True)):
            if line:
                a[first, :known] = read
                a[first + 1 : first + line, first : first + line - 1] = np.eye(line - 1)
                c[row] = np.eye(1, known + more, first + line - 1)
                first += line
        return a, b, c

    def sampled_response(self, frequencies_hz: Floats, dt: float) -> Complexes:
        """Frequency response of the first axis as `sampled`, from u_k to f_k, shape (N,), N/V."""
        whole, remainder = lti.split_dead_time(self.delay, dt)
        a, b, c = replace(self, delay=remainder).sampled(dt)
        z = np.exp(2j * np.pi * frequencies_hz * dt)
        forces = lti.state_space_response(a, b, c, np.zeros_like(self.d), z)
        return forces[:, 0, 0] * z ** -float(whole)

    @cached_property
    def roots(self) -> tuple[list[Root], list[Root]]:
        """Poles and zeros of the first axis, without those that cancel, lowest first."""
        first = self.axis(0)
        poles, size = np.linalg.eigvals(first.a).astype(np.complex128), len(first.a)
        system = np.block([[first.a, first.b], [first.c, first.d]])
        zeros = eigvals(system, np.diag([1.0] * size + [0.0]))  # transmission zeros
        return roots_of(uncancelled(poles, zeros)), roots_of(uncancelled(zeros, poles))

    def antiresonance(self) -> Root | None:
        """Lowest lightly damped zero: the natural frequency of the specimen.

        It is a zero by control-structure interaction (Dyke et al. 1995).
        """
        return next(iter(lightly_damped(self.roots[1])), None)

    def oil_column(self) -> Root | None:
        """Lightly damped pole above that zero at which the gain of the plant is largest."""
        zero = self.antiresonance()
        above = [p for p in lightly_damped(self.roots[0]) if zero is None or p.hz > zero.hz]
        peaks = np.abs(self.response(np.array([pole.hz for pole in above])))
        return above[int(peaks.argmax())] if above else None


FOLDED = 0.2
"""Part of what held commands fold down (`held_relations`) that is not known: it goes with the
square of a valve's frequency, which is known to a tenth."""

_IMAGES = np.arange(-20, 21)  # of a motion in held commands: they fall with the fourth power


def held_relations(
    plant: Plant, frequencies_hz: Floats, dt: float, lag: Floats, filters: tuple[Floats, Floats]
) -> tuple[Complexes, Floats]:
    """Velocity and acceleration of a rig whose channels agree, over the derivatives of x.

    They differ from 1 because a command is held over a period: its images at f + k / dt are in the
    samples, too, as far as the plant and a channel pass them. In the acceleration that is 0.1 % at
    500 Hz and 0.8 % at 250 Hz with a valve of 70 Hz and an oil column of 90 Hz. The force shows as
    much of them as inertia has, unless its channel passes them otherwise than the accelerometer.

    Parameters
    ----------
    plant : Plant
        To (x, v, a, f) of n axes, without lags.
    frequencies_hz : ndarray
        Of the motion, shape (m,).
    dt : float
        Sampling period, s.
    lag : ndarray
        Of each channel, shape (4, n), s, to which they are aligned after sampling.
    filters : tuple of ndarray
        p (s) and q (s^2) of each channel's filter, (4, n) each, see
        `seft_plant_sim.rig_parameters.filter_of`.

    Returns
    -------
    relations : ndarray
        Of each axis that moves by its own drive, shape (m, 2, n).
    unsure : ndarray
        What is not known of them, shape (m, 3, n): a lag may be that of a filter, and see `FOLDED`;
        and of the mass, kg: what the force shows of images beyond those that inertia does.
    """
    n, own = plant.b.shape[1], 2j * np.pi * np.asarray(frequencies_hz)[:, np.newaxis]
    s = own + 2j * np.pi * _IMAGES / dt
    response = lti.state_space_response(plant.a, plant.b, plant.c, plant.d, s.ravel())
    held = np.einsum("mcii->mci", response.reshape(-1, 4, n, n)).reshape(*s.shape, 4, n)
    s, own = (each[..., np.newaxis, np.newaxis] for each in (s, own))
    held = held * np.exp(-s * plant.delay) / s

    def relations(wait: Floats, p: Floats, q: Floats) -> Complexes:
        passed = np.exp((own - s) * wait) * (1 + own * (p + own * q)) / (1 + s * (p + s * q))
        x, v, acceleration, force = np.moveaxis((held * passed).sum(axis=1), 1, 0)
        first, like = own[:, 0, 0], (held[:, :, FORCE] * passed[:, :, ACCELERATION]).sum(axis=1)
        moved = first * first * x
        return np.stack([v / (first * x), acceleration / moved, (force - like) / moved], axis=1)

    p, q = filters
    found = relations(lag, p, q)
    filtered = relations(np.zeros_like(lag), p + lag, q + 0.5 * lag**2)
    unsure = np.abs(found - filtered) + FOLDED * np.abs(found - 1.0)
    unsure[:, 2] = np.abs(found[:, 2])
    return found[:, :2], unsure


def rig_model(
    experiment: Experiment, stiffness: float = 1.0
) -> tuple[Literal["rig", "identified"], ContinuousModel]:
    """Model of an experiment's rig: the simulated one or, where there is none, that of the facts.

    ``stiffness`` is a factor on that of the specimen. An InputError says if sizes do not fit the
    axes, or the actuators are not known.
    """
    if is_simulated(experiment):
        return "rig", simulated_rig(experiment, stiffness)
    section, axes = experiment["force_controller"], experiment.axes
    specimen = tested_specimen(experiment)
    specimen = replace(specimen, stiffness=stiffness * specimen.stiffness)
    if section["actuator.kind"] in FORCE_DRIVEN:
        delay = section["actuator.delay"] + common_lag(section)
        return "identified", delayed_force(specimen, delay)
    if section["actuator.kind"] == POSITION_SERVO:
        servos, late = known_responses(section, axes, range(len(axes))), common_lag(section)
        servos = [replace(each, dead_time=each.dead_time + late) for each in servos]
        return "identified", imposed_motion(specimen, servos, np.full(len(axes), np.inf))
    return "identified", small_signal(specimen, **known_actuators(section, axes, range(len(axes))))


def simulated_rig(experiment: Experiment, stiffness: float = 1.0) -> ContinuousModel:
    """Make the simulated rig of an experiment, to the state that it publishes.

    ``stiffness`` is a factor on that of the specimen. The velocity is the measured one; an
    InputError says if sizes do not fit the axes.
    """
    section, axes = experiment["rig"], experiment.axes
    return as_published(continuous_model(section, axes, stiffness=stiffness), section, axes)


def small_signal(specimen: Specimen, **actuators: Any) -> ContinuousModel:
    """Linear model of servo-hydraulic actuators on a specimen, from some `Hydraulics` values."""
    one = np.ones(specimen.axes)
    ideal: dict[str, Any] = {
        **dict.fromkeys(("rated_voltage", "force_capacity", "stroke"), np.inf * one),
        **dict.fromkeys(("friction", "viscous_friction"), 0.0 * one),
        "friction_velocity": one,
    }
    return servo_hydraulic(specimen, Hydraulics(**ideal | actuators), linear=True)
