import math

import numpy as np
import pytest
from experiments_at_hand import load
from interlocks_at_hand import (
    AXES,
    DT,
    NO_LIMITS,
    Scripted,
    left,
    sample_of,
    stepped,
    target_of,
    watched,
)
from seft_msgs_py.errors import InputError
from seft_plant_sim.judge.detection import detectors_of
from seft_plant_sim.judge.detector_list import DETECTORS
from seft_plant_sim.judge.detectors import LIMITED_AT
from seft_ros.force_controller.force_control import ForceController
from seft_ros.force_controller.interlock import Interlock
from seft_ros.protection.protection_step import extrapolated
from warning_detectors import warning_detectors


def interlock(gain=1.0, longest_saturation=0.5, **detectors):
    controller = ForceController([([gain], [1.0])] * len(AXES), 10.0, DT)
    watched = warning_detectors(2, **detectors)
    return Interlock(controller, AXES, 1000.0, longest_saturation, 0.0, NO_LIMITS, watched)


def state(east=0.0, north=0.0):
    found = np.zeros((4, 2))
    found[3] = east, north
    return found


def force(east, north):
    return np.array([[[east, north]]])


def test_it_is_the_controller_itself_while_all_is_well():
    guarded, bare = interlock(), ForceController([([1.0], [1.0])] * 2, 10.0, DT)
    rng = np.random.default_rng(1)
    for step in range(200):
        asked, measured = force(*rng.normal(0, 300, 2)), state(*rng.normal(0, 300, 2))
        expected = bare.step(asked, measured)
        np.testing.assert_array_equal(stepped(guarded, step * 1000, asked, measured), expected)
    assert guarded.reason == ""
    assert guarded.step_index == -1
    assert guarded.kind == interlock().kind is not None


def test_a_controller_of_forces_follows_the_force_of_a_target():
    guarded, bare = interlock(), ForceController([([1.0], [1.0])] * 2, 10.0, DT)
    for step, asked in enumerate(np.random.default_rng(1).normal(0.0, 300.0, (50, 1, 1, 2))):
        target = np.concatenate([np.full((1, 2, 2), 1e-3), asked], axis=1)
        expected = bare.step(asked, state())
        np.testing.assert_array_equal(stepped(guarded, step * 1000, target, state()), expected)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_what_is_no_number_never_gets_into_the_recursion(value):
    guarded = interlock()
    np.testing.assert_array_equal(stepped(guarded, 7, force(1.0, value), state()), [0.0, 0.0])
    words = f"reference force on axis north is {value}"
    if abs(value) == math.inf:
        words = f"reference force {value:g} N on axis north is beyond the limit of 1000 N"
    assert guarded.reason == words
    assert guarded.step_index == 7
    np.testing.assert_array_equal(stepped(guarded, 8, force(1.0, 1.0), state()), [0.0, 0.0])
    guarded.reset()
    np.testing.assert_array_equal(stepped(guarded, 0, force(1.0, 1.0), state()), [1.0, 1.0])


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("row", range(4))
def test_a_measured_value_that_is_no_number_is_replaced_before_the_controller_answers(row, value):
    controller = Scripted(1)
    guarded = watched(controller)
    for step in range(9):
        raw = sample_of(step)
        raw[row, 1] = value if step == 5 else raw[row, 1]
        stepped(guarded, step, target_of(step, 1), raw)
        np.testing.assert_allclose(controller.seen[-1][1], sample_of(step), atol=1e-9)
    assert guarded.reason == ""


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("row", range(4))
def test_a_judged_sample_beyond_a_limit_trips(row, axis):
    controller, quantity = (
        Scripted(1, 1),
        ("displacement", "velocity", "acceleration", "force")[row],
    )
    limits, unit = (0.25, 0.5, 20.0, 5000.0), ("m", "m/s", "m/s^2", "N")[row]
    watching = warning_detectors(2)
    guarded = Interlock(controller, AXES, 1000.0, 0.5, 0.0, limits, watching)
    raw = np.zeros((4, 2))
    raw[row, axis] = limits[row]
    assert np.any(stepped(guarded, 0, force(0.0, 0.0), raw))
    assert guarded.reason == ""
    raw[row, axis] = -1.25 * limits[row]
    assert not np.any(stepped(guarded, 7, force(0.0, 0.0), raw))
    assert guarded.step_index == 7
    assert guarded.reason == (
        f"{quantity} {raw[row, axis]:g} {unit} on axis {AXES[axis]} is beyond the limit of "
        f"{limits[row]:g} {unit}"
    )


def test_forces_may_be_as_large_as_floats_can_be_without_being_called_no_number():
    guarded = interlock()
    with np.errstate(over="ignore"):
        stepped(guarded, 0, force(999.0, 0.0), state(east=1e307, north=-1e307))
    assert guarded.reason == ""


def test_a_reference_force_beyond_the_limit_is_nonsense():
    guarded = interlock()
    stepped(guarded, 0, force(1000.0, -1000.0), state())
    assert guarded.reason == ""
    np.testing.assert_array_equal(stepped(guarded, 1, force(1000.0, -1000.1), state()), [0, 0])
    assert guarded.reason == "reference force -1000.1 N on axis north is beyond the limit of 1000 N"


def test_a_valve_at_its_limit_for_too_long_within_a_second_trips():
    guarded = interlock(longest_saturation=0.1)
    for step in range(1600):  # a tenth of each second, and no more
        at_limit = step % 500 < 50
        stepped(guarded, step, force(0.0, -900.0 if at_limit else 5.0), state())
    assert guarded.reason == ""
    guarded.reset()
    drives = [stepped(guarded, step, force(50.0, 0.0), state()) for step in range(52)]
    np.testing.assert_array_equal(drives[49], [10.0, 0.0])
    np.testing.assert_array_equal(drives[50], [0.0, 0.0])
    assert guarded.step_index == 50
    assert guarded.reason.startswith("the valve command is at its limit for more than 0.1 s")


def test_a_rig_that_obeys_forces_has_no_valve_to_stay_at_its_limit():
    guarded = interlock(longest_saturation=0.1, has_valve=False)
    for step in range(600):
        stepped(guarded, step, force(900.0, 0.0), state())
    assert guarded.reason == ""
    assert guarded.state.detectors.step[LIMITED_AT] < 0  # tracking is watched on


def test_the_first_reason_counts():
    guarded = interlock()
    guarded.trip(3, "first")
    guarded.trip(4, "second")
    assert (guarded.reason, guarded.step_index) == ("first", 3)


def test_a_suspect_sample_is_replaced_by_what_was_planned_before_it():
    for count in (4, 2, 1):
        controller = Scripted(count)
        guarded = watched(controller)
        for step in range(70, 80):
            stepped(guarded, step, target_of(step, count), sample_of(step), 75 <= step < 78)
        assert guarded.reason == ""
        for place, step in enumerate(range(70, 80)):
            plan, sample = controller.seen[place]
            if 75 <= step < 78:
                planned = target_of(74, count)
                for _ in range(step - 74):
                    planned = extrapolated(planned, 1, count, DT)
                expected = (
                    planned[0, 0],
                    planned[0, 1],
                    planned[min(1, count - 1), 1],
                    planned[0, 2],
                )
                np.testing.assert_array_equal(plan, planned)
                np.testing.assert_array_equal(sample[[0, 1, 3]], [expected[i] for i in (0, 1, 3)])
                np.testing.assert_allclose(sample[2], (expected[2] - expected[1]) / DT, rtol=1e-14)
            else:
                np.testing.assert_array_equal(plan, target_of(step, count))
                np.testing.assert_array_equal(sample, sample_of(step))


def test_while_a_sample_is_suspect_a_controller_of_forces_holds_its_last_command():
    controller = Scripted(1, 1)
    guarded = watched(controller)
    for step in range(10):
        command = stepped(guarded, step, force(0.0, 0.0), sample_of(step), 5 <= step < 8)
        answered = min(step + 1, 5) if step < 8 else step - 2
        np.testing.assert_array_equal(command, [answered, 2.0 * answered])
    assert len(controller.seen) == 7


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("rows", [1, 3])
def test_a_fault_closes_the_valve_from_the_last_fault_free_command_and_its_cause_stays(axis, rows):
    controller = Scripted(1, rows)
    guarded = watched(controller)

    def step(index, off):
        points = target_of(index, 1)[:, -rows:] if rows > 1 else force(*[5.0] * 2)
        return stepped(guarded, index, points, sample_of(index, off, axis))

    for index in range(5):
        step(index, 0.0)
    drives = [step(index, 2e-3) for index in range(5, 15)]
    last = drives[1]
    for taken, drive in enumerate(drives[2:], 1):
        np.testing.assert_allclose(drive, left(taken) * last, rtol=1e-14)
    # of the second wrong sample on, a controller of forces holds its last command
    assert len(controller.seen) == (7 if rows > 1 else 6)
    assert guarded.step_index == 7
    message = (
        f"measured displacement on axis {AXES[axis]} contradicts the other channels: 3 samples "
        "within"
    )
    assert guarded.reason.startswith(message)
    reason = guarded.reason
    assert not np.any(stepped(guarded, 15, force(0.0, math.nan), state(math.nan)))
    guarded.trip(16, "another")
    assert (guarded.reason, guarded.step_index) == (reason, 7)
    guarded.reset()
    assert (guarded.reason, guarded.step_index, guarded.nearest[1]) == ("", -1, 0.0)
    assert controller.seen == []
    np.testing.assert_array_equal(stepped(guarded, 0, force(math.nan, 0.0), state()), [0.0, 0.0])


def test_detectors_that_only_warn_put_no_sample_under_suspicion():
    controller = Scripted(1, 3)
    guarded = watched(controller, warn_only=["displacement_velocity", "displacement_wrong"])
    for index in range(9):
        stepped(guarded, index, target_of(index, 1), sample_of(index, 2e-3 * (index >= 5)))
    assert (guarded.reason, len(controller.seen)) == ("", 9)
    name, share = guarded.nearest
    assert name == "displacement_wrong"
    assert share > 1.0


def test_detectors_are_not_blinded_by_what_is_no_number():
    controller = Scripted(1, 1)
    guarded = watched(controller)
    for index in range(50):
        measured = sample_of(index, 2e-3 * (index >= 40))
        measured[0, 1] = math.nan if index == 3 else measured[0, 1]
        stepped(guarded, index, force(0.0, 0.0), measured)
    assert guarded.step_index == 42


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_a_drive_that_is_no_number_is_not_sent(bad):
    controller = Scripted(1, 1)
    guarded = watched(controller)
    fault_free = stepped(guarded, 0, force(0.0, 0.0), state())
    controller.drive = np.array([3.0, bad])
    for index in range(1, 7):
        drive = stepped(guarded, index, force(0.0, 0.0), state())
        np.testing.assert_allclose(drive, left(index) * fault_free, rtol=1e-14)
    assert guarded.reason == f"valve command on axis north is {bad}"
    assert (guarded.step_index, len(controller.seen)) == (1, 2)


def test_a_valve_that_trips_at_its_limit_closes_from_the_command_before():
    controller = Scripted(1, 1)
    guarded = watched(controller)  # 0.02 s: ten samples
    controller.limited = True
    drives = [stepped(guarded, index, force(0.0, 0.0), state()) for index in range(13)]
    np.testing.assert_array_equal([drive[0] for drive in drives[:10]], np.arange(1.0, 11.0))
    np.testing.assert_allclose([d[0] for d in drives[10:]], [10 * left(k) for k in (1, 2, 3)])
    assert guarded.step_index == 10


@pytest.mark.parametrize("axes", [("a",), ("a", "b", "c", "d")])
def test_a_controller_gets_as_many_points_as_it_asks_for(axes):
    n, controller = len(axes), Scripted(4, 3)
    for count, rows in ((2, 3), (6, 3), (1, 1), (4, 3)):
        guarded = watched(controller, axes)
        points = np.arange(1.0, 1 + count * rows * n).reshape(count, rows, n)
        points[:, 0], measured = points[0, 0], np.ones((4, n))
        measured[0] = points[0, 0]
        stepped(guarded, 0, points, measured)
        plan, sample = controller.seen[-1]
        expected = [np.broadcast_to(points[min(k, count - 1)], (3, n)) for k in range(4)]
        np.testing.assert_array_equal(plan, expected)
        np.testing.assert_array_equal(sample, measured)


def section_of(*words):
    """The force controller's section of a test with two rigs, its axes, and the test."""
    experiment = load(*words, config="two_pier_bridge")
    return experiment["force_controller"], experiment.axes, experiment


def test_an_interlock_is_made_of_its_section():
    words = ("/**:limits.force:=900.0", "rig:safe.close_time:=0.03")
    words += ("force_controller:watchdog.saturation_time:=0.1",)
    section, axes, experiment = section_of(*words)
    controller = Scripted(1, 1)
    of_all = (controller, section, axes, experiment.timebase)
    for rig in (None, *experiment.rigs):
        made = Interlock.from_parameters(*of_all, rig)
        assert (made.parameters.largest, made.parameters.window) == (900.0, 500)
        assert made.parameters.closing == pytest.approx(15.0)
        assert len(made.state.saturated) == 51
        own = axes if rig is None else rig.axes
        n = len(own)
        made.step(0, np.array([[[0.0] * (n - 1) + [-901.0]]]), np.zeros((4, n)))
        assert f"-901 N on axis {own[-1]} is beyond the limit of 900 N" in made.reason


def test_detectors_know_what_their_section_says_of_their_axes():
    section, axes, _ = section_of(
        "/**:actuator.flow_gain:=[0.04, 0.05]",
        "/**:actuator.valve_frequency:=[70.0, 0.0]",
        "rig:simulated.actuator.valve_frequency:=70.0",
        "/**:sensors.force_noise:=[3.0, 4.0]",
        "/**:sensors.force_range:=[0.0, 9000.0]",
        "force_controller:detectors.warn_only:=oil_balance, tracking",
    )
    p, _ = detectors_of(section, axes, DT, (0, 1))
    expected = [[0.04, 1.685e7, 50.0, 24500.0], [0.0, 1.685e7, 50.0, 24500.0]]
    np.testing.assert_array_equal(p.actuator[:, :1], np.array(expected)[:, :1])
    np.testing.assert_array_equal(p.actuator[0], expected[0])
    assert np.isfinite(p.sums[2]).tolist() == [True, False]  # its valve is not known
    np.testing.assert_array_equal(p.noise, [[5e-6] * 2, [1e-3] * 2, [0.05] * 2, [3.0, 4.0]])
    np.testing.assert_array_equal(p.range[3], [np.inf, 9000.0])
    np.testing.assert_array_equal(p.range[:3, 0], [0.1, 1.0, 39.24])
    np.testing.assert_array_equal(p.mass, np.diag([52.7, 45.0]))
    np.testing.assert_array_equal(p.stiffness, np.diag([211e3, 160e3]))
    np.testing.assert_array_equal(p.computed_mass, p.mass)
    quiet = [one.name for one, acts in zip(DETECTORS, p.acts, strict=True) if not acts]
    assert quiet == ["oil_balance", "tracking"]
    assert p.persistence[2] == 3
    np.testing.assert_allclose(p.past[:, 0].sum(axis=1), 1.0, atol=0.01)  # what is sent, flows
    alone, state = detectors_of(section, axes, DT, (1,))
    assert (alone.mass.item(), alone.stiffness.item(), alone.noise[3, 0]) == (45.0, 160e3, 4.0)
    assert (alone.range[3, 0], state.last.shape) == (9000.0, (4, 1))


def test_what_a_test_is_like_changes_what_its_detectors_know():
    def of(*words):
        section, axes, _ = section_of(*words)
        return detectors_of(section, axes, DT, (0, 1))[0]

    assert not of("reference_force:mass_ratio:=0.0").computed_mass.any()
    half = of("reference_force:mass_ratio:=0.5")
    np.testing.assert_array_equal(half.computed_mass, 0.5 * half.mass)
    unknown = of("/**:specimen.stiffness:=0.0")
    assert not unknown.stiffness.any()
    assert np.isinf(unknown.rough).all()
    ideal = of("/**:actuator.kind:=ideal")
    assert np.isinf(ideal.sums[2]).all()
    np.testing.assert_allclose(ideal.by_force, np.linalg.inv(ideal.mass))
    assert not of().by_force.any()
    assert np.isfinite(of("/**:actuator.valve_frequency:=0.5").sums[2]).all()
    assert not of("force_controller:detectors.warn_only:=all").acts.any()
    assert of().acts.all()
    derived = of("/**:sensors.velocity:=derived")
    np.testing.assert_allclose(derived.noise[1], math.sqrt(2.0) * 5e-6 / DT)
    with pytest.raises(InputError, match=r"detectors\.warn_only: no detector 'speed'; there are "):
        of("force_controller:detectors.warn_only:=speed")
