"""Linear systems: dead times that add up, inverses that fit into memory."""

import math

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


@pytest.mark.parametrize("rate", [250.0, 500.0, 1000.0, 2048.0, 4096.0, 20000.0])
@pytest.mark.parametrize(("highest", "ahead"), [(10.0, 0.1), (50.0, 0.02)])
def test_an_inverse_is_as_good_at_any_rate_and_exact_at_rest(rate, highest, ahead):
    late, dt = 0.2 * ahead, 1.0 / rate
    past, taps = round(0.5 * ahead * rate), round(1.5 * ahead * rate)

    def response(s):
        return 2.0 * np.exp(-s * late) / (1.0 + s / (4.0 * math.pi * highest))

    h = noncausal_inverse(response, highest, taps, dt, past)
    s = 2j * math.pi * np.linspace(0.0, 0.7 * highest, 500)
    through = response(s) * (np.exp(np.outer(s, np.arange(-past, taps - past) * dt)) @ h)
    assert np.abs(through - 1.0).max() < 0.005
    assert through[0] == pytest.approx(1.0, abs=1e-9)
