"""What the simulated rig does when its valve goes to its safe position."""

from pathlib import Path

import numpy as np
from seft_msgs_py.config.experiment import Experiment
from seft_plant_sim.rig import Rig
from seft_plant_sim.rig_parameters import TABLE

JHU = Path(__file__).parents[3] / "config" / "jhu.yaml"  # wherever it runs, as by colcon test


def moving_rig(*overrides):
    experiment = Experiment.load([TABLE], [JHU], overrides, nodes=["rig"])
    rig = Rig.from_parameters(experiment["rig"], experiment.axes, experiment.timebase)
    rig.reset()
    for step in range(200):
        rig.step(np.array([5.0 * np.sin(2 * np.pi * 5.0 * 0.002 * step)]))
    return rig


def test_a_closed_valve_locks_the_piston_on_its_oil_column():
    rig = moving_rig()
    before = abs(rig.sample[1, 0])
    assert before > 0.03
    stopped = rig.stop()
    assert stopped.steps <= 100
    assert abs(rig.sample[1, 0]) < 0.2 * before
    assert stopped.peak_force > abs(rig.sample[3]).max()
    assert rig.step_index == 199 + 1  # the samples of the test are what they were


def test_a_rig_without_a_settling_time_is_left_where_it_is():
    rig = moving_rig(("rig", "safe.settle_time", 0.0))
    assert rig.stop().steps == 0


def test_the_safe_position_is_that_of_the_parameters():
    closed, opened = moving_rig(), moving_rig(("rig", "safe.valve_command", 2.0))
    closed.stop()
    opened.stop()
    assert abs(opened.sample[3, 0]) > abs(closed.sample[3, 0]) + 100.0


def test_a_rig_at_rest_is_settled_at_once():
    experiment = Experiment.load([TABLE], [JHU], [], nodes=["rig"])
    rig = Rig.from_parameters(experiment["rig"], experiment.axes, experiment.timebase)
    rig.reset()
    assert rig.stop().steps == 10


def test_two_axes_stop_too():
    axes = ("/**", "axes", ["x", "y"])
    experiment = Experiment.load([TABLE], [JHU], [axes], nodes=["rig"])
    rig = Rig.from_parameters(experiment["rig"], experiment.axes, experiment.timebase)
    rig.reset()
    for _ in range(50):
        rig.step(np.array([3.0, -3.0]))
    assert rig.stop().peak_force > 0.0
    assert np.abs(rig.sample[1]).max() < 0.05
