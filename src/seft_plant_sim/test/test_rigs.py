"""Several rigs, each with its part of the parameters."""

import numpy as np
import pytest
from bare_rig import driven
from seft_msgs_py.config.experiment import Experiment, parse_override
from seft_msgs_py.errors import InputError
from seft_plant_sim.rig import Rig, Rigs
from seft_plant_sim.rig_parameters import RIG_TABLE

PLAN = (
    "/**:axes:=[west/x, east/x, west/y]",
    "/**:specimen.mass:=[50.0, 40.0, 60.0]",
    "/**:specimen.damping:=[800.0, 700.0, 900.0]",
    "/**:specimen.stiffness:=[2.0e5, 0.0, -3.0e4, 0.0, 1.5e5, 0.0, -3.0e4, 0.0, 1.8e5]",
    "/**:actuator.flow_gain:=[0.04, 0.03, 0.05]",
    "rig:simulated.actuator.friction:=10.0",
    "/**:sensors.displacement_noise:=[1.0e-5, 2.0e-5, 3.0e-5]",
    "/**:sensors.force_noise:=3.0",
    "rig:safe.valve_command:=[0.1, 0.2, 0.3]",
    "rig:seed:=3",
)


def plan(*more):
    return Experiment.load([RIG_TABLE], [], [parse_override(text) for text in (*PLAN, *more)])


COMMANDS = np.random.default_rng(0).normal(scale=0.3, size=(200, 3))


def of_plan(test, rig=None):
    return Rig(test["rig"], test.axes, test.timebase, rig)


SPRINGS = [1.0, 0.0, 0.0, 1.0, 0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
YIELDING = (
    "rig:simulated.specimen.kind:=bouc_wen",
    "rig:simulated.specimen.yield_displacement:=1.0e-3",
    f"/**:specimen.springs:={SPRINGS}",
)
FILTERED = (
    "/**:sensors.velocity:=derived",
    "rig:simulated.sensors.displacement_filter:=100.0",
    "/**:calibration.force_lag:=[0.0, 0.003, 0.0005]",
    "/**:calibration.acceleration_bias:=[0.1, 0.0, 0.2]",
    "rig:simulated.sensors.acceleration_bias:=0.0",
)


FAULTS = (
    'rig:faults:=["force noise 9 at 0.1", "east/x/velocity noise 0.2 at 0", '
    '"west/y/displacement flip at 0.2", "valve scale 0.9 at 0.1"]',
)


@pytest.mark.parametrize("more", [(), YIELDING, FILTERED, FAULTS])
def test_rigs_together_do_what_one_with_all_axes_does(more):
    test = plan(*more)
    together = Rigs(test)
    found, whole = driven(together, COMMANDS), driven(of_plan(test), COMMANDS)
    scale = np.abs(whole).max(axis=0)
    np.testing.assert_allclose(found / scale, whole / scale, rtol=0, atol=1e-10)
    assert together.drive == "valve_command"


@pytest.mark.parametrize("more", [(), FAULTS])
def test_each_has_the_bits_of_its_node(more):
    test = plan(*more)
    found = driven(Rigs(test), COMMANDS)
    for rig in test.rigs:
        places = list(rig.places)
        states = driven(of_plan(test, rig), COMMANDS[:, places])
        np.testing.assert_array_equal(found[:, :, places], states)


def test_a_limit_that_one_breaks_is_the_violation_of_all():
    test = plan("/**:limits.displacement:=1.0e-4")
    together = Rigs(test)
    driven(together, np.tile([0.0, 2.0, 0.0], (200, 1)))
    assert "axis east/x" in together.violation


@pytest.mark.parametrize("name", ["mass", "damping", "stiffness"])
def test_what_two_rigs_share_can_only_be_computed(name):
    matrix = [50.0, 1.0, 0.0, 1.0, 40.0, 0.0, 0.0, 0.0, 60.0]
    test = plan(f"/**:specimen.{name}:={matrix}")
    with pytest.raises(InputError, match=f"{name} couples axes of west with those of another"):
        of_plan(test, test.rigs[0])


def test_no_spring_connects_rigs():
    springs = [1.0, -1.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0, 1.0]  # two whose stiffness adds up to none
    test = plan(
        "rig:simulated.specimen.kind:=bilinear",
        "rig:simulated.specimen.yield_displacement:=0.01",
        f"/**:specimen.springs:={springs}",
        "/**:specimen.stiffness:=[2.0e5, 2.0e5, 1.0e5]",
    )
    with pytest.raises(InputError, match="a spring connects west with another rig"):
        of_plan(test, test.rigs[0])
