"""Noise is a function of seed, step and number of axes; of nothing else."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from seft_msgs_py.errors import InputError
from seft_plant_sim.sensors import Sensors

RMS = np.array([[5e-6, 1e-5], [0.01, 0.02], [0.05, 0.1], [3.0, 0.0]])
STATE = np.arange(8.0).reshape(4, 2)


def noise(steps, rms=RMS, seed=1):
    sensors = Sensors(rms, seed)
    return np.array([sensors.measure(step, np.zeros(rms.shape)) for step in steps])


@settings(max_examples=25, deadline=None)
@given(st.lists(st.integers(0, 20_000), max_size=10))
def test_the_noise_of_a_step_does_not_depend_on_the_steps_before(steps):
    for step, value in zip(steps, noise(steps), strict=True):
        np.testing.assert_array_equal(value, noise([step])[0])


def test_another_seed_is_other_noise_and_the_same_seed_the_same():
    steps = [0, 1, 5000]
    np.testing.assert_array_equal(noise(steps), noise(steps))
    assert not np.isclose(noise(steps)[:, :3], noise(steps, seed=2)[:, :3]).any()


def test_rms_is_as_asked_for_and_the_mean_is_zero():
    samples = noise(range(20_000))
    np.testing.assert_allclose(np.sqrt(np.mean(samples**2, axis=0)), RMS, rtol=0.03)
    np.testing.assert_allclose(samples.mean(axis=0), 0.0, atol=0.03 * RMS.max(axis=1).max())
    assert (samples[:, 3, 1] == 0.0).all()


def test_noise_is_white_and_differs_between_axes_and_quantities():
    samples = noise(range(20_000), np.ones((4, 2))).reshape(-1, 8)
    limit = 5 / np.sqrt(len(samples))
    for one, other in itertools.combinations(samples.T, 2):
        assert abs(np.corrcoef(one, other)[0, 1]) < limit
    for lag in (1, 2, 10, 4096):
        for column in samples.T:
            assert abs(np.mean(column[lag:] * column[:-lag])) < limit


def test_noise_is_added_to_the_true_state_and_leaves_it_alone():
    state = STATE.copy()
    measured = Sensors(RMS, 1).measure(3, state)
    np.testing.assert_array_equal(measured, STATE + noise([3])[0])
    np.testing.assert_array_equal(state, STATE)


def test_sensors_without_noise_measure_the_truth():
    np.testing.assert_array_equal(Sensors(np.zeros((4, 2)), 5).measure(9, STATE), STATE)


def test_twice_the_rms_is_twice_the_noise():
    np.testing.assert_array_equal(noise([7], 2 * RMS), 2 * noise([7]))


def test_parameters_are_one_number_or_one_for_each_axis():
    names = ("position_noise", "velocity_noise", "acceleration_noise", "force_noise")
    values = dict(zip(names, [[5e-6, 1e-5], [0.01, 0.02], [0.05, 0.1], [3.0, 0.0]], strict=True))
    sensors = Sensors.from_parameters(values, 1, ("x", "y"), "rig: sensors")
    np.testing.assert_array_equal(sensors.measure(4, STATE), STATE + noise([4])[0])
    same = Sensors.from_parameters(dict.fromkeys(names, 2.0), 1, ("x", "y"), "rig: sensors")
    np.testing.assert_array_equal(same.measure(4, 0 * STATE), noise([4], np.full((4, 2), 2.0))[0])
    with pytest.raises(InputError, match=r"rig: sensors\.force_noise: 3 values for 2 axes"):
        values["force_noise"] = [1.0, 2.0, 3.0]
        Sensors.from_parameters(values, 1, ("x", "y"), "rig: sensors")
