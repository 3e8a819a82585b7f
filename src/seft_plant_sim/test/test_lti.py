"""Linear systems: one response in every form, holds and dead times that add up."""

import numpy as np
import pytest
from seft_plant_sim.lti import (
    TransferFunction,
    companion_form,
    split_dead_time,
    state_space_response,
)

HZ = np.array([0.1, 3.0, 10.0, 70.0])
NUMERATOR, DENOMINATOR = np.array([2.0, 3.0e3]), np.array([1.0, 40.0, 4.0e3, 1.0e5])


def test_a_transfer_function_and_its_companion_form_have_one_response():
    given = TransferFunction(tuple(NUMERATOR), tuple(DENOMINATOR))
    found = state_space_response(*companion_form(NUMERATOR, DENOMINATOR), 2j * np.pi * HZ)
    np.testing.assert_allclose(found[:, 0, 0], given.response(HZ), rtol=1e-12)


@pytest.mark.parametrize("delay", [0.0, 0.001, 0.002, 0.0035, 0.01, 0.0123])
def test_whole_samples_and_the_rest_add_up_to_the_dead_time(delay):
    whole, rest = split_dead_time(delay, 0.002)
    assert 0.0 <= rest < 0.002
    assert 0.002 * whole + rest == pytest.approx(delay, abs=1e-12)
