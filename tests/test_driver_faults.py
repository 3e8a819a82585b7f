"""Whatever goes wrong in the template of a driver, its hardware goes to the safe position."""

import sys
import time
from types import SimpleNamespace

import numpy as np
import pytest
import quiet_shell
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.wire.messages import Status
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


class Shell(quiet_shell.Shell):
    """A node's shell without a network: tells of a fault as the process does, at the next turn."""

    def __init__(self, experiment, turns):
        super().__init__(experiment, "rig")
        self.rig, self.stopping = RigAxes.whole(experiment.axes), False
        self.reports, self._turns = [], turns

    def report(self, status):
        self.reports.append(status)

    def attempt(self, what, call):
        try:
            call()
        except OSError as error:
            self.faults.append(f"a fault of the program in {what}: {error}")

    def spin_once(self, timeout):
        while self.faults:
            self.node.fault(self.faults.pop())
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
        node._supervision.wanted = Status("experiment", 0, "running", values={"steps": "1000000"})
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


class Pump:
    """Valves that are written to, and a pump whose pressure is counted away."""

    def __init__(self):
        self.written, self.dumped = [], 0

    def write_command(self, volts):
        self.written.append(volts.tolist())

    def to_safe_position(self):
        self.written.append("safe")

    def dump_pressure(self):
        self.dumped += 1


MAX_SKEW_S = 2.0**-10  # m


def two_axes(hardware, close_time=0.008):
    from rig_driver.safe_stop import SafeStop

    safe = np.array([0.5, -0.25])
    return SafeStop(hardware, safe, close_time, farthest=MAX_SKEW_S, dt=0.002, sleep=time.sleep)


def follow(stop, *displacements):
    for each in displacements:
        stop.follow(np.array([0.25, each]))


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_pressure_goes_once_at_the_first_sample_too_far_from_where_the_valve_had_closed(
    driver, sign
):
    pump = Pump()
    stop = two_axes(pump)
    follow(stop, *range(100))
    assert (pump.written, pump.dumped) == ([], 0)  # nothing has been stopped
    assert not stop.has_dumped
    for count, at in ((1, 0.5), (2, -0.5)):
        stop.begin(np.array([5.0, -3.0]))
        assert not stop.has_dumped
        follow(stop, *range(3 + 25))  # it closes, and the oil answers
        far = sign * MAX_SKEW_S
        follow(stop, at, at + far, at + 0.5 * far)
        assert (pump.dumped, stop.has_dumped) == (count - 1, False)
        follow(stop, np.nextafter(at + far, sign * 9.0))
        assert (pump.dumped, stop.has_dumped) == (count, True)
        follow(stop, *range(100))
        assert pump.dumped == count
    assert len(pump.written) == 8


def test_the_pressure_goes_also_where_the_valve_was_closed_at_once(driver):
    pump = Pump()
    stop = two_axes(pump)
    stop.begin(np.array([5.0, -3.0]))
    follow(stop, *range(3 + 26))  # it stands where the last of these says
    stop.at_once()
    follow(stop, *range(25), 7.0, 7.0)
    assert pump.dumped == 0
    follow(stop, 7.1)
    assert pump.dumped == 1
    assert pump.written[4:] == ["safe"]
    stop.begin(np.array([5.0, -3.0]))
    stop.at_once()  # while the valve closes, which ends that
    follow(stop, *range(5))
    assert pump.written[6:] == ["safe"]
    stop = two_axes(pump, close_time=0.0)
    stop.at_once()
    follow(stop, *range(26), 9.0)
    assert pump.dumped == 2


def test_each_valve_goes_from_its_command_to_its_safe_value(driver, monkeypatch):
    pump, command, waits = Pump(), np.array([4.5, -4.25]), []
    monkeypatch.setattr(time, "sleep", waits.append)
    stop = two_axes(pump)
    stop.finish()
    assert pump.written == []
    stop.begin(command)
    command[:] = 9.0  # of the next test
    follow(stop, 0.0)
    stop.finish()
    left = 0.5 * (1.0 + np.cos(np.pi * np.arange(1, 4) / 4))
    expected = np.array([0.5, -0.25]) + left[:, np.newaxis] * [4.0, -4.0]
    np.testing.assert_allclose(pump.written[:-1], expected, rtol=1e-14)
    assert pump.written[-1] == "safe"
    assert waits == [0.002] * 2
    two_axes(pump, close_time=0.0).begin(command)
    assert pump.written[4:] == ["safe"]


def test_a_rig_whose_pressure_nobody_can_take_away_is_followed_without(driver):
    hardware = SimpleNamespace(write_command=lambda volts: None, to_safe_position=lambda: None)
    stop = two_axes(hardware)
    stop.begin(np.zeros(2))
    follow(stop, *range(100))
    assert not stop.has_dumped


def test_a_rig_rests_once_its_mean_velocity_of_50_ms_is_small_on_each_axis(driver):
    from rig_driver.rest import Rest

    def reached(*velocities, force=0.0):
        """Whether it rests after each of some samples."""
        samples = (np.array([[9, 9], [0, v], [9, 9], [0, force]]) for v in velocities)
        return [rest.is_reached(sample) for sample in samples]

    rest = Rest(0.25, 0.002)
    noise = [1.0, -1.0] * 12
    assert reached(*noise, 0.0) == [False] * 24 + [True]
    rest.begin()
    assert reached(*noise[::-1], -6.25) == [False] * 25  # at the limit, and backwards
    assert reached(1.0) == [True]
    assert reached(*[-0.5] * 30)[-1] is False
    assert rest.time == pytest.approx(56 * 0.002)
    assert reached(0.0, force=-70.0) + reached(0.0, force=50.0) == [False] * 2
    assert rest.peak_force == 70.0
    rest.begin()
    assert (rest.time, rest.peak_force, reached(0.0)) == (0.0, 0.0, [False])
    rest = Rest(0.25, 0.1)  # a sample is longer than that
    assert reached(0.25, 0.2) == [False, True]
    rest.begin()
    assert reached(0.2) == [True]
