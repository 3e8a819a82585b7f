"""What the supervisor makes of what nodes tell, without a network."""

import pytest
from quiet_shell import Shell
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.node.clock import AwakeClock
from seft_msgs_py.wire.messages import Status, decode_status, encode_diagnostics
from seft_msgs_py.wire.outcome import State, tripped_status
from seft_msgs_py.wire.topics import DIAGNOSTICS
from seft_ros.test_run.parameter_tables import TABLES

supervisor = pytest.importorskip("seft_ros.nodes.supervisor_node")


class Watched:
    """A supervisor in a test that runs, of whose nodes each may tell something or be silent."""

    def __init__(self):
        self.shell = Shell(Experiment.load(TABLES, [], [], nodes=["supervisor"]), "supervisor")
        self.node = supervisor.SupervisorNode(self.shell)
        self._now = 0.0
        self.node._awake = AwakeClock(lambda: self._now)
        self.peers = self.shell.experiment["supervisor"]["peers"]
        self.node._machine.peers("")
        assert self.node._machine.start().accepted

    def tell(self, status):
        self.shell.handlers[DIAGNOSTICS.name](encode_diagnostics(0, [status]), 0)

    def wait(self, seconds, *silent):
        """Let time go by in which all nodes give signs of life but for some."""
        for _ in range(round(seconds / 0.1)):
            self._now += 0.1
            for node in set(self.peers) - set(silent):
                self.tell(Status(node, 0, "", values={"phase": "x"}))
            self.node.poll()

    @property
    def state(self):
        return decode_status(self.shell.sent[-1][1])

    def ask(self, service):
        return self.shell.services[service]()


@pytest.fixture
def test():
    return Watched()


def test_what_a_silent_node_has_done_meanwhile_is_added_when_its_link_is_back(test):
    test.wait(1.0)
    test.wait(3.0, "rig", "force_controller")
    detail = test.state.values["detail"]
    assert test.state.message == State.TRIPPED
    assert detail.startswith("node force_controller has been silent since")
    cut = "no reference_force for 50 steps; is the link to the reference_force node cut?"
    for _ in range(3):  # it says so again and again
        test.tell(tripped_status("force_controller", cut, 100))
        test.tell(tripped_status("rig", "stopped", 120))
        test.tell(tripped_status("reference_force", "something that follows", 120))
    assert test.state.values["detail"] == f"{detail}; force_controller: {cut}"
