"""Memory by sample: what a bag of an hour takes is seen from one of some minutes."""

import dataclasses
import tracemalloc
from collections import Counter

import pytest
from compensators import force_section
from recordings_at_hand import noise_recording
from seft_msgs_py.config.experiment import Experiment
from seft_ros.analysis import calibration_check
from seft_ros.analysis.comparison import compare_recordings
from seft_ros.analysis.summary import reference_of, summarise
from seft_ros.bags.bag_files import Bag
from seft_ros.bags.recording_bag import read_bag, write_recording

STEPS = 40_000
BATCHES = 10e6  # bytes that reading takes whatever the length


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    section = force_section(rate=1000.0, specimen__damping=800.0, mass_ratio=0.5)
    experiment = Experiment({"reference_force": section})
    path = tmp_path_factory.mktemp("bags") / "long"
    recording = noise_recording(STEPS, ["x"])
    write_recording(dataclasses.replace(recording, experiment=experiment), path)
    return path


def peak_per_step(call):
    """Most bytes that a call has at a time, beyond what was there, by step."""
    tracemalloc.start()
    try:
        found = call()
        return found, tracemalloc.get_traced_memory()[1] / STEPS
    finally:
        tracemalloc.stop()


def test_reading_takes_the_memory_of_the_samples(bag):
    read_bag(bag)  # imports
    recording, peak = peak_per_step(lambda: read_bag(bag))
    assert len(recording.series["rig/state"].steps) == STEPS
    samples = 8 * (1 + 4 + 3 * (1 + 1))  # steps, and values of the four topics
    received = 8 * 4
    assert peak < 2 * (samples + received) + BATCHES / STEPS


def test_a_summary_takes_few_arrays_of_the_recordings_length(bag, monkeypatch):
    # estimates are of a part of bounded length, however long the recording is
    monkeypatch.setattr(calibration_check, "MAX_SAMPLES", 500)
    recording = read_bag(bag)
    reference = reference_of(recording)
    summarise(recording, reference)  # imports
    _, peak = peak_per_step(lambda: summarise(recording, reference))
    assert peak < 8 * 50


def test_comparing_copies_no_samples(bag):
    one, other = read_bag(bag), read_bag(bag)
    _, peak = peak_per_step(lambda: compare_recordings(one, other))
    assert peak < 8 * 4


def test_every_message_of_a_test_goes_by_once(bag, monkeypatch):
    seen = Counter()
    blocks = Bag.blocks

    def counted(file, numbers):
        topics = {number: topic for topic, number in numbers.items()}
        for block in blocks(file, numbers):
            seen.update((topics[message[0]], *message[1:]) for message in block.messages())
            yield block

    monkeypatch.setattr(Bag, "blocks", counted)
    read_bag(bag)
    assert len(seen) > 3 * STEPS
    assert set(seen.values()) == {1}
