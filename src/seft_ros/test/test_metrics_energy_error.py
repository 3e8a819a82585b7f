import numpy as np
import pytest
from hypothesis import settings
from seft_ros.analysis.tracking import energy_error

QUICK = settings(max_examples=40)
DT = 0.002
TIME = np.arange(1001) * DT  # 2 s
OMEGA = 2 * np.pi * 5.0  # whole cycles


def test_an_error_in_phase_with_the_velocity_feeds_half_the_product_of_amplitudes():
    error, velocity = 30.0 * np.sin(OMEGA * TIME), 0.2 * np.sin(OMEGA * TIME)
    work = energy_error(error, velocity, DT)
    assert work[0] == 0.0
    assert work[-1] == pytest.approx(0.5 * 30.0 * 0.2 * 2.0, rel=1e-12)
    assert energy_error(-error, velocity, DT)[-1] == -work[-1]


def test_an_error_in_phase_with_the_displacement_feeds_nothing():
    work = energy_error(30.0 * np.cos(OMEGA * TIME), 0.2 * np.sin(OMEGA * TIME), DT)
    assert work[-1] == pytest.approx(0.0, abs=1e-12)


def test_hand_values():
    work = energy_error(np.array([1.0, 3.0, -2.0]), np.array([2.0, 1.0, 4.0]), 0.5)
    assert work.tolist() == [0.0, 1.25, 0.0]  # powers 2, 3, -8


def test_shapes_that_differ_are_refused():
    with pytest.raises(ValueError, match="same shape"):
        energy_error(np.ones(5), np.ones(4), DT)
