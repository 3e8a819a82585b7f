"""What detectors keep from sample to sample."""

import math

import numpy as np
import pytest
from detector_samples import ACTUATOR, DT, NO_TARGET, NOISE, N, detect, detectors
from seft_plant_sim.judge.channel_relations import find_flow
from seft_plant_sim.judge.detector_list import DETECTORS
from seft_plant_sim.judge.detectors import FROZEN, TRACKING


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


def test_tracking_is_compared_with_the_largest_recent_motion_of_its_axis():
    alone = [one.name for one in DETECTORS if one.name != "tracking"]
    p, state = detectors(alone)
    at, found, largest = (0.004, 0.003), [], np.zeros(N)
    for step in range(10):
        target = np.array([0.004, -0.01 if step < 1 else -0.0099])
        points, measured = np.zeros((1, 3, N)), np.zeros((4, N))
        points[0, 0], measured[0] = target, at
        state.shares[:] = 0.0
        found.append(detect(p, state, step, points, measured))
        of_both = np.maximum(np.abs(target), at)
        largest = np.maximum(of_both, p.memory * largest)
        bias = p.most[0, 2] * DT / (1.0 - p.fade)
        share = np.abs(target - at) / (p.sums[0] + bias + p.off_target * largest)
        np.testing.assert_allclose(state.shares[TRACKING], share, rtol=1e-12)
    assert found[-2:] == [-1, TRACKING * N + 1]


@pytest.mark.parametrize("chance", [0.1, 0.499, 0.5, 0.7, 1.5])
def test_of_a_sensor_coarser_than_its_noise_no_value_is_frozen(chance):
    p, state = detectors()
    coarse = chance * 2.0 * math.sqrt(math.pi) * NOISE[0, 0]
    for step, value in enumerate((0.0, coarse, coarse)):
        measured = np.zeros((4, N))
        measured[0, 0] = value
        state.shares[:] = 0.0
        detect(p, state, step, NO_TARGET, measured)
    share = math.log(chance) / math.log(1e-9) if chance < 0.5 else 0.0
    assert state.shares[FROZEN, 0] == pytest.approx(share, rel=1e-9)
