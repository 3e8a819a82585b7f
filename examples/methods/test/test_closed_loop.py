"""Compensated tests as a whole, against the exact response of the whole structure."""

import numpy as np
import pytest
from experiments_at_hand import load
from seft_plant_sim.lti import bilinear
from seft_ros.analysis.summary import summarise
from seft_ros.design.plant import choose_plant
from seft_ros.test_run.compiled_loop import build_blocks
from seft_ros.test_run.offline import simulate_test

DELAYED = (
    "rig:actuator.kind:=delay",
    "rig:actuator.delay:=0.01",
    "reference_force:compensation.delay:=0.013",  # and a step of latency, and half a step held
)
ESTIMATED = "reference_force:compensation.settings:=estimate_delay=true"


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


def phase_delays(frequencies_hz):
    """Delays of the servo-hydraulic force loop from its linear model, s."""
    experiment = load()
    dt, control = experiment.timebase.dt, experiment["force_controller"]
    b, a = bilinear(control["numerator"], control["denominator"], dt)
    z = np.exp(2j * np.pi * frequencies_hz * dt)
    loop = choose_plant(experiment).sampled_response(frequencies_hz, dt)
    loop = loop * np.polyval(b, z) / np.polyval(a, z)
    return -np.unwrap(np.angle(loop / (1 + loop))) / (2 * np.pi * frequencies_hz)


@pytest.mark.parametrize("start", [0.007, 0.0208])
def test_a_delay_that_is_half_wrong_is_found_while_the_test_runs(start):
    """jhu.yaml with noise: strong motion begins after 0.5 s, quiet ends it."""
    words = (f"reference_force:compensation.delay:={start}",)
    blocks, summary = run("smith", 1.0, *words, ESTIMATED)
    truth = phase_delays(np.linspace(1.0, 9.0, 33))
    assert summary["stable"]
    assert truth.min() < blocks.reference_force.estimates()["delay"][0] < truth.max()
    assert summary["displacement"]["nrmse"] < min(0.25, error("smith", 1.0, *words) / 2)
