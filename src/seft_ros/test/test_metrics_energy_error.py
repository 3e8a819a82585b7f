import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from seft_ros.analysis.tracking import energy_error, relative_energy_error

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


def test_a_late_force_relative_to_the_input_is_its_closed_form():
    """Reference in phase with v, measured late by 3.7 ms: 1 - 1/cos(w tau) of the input."""
    velocity = 0.2 * np.sin(OMEGA * TIME)
    reference, force = np.sin(OMEGA * TIME), np.sin(OMEGA * (TIME - 0.0037))
    found = relative_energy_error(reference, force, velocity, DT)
    assert found == pytest.approx(1 - 1 / np.cos(OMEGA * 0.0037), rel=0.02)
    assert found < 0


@QUICK
@given(st.floats(1e-3, 1e3), st.floats(1e-3, 1e3), st.integers(0, 2**32 - 1))
def test_relative_to_the_input_it_knows_neither_unit(of_force, of_velocity, seed):
    reference, force, velocity = np.random.default_rng(seed).standard_normal((3, 30))
    one = relative_energy_error(reference, force, velocity, DT)
    other = relative_energy_error(
        of_force * reference, of_force * force, of_velocity * velocity, DT
    )
    assert other == pytest.approx(one, rel=1e-9, abs=1e-12)


@QUICK
@given(st.integers(0, 2**32 - 1))
def test_the_works_of_two_errors_add_up(seed):
    one, other, velocity = np.random.default_rng(seed).standard_normal((3, 30))
    both = energy_error(one, velocity, DT) + energy_error(other, velocity, DT)
    assert energy_error(one + other, velocity, DT) == pytest.approx(both, abs=1e-12)


def test_axes_are_columns():
    velocity = np.stack([np.sin(OMEGA * TIME)] * 2, axis=1)
    force = velocity * [2.0, 3.0]
    assert relative_energy_error(velocity, force, velocity, DT) == pytest.approx([1 / 2, 2 / 3])
    assert energy_error(force, velocity, DT)[-1] == pytest.approx([2.0, 3.0])


def test_perfect_tracking_has_no_energy_error():
    assert relative_energy_error(TIME, TIME, TIME, DT) == 0.0


def test_what_makes_no_sense_is_nan_and_shapes_that_differ_are_refused():
    assert np.isnan(relative_energy_error(np.ones(5), np.zeros(5), np.ones(5), DT))
    assert np.isnan(relative_energy_error(np.ones(1), np.ones(1), np.ones(1), DT))
    assert np.isnan(relative_energy_error(*np.empty((3, 0)), DT))
    assert np.isnan(relative_energy_error(np.ones(5), np.full(5, np.inf), np.ones(5), DT))
    with pytest.raises(ValueError, match="same shape"):
        energy_error(np.ones(5), np.ones(4), DT)
    with pytest.raises(ValueError, match="same shape"):
        relative_energy_error(np.ones(5), np.ones(5), np.ones(4), DT)
