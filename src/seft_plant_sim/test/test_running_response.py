"""The response piece by piece is the response at once."""

import numpy as np
import pytest
from seft_msgs_py.config.experiment import Experiment
from seft_plant_sim.rig_parameters import RIG_TABLE
from seft_plant_sim.whole_structure import RunningResponse, reference_response

MODEL = {"model.mass": [52.7], "method": "seft", "mass_ratio": 1.5, "rate": 500.0, "axes": ["x"]}


def experiment(**specimen):
    rig = Experiment.load(
        [RIG_TABLE], [], [("rig", f"specimen.{name}", value) for name, value in specimen.items()]
    )["rig"]
    return Experiment({"rig": {**rig, "rate": 500.0, "axes": ["x"]}, "reference_force": MODEL})


LINEAR = experiment(mass=52.7, damping=800.3, stiffness=2.11e5)


@pytest.mark.parametrize("kind", ["bilinear", "bouc_wen"])
def test_of_a_specimen_that_yields_the_response_is_near(kind):
    yielding = experiment(
        kind=kind, mass=52.7, damping=800.3, stiffness=2.11e5, yield_displacement=0.004
    )
    time = np.arange(500) / 500.0
    motion = 8.0 * np.sin(2.0 * np.pi * 5.0 * time)[:, np.newaxis]
    response = RunningResponse(yielding)
    assert not response.exact
    found = [response.advance(piece) for piece in np.split(motion, [70, 71, 300])]
    wanted = reference_response(yielding, motion)
    linear = reference_response(LINEAR, motion)
    assert np.abs(wanted.displacement - linear.displacement).max() > 0.004  # it does yield
    for index, quantity in enumerate((wanted.displacement, wanted.acceleration)):
        joined = np.concatenate([part[index] for part in found])
        np.testing.assert_allclose(joined, quantity, rtol=0.0, atol=0.02 * np.abs(quantity).max())
