"""A rig: its hardware, and the guard that each of its samples passes."""

from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np
from seft_msgs_py.arrays import Floats, Ints
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.wire.outcome import Saturation, Simulated, all_saturated, count_saturated
from seft_msgs_py.wire.topics import VALVE_COMMAND, RigAxes, Timebase

from seft_plant_sim.calibration import biases_of_all, zeroed_at_rest
from seft_plant_sim.compiled import kind_of
from seft_plant_sim.hardware.hosted import HardwareError, HostedHardware
from seft_plant_sim.hardware.safe_stop import Safe, Stopped
from seft_plant_sim.judge.guard import DRIVE_ROW, RANGES, Guard
from seft_plant_sim.judge.known_rig import command_limit
from seft_plant_sim.simulated.rig import SimulatedRig
from seft_plant_sim.simulated.rig_step import SATURATED_PARTS, left_open

_SATURATED = RANGES | SATURATED_PARTS
"""Bits of what is saturated at a sample, by name."""


class Rig:
    """Takes the samples of its hardware through its guard, and gives it commands.

    Parameters
    ----------
    section, axes, timebase
        The rig's section of an experiment, which is for all axes; axes and time base.
    rig : RigAxes, optional
        With several rigs, one of them, which has some of the axes.
    hardware : HostedHardware, optional
        Its hardware; default simulated.

    Raises
    ------
    InputError
        If sizes do not fit the axes, or values do not make a rig.

    Attributes
    ----------
    drive : str
        Topic that drives the actuator: ``valve_command`` or ``reference_force``.
    hardware, guard : SimulatedRig or HostedHardware, and Guard
        What its samples come from, and pass.
    step_index : int
        Step of the last sample.
    raw, measured : ndarray
        The last sample as the hardware gave it, and calibrated and aligned, shape (4, n).
    violation : str or None
        Why the test must end with the last sample.
    trusted : int
        The last step up to which no wrong value was used, so that a stop can follow a plan from
        then; -1: none.
    saturation : Saturation
        Saturation since the reset: of stroke, force capacity, valve, and sensors.
    zeroed : dict or None
        What it measured at rest, see `zeroed_at_rest`; None: nothing.
    """

    def __init__(
        self,
        section: dict[str, Any],
        axes: tuple[str, ...],
        timebase: Timebase,
        rig: RigAxes | None = None,
        hardware: HostedHardware | None = None,
    ) -> None:
        self._of = own = rig or RigAxes.whole(axes)
        self._section, self._axes, self._dt = section, axes, timebase.dt
        self.hardware = hardware or SimulatedRig.from_parameters(section, axes, timebase, own)
        self.drive = self.hardware.drive
        self._safe = Safe.from_parameters(section, axes, own.places, timebase.dt)
        self._command = np.zeros_like(self._safe.command)
        self.measured = np.zeros((4, len(self._command)))
        self.zero(self.hardware.at_rest(round(section["calibration.zeroing"] / timebase.dt)))

    @property
    def kind(self) -> tuple[Any, ...]:
        """`kind_of` parameters and states of a compiled loop."""
        simulated, guard = self.simulation, self.guard
        return kind_of((simulated.parameters, simulated.state, guard.parameters, guard.state))

    @property
    def simulation(self) -> SimulatedRig:
        """Its hardware, which is simulated."""
        assert isinstance(self.hardware, SimulatedRig)
        return self.hardware

    @property
    def safe_command(self) -> Floats:
        """Command at which the actuator rests, shape (n,); 0 where it stood before the test."""
        rests = self.drive == VALVE_COMMAND.name
        return self._safe.command if rests else np.zeros_like(self._safe.command)

    def zero(self, samples: Floats) -> None:
        """Take biases that nobody knows from samples at rest, shape (N, 4, n), as read."""
        known, of = self._section, self._of
        self.zeroed: dict[str, Any] | None = None
        if len(samples):
            known, self.zeroed = zeroed_at_rest(known, self._axes, of.places, samples)
        self.guard = Guard(known, self._axes, of, self._dt, self.zeroed)
        self.begin()

    def begin(self) -> None:
        """Begin a test with its next sample; a simulated rig is at rest."""
        self.saturation: Saturation = {}
        self.violation: str | None = None
        self.trusted = -1
        self.step_index, self._command[:] = -1, 0.0
        self.hardware.reset()
        self.guard.reset()

    def read(self) -> Floats:
        """Take the next sample: read it, calibrate and align it, judge it, and look for faults.

        Returns
        -------
        ndarray
            Judged displacement (m), velocity (m/s), acceleration (m/s^2) and force (N), 1 where it
            is suspect, and what the rig applies from then on, see `guard_step`; shape (6, n).
        """
        self.raw = self._call(self.hardware.read)
        self.step_index += 1
        self.measured, sample = self.raw.copy(), np.empty((DRIVE_ROW + 1, len(self._command)))
        found = self.guard.take(self.step_index, self.measured, self._command, sample)
        found |= self.hardware.saturated
        self.violation, self.trusted = None, self.step_index
        if found:
            self.hardware.check()
            self.violation = self.guard.violation(found)
            if self.violation is not None:
                missing = self.hardware.missing
                self.violation = missing or self.violation
                self.trusted = -1 if missing else self.guard.trusted(found)
            for name, bit in _SATURATED.items():
                if found & bit:
                    count_saturated(self.saturation, name, 1, self.step_index)
        return sample

    def write(self, command: Floats) -> None:
        """Apply a command from the last sample on, shape (n,), V or N, see `drive`."""
        self._command[:] = command
        self._call(self.hardware.write, self._command)

    def _call(self, method: Callable[..., Any], *arguments: Any) -> Any:
        """Call the hardware in a test, which must end with a fault of it."""
        try:
            return method(*arguments)
        except HardwareError as error:
            self.violation, self.trusted = str(error), -1
            raise

    def reset(self) -> Floats:
        """Begin a test and take the sample of step 0, see `read`."""
        self.begin()
        return self.read()

    def step(self, command: Floats) -> Floats:
        """Apply a command and take the next sample, see `write` and `read`."""
        self.write(command)
        return self.read()

    def extrapolated_command(self, last: Floats, age: int, plan: Floats, taken: int) -> Floats:
        """Give the command of a step without one: it continues along a stop.

        Parameters
        ----------
        last : ndarray
            The last command, shape (n,), V.
        age, plan : int, ndarray
            The stop, shape (m, n), V, and its age in steps. One of one point holds the last
            command.
        taken : int
            Age of the last command, in steps. When the valve has had the time to close, the
            difference between last command and stop is gone.
        """
        end, then = len(plan) - 1, age - taken
        offset = last - plan[min(then, end)] if then >= 0 else np.zeros_like(last)
        left = left_open(taken, self._safe.closing) if end else 1.0
        return plan[min(age, end)] + left * offset

    def stop(self, plan: Floats | None = None, planned: Floats | None = None) -> Stopped | None:
        """Move the valve to its safe command, and come to rest.

        Before that it follows a plan, the commands of this step and the coming ones, shape (m, n),
        which must be of a `trusted` step. If the plan had another command for the last step,
        ``planned``, the difference goes in the time in which the valve closes.

        A displacement servo, which is where its last commands lead it, moves on from there as the
        plan does, and holds its last command.

        A closed valve locks the piston: the oil column rings, friction and leakage damp it, and the
        remaining force decays. A simulated rig is at rest afterwards; others continue with each
        sample, see `come_to_rest`.
        """
        if plan is None:
            plan = np.zeros((0, len(self._command)))
        safe = self._safe._replace(command=self.safe_command)
        if safe.holds:
            if planned is not None:  # it is where its last commands lead it, and goes on from there
                limit = command_limit(self._section)
                plan = np.clip(plan + (self._command - planned), -limit, limit)
                planned = None
            safe = safe._replace(command=plan[-1] if len(plan) else self._command.copy())
        return self.hardware.stop(plan, planned, self._command, safe)

    def come_to_rest(self, *, is_read: bool = True) -> Stopped | None:
        """Continue a stop with the last sample, or without one; give its end, if it has come."""
        sample = self.measured if is_read else np.full_like(self.measured, np.nan)
        return self.hardware.come_to_rest(sample)

    def simulated(self, first: int | None = None) -> Simulated | None:
        """Largest true motion of the test so far, see `SimulatedRig.simulated`; None: not known."""
        return self.hardware.simulated(first)

    def take(self, found: Ints, forces: Floats) -> None:
        """Continue after a compiled loop of N steps.

        ``found`` are the results of `rig_step` and `guard_step` together, ``forces`` the largest
        true force (N) at each step; both have shape (N,).
        """
        self.simulation.take(forces)
        self._command[:] = self.simulation.state.asked  # which a servo may hold
        self.step_index = len(found) - 1
        seen = [name for name, bit in _SATURATED.items() if np.bitwise_or.reduce(found) & bit]
        steps = {name: np.flatnonzero(found & _SATURATED[name]).tolist() for name in seen}
        self.saturation = {k: {"samples": len(at), "first_step": at[0]} for k, at in steps.items()}
        self.violation = self.guard.violation(int(found[-1]))
        self.trusted = self.step_index
        if self.violation is not None:
            self.trusted = self.guard.trusted(int(found[-1]))


class Rigs:
    """The rigs of an experiment, stepped together; the bits are those of their nodes."""

    def __init__(self, experiment: Experiment) -> None:
        section, axes, timebase = experiment["rig"], experiment.axes, experiment.timebase
        self._axes = len(axes)
        self._rigs = [(list(of.places), Rig(section, axes, timebase, of)) for of in experiment.rigs]

    @property
    def drive(self) -> str:
        """Topic that drives the actuators."""
        return self._rigs[0][1].drive

    @property
    def violation(self) -> str | None:
        """Why the test must end with the last sample, of the first rig that knows."""
        return next((rig.violation for _, rig in self._rigs if rig.violation), None)

    @property
    def trusted(self) -> int:
        """The last step up to which no rig has used a wrong value, see `Rig`."""
        return min(rig.trusted for _, rig in self._rigs)

    @property
    def measured(self) -> Floats:
        """The last sample as measured, see `Rig`, shape (4, n)."""
        return self._gather(rig.measured for _, rig in self._rigs)

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
        return self._gather([rig.reset() for _, rig in self._rigs])

    def step(self, command: Floats) -> Floats:
        """Apply a command and take the next sample, see `Rig.step`."""
        return self._gather([rig.step(command[places]) for places, rig in self._rigs])

    def stop(self, *plans: Sequence[Floats | None]) -> None:
        """Bring all of them to rest, see `Rig.stop`; ``plans`` are its arguments for each."""
        for plan, (_, rig) in zip(plans or [()] * len(self._rigs), self._rigs, strict=True):
            rig.stop(*plan)

    def simulated(self, first: int | None = None) -> Simulated:
        """Largest true motion of any of them, see `Rig.simulated`."""
        found = (rig.simulated(first) for _, rig in self._rigs)
        return Simulated.of_all(each for each in found if each is not None)

    def _gather(self, parts: Iterable[Floats]) -> Floats:
        parts = list(parts)
        whole = np.empty((len(parts[0]), self._axes))
        for (places, _), part in zip(self._rigs, parts, strict=True):
            whole[:, places] = part
        return whole
