"""What a rig node watches: its time, its commands, and how a test goes."""

import math
import statistics
import time
from functools import partial
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from seft_msgs_py.errors import WireError
from seft_msgs_py.node.transport import MACHINE
from seft_msgs_py.wire.experiment_state import ExperimentState, encode_state
from seft_msgs_py.wire.messages import OK, Status, encode_diagnostics
from seft_msgs_py.wire.outcome import RECORDED, RECORDER_NODE_NAME, ROUND_TRIPS, STOPPED, State
from seft_msgs_py.wire.topics import VALVE_COMMAND
from seft_plant_sim import rig_watch
from seft_plant_sim.rig_watch import CommandWatch, RecorderLag, RoundTrip, SampleClock, Supervision

PERIOD, TIMEOUT = 0.002, 0.02
ALLOWED = 10  # steps
BOOT_TIME = partial(time.clock_gettime, time.CLOCK_BOOTTIME)


@pytest.fixture
def watch():
    found = CommandWatch(VALVE_COMMAND, PERIOD, TIMEOUT)
    found.begin(100.0)
    return found


def look(watch, step, answered, late=0.0):
    """Look at the end of a step's period, or later."""
    return watch.fault(100.0 + (step + 1) * PERIOD + late, step, answered)


def test_commands_that_settle_coming_steps_may_be_lost_as_long_as_they_are_settled(watch):
    assert not any(look(watch, step, 30) for step in range(31 + ALLOWED))
    assert look(watch, 31 + ALLOWED, 30).startswith("no new valve_command for 0.02 s (the last is")


def test_a_period_beyond_the_timeout_is_what_counts():
    watch = CommandWatch(VALVE_COMMAND, 0.1, 0.02)
    watch.begin(0.0)
    assert not watch.fault(0.1, 0, 0)
    assert not watch.fault(0.2, 1, 0)
    assert watch.fault(0.3, 2, 0)


def test_a_rig_that_has_waited_in_vain_says_so_at_once(watch):
    assert watch.fault(100.0, 0, -1, in_vain=True).startswith("no new valve_command")


def test_time_runs_while_the_machine_sleeps():
    before, now, after = (f() for f in (BOOT_TIME, MACHINE.elapsed, BOOT_TIME))
    assert before <= now <= after


TICK = 2.0**-9  # s; times are exact in multiples of it


@pytest.mark.parametrize(
    ("before", "last", "periods"),
    [
        ([], (0, -1), 1),  # since the test began
        ([(0, -1), (1, 0)], (2, 0), 2),  # since the sample that was answered
        ([(0, 0), (1, 1)], (2, 1), 1),
        ([(0, 0), (1, 1)], (2, 2), 0),  # it is answered, and the rig stood still before it knew
        ([(0, -1), (1, 0), (2, 1)], (3, 2), 1),
        ([(0, -1), (1, 0), (2, 1)], (3, 1), 2),
        ([(0, 20), (1, 20)], (2, 20), 0),  # settled ahead
    ],
)
def test_the_time_without_a_command_is_exact(before, last, periods):
    watch, start, longest = CommandWatch(VALVE_COMMAND, TICK, 8 * TICK), 100.0, 8.5 * TICK
    for late, fault in ((0.0, ""), (2.0**-30, "the rig stood still")):
        watch.begin(start)
        for step, answered in before:
            assert watch.fault(start + (step + 1) * TICK, step, answered) == ""
        now = start + (last[0] + 1 - periods) * TICK + longest + late
        assert watch.fault(now, *last)[:19] == fault


def test_who_failed_is_reported_by_the_steps_without_a_command():
    watch = CommandWatch(VALVE_COMMAND, TICK, 8 * TICK)
    for step, words in ((8, "the rig stood still for"), (9, "no new valve_command for")):
        watch.begin(0.0)
        assert watch.fault(TICK, 0, 0) == ""
        assert watch.fault(1.0, step, 0).startswith(words)


@pytest.mark.parametrize("makes_up", [False, True])
def test_who_was_held_up_goes_on_from_there(makes_up):
    clock = SampleClock(0.002, 10.0, makes_up=makes_up)
    clock.awake(0.0065)
    assert clock.overruns == 1
    assert clock.deadline(1) == pytest.approx(10.0084 if makes_up else 10.0085)
    for _ in range(200):
        clock.awake(0.0)
    assert clock.deadline(1) == pytest.approx(10.002 if makes_up else 10.0085)


def test_half_a_period_is_the_least_overrun():
    clock = SampleClock(TICK, 10.0, makes_up=False)
    clock.awake(TICK / 2)
    assert (clock.overruns, clock.deadline(0)) == (0, 10.0)
    clock.awake(math.nextafter(TICK / 2, 1.0))
    assert (clock.overruns, clock.deadline(0)) == (1, 10.0 + TICK / 2)


def test_all_that_is_to_come_is_put_off():
    clock = SampleClock(0.002, 10.0, makes_up=False)
    clock.fall_back(0.001)
    assert clock.deadline(3) == pytest.approx(10.007)
    assert clock.overruns == 0


@pytest.fixture
def clock(monkeypatch):
    """The time awake, which stands still until it is put forward."""
    found = SimpleNamespace(now=0.0)
    monkeypatch.setattr(rig_watch, "AwakeClock", lambda _: SimpleNamespace(time=lambda: found.now))
    return found


def test_a_rig_waits_for_a_recorder_that_is_far_behind_but_not_for_a_silent_one(clock):
    def hear(*statuses):
        told = [Status(name, OK, "", values=values) for name, values in statuses]
        lag.receive(encode_diagnostics(0, told), 0)

    lag = RecorderLag(1.5, MACHINE)
    assert not lag.is_large(10_000)  # it has never been heard
    hear(("rig", {RECORDED: "9000"}), (RECORDER_NODE_NAME, {RECORDED: "100"}), ("rig", {}))
    assert [lag.is_large(step) for step in (99, 3171, 3172)] == [False, False, True]
    clock.now = 1.25
    assert lag.is_large(3172)
    hear(("rig", {}))
    clock.now = 1.5
    assert not lag.is_large(3172)
    hear((RECORDER_NODE_NAME, {RECORDED: "101"}))
    assert [lag.is_large(step) for step in (3172, 3173)] == [False, True]
    lag.reset()
    assert [lag.is_large(step) for step in (3071, 3072)] == [False, True]
    hear((RECORDER_NODE_NAME, {RECORDED: "500"}), (RECORDER_NODE_NAME, {}))  # nothing is begun
    assert [lag.is_large(step) for step in (3071, 3072)] == [False, True]


@pytest.fixture
def listener(clock):
    """What a rig makes of the supervisor's states."""

    def tell(*states, **values):
        for state in states:
            found.receive(encode_state(ExperimentState(State(state), **values)), 0)
        return found.is_moving

    found = Supervision(2.0, MACHINE)
    return SimpleNamespace(supervision=found, tell=tell, clock=clock)


@pytest.mark.parametrize("state", ["running", "ramping_down"])
def test_a_rig_moves_in_no_test_for_which_it_was_not_ready(listener, state):
    supervision = listener.supervision
    nothing = (None, "", "", False, 0.0)
    found = (supervision.wanted, supervision.state, supervision.fault)
    assert (*found, supervision.latched, supervision.rehearsal) == nothing
    assert supervision.reason_to_end() == STOPPED
    with pytest.raises(WireError, match="a test that began before this rig was ready"):
        listener.tell(state, steps=9)
    assert not listener.tell(state, steps=9)  # a sign of life
    assert supervision.reason_to_end() == STOPPED
    assert not listener.tell("idle", "ready", "idle")
    with pytest.raises(WireError, match="began before this rig"):
        listener.tell(state, steps=9)


def test_a_rig_moves_from_start_to_end_and_not_again(listener):
    assert not listener.tell("idle", "ready")
    assert listener.tell("running", steps=9)
    assert listener.supervision.reason_to_end() is None
    assert listener.tell("ramping_down", "running", steps=9)
    assert (listener.supervision.state, listener.supervision.wanted.steps) == ("running", 9)
    assert not listener.tell("done")
    assert listener.supervision.reason_to_end() == STOPPED
    with pytest.raises(WireError, match="began before this rig"):
        listener.tell("running", steps=9)
    assert not listener.supervision.is_moving


def test_a_test_says_how_many_steps_it_has(listener):
    listener.tell("ready")
    with pytest.raises(WireError, match="a test without its number of steps"):
        listener.tell("running")
    assert not listener.supervision.is_moving


def test_after_a_trip_a_rig_moves_only_after_a_reset(listener):
    listener.tell("ready")
    listener.tell("running", steps=9)
    listener.supervision.latched, listener.supervision.fault = True, "an error"
    assert listener.supervision.reason_to_end() == "an error"
    listener.tell("tripped", "ready")
    with pytest.raises(WireError, match="a test after a trip and no reset"):
        listener.tell("running", steps=9)
    assert (listener.supervision.latched, listener.supervision.fault) == (True, "an error")
    listener.tell("idle")
    assert (listener.supervision.latched, listener.supervision.fault) == (False, "")
    listener.tell("ready")
    assert listener.tell("running", steps=9)


def test_a_silent_supervisor_ends_a_test_after_its_time(listener):
    listener.clock.now = 7.0
    listener.tell("ready")
    listener.tell("running", steps=9)
    listener.clock.now = 9.0
    assert listener.supervision.reason_to_end() is None
    listener.tell("running", steps=9)
    listener.clock.now = 11.0
    assert listener.supervision.reason_to_end() is None
    listener.clock.now = 11.25
    assert listener.supervision.reason_to_end() == "node supervisor has been silent for 2 s"


def test_a_rehearsal_is_asked_for_and_ended_by_signs_of_life(listener):
    listener.tell("idle", rehearse=2.5, zeroing=0.5)
    assert (listener.supervision.rehearsal, listener.supervision.zeroing) == (2.5, 0.5)
    listener.tell("idle")
    assert (listener.supervision.rehearsal, listener.supervision.zeroing) == (0.0, 0.0)


NONE = float("nan")


def of(*times):
    round_trip = RoundTrip()
    for each in times:
        round_trip.add(each)
    return round_trip


@given(st.lists(st.floats(1e-5, 10.0), min_size=1, max_size=200))
def test_last_and_largest_are_exact_and_the_median_is_near(times):
    round_trip = of(*times)
    assert round_trip.last == times[-1]
    numbers = round_trip.numbers()
    assert numbers["largest"] == max(times)
    assert numbers["p50"] == pytest.approx(statistics.median_low(times), rel=0.06)
    assert list(numbers) == list(ROUND_TRIPS)
    assert sorted(numbers.values()) == list(numbers.values())


def test_each_quantile_is_within_its_bin():
    found = of(*(1e-3 * n for n in range(1, 10_001))).numbers()
    assert list(found.values()) == pytest.approx([5.0, 9.0, 9.9, 9.99, 10.0], rel=0.06)


@pytest.mark.parametrize("time", [0.0, -1.0, 1e-9, 1e9])
def test_any_time_has_its_bin(time):
    numbers = of(time).numbers()
    assert numbers["p50"] <= numbers["largest"] == time
