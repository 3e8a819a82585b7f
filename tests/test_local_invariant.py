"""Offline = lockstep = realtime, bit for bit, in virtual time, for all kinds of loops."""

import json

import pytest
from graph_tools import JHU
from local_tools import TARGET_MOTION, TWO_AXES, UNREHEARSED, assert_same, offline, perform

SHORT = ("ground_motion:synthetic.duration:=3.0", "ground_motion:tail:=0.2")
FAULTS = (
    'rig:faults:=["force noise 2 at 0.5", "force add 20 at 1.0 for 1", "velocity scale 0.99 at 0", '
    '"displacement late 0.0003 at 0", "valve hysteresis 0.05 at 0.5", "valve null 0.01 at 1", '
    '"supply scale 0.8 at 1", "specimen slip 1e-5 at 1", "specimen break 0.98 at 1.2", '
    '"specimen collide 1e3 at 0.9"]'
)
EXPERIMENTS = {
    "servo_hydraulic": ("reference_force:mass_ratio:=0.5",),
    "restoring": (
        "reference_force:mass_ratio:=0.5",
        "reference_force:compensation.method:=restoring",
    ),
    "delay": (
        *("rig:actuator.kind:=delay", "rig:actuator.delay:=0.0113"),
        "reference_force:mass_ratio:=0.5",
    ),
    "eft_ideal": ("rig:actuator.kind:=ideal", "reference_force:method:=eft"),
    "coupled_axes": (
        *TWO_AXES,
        "rig:specimen.stiffness:=[2.0e5, -1.0e4, -1.0e4, 2.2e5]",
        "rig:specimen.mass:=[52.7, 55.0]",
        "reference_force:mass_ratio:=0.3",
    ),
    "loop_delay_of_an_idealised_actuator": (
        *("rig:actuator.kind:=delay", "rig:actuator.delay:=0.0113"),
        *("reference_force:loop_delay:=5", "reference_force:mass_ratio:=0.3"),
        "reference_force:compensation.method:=model",
        "reference_force:compensation.delay:=0.0143",
    ),
    "method_of_another_package": (
        "reference_force:mass_ratio:=0.2",
        "reference_force:compensation.method:=polynomial",
        "reference_force:compensation.delay:=0.0139",
    ),
    "target_motion": TARGET_MOTION,
    "target_motion_of_two_axes": (*TARGET_MOTION, *TWO_AXES),
    "target_motion_behind_a_link": (
        *TARGET_MOTION,
        *TWO_AXES,
        "reference_force:loop_delay:=7",
    ),
    "target_motion_of_an_idealised_actuator": (
        *TARGET_MOTION,
        "force_controller:method:=transfer_function",
        *("rig:actuator.kind:=delay", "rig:actuator.delay:=0.005"),
        *("reference_force:loop_delay:=2", "reference_force:compensation.delay:=0.008"),
    ),
    "target_motion_yielding": (
        *TARGET_MOTION,
        *("rig:specimen.kind:=bilinear", "rig:specimen.yield_displacement:=0.001"),
    ),
    "faults": (*TARGET_MOTION, FAULTS),
}


@pytest.mark.parametrize("name", EXPERIMENTS)
def test_lockstep_and_realtime_give_the_bits_of_the_offline_loop(local_graph, name):
    record = None
    for pace in ("lockstep", "realtime"):
        words = (*SHORT, UNREHEARSED, *EXPERIMENTS[name], f"rig:pace:={pace}")
        with local_graph(*words, config=JHU) as graph:
            perform(graph)
            record = record or offline(graph)
            assert len(record.series["rig/state"].steps) == 851
            assert_same(graph, record)
            assert graph.status("rig")["missed"] == "0"
            assert json.loads(graph.status("rig")["simulated"]) == vars(record.simulated)
