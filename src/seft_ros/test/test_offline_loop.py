"""The offline loop: where it ends, and that its stability is that of the paper's equation."""

import numpy as np
import pytest
from experiments_at_hand import load, simulated
from seft_msgs_py.config.facts import CHANNELS
from seft_msgs_py.errors import InputError
from seft_plant_sim.compiled import kind_of
from seft_plant_sim.simulated.sensors import BLOCK
from seft_ros.test_run.blocks import build_blocks
from seft_ros.test_run.offline import simulate_test

PERFECT = (
    "/**:sensors.adc_bits:=0",
    *(f"/**:sensors.{name}_{row}:=0" for name in CHANNELS for row in ("noise", "range")),
)
"""Sensors that measure the truth."""
QUIET = (*PERFECT, "/**:specimen.damping:=903.5")
DELAY = ("/**:actuator.kind:=delay", "/**:actuator.delay:=0.01")


UNWATCHED = "reference_force:instability.ratio:=0.0"
"""Lets a loop go unstable as by its equations."""


def run(*words):
    """Record of an experiment, and its samples of rig/state, shape (N, 4, n)."""
    recording = simulated(load(UNWATCHED, *words))
    return recording, recording.series["rig/state"].values[:, :4]


def with_ratio(alpha):
    return f"reference_force:mass_ratio:={alpha}"


def test_a_delay_of_10_ms_is_stable_below_a_mass_ratio_of_one_and_not_at_one():
    """A neutral delay equation: alpha_c = 1 - (2 f_n T)^2 with the loop's own 3 ms in T."""
    critical = 1 - (2 * 10.07 * 0.013) ** 2
    words = (*QUIET, *DELAY, "ground_motion:tail:=20")
    for alpha in (0.9, critical - 0.01):
        recording, states = run(*words, with_ratio(alpha))
        x = np.abs(states[:, 0, 0])
        assert recording.trip is None
        assert x[-1000:].max() < 1e-9 * x.max()
    for alpha in (critical + 0.01, 1.0):
        assert run(*words, with_ratio(alpha))[0].trip is not None


@pytest.mark.parametrize(
    "words",
    [
        (with_ratio(1.6), "/**:limits.acceleration:=30"),
        (with_ratio(0.5), "/**:limits.displacement:=0.003"),
        (with_ratio(0.0), "/**:limits.velocity:=0.1"),
    ],
)
def test_a_test_ends_with_the_sample_that_breaks_a_limit(words):
    recording, states = run(*words)
    limits = np.array([recording.experiment["rig"][f"limits.{name}"] for name in CHANNELS])
    beyond = (np.abs(states[:, :, 0]) > limits).any(axis=1)
    assert np.flatnonzero(beyond).tolist() == [len(states) - 1]
    assert recording.trip.step == len(states) - 1
    assert recording.trip.time_s == pytest.approx(recording.trip.step * 0.002)
    assert recording.trip.reason.split()[0] in words[1]
    for series in recording.series.values():
        np.testing.assert_array_equal(series.steps, np.arange(len(states)))


def test_a_limit_that_is_broken_from_rest_on_ends_the_test_at_once():
    recording, states = run(*PERFECT, "/**:sensors.force_noise:=1000", "/**:limits.force:=0.001")
    assert len(states) == 1
    assert recording.trip.step == 0


def test_the_same_experiment_gives_the_same_bits_and_another_seed_others():
    one, two, other = (run(with_ratio(0.5), f"rig:seed:={seed}")[1] for seed in (1, 1, 2))
    np.testing.assert_array_equal(one, two)
    assert not np.array_equal(one, other)


def test_progress_is_reported_in_steps():
    experiment = load()
    steps = []
    simulate_test(experiment, build_blocks(experiment), steps.append)
    assert steps == [BLOCK, 2 * BLOCK, 8501]


SHORT = ("ground_motion:synthetic.duration:=5.0", "ground_motion:tail:=0.5")


def ended(*words):
    return simulated(load(*SHORT, *words))


def force_of(recording):
    return recording.series["reference_force"].values[:, 0, 0]


def test_a_rig_that_trips_within_the_ramp_ends_it_at_once_and_both_causes_are_reported():
    """The supervisor's limit stands in for both: the rig's force comes after its reference."""
    free = force_of(ended())
    first = int(np.argmax(np.abs(free) > 500.0))
    recording = ended("/**:limits.force:=500.0")
    last = int(recording.series["rig/state"].steps[-1])
    assert first < last < first + 249
    assert recording.trip.step == last
    assert recording.trip.reason.startswith("force ")
    assert "(while ramping down: reference force" in recording.trip.reason


@pytest.mark.parametrize("of", ["rig", "reference_force", "force_controller"])
def test_tests_of_any_number_of_axes_beyond_one_have_the_same_machine_code(of):
    three, six = (build_blocks(load(config=f"{n}_storey_frame")) for n in ("three", "six"))
    assert getattr(three, of).kind == getattr(six, of).kind


def test_the_checks_of_one_axis_have_the_machine_code_of_several():
    one, three = (load(config=name) for name in ("demo", "three_storey_frame"))
    one, three = (build_blocks(each).force_controller for each in (one, three))
    assert kind_of((one.parameters, one.state)) == kind_of((three.parameters, three.state))


def test_a_test_beyond_the_memory_of_the_machine_is_refused_before_it_is_taken(monkeypatch):
    experiment = load()
    blocks = build_blocks(experiment)
    monkeypatch.setattr("os.sysconf", {"SC_PHYS_PAGES": 100, "SC_PAGE_SIZE": 4096}.get)
    with pytest.raises(InputError, match=r"steps of 1 axes need some .* GB, and this machine has"):
        simulate_test(experiment, blocks)
