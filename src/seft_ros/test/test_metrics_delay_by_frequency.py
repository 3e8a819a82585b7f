import numpy as np
import pytest
from scipy.signal import butter, freqz, lfilter
from seft_ros.analysis.metrics import delayed
from seft_ros.analysis.tracking import delay_by_frequency

DT = 0.002
COUNT = 30000


def noise(seed=0):
    """Band-limited to 100 Hz."""
    white = np.random.default_rng(seed).standard_normal(COUNT)
    return lfilter(*butter(8, 100.0, fs=1 / DT), white)


def in_band(found, low=1.0, high=80.0):
    return (found.frequency_hz >= low) & (found.frequency_hz <= high)


@pytest.mark.parametrize("delay", [0.0037, -0.0037, 0.05])
def test_a_pure_delay_is_the_same_at_every_frequency(delay):
    found = delay_by_frequency(noise(), 0.8 * delayed(noise(), delay, DT), DT)
    band = in_band(found)
    assert found.delay_s[band] == pytest.approx(delay, abs=2e-5)
    assert np.median(found.delay_s[band]) == pytest.approx(delay, abs=1e-7)
    assert np.median(found.amplitude[band]) == pytest.approx(0.8, rel=1e-4)
    assert found.coherence[band].min() > 0.999


def test_a_filter_shows_its_own_amplitude_and_phase_delay():
    b, a = butter(2, 40.0, fs=1 / DT)
    found = delay_by_frequency(noise(), lfilter(b, a, noise()), DT)
    band = in_band(found)
    frequency = found.frequency_hz[band]
    _, response = freqz(b, a, worN=frequency, fs=1 / DT)
    expected = -np.unwrap(np.angle(response)) / (2 * np.pi * frequency)
    assert found.amplitude[band] == pytest.approx(np.abs(response), rel=0.02)
    assert found.delay_s[band] == pytest.approx(expected, abs=1e-4)


def test_noise_lowers_the_coherence():
    found = delay_by_frequency(noise(), noise() + noise(1), DT)
    assert found.coherence[in_band(found)].mean() == pytest.approx(0.5, abs=0.1)


def test_a_command_that_is_zero_or_too_short_has_no_delays():
    assert np.isnan(delay_by_frequency(np.zeros(50), np.ones(50), DT).delay_s).all()
    assert np.isnan(delay_by_frequency(np.ones(50), np.full(50, np.nan), DT).delay_s).all()
    assert delay_by_frequency(np.ones(1), np.ones(1), DT).delay_s.shape == (0,)
    with pytest.raises(ValueError, match="same shape"):
        delay_by_frequency(np.ones(50), np.ones(49), DT)
