"""A driver of a rig that is bad at all that only its process can show: the template's, broken.

python -m bad_drivers --ros-args --params-file FILE
"""

import sys
from types import SimpleNamespace

from rig_driver.driver_node import DriverNode, stand_in
from rig_driver.parameters import TABLE
from seft_msgs_py.node.node_kind import NodeKind
from seft_plant_sim.command import MessagesAhead


class Careless(DriverNode):
    """Applies whatever number comes last, of whatever step; a trip is over with the next ready.

    It counts steps without a command, and no time: it goes on as if it had never stood still.
    """

    def __init__(self, shell, hardware):
        super().__init__(shell, hardware)
        longest = self._section["watchdog.command_timeout"] / self._timebase.dt
        command = self._command

        def fault(now, step, answered):
            return "no new valve_command" if step - answered > longest else ""

        def take(raw):
            _, values = command.codec.decode(raw)
            command.step = command.current
            command._messages = MessagesAhead(0, values[:, 0])

        self._watch = SimpleNamespace(begin=lambda now: None, fault=fault)
        command.take = take

    def _on_experiment_state(self, raw, at):
        self._supervision.latched = False
        super()._on_experiment_state(raw, at)


if __name__ == "__main__":
    sys.exit(NodeKind(TABLE, [TABLE], lambda shell: Careless(shell, stand_in(shell))).main())
