"""Linear systems: dead times that add up."""

import pytest
from seft_plant_sim.lti import split_dead_time


@pytest.mark.parametrize("delay", [0.0, 0.001, 0.002, 0.0035, 0.01, 0.0123])
def test_whole_samples_and_the_rest_add_up_to_the_dead_time(delay):
    whole, remainder = split_dead_time(delay, 0.002)
    assert 0.0 <= remainder < 0.002
    assert 0.002 * whole + remainder == pytest.approx(delay, abs=1e-12)
