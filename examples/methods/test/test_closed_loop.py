"""Compensated tests as a whole, against the exact response of the whole structure."""

import numpy as np
import pytest
from experiments_at_hand import load
from seft_ros.analysis.summary import summarise
from seft_ros.test_run.blocks import build_blocks
from seft_ros.test_run.offline import simulate_test

DELAYED = (
    "/**:actuator.kind:=delay",
    "/**:actuator.delay:=0.01",
)


def run(method, alpha, *words):
    """Blocks and summary of a test."""
    given = (
        "ground_motion:synthetic.duration:=16.0",
        "ground_motion:peak_force:=300.0",
        f"reference_force:mass_ratio:={alpha}",
        f"reference_force:compensation.method:={method}",
        *words,
    )
    experiment = load(*given)
    blocks = build_blocks(experiment)
    return blocks, summarise(simulate_test(experiment, blocks))


def error(*arguments):
    summary = run(*arguments)[1]
    return summary["displacement"]["nrmse"] if summary["stable"] else np.inf


@pytest.mark.parametrize(
    ("method", "alpha", "least"),
    [
        ("smith", 1.0, 0.015),
        ("smith", 3.0, 0.03),
        ("linear_acceleration", 0.5, 0.03),
        ("linear_acceleration", 1.5, 0.08),
        ("polynomial", 0.2, 0.25),
    ],
)
def test_what_predicts_the_acceleration_goes_beyond_what_none_can(method, alpha, least):
    assert error(method, alpha, *DELAYED) < min(least, error("none", alpha, *DELAYED))
