"""A laboratory's driver beside the nodes of a test, in virtual time: the template's."""

import sys

import numpy as np
import pytest
import yaml
from local_tools import at_rest, perform
from seft_msgs_py.wire.messages import decode_description
from seft_msgs_py.wire.topics import (
    DESCRIPTION,
    GROUND_MOTION,
    REFERENCE_FORCE,
    RIG_STATE,
    VALVE_COMMAND,
)
from seft_ros.bags.record import Record, Series
from seft_ros.cli.rig_commands import TEMPLATES
from seft_ros.identification.calibrated import Calibrated, Shaken, all_known
from seft_ros.identification.rig_tests import shake_test, write_forces
from seft_ros.identification.shake import plan_shake, shake_drive, with_actuators
from seft_ros.nodes.kinds import NODE_KINDS
from test_identification_shake import identified

TOPICS = (GROUND_MOTION, RIG_STATE, REFERENCE_FORCE, VALVE_COMMAND)
TEMPLATE = TEMPLATES / "rig_driver"
SMALL = ("ground_motion:synthetic.duration:=6.0", "ground_motion:peak_force:=20.0")


@pytest.fixture
def driver(local_graph, monkeypatch):
    """Make the nodes of a test with the template's driver as its rig."""
    monkeypatch.syspath_prepend(str(TEMPLATE))
    from rig_driver.driver_node import KIND

    def make(*overrides, files=()):
        kinds, own = {**NODE_KINDS, "rig": KIND}, {"rig": [TEMPLATE / "config/rig.yaml", *files]}
        return local_graph(*SMALL, *overrides, kinds=kinds, own_files=own)

    yield make
    for name in [name for name in sys.modules if name.startswith("rig_driver")]:
        del sys.modules[name]


def test_a_driver_rehearses_and_performs_a_test(driver):
    graph = driver()
    perform(graph)
    assert graph.values["detail"] == "2501 steps done"
    assert (graph.status("rig")["missed"], graph.status("rig")["overruns"]) == ("0", "0")


def test_a_driver_aligns_a_late_channel_and_the_loop_counts_its_lag(driver, monkeypatch):
    from rig_driver import stand_in

    for name, value in (("force_lag", 0.003), ("acceleration_lag", 0.0007)):
        monkeypatch.setitem(stand_in._RIG, f"sensors.{name}", value)
    words = ("rig:calibration.force_lag:=0.003", "rig:calibration.acceleration_lag:=0.0007")
    graph = driver("ground_motion:peak_force:=400.0", *words)
    perform(graph)
    x, v, a, f = graph.samples(RIG_STATE)[1][:, :, 0].T
    own = stand_in._RIG
    r = own["specimen.damping"] * v + own["specimen.stiffness"] * x
    left = f - own["specimen.mass"] * a - r
    assert left.std() < 6.0  # N, of which the noise is 4
    assert 0.003 * own["specimen.stiffness"] * v.std() > 12.0  # what 3 ms change of the spring's


def shaken(driver, folder):
    """Shake the driver's rig for a short time, and evaluate that."""
    experiment = driver().experiment
    found = identified(experiment)
    plan = with_actuators(plan_shake(experiment), found, experiment)
    commands, sines = shake_drive(plan, found, experiment.timebase.dt, seconds=6.0)
    test = shake_test(experiment, write_forces(folder / "shake.csv", experiment, commands))
    words = [
        f"{node}:{name}:={value}"
        for node in ("ground_motion", "reference_force", "force_controller", "supervisor")
        for name, value in test[node].items()
        if value != experiment[node][name]
    ]
    graph = driver(*words)
    perform(graph)
    sampled = [(topic.name, *graph.samples(topic)) for topic in TOPICS]
    record = Record(test, {name: Series(np.array(at), values) for name, at, values in sampled})
    known = all_known(experiment)
    return Shaken.of_record(plan, record, sines, found, Calibrated(known, known, 0.0, False))


def test_a_driver_started_again_with_what_a_shake_has_found_is_corrected(
    driver, monkeypatch, tmp_path
):
    from rig_driver import stand_in

    wrong = {"acceleration_lag": 0.0013, "position_lag": 0.0006, "acceleration_scale": 0.97}
    for name, value in wrong.items():
        monkeypatch.setitem(stand_in._RIG, f"sensors.{name}", value)
    first = shaken(driver, tmp_path)
    written = first.sections()["rig"]
    assert {name: written[f"calibration.{name}"][0] for name in wrong} == pytest.approx(
        wrong, abs=5e-5, rel=6e-3
    )
    model = tmp_path / "model.yaml"
    model.write_text(yaml.safe_dump({"rig": {"ros__parameters": written}}))
    words = [f"{n}:{name}:={v}" for n, own in first.lags().items() for name, v in own.items()]
    graph = driver(*words, "ground_motion:peak_force:=400.0", files=[model])
    perform(graph)
    assert facts(graph)["sensor_lag"] == max(written["calibration.acceleration_lag"])
    x, v, a, f = graph.samples(RIG_STATE)[1][:, :, 0].T
    own = stand_in._RIG
    r = own["specimen.damping"] * v + own["specimen.stiffness"] * x
    assert (f - own["specimen.mass"] * a - r).std() < 6.0  # N, of which the noise is 4


def facts(graph):
    """What the rig's last description tells."""
    told = [sent.raw for sent in graph.graph.sent if sent.topic == DESCRIPTION.name]
    return [facts for node, facts in map(decode_description, told) if node == "rig"][-1]


def test_a_driver_zeroes_its_sensors_in_the_rehearsal(driver, monkeypatch):
    from rig_driver import stand_in

    monkeypatch.setitem(stand_in._RIG, "sensors.force_bias", 22.2)
    graph = driver()
    perform(graph)
    force = graph.samples(RIG_STATE)[1][:100, 3]
    assert abs(force.mean()) < 1.5  # N, of which the noise is 0.3
    sent = [each.raw for each in graph.graph.sent if each.topic == DESCRIPTION.name]
    told = [facts for node, facts in map(decode_description, sent) if node == "rig"][-1]["zeroed"]
    assert told["samples"] == 500
    assert abs(told["subtracted"]["force"][0] - 22.2) < 1.0
    assert told["subtracted"]["position"] == [0.0]


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
