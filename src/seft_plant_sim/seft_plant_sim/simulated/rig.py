"""The simulated rig: actuator, specimen, sensors and limits, stepped by commands."""

from array import array
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from seft_msgs_py.arrays import Floats, Ints
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.config.facts import CHANNELS
from seft_msgs_py.config.parameter_table import group, per_axis
from seft_msgs_py.errors import InputError
from seft_msgs_py.wire.outcome import Saturation, Simulated, all_saturated, count_saturated
from seft_msgs_py.wire.topics import VALVE_COMMAND, RigAxes, Timebase

from seft_plant_sim.calibration import (
    Calibration,
    CalibrationState,
    biases_of_all,
    calibration_of,
    nothing_known,
    zeroed_at_rest,
)
from seft_plant_sim.compiled import entry_point, kind_of
from seft_plant_sim.limits import Limits, event_ring
from seft_plant_sim.lti import split_dead_time
from seft_plant_sim.simulated.actuator import Hydraulics
from seft_plant_sim.simulated.continuous_model import (
    ContinuousModel,
    Drive,
    at_rest,
    delayed_force,
    dynamics_of,
    servo_hydraulic,
)
from seft_plant_sim.simulated.faults import (
    NO_FAULTS,
    Fault,
    Faults,
    failing_specimen,
    faults_of,
    read_faults,
)
from seft_plant_sim.simulated.rig_step import (
    BLIND,
    ENDS,
    FORCE_NOW,
    LARGEST_TRAVEL,
    RIG_LIMIT,
    RigParameters,
    RigState,
    come_to_rest,
    rig_step,
)
from seft_plant_sim.simulated.rig_step import left_open as left_open
from seft_plant_sim.simulated.sensor_dynamics import sensing_of, with_sensors
from seft_plant_sim.simulated.sensors import Sensors
from seft_plant_sim.simulated.specimen import Specimen
from seft_plant_sim.simulated.springs import ONE_SIDED, SPRING_KIND

LONGEST_DELAY_STEPS = 1_000_000
"""Largest dead time of a rig, in samples."""


class Safe(NamedTuple):
    """The safe command, and how the rig gets there at the end of a test.

    Attributes
    ----------
    command : ndarray
        The safe valve command, shape (n,), V.
    closing : int
        Steps in which the valve goes there.
    longest : int
        Largest number of steps until rest that are simulated.
    """

    command: Floats
    closing: int
    longest: int


class Stopped(NamedTuple):
    """Number of steps until the rig was at rest, and the largest force of any actuator, N."""

    steps: int
    peak_force: float


class Rig:
    """Simulates a laboratory's rig: it measures with a period of ``dt`` s, and obeys commands.

    Within a second its sensors may be saturated for ``saturated_time`` s.

    Attributes
    ----------
    drive : str
        Topic that drives the actuator: ``valve_command`` or ``reference_force``.
    parameters, state : RigParameters, RigState
        Arguments of `rig_step`, here and in a compiled loop.
    kind : tuple
        `kind_of` both.
    step_index : int
        Step of the last sample.
    violation : str or None
        The limit that the last sample breaks; the test must end with that sample.
    saturation : Saturation
        Saturation since the reset: of stroke, force capacity, valve, and sensors.
    zeroed : dict or None
        What it measured at rest, see `zeroed_at_rest`; None: nothing.
    """

    def __init__(
        self,
        model: ContinuousModel,
        sensors: Sensors,
        limits: Limits,
        saturated_time: float,
        dt: float,
        safe: Safe | None = None,
        faults: tuple[Faults, int] = NO_FAULTS,
        calibration: tuple[Calibration, CalibrationState] | None = None,
    ) -> None:
        self.drive: Drive = model.drive
        self.sensors = sensors
        self.limits = limits
        split = [split_dead_time(delay, dt) for delay in model.delay.tolist()]
        wholes, parts = np.array([whole for whole, _ in split]), [part for _, part in split]
        if (longest := int(wholes.max())) > LONGEST_DELAY_STEPS:
            delay = model.delay.max()
            raise InputError(f"actuator: a delay of {delay:g} s is {longest} samples long")
        n = model.b.shape[1]
        lengths, change, sensing = sensing_of(model, parts, dt)
        dynamics, periods = dynamics_of(model, lengths), int(sensing.whole.max(initial=-1)) + 1
        blind, window = event_ring(saturated_time, dt)
        known, known_state = calibration or nothing_known(n)
        self.parameters = RigParameters(
            dynamics,
            np.ascontiguousarray(model.drive_limit),
            longest - wholes,
            change,
            sensing,
            sensors.channels,
            limits.values,
            window,
            faults[0],
            known,
        )
        self.state = RigState(
            at_rest(dynamics),
            np.zeros(4 * n),
            np.zeros((periods, len(sensing.whole))),
            np.zeros(len(sensing.whole)),
            np.zeros(n),
            np.zeros((longest + 2, n)),
            np.zeros(4, dtype=np.int64),
            np.zeros((4, n)),
            limits.recent,
            limits.change,
            limits.largest,
            blind,
            np.zeros((len(faults[0].numbers), faults[1])),
            np.zeros(2),
            known_state,
        )
        self.step_index = 0
        self.violation: str | None = None
        self.saturation: Saturation = {}
        self.zeroed: dict[str, Any] | None = None
        self._model, self._saturated_time, self._safe = model, saturated_time, safe
        self._command = np.zeros(n)
        self._forces = array("d")  # largest true force of each sample, and of the stop
        noise, measured = np.zeros((2, *self.state.measured.shape))
        both = self.parameters, self.state
        self.kind = kind_of(both)
        arguments = 0, self._command, noise, measured
        self._step = entry_point(rig_step, *both, *arguments, kind=self.kind)
        one, plan = self._command, np.zeros((0, n))
        self._rest = entry_point(
            come_to_rest, *both, 0, plan, one, one, one, 0, 0, one, kind=self.kind
        )

    @classmethod
    def from_parameters(
        cls,
        section: dict[str, Any],
        axes: tuple[str, ...],
        timebase: Timebase,
        rig: RigAxes | None = None,
    ) -> "Rig":
        """Make the rig from its section of an experiment, which is for all axes.

        With several rigs, ``rig`` selects one, which has some of the axes. Raises `InputError` if
        sizes do not fit the axes, values do not make a rig, or its specimen is coupled with that of
        another rig.
        """
        own = rig or RigAxes.whole(axes)
        dt, safe = timebase.dt, group(section, "safe")
        command = per_axis(safe["valve_command"], axes, "rig: safe.valve_command")
        closing, longest = (round(safe[name] / dt) for name in ("close_time", "settle_time"))
        faults = read_faults(section["faults"], axes)
        noises = sum(fault.kind == "noise" for fault in faults)
        sensors = Sensors.from_parameters(section, axes, dt, own.places, noises)
        model = continuous_model(section, axes, own, faults=faults)
        stops = sum(law.law[SPRING_KIND] == ONE_SIDED for law in model.springs)
        known, zeroed = section, None
        if resting := round(section["calibration.zeroing"] / dt):
            known, zeroed = zeroed_at_rest(section, axes, own.places, sensors.at_rest(resting))
        made = cls(
            model,
            sensors,
            Limits(group(section, "limits"), own.axes, dt),
            section["limits.saturated_time"],
            dt,
            Safe(command[list(own.places)], closing, longest),
            faults_of(
                faults,
                own,
                timebase,
                sensors.channels.resolution,
                len(model.springs) - stops,
                section,
            ),
            calibration_of(
                known,
                axes,
                own.places,
                dt,
                sensors.channels.range,
                sensors.channels.resolution,
                sensors.channels.cutoff > 0.0,
            ),
        )
        made.zeroed = zeroed
        return made

    @property
    def sample(self) -> Floats:
        """The true state at the last step, shape (4, n)."""
        return self.state.true.reshape(4, -1).copy()

    @property
    def safe_command(self) -> Floats:
        """Command at which the actuator rests, shape (n,)."""
        if self._safe is None or self.drive != VALVE_COMMAND.name:
            return np.zeros_like(self._command)
        return self._safe.command

    def reset(self) -> Floats:
        """Bring the rig to rest and take the sample of step 0, see `step`."""
        self.saturation, self._command[:] = {}, 0.0
        del self._forces[:]
        return self._sample(0)

    def step(self, command: Floats) -> Floats:
        """Apply a command, shape (n,), V or N, see `drive`; take the next sample, shape (5, n).

        The sample contains displacement (m), velocity (m/s), acceleration (m/s^2), force (N), and
        the command.
        """
        self._command[:] = command
        return self._sample(self.step_index + 1)

    def extrapolated_command(self, last: Floats, age: int, plan: Floats, taken: int) -> Floats:
        """Give the command of a step without one, see the function `extrapolated_command`."""
        return extrapolated_command(last, age, plan, taken, self._safe.closing if self._safe else 0)

    def stop(self, plan: Floats | None = None, planned: Floats | None = None) -> Stopped:
        """Move the valve to its safe command and simulate the rig until it is at rest.

        Before that it follows a plan, the commands of this step and the coming ones, shape (m, n),
        unless it ends the test by itself (`violation`). If the plan had another command for the
        last step, ``planned``, the difference goes in the time in which the valve closes.

        A closed valve locks the piston: the oil column rings, friction and leakage damp it, and the
        remaining force decays. After that `sample` is the true state, and no limit trips.
        """
        if self._safe is None:
            return Stopped(0, 0.0)
        if plan is None or self.violation is not None:
            plan = np.zeros((0, len(self._command)))
        room, last, safe = np.empty_like(self._command), self.state.asked.copy(), self.safe_command
        offset = last - (last if planned is None else planned)
        ends = offset, last, safe, self._safe.closing, self._safe.longest
        step = self.step_index
        stopped = Stopped(*self._rest(self.parameters, self.state, step, plan, *ends, room))
        self._forces.append(stopped.peak_force)
        return stopped

    def simulated(self, first: int | None = None) -> Simulated:
        """Largest true motion of the test so far, of any axis.

        Its stop begins at the sample of step ``first``, by default the last one.
        """
        begun = self.step_index if first is None else min(first, self.step_index)
        peaks = self.state.peaks[LARGEST_TRAVEL], max(self._forces), max(self._forces[begun:])
        return Simulated(*map(float, peaks))

    def take(self, found: Ints, forces: Floats) -> None:
        """Continue after a compiled loop of N steps.

        ``found`` are the results of `rig_step` there, ``forces`` the largest true force (N) at each
        step; both have shape (N,).
        """
        self.step_index = len(found) - 1
        self._forces = array("d", forces)
        self.violation, self.saturation = self.violation_of(int(found[-1])), saturation_of(found)

    def violation_of(self, found: int) -> str | None:
        """Say why the test must end with the last sample; ``found`` is the result of `rig_step`.

        Raises the exception of a spring of another package, if there was one.
        """
        if found & RIG_LIMIT:
            for spring in self._model.springs:
                spring.check()
            return self.limits.describe(self.state.measured)
        if found & BLIND:
            blind = sorted(name for row, name in enumerate(CHANNELS) if found & 1 << row)
            return (
                f"{' and '.join(blind)} at the end of the sensor's range for more than "
                f"{self._saturated_time:g} s within one second: their channels are unknown"
            )
        return None

    def _sample(self, step: int) -> Floats:
        self.step_index = step
        sample = np.empty((5, len(self._command)))
        sample[4] = self._command
        noise = self.sensors.noise_of(step)
        found = self._step(self.parameters, self.state, step, self._command, noise, sample[:4])
        self._forces.append(self.state.peaks[FORCE_NOW])
        self.violation = None
        if found:
            self.violation = self.violation_of(found)
            for name, bit in ENDS.items():
                if found & bit:
                    count_saturated(self.saturation, name, 1, step)
        return sample


def extrapolated_command(
    last: Floats, age: int, plan: Floats, taken: int, closing: float
) -> Floats:
    """Give the command of a step without one: it continues along a stop.

    Parameters
    ----------
    last : ndarray
        The last command, shape (n,), V.
    age, plan : int, ndarray
        The stop, shape (m, n), V, and its age in steps. One of one point holds the last command.
    taken : int
        Age of the last command, in steps.
    closing : float
        Steps in which the valve closes: then the difference between last command and stop is gone.
    """
    end, then = len(plan) - 1, age - taken
    offset = last - plan[min(then, end)] if then >= 0 else np.zeros_like(last)
    left = left_open(taken, closing) if end else 1.0
    command: Floats = plan[min(age, end)] + left * offset
    return command


def saturation_of(found: Ints) -> Saturation:
    """Count saturated samples; ``found`` are the results of `rig_step` by step, shape (N,)."""
    steps = {name: np.flatnonzero(found & bit).tolist() for name, bit in ENDS.items()}
    return {name: {"samples": len(at), "first_step": at[0]} for name, at in steps.items() if at}


def continuous_model(
    section: dict[str, Any],
    axes: tuple[str, ...],
    rig: RigAxes | None = None,
    stiffness: float = 1.0,
    faults: Sequence[Fault] = (),
) -> ContinuousModel:
    """Model of actuator, specimen and sensors from a rig's parameters.

    See `Rig.from_parameters`; ``stiffness`` is a factor on the stiffness of the elastic specimen,
    ``faults`` are those that the specimen may have.
    """
    own = rig or RigAxes.whole(axes)
    where = "rig: simulated.specimen"
    whole = Specimen.from_parameters(group(section, "simulated.specimen"), axes, where)
    specimen = whole.part(own, where)
    specimen = replace(specimen, stiffness=stiffness * specimen.stiffness)
    specimen = failing_specimen(faults, own, specimen)
    actuator, kind = group(section, "simulated.actuator"), section["actuator.kind"]
    if kind in ("ideal", "delay"):
        model = delayed_force(specimen, actuator["delay"] if kind == "delay" else 0.0)
    else:
        everywhere = Hydraulics.from_parameters(actuator, axes)
        hydraulics = everywhere.part(own.places)
        model = servo_hydraulic(specimen, hydraulics, linear=kind == "servo_hydraulic_linear")
    return with_sensors(model, section, axes, own.places)


class Rigs:
    """The rigs of an experiment, stepped together; the bits are those of their nodes."""

    def __init__(self, experiment: Experiment) -> None:
        section, axes, timebase = experiment["rig"], experiment.axes, experiment.timebase
        self._axes = len(axes)
        self._rigs = [
            (list(of.places), Rig.from_parameters(section, axes, timebase, of))
            for of in experiment.rigs
        ]

    @property
    def drive(self) -> Drive:
        """Topic that drives the actuators."""
        return self._rigs[0][1].drive

    @property
    def violation(self) -> str | None:
        """The limit that the last sample breaks, of the first rig that has one."""
        return next((rig.violation for _, rig in self._rigs if rig.violation), None)

    @property
    def zeroed(self) -> dict[str, Any] | None:
        """What they measured at rest, over all axes; None: nothing."""
        found = [(places, rig.zeroed) for places, rig in self._rigs if rig.zeroed is not None]
        if not found:
            return None
        return {"samples": found[0][1]["samples"], **biases_of_all(self._axes, found)}

    @property
    def saturation(self) -> Saturation:
        """Saturation of any of them."""
        return all_saturated(rig.saturation for _, rig in self._rigs)

    def reset(self) -> Floats:
        """Bring the rigs to rest and take the sample of step 0, see `Rig.step`."""
        return self._gather(rig.reset() for _, rig in self._rigs)

    def step(self, command: Floats) -> Floats:
        """Apply a command and take the next sample, see `Rig.step`."""
        return self._gather(rig.step(command[places]) for places, rig in self._rigs)

    def stop(self, plans: Sequence[Floats] | None = None) -> None:
        """Bring all of them to rest, see `Rig.stop`; ``plans`` are one for each."""
        for place, (_, rig) in enumerate(self._rigs):
            rig.stop(None if plans is None else plans[place])

    def simulated(self, first: int | None = None) -> Simulated:
        """Largest true motion of any of them, see `Rig.simulated`."""
        return Simulated.of_all(rig.simulated(first) for _, rig in self._rigs)

    def _gather(self, states: Iterable[Floats]) -> Floats:
        whole = np.empty((5, self._axes))
        for (places, _), state in zip(self._rigs, states, strict=True):
            whole[:, places] = state
        return whole
