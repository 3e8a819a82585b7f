"""How a rig is stopped: the valve closes, and the pressure goes where it does not."""

from collections.abc import Callable

import numpy as np
import numpy.typing as npt
from seft_plant_sim.simulated.rig import left_open

from rig_driver.hardware import Hardware

Floats = npt.NDArray[np.float64]

ANSWERS_IN = 0.05
"""Time that a valve and the oil have after that, s, before the piston must stand."""


class SafeStop:
    """Brings the valves from their last command to the safe command.

    Not at once: a valve that closes on a moving mass M makes the oil hammer with v sqrt(k M).

    Parameters
    ----------
    hardware : Hardware
        The rig. If it has ``dump_pressure()``, that is called where a piston goes on.
    safe : ndarray
        Safe command of the valve, V, shape (n,).
    close_time : float
        Time in which the valves go there, s.
    farthest : float
        Displacement beyond which a piston with a closed valve goes on, m.
    dt : float
        Sampling period, s.
    sleep : callable
        Waits for a time in s; the clock's of the node.

    Attributes
    ----------
    has_dumped : bool
        Whether the pressure was taken away.
    """

    def __init__(
        self,
        hardware: Hardware,
        safe: Floats,
        close_time: float,
        farthest: float,
        dt: float,
        sleep: Callable[[float], None],
    ) -> None:
        self._hardware, self._safe, self._max_skew = hardware, safe, farthest
        self._dt, self._sleep = dt, sleep
        self._steps, self._answers = round(close_time / dt), round(ANSWERS_IN / dt)
        self._taken, self.has_dumped = -1, False
        self._command = safe
        self._stands: Floats | None = None

    def begin(self, command: Floats) -> None:
        """Begin to close the valves from a command, V, shape (n,)."""
        self._command, self._taken, self.has_dumped = command.copy(), 0, False
        self._stands = None
        self._close()

    def at_once(self) -> None:
        """Go to the safe command now: who should close the valve can't."""
        self._hardware.to_safe_command()
        self._taken, self._stands = self._steps, None

    def follow(self, displacement: Floats) -> None:
        """Go on at the next sample, which has this displacement, m, shape (n,)."""
        if self._taken < 0 or self.has_dumped:
            return
        if self._taken < self._steps:
            self._close()
            return
        self._taken += 1
        if self._taken <= self._steps + self._answers:
            return
        if self._stands is None:
            self._stands = displacement.copy()
        dump = getattr(self._hardware, "dump_pressure", None)
        if dump and np.abs(displacement - self._stands).max() > self._max_skew:
            dump()
            self.has_dumped = True

    def finish(self) -> None:
        """Close the valves to the end, before the node ends."""
        while 0 <= self._taken < self._steps:
            self._sleep(self._dt)
            self._close()

    def _close(self) -> None:
        self._taken += 1
        if self._taken >= self._steps:
            self._hardware.to_safe_command()
            return
        left = left_open(self._taken, self._steps)
        self._hardware.write_command(self._safe + left * (self._command - self._safe))
