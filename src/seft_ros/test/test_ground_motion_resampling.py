"""Resampling to the rate of the loop: no peak is lost, nothing is folded."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from seft_msgs_py.wire.topics import Timebase
from seft_ros.ground_motion.conditioning import resample

STEPS = np.arange(4000)


def waves(frequencies, dt=0.005):
    """Sum of sines that begins and ends softly."""
    t = dt * STEPS
    window = np.sin(np.pi * STEPS / STEPS[-1]) ** 2
    return sum(np.sin(2 * np.pi * f * t + f) for f in frequencies)[:, np.newaxis] * window[:, None]


@given(
    st.sampled_from([0.01, 0.005, 0.02, 1 / 3 * 0.01]),
    st.sampled_from([0.5, 1.0, 2.0, 0.3]),
    st.integers(2, 3000),
)
def test_a_loop_at_the_rate_of_the_record_gives_the_record_itself(dt, time_scale, length):
    record = np.random.default_rng(length).normal(size=(length, 2))
    timebase = Timebase(1 / (dt * time_scale))
    exact = timebase.dt / time_scale
    np.testing.assert_array_equal(resample(record, exact, timebase, time_scale)[0], record)


@pytest.mark.parametrize(("rate", "time_scale"), [(400.0, 1.0), (1000.0, 0.2), (500.0, 0.4)])
def test_at_a_multiple_of_its_rate_each_sample_of_the_record_is_a_step(rate, time_scale):
    record = waves([1.3, 30.0])
    found = resample(record, 0.005, Timebase(rate), time_scale)
    every = round(rate * 0.005 * time_scale)
    np.testing.assert_allclose(found[0][::every], record, atol=1e-12)
    assert found[1].endswith("each of its samples is a step")


@pytest.mark.parametrize(
    ("rate", "time_scale"), [(500.0, 1.0), (512.0, 1.0), (625.0, 0.7), (1000.0, 1.0)]
)
def test_between_its_samples_a_record_is_band_limited(rate, time_scale):
    record = waves([1.3, 11.0, 60.0])
    found = resample(record, 0.005, Timebase(rate), time_scale)[0][:, 0]
    ratio = 1 / rate / (0.005 * time_scale)
    shift = np.round(np.argmax(np.abs(record)) % ratio, 9) % ratio
    places = shift + np.arange(len(found)) * ratio
    fine = np.sin(np.pi * places / STEPS[-1]) ** 2
    expected = sum(np.sin(2 * np.pi * f * 0.005 * places + f) for f in (1.3, 11.0, 60.0)) * fine
    np.testing.assert_allclose(found, expected, atol=2e-4)


@pytest.mark.parametrize(("rate", "time_scale"), [(500.0, 0.2), (400.0, 0.2), (100.0, 1.0)])
def test_a_slower_loop_keeps_what_it_can_show_and_folds_nothing(rate, time_scale):
    low = resample(waves([2.0, 9.0]), 0.005, Timebase(rate), time_scale)
    both = resample(waves([2.0, 9.0, 93.0]), 0.005, Timebase(rate), time_scale)
    limit = 0.46 * rate * time_scale
    assert f"band-limited to {0.46 * rate:.4g} Hz" in both[1]
    assert limit < 93.0
    length = min(len(low[0]), len(both[0]))
    spectrum = np.abs(np.fft.rfft(both[0][:length, 0])) / length
    expected = np.abs(np.fft.rfft(low[0][:length, 0])) / length
    np.testing.assert_allclose(spectrum, expected, atol=1e-3)
    assert expected.max() > 0.1


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize(("rate", "time_scale"), [(500.0, 0.2), (500.0, 1.0), (320.0, 0.3)])
def test_the_peak_is_not_lost(seed, rate, time_scale):
    random = np.random.default_rng(seed)
    record = waves(random.uniform(0.5, 25.0, 20))
    peak = np.abs(record).max()
    found = np.abs(resample(record, 0.005, Timebase(rate), time_scale)[0]).max()
    assert 0.999 * peak <= found <= 1.05 * peak  # a peak between two samples may be higher


def test_the_ends_of_a_record_hold():
    record = np.full((100, 1), 3.0)
    for time_scale in (0.2, 1.0):
        found = resample(record, 0.005, Timebase(500.0), time_scale)[0]
        np.testing.assert_allclose(found, 3.0, rtol=1e-12)


def test_a_motion_that_is_linear_between_its_samples_is_so_at_any_rate():
    record = np.array([[0.0], [2.0], [0.0], [-4.0], [0.0]])
    for rate, expected in (
        (50.0, [0, 0, 0]),
        (125.0, [0, 1.6, 0.8, -1.6, -3.2, 0]),
        (64.0, [0, 0.875, -3.5]),  # ends between two steps: 1.5625, 3.125 record steps
    ):
        found = resample(record, 0.01, Timebase(rate), linear=True)
        np.testing.assert_allclose(found[0][:, 0], expected, atol=1e-12)
        assert found[1] == "linear between its samples"
