"""A rig between two tests: its samples go on, it comes to rest, its hardware may fail."""

from collections.abc import Callable
from contextlib import suppress
from typing import Any

from seft_msgs_py.node.node_shell import IDLE_WAIT, NodeShell

from seft_plant_sim.hardware.hosted import HardwareError
from seft_plant_sim.hardware.safe_stop import Stopped
from seft_plant_sim.rig import Rig
from seft_plant_sim.rig_watch import EARLY


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
        rig = self._rig
        is_closing = rig.hardware.is_closing  # which goes on without samples
        is_read = self.attempt(rig.read, is_safe=is_closing) is not None
        if is_read and self.failure:
            self.failure = ""
            self._tell("")
        if rig.hardware.is_clock:
            self.due = self._shell.clock.monotonic() + (1 - EARLY) * self._period
        if not (is_read or is_closing):
            return
        if (stopped := self.attempt(rig.come_to_rest)) is not None:
            self._at_rest(stopped)

    def attempt(self, call: Callable[[], Any], *, is_safe: bool = False) -> Any:
        """Call the hardware; at a fault it goes to its safe command.

        Unless it ``is_safe`` to do nothing. The result is None then.
        """
        try:
            return call()
        except HardwareError as error:
            if self.failure != str(error):
                self.failure = str(error)
                self._shell.log("error", self.failure)
                self._tell(self.failure)
            with suppress(HardwareError):
                if not is_safe:
                    self._rig.hardware.safe()
        return None
