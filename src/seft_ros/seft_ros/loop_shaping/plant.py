"""The plant of the force loop: from valve drive to actuator force, in continuous time."""

from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
from scipy.linalg import block_diag
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.errors import InputError
from seft_plant_sim.actuator import Hydraulics
from seft_plant_sim.continuous_model import ContinuousModel, servo_hydraulic
from seft_plant_sim.lti import companion_form, state_space_response
from seft_plant_sim.rig import continuous_model
from seft_plant_sim.specimen import Specimen

from seft_ros.loop_shaping import Source
from seft_ros.loop_shaping.roots import Root, lightly_damped, roots_of, uncancelled

Floats = npt.NDArray[np.float64]
Complexes = npt.NDArray[np.complex128]


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

    @property
    def axes(self) -> int:
        """Number of axes n."""
        return self.b.shape[1]

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
        """Leave out states that no valve reaches or no force shows, as those of idle springs."""
        links = self.a != 0
        reached, shown = self.b.any(axis=1), self.c.any(axis=0)
        for _ in self.a:
            reached, shown = reached | links @ reached, shown | shown @ links
        kept = np.flatnonzero(reached & shown)
        return replace(self, a=self.a[np.ix_(kept, kept)], b=self.b[kept], c=self.c[:, kept])

    def response(self, frequencies_hz: Floats) -> Complexes:
        """Frequency response H_fu(jw) of the first axis, shape (N,), N/V."""
        s = np.asarray(2j * np.pi * frequencies_hz, dtype=np.complex128)
        forces = state_space_response(self.a, self.b, self.c, self.d, s)
        return forces[:, 0, 0] * np.exp(-s * self.delay)

    def poles(self) -> list[Root]:
        """Poles of the first axis, those that zeros cancel left out, lowest first."""
        return self._roots()[0]

    def zeros(self) -> list[Root]:
        """Zeros of the first axis, those that poles cancel left out, lowest first."""
        return self._roots()[1]

    def antiresonance(self) -> Root | None:
        """Lowest lightly damped zero: the specimen's natural frequency, seen through the force.

        It is there by control-structure interaction (Dyke et al. 1995).
        """
        return next(iter(lightly_damped(self.zeros())), None)

    def oil_column(self) -> Root | None:
        """Lightly damped pole above that zero at which the plant answers most."""
        zero = self.antiresonance()
        above = [p for p in lightly_damped(self.poles()) if zero is None or p.hz > zero.hz]
        if not above:
            return None
        peaks = np.abs(self.response(np.array([pole.hz for pole in above])))
        return above[int(peaks.argmax())]

    def _roots(self) -> tuple[list[Root], list[Root]]:
        import control

        first = self.axis(0)
        system = control.ss(first.a, first.b, first.c, first.d, remove_useless_states=False)
        poles, zeros = system.poles(), system.zeros()
        return roots_of(uncancelled(poles, zeros)), roots_of(uncancelled(zeros, poles))


def choose_plant(experiment: Experiment, source: Source = Source.AUTO) -> Plant:
    """Plant that an experiment's `rig` or `force_controller` describes; InputError if none.

    The source ``auto`` is the identified plant where the experiment gives one, else the rig.
    """
    identified = np.any(_numerator(experiment["force_controller"]))
    if source == "identified" and not identified:
        raise InputError(
            "force_controller: plant.numerator is not given, so there is no identified plant; "
            "let seft identify write one, or shape for --plant rig"
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
    """Linear model of servo-hydraulic actuators on a specimen, of some of `Hydraulics`' values."""
    unlimited, none = np.full(specimen.axes, np.inf), np.zeros(specimen.axes)
    unknown: dict[str, Any] = {
        **dict.fromkeys(("opening_limit", "force_capacity", "stroke"), unlimited),
        **dict.fromkeys(("friction", "viscous_friction"), none),
        "friction_velocity": np.ones(specimen.axes),
    }
    return servo_hydraulic(specimen, Hydraulics(**unknown | actuators), linear=True)


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
    one_axis = companion_form(numerator, denominator)
    a, b, c, d = (block_diag(*[part] * axes) for part in one_axis)
    return Plant("identified", a, b, c, d, float(section["plant.dead_time"]))


def _numerator(section: dict[str, Any]) -> Floats:
    return np.atleast_1d(section.get("plant.numerator", 0.0)).astype(np.float64)
