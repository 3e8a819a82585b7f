"""Round trips, from when messages were received."""

import dataclasses
import os

import numpy as np
import pytest
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.node.host import FIRST_NICENESS
from seft_ros.analysis.timing import stalls_of, timing_of
from seft_ros.bags.recording import Recording, Series
from seft_ros.test_run import stall_watch
from seft_ros.test_run.stall_watch import StallWatch

DT_NS = 2_000_000


def make_recording(trip_ns, mode="run", pace="realtime", drop=()):
    """States every period, and commands that answer them after a time."""
    count = len(trip_ns)
    steps = np.arange(count)
    sent = steps * DT_NS
    kept = np.setdiff1d(steps, drop)
    one = np.zeros((count, 1, 1))
    rig = {"rate": 500.0, "axes": ["x"], "pace": pace}
    commands = Series(kept, one[kept], received_ns=(sent + trip_ns)[kept])
    series = {
        "ground_motion": Series(steps, one),
        "rig/state": Series(steps, np.zeros((count, 4, 1)), received_ns=sent),
        "reference_force": Series(steps, one, received_ns=sent + 1),
        "valve_command": commands,
    }
    return Recording(Experiment({"rig": rig}), series, environment={"mode": mode})


def test_round_trips_are_from_a_state_to_its_own_command():
    trips = np.array([300_000, 400_000, 2_500_000, 350_000])
    timing = timing_of(make_recording(trips))
    assert timing.round_trip_s == pytest.approx(trips * 1e-9)
    numbers = timing.numbers["round_trip_s"]
    assert numbers["over_a_period"] == 1
    assert numbers["largest"] == pytest.approx(2.5e-3)
    assert numbers["steps"] == 4


def test_a_lost_command_has_no_round_trip():
    timing = timing_of(make_recording(np.full(20, 300_000), drop=[7, 8]))
    assert len(timing.round_trip_s) == 18


def test_the_offline_loop_has_no_timing():
    assert timing_of(make_recording(np.full(5, 1), mode="simulate")) is None


def test_without_times_there_is_no_timing():
    recording = make_recording(np.full(5, 1))
    bare = {name: dataclasses.replace(s, received_ns=None) for name, s in recording.series.items()}
    assert timing_of(dataclasses.replace(recording, series=bare)) is None


def test_an_idealised_actuator_answers_to_the_reference_force():
    record = make_recording(np.full(5, 1))
    none = Series(np.empty(0, np.int64), np.empty((0, 1, 1)), received_ns=np.empty(0, np.int64))
    timing = timing_of(dataclasses.replace(record, series=record.series | {"valve_command": none}))
    assert timing.round_trip_s == pytest.approx(1e-9)


def test_lockstep_keeps_no_pace():
    assert not timing_of(make_recording(np.full(5, 1), pace="lockstep")).numbers["paced"]


def test_a_missed_step_is_the_machines_where_a_bare_process_was_late_too():
    record = make_recording(np.full(20, 300_000), drop=[7, 8, 15])
    stall = [7 * DT_NS + 500_000, 8 * DT_NS + 100_000]
    seen = {"beats": 20, "count": 1, "late_s": 1e-3, "longest_s": 1.6e-3, "intervals_ns": [stall]}
    environment = {"mode": "run", "stalls": seen}
    record = dataclasses.replace(record, missed=3, missed_steps=[7, 8, 15], environment=environment)
    stalls = stalls_of(record)
    assert (stalls["missed_listed"], stalls["missed_in_a_stall"]) == (3, 2)
    assert stalls["count"] == 1


def test_where_nobody_watched_the_machine_nothing_is_said_of_it():
    assert stalls_of(make_recording(np.full(5, 1))) is None


@pytest.mark.parametrize("first", [False, True])
def test_a_stall_watch_takes_precedence_where_its_loop_does_and_tells_what_it_saw(first):
    watch, own = StallWatch(), os.getpriority(os.PRIO_PROCESS, 0)
    watch.begin(sorted(os.sched_getaffinity(0)), 0.002, 0, first=first)
    if os.geteuid() == 0:  # whose right it is
        assert os.getpriority(os.PRIO_PROCESS, watch.pid) == (FIRST_NICENESS if first else own)
    seen = watch.end()
    assert (seen["period"], seen["late_s"]) == (0.0005, 0.001)
    assert seen["beats"] >= seen["count"] >= len(seen["intervals_ns"])


class Machine:
    """A clock, and sleeps that end late by turns."""

    def __init__(self, *late):
        self.now, self._late = 100.0, iter(late)

    def sleep(self, _files, _others, _more, timeout):
        late = next(self._late, None)
        if late is None:
            return [[0]]  # it is to end
        self.now += timeout + late
        return [[]]


def test_a_stall_is_a_deadline_met_late_and_those_missed_meanwhile_are_passed_over(monkeypatch):
    machine = Machine(0.0, 0.0005, 0.0032, 0.0, 0.0015)
    monkeypatch.setattr(stall_watch.select, "select", machine.sleep)
    monkeypatch.setattr(stall_watch.time, "monotonic", lambda: machine.now)
    monkeypatch.setattr(stall_watch.time, "time_ns", lambda: round(1e9 * machine.now))
    seen = stall_watch.watch(0.001, 0.001)
    assert (seen["beats"], seen["count"]) == (5, 2)
    assert seen["longest_s"] == pytest.approx(0.0032)
    lengths = [1e-9 * (end - begin) for begin, end in seen["intervals_ns"]]
    assert lengths == pytest.approx([0.0032, 0.0015])
    # deadlines at 1, 2, 3 and, of the three that were missed, the next at 7 and 8 ms
    assert machine.now == pytest.approx(100.0095)


def test_a_stall_watch_that_was_not_begun_tells_nothing():
    assert StallWatch().end() is None
