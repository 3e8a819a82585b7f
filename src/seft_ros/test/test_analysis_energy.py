"""Energy balance in the summary of a test."""

import dataclasses

import numpy as np
import pytest
from experiments_at_hand import load, simulated
from recordings_at_hand import as_measured
from seft_msgs_py.config.experiment import Experiment
from seft_ros.analysis.summary import balance_of, energy_numbers, summarise
from seft_ros.bags.recording import Series

SHORT = ("ground_motion:synthetic.duration:=8.0", "ground_motion:tail:=1.0")
YIELDING = (
    "rig:simulated.specimen.kind:=bilinear",
    "rig:simulated.specimen.yield_displacement:=0.002",
)
KEYS = ["input_j", "kinetic_j", "strain_j", "damped_j", "hysteretic_j", "closure"]


def energy_of(recording):
    return energy_numbers(balance_of(recording))


def run(*words):
    return simulated(load(*SHORT, *words))


@pytest.mark.parametrize(
    ("words", "most"),
    [
        ((), 0.01),
        (YIELDING, 0.01),
        (("actuator.kind:=delay", "actuator.delay:=0.0033", *YIELDING), 0.01),
        (("sensors.velocity:=derived",), 0.02),
    ],
)
def test_the_energy_of_a_simulated_test_closes_with_the_noise_of_its_sensors(words, most):
    recording = run(*words)
    energy = energy_of(recording)
    assert list(energy) == KEYS
    assert energy["closure"] < most
    held = sum(energy[f"{name}_j"] for name in ("kinetic", "strain", "damped", "hysteretic"))
    assert energy["input_j"] == pytest.approx(held, rel=most)
    assert (energy["hysteretic_j"] > 0.1 * energy["input_j"]) == (YIELDING[0] in words)


def test_a_recording_without_all_of_its_samples_has_no_energy():
    recording = run()
    states = recording.series["rig/state"]
    for kept in (np.arange(len(states.steps)) != 40, slice(1), slice(0)):
        part = Series(states.steps[kept], states.values[kept])
        lost = dataclasses.replace(recording, series=as_measured(recording, part))
        assert energy_of(lost) is None
    values = states.values.copy()
    values[7, 2, 0] = np.nan
    broken = as_measured(recording, Series(states.steps, values))
    assert energy_of(dataclasses.replace(recording, series=broken)) is None


def test_a_recording_of_a_specimen_that_is_not_known_has_no_energy():
    recording = run()
    sections = {"supervisor": recording.experiment["supervisor"]}
    unknown = dataclasses.replace(recording, experiment=Experiment(sections))
    assert energy_of(unknown) is None
    assert summarise(unknown)["energy"] is None
    del recording.experiment.sections["rig"]
    assert energy_of(recording)["closure"] < 0.01  # the model is the specimen
