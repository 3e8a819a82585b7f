import dataclasses

import numpy as np
import pytest
from bags_at_hand import contents
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from recordings_at_hand import assert_same_samples, noise_recording
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.wire.outcome import Simulated, Trip
from seft_msgs_py.wire.topics import GROUND_MOTION, LOOP_TOPICS, Timebase
from seft_msgs_py.wire.trajectory import TrajectoryCodec
from seft_ros.bags.gathering import SeriesGatherer
from seft_ros.bags.message_blocks import MessageBlock
from seft_ros.bags.recording import Estimates, Series
from seft_ros.bags.recording_bag import read_bag, write_recording

AXES = ("x", "y")
NODE = {"rate": 1000.0, "axes": list(AXES)}
EXPERIMENT = Experiment({"rig": {**NODE, "seed": 3, "gain": 0.1}, "recorder": {**NODE}})
START = 1_767_258_000_250_001_000
ENVIRONMENT = {"start": "2026-01-01T10:00:00.250001+01:00", "mode": "simulate"}
ESTIMATES_NAME = "/reference_force/estimates"
FINITE = st.floats(allow_nan=False, allow_infinity=False)


def make_recording(count=250, **changes):
    recording = noise_recording(count, AXES, wall_s=0.123, environment=ENVIRONMENT)
    return dataclasses.replace(recording, experiment=EXPERIMENT, **changes)


def make_estimates(steps=range(0, 250, 100)):
    steps = np.array(steps)
    values = np.random.default_rng(4).normal(size=(len(steps), 2, 2))
    return Estimates(steps, values, ("delay", "stiffness"))


def assert_same(a, b):
    assert_same_samples(b, a)
    assert a.experiment.sections == b.experiment.sections
    names = ("missed", "missed_steps", "simulated")
    for name in ("trip", *names, "wall_s", "complete"):
        assert getattr(a, name) == getattr(b, name)
    assert a.saturation == b.saturation
    assert b.environment == {**a.environment, "undecodable": 0}


@pytest.mark.parametrize(
    "changes",
    [
        {"saturation": {"force_range": {"samples": 3, "first_step": 40}}},
        {"simulated": Simulated(0.1 + 0.2, 1e3 / 3, 7.0)},
        {"complete": False, "missed": None, "wall_s": None},
    ],
)
def test_a_recording_is_read_back_bit_for_bit_also_without_an_end(tmp_path, changes):
    recording = make_recording(**changes)
    write_recording(recording, tmp_path / "bag")
    assert_same(recording, read_bag(tmp_path / "bag"))


def test_estimates_are_read_back_bit_for_bit(tmp_path):
    recording = make_recording(estimates=make_estimates())
    write_recording(recording, tmp_path / "bag")
    assert_same(recording, read_bag(tmp_path / "bag"))
    found = [(t - START, n) for n, t, _ in contents(tmp_path / "bag") if t == START + 100_000_000]
    assert found[-2:] == [(100_000_000, "/valve_command"), (100_000_000, ESTIMATES_NAME)]


@settings(max_examples=10)
@given(
    data=st.data(),
    steps=st.sets(st.integers(0, 40), max_size=12),
    missed=st.integers(0, 50),
    trip=st.none() | st.just(Trip("limit", 3, 0.003)),
)
def test_gaps_any_finite_numbers_and_any_end_are_kept(tmp_path_factory, data, steps, missed, trip):
    ordered = np.array(sorted(steps), dtype=np.int64)
    series = {}
    for topic in LOOP_TOPICS:
        shape = (len(ordered), len(topic.quantities), 2)
        values = data.draw(hnp.arrays(np.float64, shape, elements=FINITE))
        series[topic.name] = Series(ordered, values)
    recording = make_recording(series=series, missed=missed, missed_steps=[0] * missed, trip=trip)
    path = tmp_path_factory.mktemp("bags") / "bag"
    write_recording(recording, path)
    assert_same(recording, read_bag(path))


def test_messages_come_in_the_order_of_time_and_at_the_wall_clock_of_their_step(tmp_path):
    write_recording(make_recording(), tmp_path / "bag")
    messages = contents(tmp_path / "bag")
    times = [time_ns for _, time_ns, _ in messages]
    assert times == sorted(times)
    assert times[0] == START
    assert times[-1] == START + 249_000_000
    descriptions = ["/experiment/description"] * 3
    assert [topic for topic, _, _ in messages[:3]] == descriptions
    assert [topic for topic, _, _ in messages[-4:]] == ["/diagnostics", *descriptions]
    for topic in LOOP_TOPICS[1:4]:
        codec = TrajectoryCodec(topic, AXES, Timebase.from_rate(1000.0))
        sent = [(t, raw) for name, t, raw in messages if name == f"/{topic.name}"]
        steps = [(t, codec.decode(raw)[0]) for t, raw in sent]
        assert steps == [(START + k * 1_000_000, k) for k in range(250)]
    at_seven = [name for name, time_ns, _ in messages if time_ns == START + 7_000_000]
    assert at_seven == [f"/{topic.name}" for topic in LOOP_TOPICS]


def test_ground_motion_is_sent_ahead_in_the_messages_that_were_given(tmp_path):
    values = np.random.default_rng(2).normal(size=(300, 2))
    recording = make_recording(250)
    chunks = [(0, values[:64]), (64, values[64:128]), (128, values[128:256]), (256, values[256:])]
    write_recording(recording, tmp_path / "bag", ground_motion=chunks)
    codec = TrajectoryCodec(LOOP_TOPICS[0], AXES, Timebase.from_rate(1000.0))
    messages = contents(tmp_path / "bag")
    sent = [(t, *codec.decode(raw)) for name, t, raw in messages if name == "/ground_motion"]
    assert [first for _, first, _ in sent] == [0, 64, 128, 256]
    assert [t - START for t, _, _ in sent] == [0, 0, 64_000_000, 128_000_000]
    series = read_bag(tmp_path / "bag").series["ground_motion"]
    assert np.array_equal(series.values[:, 0], values[:250])


def test_samples_that_no_message_can_carry_are_left_out_and_counted(tmp_path):
    recording = make_recording(estimates=make_estimates())
    recording.series["rig/state"].values[200:, 0, 0] = np.inf
    recording.series["valve_command"].values[249] = np.nan
    recording.estimates.values[1, 0, 1] = np.nan
    write_recording(recording, tmp_path / "bag")
    back = read_bag(tmp_path / "bag")
    assert back.environment["not_finite"] == 52
    assert back.estimates.steps.tolist() == [0, 200]
    assert len(back.series["rig/state"].steps) == 200
    assert len(back.series["valve_command"].steps) == 249


@given(st.lists(st.tuples(st.integers(0, 30), st.integers(1, 5)), max_size=20))
def test_the_first_sample_of_each_step_is_kept(messages):
    (rig,) = EXPERIMENT.rigs
    codec = TrajectoryCodec(GROUND_MOTION, AXES, EXPERIMENT.timebase)
    gatherer = SeriesGatherer(GROUND_MOTION, EXPERIMENT, rig, 0)
    expected, raws = {}, []
    for number, (step, count) in enumerate(messages):
        raws.append(codec.encode_points(step, np.full((count, 2), float(number))))
        for k in range(count):
            expected.setdefault(step + k, float(number))
    none = [0] * len(raws)
    assert gatherer.take(MessageBlock.of(none, none, raws)) == 0
    series = gatherer.series()
    assert series.steps.tolist() == sorted(expected)
    assert series.values[:, 0, 0].tolist() == [expected[step] for step in series.steps]


def test_a_series_is_cut_after_a_step():
    series = Series(np.array([0, 2, 5]), np.zeros((3, 1, 1)))
    assert series.until(2).steps.tolist() == [0, 2]
    assert series.until(4).steps.tolist() == [0, 2]
    assert series.until(-1).values.shape == (0, 1, 1)
