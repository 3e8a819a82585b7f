"""Values and faults of the program that end a test, in virtual time."""

import json

import numpy as np
import pytest
from local_tools import (
    LOCKSTEP,
    LONG,
    NODES,
    TARGET_MOTION,
    UNREHEARSED,
    at_rest,
)
from seft_msgs_py.wire.messages import encode_diagnostics
from seft_msgs_py.wire.outcome import FINISHED, Outcome, rig_status
from seft_msgs_py.wire.topics import DIAGNOSTICS, RIG_STATE
from seft_plant_sim.simulated.rig import Rig
from seft_ros.test_run.compiled_loop import build_blocks


def test_a_rig_whose_model_is_not_a_number_trips(running, monkeypatch):
    graph = running(LONG)
    step = Rig.step

    def broken(rig, command):
        rig.state.line[:] = np.nan
        return step(rig, command)

    monkeypatch.setattr(Rig, "step", broken)
    graph.until("tripped", within=0.1)
    assert graph.values["detail"].endswith(": displacement_wrong")
    monkeypatch.undo()


@pytest.mark.parametrize("end", ["estop", "force_controller"])
def test_a_rig_follows_the_plan_to_rest_also_when_its_sender_is_dead(local_graph, end):
    graph = local_graph(LONG, *TARGET_MOTION, LOCKSTEP, UNREHEARSED)
    graph.until("ready")
    graph.call("start")
    graph.until(lambda: len(graph.samples(RIG_STATE)[0]) > 1503)
    if end == "estop":
        graph.call("estop")
    else:
        graph.kill(end)
    graph.until(lambda: graph.status("rig").get("phase") == "tripped", within=8.0)
    last = len(graph.samples(RIG_STATE)[0]) - 1
    blocks = build_blocks(graph.experiment)
    rig, force, interlock = blocks.rig, blocks.reference_force, blocks.force_controller
    known, window, every = blocks.ground_motion.known, 1 + force.preview, 5
    state = rig.reset()
    for step in range(last + 1):
        judged = interlock.judge(step, state)
        command = interlock.step(step, force.step(known[step : step + window], judged), judged)
        if step % every == 0 and (end != "force_controller" or step < last):
            sent, plan = step, interlock.stop(step)
        state = rig.step(command) if step < last else state
    age = last - sent
    rig.stop(plan[age:], plan[age - 1] if age else None)
    assert json.loads(graph.status("rig")["simulated"]) == vars(rig.simulated())
    assert float(graph.status("rig")["stop time (s)"]) > 0.1


@pytest.mark.parametrize(
    "node",
    ["rig", "force_controller", "reference_force", "ground_motion", "supervisor", "recorder"],
)
def test_a_fault_of_the_program_ends_the_test_and_estop_still_answers(running, tmp_path, node):
    graph = running(LONG, f"recorder:directory:={tmp_path}", nodes=(*NODES, "recorder"))
    graph.break_next(node)
    graph.until(
        lambda: graph.state == "tripped" or graph.status("rig").get("phase") == "tripped",
        within=3.0,
    )
    assert "a fault of the program in" in graph.values["detail"]
    graph.until(lambda: graph.status(node)["faults"] == "1", within=0.5)
    assert graph.call("estop")[0]
    graph.until("tripped")
    assert at_rest(graph)
    graph.until(lambda: graph.call("reset")[0])
    graph.until("ready")


def test_a_rig_that_finishes_before_the_end_of_the_motion_trips_the_test(running):
    graph = running(LONG)
    finished = rig_status(Outcome(FINISHED, 499, 0, [], 1.0))
    graph.inject(DIAGNOSTICS, encode_diagnostics(0, [finished]), "rig")
    graph.until("tripped", within=0.1)
    assert graph.values["detail"] == "node rig finished after 499 of 101001 steps"
    assert graph.values["step"] == "498"
    assert at_rest(graph)
