"""A planned test as a closed loop, and the loop with other values than planned."""

import cmath
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from seft_msgs_py.arrays import Floats
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.errors import InputError
from seft_msgs_py.wire.topics import VALVE_COMMAND
from seft_plant_sim.simulated.continuous_model import Drive
from seft_plant_sim.simulated.specimen import Specimen
from seft_plant_sim.whole_structure import tested_specimen

from seft_ros.design.closed_loop import SampledLoop, closed_loop, frozen_feedforward, frozen_target
from seft_ros.design.plant import Plant, rig_model
from seft_ros.force_controller.force_control import LinearControl
from seft_ros.force_controller.force_controller_parameters import VELOCITY_FEEDFORWARD
from seft_ros.force_controller.methods import force_control
from seft_ros.force_controller.velocity_feedforward import VelocityFeedforward
from seft_ros.reference_force.compensator import Compensator, LinearFilter
from seft_ros.reference_force.reference_force_block import compensator, method_inputs
from seft_ros.reference_force.reference_force_parameters import TARGET_MOTION
from seft_ros.reference_force.target_motion import TargetMotion
from seft_ros.reference_force.target_step import FORCE_ROW

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
    derived = experiment["reference_force"]["sensors.velocity"] == "derived"
    cutoff = experiment["reference_force"]["sensors.velocity_cutoff"] if derived else None
    plant, specimen = Plant.of_model(source, model, motion=True), tested_specimen(experiment)
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
        self,
        mass_ratio: float | None = None,
        stiffness: float = 1.0,
        delay_error: float = 0.0,
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

    def _sample(
        self, stiffness: float, dead_time: float, gain: float
    ) -> tuple[Floats, Floats, Floats]:
        other = stiffness != 1.0
        rig = choose_rig(self.experiment, stiffness) if other else self.rig
        return rig.sampled(self.dt, dead_time, gain)

    def _linear_controllers(self) -> Sequence[tuple[Floats | None, LinearControl]]:
        """Make the controller as it starts, then at the bounds to which it may adapt.

        Before each is the matrix from the points to what it reads; None: the method has no points.
        """
        n, section = len(self.axes), self.experiment["force_controller"]
        control = LinearControl.none(n)
        if self.rig.drive == VALVE_COMMAND.name:
            made = force_control(section, self.axes, self.experiment.timebase)
            if isinstance(made, VelocityFeedforward):
                if not self.follows:
                    raise InputError(
                        f"force_controller: {VELOCITY_FEEDFORWARD} needs a target motion: set "
                        f"reference_force: compensation.method to {TARGET_MOTION}"
                    )
                return frozen_feedforward(made)
            control = made.linear()
        return [(np.eye(n, 3 * n, k=FORCE_ROW * n) if self.follows else None, control)]
