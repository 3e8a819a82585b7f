from pathlib import Path

import numpy as np
import pytest
from bare_rig import driven, make_rig, rig_section
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.errors import InputError
from seft_msgs_py.wire.outcome import Simulated
from seft_msgs_py.wire.topics import Timebase
from seft_plant_sim.hardware.hosted import HardwareError
from seft_plant_sim.judge.guard import FAULT
from seft_plant_sim.judge.hypotheses import EVENT
from seft_plant_sim.rig import Rig
from seft_plant_sim.rig_parameters import RIG_TABLE
from seft_plant_sim.simulated.rig_step import left_open

TIMEBASE = Timebase.from_rate(500.0)


@pytest.mark.parametrize(
    ("kind", "drive", "force_at"),
    [
        ("ideal", "reference_force", 1),
        ("delay", "reference_force", 6),
        ("servo_hydraulic", "valve_command", 3),
    ],
)
def test_each_kind_obeys_its_drive_after_its_delay(kind, drive, force_at):
    late = 0.0 if kind == "ideal" else 0.01
    one = make_rig(actuator__kind=kind, actuator__delay=late, actuator__dead_time=0.003)
    assert one.drive == drive
    force = driven(one, np.ones(10))[:, 3, 0]
    assert np.flatnonzero(force)[0] == force_at


def test_a_violation_is_that_of_the_last_sample_as_measured():
    one = make_rig(actuator__kind="ideal", limits__force=100.0)
    one.reset()
    for force in (101.0, 102.0):  # wrong samples, which are judged, do not last
        one.step(np.full(1, force))
        assert one.violation is None
    one.step(np.full(1, 101.0))
    assert one.violation == "force 101 N on axis x is beyond the limit of 100 N"
    one.step(np.full(1, 99.0))
    assert one.violation is None
    one.step(np.full(1, -101.0))
    one.reset()
    assert one.violation is None
    loud = make_rig(sensors__force_noise=1000.0, limits__force=1.0)
    loud.reset()
    for _ in range(2):
        loud.step(np.zeros(1))
    assert loud.violation is not None  # the test must see what the sensor sees


@pytest.mark.parametrize(
    ("only_warn", "why"),
    [
        ("", "measured force on axis x contradicts the other channels: 3 samples within 50 ms"),
        ("all", "force 90000 N on axis x is beyond the limit of 10000 N"),
    ],
)
def test_a_wrong_sample_beyond_a_limit_is_replaced_until_it_lasts(only_warn, why):
    words = {"limits__force": 1e4, "limits__force_rate": 1e9, "detectors__warn_only": only_warn}
    one = make_rig(faults="force set 9e4 at 0.02 for 3", sensors__force_noise=1.0, **words)
    driven(one, np.zeros(9))
    for _ in range(2):
        judged = one.step(np.zeros(1))
        assert abs(judged[3, 0]) < 20.0
        assert one.measured[3, 0] == 9e4
        assert one.violation is None
    one.step(np.zeros(1))
    assert one.violation.startswith(why)


def test_what_is_at_the_end_of_its_range_is_counted_until_a_reset():
    ranges = {"sensors__force_range": 100.0, "sensors__acceleration_range": 1.0}
    one = make_rig(("x", "y"), actuator__kind="ideal", **ranges)
    driven(one, np.outer([50.0, 101.0, -200.0, 10.0, 300.0], np.ones(2)))  # 50 N: 0.95 m/s^2
    counted = {"samples": 3, "first_step": 2}  # however many axes are at the end
    before = one.saturation
    assert before == {"force_range": counted, "acceleration_range": counted}
    one.reset()
    assert one.saturation == {}
    assert before["force_range"] == counted


def test_a_test_that_is_blind_for_long_ends_with_the_reason():
    ranges = {"sensors__force_range": 10.0, "sensors__acceleration_range": 0.1}
    one = make_rig(actuator__kind="ideal", limits__saturated_time=0.01, **ranges)
    one.reset()
    violations = []
    for _ in range(6):
        one.step(np.full(1, 99.0))
        violations.append(one.violation)
    assert violations[:5] == [None] * 5
    assert violations[5] == (
        "acceleration and force at the end of the sensor's range for more than 0.01 s within one "
        "second: their channels are unknown"
    )
    one.reset()
    one.step(np.full(1, 99.0))
    assert one.violation is None


JHU = Path(__file__).parents[3] / "config" / "jhu.yaml"  # wherever it runs, as by colcon test


def moving_rig(*overrides, axes=("x",), steps=200, size=5.0):
    given = [("/**", "axes", list(axes)), *overrides]
    experiment = Experiment.load([RIG_TABLE], [JHU], given, nodes=["rig"])
    rig = Rig(experiment["rig"], experiment.axes, experiment.timebase)
    swing = size * np.sin(2 * np.pi * 5.0 * 0.002 * np.arange(steps))
    driven(rig, np.outer(swing, np.ones(len(axes))))
    return rig


@pytest.mark.parametrize("axes", ["x", "xy"])
def test_a_closed_valve_locks_the_piston_on_its_oil_column(axes):
    rig = moving_rig(axes=axes)
    before = abs(rig.simulation.sample[1]).min()
    assert before > 0.03
    stopped = rig.stop()
    assert stopped.time <= 0.2
    assert abs(rig.simulation.sample[1]).max() < 0.2 * before
    assert stopped.peak_force > abs(rig.simulation.sample[3]).max()
    assert rig.step_index == 199 + 1  # the samples of the test are what they were


def test_a_stop_follows_the_plan_then_closes():
    planned, stepped = moving_rig(), moving_rig()
    last, planned_last = stepped.simulation.state.asked.copy(), np.array([1.0])
    plan = np.linspace(3.0, 0.5, 20)[:, np.newaxis]
    stopped = planned.stop(plan, planned_last)
    peak = 0.0
    for taken, command in enumerate(plan, 1):
        stepped.step(command + left_open(taken, 10) * (last - planned_last))
        peak = max(peak, abs(stepped.simulation.sample[3, 0]))
    assert stopped.peak_force == max(peak, stepped.stop().peak_force)
    np.testing.assert_array_equal(planned.simulation.sample, stepped.simulation.sample)


SERVO = (
    ("/**", "actuator.kind", "position_servo"),
    ("/**", "actuator.response.numerator", [3e4]),
    ("/**", "actuator.response.denominator", [1.0, 200.0, 3e4]),
    ("/**", "actuator.response.dead_time", 0.002),
)


def test_a_servo_goes_on_from_where_it_is_and_stays_there():
    limit = ("/**", "limits.displacement", 0.006)
    planned, stepped = (moving_rig(*SERVO, limit, size=0.005) for _ in range(2))
    last = stepped.simulation.state.asked.copy()
    plan = 0.003 * np.linspace(0.1, 1.0, 20)[:, np.newaxis]
    stopped = planned.stop(plan, np.array([-0.002]))
    peak = 0.0
    for command in np.minimum(plan + last + 0.002, 0.006):
        stepped.step(command)
        peak = max(peak, abs(stepped.simulation.sample[3, 0]))
    assert stopped.peak_force == max(peak, stepped.stop().peak_force)
    np.testing.assert_array_equal(planned.simulation.sample, stepped.simulation.sample)


@pytest.mark.parametrize(
    ("faults", "ends", "trusted"),
    [
        ("force set -9e4 at 0.396 for 3", "force_wrong", 194),
        ("force set -9e4 at 0.4 for 1", None, 200),
        ("velocity set 0.9 at 0.396 for 3", "velocity_wrong", 200),
        ("velocity add 0.02 at 0.396 for 3", "velocity_wrong", 194),
        ("displacement set 0.09 at 0.396 for 3", "displacement_wrong", 200),
        (["velocity freeze at 0.392", "force freeze at 0.392"], "velocity_frozen", 192),
        (["acceleration flip at 0.394", "force flip at 0.394"], "acceleration_wrong", 193),
    ],
)
def test_a_rig_knows_up_to_which_step_nothing_wrong_was_used(faults, ends, trusted):
    rig = moving_rig(("rig", "faults", faults))
    assert rig.step_index == 200
    assert rig.violation is None if ends is None else rig.violation.endswith(ends)
    assert rig.trusted == trusted


def test_an_event_before_wrong_samples_may_have_been_wrong():
    rig = moving_rig(("rig", "faults", "force set -9e4 at 0.396 for 3"))
    judge = rig.guard.state.detectors.judge
    assert rig.guard.trusted(FAULT) == 194
    judge.sets[judge.place[0] - 3] = EVENT
    assert rig.guard.trusted(FAULT) == 193
    judge.sets[judge.place[0] - 5] = EVENT  # with a sound sample between: 30 ms before
    assert rig.guard.trusted(FAULT) == 182


@pytest.mark.parametrize("method", ["read", "write"])
def test_a_rig_whose_hardware_fails_trusts_no_plan(method, monkeypatch):
    rig = moving_rig()
    assert rig.trusted == 200

    def fails(*arguments):
        raise HardwareError("it fails")

    monkeypatch.setattr(rig.hardware, method, fails)
    with pytest.raises(HardwareError):
        rig.step(np.zeros(1))
    assert (rig.violation, rig.trusted) == ("it fails", -1)


def test_a_rig_without_a_settling_time_is_left_where_it_is():
    rig = moving_rig(("rig", "safe.settle_time", 0.0))
    assert rig.stop().time == 0.0


def test_the_safe_command_is_that_of_the_parameters():
    closed, opened = moving_rig(), moving_rig(("rig", "safe.valve_command", 2.0))
    closed.stop()
    opened.stop()
    assert abs(opened.simulation.sample[3, 0]) > abs(closed.simulation.sample[3, 0]) + 100.0


@pytest.mark.parametrize("command", [1e30, -10.1])
def test_a_safe_command_beyond_the_limit_of_commands_is_refused(command):
    with pytest.raises(InputError, match=r"safe.valve_command is .*within /.*: limits.command, 10"):
        moving_rig(("rig", "safe.valve_command", command), steps=0)


def test_a_rig_at_rest_is_settled_at_once():
    assert moving_rig(steps=0).stop().time == pytest.approx(0.02)


def test_the_largest_true_motion_is_known_without_noise_and_filters():
    quiet = moving_rig()
    filters = ("rig", "simulated.sensors.force_filter", 20.0)
    filtered = moving_rig(filters, ("/**", "sensors.force_noise", 99.0))
    true_force = quiet.simulation.sample[3, 0]
    assert filtered.simulation.state.shown[3] != pytest.approx(true_force, rel=0.02)
    found, same = quiet.simulated(), filtered.simulated()
    for peak in ("displacement_peak", "force_peak", "stop_force_peak"):
        assert getattr(same, peak) == pytest.approx(getattr(found, peak), rel=1e-6)
    assert found.stop_force_peak == abs(true_force) < found.force_peak
    stopped = quiet.stop()
    after = quiet.simulated()
    assert after.stop_force_peak == max(stopped.peak_force, found.stop_force_peak)
    assert after.force_peak == max(stopped.peak_force, found.force_peak)
    assert quiet.simulated(first=0).stop_force_peak == after.force_peak
    assert after.displacement_peak >= found.displacement_peak
    quiet.reset()
    assert quiet.simulated() == Simulated(0.0, 0.0, 0.0)


def test_a_rig_of_a_faulty_sensor_moves_as_before_and_shows_the_fault():
    fault_free = moving_rig()
    faulty = moving_rig(("rig", "faults", ["force set -5589.0 at 0.4 for 1"]))
    np.testing.assert_array_equal(fault_free.simulation.sample, faulty.simulation.sample)
    assert faulty.measured[3, 0] == -5589.0
    assert faulty.violation is None
    assert faulty.guard.state.change[3, 0] < -5000.0


def test_a_stuck_valve_does_not_close():
    stuck = moving_rig(("rig", "faults", "valve stick at 0.39"))
    stuck.stop()
    assert abs(stuck.simulation.sample[1, 0]) > 0.02


@pytest.mark.parametrize("rate", [500.0, 1000.0, 4000.0])
def test_a_rig_trips_by_a_rate_of_change_that_lasts_but_not_by_a_jump(rate):
    """What jumps is judged, at every rate."""

    def trips(fault):
        limits = {"limits__force": 1e9, "limits__force_rate": 2e6}
        section = rig_section(faults=f"force {fault} at 0.05 for {0.01 * rate:.0f}", **limits)
        rig = Rig(section, ("x",), Timebase.from_rate(rate))
        rig.reset()
        for _ in range(round(0.1 * rate)):
            rig.step(np.zeros(1))
            if rig.violation:
                return rig.violation
        return ""

    assert trips("add 5000") == ""
    assert trips("drift 1.9e6") == ""
    assert trips("drift 2.1e6").startswith("force rate 2.1e+06 N/s on axis x is beyond")
    if rate > 500.0:  # there 10 ms are five samples
        assert trips("noise 2e4").startswith("force rate ")


def test_an_ideal_actuator_has_no_delay():
    with pytest.raises(InputError, match=r"ideal obeys at once.* 0\.01 s: make the kind delay"):
        make_rig(actuator__kind="ideal", actuator__delay=0.01)
