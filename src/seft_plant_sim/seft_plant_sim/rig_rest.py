"""A rig between two tests: its samples go on, it comes to rest, its hardware may fail."""

from collections.abc import Callable
from contextlib import suppress
from functools import partial
from typing import Any

from seft_msgs_py.node.node_shell import IDLE_WAIT, NodeShell

from seft_plant_sim.hardware.hosted import HardwareError
from seft_plant_sim.hardware.safe_stop import Stopped
from seft_plant_sim.rig import Rig
from seft_plant_sim.rig_watch import EARLY

SOON = 1.0  # s, for which a failure of the hardware counts; and between two that are told


class RigRest:
    """Keeps a rig at rest between two tests.

    Parameters
    ----------
    shell : NodeShell
        Of the rig.
    rig : Rig
        Its hardware is called.
    period : float
        Sampling period, s.
    is_sampled : bool
        Whether its samples go on.
    tell : callable
        Called with what is wrong with the hardware; with nothing when that is over.
    at_rest : callable
        Called with the end of a stop that went on after its test.

    Attributes
    ----------
    due : float
        Time of the next sample, s, monotonic.
    failure : str
        What is wrong with the hardware.
    """

    def __init__(
        self,
        shell: NodeShell,
        rig: Rig,
        period: float,
        *,
        is_sampled: bool,
        tell: Callable[[str], None],
        at_rest: Callable[[Stopped], None],
    ) -> None:
        self._shell, self._rig, self._period = shell, rig, period
        self._is_sampled, self._tell, self._at_rest = is_sampled, tell, at_rest
        self.due, self.failure = shell.clock.monotonic(), ""
        self._failed_at = self._told_at = 0.0

    def turn(self, longest: float = IDLE_WAIT) -> None:
        """Handle messages; take a sample that is due, or wait at most ``longest`` s."""
        if not (self._is_sampled or self._rig.hardware.is_stopping):
            self._shell.spin_once(longest)
            return
        now = self._shell.clock.monotonic
        while self._is_sampled and (left := self.due - now()) > 0:
            self._shell.spin_once(left)
        self._shell.spin_once(0.0)
        self.due = max(self.due + self._period, now())  # after a stall it goes on from here
        self.sample()

    def sample(self) -> None:
        """Take a sample, and continue a stop."""
        rig, hardware = self._rig, self._rig.hardware
        is_read = self.attempt(rig.read, is_safe=hardware.is_closing) is not None
        now = self._shell.clock.monotonic()
        if is_read and self.failure and now - self._failed_at >= SOON:
            self.failure = ""
            self._tell("")
        if hardware.is_clock:  # a stop takes each sample at once
            self.due = now + (not hardware.is_stopping) * (1 - EARLY) * self._period
        stopped = self.attempt(partial(rig.come_to_rest, is_read=is_read))
        if stopped is not None:
            self._at_rest(stopped)

    def attempt(self, call: Callable[[], Any], *, is_safe: bool = False) -> Any:
        """Call the hardware; at a fault it goes to its safe command.

        Unless it ``is_safe`` to do nothing. The result is None then.
        """
        try:
            return call()
        except HardwareError as error:
            self._failed_at = now = self._shell.clock.monotonic()
            if not self.failure or (self.failure != str(error) and now - self._told_at >= SOON):
                self.failure, self._told_at = str(error), now
                self._shell.log("error", self.failure)
                self._tell(self.failure)
            with suppress(HardwareError):
                if not is_safe:
                    self._rig.hardware.safe()
        return None
