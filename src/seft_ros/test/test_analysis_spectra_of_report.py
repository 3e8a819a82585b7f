"""Spectra against closed forms, and the vibration that a test has beyond its reference."""

import math

import numpy as np
import pytest
import scipy.signal
from seft_ros.analysis.report_numbers import spectrum_of, vibration

DT = 0.002
TIME = np.arange(20_000) * DT


def test_vibration_is_what_is_beyond_the_reference():
    exact = np.sin(2 * np.pi * 5.0 * TIME)
    shaking = exact + 0.3 * np.sin(2 * np.pi * 40.0 * TIME)
    reference = spectrum_of(exact, DT)
    assert vibration(spectrum_of(shaking, DT), reference, (30, 60)) == pytest.approx(0.3, rel=1e-2)
    assert vibration(reference, reference, (30, 60)) == 0
    assert vibration(spectrum_of(0.5 * exact, DT), reference, (1, 60)) == 0


def test_without_a_reference_in_motion_vibration_is_undefined():
    still = spectrum_of(np.zeros_like(TIME), DT)
    assert math.isnan(vibration(still, still, (1, 60)))


@pytest.mark.parametrize("count", [0, 1, 2, 7])
def test_short_recordings_have_short_spectra(count):
    found = spectrum_of(np.ones(count), DT)
    assert len(found.frequency_hz) == (count // 2 + 1 if count > 1 else 0)
    assert found.rms() == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("count", [2, 5, 1999, 2000, 2001, 7001])
def test_spectrum_is_that_of_scipy(count):
    y = np.random.default_rng(count).normal(size=count) + 3.0
    found = spectrum_of(y, DT)
    frequency, power = scipy.signal.welch(y, 1 / DT, nperseg=min(count, round(4.0 / DT)))
    np.testing.assert_allclose(found.frequency_hz, frequency)
    np.testing.assert_allclose(found.power, power, atol=1e-12 * power.max())
