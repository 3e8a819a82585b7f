"""What `seft check` finds of a rig with one thing wrong each, on the virtual clock."""

import numpy as np
import pytest
from experiments_at_hand import JHU, load
from seft_msgs_py.config.facts import CHANNELS
from seft_msgs_py.virtual.scheduler import Scheduler, VirtualClock
from seft_plant_sim.simulated.rig import ConverterBoard
from seft_ros.check.motion_checks import RigCheck
from seft_ros.check.rig_mover import RigMover


class Board:
    """A laboratory's class, whose calls pass what a test puts in their way."""

    clock = None

    def __init__(self, parameters, axes):
        self._board, self._n, self.reads = ConverterBoard(parameters, axes), len(axes), 0

    def read(self):
        self.reads += 1
        return self.shown(self._board.inputs())

    def write(self, drive):
        self._board.output(self.valve * drive)

    def safe(self):
        self._board.output(np.zeros(self._n))

    def close(self):
        self.safe()

    def shown(self, volts):
        return volts

    valve = 1.0


HOSTED = f"rig:hardware:={__name__}:Board"


@pytest.fixture
def checked(monkeypatch):
    """Check a board that is spoilt by other members; gives findings by name, and how it rests."""

    def run(*words, config="jhu", travel=0.005, force=2000.0, **members):
        for name, member in members.items():
            monkeypatch.setattr(Board, name, member)
        experiment, Board.clock = load(HOSTED, *words, config=config), VirtualClock(Scheduler())
        of = experiment.rigs[0]
        mover = RigMover(experiment, of, Board.clock, travel, force)
        try:
            found = [*RigCheck(mover, experiment, of, None).findings()]
        except KeyboardInterrupt:
            found = []
        return {each.name: each for each in found}, mover.close()

    return run


def wrong(found):
    """Texts of what is wrong, by name."""
    return {name: each.text for name, each in found.items() if not each.ok}


def times(row, factor):
    """Spoil a channel of a board by a factor."""

    def shown(self, volts):
        volts[row] *= factor
        return volts

    return shown


CHECKED = {
    *("rest", "direction", "dead time", "safe()", "calls"),
    *(f"{name}{what}" for name in CHANNELS for what in ("", " lag")),
}


def test_a_board_without_fault_passes(checked):
    found, rests = checked()
    assert (wrong(found), set(found), rests) == ({}, CHECKED, "the rig is at rest")


@pytest.mark.parametrize(
    ("words", "config"),
    [
        ((), "three_storey_frame"),
        ((), "heavy_specimen"),
        (("sensors.velocity:=derived",), "jhu"),
        (("actuator.kind:=delay", "actuator.delay:=0.01"), "jhu"),
    ],
)
def test_other_rigs_pass(checked, words, config):
    assert wrong(checked(*words, config=config)[0]) == {}


OPEN, NO_STOP = (lambda self, drive: self._board.output(drive + 0.05)), (lambda self: None)


@pytest.mark.parametrize(
    ("name", "remedy", "members"),
    [
        ("displacement", "_per_volt: make it negative, -1 in place of 1", {"shown": times(0, -1)}),
        ("force", "force_per_volt: make it negative, -1 in", {"shown": times(3, -1)}),
        ("displacement", "_per_volt: 0.0254 in place of 1", {"shown": times(0, 1 / 0.0254)}),
        ("acceleration", "_per_volt: make it negative, -9.81", {"shown": times(2, -1 / 9.80665)}),
        ("force", "/**: calibration.force_per_volt: 1e+03 in place", {"shown": times(3, 1e-3)}),
        ("acceleration", "shows no motion: look at its cable", {"shown": times(2, 0)}),
        ("direction", "reverse the sign in write()", {"valve": -1.0}),
        ("safe()", "rig: hardware: its safe()", {"safe": NO_STOP}),
        ("rest", "safe.valve_command", {"write": OPEN}),
        ("rest", "/**: calibration.displacement_per_volt is wrong", {"shown": times(0, 1e3)}),
        ("rest", "/**: calibration.velocity_per_volt is wrong", {"shown": times(1, 1e3)}),
    ],
)
def test_what_is_wrong_is_found_with_its_remedy(checked, name, remedy, members):
    found = checked(**members)[0]
    assert set(wrong(found)) == {name}
    assert remedy in found[name].text
    assert (name == "rest") == (len(found) == 1)  # then nothing moves


@pytest.mark.parametrize(("row", "name"), [(1, "velocity"), (3, "force")])
def test_a_channel_of_twice_its_size_is_found(checked, row, name):
    found = wrong(checked(shown=times(row, 2.0))[0])
    assert set(found) == {name}
    new = found[name].split("_per_volt: ")[1].split()[0]
    assert float(new) == pytest.approx(0.5, abs=0.03)


@pytest.mark.parametrize("name", CHANNELS)
def test_a_channel_that_is_3_ms_late_is_found_and_its_parameter_named(checked, name):
    found = wrong(checked(f"rig:simulated.sensors.{name}_lag:=0.003")[0])
    assert set(found) - {"dead time"} == {f"{name} lag"}
    new = found[f"{name} lag"].split(f"/**: calibration.{name}_lag: ")[1].split()[0]
    assert float(new) == pytest.approx(0.003, abs=0.0006)


def test_a_lag_that_is_known_is_none(checked):
    assert wrong(checked("calibration.force_lag:=0.003")[0]) == {}


def test_a_dead_time_is_found(checked):
    found = wrong(checked("rig:simulated.actuator.dead_time:=0.008")[0])
    assert set(found) == {"dead time"}
    new = found["dead time"].split("/**: actuator.dead_time: ")[1].split()[0]
    assert float(new) == pytest.approx(0.008, abs=0.0005)


def test_exchanged_channels_and_a_dead_rig_are_found(checked):
    def exchanged(self, volts):
        return volts[[0, 2, 1, 3]]

    found = wrong(checked(shown=exchanged)[0])
    assert {"velocity", "acceleration"} & set(found)
    assert "at its place in read()" in " ".join(found.values())
    found = wrong(checked(shown=times(2, 1.0), valve=0.0)[0])
    assert "nothing moves: is the pressure on" in found["motion"]


def test_exchanged_valves_are_found(checked):
    exchange = np.eye(3)[[1, 0, 2]]
    write = {"write": lambda self, drive: self._board.output(exchange @ drive)}
    found = checked(config="three_storey_frame", **write)[0]
    assert "floor_1 moves floor_2" in wrong(found)["floor_1: motion"]


@pytest.mark.parametrize("milliseconds", [1.2, 5.0])
def test_slow_reads_are_found_before_anything_moves(checked, milliseconds):
    def slow(self, volts):
        self.clock.sleep(1e-3 * milliseconds)
        return volts

    found = checked(shown=slow)[0]
    assert set(wrong(found)) == {"calls"}
    assert f"read() {milliseconds:g} ms" in found["calls"].text
    assert "lower /**: rate" in found["calls"].text
    assert "direction" not in found


@pytest.mark.parametrize(("every", "name"), [(100, None), (20, "calls")])
def test_few_reads_may_be_late(checked, every, name):
    def late(self, volts):
        self.clock.sleep(0.0 if self.reads % every else 5e-3)
        return volts

    found = wrong(checked(shown=late)[0])
    assert set(found) == ({name} if name else set())
    assert "came late" in found.get(name, "came late")


def at_read(number, what, lasts=1):
    """Spoil some reads of a board."""

    def shown(self, volts):
        return what(volts) if number <= self.reads < number + lasts else volts

    return shown


def broken(volts):
    raise OSError("card lost")


def interrupted(volts):
    raise KeyboardInterrupt


def unknown(volts):
    volts[1] = np.nan
    return volts


IN_MOTION = 4000  # after 1 s at rest and the first small motion


def test_an_exception_in_the_middle_ends_at_rest(checked):
    found, rests = checked(shown=at_read(IN_MOTION, broken))
    assert "read(): card lost" in wrong(found)["calls"]
    assert rests == "the rig is at rest"


def test_what_is_no_number_names_its_parameter(checked):
    found, rests = checked(shown=at_read(IN_MOTION, unknown))
    assert "nan for the velocity" in wrong(found)["calls"]
    assert "/**: sensors.velocity: derived" in wrong(found)["calls"]
    assert rests == "the rig is at rest"


def test_ctrl_c_in_the_middle_says_that_the_rig_is_at_rest(checked):
    assert checked(shown=at_read(IN_MOTION, interrupted)) == ({}, "the rig is at rest")


def test_a_rig_that_can_not_be_seen_or_stopped_is_not_said_to_rest(checked):
    forever = at_read(IN_MOTION, broken, lasts=10**9)
    assert "NOT known to be at rest: safe() was called, but" in checked(shown=forever)[1]

    def fails(self):
        raise OSError("no power")

    assert "the rig is NOT at rest" in checked(shown=forever, safe=fails)[1]
    assert "no power" in checked()[1]


def test_a_rig_that_drifts_after_its_stop_is_not_at_rest(checked):
    def leaks(self, drive):
        self._board.output(drive + 0.2 * (self.reads > IN_MOTION))

    rests = checked(write=leaks, safe=lambda self: self.write(np.zeros(1)))[1]
    assert "the rig is NOT at rest: it shows 0.00" in rests


def test_a_motion_that_goes_too_far_ends(checked):
    found, rests = checked(travel=1e-4, force=20.0)
    assert "more than 0.0001 m and 20 N" in wrong(found)["limits"]
    assert rests == "the rig is at rest"


def test_the_command_asks_before_it_moves_and_tries_a_simulated_rig(seft, seft_json, monkeypatch):
    status, _, errors = seft("check", JHU, "-p", HOSTED)
    assert status == 2
    assert "the rig will be moved (0.2 V, stopped at 5 mm): say --yes" in errors
    monkeypatch.setattr("seft_msgs_py.node.transport.MACHINE", VirtualClock(Scheduler()))
    result = seft_json("check", JHU)
    assert (result["good"], result["rest"]) == (True, "the rig is at rest")
    assert set(result["checks"][0]) == {"name", "ok", "text"}
    monkeypatch.setattr(Board, "valve", -1.0)
    status, out, _ = seft("check", JHU, "-p", HOSTED, "--yes")
    assert (status, "1 wrong" in out) == (1, True)
    monkeypatch.setattr(Board, "valve", 1.0)
    monkeypatch.setattr(Board, "shown", at_read(IN_MOTION, interrupted))
    status, _, errors = seft("check", JHU, "-p", HOSTED, "--yes")
    assert (status, errors.count("interrupted; the rig is at rest")) == (1, 1)
