"""The guard: what a sample is when it leaves it, what of it is noted, and what ends a test."""

import numpy as np
import pytest
from bare_rig import rig_section
from hypothesis import given
from hypothesis import strategies as st
from seft_msgs_py.config.facts import CHANNELS
from seft_msgs_py.wire.topics import RigAxes
from seft_plant_sim.judge.guard import DRIVE_ROW, ENDS_TEST, RANGES, SUSPECT_ROW, Guard

DT, AXES = 0.002, ("east", "north")
NOISE = {"sensors__displacement_noise": 5e-6, "sensors__velocity_noise": 1e-3}
NOISE |= {"sensors__acceleration_noise": 0.05, "sensors__force_noise": 3.0}


def guard(**values):
    """Guard of two axes of these parameters; a double underscore stands for a dot."""
    made = Guard(rig_section(**values), AXES, RigAxes.whole(AXES), DT)
    made.reset()
    return made


def taken(one, samples, drive=(0.0, 0.0)):
    """What a guard makes of samples, and what it found: shapes (N, 6, 2) and (N,)."""
    found, drive = [], np.array(drive)
    passed = np.empty((len(samples), DRIVE_ROW + 1, 2))
    for step, measured in enumerate(samples):
        found.append(one.take(step, np.array(measured, np.float64), drive, passed[step]))
    return passed, found


def quiet(count):
    """Samples of sensors of this noise that see nothing else, shape (N, 4, 2)."""
    rms = np.array([*NOISE.values()])[:, np.newaxis]
    return 0.3 * rms * np.random.default_rng(2).normal(size=(count, 4, 2))


def named(found):
    """Channels at the end of their ranges."""
    return {name for name, bit in RANGES.items() if found & bit}


@given(st.lists(st.floats(-3, 3), min_size=8, max_size=8))
def test_a_sensor_is_reported_if_and_only_if_it_is_at_its_range(values):
    shown = np.clip(np.reshape(values, (4, 2)), -1.0, 1.0)
    one = guard(**{f"sensors__{name}_range": 1.0 for name in CHANNELS})
    beyond = (np.abs(shown) >= 1.0).any(axis=1)
    _, (found,) = taken(one, [shown])
    assert named(found) == {f"{n}_range" for n, b in zip(CHANNELS, beyond, strict=True) if b}


def test_the_range_is_of_what_a_sensor_shows_not_of_what_it_means():
    """A range is found before calibration, in volts or not, and never of a derived velocity."""
    one = guard(sensors__force_range=100.0, calibration__force_scale=0.5)
    shown = np.zeros((4, 2))
    shown[3] = 60.0, -99.0
    passed, (found,) = taken(one, [shown])
    assert named(found) == set()
    np.testing.assert_array_equal(passed[0, 3], [120.0, -198.0])
    shown[3] = 60.0, -100.0
    assert named(taken(one, [shown])[1][0]) == {"force_range"}
    derived = guard(sensors__velocity="derived", sensors__velocity_range=1e-9)
    moving = np.zeros((2, 4, 2))
    moving[1, 0] = 1e-4
    passed, found = taken(derived, moving)
    assert (passed[1, 1] > 0.02).all()
    assert [named(each) for each in found] == [set(), set()]


def test_what_rounding_leaves_of_a_filter_at_rest_is_no_step_of_a_converter():
    known = {f"sensors__{name}_range": 1e4 * NOISE[f"sensors__{name}_noise"] for name in CHANNELS}
    filtered = {"calibration__force_filter": 100.65, "calibration__force_filter_damping": 0.7112}
    one = guard(**NOISE, **known, sensors__adc_bits=16, **filtered)
    for stands in np.linspace(1.0, 3.0, 20) * NOISE["sensors__displacement_noise"]:
        samples = quiet(40)
        samples[:5, 0] = stands
        one.reset()
        assert not any(taken(one, samples)[1])


def test_a_channel_that_waits_repeats_its_first_sample_without_being_frozen():
    known = {f"sensors__{name}_range": 1e4 * NOISE[f"sensors__{name}_noise"] for name in CHANNELS}
    one = guard(**NOISE, **known, sensors__adc_bits=16, calibration__force_lag=0.0299)
    passed, found = taken(one, quiet(40))
    assert (passed[:14, 0] == passed[0, 0]).all()
    assert not any(found)


def test_a_converter_that_is_known_keeps_its_steps_through_the_alignment():
    ranges = {f"sensors__{name}_range": 1.0 for name in CHANNELS}
    turning = np.rint(60.0 * np.sin(0.3 * np.arange(40))) / 128.0
    samples = np.broadcast_to(turning[:, np.newaxis, np.newaxis], (40, 4, 2))
    for bits in (8, 0):
        one = guard(sensors__adc_bits=bits, calibration__displacement_lag=0.0007, **ranges)
        waited = []
        for step, sample in enumerate(samples.copy()):
            one.take(step, sample, np.zeros(2), np.empty((6, 2)))
            waited.append(sample[3])
        assert (128.0 * np.array(waited) % 1.0 == 0.0).all() == (bits > 0)


def test_a_sample_is_calibrated_in_place_and_ends_with_the_drive():
    one, shown = guard(calibration__force_bias=[5.0, -7.0]), np.zeros((4, 2))
    sample = np.empty((6, 2))
    one.take(0, shown, np.array([1.5, -2.0]), sample)
    for each in (shown, sample):
        np.testing.assert_array_equal(each[3], [-5.0, 7.0])
    np.testing.assert_array_equal(sample[DRIVE_ROW], [1.5, -2.0])
    np.testing.assert_array_equal(one.state.measured, shown)


@pytest.mark.parametrize("only_warn", ["", "all"])
def test_a_wrong_value_is_replaced_then_suspect_on_all_axes_then_ends_the_test(only_warn):
    one, samples = guard(**NOISE, detectors__warn_only=only_warn), quiet(13)
    samples[10:, 3, 1] = 4e3
    passed, found = taken(one, samples)
    np.testing.assert_array_equal(passed[:10, :4], samples[:10])
    assert (np.abs(passed[10:, 3, 1]) < 100.0).all()
    np.testing.assert_array_equal(passed[10:, :4, 0], samples[10:, :, 0])
    acts = not only_warn
    suspect = np.zeros((13, 2))
    suspect[11:] = acts
    np.testing.assert_array_equal(passed[:, SUSPECT_ROW], suspect)
    assert [one.violation(each) for each in found[:-1]] == [None] * 12
    assert one.violation(found[-1]) == (
        "measured force on axis north contradicts the other channels: 3 samples within 50 ms "
        "(2.5 samples allowed): force_wrong"
        if acts
        else None
    )
    assert one.nearest == ("force_wrong", 1.2)


def test_a_new_test_finds_what_the_one_before_did():
    one, samples = guard(**NOISE, limits__force=3e3, detectors__warn_only="all"), quiet(20)
    samples[10:, 3, 1] = 4e3
    runs = []
    for _ in range(2):
        one.reset()
        runs.append(taken(one, samples))
    np.testing.assert_array_equal(runs[0][0], runs[1][0])
    assert runs[0][1] == runs[1][1]
    ends = [found & ENDS_TEST > 0 for found in runs[0][1]]
    assert ends == [False] * 12 + [True] * 8
    one.reset()
    assert one.nearest[1] == 0.0
    assert set(one.limits.margins().values()) == {1.0}
