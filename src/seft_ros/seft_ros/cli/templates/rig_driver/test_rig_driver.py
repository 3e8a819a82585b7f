"""The class gives samples of its axes, and stands still at its safe command."""

from pathlib import Path

import numpy as np
from rig_driver import Hardware
from seft_msgs_py.config.experiment import Experiment
from seft_plant_sim.rig_parameters import RIG_TABLE


def test_it_moves_with_its_valve_and_stands_when_it_is_safe():
    """Of the simulated converter board; your own needs its pressure."""
    file = Path(__file__).parent / "laboratory.yaml"
    test = Experiment.load([RIG_TABLE], [file], [])
    hardware = Hardware(test["rig"], test.axes)
    hardware.write(np.array([0.2]))
    moved = [hardware.read() for _ in range(100)][-1]
    assert moved.shape == (4, 1)
    assert moved[0, 0] > 0.0
    hardware.safe()
    after = np.array([hardware.read() for _ in range(200)])[:, 0, 0]
    assert np.abs(after).max() < 1.5 * moved[0, 0]  # an open valve moves it to three times that
