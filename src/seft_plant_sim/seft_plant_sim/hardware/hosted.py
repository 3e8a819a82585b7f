"""A laboratory's hardware behind the rig node: each of its calls is checked."""

import inspect
import traceback
from collections.abc import Callable, Mapping
from contextlib import suppress
from itertools import compress
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from seft_msgs_py.arrays import Floats
from seft_msgs_py.config.facts import CHANNELS, FORCE_DRIVEN
from seft_msgs_py.config.registered import line_in, reason_of
from seft_msgs_py.errors import ExperimentError, InputError
from seft_msgs_py.wire.topics import REFERENCE_FORCE, VALVE_COMMAND, RigAxes

from seft_plant_sim import channels
from seft_plant_sim.hardware.safe_stop import Safe, SafeStop, Stopped
from seft_plant_sim.hardware.udp import UdpHardware
from seft_plant_sim.rig_parameters import HARDWARE, UDP


class Hardware(Protocol):
    """What a laboratory writes: a class, made as ``CLASS(parameters, axes)``.

    ``parameters`` are those of the rig, by name; ``axes`` the names of its n axes. All calls come
    from one thread, and must not take longer than a sampling period.

    Two attributes are optional: ``can_wait``, whether ``read`` gives the sample after the last
    ``write``, however late it is called (for lockstep; default False); ``is_clock``, whether
    ``read`` waits for the next sample of a controller, which then is the clock (default False). So
    is a method ``dump_pressure()``: called where a piston goes on after its valve was closed.
    """

    def read(self) -> Floats:
        """Read all channels at one instant.

        Returns
        -------
        ndarray
            Displacement, velocity, acceleration and force of each axis, shape (4, n), in SI units,
            or in volts (``calibration.*_per_volt``); NaN throughout for what is derived.
        """

    def write(self, drive: Floats) -> None:
        """Put out the valve commands, V, shape (n,); positive extends the actuator.

        Of a position_servo displacements, m, from where it stood when this object was made.
        """

    def safe(self) -> None:
        """Bring the rig to rest, whatever it is in, and keep it there until the next `write`.

        A position_servo holds its last displacement.
        """

    def close(self) -> None:
        """Give the devices back."""


class HardwareError(ExperimentError):
    """Something that a laboratory's hardware did wrong, in one line with its file and line."""


class HostedHardware:
    """Checks each call of a `Hardware`, and gives its samples in SI units.

    Parameters
    ----------
    section, axes
        The rig's section, and the names of all axes.
    rig : RigAxes
        Those that it moves.
    period : float
        Longest duration of a call at the pace realtime, s: the sampling period.
    now : callable
        Monotonic time, s.
    device : Hardware, optional
        The laboratory's; default what ``rig: hardware`` names. The first command of each test is
        where a displacement servo stands.

    Raises
    ------
    InputError
        If it can't be made, or lacks a method; if it is to have simulated faults.

    Attributes
    ----------
    drive : str
        Topic that it obeys.
    can_wait, is_clock : bool
        See `Hardware`.
    saturated : int
        0: nobody knows what of a real rig is saturated beside its sensors.
    """

    saturated = 0

    def __init__(
        self,
        section: Mapping[str, Any],
        axes: tuple[str, ...],
        rig: RigAxes,
        period: float,
        now: Callable[[], float],
        device: Hardware | None = None,
    ) -> None:
        self._name, self._axes, self._now = section["hardware"], rig.axes, now
        if section["faults"]:
            raise InputError("rig: faults are those of a simulated rig; leave them out")
        safe = Safe.from_parameters(section, axes, rig.places, period)
        known = {**section, "safe.valve_command": safe.command.tolist()}
        self._device = _device(known, rig.axes) if device is None else device
        needed = ("read", "write", "safe", "close")
        missing = [each for each in needed if not callable(getattr(self._device, each, None))]
        if missing:
            raise InputError(f"rig: hardware: {self._name} has no method {', '.join(missing)}")
        force_driven = section["actuator.kind"] in FORCE_DRIVEN
        self.drive = (REFERENCE_FORCE if force_driven else VALVE_COMMAND).name
        every = channels.per_channel(section, axes, "calibration.{}_per_volt")
        self._per_volt = every[:, list(rig.places)]  # SI units per unit of the device's channels
        derived = [channels.velocity_is_derived(section), channels.acceleration_is_derived(section)]
        self._derived = list(compress((channels.VELOCITY, channels.ACCELERATION), derived))
        self._period = np.inf if section["pace"] == "lockstep" else period  # where the rig waits
        self._holds = safe.holds
        # of a displacement servo: its last command, and that of it where a test's is 0
        self._held = np.zeros(len(rig.axes))
        self._base = None if safe.holds else np.zeros(len(rig.axes))
        self.can_wait: bool = getattr(self._device, "can_wait", False)
        self.is_clock: bool = getattr(self._device, "is_clock", False)
        self._remote = self._device if isinstance(self._device, UdpHardware) else None
        self._stop: SafeStop | None = None
        self._is_missing = False  # the last sample
        self._file = None
        with suppress(TypeError):  # of a class of an extension module
            self._file = inspect.getsourcefile(type(self._device))

    def read(self) -> Floats:
        """Read a sample, shape (4, n), in SI units.

        Raises
        ------
        HardwareError
            If the device raises an exception, takes longer than a period, or gives no such sample.
        """
        given = self._call("read", longest=np.inf if self.is_clock else 1.0)
        try:
            sample = np.array(given, np.float64)
        except (TypeError, ValueError):
            raise self._wrong("read", f" gave no numbers, but {given!r:.80}") from None
        if sample.shape != self._per_volt.shape:
            rows = "(displacement, velocity, acceleration, force; axes)"
            what = f" gave an array of shape {sample.shape}, not {self._per_volt.shape} {rows}"
            raise self._wrong("read", what)
        sample *= self._per_volt
        self._is_missing = bool(np.isnan(sample).all())
        sample[self._derived] = 0.0
        if not (self._remote or np.isfinite(sample).all()):  # a lost sample is judged
            row, axis = np.argwhere(~np.isfinite(sample))[0].tolist()
            what = f" gave {sample[row, axis]} for the {CHANNELS[row]} of axis {self._axes[axis]}"
            if row in (channels.VELOCITY, channels.ACCELERATION):
                what += f"; if it has no such sensor, give /**: sensors.{CHANNELS[row]}: derived"
            raise self._wrong("read", what)
        return sample

    def write(self, drive: Floats) -> None:
        """Put out a command, shape (n,), V, m or N, see `drive`."""
        if self._base is None:
            self._base = self._held - drive
        self._held = self._base + drive
        self._call("write", self._held.copy())

    def safe(self) -> None:
        """Bring the rig to its safe command now; a stop goes on with that."""
        self._close_valve()
        if self._stop is not None:
            self._stop.is_closed = True

    def close(self) -> None:
        """Bring the rig to its safe command, and give the devices back."""
        try:
            self.safe()
        finally:
            self._call("close", longest=np.inf)

    def at_rest(self, count: int) -> Floats:
        """Give samples at rest, if the device can wait, shape (N, 4, n): so many, or none."""
        samples = [self.read() for _ in range(count if self.can_wait else 0)]
        return np.array(samples).reshape(-1, *self._per_volt.shape)

    def reset(self) -> None:
        """Begin a test, wherever the rig is."""
        self._stop = None
        if self._holds:
            self._base = None

    def check(self) -> None:
        """Nothing else can be wrong."""

    @property
    def missing(self) -> str:
        """Say that a controller's last sample did not come; empty if it did."""
        return self._remote.missing() if self._remote and self._is_missing else ""

    def stop(self, plan: Floats, planned: Floats | None, last: Floats, safe: Safe) -> None:
        """Begin to obey a plan, and then to close the valve, see `SafeStop`."""
        dump = getattr(self._device, "dump_pressure", None)
        self._stop = SafeStop(
            self.write, self._close_valve, plan, planned, last, safe, dump and self._dump
        )
        self._stop.command()

    def come_to_rest(self, measured: Floats) -> Stopped | None:
        """Continue a stop with a sample, shape (4, n), or NaN; give its end when it is at rest.

        If it does not come to rest, that is said after ``Safe.longest`` steps.
        """
        stopped = self._stop.next(measured) if self._stop is not None else None
        if stopped is not None:
            self._stop = None
        return stopped

    def simulated(self, first: int | None = None) -> None:
        """Nobody knows the true motion."""

    @property
    def counts(self) -> Mapping[str, int]:
        """Number of datagrams that were not obeyed, by kind, of a controller at the other end."""
        return self._remote.counts if self._remote else {}

    @property
    def is_stopping(self) -> bool:
        """Whether a stop is under way."""
        return self._stop is not None

    @property
    def is_closing(self) -> bool:
        """Whether the valve of a stop is not closed yet."""
        return self._stop is not None and not self._stop.is_closed

    def _close_valve(self) -> None:
        self._call("safe", longest=np.inf)

    def _dump(self) -> None:
        self._call("dump_pressure", longest=np.inf)

    def _call(self, method: str, *arguments: Any, longest: float = 1.0) -> Any:
        begun = self._now()
        try:
            result = getattr(self._device, method)(*arguments)
        except (Exception, SystemExit) as error:
            if self._remote:
                raise HardwareError(reason_of(error)) from error
            raise self._wrong(method, f": {reason_of(error)}", error) from error
        took = self._now() - begun
        if took > longest * self._period and not self._remote:  # which has its own timeout
            period = f"more than a period of {self._period * 1e3:g} ms"
            raise self._wrong(method, f" took {took * 1e3:.3g} ms, {period}")
        return result

    def _wrong(self, method: str, what: str, error: BaseException | None = None) -> HardwareError:
        """Make the error of a call, with the method's file and the line, by default its first."""
        code = getattr(inspect.unwrap(getattr(self._device, method)), "__code__", None)
        if code is None:  # of an extension module
            return HardwareError(f"{self._name}: {method}(){what}")
        line = line_in(error, code.co_filename) if error is not None else ""
        line = line or f" line {code.co_firstlineno}"
        inherited = f", {Path(code.co_filename).name}" if code.co_filename != self._file else ""
        return HardwareError(f"{self._name}{inherited}{line}: {method}(){what}")


def _device(section: Mapping[str, Any], axes: tuple[str, ...]) -> Hardware:
    """Make the hardware that a rig's section names."""
    name = section["hardware"]
    try:
        if name == UDP:
            return UdpHardware(section, axes)
        made: Hardware = HARDWARE.make(name, "", "rig: hardware", section, axes)
    except InputError:
        raise
    except (Exception, SystemExit) as error:
        below = traceback.extract_tb(error.__traceback__)[2:]  # this function and `make`
        line = line_in(error, below[0].filename) if below else ""
        why = f"can't be made: {reason_of(error)}"
        raise InputError(f"rig: hardware: {name}{line} {why}") from None
    return made
