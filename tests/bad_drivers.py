"""Drivers of a rig with one fault each: the template's, deliberately broken.

python -m bad_drivers FAULT --ros-args --params-file FILE
"""

import sys
from types import SimpleNamespace

from rig_driver.driver_node import DriverNode, stand_in
from rig_driver.parameters import TABLE
from seft_msgs_py.node.node_kind import NodeKind
from seft_msgs_py.node.node_shell import NodeShell
from seft_plant_sim.command import MessagesAhead

TIMEOUT = "watchdog.command_timeout"


class NoSafePosition(DriverNode):
    """Its valve stays where it is when the test is over."""

    def __init__(self, shell, hardware):
        super().__init__(shell, hardware)
        nothing = {name: lambda *_: None for name in ("begin", "follow", "finish", "at_once")}
        self._stop = SimpleNamespace(has_dumped=False, **nothing)


class NoWatchdog(DriverNode):
    """A command that does not come is held for ever."""

    def __init__(self, shell, hardware):
        super().__init__(shell, hardware)
        self._watch = SimpleNamespace(begin=lambda now: None, fault=lambda *_: "")


class StandsStill(DriverNode):
    """Counts steps without a command, and no time: it goes on as if it had never stood still."""

    def __init__(self, shell, hardware):
        super().__init__(shell, hardware)
        longest = self._section[TIMEOUT] / self._timebase.dt

        def fault(now, step, answered):
            return "no new valve_command" if step - answered > longest else ""

        self._watch = SimpleNamespace(begin=lambda now: None, fault=fault)


class Careless(DriverNode):
    """Applies whatever number comes last, of whatever step; a trip is over with the next ready."""

    def __init__(self, shell, hardware):
        super().__init__(shell, hardware)
        command = self._command

        def take(raw):
            _, values = command.codec.decode(raw)
            command.step = command.current
            command._messages = MessagesAhead(0, values[:, 0])

        command.take = take

    def _on_experiment_state(self, raw, at):
        self._supervision.latched = False
        super()._on_experiment_state(raw, at)


NODES = {
    "no_safe_position": NoSafePosition,
    "no_watchdog": NoWatchdog,
    "stands_still": StandsStill,
    "careless": Careless,
}


def main() -> int:
    fault = sys.argv.pop(1)

    def make(shell: NodeShell) -> DriverNode:
        return NODES[fault](shell, stand_in(shell))

    return NodeKind(TABLE, [TABLE], make).main()


if __name__ == "__main__":
    sys.exit(main())
