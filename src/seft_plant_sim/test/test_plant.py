"""The sampled plant: its delay, and its samples.

Against an ODE solver: test_nonlinear_plant_by_hand.py; a small drive sees the linear rig.
"""

import numpy as np
import pytest
from bare_rig import BareRig, driven
from seft_msgs_py.errors import InputError
from seft_plant_sim.continuous_model import delayed_force
from seft_plant_sim.specimen import Specimen

PAPER = Specimen(np.array([[52.7]]), np.array([[903.5]]), np.array([[2.11e5]]))


@pytest.mark.parametrize("rate", [100.0, 512.0, 1000.0, 2000.0])
def test_a_delay_of_whole_samples_is_whole_at_any_rate(rate):
    dt = 1 / rate
    for steps in (1, 3, 29, 300):
        plant = BareRig(delayed_force(PAPER, steps * dt), dt)
        force = driven(plant, np.arange(1.0, 400.0))[1:, 3, 0]
        assert np.flatnonzero(force)[0] == steps


def test_a_sample_is_not_changed_by_later_steps_nor_by_the_command_array():
    plant = BareRig(delayed_force(PAPER, 0.001), 0.002)
    command = np.ones(1)
    sample = plant.step(command)
    kept = sample.copy()
    for _ in range(5):
        plant.step(np.full(1, 9.0))
    np.testing.assert_array_equal(sample, kept)
    with pytest.raises(InputError, match="a delay of 2001 s is 1000500 samples long"):
        BareRig(delayed_force(PAPER, 2001.0), 0.002)
