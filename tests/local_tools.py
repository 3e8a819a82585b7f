"""What the tests of whole graphs in virtual time share."""

import numpy as np
from seft_msgs_py.virtual import LocalGraph
from seft_msgs_py.wire.messages import EstimatesCodec
from seft_msgs_py.wire.topics import ESTIMATES, MEASURED, RIG_STATE, VALVE_COMMAND
from seft_ros.bags.recording import Recording
from seft_ros.bags.recording_bag import read_bag
from seft_ros.reference_force.reference_force_parameters import reference_force_topic
from seft_ros.test_run.blocks import build_blocks
from seft_ros.test_run.offline import simulate_test

LONG = "ground_motion:synthetic.duration:=400.0"
THREE_SECONDS = "ground_motion:synthetic.duration:=3.4"  # s, a test of 3 s
SHORT = ("ground_motion:synthetic.duration:=3.0", "ground_motion:tail:=0.2")
LOCKSTEP = "rig:pace:=lockstep"
UNREHEARSED = "supervisor:rehearsal.duration:=0.0"
NO_COMMAND_WATCH = "rig:watchdog.command_timeout:=60.0"
TARGET_MOTION = (
    "reference_force:compensation.method:=target_motion",
    "force_controller:method:=velocity_feedforward",
    "reference_force:mass_ratio:=1.0",
    "ground_motion:peak_force:=300.0",
)
TWO_AXES = ("axes:=[north, east]", "ground_motion:influence:=[1.0, 0.5]")
NODES = ("ground_motion", "reference_force", "force_controller", "rig", "supervisor")
RIGS_NODES = (
    *("ground_motion", "reference_force", "supervisor"),
    *("west/rig", "west/force_controller", "east/rig", "east/force_controller"),
)


def at_rest(graph: LocalGraph) -> bool:
    """Whether the rig has tripped, and sends no more states."""
    count = len(graph.samples(RIG_STATE)[0])
    graph.run(0.5)
    return len(graph.samples(RIG_STATE)[0]) == count and graph.status("rig")["phase"] == "tripped"


def offline(graph: LocalGraph):
    """What `seft simulate` makes of the same experiment."""
    return simulate_test(graph.experiment, build_blocks(graph.experiment))


def assert_same(graph: LocalGraph, recording, steps: int | None = None) -> None:
    """Check that the samples of a test are those of a recording; or of so many first steps."""
    force = reference_force_topic(graph.experiment["reference_force"])
    for topic in (RIG_STATE, MEASURED, force, VALVE_COMMAND):
        there, (found, values) = recording.series[topic.name], graph.samples(topic)
        count = max(len(found), len(there.steps)) if steps is None else steps
        assert found[:count] == there.steps[:count].tolist(), topic.name
        expected = there.values[:count].reshape(values[:count].shape)
        np.testing.assert_array_equal(values[:count], expected)
    if (known := recording.estimates) is not None:
        codec = EstimatesCodec(graph.experiment.axes, graph.experiment.timebase)
        sent = (codec.decode(each.raw) for each in graph.graph.sent if each.topic == ESTIMATES.name)
        by_step = dict(sent)
        until = [step for step in known.steps.tolist() if steps is None or step < steps]
        found = [list(by_step[step].values()) for step in until]
        np.testing.assert_array_equal(found, known.values[: len(until)])


def begin(graph: LocalGraph) -> None:
    """Start a test."""
    graph.until("ready")
    accepted, answer = graph.call("start")
    assert accepted, answer


def perform(graph: LocalGraph, end: str = "done") -> None:
    """Run a test to its end."""
    begin(graph)
    graph.until(end)


def saved(graph: LocalGraph) -> Recording:
    """Read the bag of the test that has just ended."""
    graph.until(lambda: graph.status("recorder")["phase"] == "saved")
    return read_bag(graph.status("recorder")["bag"])
