"""A computed model takes part in tests: the same bits in nodes, near the whole structure, safe."""

import json
import subprocess
import sys

import numpy as np
import pytest
from experiments_at_hand import error_of, load, simulated
from graph_tools import DEMO, ROOT
from local_tools import UNREHEARSED, assert_same, begin, offline, perform
from models_at_hand import MODELS
from seft_ros.analysis.metrics import nrmse
from seft_ros.design import preflight_tables
from seft_ros.design.planned_tests import PlannedTest
from seft_ros.design.stability_verdict import predicted_modes
from seft_ros.protection.protected_force import ProtectedForce
from seft_ros.test_run.blocks import build_blocks
from seft_ros.test_run.offline import simulate_test

THOROUGH = (pytest.mark.thorough, pytest.mark.offline)
SHORT = ("-p", "ground_motion:synthetic.duration:=5.0", "-p", "ground_motion:tail:=0.5")
YIELDS = "rig:simulated.specimen.yield_displacement:=0.004"
BILINEAR = ("rig:simulated.specimen.kind:=bilinear", YIELDS)


@pytest.fixture
def model(tmp_path):
    """Give the options for a class of the file."""
    (tmp_path / "models.py").write_text(MODELS)
    return lambda name: ("-p", f"reference_force:computed.model:={tmp_path}/models.py:{name}")


def example(name, *settings):
    """Give a shipped example, whose script is found wherever this runs."""
    script = ROOT / "config" / "models" / f"{name}.py"
    words = " ".join([f"script={script}", *settings])
    config = ROOT / "config" / f"computed_{name}.yaml"
    return config, "-p", f"reference_force:computed.settings:={words}"


@pytest.fixture
def refused(seft):
    """Give the line with which `seft run` refuses a test before it starts anything."""
    return lambda *words: seft("run", *words, status=2).stderr.strip().splitlines()[-1]


def bare(words):
    """Overrides without the options' name."""
    return [word for word in words if word not in ("-p", DEMO)]


def test_a_model_gives_the_bits_of_the_offline_loop_in_its_node_near_the_whole(local_graph, model):
    graph = local_graph(*bare([*SHORT, *model("Damper")]), UNREHEARSED, config=DEMO)
    perform(graph)
    recording = offline(graph)
    assert_same(graph, recording)
    assert error_of(recording) < 0.01


def test_a_model_that_fails_brings_the_test_down_softly_and_says_where(seft, refused, model):
    """Of all ways in which a model fails, see test_model_process.py."""
    words, text = ((DEMO, *SHORT, *model("Breaking")), "models.py:Breaking line 89, step: it broke")
    offline = seft("simulate", *words, "--json", status=1)
    found = json.loads(offline.stdout)
    assert text in found["trip"]["reason"]
    assert found["steps"] > 750 + 250  # it ramped down
    assert text in offline.stderr.strip().splitlines()[-1]
    assert text in refused(*words)


def test_a_model_takes_every_second_sample(model):
    words = bare([*SHORT, *model("Damper"), "-p", "reference_force:computed.every:=2"])
    assert error_of(simulated(load(*words, config="demo"))) < 0.05


def test_a_model_that_becomes_slow_in_a_test_trips_it(local_graph, model, monkeypatch):
    graph = local_graph(*bare([*SHORT, *model("Spring")]), UNREHEARSED, config=DEMO)
    ask = ProtectedForce.ask_model

    def slow(block):
        graph.graph.clock.sleep(0.051)
        ask(block)

    begin(graph)
    graph.run(0.2)
    monkeypatch.setattr(ProtectedForce, "ask_model", slow)
    graph.until("tripped")
    assert "models.py:Spring took 0.051 s for a step" in graph.values["detail"]


def test_a_model_that_is_slow_is_refused_with_a_rate_that_fits(
    seft_json, refused, model, monkeypatch
):
    words = (DEMO, *SHORT, *model("Spring"))
    times = [4.1e-3] * 1501
    monkeypatch.setattr(preflight_tables, "model_times", lambda *_: times)
    found = seft_json("preflight", *words, status=1)["model"]
    assert found["median_s"] == 4.1e-3 and not found["fits"]
    assert (found["fitting_rate_hz"], found["fitting_every"]) == (125, 4)
    times[:] = [1e-4] * 1501  # but one, at which the test would trip
    times[151] = 0.21
    message = refused(*words)
    assert "takes 0.21 s for the step at 0.302 s, at which the test would trip" in message
    assert "a watchdog allows 0.05 s (rig: watchdog.command_timeout, at most 0.05)" in message
    times[151] = 0.04
    watchdog = ("-p", "rig:watchdog.command_timeout:=0.03")
    assert "a watchdog allows 0.03 s" in refused(*words, *watchdog)


def test_only_a_target_takes_a_model(seft, model):
    words = ("-p", "reference_force:compensation.method:=restoring", *model("Spring"))
    control = ("-p", "force_controller:method:=transfer_function")
    (line,) = seft("simulate", DEMO, *words, *control, status=2).stderr.strip().splitlines()
    assert "restoring does not compute; make that target_motion" in line
    eft = ("-p", "reference_force:method:=eft", *model("Spring"))
    (line,) = seft("simulate", DEMO, *eft, status=2).stderr.strip().splitlines()
    assert "with method eft nothing is computed" in line


def test_a_plan_has_all_modes_of_a_model_with_a_mass_of_its_own(model):
    found = predicted_modes(PlannedTest(load(*bare(model("Damper")), config="demo")))
    pairs = ((800.3, 80.0), (2.11e5, 11000.0))
    c, k = (np.array([[own + part, -part], [-part, part]]) for own, part in pairs)
    m = np.diag([2.5 * 52.7, 8.0])
    a = np.block([[np.zeros((2, 2)), np.eye(2)], [-np.linalg.solve(m, k), -np.linalg.solve(m, c)]])
    poles = sorted((pole for pole in np.linalg.eigvals(a) if pole.imag > 0), key=abs)
    assert [mode.exact_hz for mode in found] == pytest.approx(
        [abs(pole) / (2 * np.pi) for pole in poles], rel=1e-3
    )
    assert [mode.exact_damping for mode in found] == pytest.approx(
        [-pole.real / abs(pole) for pole in poles], rel=1e-2
    )
    assert {mode.hz for mode in found} == {None}


# ---- OpenSees


@pytest.fixture
def opensees():
    """Skip where it is not installed."""
    pytest.importorskip("openseespy", reason="OpenSeesPy is not installed")


OTHERS = [
    (name, foundation, kind, seed, 24.0)
    for name, foundation in (("frame", 0.0), ("damper", 0.0), ("soil", 150.0))
    for kind, seed in (("linear", 2), ("bilinear", 3))
]
WHOLE = """
import json, sys
import numpy as np
import openseespy.opensees as ops
from seft_plant_sim.computed import opensees

script, kind, total, foundation, file = sys.argv[1:]
total, foundation, (motion, dt) = float(total), float(foundation), json.load(open(file))
opensees._runs_script = True
try:
    exec(compile(open(script).read(), script, "exec"), {"__name__": "__main__"})
except opensees._InterfaceReached as reached:
    nodes = [place[0] for place in reached.args[0][0]]
first, size = nodes[0], len(ops.nodeDisp(nodes[0]))
rest = [0.0] * (size - 1)
for node in nodes[1:]:
    ops.equalDOF(first, node, 1)
ops.node(990, *ops.nodeCoord(first))
if kind == "linear":
    ops.uniaxialMaterial("Elastic", 990, 2.11e5)
else:
    ops.uniaxialMaterial("Steel01", 990, 0.004 * 2.11e5, 2.11e5, 0.05)
ops.uniaxialMaterial("Viscous", 991, 800.3, 1.0)
bottom, top = 990, first
if foundation:  # the specimen stands on the interface
    bottom, top = first, 990
    ops.mass(first, foundation, *rest)
else:
    ops.fix(990, *[1] * size)
ops.mass(top, total, *rest)
ops.element("zeroLength", 990, bottom, top, "-mat", 990, "-dir", 1)
ops.element("zeroLength", 991, bottom, top, "-mat", 991, "-dir", 1)
fine = np.interp(np.arange(4 * len(motion)) / 4, np.arange(len(motion)), motion)
ops.timeSeries("Path", 990, "-dt", dt / 4, "-values", *fine.tolist())
ops.pattern("UniformExcitation", 990, 1, "-accel", 990)
ops.constraints("Transformation")
ops.numberer("RCM")
ops.system("BandGeneral")
ops.test("NormDispIncr", 1e-10, 50)
ops.algorithm("Newton")
ops.integrator("Newmark", 0.5, 0.25)
ops.analysis("Transient")
found = [0.0]
for _ in motion[1:]:
    assert ops.analyze(4, dt / 4) == 0
    found.append(ops.nodeDisp(top, 1) - ops.nodeDisp(bottom, 1))
json.dump(found, open(file, "w"))
"""
"""OpenSees's own solution of a whole structure, whose specimen is a material of its own."""


def own_solution(script, kind, foundation, motion, dt, folder):
    file = folder / "motion.json"
    file.write_text(json.dumps([motion, dt]))
    words = [sys.executable, "-c", WHOLE, script, kind, "131.75", str(foundation), file]
    subprocess.run(words, check=True, capture_output=True)
    return json.loads(file.read_text())


@pytest.mark.usefixtures("opensees")
@pytest.mark.parametrize(
    ("name", "foundation", "kind", "seed", "seconds"),
    [("frame", 0.0, "bilinear", 1, 5.0), *(pytest.param(*case, marks=THOROUGH) for case in OTHERS)],
)
def test_an_example_is_near_what_opensees_solves(tmp_path, name, foundation, kind, seed, seconds):
    config, _, script = example(name)
    overrides = [script, f"ground_motion:synthetic.seed:={seed}"]
    overrides.append(f"ground_motion:synthetic.duration:={seconds}")
    overrides += BILINEAR if kind == "bilinear" else ()
    experiment = load(*overrides, config=config.stem)
    blocks = build_blocks(experiment)
    recording = simulate_test(experiment, blocks)
    assert recording.trip is None
    motion, dt = blocks.ground_motion.samples[:, 0].tolist(), experiment.timebase.dt
    path = ROOT / "config" / "models" / f"{name}.py"
    exact = np.array(own_solution(path, kind, foundation, motion, dt, tmp_path))
    error = nrmse(recording.series["rig/state"].values[:, 0, 0], exact)
    assert error < (0.015 if kind == "linear" else 0.03)


PORTAL = """
# after "Cantilever" of the OpenSees examples manual: one column, a mass on top, an earthquake
from openseespy.opensees import *

wipe()
model("basic", "-ndm", 2, "-ndf", 3)
node(1, 0.0, 0.0)
node(2, 0.0, 1.0)
fix(1, 1, 1, 1)
mass(2, 20.0, 0.0, 0.0)
geomTransf("Linear", 1)
element("elasticBeamColumn", 1, 1, 2, 1.0e-3, 2.0e11, 8.0e-8, 1)
{interface}
# gravity, earthquake and analysis of its own: not run in a test
timeSeries("Path", 2, "-dt", 0.01, "-filePath", "no_such_record.g3", "-factor", 9.81)
pattern("UniformExcitation", 2, 1, "-accel", 2)
constraints("Transformation")
analysis("Transient")
analyze(1000, 0.02)
raise RuntimeError("this must not be reached")
"""


@pytest.mark.usefixtures("opensees")
def test_a_script_needs_no_more_than_the_interface_s_lines(seft, seft_json, tmp_path):
    lines = "from seft_plant_sim.computed.opensees import interface\ninterface((1, 1))"
    (tmp_path / "cantilever.py").write_text(PORTAL.format(interface=lines))
    words = ("-p", "reference_force:computed.model:=opensees")
    words = (*words, "-p", "reference_force:computed.settings:=script=cantilever.py")
    summary = seft_json("simulate", DEMO, *SHORT, *words)
    assert summary["displacement"]["nrmse"] < 0.01

    def message(text):
        (tmp_path / "cantilever.py").write_text(text)
        (line,) = seft("simulate", DEMO, *words, status=2).stderr.strip().splitlines()
        return line

    massive = PORTAL.replace("fix(1", "mass(1, 5.0, 5.0, 0.0)\nfix(1").format(interface=lines)
    assert "node 1 has a mass of 5 kg in direction 1" in message(massive)
    assert "cantilever.py line 5: " in message("\n\n\n\nwrong = 1 / 0\n")
    assert "the script has no line interface(...)" in message("import openseespy.opensees\n")
