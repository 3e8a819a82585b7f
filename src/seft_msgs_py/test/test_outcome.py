"""What was at the end of its range: counted, and reported as text."""

import dataclasses
import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st
from seft_msgs_py.errors import WireError
from seft_msgs_py.wire.messages import ERROR, OK, WARN, Status, decode_status, encode_status
from seft_msgs_py.wire.outcome import (
    LISTED_STEPS,
    Outcome,
    Simulated,
    Trip,
    count_saturated,
    read_outcome,
    rig_status,
)
from seft_msgs_py.wire.topics import Timebase

TIMEBASE = Timebase.from_rate(500.0)
COUNT = st.integers(0, 10**9)
TEXT = st.text(st.characters(codec="utf-8", exclude_characters="\x00"))


@given(
    steps=COUNT,
    missed_steps=st.lists(COUNT, max_size=LISTED_STEPS),
    wall_s=st.none() | st.floats(0, 1e9),
    trip=st.none() | st.builds(Trip, TEXT, COUNT, st.just(0.0)),
    saturated=st.lists(TEXT, max_size=5),
)
def test_what_the_rig_tells_of_the_end_is_read_back(steps, missed_steps, wall_s, trip, saturated):
    phase = "tripped" if trip else "finished"
    missed = len(missed_steps)
    counts = {name: {"samples": 2, "first_step": 7} for name in saturated}
    sent = Outcome(phase, steps, missed, missed_steps, wall_s, trip, 0, counts)
    expected = trip and Trip(trip.reason, trip.step, trip.step * 2_000_000 / 1e9)
    outcome = read_outcome(decode_status(encode_status(rig_status(sent))), TIMEBASE)
    assert outcome == dataclasses.replace(sent, trip=expected)


def test_all_missed_steps_are_counted_and_the_first_are_listed():
    outcome = read_outcome(rig_status(Outcome("finished", 9000, 5000, range(5000), 1.0)), TIMEBASE)
    assert outcome.missed == 5000
    assert outcome.missed_steps == list(range(LISTED_STEPS))


def test_the_level_is_ok_warn_when_steps_were_missed_and_error_when_tripped():
    trip = Trip("force 900 N on axis x is beyond the limit of 800 N", 7, 0.014)
    assert rig_status(Outcome("finished", 9, 0, [], 1.0)).level == OK
    assert rig_status(Outcome("running", 9, 1, [3], 1.0)).level == WARN
    assert rig_status(Outcome("tripped", 9, 1, [3], 1.0, trip)).level == ERROR


@pytest.mark.parametrize(
    "status",
    [
        rig_status(Outcome("running", 5, 0, [], 0.1)),
        rig_status(Outcome("idle", 0, 0, [], None)),
        Status("supervisor", OK, "", values={"phase": "finished"}),
        Status("rig", OK, "no phase"),
    ],
)
def test_a_status_before_the_end_or_of_another_node_is_no_outcome(status):
    assert read_outcome(status, TIMEBASE) is None


@pytest.mark.parametrize("key", ["steps", "missed", "missed_steps", "reason", "step"])
def test_a_missing_value_is_named(key):
    status = rig_status(Outcome("tripped", 9, 0, [], 1.0, Trip("limit", 7, 0.014)))
    del status.values[key]
    with pytest.raises(WireError, match=f"{key} is missing"):
        read_outcome(status, TIMEBASE)


NUMBERS = ("steps", "missed", "missed_steps", "step")


@pytest.mark.parametrize(
    ("key", "text"),
    [
        *itertools.product(NUMBERS, ("many", "nan", "9" * 5000, "{}")),
        *itertools.product(("saturated", "simulated"), ("", "no json", "[]", "3")),
        ("saturated", '{"valve": 3}'),
        ("saturated", '{"valve": {"samples": 3}}'),
        ("saturated", '{"valve": {"samples": "many", "first_step": 0}}'),
        ("simulated", "{}"),
        ("simulated", '{"displacement_peak": 1, "force_peak": "no"}'),
    ],
)
def test_a_value_of_another_kind_is_refused(key, text):
    status = rig_status(Outcome("tripped", 9, 0, [], 1.0, Trip("limit", 7, 0.014)))
    status.values[key] = text
    with pytest.raises(WireError, match="status of the tripped rig"):
        read_outcome(status, TIMEBASE)


def test_round_trips_are_read_back_and_of_several_rigs_the_longest_are_reported():
    trips = {"p50": 2e-4, "p99.9": 1.5e-3, "largest": 2e-3}
    status = rig_status(Outcome("finished", 9, 0, [], 1.0, round_trips=trips))
    outcome = read_outcome(decode_status(encode_status(status)), TIMEBASE)
    assert outcome.round_trips == pytest.approx(trips)
    other = dataclasses.replace(outcome, round_trips={"p50": 3e-4, "largest": 1e-3})
    both = Outcome.of_all([outcome, other])
    assert both.round_trips == pytest.approx({"p50": 3e-4, "p99.9": 1.5e-3, "largest": 2e-3})
    status.values["round trip largest (ms)"] = "inf"
    with pytest.raises(WireError, match="inf is not finite"):
        read_outcome(status, TIMEBASE)


def test_a_trip_belongs_to_the_phase_tripped_and_to_no_other():
    with pytest.raises(ValueError, match="tripped"):
        rig_status(Outcome("tripped", 1, 0, [], 1.0, None))
    with pytest.raises(ValueError, match="finished"):
        rig_status(Outcome("finished", 1, 0, [], 1.0, Trip("limit", 0, 0.0)))


NAMES = st.sampled_from(["valve", "stroke", "force_capacity", "force_range", "acceleration_range"])


@given(st.lists(st.lists(NAMES), max_size=30))
def test_each_name_has_the_number_of_its_samples_and_the_first(steps):
    saturation = {}
    for step, names in enumerate(steps):
        for name in set(names):
            count_saturated(saturation, name, 1, step)
    seen = {name for names in steps for name in names}
    assert set(saturation) == seen
    for name in seen:
        at = [step for step, names in enumerate(steps) if name in names]
        assert saturation[name] == {"samples": len(at), "first_step": at[0]}


def test_the_largest_true_motion_of_a_simulated_rig_is_reported_bit_for_bit():
    peaks = Simulated(0.1 + 0.2, 1234.5, 1e-300)
    real, simulated = (Outcome("finished", 9, 0, [], 1.0, simulated=one) for one in (None, peaks))
    for one in (real, simulated):
        assert read_outcome(decode_status(encode_status(rig_status(one))), TIMEBASE) == one
    assert "simulated" not in rig_status(real).values
    other = dataclasses.replace(simulated, simulated=Simulated(0.1, 2000.0, 5.0))
    largest = Simulated(peaks.displacement_peak, 2000.0, 5.0)
    assert Outcome.of_all([simulated, other]).simulated == largest
    assert Outcome.of_all([simulated, real]).simulated is None
