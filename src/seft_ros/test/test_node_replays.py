"""A recorded test fed to the blocks once more, and what of a bag can't be."""

from dataclasses import replace

import numpy as np
import pytest
from bags_at_hand import write_stock_bag
from experiments_at_hand import load
from recordings_at_hand import without
from rosbags.rosbag2 import Reader
from seft_msgs_py.wire.experiment_state import ExperimentState, encode_state
from seft_msgs_py.wire.outcome import State
from seft_msgs_py.wire.topics import EXPERIMENT_STATE, REFERENCE_FORCE, RIG_STATE, VALVE_COMMAND
from seft_ros.bags.bag_writer import BagWriter
from seft_ros.bags.recording import Recording, Series
from seft_ros.bags.recording_bag import write_recording
from seft_ros.replay.node_replays import Recorded, RigReplay, read_recorded
from seft_ros.test_run.blocks import build_blocks
from seft_ros.test_run.compiled_loop import LoopSamples
from seft_ros.test_run.offline import loop_series, simulate_test

EXPERIMENT = load(
    *("ground_motion:synthetic.duration:=1.0", "ground_motion:tail:=0.1"),
    "/**:actuator.kind:=servo_hydraulic_linear",
)


@pytest.fixture
def blocks():
    return build_blocks(EXPERIMENT)


@pytest.fixture
def recording(blocks):
    return simulate_test(EXPERIMENT, blocks)


@pytest.fixture
def bag_of(tmp_path, blocks):
    """Write a recording as a bag; gives its path."""

    def bag_of(recording, name="bag"):
        write_recording(recording, tmp_path / name, ground_motion=blocks.ground_motion.chunks)
        return tmp_path / name

    return bag_of


def held_test(blocks, held):
    """A test in which the command of step ``held[k]`` was applied after step k."""
    rig = blocks.rig
    steps = blocks.ground_motion.steps
    commands = np.random.default_rng(5).normal(scale=0.05, size=(steps, 1))
    states, measured = [rig.reset()], [rig.measured]
    for step in range(steps - 1):
        at = held.get(step, step)
        states.append(rig.step(commands[at] if at >= 0 else np.zeros(1)))
        measured.append(rig.measured)
    motion = blocks.ground_motion.samples
    forces, unused = np.zeros_like(commands)[:, None], np.empty(0)
    samples = np.array(states), np.array(measured)
    course = LoopSamples(*samples, forces, commands, unused, unused, unused)
    series = loop_series(motion, course, steps)
    return Recording(EXPERIMENT, series, missed=len(held), missed_steps=sorted(held))


def test_a_changed_parameter_is_reported_by_step_field_and_values(seft_json, recording, bag_of):
    words = ("--node", "force_controller", "-p", "force_controller:numerator:=[38.0]")
    result = seft_json("replay", bag_of(recording), *words, status=1)
    first = result["first_difference"]
    commands = recording.series[VALVE_COMMAND.name].values[:, 0, 0]
    assert (first["topic"], first["field"], first["axis"]) == ("valve_command", "effort", "x")
    assert first["a"] == commands[first["step"]]
    assert first["b"] == pytest.approx(first["a"] * 38 / 37)
    assert result["topics"]["valve_command"]["nrmse"] == pytest.approx(1 / 37, rel=1e-6)


@pytest.mark.parametrize(
    "held",
    [
        {},
        {20: 19, 40: 39},
        {0: -1, 1: -1, 2: 0},
        {30: 29, 31: 29, 32: 29},
        {30: 29, 31: 30, 32: 31, 60: 59, 61: 59, 62: 61},
    ],
)
def test_commands_that_a_rig_says_it_applied_are_replayed(blocks, held):
    recording = held_test(blocks, held)
    replay = RigReplay(Recorded(recording, [], {}))
    states, _ = replay.computed(EXPERIMENT["rig"])
    assert replay.notes == []
    np.testing.assert_array_equal(states.values, recording.series[RIG_STATE.name].values)


@pytest.mark.parametrize(
    ("node", "topic", "expected"),
    [
        ("reference_force", RIG_STATE, "lacks rig/state of step 40, which reference_force has"),
        ("force_controller", RIG_STATE, "lacks rig/state of step 40, which force_controller has"),
        ("force_controller", REFERENCE_FORCE, "lacks reference_force of step 40"),
    ],
)
def test_what_was_reported_and_is_not_there_is_named(
    refused, recording, bag_of, node, topic, expected
):
    bag = bag_of(without(recording, topic.name, [40]))
    assert expected in refused("replay", bag, "--node", node)


@pytest.mark.parametrize(
    ("node", "topic", "steps", "note"),
    [
        ("rig", RIG_STATE, 40, "replayed until step 39: rig/state of the next is not in the bag"),
        ("reference_force", REFERENCE_FORCE, None, "the bag lacks the recorded answer: step 40"),
    ],
)
def test_a_rig_is_replayed_until_a_sample_is_lost_and_an_answer_that_was_lost_is_given(
    seft_json, recording, blocks, bag_of, node, topic, steps, note
):
    bag = bag_of(without(recording, topic.name, [40]))
    result = seft_json("replay", bag, "--node", node)
    assert result["notes"] == [note]
    assert result["steps"] == (steps or blocks.ground_motion.steps - 1)


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["--node", "recorder"], "--node recorder: must be one of reference_force"),
        (["--node", "rig", "-p", "rate:=100.0"], "the recorded samples have their own rate"),
        (["--node", "rig", "-p", "supervisor:peers:=[rig]"], "the replay is to rig alone"),
    ],
)
def test_wrong_words_are_refused_in_one_line(refused, recording, bag_of, words, expected):
    assert expected in refused("replay", bag_of(recording), *words)


def test_a_bag_that_begins_late_or_has_two_tests_is_refused(seft, recording, bag_of, tmp_path):
    states = recording.series[RIG_STATE.name]
    late = Series(states.steps[5:], states.values[5:])
    middle = replace(recording, series={**recording.series, RIG_STATE.name: late})
    status, _, errors = seft("replay", bag_of(middle, "middle"))
    assert (status, "the bag begins at step 5" in errors) == (2, True)
    with Reader(bag_of(recording, "one")) as reader, BagWriter(tmp_path / "two") as writer:
        for state in ("running", "done", "idle", "running"):
            raw = encode_state(ExperimentState(State(state)))
            writer.write(EXPERIMENT_STATE, raw, reader.start_time)
    stock_recording(tmp_path / "one", tmp_path / "two", tmp_path / "both")
    status, _, errors = seft("replay", tmp_path / "both")
    assert (status, "holds 2 tests; record one in a bag" in errors) == (2, True)


def stock_recording(*bags):
    """Write what bags hold into the last, a sqlite3 bag without our metadata."""
    messages = []
    for bag in bags[:-1]:
        with Reader(bag) as reader:
            messages += [(c.topic, c.msgtype, at, raw) for c, at, raw in reader.messages()]
    write_stock_bag(bags[-1], sorted(messages, key=lambda message: message[2]), "sqlite3")


def test_motion_beyond_the_end_of_the_test_is_read_for_previews(recording, blocks, bag_of):
    recorded = read_recorded(bag_of(recording))
    last = max(first + len(values) for first, values in recorded.chunks)
    assert last > blocks.ground_motion.steps
