"""What the motion filter makes of noise, against noise that is drawn."""

import numpy as np
import pytest
from seft_ros.reference_force.compensation.preview.motion_filter import motion_filter, motion_noise


@pytest.mark.parametrize("noise", [(5e-6, 1e-3, 0.05), (5e-5, 2e-4, 0.5)])
def test_the_noise_that_is_left_is_that_of_many_tests(noise):
    dt, tests, steps = 0.002, 400, 1500
    gains = motion_filter(dt, *noise)
    rng = np.random.default_rng(1)
    left, last = np.zeros((2, tests)), rng.normal(0.0, noise[2], tests)
    for _ in range(steps):  # of a specimen at rest
        now = rng.normal(size=(3, tests)) * np.reshape(noise, (3, 1))
        left = gains @ np.vstack([left, last, now])
        last = now[2]
    # the filter takes the acceleration's noise to be held over a step; it is linear between samples
    np.testing.assert_allclose(left.var(axis=1), np.diag(motion_noise(dt, *noise)), rtol=0.3)
