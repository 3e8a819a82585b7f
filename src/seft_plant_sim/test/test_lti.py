"""Linear systems: dead times that add up, inverses that fit into memory."""

import numpy as np
import pytest
from seft_msgs_py.errors import InputError
from seft_plant_sim.lti import noncausal_inverse, split_dead_time


@pytest.mark.parametrize("delay", [0.0, 0.001, 0.002, 0.0035, 0.01, 0.0123])
def test_whole_samples_and_the_rest_add_up_to_the_dead_time(delay):
    whole, remainder = split_dead_time(delay, 0.002)
    assert 0.0 <= remainder < 0.002
    assert 0.002 * whole + remainder == pytest.approx(delay, abs=1e-12)


def test_an_inverse_of_too_many_samples_is_refused_before_it_takes_memory():
    with pytest.raises(InputError, match=r"rate is 1e\+06 Hz, .* takes 1000000000 samples"):
        noncausal_inverse(np.ones_like, 100.0, 10**9, 1e-6)
