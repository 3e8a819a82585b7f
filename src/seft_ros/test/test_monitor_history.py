"""A long test in bounded memory, without losing a peak."""

import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from seft_msgs_py.wire.messages import Status
from seft_msgs_py.wire.topics import rigs_of
from seft_ros.monitor.history import (
    ENVELOPE,
    SAMPLES,
    Envelope,
    History,
    RigBatches,
    Stretch,
    envelope_frame,
    samples_frame,
)
from seft_ros.monitor.session import Session

ONE = slice(0, 1)


def column(values):
    return np.asarray(values, np.float32)[:, np.newaxis]


@given(st.integers(0, 10**9), st.lists(st.integers(1, 60), min_size=1, max_size=20))
def test_an_envelope_holds_the_extremes_of_all_samples_in_its_buckets(first, lengths):
    signal = np.random.default_rng(sum(lengths)).normal(size=sum(lengths)).astype(np.float32)
    envelope = Envelope(1, buckets=8)
    at = 0
    for length in lengths:
        envelope.add(first + at, column(signal[at : at + length]))
        at += length
    assert envelope.count <= 8
    assert envelope.origin == first
    for bucket in range(envelope.count):
        part = signal[bucket * envelope.size : (bucket + 1) * envelope.size]
        assert envelope.low[bucket, 0] == part.min()
        assert envelope.high[bucket, 0] == part.max()


def test_an_envelope_bridges_what_is_missing():
    envelope = Envelope(1)
    envelope.add(0, column([np.nan, 1.0, np.nan]))
    envelope.add(10, column([2.0]))
    assert envelope.count == 11
    assert np.isnan(envelope.low[5, 0])
    assert np.nanmax(envelope.high) == 2.0


def test_signals_of_a_step_are_written_in_any_order_until_it_is_released():
    history = History(2, length=16)
    history.begin(0)
    steps = np.arange(4)
    history.write(steps, slice(1, 2), column([0, 1, 2, 3]))
    history.write(steps, ONE, column([10, 11, 12, 13]))
    first = history.release(3)
    assert first is not None
    assert first.values.tolist() == [[10, 0], [11, 1], [12, 2]]
    history.write(np.array([2, 3]), ONE, column([99, 99]))
    second = history.release(4)
    assert second is not None
    assert second.first == 3
    assert second.values.tolist() == [[99, 3]]
    assert history.release(4) is None


def test_what_is_recent_is_kept_and_what_was_not_written_is_no_number():
    history = History(1, length=16)
    history.begin(100)
    history.write(np.array([100, 103]), ONE, column([1, 4]))
    history.release(200)
    recent = history.recent()
    assert recent.first == 100
    np.testing.assert_array_equal(recent.values[:, 0], [1, np.nan, np.nan, 4])
    for step in range(104, 150):
        history.write(np.array([step]), ONE, column([step]))
        history.release(step + 1)
    assert history.recent().first == 134
    assert history.recent().values[:, 0].tolist() == list(range(134, 150))
    assert np.nanmax(history.envelope.high) == 149


def test_a_step_far_away_is_left_out():
    history = History(1, length=16)
    history.begin(0)
    history.write(np.array([0, 10**15]), ONE, column([1, 2]))
    assert history.head == 1


@pytest.mark.parametrize("columns", [1, 3])
def test_frames_hold_signal_after_signal(columns):
    values = np.arange(5 * columns, dtype=np.float32).reshape(5, columns)
    frame = samples_frame(7, Stretch(40, values))
    assert struct.unpack("<4I2d", frame[:32]) == (SAMPLES, 7, columns, 5, 40.0, 1.0)
    assert np.frombuffer(frame, "<f4", offset=32).reshape(columns, 5).T.tolist() == values.tolist()
    envelope = Envelope(columns)
    envelope.add(40, values)
    frame = envelope_frame(7, envelope)
    assert struct.unpack("<4I2d", frame[:32]) == (ENVELOPE, 7, columns, 5, 40.0, 1.0)
    assert len(frame) == 32 + 2 * 4 * values.size


RIGS = rigs_of(["west/x", "east/x", "west/y"])


def batch(rig, steps):
    steps = np.array(steps, np.int64)
    values = np.broadcast_to((10.0 * (rig + 1) + steps)[:, None, None], (len(steps), 4, 2 - rig))
    return steps, values.copy(), 1000 * steps + rig


def test_steps_are_given_once_all_have_sent_them():
    batches = RigBatches(RIGS)
    batches.take(0, batch(0, range(5)))
    assert len(batches.complete()[0]) == 0
    batches.take(1, batch(1, [1, 2]))
    steps, values, sent = batches.complete()
    assert steps.tolist() == [1, 2]
    np.testing.assert_array_equal(values[0, 0], [11.0, 21.0, 11.0])
    assert sent.tolist() == [1001, 2001]
    assert len(batches.complete()[0]) == 0
    batches.take(1, batch(1, [3, 5]))
    batches.take(0, batch(0, [5]))
    assert batches.complete()[0].tolist() == [3, 5]


def test_a_new_test_forgets_what_waits_of_the_old():
    batches = RigBatches(RIGS)
    batches.take(0, batch(0, [7, 8]))
    batches.take(0, batch(0, [9, 0, 1]))
    batches.take(1, batch(1, [7, 8, 9]))
    assert len(batches.complete()[0]) == 0
    batches.take(1, batch(1, [0, 1, 2]))
    assert batches.complete()[0].tolist() == [0, 1]


def test_what_rigs_tell_is_shown_together():
    session = Session()
    for rig, missed, margin in (("west", 3, 0.5), ("east", 4, 0.25)):
        values = {"phase": "running", "steps": "100", "missed": str(missed)}
        values |= {"margin force": str(margin), "round trip median (ms)": str(margin)}
        session.on_diagnostics([Status(f"{rig}/rig", 0, "running", values=values)], 0.002)
    summary = session.summary()
    assert summary["missed"] == 7
    assert summary["margins"] == {"force": 0.25}
    assert summary["round_trip"] == {"median (ms)": 0.5}
    assert [node["name"] for node in summary["nodes"]] == ["east/rig", "west/rig"]
