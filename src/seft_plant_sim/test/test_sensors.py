"""What sensors make of the truth: bias, noise, range and resolution.

Noise is a function of seed, axis and step; of nothing else. What is at the end of its range is
found by the guard: test_judge_guard.py.
"""

import itertools

import numpy as np
import pytest
from bare_rig import rig_section
from hypothesis import given, settings
from hypothesis import strategies as st
from seft_msgs_py.config.facts import CHANNELS
from seft_msgs_py.errors import InputError
from seft_plant_sim.channels import Derivation, derive_velocity
from seft_plant_sim.simulated.sensors import Channels, Sensors, measure_channels

DT = 0.002
RMS = np.array([[5e-6, 1e-5], [0.01, 0.02], [0.05, 0.1], [3.0, 0.0]])
STATE = np.arange(8.0).reshape(4, 2)
MEASURED = Derivation(0.0, 0.0)


class Measured:
    """Sensors, sample by sample, with a velocity that may be derived."""

    def __init__(self, sensors, derivation=MEASURED):
        self.sensors, self._derivation = sensors, derivation
        self._last = np.zeros(sensors.channels.noise.shape)

    def measure(self, step, state):
        channels, measured = self.sensors.channels, np.empty_like(self._last)
        noise = self.sensors.noise_of(step)
        measure_channels(channels, np.ravel(state) * 1.0, noise, measured)
        derive_velocity(self._derivation, step, self._last, measured)
        self._last = measured
        return measured


def sensors(rms=RMS, seed=1, **rows):
    """Sensors with this noise, and bias, range or resolution where given."""
    rms = np.asarray(rms, dtype=float)
    values = {"bias": 0.0, "range": np.inf, "resolution": 0.0} | rows
    full = {name: np.broadcast_to(value, rms.shape).astype(float) for name, value in values.items()}
    places = range(rms.shape[1])
    made = Sensors(rig_section() | {"seed": seed}, [*map(str, places)], places)
    made.channels = Channels(rms, **full)
    return Measured(made)


def from_parameters(seed=1, axes=("x", "y"), **values):
    """Sensors of the table's defaults with changes."""
    section = rig_section("sensors.", **values) | {"seed": seed}
    made = Sensors(section, axes, range(len(axes)))
    return Measured(made, Derivation.from_parameters(section, DT))


def noise(steps, rms=RMS, seed=1):
    one = sensors(rms, seed)
    return np.array([one.measure(step, np.zeros(rms.shape)) for step in steps])


@settings(max_examples=25)
@given(st.lists(st.integers(0, 20_000), max_size=10))
def test_the_noise_of_a_step_does_not_depend_on_the_steps_before(steps):
    for step, value in zip(steps, noise(steps), strict=True):
        np.testing.assert_array_equal(value, noise([step])[0])


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


def test_noise_of_an_axis_does_not_depend_on_how_many_there_are():
    steps = [0, 1, 4095, 4096, 9000]
    three = noise(steps, np.ones((4, 3)))
    for count in (1, 2):
        np.testing.assert_array_equal(noise(steps, np.ones((4, count))), three[:, :, :count])


def test_parameters_are_one_number_or_one_for_each_axis():
    names = ("displacement_noise", "velocity_noise", "acceleration_noise", "force_noise")
    values = dict(zip(names, [[5e-6, 1e-5], [0.01, 0.02], [0.05, 0.1], [3.0, 0.0]], strict=True))
    measured = from_parameters(**values).measure(4, STATE)
    np.testing.assert_array_equal(measured, STATE + noise([4])[0])
    same = from_parameters(**dict.fromkeys(names, 2.0))
    np.testing.assert_array_equal(same.measure(4, 0 * STATE), noise([4], np.full((4, 2), 2.0))[0])
    true = "rig: simulated."
    places = {"force_noise": true, "displacement_bias": true, "force_range": "/**: "}
    for name, place in places.items():
        with pytest.raises(InputError) as refused:
            from_parameters(**{name: [1.0, 2.0, 3.0]})
        assert str(refused.value).startswith(f"{place}sensors.{name}: 3 values for 2 axes")


def test_a_range_ends_either_way():
    one = from_parameters(acceleration_range=[4.5, 10.0], force_range=100.0)
    np.testing.assert_array_equal(one.measure(0, STATE)[2], [4.0, 5.0])
    np.testing.assert_array_equal(one.measure(1, 3 * STATE)[2], [4.5, 10.0])
    measured = one.measure(2, -30 * STATE)
    np.testing.assert_array_equal(measured[2:], [[-4.5, -10.0], [-100.0, -100.0]])
    np.testing.assert_array_equal(measured[:2], -30 * STATE[:2])  # no range: no end


@given(st.lists(st.floats(-3, 3), min_size=8, max_size=8))
def test_a_sensor_shows_what_is_within_its_range_as_it_is(values):
    state = np.reshape(values, (4, 2))
    measured = sensors(np.zeros((4, 2)), range=1.0).measure(0, state)
    np.testing.assert_array_equal(measured, np.clip(state, -1.0, 1.0))


@given(st.integers(1, 24), st.floats(-0.999, 0.999))
def test_a_converter_gives_the_nearest_multiple_of_its_resolution(bits, part):
    ranges = np.array([[0.1], [1.0], [40.0], [22200.0]])
    given_ranges = zip((f"{name}_range" for name in CHANNELS), ranges[:, 0].tolist(), strict=True)
    one = from_parameters(adc_bits=bits, axes=("x",), **dict(given_ranges))
    truth, step = part * ranges, 2 * ranges / 2**bits
    measured = one.measure(0, truth)
    np.testing.assert_allclose(measured / step, np.rint(measured / step), rtol=1e-15, atol=0)
    assert (np.abs(measured - truth) <= 0.5000001 * step).all()


def test_a_converter_sees_noise_and_bias_and_ends_at_the_range():
    one = sensors(np.full((4, 2), 0.3), bias=10.0, range=12.0, resolution=0.5)
    samples = np.array([one.measure(step, np.zeros((4, 2))) for step in range(4000)])
    np.testing.assert_array_equal(samples % 0.5, 0.0)
    np.testing.assert_allclose(samples.mean(axis=0), 10.0, atol=0.03)
    np.testing.assert_allclose(samples.std(axis=0), np.hypot(0.3, 0.5 / np.sqrt(12)), rtol=0.05)
    assert one.measure(9, np.full((4, 2), 99.0)).max() == 12.0


def test_a_converter_needs_a_range():
    ranges = {"displacement_range": 0.1, "velocity_range": 1.0, "force_range": 2e4}
    with pytest.raises(InputError, match=r"adc_bits is 16, but acceleration_range is 0: .* needs"):
        from_parameters(adc_bits=16, **ranges)
    with pytest.raises(InputError, match=r"displacement_range is 0"):
        from_parameters(adc_bits=16, displacement_range=[0.1, 0.0])


def test_a_velocity_that_is_derived_has_no_sensor():
    """Neither its noise nor its bias nor its range mean anything then."""
    ranges = {"displacement_range": 0.1, "acceleration_range": 40.0, "force_range": 2e4}
    one = from_parameters(velocity="derived", adc_bits=16, **ranges)
    assert one.measure(0, np.zeros((4, 2))).tolist() == np.zeros((4, 2)).tolist()
    noisy = {"velocity_noise": 5.0, "velocity_bias": 3.0, "velocity_range": 1e-9}
    other = from_parameters(velocity="derived", adc_bits=16, **ranges, **noisy)
    fast = np.array([[0.0], [9.0], [0.0], [0.0]]) * np.ones(2)
    assert not other.measure(0, fast).any()
