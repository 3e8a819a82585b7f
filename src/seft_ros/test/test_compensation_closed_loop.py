"""The compensated test as a whole, against the exact response of the whole structure."""

from pathlib import Path

import pytest
from seft_msgs_py.config.experiment import Experiment, parse_override
from seft_ros.analysis.summary import summarise
from seft_ros.test_run.compiled_loop import build_blocks
from seft_ros.test_run.offline import simulate_test
from seft_ros.test_run.parameter_tables import TABLES

JHU = Path(__file__).parents[3] / "config" / "jhu.yaml"
DELAYED = (
    "ground_motion:synthetic.duration:=16.0",
    "ground_motion:peak_force:=300.0",
    "rig:actuator.kind:=delay",
    "rig:actuator.delay:=0.01",
    "reference_force:compensation.delay:=0.013",  # and a step of latency, and half a step held
)


def error(method, alpha):
    """Error of the displacement; infinite if the test tripped."""
    own = (f"reference_force:mass_ratio:={alpha}", f"reference_force:compensation.method:={method}")
    words = [parse_override(word) for word in (*DELAYED, *own)]
    experiment = Experiment.load(TABLES, [JHU], words)
    summary = summarise(simulate_test(experiment, build_blocks(experiment)))
    return summary["displacement"]["nrmse"] if summary["stable"] else float("inf")


@pytest.mark.parametrize(("alpha", "most"), [(0.5, 0.015), (1.0, 0.015), (3.0, 0.03)])
def test_the_model_brings_a_delayed_test_close_to_the_reference_as_in_figure_8(alpha, most):
    assert error("none", alpha) > 0.4
    assert error("model", alpha) < most
