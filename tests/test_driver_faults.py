"""How the template of a driver brings its valves to their safe command, and its rig to rest."""

import time
from types import SimpleNamespace

import numpy as np
import pytest

pytestmark = pytest.mark.usefixtures("template")


class Pump:
    """Valves that are written to, and a pump whose pressure is counted away."""

    def __init__(self):
        self.written, self.dumped = [], 0

    def write_command(self, volts):
        self.written.append(volts.tolist())

    def to_safe_command(self):
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
def test_the_pressure_goes_once_at_the_first_sample_too_far_from_where_the_valve_had_closed(sign):
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


def test_the_pressure_goes_also_where_the_valve_was_closed_at_once():
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


def test_each_valve_goes_from_its_command_to_its_safe_value(monkeypatch):
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


def test_a_rig_whose_pressure_nobody_can_take_away_is_followed_without():
    hardware = SimpleNamespace(write_command=lambda volts: None, to_safe_command=lambda: None)
    stop = two_axes(hardware)
    stop.begin(np.zeros(2))
    follow(stop, *range(100))
    assert not stop.has_dumped


def test_a_rig_rests_once_its_mean_velocity_of_50_ms_is_small_on_each_axis():
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
