"""Values and faults of the program that end a test, in virtual time."""

import json
import re

import pytest
from graph_tools import MISSES_ALLOWED
from local_tools import LOCKSTEP, LONG, NODES, TARGET_MOTION, UNREHEARSED, at_rest, begin, perform
from seft_msgs_py.wire.topics import REFERENCE_FORCE, RIG_STATE, VALVE_COMMAND
from seft_plant_sim.command import stop_period
from seft_ros.test_run.blocks import build_blocks


@pytest.mark.parametrize("end", ["estop", "force_controller"])
def test_a_rig_follows_the_plan_to_rest_also_when_its_sender_is_dead(local_graph, end):
    graph = local_graph(LONG, *TARGET_MOTION, LOCKSTEP, UNREHEARSED)
    begin(graph)
    graph.until(lambda: len(graph.samples(RIG_STATE)[0]) > 1503)
    if end == "estop":
        graph.call("estop")
    else:
        graph.kill(end)
    graph.until(lambda: graph.status("rig").get("phase") == "tripped", within=8.0)
    last = len(graph.samples(RIG_STATE)[0]) - 1
    blocks = build_blocks(graph.experiment)
    rig, force, interlock = blocks.rig, blocks.reference_force, blocks.force_controller
    known, window = blocks.ground_motion.known, 1 + force.preview
    every = stop_period(graph.experiment.timebase.dt)
    state = rig.reset()
    for step in range(last + 1):
        interlock.look(step, state)
        command = interlock.step(step, force.step(known[step : step + window], state[:4]), state)
        if step % every == 0 and step < last:
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


@pytest.mark.parametrize(
    ("every", "late", "most"), [(21, 1.0, 24), (19, 1.0, 27), (1, 0.0025, 500)]
)
def test_too_many_missed_commands_within_a_second_bring_the_test_down(running, every, late, most):
    graph = running(LONG, *MISSES_ALLOWED[1::2])
    first = graph.samples(RIG_STATE)[0][-1] + 1
    graph.delay(VALVE_COMMAND, late, range(first, 10**6, every), "rig")
    graph.run(3.0)
    assert graph.status("rig")["most_missed"] == str(most)
    if most <= 25:
        assert graph.state == "running", graph.values
        return
    assert graph.state == "tripped"
    assert graph.samples(REFERENCE_FORCE)[1][-1, 0, 0] == 0.0
    said = r"node rig missed (\d+) of 500 commands within a second"
    assert 25 < int(re.match(said, graph.values["detail"])[1]) <= most


def test_missed_commands_of_a_short_test_count_until_its_last_step(local_graph):
    graph = local_graph("ground_motion:synthetic.duration:=0.6", "ground_motion:tail:=0.1")
    graph.drop(VALVE_COMMAND, range(100, 200, 3), "rig")
    perform(graph, "tripped")
    assert graph.status("rig")["phase"] == "finished"
    assert "missed 34 of 500 commands within a second (6.8 %" in graph.values["detail"]
