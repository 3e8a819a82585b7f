"""What detectors keep from sample to sample."""

import math

import numpy as np
import pytest
from detector_samples import ACTUATOR, NOISE, N, detect, detectors
from seft_plant_sim.judge.channel_relations import find_flow
from seft_plant_sim.judge.detectors import FROZEN


@pytest.mark.parametrize(
    ("lost", "held"),
    [
        (0, [5.0, 1.0, 2.0, 3.0]),
        (1, [5.0, 1.0, 1.0, 2.0]),
        (2, [5.0, 1.0, 1.0, 1.0]),
        (9, [5.0, 1.0, 1.0, 1.0]),
    ],
)
def test_of_lost_samples_the_last_command_was_held(lost, held):
    rng = np.random.default_rng(1)
    past = rng.normal(size=(N, 2, 4))
    p, state = detectors(past=past)
    state.sent[:] = [[1.0, 2.0, 3.0, 4.0], [10.0, 20.0, 30.0, 40.0]]
    find_flow(p, state, lost, np.array([5.0, 50.0]))
    sent = np.outer([1.0, 10.0], held)
    np.testing.assert_array_equal(state.sent, sent)
    found = ACTUATOR[:, 0] * (past * sent[:, np.newaxis]).sum(axis=2).T
    np.testing.assert_allclose(state.flow, found, rtol=1e-12)


@pytest.mark.parametrize("chance", [0.1, 0.499, 0.5, 0.7, 1.5])
def test_of_a_sensor_coarser_than_its_noise_no_value_is_frozen(chance):
    p, state = detectors()
    coarse = chance * 2.0 * math.sqrt(math.pi) * NOISE[0, 0]
    for step, value in enumerate((0.0, coarse, coarse)):
        measured = np.zeros((4, N))
        measured[0, 0] = value
        state.shares[:] = 0.0
        detect(p, state, step, measured)
    share = math.log(chance) / math.log(1e-9) if chance < 0.5 else 0.0
    assert state.shares[FROZEN, 0] == pytest.approx(share, rel=1e-9)
