import numpy as np
import pytest
from seft_plant_sim import whole_structure


@pytest.mark.parametrize("count", [*range(1, 20), 500, 9973])
def test_all_pieces_at_a_time_give_what_step_by_step_gives(count):
    rng = np.random.default_rng(count)
    free = np.array([[0.99, 0.1, 0.0], [-0.1, 0.99, 0.02], [0.0, 0.0, 0.9]])
    driven = rng.normal(size=(count, 3))
    expected = driven.copy()
    for step in range(1, count):
        expected[step] += free @ expected[step - 1]
    whole_structure._recur(free, driven)
    np.testing.assert_allclose(driven, expected, rtol=0, atol=1e-12 * np.abs(expected).max())
