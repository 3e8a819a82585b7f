"""The recorder in virtual time: its bag holds the test."""

import dataclasses
import shutil

import numpy as np
import pytest
from local_tools import (
    LOCKSTEP,
    LONG,
    NODES,
    SHORT,
    THREE_SECONDS,
    UNREHEARSED,
    at_rest,
    offline,
    perform,
    saved,
)
from seft_msgs_py.wire.topics import REFERENCE_FORCE, RIG_STATE
from seft_plant_sim.rig_watch import MAX_UNRECORDED_STEPS
from seft_ros.analysis.report_numbers import report_numbers
from seft_ros.analysis.summary import summarise
from seft_ros.drawing.style import Mark

RECORDED = (*NODES, "recorder")


@pytest.fixture
def recorded(local_graph, tmp_path):
    """Make nodes with a recorder."""
    place = f"recorder:directory:={tmp_path}"
    return lambda *words: local_graph(place, *words, nodes=RECORDED)


def assert_holds(found, expected) -> None:
    """Check that a recording has the samples of another, and maybe more topics."""
    for topic, series in expected.series.items():
        np.testing.assert_array_equal(found.series[topic].steps, series.steps)
        np.testing.assert_array_equal(found.series[topic].values, series.values)


def test_a_bag_holds_the_samples_of_the_offline_loop_and_the_rehearsal(recorded):
    graph = recorded(THREE_SECONDS)
    perform(graph)
    found = saved(graph)
    assert (found.complete, found.missed, found.trip) == (True, 0, None)
    assert_holds(found, offline(graph))
    rehearsal = found.facts["rig"]["rehearsal"]
    assert (rehearsal["rate_hz"], rehearsal["steps"]) == (500.0, 750)
    assert 2e-4 < rehearsal["round_trip_s"]["p50"] < 2e-3
    assert summarise(found)["timing"]["rehearsal"] == rehearsal


def test_tests_that_follow_one_another_at_once_have_a_whole_bag_each(recorded):
    graph = recorded(*SHORT, LOCKSTEP)
    bags = {}
    for _ in range(3):
        for end in ("done", "tripped"):
            graph.until("ready")
            assert graph.call("start") == (True, "the test is running")
            if end == "tripped":
                assert graph.call("estop")[0]
            graph.until(end)
            graph.until(lambda: graph.call("reset")[0])
            graph.until(lambda: graph.status("recorder").get("bag", "") not in {"", *bags})
            recording = saved(graph)
            assert recording.complete
            assert "rehearsal" not in recording.facts["rig"]
            assert (recording.trip is None) == (end == "done")
            if end == "done":
                assert_holds(recording, offline(graph))
            bags[graph.status("recorder")["bag"]] = recording
    assert len(bags) == 6


def test_a_test_waits_until_there_is_a_place_for_its_bag(recorded, tmp_path):
    (tmp_path / "bag").mkdir()
    graph = recorded(*SHORT, UNREHEARSED, "recorder:name:=bag")
    graph.until(lambda: "exists already" in graph.values.get("detail", ""))
    assert graph.values["detail"] == (
        f"waiting for the recorder, as {tmp_path / 'bag'} exists already; "
        "correct that, or set its parameter name or directory to another"
    )
    assert graph.call("start")[0] is False
    graph.set_parameter("recorder", "name", "named")
    perform(graph)
    assert saved(graph).complete
    assert (tmp_path / "named").is_dir()


@pytest.mark.parametrize("on_loss", ["stop", "go_on"])
def test_a_bag_that_is_deleted_under_way_is_saved_all_the_same(running, tmp_path, on_loss):
    words = (f"recorder:directory:={tmp_path}", "recorder:name:=bag")
    graph = running(LONG, *words, f"recorder:on_loss:={on_loss}", nodes=RECORDED)
    shutil.rmtree(tmp_path / "bag")
    if on_loss == "go_on":
        graph.run(3.0)
        assert graph.state == "running"
        graph.call("stop")
    recording = saved(graph)
    assert recording.complete
    assert recording.series["rig/state"].steps.tolist() == graph.samples(RIG_STATE)[0]
    assert recording.series["reference_force"].values[-1, 0, 0] == 0.0
    if on_loss == "stop":
        lost = f"the recorder's bag is lost: {tmp_path / 'bag'}: the bag was deleted"
        assert recording.trip.reason == graph.values["detail"] == lost
    else:
        assert (recording.stopped, recording.trip) == (True, None)


def test_the_numbers_of_a_stopped_test_are_those_before_its_ramp(running, tmp_path):
    graph = running(f"recorder:directory:={tmp_path}", nodes=RECORDED)
    graph.run(4.0)
    graph.call("stop")
    graph.until("done")
    recording = saved(graph)
    found, last = summarise(recording), recording.last_step
    assert (found["stopped"], found["trip"], found["stable"]) == (True, None, True)
    assert found["judged_steps"] == last + 1 == int(graph.status("reference_force")["ramp_step"])
    until_then = {name: each.until(last) for name, each in offline(graph).series.items()}
    planned = summarise(dataclasses.replace(recording, stopped=False, series=until_then))
    assert found["displacement"] == planned["displacement"]
    said = f"stopped by the operator at {(last + 1) * 0.002:.3f} s"
    findings = report_numbers(recording).assessment.findings
    finding = next(each for each in findings if each.name == "ending")
    assert (finding.verdict, finding.text) == (Mark.DOUBT, f"it was {said}")


def test_a_fault_in_the_ramp_of_a_stop_is_a_trip_of_which_steps_before_it_count(running, tmp_path):
    graph = running(f"recorder:directory:={tmp_path}", nodes=RECORDED)
    graph.run(2.0)
    graph.call("stop")
    graph.run(0.3)
    graph.call("estop")
    recording = saved(graph)
    assert recording.trip.reason == graph.values["detail"]
    assert recording.trip.reason.startswith("aborted by the operator (while ramping down: stopped")
    assert not recording.stopped
    assert recording.last_step < recording.trip.step - 100


def test_the_death_of_the_recorder_brings_the_test_down_softly(running, tmp_path):
    graph = running(LONG, f"recorder:directory:={tmp_path}", nodes=RECORDED)
    graph.kill("recorder")
    graph.until("tripped")
    assert "node recorder has been silent since" in graph.values["detail"]
    assert graph.samples(REFERENCE_FORCE)[1][-1, 0, 0] == 0.0
    assert at_rest(graph)


def test_in_lockstep_the_rig_waits_for_a_recorder_that_stands_still(running, tmp_path):
    words = (f"recorder:directory:={tmp_path}", LOCKSTEP)
    words += ("rig:lockstep_timeout:=60.0", "supervisor:watchdog.peer_timeout:=60.0")
    graph = running(LONG, *words, nodes=RECORDED, latency=5e-4)
    before = len(graph.samples(RIG_STATE)[0])
    graph.freeze("recorder")
    graph.run(10.0)
    steps = len(graph.samples(RIG_STATE)[0])
    assert steps - before <= MAX_UNRECORDED_STEPS  # fewer than the recorder's queue holds
    graph.thaw("recorder")
    graph.run(1.0)
    assert len(graph.samples(RIG_STATE)[0]) > steps + 100
    graph.call("stop")
    assert saved(graph).series["rig/state"].steps.tolist() == graph.samples(RIG_STATE)[0]
