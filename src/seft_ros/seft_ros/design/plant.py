"""The plant of the force loop, in continuous time and sampled."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np
from scipy.linalg import block_diag
from seft_msgs_py.arrays import Complexes, Floats
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.errors import InputError
from seft_plant_sim import lti
from seft_plant_sim.actuator import Hydraulics
from seft_plant_sim.continuous_model import ContinuousModel, servo_hydraulic
from seft_plant_sim.rig import continuous_model
from seft_plant_sim.specimen import Specimen

from seft_ros.design import Source
from seft_ros.design.controller import Root, lightly_damped, roots_of, uncancelled


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
    """

    source: Literal["rig", "identified"]
    a: Floats
    b: Floats
    c: Floats
    d: Floats
    delay: float

    @classmethod
    def of_model(
        cls, source: Literal["rig", "identified"], model: ContinuousModel, motion: bool = False
    ) -> "Plant":
        """Make it of actuators and specimen, to the forces or, with motion, to (x, v, a, f)."""
        outputs = slice(0 if motion else 3 * model.b.shape[1], None)
        c, d = model.c[outputs], model.d[outputs]
        return cls(source, model.a, model.b, c, d, model.delay).without_idle_states()

    def axis(self, index: int) -> "Plant":
        """Plant of one axis alone, the valves of the others closed."""
        one = slice(index, index + 1)
        return replace(
            self, b=self.b[:, one], c=self.c[one], d=self.d[one, one]
        ).without_idle_states()

    def without_idle_states(self) -> "Plant":
        """Remove states that no valve reaches or no output shows, as those of idle springs."""
        links = self.a != 0
        reached, shown = self.b.any(axis=1), self.c.any(axis=0)
        for _ in self.a:
            reached, shown = reached | links @ reached, shown | shown @ links
        kept = np.flatnonzero(reached & shown)
        return replace(self, a=self.a[np.ix_(kept, kept)], b=self.b[kept], c=self.c[:, kept])

    def with_specimen(self, specimen: Specimen) -> "Plant":
        """Plant to (x, v, a, f), with the motion of the specimen that follows from the force."""
        n, size = specimen.axes, len(self.a)
        moving, by_force = specimen.state_matrices()
        a = np.block([[self.a, np.zeros((size, 2 * n))], [by_force @ self.c, moving]])
        b = np.vstack([self.b, by_force @ self.d])
        c = np.zeros((4 * n, size + 2 * n))
        c[: 2 * n, size:] = np.eye(2 * n)
        c[2 * n : 3 * n] = a[size + n :]
        c[3 * n :, :size] = self.c
        d = np.vstack([np.zeros((2 * n, n)), b[size + n :], self.d])
        return replace(self, a=a, b=b, c=c, d=d)

    def response(self, frequencies_hz: Floats) -> Complexes:
        """Frequency response H_fu(jw) of the first axis, shape (N,), N/V."""
        s = np.asarray(2j * np.pi * frequencies_hz, dtype=np.complex128)
        forces = lti.state_space_response(self.a, self.b, self.c, self.d, s)
        return forces[:, 0, 0] * np.exp(-s * self.delay)

    @cached_property
    def roots(self) -> tuple[list[Root], list[Root]]:
        """Poles and zeros of the first axis, without those that cancel, lowest first."""
        import control  # here: it takes a second

        first = self.axis(0)
        system = control.ss(first.a, first.b, first.c, first.d, remove_useless_states=False)
        poles, zeros = system.poles(), system.zeros()
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
        if not above:
            return None
        peaks = np.abs(self.response(np.array([pole.hz for pole in above])))
        return above[int(peaks.argmax())]


def choose_plant(experiment: Experiment, source: Source = Source.AUTO) -> Plant:
    """Plant of an experiment's `rig` or `force_controller`; InputError if there is none.

    The source ``auto`` is the identified plant if the experiment has one, else the rig.
    """
    identified = np.any(_numerator(experiment["force_controller"]))
    if source == "identified" and not identified:
        raise InputError(
            "force_controller: plant.numerator is not given, so there is no identified plant; "
            "let seft identify write one, or choose --plant rig if the rig is simulated"
        )
    if source == "rig" or not identified:
        return rig_plant(experiment["rig"], experiment.axes)
    return identified_plant(experiment["force_controller"], len(experiment.axes))


def rig_plant(section: dict[str, Any], axes: tuple[str, ...]) -> Plant:
    """Small-signal linear model of the simulated rig; InputError if no valve drives it."""
    model = continuous_model(section, axes)
    if model.drive != "valve_command":
        raise InputError(
            f"rig: actuator.kind is {section['actuator.kind']}, which has no valve to shape a loop "
            "for; set it to servo_hydraulic, or give an identified plant"
        )
    return Plant.of_model("rig", model)


def small_signal(specimen: Specimen, **actuators: Any) -> ContinuousModel:
    """Linear model of servo-hydraulic actuators on a specimen, from some `Hydraulics` values."""
    one = np.ones(specimen.axes)
    ideal: dict[str, Any] = {
        **dict.fromkeys(("opening_limit", "force_capacity", "stroke"), np.inf * one),
        **dict.fromkeys(("friction", "viscous_friction"), 0.0 * one),
        "friction_velocity": one,
    }
    return servo_hydraulic(specimen, Hydraulics(**ideal | actuators), linear=True)


def identified_plant(section: dict[str, Any], axes: int) -> Plant:
    """Plant of `plant.numerator`, `plant.denominator` and `plant.dead_time`, on every axis.

    An InputError says if it is improper or has no denominator.
    """
    numerator = np.trim_zeros(_numerator(section), "f")
    denominator = np.trim_zeros(np.atleast_1d(section["plant.denominator"]).astype(float), "f")
    if not denominator.size:
        raise InputError("force_controller: plant.denominator is zero")
    if numerator.size > denominator.size:
        raise InputError(
            f"force_controller: the plant is improper: plant.numerator of degree "
            f"{numerator.size - 1} over plant.denominator of degree {denominator.size - 1}"
        )
    one_axis = lti.companion_form(numerator, denominator)
    a, b, c, d = (block_diag(*[part] * axes) for part in one_axis)
    return Plant("identified", a, b, c, d, float(section["plant.dead_time"]))


def _numerator(section: dict[str, Any]) -> Floats:
    return np.atleast_1d(section.get("plant.numerator", 0.0)).astype(np.float64)


MAX_DELAY_STEPS = 500
"""Longest dead time in samples: the closed loop's eigenvalues are still found in a second."""


@dataclass(frozen=True)
class SampledPlant:
    """Exact sampling of a plant: zero-order hold, dead time and the loop's step of latency.

    u_k answers sample k and holds from step k+1 on; the dead time is m whole samples and a rest.
    So z_k+1 = a z_k + before u_k-m-2 + after u_k-m-1, f_k = c z_k + d u_k-m-1, or d u_k-m-2
    where there is a rest.

    Attributes
    ----------
    a, before, after, c, d : ndarray
        Shapes (s, s), (s, n), (s, n), (n, s), (n, n).
    whole : int
        m.
    rest : bool
        Whether a part of a sample remains.
    dt : float
        Sampling period, s.
    """

    a: Floats
    before: Floats
    after: Floats
    c: Floats
    d: Floats
    whole: int
    rest: bool
    dt: float

    @classmethod
    def of(cls, plant: Plant, dt: float) -> "SampledPlant":
        """Sample a plant; InputError if its dead time is many samples long."""
        whole, rest = lti.split_dead_time(plant.delay, dt)
        if whole > MAX_DELAY_STEPS:
            raise InputError(
                f"the plant's dead time of {plant.delay:g} s is {whole} samples long, but at most "
                f"{MAX_DELAY_STEPS} are allowed"
            )
        early, forced_early, _ = lti.first_order_hold(plant.a, plant.b, rest)
        late, forced_late, _ = lti.first_order_hold(plant.a, plant.b, dt - rest)
        before = late @ forced_early
        return cls(late @ early, before, forced_late, plant.c, plant.d, whole, rest > 0, dt)

    def response(self, frequencies_hz: Floats) -> Complexes:
        """Frequency response of the first axis, from u_k to f_k, shape (N,), N/V."""
        z = np.exp(2j * np.pi * frequencies_hz * self.dt)
        earlier = z[:, np.newaxis, np.newaxis]
        drive = self.before / earlier + self.after
        direct = self.d / earlier if self.rest else self.d
        forces = lti.state_space_response(self.a, drive, self.c, direct, z)
        return forces[:, 0, 0] * z ** -(self.whole + 1.0)

    def state_space(self) -> tuple[Floats, Floats, Floats]:
        """Matrices a, b, c with the drives of the last m + 2 samples as states, newest first.

        The plant may have any number of outputs: c has as many rows.
        """
        size, n = self.before.shape
        line = (self.whole + 2) * n
        a = np.zeros((size + line, size + line))
        a[:size, :size] = self.a
        a[:size, -2 * n :] = np.hstack([self.after, self.before])
        a[size + n :, size:-n] = np.eye(line - n)
        b = np.zeros((size + line, n))
        b[size : size + n] = np.eye(n)
        c = np.zeros((len(self.c), size + line))
        c[:, :size] = self.c
        newest = size + (self.whole + self.rest) * n
        c[:, newest : newest + n] = self.d
        return a, b, c
