import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from seft_ros.identification.response_fits import tracking_measures

F = np.geomspace(0.05, 200.0, 600)
S = 2j * np.pi * F


@settings(max_examples=12)
@given(st.floats(0.0, 0.04), st.booleans())
def test_a_pure_delay_is_found_however_the_frequencies_lie(delay, evenly):
    f = np.linspace(0.5, 100.0, 200) if evenly else F
    delayed = np.exp(-2j * np.pi * f * delay)
    found = tracking_measures(f, delayed)
    assert found.delay_s == pytest.approx(delay, abs=1e-12)
    assert (found.closed_loop_flat_to_hz, found.bandwidth_hz) == (None, None)
    assert (found.dip_db, found.dip_hz) == (None, None)


def test_bandwidth_of_a_first_order_lag_is_its_corner():
    found = tracking_measures(F, 1 / (1 + S / (2 * np.pi * 20)))
    half_power = np.sqrt(10**0.3 - 1)  # -3 dB is not quite half
    assert found.bandwidth_hz == pytest.approx(20 * half_power, rel=1e-3)
    assert found.closed_loop_flat_to_hz == pytest.approx(20 * np.sqrt(10**0.1 - 1), rel=1e-3)


def test_a_dip_is_reported_with_its_place():

    def notch(hz):
        w = 2 * np.pi * hz
        return (S**2 + 2 * 0.10 * w * S + w**2) / (S**2 + 2 * 0.11 * w * S + w**2)

    found = tracking_measures(F, notch(10.0))
    assert found.dip_db == pytest.approx(20 * np.log10(0.10 / 0.11), abs=0.05)
    assert found.dip_hz == pytest.approx(10.0, rel=0.02)
    assert tracking_measures(F, notch(30.0)).dip_db is None  # beyond the band


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
    found = tracking_measures(F, np.full(len(F), 0.1 + 0j))
    assert (found.closed_loop_flat_to_hz, found.bandwidth_hz, found.delay_s) == (0.0, 0.0, None)
    unknown = np.full(len(F), np.nan, dtype=complex)
    assert tracking_measures(F, unknown).delay_s is None
