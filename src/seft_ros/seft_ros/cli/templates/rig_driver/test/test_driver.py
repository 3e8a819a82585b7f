"""The driver's own parts, without a network. `seft conform` checks the driver as a whole."""

from pathlib import Path

import numpy as np
from rig_driver.parameters import TABLE
from rig_driver.stand_in import StandIn
from rig_driver.volts import Volts
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.config.parameter_table import group

FILE = Path(__file__).parents[1] / "config" / "rig.yaml"


def parts():
    """Make the volts of the parameter file, and the board that is driven."""
    experiment = Experiment.load([TABLE], [FILE])
    axes, section = experiment.axes, experiment["rig"]
    safe = np.full(len(axes), section["safe.valve_command"])
    board = StandIn(experiment.timebase.rate, axes, safe)
    return Volts(group(section, "volts"), axes), board


def velocity(volts, board, steps):
    """Take samples; give the mean velocity of each axis over the second half, m/s."""
    samples = np.array([volts.to_si(board.read_sample()) for _ in range(steps)])
    return samples[steps // 2 :, 1].mean(axis=0)


def test_a_positive_command_extends_the_actuator_and_the_safe_command_stops_it():
    volts, board = parts()
    board.write_command(np.full(len(volts.factors[0]), 0.5))
    moving = velocity(volts, board, 100)
    assert np.all(moving > 0.01)
    board.to_safe_command()
    assert np.all(np.abs(velocity(volts, board, 400)) < moving / 5)  # the oil leaks


def test_displacement_is_the_integral_of_velocity():
    volts, board = parts()
    start = volts.to_si(board.read_sample())[0]
    board.write_command(np.full(len(start), 0.5))
    samples = np.array([volts.to_si(board.read_sample()) for _ in range(200)])
    dt = 1.0 / Experiment.load([TABLE], [FILE]).timebase.rate
    way = samples[-1, 0] - start
    np.testing.assert_allclose(samples[:, 1].sum(axis=0) * dt, way, rtol=0.02)
