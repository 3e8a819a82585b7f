"""The simulated rig: actuator, specimen and sensors, stepped by commands."""

from array import array
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from seft_msgs_py.arrays import Floats, clear, zeros
from seft_msgs_py.config.facts import FORCE_DRIVEN, POSITION_SERVO
from seft_msgs_py.config.parameter_table import group
from seft_msgs_py.errors import InputError
from seft_msgs_py.wire.outcome import Simulated
from seft_msgs_py.wire.topics import RigAxes, Timebase

from seft_plant_sim.channels import per_channel
from seft_plant_sim.compiled import entry_point
from seft_plant_sim.hardware.safe_stop import Safe, Stopped
from seft_plant_sim.judge.known_rig import known_responses
from seft_plant_sim.lti import split_dead_time
from seft_plant_sim.rig_parameters import is_imposed
from seft_plant_sim.simulated.actuator import Hydraulics, InnerLoop
from seft_plant_sim.simulated.continuous_model import (
    ContinuousModel,
    Drive,
    at_rest,
    begin_motion,
    delayed_force,
    dynamics_of,
    imposed_motion,
    servo_hydraulic,
    with_inner_loop,
)
from seft_plant_sim.simulated.faults import Fault, Faults, failing_specimen, faults_of, read_faults
from seft_plant_sim.simulated.rig_step import (
    FORCE_NOW,
    LARGEST_TRAVEL,
    RigParameters,
    RigState,
    come_to_rest,
    rig_step,
)
from seft_plant_sim.simulated.sensors import Sensors, sensing_of, with_sensors
from seft_plant_sim.simulated.specimen import Specimen
from seft_plant_sim.simulated.springs import ONE_SIDED, SPRING_KIND

LONGEST_DELAY_STEPS = 1_000_000
"""Largest dead time of a rig, in samples."""


class SimulatedRig:
    """Simulates a laboratory's rig: it measures with a period of ``dt`` s, and obeys commands.

    Attributes
    ----------
    drive : str
        Topic that drives the actuator: ``valve_command`` or ``reference_force``.
    parameters, state : RigParameters, RigState
        Arguments of `rig_step`, here and in a compiled loop.
    step_index : int
        Step of the last sample.
    can_wait, is_clock, is_stopping, is_closing : bool
        See `seft_plant_sim.hardware.hosted`; a stop has ended when it returns.
    missing : str
        Empty: every sample comes.
    counts : dict
        See `seft_plant_sim.hardware.hosted.HostedHardware`; it has none.
    saturated : int
        What was saturated at the last sample, bits of `SATURATED_PARTS`.
    """

    can_wait, is_clock = True, False
    is_stopping = is_closing = False
    missing = ""

    def __init__(
        self, model: ContinuousModel, sensors: Sensors, dt: float, faults: tuple[Faults, int]
    ) -> None:
        self.drive: Drive = model.drive
        self.sensors = sensors
        split = [split_dead_time(delay, dt) for delay in model.delay.tolist()]
        wholes, parts = np.array([whole for whole, _ in split]), [part for _, part in split]
        if (longest := int(wholes.max())) > LONGEST_DELAY_STEPS:
            delay = model.delay.max()
            raise InputError(f"actuator: a delay of {delay:g} s is {longest} samples long")
        n = model.b.shape[1]
        lengths, change, sensing = sensing_of(model, parts, dt)
        dynamics, periods = dynamics_of(model, lengths), int(sensing.whole.max(initial=-1)) + 1
        limit, newer = np.ascontiguousarray(model.drive_limit), longest - wholes
        seen = sensing, sensors.channels, faults[0]
        self.parameters = RigParameters(dynamics, limit, newer, change, *seen)
        sizes = {"n": n, "channels": 4 * n, "periods": periods, "read": len(sensing.whole)}
        sizes |= {"line": longest + 2, "faults": len(faults[0].numbers), "memory": faults[1]}
        self.state = zeros(RigState, sizes, motion=at_rest(dynamics))
        self.step_index, self.saturated = -1, 0
        self.counts: dict[str, int] = {}
        self._springs, self._command, self._forces = model.springs, np.zeros(n), array("d")
        both, measured = (self.parameters, self.state), np.zeros((4, n))
        self._step = entry_point(rig_step, *both, 0, self._command, measured, measured)
        one, plan = self._command, np.zeros((0, n))
        self._rest = entry_point(come_to_rest, *both, 0, plan, one, one, one, 0, 0, one)

    @classmethod
    def from_parameters(
        cls, section: dict[str, Any], axes: tuple[str, ...], timebase: Timebase, rig: RigAxes
    ) -> "SimulatedRig":
        """Make it from the rig's section of an experiment, which is for all axes.

        Raises
        ------
        InputError
            If sizes do not fit the axes, values do not make a rig, or its specimen is coupled with
            that of another rig.
        """
        faults = read_faults(section["faults"], axes)
        noises = sum(fault.kind == "noise" for fault in faults)
        sensors = Sensors(section, axes, rig.places, noises)
        model = continuous_model(section, axes, rig, faults=faults)
        laws = sum(law.law[SPRING_KIND] != ONE_SIDED for law in model.springs)
        found = faults_of(faults, rig, timebase, sensors.channels.resolution, laws, section)
        return cls(model, sensors, timebase.dt, found)

    @property
    def sample(self) -> Floats:
        """The true state at the last step, shape (4, n)."""
        return self.state.true.reshape(4, -1).copy()

    def at_rest(self, count: int) -> Floats:
        """Give so many samples at rest, shape (count, 4, n)."""
        return self.sensors.at_rest(count) if count else np.zeros((0, 4, len(self._command)))

    def reset(self) -> None:
        """Come to rest before step 0 of a test."""
        self.step_index, self._command[:] = -1, 0.0
        clear(self.state)
        begin_motion(self.state.motion)
        del self._forces[:]

    def write(self, drive: Floats) -> None:
        """Obey a command from the last sample on, shape (n,), V or N, see `drive`."""
        self._command[:] = drive

    def read(self) -> Floats:
        """Take the sample a period after the last one, shape (4, n); the first one is at rest."""
        self.step_index += 1
        measured, step = np.empty((4, len(self._command))), self.step_index
        noise, both = self.sensors.noise_of(step), (self.parameters, self.state)
        self.saturated = self._step(*both, step, self._command, noise, measured)
        self._forces.append(self.state.peaks[FORCE_NOW])
        return measured

    def stop(self, plan: Floats, planned: Floats | None, last: Floats, safe: Safe) -> Stopped:
        """Obey a plan, close the valve and come to rest, see `seft_plant_sim.rig.Rig.stop`."""
        room, last = np.empty_like(self._command), self.state.asked.copy()
        offset = last - (last if planned is None else planned)
        ends = offset, last, safe.command, safe.closing, safe.longest, room
        both = self.parameters, self.state
        steps, peak_force = self._rest(*both, self.step_index, plan, *ends)
        self._forces.append(peak_force)
        return Stopped(steps * safe.dt, peak_force)

    def safe(self) -> None:
        """Nothing moves between two tests."""

    def close(self) -> None:
        """There is nothing to give back."""

    def come_to_rest(self, measured: Floats) -> None:
        """Do nothing: it rests when `stop` has ended."""

    def simulated(self, first: int | None = None) -> Simulated:
        """Largest true motion of the test so far, of any axis.

        Its stop begins at the sample of step ``first``, by default the last one.
        """
        begun = self.step_index if first is None else min(first, self.step_index)
        forces = np.array(self._forces)
        peaks = self.state.peaks[LARGEST_TRAVEL], forces.max(), forces[begun:].max()
        return Simulated(*map(float, peaks))

    def check(self) -> None:
        """Raise the exception of a spring of another package, if there was one."""
        for spring in self._springs:
            spring.check()

    def take(self, forces: Floats) -> None:
        """Continue after a compiled loop of N steps; ``forces`` are the largest true ones, (N,)."""
        self.step_index, self._forces = len(forces) - 1, array("d", forces.tobytes())


def continuous_model(
    section: dict[str, Any],
    axes: tuple[str, ...],
    rig: RigAxes | None = None,
    stiffness: float = 1.0,
    faults: Sequence[Fault] = (),
) -> ContinuousModel:
    """Model of actuator, specimen and sensors from a rig's parameters.

    See `Rig`; ``stiffness`` is a factor on the stiffness of the elastic specimen,
    ``faults`` are those that the specimen may have.
    """
    own = rig or RigAxes.whole(axes)
    where = "rig: simulated.specimen"
    whole = Specimen.from_parameters(group(section, "simulated.specimen"), axes, where)
    specimen = whole.part(own, where)
    specimen = replace(specimen, stiffness=stiffness * specimen.stiffness)
    specimen = failing_specimen(faults, own, specimen)
    actuator, kind = group(section, "simulated.actuator"), section["actuator.kind"]
    if kind == "ideal" and np.any(actuator["delay"]):
        other = f"actuator.delay is {actuator['delay']} s: make the kind delay, or actuator.delay 0"
        raise InputError(f"/**: actuator.kind ideal obeys at once, but {other}")
    hydraulics = Hydraulics.from_parameters(actuator, axes).part(own.places)
    if kind in FORCE_DRIVEN:
        model = delayed_force(specimen, actuator["delay"])
    elif is_imposed(section):
        servos = known_responses(section, axes, own.places)
        model = imposed_motion(specimen, servos, hydraulics.stroke)
    else:
        model = servo_hydraulic(specimen, hydraulics, linear=kind == "servo_hydraulic_linear")
        if kind == POSITION_SERVO:
            loop = InnerLoop.from_parameters(actuator, axes, own.places)
            model = with_inner_loop(model, loop, hydraulics.stroke)
    return with_sensors(model, section, axes, own.places)


class ConverterBoard:
    """Shows the volts of a simulated rig's amplifiers, which goes on moving between two tests.

    Parameters
    ----------
    parameters : mapping
        Of the rig, by name: what it truly is, and ``calibration.*_per_volt``.
    axes : tuple of str
        Names of its n axes.
    """

    def __init__(self, parameters: Mapping[str, Any], axes: tuple[str, ...]) -> None:
        section, every = dict(parameters), tuple(parameters["axes"])
        rig = RigAxes("", axes, tuple(every.index(axis) for axis in axes))
        timebase = Timebase.from_rate(section["rate"])
        self._rig = SimulatedRig.from_parameters(section, every, timebase, rig)
        self._rig.reset()
        per_volt = per_channel(section, every, "calibration.{}_per_volt")
        self._per_volt = per_volt[:, list(rig.places)]

    def inputs(self) -> Floats:
        """Convert all channels a period after the last time, V, shape (4, n)."""
        return np.asarray(self._rig.read() / self._per_volt)

    def output(self, volts: Floats) -> None:
        """Put out the valve commands, V, shape (n,)."""
        self._rig.write(volts)
