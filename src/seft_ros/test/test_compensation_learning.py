"""Whether a method learns right after its answer or only with the next step makes no difference."""

from pathlib import Path

import numpy as np
import pytest
from seft_msgs_py.experiment import Experiment
from seft_msgs_py.parameter_file import parse_override
from seft_msgs_py.topics import REFERENCE_FORCE
from seft_ros.experiment.blocks import build_blocks
from seft_ros.experiment.offline import simulate
from seft_ros.experiment.tables import TABLES

JHU = Path(__file__).parents[3] / "config" / "jhu.yaml"
SHORT = (
    "ground_motion:synthetic.duration:=10.0",
    "ground_motion:tail:=0.5",
    "reference_force:mass_ratio:=0.3",
    "reference_force:compensation.delay:=0.012",
)
FOLLOWED = "reference_force:compensation.estimate_delay:=true"
METHODS = {
    "preview_inverse": (),
    "preview_inverse, yielding": (
        "ground_motion:peak_force:=400.0",
        "rig:specimen.kind:=bouc_wen",
        "rig:specimen.yield_displacement:=0.0015",
    ),
    "ats": (),
    "polynomial": (FOLLOWED,),
    "polynomial, a tuned mass": (
        FOLLOWED,
        "reference_force:computed.internal:=1",
        "reference_force:computed.mass:=[50.0, 0.0, 0.0, 5.0]",
        "reference_force:computed.damping:=[10.0, -10.0, -10.0, 10.0]",
        "reference_force:computed.stiffness:=[2.0e4, -2.0e4, -2.0e4, 2.0e4]",
        "reference_force:computed.influence:=[1.0]",
    ),
}


def run(words, when):
    """Forces and estimates of a test, ``learn`` being called every so many steps."""
    experiment = Experiment.load(TABLES, [JHU], [parse_override(word) for word in words])
    blocks = build_blocks(experiment)
    force, steps = blocks.reference_force, 0
    answer = force.step

    def step(*given):
        nonlocal steps
        found, steps = answer(*given), steps + 1
        if when and steps % when == 0:
            force.learn()
        return found

    force.step = step
    record = simulate(experiment, blocks)
    assert record.trip is None
    return record.series[REFERENCE_FORCE.name].values, record.estimates


@pytest.mark.parametrize("name", METHODS)
def test_when_it_learns_makes_no_difference(name):
    method = f"reference_force:compensation.method:={name.partition(',')[0]}"
    words = (*SHORT, method, *METHODS[name])
    forces, estimates = run(words, when=0)
    assert np.ptp(estimates.values, axis=0).any(), "it learnt nothing"
    for when in (1, 7):
        again, found = run(words, when)
        np.testing.assert_array_equal(again, forces)
        np.testing.assert_array_equal(found.values, estimates.values)
