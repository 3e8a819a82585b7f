"""The linear system that a controller says it is answers as its block does."""

import numpy as np
import pytest
from seft_ros.force_controller.block import ForceController
from seft_ros.force_controller.force_control import LinearControl


@pytest.mark.parametrize("axes", [1, 3])
@pytest.mark.parametrize("feedback", [True, False])
def test_the_linear_system_of_a_controller_answers_like_it(axes, feedback):
    control = ForceController([37.0, 2.0], [1.0, 17.14, 4002.0], 1e9, 0.002, axes, feedback)
    linear = control.linear()
    rng, w = np.random.default_rng(1), np.zeros(len(linear.a))
    for _ in range(50):
        force, state = rng.normal(size=axes), rng.normal(size=(4, axes))
        signals = np.concatenate([force, state.ravel()])
        expected = linear.c @ w + linear.d @ signals
        w = linear.a @ w + linear.b @ signals
        np.testing.assert_allclose(control.step(force, state), expected, rtol=1e-12, atol=1e-15)


def test_none_hands_the_reference_force_on():
    linear = LinearControl.none(2)
    assert linear.a.shape == (0, 0)
    np.testing.assert_array_equal(linear.d @ np.arange(10.0), [0.0, 1.0])
