"""Fits of the specimen and of the closed loop to responses with noise."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from seft_plant_sim.lti import TransferFunction
from seft_ros.identification.measured_test import frequency_response, motion_spectra
from seft_ros.identification.response_fits import fit_specimen, fit_tracking, tracking_measures

RATE, SEGMENT, COUNT = 500.0, 8.0, 60_000
MASS = np.array([[52.7, 3.0], [3.0, 40.0]])
DAMPING = np.array([[800.0, -60.0], [-60.0, 500.0]])
STIFFNESS = np.array([[2.1e5, -2.0e4], [-2.0e4, 1.5e5]])


def measured(axes, noise, seed=1, force=1000.0, filtered=lambda s: 1.0):
    """Response of (x, a, f) to the excitation; noise: RMS of displacement, acceleration, force.

    The motion is periodic, and so exact; the sensors are not, and acceleration may be filtered.
    """
    mass, damping, stiffness = (part[:axes, :axes] for part in (MASS, DAMPING, STIFFNESS))
    rng = np.random.default_rng(seed)
    f = np.fft.rfftfreq(COUNT, 1 / RATE)
    s = 2j * np.pi * f[:, np.newaxis, np.newaxis]
    band = ((f > 0.3) & (f < 60.0))[:, np.newaxis]
    white = force * rng.standard_normal((COUNT, axes))
    drive = np.fft.rfft(white, axis=0) * band
    motion = np.linalg.solve(s**2 * mass + s * damping + stiffness, drive[..., np.newaxis])[..., 0]
    signals = [drive, motion, filtered(s[..., 0]) * s[..., 0] ** 2 * motion, drive]
    signals = [np.fft.irfft(signal, COUNT, axis=0) for signal in signals]
    for signal, rms in zip(signals[1:], noise, strict=True):
        signal += rms * rng.standard_normal(signal.shape)
    found = motion_spectra(np.hstack(signals), RATE, SEGMENT)
    return frequency_response(found, slice(0, axes), slice(axes, 4 * axes), (0.5, 50.0))


@pytest.mark.parametrize("axes", [1, 2])
def test_without_noise_the_matrices_are_found(axes):
    fit = fit_specimen([measured(axes, (0.0, 0.0, 0.0))])
    pairs = (fit.mass, MASS), (fit.damping, DAMPING), (fit.stiffness, STIFFNESS)
    for found, known in pairs:
        known = known[:axes, :axes]
        np.testing.assert_allclose(found, known, atol=0.01 * np.abs(known).max())
        np.testing.assert_array_equal(found, found.T)
    assert fit.error < 0.02


def test_noise_of_the_sensors_does_not_bias_it():
    """Noise as large as the signals; least squares on the signals would see half the stiffness."""
    noise = (1.5e-3, 4.0, 300.0)
    fits = [fit_specimen([measured(1, noise, seed)]) for seed in range(8)]
    for name, known in (("mass", MASS), ("damping", DAMPING), ("stiffness", STIFFNESS)):
        values = np.array([getattr(fit, name)[0, 0] for fit in fits]) / known[0, 0]
        assert values.std() > 1e-4
        assert abs(values.mean() - 1) < 3 * values.std() / np.sqrt(len(values)) + 0.005


def low_pass(s, hz=100.0):
    """Butterworth's of second order."""
    w = s / (2 * np.pi * hz)
    return 1.0 / (1.0 + np.sqrt(2.0) * w + w * w)


@pytest.mark.parametrize("filtered", [low_pass, lambda s: np.exp(-5e-4 * s)], ids=["filter", "lag"])
def test_what_delays_the_acceleration_is_no_damping(filtered):
    fit = fit_specimen([measured(2, (0.0, 0.0, 0.0), filtered=filtered)])
    np.testing.assert_allclose(fit.damping, DAMPING, atol=0.03 * DAMPING.max())
    np.testing.assert_allclose(fit.mass, MASS, atol=0.01 * MASS.max())


def test_damping_is_never_negative():
    drowned = (1.5e-2, 40.0, 3000.0)
    for seed in range(6):
        fit = fit_specimen([measured(1, drowned, seed)])
        assert fit.damping[0, 0] >= 0.0


F = np.arange(0.3, 100.0, 0.1)
ONES = np.ones(len(F))


def pair(hz, damping):
    w = 2 * np.pi * hz
    return np.array([1.0, 2 * damping * w, w * w])


def test_a_pair_with_dead_time_is_found():
    known = TransferFunction((pair(25.0, 0.6)[2],), tuple(pair(25.0, 0.6)), 0.008)
    fit = fit_tracking(F, known.response(F), ONES)
    assert fit.error < 1e-6
    assert fit.model.dead_time == pytest.approx(0.008, rel=1e-4)
    np.testing.assert_allclose(fit.model.denominator, pair(25.0, 0.6), rtol=1e-3)
    np.testing.assert_allclose(fit.model.numerator, [pair(25.0, 0.6)[2]], rtol=1e-3)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_it_is_stable_whatever_the_data(seed):
    rng = np.random.default_rng(seed)
    noise = rng.standard_normal(len(F)) + 1j * rng.standard_normal(len(F))
    fit = fit_tracking(F, np.exp(-0.06j * F) + 0.5 * noise, ONES)
    assert np.roots(fit.model.denominator).real.max() < 0
    assert fit.model.dead_time >= 0


def test_the_dead_time_is_at_least_the_latency_that_is_there():
    """Lags in series may pass for a dead time and the other way round: 6 ms, of which 2 dead."""
    lags = 1 / np.polyval(np.polymul([0.002, 1.0], [0.002, 1.0]), 2j * np.pi * F)
    measured = lags * np.exp(-2j * np.pi * F * 0.002)
    free = fit_tracking(F, measured, ONES)
    held = fit_tracking(F, measured, ONES, least_dead_time=0.003)
    assert free.model.dead_time == pytest.approx(0.002, rel=0.05)
    assert held.model.dead_time >= 0.003
    assert held.error < 0.1


# ---- What is measured of a closed loop that follows


WIDE = np.geomspace(0.05, 200.0, 600)
S = 2j * np.pi * WIDE


@settings(max_examples=12)
@given(st.floats(0.0, 0.04), st.booleans())
def test_a_pure_delay_is_found_however_the_frequencies_lie(delay, evenly):
    f = np.linspace(0.5, 100.0, 200) if evenly else WIDE
    delayed = np.exp(-2j * np.pi * f * delay)
    found = tracking_measures(f, delayed)
    assert found.delay_s == pytest.approx(delay, abs=1e-12)
    assert (found.closed_loop_flat_to_hz, found.bandwidth_hz) == (None, None)
    assert (found.dip_db, found.dip_hz) == (None, None)


def test_bandwidth_of_a_first_order_lag_is_its_corner():
    found = tracking_measures(WIDE, 1 / (1 + S / (2 * np.pi * 20)))
    half_power = np.sqrt(10**0.3 - 1)  # -3 dB is not quite half
    assert found.bandwidth_hz == pytest.approx(20 * half_power, rel=1e-3)
    assert found.closed_loop_flat_to_hz == pytest.approx(20 * np.sqrt(10**0.1 - 1), rel=1e-3)


def test_a_dip_is_reported_with_its_place():

    def notch(hz):
        w = 2 * np.pi * hz
        return (S**2 + 2 * 0.10 * w * S + w**2) / (S**2 + 2 * 0.11 * w * S + w**2)

    found = tracking_measures(WIDE, notch(10.0))
    assert found.dip_db == pytest.approx(20 * np.log10(0.10 / 0.11), abs=0.05)
    assert found.dip_hz == pytest.approx(10.0, rel=0.02)
    assert tracking_measures(WIDE, notch(30.0)).dip_db is None  # beyond the band


def test_noise_and_outliers_change_little():
    rng = np.random.default_rng(3)
    f = np.arange(0.5, 100.0, 0.5)
    clean = np.exp(-2j * np.pi * f * 0.014) / (1 + (1j * f / 40) ** 2 + 1.4j * f / 40)
    noisy = clean + 0.01 * (rng.standard_normal(len(f)) + 1j * rng.standard_normal(len(f)))
    noisy[[10, 30, 31]] *= 2.0  # 6 dB
    true, found = tracking_measures(f, clean), tracking_measures(f, noisy)
    assert found.delay_s == pytest.approx(true.delay_s, rel=0.01)
    assert found.closed_loop_flat_to_hz == pytest.approx(true.closed_loop_flat_to_hz, rel=0.1)
    assert found.bandwidth_hz == pytest.approx(true.bandwidth_hz, rel=0.1)
    assert found.dip_db is None


def test_a_loop_that_never_follows_is_flat_nowhere():
    found = tracking_measures(WIDE, np.full(len(WIDE), 0.1 + 0j))
    assert (found.closed_loop_flat_to_hz, found.bandwidth_hz, found.delay_s) == (0.0, 0.0, None)
    unknown = np.full(len(WIDE), np.nan, dtype=complex)
    assert tracking_measures(WIDE, unknown).delay_s is None
