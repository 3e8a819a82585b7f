"""The compiled loop gives the bits of the plain one, alone and in an ensemble.

Of all laws of specimens, which both call, and of what is drawn: test_local_drawn.py.
"""

from collections import Counter

import experiments_at_hand
import pytest
from recordings_at_hand import assert_same_samples
from seft_plant_sim import compiled as machine_code
from seft_ros.force_controller.force_control import ControlInputs
from seft_ros.force_controller.interlock import Interlock
from seft_ros.force_controller.methods import RegisteredControl
from seft_ros.test_run import blocks, offline
from seft_ros.test_run.blocks import build_blocks
from seft_ros.test_run.compiled_loop import why_not_compiled
from seft_ros.test_run.offline import BlockCache, simulate_test

SHORT = ("ground_motion:synthetic.duration:=12", "ground_motion:tail:=0.5")
FINE = ("/**:sensors.adc_bits:=0",)  # no converter, which would hide small differences

RATIO = "reference_force:mass_ratio:={}".format
METHOD = "reference_force:compensation.method:={}".format
DELAY = "/**:actuator.delay:=0.0109"
WEAK = "ground_motion:peak_force:=400.0"
STRONG = "ground_motion:peak_force:=4000.0"
YIELDS = "rig:simulated.specimen.yield_displacement:=0.002"
TWO = (
    "/**:axes:=[x, y]",
    "/**:specimen.stiffness:=[2.11e5, -3.0e4, -3.0e4, 1.8e5]",
    "rig:simulated.actuator.flow_gain:=[0.0403, 0.035]",
    "ground_motion:influence:=[1.0, 0.6]",
)
TARGET = (
    METHOD("target_motion"),
    "force_controller:method:=velocity_feedforward",
    RATIO(1.0),
    WEAK,
)
WATER = (  # which sloshes in a tank on the first axis
    "reference_force:computed.internal:=1",
    "reference_force:computed.mass:=[35.0, 35.0, 25.0]",
    "reference_force:computed.stiffness:="
    "[1421.2, 0.0, -1421.2, 0.0, 0.0, 0.0, -1421.2, 0.0, 1421.2]",
)
FAULTS = (
    'rig:faults:=["force noise 3 at 1", "force set 300 at 2.5 for 1", "velocity late 0.001 at 1", '
    '"acceleration lowpass 200 at 2", "valve hysteresis 0.1 at 0.5", "valve null 0.01 at 2", '
    '"supply scale 0.8 at 1", "specimen slip 1e-5 at 1", "specimen break 0.98 at 1.2", '
    '"specimen collide 1e3 at 0.9"]'
)
CASES = {  # few combinations of blocks: a loop is compiled for each
    "nonlinear": (),
    "target": TARGET,
    "target, limited": (*TARGET, "/**:limits.force:=300.0"),
    "target, link": (*TARGET, "/**:loop_delay:=4"),
    "target, suspect samples": (  # while they are, the controller follows the plan to its end
        *TARGET,
        "/**:rate:=250.0",
        "/**:sensors.adc_bits:=12",
        "ground_motion:synthetic.duration:=30.0",
        "ground_motion:peak_force:=500.0",
    ),
    "link": (RATIO(0.1), "/**:loop_delay:=4"),
    "delay": ("/**:actuator.kind:=delay", "/**:actuator.delay:=0.0103", RATIO(0.5)),
    "ideal": ("/**:actuator.kind:=ideal", RATIO(0.5), METHOD("restoring")),
    "model": (METHOD("model"), DELAY, RATIO(1.0), WEAK),
    "derived and filtered": (
        "/**:sensors.velocity:=derived", "rig:simulated.sensors.force_filter:=200.0",
        "rig:simulated.sensors.force_bias:=5.0",
    ),
    "eft": ("reference_force:method:=eft", "ground_motion:peak_force:=300.0"),
    "open loop": ("force_controller:feedback:=false",),
    "saturated valve": (STRONG, "rig:simulated.actuator.rated_voltage:=2.0"),
    "end stops": ("rig:simulated.actuator.stroke:=0.002", "/**:limits.displacement_rate:=30.0"),
    # ends
    "displacement": ("/**:limits.displacement:=0.003",),
    "rate": ("/**:limits.acceleration_rate:=900.0",),
    "rates at 1000 Hz": (
        "/**:rate:=1000.0",
        "/**:limits.acceleration_rate:=900.0",
        "/**:limits.force_rate:=1e5",
    ),
    "blind": (  # the judge would end it before
        "/**:sensors.acceleration_range:=5.0",
        "rig:detectors.warn_only:=all",
    ),
    "unstable": (RATIO(2.0),),
    "force": ("/**:limits.force:=600.0",),
    "force rate": ("/**:limits.force_rate:=2e4",),
    "valve at its limit": ("/**:limits.command:=0.05",),
}  # fmt: skip
MORE = {
    "two axes, linear, mixed": (
        *TWO,
        "/**:actuator.kind:=servo_hydraulic_linear",
        RATIO(0.3),
        "force_controller:per_axis:=true",
        "force_controller:numerator:=[37.0, 30.0]",
        "force_controller:gain:=[1.0, 0.05, 0.0, 1.1]",
        "force_controller:denominator:=[1.0, 17.14, 4002.0, 1.0, 16.0, 3600.0]",
    ),
    "faults of two axes": (*TWO, *TARGET, FAULTS.replace('"force noise', '"y/force noise')),
    "target, two axes, yielding, sloshing water": (
        *TWO,
        *TARGET,
        *WATER,
        "rig:simulated.specimen.kind:=bouc_wen",
        "rig:simulated.specimen.springs:=[1.0, 0.0, 0.0, 1.0, 1.0, -1.0]",
        YIELDS,
    ),
}
"""Loops of their own, each of which takes longer to compile than all of the others to run."""


def load(*words):
    return experiments_at_hand.load(*SHORT, *words)


def alike(found, wanted):
    assert found.trip == wanted.trip
    assert found.saturation == wanted.saturation
    assert found.simulated == wanted.simulated
    assert_same_samples(found, wanted)


def plain(monkeypatch, experiment):
    with monkeypatch.context() as patch:
        patch.setattr(offline, "why_not_compiled", lambda _: "asked to")
        return experiments_at_hand.simulated(experiment)


THOROUGH = pytest.mark.thorough, pytest.mark.offline


@pytest.mark.parametrize("name", [*CASES, *(pytest.param(name, marks=THOROUGH) for name in MORE)])
def test_a_test_is_that_of_the_plain_loop(name, monkeypatch):
    experiment = load(*FINE, *(CASES | MORE)[name])
    assert why_not_compiled(build_blocks(experiment)) == ""
    alike(BlockCache().run(experiment), plain(monkeypatch, experiment))


def test_the_loop_is_compiled_where_that_pays(monkeypatch, tmp_path):
    def run(words, **options):
        simulate_test(experiment := load(*words), build_blocks(experiment), **options)
        return len(compiled)

    compiled = []
    first = offline.run_compiled
    monkeypatch.setattr(offline, "run_compiled", lambda *words: compiled.append(1) or first(*words))
    monkeypatch.setattr(offline, "_run_so_far", Counter())
    at_hand = offline.is_compiled
    monkeypatch.setattr(offline, "is_compiled", lambda *_: False)
    steps = len(build_blocks(load()).ground_motion.samples)
    monkeypatch.setattr(offline, "PLAIN_STEPS", 2 * steps)
    assert [run(CASES["force"]) for _ in range(3)] == [0, 0, 1]
    assert run(CASES["target"]) == 1  # of another kind
    assert run(CASES["target"], compiles=True) == 2
    monkeypatch.setattr(offline, "PLAIN_STEPS", 99 * steps)
    monkeypatch.setattr(offline, "is_compiled", at_hand)
    assert run(CASES["target"]) == 3
    monkeypatch.setattr(machine_code, "_entry_points", {})
    assert run(CASES["target"]) == 4  # it is on the disk
    monkeypatch.setattr(machine_code, "_entry_points", {})
    monkeypatch.setattr(machine_code, "code_folder", lambda _: tmp_path)
    assert run(CASES["target"]) == 4


def test_the_cases_end_in_every_way():
    shop = BlockCache()
    reasons = [trip.reason for words in CASES.values() if (trip := shop.run(load(*words)).trip)]
    for part in (
        "displacement", "acceleration rate", "unknown", "instability", "reference force changes",
        "reference force", "out of control", "valve command is at its limit",
    ):  # fmt: skip
        assert any(part in reason for reason in reasons), part


def test_tests_of_one_workshop_are_those_of_workshops_of_their_own():
    names = "force", "nonlinear", "target, limited", "target", "blind", "force rate", "delay"
    shop = BlockCache()
    for name in (*names, *reversed(names)):  # what ends in a trip comes before what must not
        experiment = load(*CASES[name])
        alike(shop.run(experiment), BlockCache().run(experiment))


def test_a_controller_of_another_package_is_not_compiled(monkeypatch):
    class Own:
        def reset(self):
            pass

        def step(self, reference_force, state):
            return 0.001 * (reference_force - state[3])

    def interlock_of(experiment):
        axes, timebase = experiment.axes, experiment.timebase
        own = RegisteredControl(Own, "own", ControlInputs(len(axes), timebase.dt, 10.0))
        made = Interlock.from_parameters(experiment["force_controller"], axes, timebase)
        made.controller = own
        return made

    monkeypatch.setattr(blocks, "interlock_of", interlock_of)
    assert "another package" in BlockCache().why_not_compiled(load())
