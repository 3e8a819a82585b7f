"""The tests of an identification as experiments, run offline."""

import math
import re

import numpy as np
import pytest
from experiments_at_hand import load, simulated
from seft_msgs_py.config.parameter_table import group
from seft_msgs_py.errors import InputError
from seft_plant_sim.limits import Limits, exceeds
from seft_plant_sim.simulated.specimen import Specimen
from seft_ros.ground_motion.synthetic_motion import excitation
from seft_ros.identification import rig_tests
from seft_ros.identification.rig_tests import LargestLevels, Levels, open_loop, pilot_voltage
from seft_ros.protection.protected_force import PlausibleForce, is_plausible

VOLTAGE = 0.1
LINEAR = "/**:actuator.kind:=servo_hydraulic_linear"


@pytest.fixture
def record(tmp_path):
    """A record for an experiment, of 10 s, and the unit excitation in it."""

    def make(of):
        band, seed = (1.0, 100.0), 1
        motions = rig_tests.Motions(of, band, seed)
        unit = excitation(5000, len(of.axes), of.timebase.dt, band, seed)
        return motions.write(tmp_path / "record.csv", 10.0), unit

    return make


TWO_AXES = ("axes:=[x, y]", "/**:specimen.mass:=[52.7, 3.0, 3.0, 40.0]")


@pytest.mark.parametrize("overrides", [(), TWO_AXES])
@pytest.mark.parametrize("mass_ratio", [0.0, 2.0])
def test_in_the_open_loop_the_record_drives_the_valves(record, overrides, mass_ratio):
    motion = ("ground_motion:peak_force:=1000.0", "ground_motion:influence:=2.0")
    of = load(*overrides, f"reference_force:mass_ratio:={mass_ratio}", *motion)
    path, unit = record(of)
    done = simulated(open_loop(of, path, VOLTAGE))
    commands = done.series["valve_command"].values[:, 0]
    np.testing.assert_allclose(commands[: len(unit)], VOLTAGE * unit, atol=1e-9)
    np.testing.assert_allclose(commands[len(unit) :], 0.0, atol=1e-9)
    assert np.abs(done.series["rig/state"].values[:, 3]).max() > 100.0


def unit_of(of, band=(0.3, 200.0), duration=20.0):
    return excitation(round(duration * of.timebase.rate), 1, of.timebase.dt, band, 1)


@pytest.mark.parametrize(
    ("levels", "message"),
    [
        (Levels(3.0, 200.0), "--amplitude is 3 V RMS.* and 2.16 V at most: .*limits.command"),
        (Levels(0.0, 200.0), "--amplitude is 0 V RMS, but must be above 0"),
        (Levels(0.1, 5000.0), "--force is 5000 N RMS.* and 4080 N at most: .*limits.force_rate$"),
        (Levels(0.1, -1.0), "--force is -1 N"),
        (Levels(float("nan"), 1.0), "--amplitude is nan"),
    ],
)
def test_levels_beyond_the_limits_are_refused_with_the_largest_ones(levels, message):
    of = load("/**:limits.command:=9.0")
    largest = LargestLevels.of(of, unit_of(of), math.inf)
    with pytest.raises(InputError, match=message):
        largest.check(levels)


@pytest.mark.parametrize("rate", [500, 2000])
def test_the_largest_force_reaches_a_limit_and_its_error_names_one_that_does_not(rate):
    of = load(f"rate:={rate}.0", "/**:limits.force_rate:=1e6")
    unit = unit_of(of)
    largest = LargestLevels.of(of, unit, math.inf)
    plausible = PlausibleForce(1e9, 1e6, ("x",), of.timebase.dt)

    def refused(force):
        plausible.recent[:] = 0.0
        return not all(is_plausible(plausible.limits, plausible.recent, force * u) for u in unit)

    assert largest.force[1] == "/**: limits.force_rate"
    assert [refused(factor * largest.force[0]) for factor in (0.9999, 1.0001)] == [False, True]
    with pytest.raises(InputError) as message:
        largest.check(Levels(0.1, 1e5))
    named = float(re.search(r"and (\S+) N at most", str(message.value))[1])
    largest.check(Levels(0.1, named))
    assert 0.98 * largest.force[0] < named
    assert rig_tests.default_force(of, largest) <= 0.5 * largest.force[0]


def test_under_a_cap_levels_are_those_at_which_the_known_rig_reaches_it(record):
    of, cap = load(LINEAR), 1e-3
    path, unit = record(of)
    largest = LargestLevels.of(of, unit, cap)
    assert largest.voltage[1] == largest.force[1] == "--max-displacement"
    opened = simulated(open_loop(of, path, largest.voltage[0]))
    closed = simulated(rig_tests.closed_loop_test(of, path, 0.5 * largest.force[0]))
    for done, reached in ((opened, cap), (closed, 0.5 * cap)):
        moved = np.abs(done.states.values[:, 0]).max()
        assert 0.8 * reached < moved < 1.05 * reached
    soft = Specimen(np.eye(1) * 52.7, np.eye(1) * 800.0, np.eye(1) * 2.1e4)
    assert LargestLevels.of(of, unit, cap, soft).force[0] < 0.5 * largest.force[0]
    assert pilot_voltage(of, largest) == pilot_voltage(of, LargestLevels.of(of, unit, math.inf))
    small = LargestLevels.of(of, unit, 1e-4)
    assert pilot_voltage(of, small) == pytest.approx(0.22 * 0.1 * largest.voltage[0])


def after_pilot(of, record):
    """Voltage after a pilot, and the largest one."""
    path, unit = record(of)
    largest = LargestLevels.of(of, unit, math.inf)
    low = pilot_voltage(of, largest)
    pilot = simulated(open_loop(of, path, low))
    return rig_tests.voltage_after(pilot, low, largest), largest.voltage[0]


def shares_of(of, path, voltage):
    """Shares of the limits of the state and of its changes in an open loop."""
    states = simulated(open_loop(of, path, voltage)).measured.values
    limits = Limits(group(of["supervisor"], "limits"), of.axes, of.timebase.dt)
    for step, state in enumerate(states):
        assert not exceeds(limits.values, step, limits.recent, state, limits.change, limits.largest)
    return 1.0 - np.array(list(limits.margins().values())).reshape(2, 4)


def test_after_a_pilot_the_rig_uses_a_fifth_of_its_limits(record):
    of = load(LINEAR)
    voltage, _ = after_pilot(of, record)
    assert voltage > 2 * pilot_voltage(of, LargestLevels.of(of, record(of)[1], math.inf))
    shares = shares_of(of, record(of)[0], voltage)
    assert shares[0].max() == pytest.approx(0.22, rel=0.05)


def test_after_a_pilot_no_change_uses_more_than_half_of_its_limit(record):
    of = load(LINEAR, "/**:limits.velocity_rate:=40.0", "rate:=1000.0")
    shares = shares_of(of, record(of)[0], after_pilot(of, record)[0])
    assert shares[1].max() == pytest.approx(0.5, rel=0.1)
    assert shares[0].max() < 0.22


def test_a_rig_that_hardly_moves_gets_peaks_of_half_the_voltage_limit_and_no_more(record):
    of = load("rig:simulated.actuator.flow_gain:=1.0e-5", "rig:simulated.actuator.friction:=0.0")
    voltage, largest = after_pilot(of, record)
    assert voltage == 0.5 * largest


def test_the_closed_loop_follows_the_excitation_times_a_force(record):
    of = load()
    path, unit = record(of)
    followed = simulated(rig_tests.closed_loop_test(of, path, 150.0))
    force = followed.series["reference_force"].values[:, 0]
    np.testing.assert_allclose(force[: len(unit)], 150.0 * unit, atol=1e-6)


@pytest.mark.parametrize(
    ("kind", "valve"), [("ideal", False), ("delay", False), ("servo_hydraulic", True)]
)
def test_idealised_actuators_have_no_valve(kind, valve):
    assert rig_tests.has_valve(load(f"/**:actuator.kind:={kind}")) is valve
