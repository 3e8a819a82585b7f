"""A laboratory's driver beside the nodes of a test, in virtual time: the template's."""

import numpy as np
import pytest
from local_tools import UNREHEARSED, at_rest, perform
from seft_msgs_py.config.facts import place_of
from seft_msgs_py.wire.messages import decode_description
from seft_msgs_py.wire.topics import (
    DESCRIPTION,
    GROUND_MOTION,
    REFERENCE_FORCE,
    RIG_STATE,
    VALVE_COMMAND,
)
from seft_ros.bags.recording import Recording, Series
from seft_ros.identification.calibrated import Calibrated, MultisineResult, all_known
from seft_ros.identification.multisine import multisine_drive, plan_multisine, with_actuators
from seft_ros.identification.rig_tests import multisine_test, write_forces
from seft_ros.nodes.kinds import NODE_KINDS
from test_identification_multisine import identified

TOPICS = (GROUND_MOTION, RIG_STATE, REFERENCE_FORCE, VALVE_COMMAND)
SMALL = ("ground_motion:synthetic.duration:=6.0", "ground_motion:peak_force:=20.0")


@pytest.fixture
def driver(local_graph, template):
    """Make the nodes of a test with the template's driver as its rig."""
    from rig_driver.driver_node import KIND

    def make(*overrides):
        kinds, own = {**NODE_KINDS, "rig": KIND}, {"rig": [template / "config/rig.yaml"]}
        return local_graph(*SMALL, *overrides, kinds=kinds, own_files=own)

    return make


def left_by(graph, own):
    """RMS of what the corrected channels leave of the equation of motion, N."""
    x, v, a, f, _ = graph.samples(RIG_STATE)[1][:, :, 0].T
    restoring = own["specimen.damping"] * v + own["specimen.stiffness"] * x
    return (f - own["specimen.mass"] * a - restoring).std()


def multisine_of(driver, folder):
    """Run a short multisine test on the driver's rig, and evaluate it."""
    experiment = driver().experiment
    found = identified(experiment)
    plan = with_actuators(plan_multisine(experiment), found, experiment)
    commands, sines = multisine_drive(plan, found, experiment.timebase.dt, seconds=6.0)
    test = multisine_test(experiment, write_forces(folder / "multisine.csv", experiment, commands))
    words = [
        f"{place_of(name, node)}:{name}:={value}"
        for node in ("ground_motion", "reference_force", "force_controller", "supervisor")
        for name, value in test[node].items()
        if value != experiment[node][name]
    ]
    graph = driver(*words)
    perform(graph)
    sampled = [(topic.name, *graph.samples(topic)) for topic in TOPICS]
    recording = Recording(
        test, {name: Series(np.array(at), values) for name, at, values in sampled}
    )
    known = all_known(experiment)
    return MultisineResult.of_recording(
        plan, recording, sines, found, Calibrated(known, known, 0.0, False)
    )


def test_a_driver_started_again_with_what_a_multisine_test_has_found_is_corrected(
    driver, monkeypatch, tmp_path
):
    from rig_driver import stand_in

    wrong = {"acceleration_lag": 0.0013, "displacement_lag": 0.0006, "acceleration_scale": 0.97}
    for name, value in wrong.items():
        monkeypatch.setitem(stand_in._RIG, f"simulated.sensors.{name}", value)
    first = multisine_of(driver, tmp_path)
    found = first.facts()
    assert {name: found[f"calibration.{name}"][0] for name in wrong} == pytest.approx(
        wrong, abs=5e-5, rel=6e-3
    )
    words = (f"{name}:={value}" for name, value in found.items())
    graph = driver(*words, "ground_motion:peak_force:=400.0")
    perform(graph)
    assert left_by(graph, stand_in._RIG) < 6.0  # N, of which the noise is 4


def test_a_driver_rehearses_zeroes_its_sensors_and_performs_a_test(driver, monkeypatch):
    from rig_driver import stand_in

    monkeypatch.setitem(stand_in._RIG, "simulated.sensors.force_bias", 22.2)
    graph = driver()
    perform(graph)
    assert graph.values["detail"] == "2501 steps done"
    assert (graph.status("rig")["missed"], graph.status("rig")["overruns"]) == ("0", "0")
    force = graph.samples(RIG_STATE)[1][:100, 3]
    assert abs(force.mean()) < 1.5  # N, of which the noise is 0.3
    raw = [sent.raw for sent in graph.graph.sent if sent.topic == DESCRIPTION.name]
    reported = [facts for node, facts in map(decode_description, raw) if node == "rig"][-1][
        "zeroed"
    ]
    assert reported["samples"] == 500
    assert abs(reported["subtracted"]["force"][0] - 22.2) < 1.0
    assert reported["subtracted"]["displacement"] == [0.0]


def test_a_driver_without_commands_trips_and_closes_its_valve(driver):
    graph = driver()
    graph.delay(VALVE_COMMAND, 1.0, range(500, 3000))
    perform(graph, "tripped")
    assert "no new valve_command for 0.02 s (the last is of step 499)" in graph.values["detail"]
    assert at_rest(graph)


def test_a_driver_that_is_terminated_ends_the_test(driver):
    graph = driver()
    graph.until("ready")
    graph.call("start")
    graph.run(1.0)
    graph.terminate("rig")
    graph.until("tripped")
    assert graph.endings == {"rig": 0}
    count = len(graph.samples(RIG_STATE)[0])
    graph.run(1.0)
    assert len(graph.samples(RIG_STATE)[0]) == count


@pytest.mark.parametrize("takes", [0.0, 1.2])
@pytest.mark.parametrize("phase", ["idle", "running"])
def test_a_fault_brings_the_hardware_to_its_safe_command_and_the_driver_lives_on(
    driver, monkeypatch, phase, takes
):
    from rig_driver.stand_in import StandIn

    graph, calls = driver(UNREHEARSED), []

    def broken(_):
        graph.graph.clock.sleep(takes * graph.experiment.timebase.dt)
        raise OSError("the converter does not answer")

    graph.until("ready")
    if phase == "running":
        graph.call("start")
        graph.run(0.5)
    for name in ("write_command", "to_safe_command", "close"):
        monkeypatch.setattr(StandIn, name, lambda *_, name=name: calls.append(name))
    monkeypatch.setattr(StandIn, "read_sample", broken)
    graph.run(0.5)
    # one before the first fault, and one that begins to close the valve
    assert calls.count("write_command") == 2 * (phase == "running")
    assert calls[-1] == "to_safe_command"
    assert int(graph.status("rig")["faults"]) > 10
    graph.terminate("rig")
    assert calls[-2:] == ["to_safe_command", "close"]
    if phase == "running":
        graph.until("tripped")
        assert "the converter does not answer" in graph.values["detail"]
