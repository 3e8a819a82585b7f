"""How a rig is stopped: along its plan if there is one, then its valve closes."""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from seft_msgs_py.arrays import Floats
from seft_msgs_py.config.facts import CHANNELS, POSITION_SERVO
from seft_msgs_py.config.parameter_table import per_axis
from seft_msgs_py.errors import InputError

from seft_plant_sim.channels import VELOCITY, per_channel, velocity_is_derived
from seft_plant_sim.judge.detectors import assumed_noise
from seft_plant_sim.simulated.rig_step import stop_command

_ANSWERS_IN = 0.05
"""Time that valve and oil have after the valve was closed, s, before the piston must stand."""
_GOES_ON = 0.05
"""Part of the largest displacement that a piston may move after that."""
_MEAN_OF = 0.05
"""Time over which velocities are averaged, s."""
_NOISE_SIGMAS = 4.0
"""Standard errors up to which a mean velocity is noise."""


class Safe(NamedTuple):
    """The safe command, and how a rig gets there at the end of a test.

    Attributes
    ----------
    command : ndarray
        The safe valve command, shape (n,), V.
    holds : bool
        Whether the rig holds its last command instead: a displacement servo stands there.
    closing : int
        Steps in which the valve goes there.
    longest : int
        Steps after that in which the rig must rest.
    rest_velocity : float
        A slower mean over `_MEAN_OF` is noise, and counts as rest, m/s.
    farthest : float
        Displacement beyond which a piston with a closed valve goes on, m.
    dt : float
        Sampling period, s.
    """

    command: Floats
    holds: bool
    closing: int
    longest: int
    rest_velocity: float
    farthest: float
    dt: float

    @classmethod
    def from_parameters(
        cls, section: Mapping[str, Any], axes: Sequence[str], places: Sequence[int], dt: float
    ) -> "Safe":
        """Make it from the rig's section, for the axes at some places.

        Raises
        ------
        InputError
            If the safe command is beyond the limit of commands.
        """
        command = per_axis(section["safe.valve_command"], axes, "rig: safe.valve_command")
        holds = section["actuator.kind"] == POSITION_SERVO
        if holds and command.any():
            raise InputError(
                f"rig: safe.valve_command is {section['safe.valve_command']} V, but an actuator of "
                f"kind {POSITION_SERVO} holds its position; leave it out"
            )
        if np.abs(command).max() > (limit := section["limits.command"]):
            raise InputError(
                f"rig: safe.valve_command is {section['safe.valve_command']} V, but must be within "
                f"/**: limits.command, {limit:g} V: give the valve's null"
            )
        noise = per_channel(section, axes, "sensors.{}_noise")[:, list(places)]
        limits = np.array([section[f"limits.{name}"] for name in CHANNELS])
        noise = assumed_noise(noise, limits, velocity_is_derived(section), dt)
        averaged = math.sqrt(max(1.0, _MEAN_OF / dt))
        return cls(
            command[list(places)],
            holds,
            round(section["safe.close_time"] / dt),
            round(section["safe.settle_time"] / dt),
            _NOISE_SIGMAS * float(noise[VELOCITY].max()) / averaged,
            _GOES_ON * section["limits.displacement"],
            dt,
        )


class Stopped(NamedTuple):
    """End of a stop.

    Attributes
    ----------
    time : float
        Until the rig was at rest, or until it should have been, s.
    peak_force : float
        Largest force of any actuator, N.
    is_at_rest : bool
        Whether it rests.
    has_dumped : bool
        Whether the pressure was taken away, because a piston went on.
    """

    time: float
    peak_force: float
    is_at_rest: bool = True
    has_dumped: bool = False


class SafeStop:
    """Brings a rig to rest, period by period.

    Not at once: a valve that closes at once on a moving mass M makes the oil hammer with
    v sqrt(k M).

    Parameters
    ----------
    write, close : callable
        Obey a command, shape (n,), V, and the safe command.
    plan, planned, last
        See `stop_command`; ``planned`` is what the plan had in place of the last command, or None.
    safe : Safe
        Where it ends.
    dump : callable or None
        Takes the pressure away where a piston goes on after its valve was closed.

    Attributes
    ----------
    is_closed : bool
        Whether the valve has its safe command.
    """

    def __init__(
        self,
        write: Callable[[Floats], None],
        close: Callable[[], None],
        plan: Floats,
        planned: Floats | None,
        last: Floats,
        safe: Safe,
        dump: Callable[[], None] | None,
    ) -> None:
        self._write, self._close = write, close
        self._plan, self._last, self._safe = plan, last.copy(), safe
        self._offset, self._dump = last - (last if planned is None else planned), dump
        self._closed_at = max(len(plan) + safe.closing - 1, 0)
        self._window = max(1, round(_MEAN_OF / safe.dt))
        self._taken, self._peak, self._has_dumped = 0, 0.0, False
        self.is_closed = False
        self._speeds: list[Floats] = []
        self._stands: Floats | None = None

    def next(self, measured: Floats) -> Stopped | None:
        """Continue with the next sample, shape (4, n), or NaN; give the end when there is one."""
        self._peak = max(self._peak, float(np.abs(measured[3]).max()))
        self._speeds = [*self._speeds[1 - self._window :], measured[1].copy()]
        if not self.is_closed and self._taken <= self._closed_at + self._safe.longest:
            self.command()  # a safe command that has failed, once more
            return None
        self._taken += 1
        closed = self._taken - self._closed_at
        self._look_at_piston(closed, measured[0])
        rests = np.abs(np.mean(self._speeds, axis=0)).max() < self._safe.rest_velocity
        if (rests and closed >= self._window) or closed > self._safe.longest:
            time, is_at_rest = self._taken * self._safe.dt, bool(rests) and self.is_closed
            return Stopped(time, self._peak, is_at_rest, self._has_dumped)
        return None

    def _look_at_piston(self, closed: int, displacement: Floats) -> None:
        """Take the pressure away where a piston goes on with its valve closed."""
        if closed * self._safe.dt <= _ANSWERS_IN or self._has_dumped:
            return
        if self._stands is None or np.isnan(self._stands).any():
            self._stands = displacement.copy()
        if self._dump and np.abs(displacement - self._stands).max() > self._safe.farthest:
            self._dump()
            self._has_dumped = True

    def command(self) -> None:
        """Give the next command; at the end, the safe one."""
        taken, self._taken = self._taken, self._taken + 1  # also where the call fails
        if taken >= self._closed_at:
            self._close()
            self.is_closed = True
        else:
            command = np.empty_like(self._last)
            s = self._safe
            stop_command(taken, self._plan, self._offset, self._last, s.command, s.closing, command)
            self._write(command)
