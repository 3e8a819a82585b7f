"""Correction of the baseline: what is left at the end, and what the filter does."""

import numpy as np
import pytest
from seft_ros.ground_motion.conditioning import baseline_numbers, correct, velocity_and_displacement

DT = 0.01
T = DT * np.arange(4001)
PULSE = np.sin(2 * np.pi * 1.5 * T) * np.exp(-(((T - 20) / 3) ** 2))
DRIFTING = (PULSE + 0.02 + 0.001 * T)[:, np.newaxis]


def test_the_integrals_are_exact_for_a_motion_that_is_linear_between_its_samples():
    v, d = velocity_and_displacement((2.0 + 3.0 * T)[:, np.newaxis], DT)
    np.testing.assert_allclose(v[:, 0], 2 * T + 1.5 * T**2, atol=1e-9)
    np.testing.assert_allclose(d[:, 0], T**2 + 0.5 * T**3, atol=1e-7)


def test_the_numbers_of_a_step_are_those_of_the_closed_form():
    numbers = baseline_numbers(np.full((101, 1), -2.0), DT)
    assert numbers == {
        "offset": [-2.0],
        "peak_acceleration": [2.0],
        "peak_velocity": [pytest.approx(2.0)],
        "peak_displacement": [pytest.approx(1.0)],
        "residual_velocity": [pytest.approx(-2.0)],
        "residual_displacement": [pytest.approx(-1.0)],
    }


def test_none_changes_no_bit_and_offset_takes_off_the_mean():
    assert correct(DRIFTING, DT, "none", 0.1, 4, True) is DRIFTING
    found = correct(DRIFTING, DT, "offset", 0.1, 4, True)
    np.testing.assert_allclose(found, DRIFTING - DRIFTING.mean())


@pytest.mark.parametrize("corner", [0.0, 0.05, 0.2])
@pytest.mark.parametrize("both_ways", [True, False])
def test_velocity_and_displacement_end_at_zero(corner, both_ways):
    motion = np.hstack([DRIFTING, -2 * DRIFTING])
    numbers = baseline_numbers(correct(motion, DT, "baseline", corner, 4, both_ways), DT)
    np.testing.assert_allclose(numbers["residual_velocity"], 0, atol=1e-12)
    np.testing.assert_allclose(numbers["residual_displacement"], 0, atol=1e-10)
    assert baseline_numbers(motion, DT)["residual_displacement"][0] > 10


def test_a_parabola_is_taken_off_whole():
    parabola = (0.3 - 0.1 * T + 0.002 * T**2)[:, np.newaxis]
    pulse = PULSE[:, np.newaxis]
    plain = correct(pulse, DT, "baseline", 0.0, 4, True)
    np.testing.assert_allclose(
        correct(pulse + parabola, DT, "baseline", 0.0, 4, True), plain, atol=1e-12
    )
    np.testing.assert_allclose(plain, pulse, atol=1e-3)


def test_a_filter_both_ways_shifts_no_phase():
    slow = (np.sin(np.pi * T / T[-1]) ** 2 * np.sin(2 * np.pi * 0.05 * T))[:, np.newaxis]
    pulse = PULSE[:, np.newaxis]
    found = correct(pulse + slow, DT, "baseline", 0.2, 4, True)[1000:3000]
    np.testing.assert_allclose(found, pulse[1000:3000], atol=2e-3)
    once = correct(pulse + slow, DT, "baseline", 0.2, 4, False)[1000:3000]
    assert np.abs(once - pulse[1000:3000]).max() > 0.05
