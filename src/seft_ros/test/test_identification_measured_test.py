"""Frequency responses in what a test has measured, against known ones."""

import numpy as np
import pytest
import scipy.signal
from seft_ros.identification.measured_test import frequency_response, motion_spectra

RATE = 500.0
COUNT = 120_000
SEGMENT = 8.0
BAND = (1.0, 200.0)
INPUT, OUTPUT = slice(0, 1), slice(1, 2)


def resonator(u):
    """Resonance at 40 Hz, and its frequency response."""
    b, a = scipy.signal.iirpeak(40.0, 8.0, fs=RATE)
    return scipy.signal.lfilter(b, a, u), lambda f: scipy.signal.freqz(b, a, f, fs=RATE)[1]


def measured(noise, seed=1):
    rng = np.random.default_rng(seed)
    u = rng.standard_normal(COUNT)
    y, known = resonator(u)
    y = y + noise * rng.standard_normal(COUNT)
    spectra = motion_spectra(np.column_stack([u, y]), RATE, SEGMENT)
    found = frequency_response(spectra, INPUT, OUTPUT, BAND)
    return found, known(found.frequencies_hz)


def test_without_noise_it_is_the_known_response_with_coherence_1():
    found, known = measured(0.0)
    np.testing.assert_allclose(found.response[:, 0, 0], known, atol=0.02)
    assert found.coherence.min() > 0.99
    assert found.frequencies_hz[0] == BAND[0]
    assert found.frequencies_hz[-1] == BAND[1]


def test_coherence_is_the_share_of_power_that_the_input_explains():
    for noise in (0.1, 1.0, 3.0):
        found, known = measured(noise)
        share = np.abs(known) ** 2 / (np.abs(known) ** 2 + noise**2)
        bias = 1 / 29  # of the estimate where there is no coherence at all
        np.testing.assert_allclose(found.coherence.mean(), share.mean(), atol=1.5 * bias)
        at_peak = np.abs(found.frequencies_hz - 40.0).argmin()
        assert found.coherence[at_peak, 0] == pytest.approx(share[at_peak], abs=0.25)


def test_of_several_inputs_at_once_each_response_is_found():
    rng = np.random.default_rng(2)
    u = rng.standard_normal((COUNT, 2)) @ np.array([[1.0, 0.4], [0.0, 1.0]])  # correlated
    gains = np.array([[2.0, -0.5], [0.3, 1.5]])
    y = np.roll(u, 3, axis=0) @ gains.T + 0.1 * rng.standard_normal((COUNT, 2))
    spectra = motion_spectra(np.hstack([u, y]), RATE, SEGMENT)
    found = frequency_response(spectra, slice(0, 2), slice(2, 4), (2.0, 150.0))
    turn = np.exp(-6j * np.pi * found.frequencies_hz / RATE)[:, np.newaxis, np.newaxis]
    np.testing.assert_allclose((found.response / turn).mean(axis=0), gains, atol=0.005)
    assert found.coherence.min() > 0.95
    common = np.abs(found.noise[:, 0, 1]).mean() / found.noise[:, 0, 0].real.mean()
    np.testing.assert_allclose(common, 0, atol=0.3)
