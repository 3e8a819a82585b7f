"""The driver's own parts, without a network. `seft conform` checks the driver as a whole."""

from pathlib import Path

import numpy as np
from rig_driver.calibration import Calibration
from rig_driver.parameters import TABLE
from rig_driver.stand_in import StandIn
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.config.parameter_table import group

FILE = Path(__file__).parents[1] / "config" / "rig.yaml"


def parts():
    """Make the calibration of the parameter file, and the board that is driven."""
    experiment = Experiment.load([TABLE], [FILE])
    axes, section = experiment.axes, experiment["rig"]
    safe = np.full(len(axes), section["safe.valve_command"])
    board = StandIn(experiment.timebase.rate, axes, safe)
    return Calibration(group(section, "calibration"), axes), board


def velocity(calibration, board, steps):
    """Take samples; give the mean velocity of each axis over the second half, m/s."""
    samples = np.array([calibration.to_si(board.read_sample()) for _ in range(steps)])
    return samples[steps // 2 :, 1].mean(axis=0)


def test_a_positive_command_extends_the_actuator_and_the_safe_position_stops_it():
    calibration, board = parts()
    board.write_command(np.full(len(calibration.factors[0]), 0.5))
    moving = velocity(calibration, board, 100)
    assert np.all(moving > 0.01)
    board.to_safe_position()
    assert np.all(np.abs(velocity(calibration, board, 400)) < moving / 5)  # the oil leaks


def test_displacement_is_the_integral_of_velocity():
    calibration, board = parts()
    start = calibration.to_si(board.read_sample())[0]
    board.write_command(np.full(len(start), 0.5))
    samples = np.array([calibration.to_si(board.read_sample()) for _ in range(200)])
    dt = 1.0 / Experiment.load([TABLE], [FILE]).timebase.rate
    way = samples[-1, 0] - start
    np.testing.assert_allclose(samples[:, 1].sum(axis=0) * dt, way, rtol=0.02)
