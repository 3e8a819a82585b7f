"""`seft identify` offline, end to end, on short tests."""

import json
import re
import shutil
from functools import partial
from types import SimpleNamespace
from unittest.mock import Mock

import numpy as np
import pytest
from commands_at_hand import run_seft
from experiments_at_hand import JHU, load
from seft_msgs_py.config.experiment import read_parameter_file, value_text
from seft_msgs_py.config.facts import CHANNELS
from seft_plant_sim.lti import bilinear, polynomial_ratio
from seft_plant_sim.rig_parameters import truth
from seft_ros.bags.recording_bag import read_bag
from seft_ros.cli import shared
from seft_ros.cli.identification_run import IdentificationTests
from seft_ros.design.plant import Plant, rig_model
from seft_ros.drawing import style
from seft_ros.identification import rig_tests
from seft_ros.identification.response_fits import tracking_measures

LINEAR = ("actuator.kind:=servo_hydraulic_linear",)
SHORT = ("--duration", "14")
BRIEF = ("--duration", "14", "--amplitude", "0.2")
"""The shortest there is, without the pilot test."""
LOOP = 0.003  # s: 1.5 sampling periods


def identified(seft, *words, overrides=()):
    """Run `seft identify --json` on the paper's rig; (status, what it prints, last line)."""
    parameters = [word for text in overrides for word in ("-p", text)]
    status, out, err = seft("identify", JHU, *parameters, *words, "--json")
    return status, json.loads(out) if out else None, err.strip().splitlines()[-1]


@pytest.fixture
def identify(seft, monkeypatch):
    """Identify in an empty folder; the figure is made, but not written."""
    monkeypatch.setattr(style, "save_figure", lambda *_: None)
    return lambda *words, **options: identified(seft, *words, **options)


@pytest.fixture(scope="module")
def linear(tmp_path_factory):
    """Folder and numbers of the linear rig, identified for several tests that look at it."""
    folder = tmp_path_factory.mktemp("linear")
    seft = partial(run_seft, folder)
    status, found, _ = identified(seft, *SHORT, "--specimen", "--out", "out", overrides=LINEAR)
    assert status == 0
    return folder / "out", found


def analytic(*overrides):
    """Plant of the rig's linear model, and measures of its closed force loop, as it runs."""
    experiment = load(*overrides)
    own, dt = experiment["force_controller"], experiment.timebase.dt
    plant, f = Plant.of_model(*rig_model(experiment)), np.geomspace(0.1, 0.499 / dt, 3000)
    sampled = bilinear(np.atleast_1d(own["numerator"]), own["denominator"], dt)
    loop = polynomial_ratio(*sampled, np.exp(2j * np.pi * f * dt)) * plant.sampled_response(f, dt)
    return plant, tracking_measures(f, loop / (1 + loop))


def test_plant_loop_and_closed_loop_agree_with_the_analytic_model(linear):
    _, found = linear
    plant, measures = analytic(*LINEAR)
    zero, pole = plant.antiresonance(), plant.oil_column()
    assert found["notes"][0].startswith("actuator.* describes the actuators and holds for any")
    assert found["actuator"]["verdict"] == "good"
    # of its seven numbers, see test_identification_actuator_fit.py
    assert found["actuator"]["flow_gain_m_per_s_per_v"] == pytest.approx(0.0403, rel=0.01)
    assert found["plant_zero_hz"] == pytest.approx(zero.hz, rel=0.01)
    assert found["plant_zero_damping"] == pytest.approx(zero.damping, rel=0.05)
    assert found["plant_pole_hz"] == pytest.approx(pole.hz, rel=0.005)
    assert found["plant_pole_damping"] == pytest.approx(pole.damping, rel=0.15)
    assert found["delay_s"] == pytest.approx(measures.delay_s, rel=0.02)
    flat_to = pytest.approx(measures.closed_loop_flat_to_hz, rel=0.03)
    assert found["closed_loop_flat_to_hz"] == flat_to
    assert found["bandwidth_hz"] == pytest.approx(measures.bandwidth_hz, rel=0.02)
    tests = ("pilot", "open_loop", "multisine_pilot", "multisine", "closed_loop")
    assert found["tripped"] == dict.fromkeys(tests)
    assert found["fit_error"] < 0.06


def test_the_folder_holds_what_repeats_and_uses_it(linear, seft_json):
    out, found = linear
    tests = {"pilot", "open_loop", "multisine_pilot", "multisine", "closed_loop"}
    names = {f"{name}.csv" for name in ("excitation", "pilot", "multisine_pilot", "multisine")}
    assert {path.name for path in out.iterdir()} == names | tests | {"model.yaml", "figure.png"}
    recording = read_bag(out / "open_loop")
    assert recording.experiment["force_controller"]["feedback"] is False
    voltage = recording.series["valve_command"].values.std()
    assert voltage == pytest.approx(found["excitation_rms"]["voltage"], rel=0.05)
    forces = np.loadtxt(out / "excitation.csv", ndmin=2) * -52.7
    assert forces.std() == pytest.approx(1.0, rel=1e-6)
    reference = read_bag(out / "closed_loop").series["reference_force"].values
    assert reference.std() == pytest.approx(found["excitation_rms"]["force"], rel=0.05)

    model = read_parameter_file(out / "model.yaml")
    assert set(model) == {"/**"}
    multisine, section = found["multisine"], model["/**"]
    assert section["specimen.mass"] == [multisine["mass"]]
    assert multisine["mass"] == pytest.approx(52.7, abs=4 * multisine["mass_error"])
    assert section["specimen.mass_error"] == [pytest.approx(0.04, abs=0.03)]
    damping = multisine["axes"][0]["damping"]
    assert damping["value"] == pytest.approx(800.3, abs=4 * damping["error"])
    assert section["calibration.force_lag_error"] == [multisine["axes"][0]["force"]["lag"]["error"]]
    assert section["specimen.stiffness"] == [pytest.approx(2.11e5, rel=0.005)]
    assert section["actuator.delay"] == pytest.approx(found["delay_s"] - LOOP)
    assert len(section["actuator.flow_gain"]) == 1
    assert not re.search(r"[&*]\w", (out / "model.yaml").read_text())  # ROS 2 reads no aliases
    dead_times = load(files=[out / "model.yaml"])["force_controller"]["actuator.dead_time"]
    assert dead_times == [pytest.approx(0.001, abs=5e-5)]

    with_model = ("--params-file", out / "model.yaml", "-p", "ground_motion:tail:=0.5")
    assert seft_json("simulate", JHU, *with_model)["stable"] is True


SENSORS = (
    "rig:simulated.sensors.acceleration_lag:=0.002",
    "rig:simulated.sensors.velocity_scale:=1.03",
    "rig:simulated.sensors.force_bias:=5.0",
    "rig:simulated.sensors.acceleration_bias:=0.1",
)
PLAN = (
    "reference_force:compensation.method:=target_motion",
    "force_controller:method:=velocity_feedforward",
    "reference_force:mass_ratio:=1.0",
    "ground_motion:synthetic.duration:=12.0",
)


def with_truth(*overrides):
    """Words of overrides, and of what the rig truly is with them, whatever a later file says."""
    true = truth(load(*overrides)["rig"])
    pinned = [f"rig:{name}:={value_text(value)}" for name, value in true.items()]
    return [word for text in (*overrides, *pinned) for word in ("-p", text)]


def test_a_rig_whose_channels_disagree_is_corrected_by_the_file(identify, seft, seft_json):
    status, found, _ = identify(*BRIEF, "--specimen", "--out", "out", overrides=SENSORS)
    assert status == 0
    assert found["actuator"]["flow_gain_m_per_s_per_v"] == pytest.approx(0.0403, rel=0.01)
    lag = found["multisine"]["axes"][0]["acceleration"]["lag"]
    assert lag["value"] == pytest.approx(0.002, abs=4 * lag["error"])
    written = read_parameter_file("out/model.yaml")
    assert written["/**"]["actuator.dead_time"] == [pytest.approx(0.001, abs=1e-4)]
    assert written["/**"]["specimen.damping"] == [pytest.approx(800.3, rel=0.03)]
    words = with_truth(*PLAN, "ground_motion:peak_force:=400.0", *SENSORS)
    assert seft("simulate", JHU, *words)[0] == 1  # it trips
    summary = seft_json("simulate", JHU, "--params-file", "out/model.yaml", *words)
    assert summary["stable"] is True
    assert summary["displacement"]["nrmse_aligned"] < 0.01
    mass = summary["calibration"]["axes"]["x"]["force"]["mass"]
    assert mass["error"] < 0.2  # with that of the multisine test


def test_a_host_that_misses_commands_is_reported(monkeypatch, tmp_path, capsys):
    states = SimpleNamespace(steps=[])
    of = {"trip": None, "stopped": False, "missed": 51, "experiment": load(), "states": states}
    recording = SimpleNamespace(**of)
    monkeypatch.setattr(shared, "dds_test", lambda *_, **__: (recording, tmp_path / "bag"))
    tests = IdentificationTests(load(), tmp_path, False, ["rig"], np.zeros((1000, 1)))
    assert tests.run("open_loop", load(), 1000)
    assert "open_loop: 51 of 1000 steps had no command in time" in capsys.readouterr().err
    recording.missed = 50
    assert tests.run("open_loop", load(), 1000)
    assert not capsys.readouterr().err


def test_a_rig_is_identified_unknown_and_the_model_holds_for_another_specimen(
    identify, seft, seft_json
):
    """With a controller that needs the actuators, and no word of the specimen."""
    unknown = "actuator.flow_gain:=0.0"
    overrides = (
        "force_controller:method:=velocity_feedforward",
        *(unknown, "rig:simulated.actuator.flow_gain:=0.0403"),
    )
    status, found, _ = identify(*BRIEF, "--out", "out", overrides=overrides)
    assert status == 0
    assert found["actuator"]["flow_gain_m_per_s_per_v"] == pytest.approx(0.0403, rel=0.01)
    assert found["delay_s"] is None
    assert found["tripped"] == {"open_loop": None, "closed_loop": None}
    model = read_parameter_file("out/model.yaml")
    assert not any(name.startswith(("actuator.response.", "specimen.")) for name in model["/**"])
    words = with_truth(
        *(*PLAN, "ground_motion:peak_force:=500.0", "specimen.stiffness:=1.5e5"),
        "rig:simulated.specimen.kind:=bilinear",
        "rig:simulated.specimen.yield_displacement:=0.003",
    )
    assert seft("simulate", JHU, *words, "-p", unknown)[0] == 2
    summary = seft_json("simulate", JHU, "--params-file", "out/model.yaml", *words)
    assert summary["stable"] is True
    assert summary["displacement"]["nrmse"] < 0.02


def test_the_known_lag_of_the_sensors_is_no_part_of_what_is_written(identify):
    """The loop adds it."""
    lag = 0.003
    overrides = [f"calibration.{channel}_lag:={lag}" for channel in CHANNELS]
    status, found, _ = identify(*BRIEF, "--out", "out", overrides=overrides)
    assert status == 0
    assert found["actuator"]["dead_time_s"] == pytest.approx(0.001 + lag, abs=3e-4)
    written = read_parameter_file("out/model.yaml")["/**"]
    dead_time = found["actuator"]["dead_time_s"] - lag
    assert written["actuator.dead_time"] == pytest.approx([dead_time])
    # the delay of a force loop with feedback hardly depends on it
    assert written["actuator.delay"] == pytest.approx(found["delay_s"] - LOOP)
    assert found["delay_s"] == pytest.approx(0.0139, abs=2e-3)


def test_a_rig_without_a_valve_has_the_closed_loop_only(identify, tmp_path):
    overrides, delay = ["actuator.kind:=delay", "actuator.delay:=0.0113"], 0.0173
    overrides += [f"calibration.{channel}_lag:=0.004" for channel in CHANNELS]
    status, found, _ = identify(*BRIEF, "--out", "out", overrides=overrides)
    assert status == 0
    assert found["plant_zero_hz"] is found["plant_pole_hz"] is None
    assert found["coherence"]["open_loop"] is None
    # the loop's latency, the dead time, and half a sample where the command is held over it
    assert delay - 1e-4 < found["delay_s"] < delay + 1.1e-3
    assert found["specimen"]["mass"] == pytest.approx(52.7, rel=0.01)
    assert any("valve" in note for note in found["notes"])
    section = read_parameter_file(tmp_path / "out" / "model.yaml")["/**"]
    assert section["actuator.response.dead_time"] > 0.0
    assert section["actuator.delay"] == pytest.approx(found["delay_s"] - 0.004 - LOOP)


@pytest.mark.thorough
@pytest.mark.offline
def test_several_axes_have_their_numbers_each(identify, tmp_path):
    stiffness = "rig:simulated.specimen.stiffness:=[2.1e5, -3.0e4, -3.0e4, 2.0e5]"
    overrides = (*LINEAR, "axes:=[north, east]", stiffness, "specimen.mass:=[52.7, 50.0]")
    words = (*BRIEF, "--specimen", "--out", "out")
    status, found, _ = identify(*words, overrides=overrides)
    assert status == 0
    assert [axis["axis"] for axis in found["axes"]] == ["north", "east"]
    assert found["axes"][0]["plant_zero_hz"] == found["plant_zero_hz"]
    np.testing.assert_allclose(found["specimen"]["mass"], np.diag([52.7, 50.0]), atol=0.5)
    known = [[2.1e5, -3.0e4], [-3.0e4, 2.0e5]]
    np.testing.assert_allclose(found["specimen"]["stiffness"], known, atol=2e3)
    for axis, pole_hz in zip(found["axes"], (90.0, 92.4), strict=True):  # of the masses
        assert axis["plant_zero_hz"] == pytest.approx(10.05, abs=0.15)
        assert axis["plant_pole_hz"] == pytest.approx(pole_hz, rel=0.01)
    model = read_parameter_file(tmp_path / "out" / "model.yaml")["/**"]
    assert len(model["specimen.stiffness"]) == 4
    assert len(model["actuator.oil_stiffness"]) == 2


def test_a_load_that_hung_on_the_load_cell_tells_its_scale(identify, tmp_path):
    wrong = ("rig:simulated.sensors.force_scale:=1.03",)
    words = (*BRIEF, "--specimen", "--known-force", "1000", "1030", "--out", "out")
    status, found, _ = identify(*words, overrides=wrong)
    assert status == 0
    assert found["specimen"]["mass"] == pytest.approx(52.7, rel=3e-3)
    assert not any("1 % of it costs" in note for note in found["notes"])
    model = read_parameter_file(tmp_path / "out" / "model.yaml")["/**"]
    assert model["calibration.force_scale"] == [1.03]
    assert model["calibration.force_scale_error"] == [3.0 / 1030.0]  # the noise of one reading


def test_a_mass_that_is_known_tells_the_scale_of_the_load_cell(once_more):
    folder, again = once_more
    shutil.rmtree(folder / "closed_loop")  # of the calibration that was found
    status, found, _ = again("--known-mass", "51.2")
    assert (status, len(found["reused"])) == (0, 4)
    scale = found["multisine"]["axes"][0]["force"]["scale"]
    assert scale["value"] == pytest.approx(52.7 / 51.2, abs=3e-3)
    assert found["multisine"]["mass"] == pytest.approx(51.2, rel=1e-9)


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (("--known-mass", "52.7"), "--known-mass is that of the multisine test: give"),
        (("--specimen", "--known-mass", "0"), "must be positive, once for each of the axes x"),
        (("--known-force", "1000", "1030"), "--known-force is that of the multisine test: give"),
        (
            ("--specimen", "--known-force", "1000", "-1030"),
            "load cell must show a load of the same",
        ),
    ],
)
def test_a_mass_or_load_that_makes_no_sense_is_one_line(identify, words, why):
    status, found, line = identify(*words)
    assert (status, found) == (2, None)
    assert why in line


@pytest.mark.parametrize(
    ("test", "words", "overrides"),
    [
        ("open_loop", ("--amplitude", "0.3"), ["limits.acceleration:=5.0"]),
        # of an accelerometer that shows more than the plan of the multisine test knows
        (
            "multisine_pilot",
            ("--amplitude", "0.06", "--specimen"),
            ["limits.acceleration:=35.0", "rig:simulated.sensors.acceleration_scale:=3.0"],
        ),
    ],
)
def test_a_trip_ends_it_in_one_line_and_keeps_all_known(identify, tmp_path, test, words, overrides):
    status, found, line = identify(*words, *SHORT, "--out", "out", overrides=overrides)
    assert status == 1
    assert line.startswith(f"seft: {test.replace('_', ' ')} tripped at ")
    assert "acceleration" in line
    assert found["tripped"][test].startswith("acceleration")
    assert found["tripped"]["closed_loop"] is None
    assert read_bag(tmp_path / "out" / test).trip is not None
    assert not (tmp_path / "out" / "closed_loop").exists()
    model = tmp_path / "out" / "model.yaml"
    known = model.exists() and "flow_gain" in model.read_text()
    assert known is ("plant_zero_hz" in found) is (test == "multisine_pilot")


def test_of_an_open_loop_what_is_before_its_trip_or_its_pilot_counts(identify, monkeypatch):
    late = ("--amplitude", "0.2", "--duration", "20", "--out", "late")
    overrides = ["rig:faults:=displacement scale 100 at 16.0"]
    status, found, _ = identify(*late, overrides=overrides)
    assert (status, found["tripped"]["open_loop"][:12]) == (1, "measured dis")
    assert found["notes"][-1] == "open loop: evaluated from what it measured before its trip"
    assert found["actuator"]["flow_gain_m_per_s_per_v"] == pytest.approx(0.0403, rel=0.01)

    monkeypatch.setattr(rig_tests, "voltage_after", lambda *_: 0.5)
    status, found, _ = identify(*SHORT, "--out", "at_once", overrides=["limits.velocity:=0.04"])
    assert (status, found["tripped"]["open_loop"][:8]) == (1, "velocity")
    assert found["notes"][-1] == "open loop: evaluated from its pilot"
    written = read_parameter_file("at_once/model.yaml")["/**"]
    assert written["actuator.flow_gain"] == [pytest.approx(0.0403, rel=0.01)]


def contents(folder):
    """Files of a folder, and when each was written."""
    return {path: path.stat().st_mtime_ns for path in folder.rglob("*")}


@pytest.fixture
def once_more(linear, identify, tmp_path):
    """A copy of the linear rig's folder, and its command once more."""
    folder = shutil.copytree(linear[0], tmp_path / "out")
    words = (*SHORT, "--specimen", "--out", "out")
    return folder, lambda *more, **own: identify(*words, *more, **({"overrides": LINEAR} | own))


def leaves(found, at=""):
    """Paths and values of a result."""
    if not isinstance(found, dict | list):
        yield at, found
        return
    for key, below in found.items() if isinstance(found, dict) else enumerate(found):
        yield from leaves(below, f"{at}/{key}")


def alike(one, other):
    """Say whether two results are the same but for LAPACK's last digits."""
    near = {path: pytest.approx(x) if isinstance(x, float) else x for path, x in leaves(other)}
    return dict(leaves(one)) == near


def test_an_interrupted_identification_continues_where_it_was(once_more, linear, monkeypatch):
    (folder, again), (whole, known) = once_more, linear
    shutil.rmtree(folder / "closed_loop")
    (folder / "model.yaml").unlink()
    with monkeypatch.context() as patch:
        patch.setattr(shared, "offline_test", Mock(side_effect=KeyboardInterrupt))
        status, _, line = again()
    assert (status, line) == (
        1,
        "seft: interrupted; the same command with --out out continues, out has the excitation, "
        "out/pilot is whole, out/open_loop is whole, out/multisine_pilot is whole, "
        "out/multisine is whole",
    )
    status, found, _ = again()
    assert (status, found["reused"]) == (0, ["pilot", "open_loop", "multisine_pilot", "multisine"])
    own = {"files": 0, "reused": 0}
    assert alike(found | own, known | own)
    assert alike(*(read_parameter_file(path / "model.yaml") for path in (folder, whole)))


@pytest.mark.parametrize(
    ("words", "overrides", "message"),
    [
        (("--seed", "2"), [], "out/excitation.csv: is of another rate, .* --seed"),
        ((), ["axes:=[y]"], r"out/pilot: is of another test: /\*\*: axes was \['x'\], and is"),
        ((), ["limits.velocity:=0.4"], "limits.velocity was 0.5, and is 0.4; name another folder"),
        ((), ["rig:seed:=9"], "out/pilot: is of another test: rig: seed was 1, and is 9"),
        (("--amplitude", "0.1"), [], "out/open_loop: is of another test: force_controller: "),
        (("--travel", "1e-4"), [], "out/multisine_pilot: is of another .* had other commands"),
        (("--out", "."), [], ".: exists already; name another folder"),
    ],
)
def test_recordings_of_another_test_are_refused_and_stay(once_more, words, overrides, message):
    folder, again = once_more
    before = contents(folder)
    status, found, line = again(*words, overrides=(*LINEAR, *overrides))
    assert (status, found) == (2, None)
    assert re.search(message, line)
    assert contents(folder) == before


def test_after_a_trip_the_same_command_goes_on_beside_what_it_left(identify, tmp_path):
    words, overrides = (*BRIEF, "--out", "out"), ["limits.velocity:=0.05"]
    status, found, line = identify(*words, overrides=overrides)
    assert status == 1
    assert line.endswith("its bag is in out/closed_loop; the same command with --out out continues")
    moved = found["moved_m"]["x"]
    status, found, _ = identify(*words, "--force", "40", overrides=overrides)
    assert (status, found["reused"]) == (0, ["open_loop"])
    assert found["files"]["closed_loop"] == "out/closed_loop_2"
    assert read_bag("out/closed_loop").trip is not None
    assert found["bandwidth_hz"] and "actuator.delay" in (tmp_path / "out/model.yaml").read_text()
    assert found["moved_m"]["x"] == moved  # in all tests
    after = read_bag("out/closed_loop_2").states.values
    assert moved > np.abs(after[:, 0]).max()
    status, _, line = identify(*words, "--force", "50", overrides=overrides)
    assert status == 2
    assert "out/closed_loop_2: is of another test: ground_motion: influence was [40.0]" in line


def test_no_test_moves_the_specimen_farther_than_half_of_the_cap(identify):
    """Also where flow gain and stiffness are not known."""
    unknown = ("actuator.flow_gain:=0.0", "specimen.stiffness:=2.1e+6")
    true = ("rig:simulated.actuator.flow_gain:=0.0403", "rig:simulated.specimen.stiffness:=2.11e+5")
    cap, overrides = 3e-4, (*unknown, *true)
    words = (*SHORT, "--specimen", "--max-displacement", str(cap), "--out", "out")
    status, found, _ = identify(*words, overrides=overrides)
    assert status == 0
    tests = [read_bag(f"out/{name}") for name in found["tripped"]]
    values = np.concatenate([test.states.values[:, :, 0] for test in tests])
    assert found["moved_m"]["x"] == np.abs(values[:, 0]).max() < 0.55 * cap
    assert found["largest_force_n"]["x"] == np.abs(values[:, 3]).max()
    assert tests[0].experiment["rig"]["limits.displacement"] == cap
    assert found["actuator"]["flow_gain_m_per_s_per_v"] == pytest.approx(0.0403, rel=0.02)
    multisine = found["multisine"]
    assert multisine["mass"] == pytest.approx(52.7, abs=4 * multisine["mass_error"])


def test_of_a_loop_that_is_unstable_the_plant_is_identified_all_the_same(identify):
    overrides = (*LINEAR, "force_controller:numerator:=200.0")
    status, found, line = identify(*BRIEF, "--out", "out", overrides=overrides)
    assert status == 1
    assert "closed loop" in line
    assert found["plant_zero_hz"] == pytest.approx(10.07, rel=0.01)
    assert found["delay_s"] is None


def test_too_little_amplitude_is_reported_with_band_and_remedy(identify, tmp_path):
    status, found, line = identify("--amplitude", "3e-4", "--duration", "14", "--out", "out")
    assert status == 1
    assert line.startswith("seft: open loop: coherence of the force on axis x is below 0.5")
    assert "Hz" in line
    assert line.endswith("raise --amplitude or --duration")
    assert found["plant_zero_hz"] is None
    assert found["delay_s"] is not None
    written = read_parameter_file(tmp_path / "out" / "model.yaml")["/**"]
    assert "actuator.delay" in written and "actuator.flow_gain" not in written
