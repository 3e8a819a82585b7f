"""A polynomial in s as weights of the steps to come."""

import numpy as np
import pytest
from seft_ros.reference_force.compensation.preview.coming_weights import coming_weights

E = np.array([3.2e-10, 5.4e-8, 4.7e-6, 2.4e-4, 0.01])  # of the frame in config/


@pytest.mark.parametrize("dt", [0.005, 0.002, 0.001, 0.0002])
def test_the_weighted_sum_is_the_polynomial_where_structures_move(dt):
    s = 2j * np.pi * np.linspace(0.0, 15.0, 16)
    weights = coming_weights(E, dt)
    found = np.exp(np.outer(s, dt * np.arange(len(weights)))) @ weights
    np.testing.assert_allclose(found, np.polyval(E, s), atol=0.012)


@pytest.mark.parametrize("dt", [0.005, 0.002, 0.001, 0.0002])
def test_it_is_small_where_no_loop_is_inverted(dt):
    s = 2j * np.pi * np.linspace(20.0, 100.0, 81)
    weights = coming_weights(E, dt)
    found = np.exp(np.outer(s, dt * np.arange(len(weights)))) @ weights
    assert np.abs(found).max() < 0.06
    assert np.abs(np.polyval(E, s)).max() > 30.0  # as the polynomial is not


def test_without_a_polynomial_nothing_counts():
    np.testing.assert_array_equal(coming_weights(np.zeros(1), 0.002), 0.0)
