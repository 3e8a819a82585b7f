import json

import numpy as np
import pytest
from bags_at_hand import write_stock_bag
from seft_msgs_py.errors import InputError
from seft_msgs_py.wire import topics
from seft_msgs_py.wire.experiment_state import ExperimentState, encode_state
from seft_msgs_py.wire.messages import EstimatesCodec, Status, encode_diagnostics, encode_string
from seft_msgs_py.wire.outcome import Outcome, State, Trip, rig_status
from seft_msgs_py.wire.trajectory import TrajectoryCodec
from seft_ros.bags.bag_writer import BagWriter
from seft_ros.bags.recording_bag import read_bag

AXES = ("x", "y")
TIMEBASE = topics.Timebase.from_rate(500.0)
CODECS = {topic.name: TrajectoryCodec(topic, AXES, TIMEBASE) for topic in topics.LOOP_TOPICS}
NODE = {"rate": 500.0, "axes": list(AXES)}
NODES = {"rig": {**NODE, "seed": 3}, "recorder": {**NODE, "directory": "bags"}}
ENVIRONMENT = {"start": "2026-01-01T10:00:00+01:00", "mode": "lockstep"}
START = 1_767_258_000_000_000_000


def states(step):
    """Sample (6, 2) that tells its step and its place."""
    return step + np.arange(12.0).reshape(6, 2) / 12


def description(nodes=NODES, environment=ENVIRONMENT):
    parts = [{"node": node, "parameters": p, "fact": 1} for node, p in nodes.items()]
    parts.append({"environment": environment})
    return [(topics.DESCRIPTION, encode_string(json.dumps(part))) for part in parts]


def motion(first_step, count):
    steps = np.arange(first_step, first_step + count, dtype=float)
    return topics.GROUND_MOTION, CODECS["ground_motion"].encode_points(
        first_step, np.stack([steps, -steps], axis=1)
    )


def loop(steps):
    for step in steps:
        yield topics.RIG_STATE, CODECS["rig/state"].encode(step, states(step))
        yield topics.MEASURED, CODECS["rig/measured"].encode(step, states(step)[:4])
        yield (
            topics.REFERENCE_FORCE,
            CODECS["reference_force"].encode(step, np.full(2, float(step))),
        )
        yield topics.VALVE_COMMAND, CODECS["valve_command"].encode(step, np.full(2, -float(step)))


def ending(phase="finished", trip=None, steps=10):
    status = rig_status(Outcome(phase, steps, 2, [4, 6], 1.25, trip))
    return topics.DIAGNOSTICS, encode_diagnostics(0, [status])


TEST = [*description(), motion(0, 8), motion(8, 8), *loop(range(10)), ending()]


def write(path, messages):
    with BagWriter(path) as bag:
        for k, (topic, raw) in enumerate(messages):
            bag.write(topic, raw, START + k)
    return path


def test_each_sample_has_the_time_its_message_was_received(tmp_path):
    late = [(topics.RIG_STATE, CODECS["rig/state"].encode(3, states(99)))]
    messages = [*description(), motion(0, 10), *loop([0, 3, 1]), *late, *loop([2])]
    series = read_bag(write(tmp_path / "bag", messages)).series
    at = [START + k for k, (topic, _) in enumerate(messages) if topic is topics.RIG_STATE]
    assert series["rig/state"].received_ns.tolist() == [at[0], at[2], at[4], at[1]]
    assert series["ground_motion"].received_ns is None


def status(name, level, message, **values):
    return topics.DIAGNOSTICS, encode_diagnostics(0, [Status(name, level, message, values=values)])


def test_what_nodes_tell_is_an_event_once_until_they_tell_another(tmp_path):
    state = [
        (topics.EXPERIMENT_STATE, encode_state(ExperimentState(State.RUNNING, detail)))
        for detail in ("running", "running", "ramping")
    ]
    messages = [
        *description(),
        motion(0, 8),
        state[0],
        *loop([0]),
        status("rig", 0, "running"),
        status("rig", 0, "running"),
        state[1],
        status("recorder", 1, "disk nearly full"),
        state[2],
        status("rig", 0, "running", late="1"),
        status("rig", 2, "tripped"),
    ]
    recording = read_bag(write(tmp_path / "bag", messages))
    assert [(e.source, e.level, e.text) for e in recording.events] == [
        ("experiment", "ok", "running"),
        ("rig", "ok", "running"),
        ("recorder", "warn", "disk nearly full"),
        ("experiment", "ok", "running: ramping"),
        ("rig", "error", "tripped"),
    ]
    times = [e.time_s for e in recording.events]
    assert times == sorted(times)
    assert times[0] < 0 < times[1]  # the rig's first sample is time zero


def test_estimates_that_do_not_fit_the_test_are_left_out_and_counted(tmp_path):
    codec, foreign = EstimatesCodec(AXES, TIMEBASE), EstimatesCodec(("z",), TIMEBASE)
    delay = {"delay": np.array([0.01, 0.02])}
    messages = [
        codec.encode(50, delay),
        codec.encode(0, delay),
        codec.encode(100, {"stiffness": np.ones(2)}),
        foreign.encode(150, {"delay": np.zeros(1)}),
        b"\x00\x01\x00\x00garbage",
    ]
    estimates = [(topics.ESTIMATES, raw) for raw in messages]
    recording = read_bag(write(tmp_path / "bag", [*TEST, *estimates]))
    assert recording.estimates.names == ("delay",)
    assert recording.estimates.steps.tolist() == [0, 50]
    assert recording.estimates.values.tolist() == [[[0.01, 0.02]]] * 2
    assert recording.environment["undecodable"] == 3


def test_the_rigs_last_word_counts(tmp_path):
    trip = Trip("limit", 9, 0.018)
    recording = read_bag(write(tmp_path / "bag", [*TEST, ending("tripped", trip)]))
    assert recording.trip == trip


def test_messages_that_cannot_be_understood_are_left_out_and_counted(tmp_path):
    other = TrajectoryCodec(topics.RIG_STATE, ("a", "b"), TIMEBASE)
    bad = [
        (topics.RIG_STATE, b"\x00\x01\x00\x00garbage"),
        (topics.RIG_STATE, other.encode(20, states(20))),
        (topics.DESCRIPTION, encode_string("no json")),
        (topics.DESCRIPTION, b""),
        (topics.DIAGNOSTICS, b"\x00\x01"),
        (topics.VALVE_COMMAND, CODECS["valve_command"].encode(0, np.zeros(2))[:-5]),
    ]
    recording = read_bag(write(tmp_path / "bag", [*bad, *TEST]))
    assert recording.environment["undecodable"] == 6
    assert recording.series["rig/state"].steps.tolist() == list(range(10))
    assert recording.missed == 2


@pytest.mark.parametrize("bad", [[], [(topics.DESCRIPTION, encode_string("{}"))], description({})])
def test_a_bag_without_description_is_an_input_error(tmp_path, bad):
    path = write(tmp_path / "bag", [*bad, *loop(range(3))])
    with pytest.raises(InputError, match=f"{path}: the bag holds no test.*experiment/description"):
        read_bag(path)


def test_nodes_that_contradict_one_another_are_an_input_error(tmp_path):
    nodes = {**NODES, "recorder": {**NODE, "rate": 1000.0}}
    path = write(tmp_path / "bag", description(nodes))
    with pytest.raises(InputError, match=r"bag: .*recorder: rate is 1000"):
        read_bag(path)


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_a_bag_without_metadata_says_how_to_get_it_back(tmp_path, storage):
    path = ros2_bag_record(tmp_path / "bag", TEST, storage=storage)
    (path / "metadata.yaml").unlink()
    with pytest.raises(InputError, match=rf"metadata.yaml is missing.*seft recover {path}$"):
        read_bag(path)
    recording = read_bag(path, damaged=True)
    assert recording.damage == ["metadata.yaml is missing"]
    assert recording.series["rig/state"].steps.tolist() == list(range(10))


def ros2_bag_record(path, messages, prefix="", storage="mcap"):
    """A bag as `ros2 bag record -a` makes it: all topics, of whatever type."""
    messages = [
        ("/rosout", topics.STRING, encode_string("log")),
        ("/clock", topics.CLOCK, b"\x00\x01\x00\x00" + bytes(8)),
        (prefix + "/rig/state", topics.STRING, encode_string("a foreign topic of that name")),
        *((f"{prefix}/{topic.name}", topic.type, raw) for topic, raw in messages),
    ]
    stamped = [(name, kind, START + k, raw) for k, (name, kind, raw) in enumerate(messages)]
    return write_stock_bag(path, stamped, storage)


@pytest.mark.parametrize("prefix", ["", "/lab/rig2"])
def test_a_bag_of_another_recorder_is_read_also_in_a_namespace(tmp_path, prefix):
    """Of all storages and compressions, see test_bags_message_blocks.py."""
    recording = read_bag(ros2_bag_record(tmp_path / "bag", TEST, prefix, storage="sqlite3"))
    assert recording.series["rig/state"].steps.tolist() == list(range(10))
    assert recording.environment["undecodable"] == 0


def test_tests_in_two_namespaces_are_an_input_error(tmp_path):
    raw = description()[0][1]
    names = ("/a/experiment/description", "/b/experiment/description")
    messages = [(name, topics.STRING, START, raw) for name in names]
    write_stock_bag(tmp_path / "bag", messages)
    with pytest.raises(InputError, match="several tests, in /a/, /b/"):
        read_bag(tmp_path / "bag")
