"""Compensated tests as a whole, against the exact response of the whole structure."""

import numpy as np
import pytest
from experiments_at_hand import error_of, load, simulated

DELAYED = (
    "/**:actuator.kind:=delay",
    "/**:actuator.delay:=0.01",
)


def error(method, alpha, *words):
    """Displacement NRMSE of a test, infinite if it tripped."""
    recording = simulated(
        load(
            "ground_motion:synthetic.duration:=16.0",
            "ground_motion:peak_force:=300.0",
            f"reference_force:mass_ratio:={alpha}",
            f"reference_force:compensation.method:={method}",
            *words,
        )
    )
    return error_of(recording) if recording.trip is None else np.inf


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
