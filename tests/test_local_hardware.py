"""A laboratory's hardware in the rig node, beside the other nodes of a test, in virtual time."""

import re

import boards
import numpy as np
import pytest
from graph_tools import BRIDGE
from local_tools import (
    RIGS_NODES,
    THREE_SECONDS,
    UNREHEARSED,
    assert_same,
    begin,
    offline,
    perform,
)
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.errors import InputError
from seft_msgs_py.wire.messages import decode_description, decode_diagnostics
from seft_msgs_py.wire.outcome import NOT_AT_REST, STOPPING
from seft_msgs_py.wire.topics import DESCRIPTION, DIAGNOSTICS, RIG_STATE, RigAxes
from seft_plant_sim.hardware.hosted import HostedHardware
from seft_plant_sim.rig_parameters import RIG_TABLE, as_simulated

SMALL = ("ground_motion:synthetic.duration:=3.0", "ground_motion:peak_force:=20.0")
IN_VOLTS = (
    *("calibration.displacement_per_volt:=0.01", "calibration.velocity_per_volt:=-0.1"),
    *("calibration.acceleration_per_volt:=3.924", "calibration.force_per_volt:=2220.0"),
)


@pytest.fixture
def hosting(local_graph):
    """Make the nodes of a test whose rig hosts a class of `boards`."""

    def make(name, *overrides):
        boards.CALLS.clear()
        return local_graph(*SMALL, f"rig:hardware:=boards:{name}", *overrides)

    return make


def calls():
    """Methods that were called, in order."""
    return [method for method, _ in boards.CALLS]


def test_a_board_that_shows_volts_is_rehearsed_zeroed_and_performs_a_test(hosting):
    graph = hosting("Board", *IN_VOLTS, "rig:simulated.sensors.force_bias:=22.2")
    perform(graph)
    assert graph.values["detail"] == "1751 steps done"
    assert (graph.status("rig")["missed"], graph.status("rig")["overruns"]) == ("0", "0")
    force = graph.samples(RIG_STATE)[1][:100, 3]
    assert abs(force.mean()) < 1.5  # N, of which the noise is 0.3
    raw = [sent.raw for sent in graph.graph.sent if sent.topic == DESCRIPTION.name]
    told = [facts for node, facts in map(decode_description, raw) if node == "rig"]
    zeroed = told[-1]["zeroed"]
    assert zeroed["samples"] == 500
    assert abs(zeroed["subtracted"]["force"][0] - 22.2) < 1.0
    assert zeroed["subtracted"]["displacement"] == [0.0]
    stopped = graph.until(lambda: graph.status("rig").get("stop time (s)"))
    assert float(stopped) > 0.02
    assert len({thread for _, thread in boards.CALLS}) == 1


@pytest.mark.parametrize("axes", [("x",), ("a", "b", "c")])
def test_a_board_that_waits_gives_the_bits_of_the_simulated_rig_in_lockstep(hosting, axes):
    words = (f"axes:=[{', '.join(axes)}]", "rig:pace:=lockstep", "calibration.zeroing:=0.0")
    graph = hosting("Waits", UNREHEARSED, *words)
    perform(graph)
    assert_same(graph, offline(as_simulated_graph(graph)))


def as_simulated_graph(graph):
    """The same test with a simulated rig, for `offline`."""
    graph.experiment = as_simulated(graph.experiment)
    return graph


def test_a_rig_without_a_velocity_sensor_gives_no_numbers_for_it(hosting):
    graph = hosting("NoVelocity", "sensors.velocity:=derived")
    perform(graph)
    assert np.abs(graph.samples(RIG_STATE)[1][:, 1]).max() > 1e-4
    graph = hosting("NoVelocity")
    graph.until(lambda: graph.status("rig").get("phase"))
    graph.run(0.1)
    (said,) = {line.text for line in graph.graph.lines if "velocity" in line.text}
    assert said.endswith("give /**: sensors.velocity: derived")


def test_a_rig_that_is_terminated_closes_its_valve_in_time_and_gives_its_devices_back(hosting):
    graph = hosting("Board")
    begin(graph)
    graph.run(1.0)
    boards.CALLS.clear()
    graph.terminate("rig")
    graph.until("tripped")
    assert graph.endings == {"rig": 0}
    assert calls().count("write") >= 9  # of the 10 steps in which the valve closes
    assert calls()[-2:] == ["safe", "close"]


FAULTS = {
    "Raises": r"boards:Raises line \d+: read\(\): the converter does not answer",
    "Shrinks": r"boards:Shrinks line \d+: read\(\) gave an array of shape \(3, 1\), not \(4, 1\)",
    "Loses": r"boards:Loses line \d+: read\(\) gave nan for the force of axis x",
    "Tells": r"boards:Tells line \d+: read\(\) gave no numbers, but 'no numbers'",
    "Refuses": r"boards:Refuses line \d+: write\(\): refused",
    "Exits": r"boards:Exits line \d+: read\(\): SystemExit\('no licence'\)",
    "Slow": r"boards:Slow line \d+: read\(\) took 3 ms, more than a period of 2 ms",
}


@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_in_a_test_has_its_line_and_the_valve_is_made_safe(hosting, monkeypatch, name):
    graph = hosting(name, UNREHEARSED)
    monkeypatch.setattr(boards.Slow, "clock", graph.graph.clock)
    begin(graph)
    graph.until("tripped")
    assert re.search(FAULTS[name], graph.values["detail"]), graph.values["detail"]
    graph.run(0.1)
    assert "safe" in calls()
    if name != "Refuses":  # the valve closes in its time, without samples
        reads = [place for place, call in enumerate(calls()) if call == "read"]
        assert 9 <= calls()[reads[boards.AT] :].count("write") <= 12
    assert graph.endings == {}
    graph.terminate("rig")
    graph.run(0.1)
    assert calls()[-1] == "close"


def test_a_test_waits_for_hardware_that_fails_and_says_why(hosting):
    graph = hosting("Inherits", UNREHEARSED)
    graph.until(lambda: "waiting for the rig" in graph.values.get("detail", ""))
    why = r"waiting for the rig, as boards:Inherits, textwrap.py line \d+: read\(\): "
    assert re.match(why, graph.values["detail"])


def test_one_of_two_rigs_hosts_hardware_and_the_other_is_simulated(local_graph, tmp_path):
    boards.CALLS.clear()
    pace, file = "    pace: realtime", tmp_path / "east.yaml"
    file.write_text(BRIDGE.read_text().replace(pace, f"{pace}\n    hardware: boards:Board"))
    own = {"east/rig": [file]}
    graph = local_graph(THREE_SECONDS, config=BRIDGE, nodes=RIGS_NODES, own_files=own)
    perform(graph)
    reported = graph.until(lambda: graph.status("east/rig").get("stop time (s)"))
    assert float(reported) > 0.0
    assert graph.status("east/rig")["steps"] == graph.status("west/rig")["steps"]
    assert "safe" in calls()


def test_a_piston_that_goes_on_loses_its_pressure(hosting):
    graph = hosting("Dumps", "limits.displacement:=0.02")
    perform(graph)
    said = graph.until(lambda: graph.status("rig").get("stop time (s)"))
    assert said
    assert "dump_pressure" in calls()


def test_a_rig_that_is_not_made_safe_is_said_not_to_be_at_rest(hosting):
    graph = hosting("Stuck", "limits.displacement:=0.02", UNREHEARSED)
    perform(graph)
    graph.until(lambda: graph.status("rig").get("stop time (s)"))
    assert any("safe(): the relay is stuck" in line.text for line in graph.graph.lines)
    sent = [each.raw for each in graph.graph.sent if each.topic == DIAGNOSTICS.name]
    told = [status for raw in sent for status in decode_diagnostics(raw)[1]]
    assert any("not at rest after" in status.message for status in told)
    ends = [key for each in told for key in (STOPPING, NOT_AT_REST) if key in each.values]
    assert (ends[0], ends[-1]) == (STOPPING, NOT_AT_REST)  # seft run waits, and then says so


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("boards:WithoutSafe", "rig: hardware: boards:WithoutSafe has no method safe"),
        ("boards:Broken", "rig: hardware: boards:Broken line 166 can't be made: no board"),
        ("boards:Nothing", "rig: hardware is boards:Nothing, but"),
        ("nothing.py:Board", "rig: hardware is nothing.py:Board, but there is no file nothing.py"),
        ("unknown", "rig: hardware is 'unknown', but must be FILE.py:CLASS"),
    ],
)
def test_hardware_that_can_not_be_made_is_one_line(name, says):
    given = [("rig", "hardware", name), ("/**", "specimen.mass", 1.0)]
    given += [("/**", "specimen.stiffness", 1.0)]
    test = Experiment.load([RIG_TABLE], [], given)
    with pytest.raises(InputError) as error:
        HostedHardware(test["rig"], test.axes, RigAxes.whole(test.axes), 0.002, lambda: 0.0)
    assert str(error.value).startswith(says)


@pytest.mark.parametrize(
    ("word", "why"),
    [
        ("faults:=force add 100 at 1", "faults are those of a simulated rig; leave them out"),
        ("pace:=lockstep", "boards:Board can't wait for a command; make pace realtime"),
    ],
)
def test_what_a_laboratory_s_hardware_can_not_do_is_refused(hosting, capfd, word, why):
    hosting("Board", f"rig:{word}").run(0.1)
    assert why in capfd.readouterr().err
