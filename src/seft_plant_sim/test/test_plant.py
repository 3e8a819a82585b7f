"""The sampled plant: its delay, and its samples.

Against an ODE solver: test_nonlinear_plant_by_hand.py; a small drive sees the linear rig.
"""

import numpy as np
import pytest
from bare_rig import BareRig, driven, make_rig
from seft_msgs_py.errors import InputError
from seft_plant_sim.simulated.continuous_model import delayed_force
from seft_plant_sim.simulated.specimen import Specimen

PAPER = Specimen(np.array([[52.7]]), np.array([[903.5]]), np.array([[2.11e5]]))


@pytest.mark.parametrize("rate", [100.0, 512.0, 1000.0, 2000.0])
def test_a_delay_of_whole_samples_is_whole_at_any_rate(rate):
    dt = 1 / rate
    for steps in (1, 3, 29, 300):
        plant = BareRig(delayed_force(PAPER, steps * dt), dt)
        force = driven(plant, np.arange(1.0, 400.0))[1:, 3, 0]
        assert np.flatnonzero(force)[0] == steps


def test_a_sample_is_not_changed_by_later_steps_nor_by_the_command_array():
    plant = BareRig(delayed_force(PAPER, 0.0), 0.002)
    command = np.ones(1)
    plant.read()
    plant.write(command)
    command[:] = 9.0
    sample = plant.read()
    kept = sample.copy()
    assert sample[3, 0] == 1.0
    for _ in range(5):
        plant.write(command)
        plant.read()
    np.testing.assert_array_equal(sample, kept)
    with pytest.raises(InputError, match="a delay of 2001 s is 1000500 samples long"):
        BareRig(delayed_force(PAPER, 2001.0), 0.002)


@pytest.mark.parametrize(
    ("kind", "times"),
    [
        ("servo_hydraulic", [0.002, 0.006]),
        ("servo_hydraulic", [0.003, 0.0]),
        ("servo_hydraulic_linear", [0.0013, 0.0055]),
        ("servo_hydraulic_linear", [0.0, 0.31]),
    ],
)
def test_each_axis_has_its_own_dead_time(kind, times):
    """Two that are not coupled do what each does alone, to rounding."""
    commands = np.random.default_rng(6).normal(size=(300, 2))
    values = {"actuator__kind": kind, "actuator__friction": 10.0, "sensors__force_lag": 0.003}
    both = driven(make_rig(("x", "y"), actuator__dead_time=times, **values), commands)
    for axis, time in enumerate(times):
        alone = driven(make_rig(actuator__dead_time=time, **values), commands[:, axis])[..., 0]
        scale = np.abs(alone).max(axis=0)
        np.testing.assert_allclose(both[..., axis] / scale, alone / scale, rtol=0.0, atol=1e-12)
