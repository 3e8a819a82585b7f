"""Whatever goes wrong in the template of a driver, its hardware goes to the safe position."""

import sys
import time
from types import SimpleNamespace

import numpy as np
import pytest
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.wire.topics import RigAxes
from seft_ros.cli.rig_commands import TEMPLATES

TEMPLATE = TEMPLATES / "rig_driver"


class Hardware:
    """Converters that can fail."""

    def __init__(self):
        self.calls, self.fails, self.takes = [], False, 0.0

    def read_sample(self):
        if self.fails:
            time.sleep(self.takes)
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


@pytest.mark.parametrize("takes", [0.0, 1.2])
@pytest.mark.parametrize("phase", ["idle", "running"])
def test_a_fault_brings_the_hardware_to_its_safe_position_and_the_driver_lives_on(
    driver, phase, takes
):
    node, hardware = driver.node, driver.hardware
    hardware.takes = takes * node._timebase.dt  # beyond a period: no wait before the next sample
    if phase == "running":
        node._told, node._total = "running", 10**6
        node._begin(np.zeros((4, 1)))
        hardware.calls.clear()
    hardware.fails = True
    node.run()
    assert set(hardware.calls) <= {"safe", "write", "close"}
    # one before the first fault, and one that begins to close the valve
    assert hardware.calls.count("write") == 2 * (phase == "running")
    assert "safe" in hardware.calls[-4:-2]
    assert hardware.calls[-2:] == ["safe", "close"]
    if phase == "running":
        trip = driver.shell.reports[-1].values
        assert trip["phase"] == "tripped"
        assert "the converter does not answer" in trip["reason"]


class Valve:
    """A valve that is written to, and a pump."""

    def __init__(self):
        self.written, self.has_pressure = [], True

    def write_command(self, volts):
        self.written.append(volts[0])

    def to_safe_position(self):
        self.written.append(0.0)

    def dump_pressure(self):
        self.has_pressure = False


def stop_of(valve):
    from rig_driver.safe_stop import SafeStop

    return SafeStop(valve, np.zeros(1), close_time=0.02, farthest=0.001, dt=0.002)


def test_a_valve_closes_within_its_time(driver):
    valve = Valve()
    stop = stop_of(valve)
    stop.begin(np.array([5.0]))
    for _ in range(30):
        stop.follow(np.array([0.01]))
    np.testing.assert_allclose(
        valve.written, 2.5 * (1.0 + np.cos(np.pi * np.arange(1, 11) / 10.0)), atol=1e-12
    )
    assert valve.has_pressure
    stop.begin(np.array([-5.0]))
    stop.finish()
    assert valve.written[-1] == 0.0
    assert len(valve.written) == 20


def test_a_piston_that_goes_on_loses_its_pressure(driver):
    valve = Valve()
    stop = stop_of(valve)
    stop.begin(np.array([5.0]))
    moved = 0.01 + 0.0002 * np.arange(60)
    for x in moved[:10]:
        stop.follow(np.array([x]))
    assert valve.has_pressure  # it may move until the valve is closed
    for x in moved[10:]:
        stop.follow(np.array([x]))
    assert stop.has_dumped
    assert not valve.has_pressure


def test_a_fault_while_the_valve_closes_ends_that(driver):
    valve = Valve()
    stop = stop_of(valve)
    stop.begin(np.array([5.0]))
    stop.at_once()
    for _ in range(5):
        stop.follow(np.zeros(1))
    assert valve.written[1:] == [0.0]
