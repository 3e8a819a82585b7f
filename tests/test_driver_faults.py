"""Whatever goes wrong in the template of a driver, its hardware goes to the safe position."""

import sys
import time
from types import SimpleNamespace

import numpy as np
import pytest
from graph_tools import ROOT
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.wire.rigs import RigAxes

TEMPLATE = ROOT / "templates" / "rig_driver"


class Hardware:
    """Converters that can fail."""

    def __init__(self):
        self.calls, self.fails = [], False

    def read_sample(self):
        if self.fails:
            raise OSError("the converter does not answer")
        return np.zeros((4, 1))

    def write_command(self, volts):
        self.calls.append("write")

    def to_safe_position(self):
        self.calls.append("safe")

    def close(self):
        self.calls.append("close")


class Shell:
    """A node's shell without a network: tells of a fault as the process does, at the next turn."""

    def __init__(self, experiment, turns):
        self.experiment, self.rig = experiment, RigAxes.whole(experiment.axes)
        self.name, self.stopping = "rig", False
        self.reports, self._faults, self._turns = [], [], turns

    def publisher(self, topic):
        return lambda raw: None

    def subscribe(self, topic, handler, **_):
        """Nothing comes."""

    def several_senders(self):
        return ""

    def report(self, status):
        self.reports.append(status)

    def attempt(self, what, call):
        try:
            call()
        except OSError as error:
            self._faults.append(f"a fault of the program in {what}: {error}")

    def spin_once(self, timeout):
        while self._faults:
            self.node.fault(self._faults.pop())
        time.sleep(timeout)
        self._turns -= 1
        self.stopping = self._turns <= 0


@pytest.fixture
def driver(monkeypatch):
    monkeypatch.syspath_prepend(str(TEMPLATE))
    from rig_driver.driver_node import DriverNode
    from rig_driver.parameters import TABLE

    patient = [("rig", f"watchdog.{who}_timeout", 60.0) for who in ("command", "supervisor")]
    file = TEMPLATE / "config" / "rig.yaml"
    shell = Shell(Experiment.load([TABLE], [file], patient), turns=20)
    hardware = Hardware()
    shell.node = DriverNode(shell, hardware)
    yield SimpleNamespace(shell=shell, hardware=hardware, node=shell.node)
    for name in [name for name in sys.modules if name.startswith("rig_driver")]:
        del sys.modules[name]


@pytest.mark.parametrize("phase", ["idle", "running"])
def test_a_fault_brings_the_hardware_to_its_safe_position_and_the_driver_lives_on(driver, phase):
    node, hardware = driver.node, driver.hardware
    if phase == "running":
        node._told, node._total = "running", 10**6
        node._begin(np.zeros((4, 1)))
        hardware.calls.clear()
    hardware.fails = True
    node.run()
    assert set(hardware.calls) <= {"safe", "write", "close"}
    assert hardware.calls.count("write") == (phase == "running")  # before the first fault
    assert "safe" in hardware.calls[-4:-2]
    assert hardware.calls[-2:] == ["safe", "close"]
    if phase == "running":
        trip = driver.shell.reports[-1].values
        assert trip["phase"] == "tripped"
        assert "the converter does not answer" in trip["reason"]
