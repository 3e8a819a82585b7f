"""The compensated test as a whole, against the exact response of the whole structure."""

import pytest
from experiments_at_hand import load, simulated
from seft_ros.analysis.summary import summarise

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
    summary = summarise(simulated(load(*DELAYED, *own)))
    return summary["displacement"]["nrmse"] if summary["stable"] else float("inf")


@pytest.mark.parametrize(("alpha", "most"), [(0.5, 0.015), (1.0, 0.015), (3.0, 0.03)])
def test_the_model_brings_a_delayed_test_close_to_the_reference_as_in_figure_8(alpha, most):
    assert error("none", alpha) > 0.4
    assert error("model", alpha) < most
