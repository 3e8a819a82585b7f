"""The compiled step: the same bits alone and in a loop, and the laws in the rig."""

import itertools

import numpy as np
import pytest
from seft_msgs_py.config.experiment import Experiment
from seft_plant_sim.compiled import compiled
from seft_plant_sim.rig import Rig, saturation_of
from seft_plant_sim.rig_parameters import RIG_TABLE
from seft_plant_sim.rig_step import rig_step

JHU = "config/jhu.yaml"
YIELDS = {"yield_displacement": 0.003}
KINDS = {
    "linear": {},
    "bilinear": YIELDS,
    "bouc_wen": YIELDS | {"bouc_wen.exponent": 1.5, "bouc_wen.strength_loss": 0.02},
    "pinching": YIELDS,
    "flag": YIELDS,
    "friction": {"friction.force": 150.0},
    "gap": {"gap.width": 0.003, "gap.stiffness": 8e5},
    "duffing": {"duffing.cubic": 4e9},
}
FILTERED = {"sensors.anti_alias": 200.0, "sensors.velocity": "derived"}
FAULTS = [
    *(
        "force set 500 at 0.2 for 3",
        "acceleration noise 0.5 at 0.3",
        "x/velocity late 0.005 at 0.3",
    ),
    *("displacement freeze at 0.5 for 9", "force bit 9 at 0.4", "force lowpass 30 at 0.6"),
    *("valve hysteresis 0.5 at 0.1", "valve null 0.3 at 0.2", "valve late 0.004 at 0.7 for 20"),
    *("supply scale 0.7 at 0.3 for 200", "specimen break 0.5 at 0.5", "specimen slip 1e-3 at 0.4"),
    *("specimen collide 1e5 at 0.6", "x/specimen slip 1e-4 at 0.7 for 9"),
    *("x/valve stick at 0.9 for 10", "velocity noise 0.01 at 0.3 for 50"),
]
RIGS = [
    *(
        {"specimen.kind": k} | {f"specimen.{n}": v for n, v in own.items()}
        for k, own in KINDS.items()
    ),
    {"actuator.kind": "ideal"},
    {"actuator.kind": "delay", "actuator.delay": 0.0113},
    {"actuator.kind": "servo_hydraulic_linear", "actuator.dead_time": 0.0037},
    {"sensors.acceleration_range": 5.0, "limits.saturated_time": 0.1} | FILTERED,
    {"specimen.kind": "bouc_wen", "specimen.yield_displacement": 0.003, "faults": FAULTS},
    {"faults": FAULTS},
]


@compiled
def run(parameters, state, commands, noise, states, found):
    """Take all steps of a rig."""
    for step in range(len(noise)):
        command = commands[max(step - 1, 0)]
        found[step] = rig_step(parameters, state, step, command, noise[step], states[step])


def rig(values, axes=("x",), rate=500.0):
    overrides = [("rig", name, value) for name, value in values.items()]
    overrides += [("/**", "axes", list(axes)), ("/**", "rate", rate)]
    experiment = Experiment.load([RIG_TABLE], [JHU], overrides, nodes=["rig"])
    return experiment, Rig.from_parameters(experiment["rig"], axes, experiment.timebase)


@pytest.mark.parametrize(
    ("values", "axes"), [*((v, "x") for v in RIGS), *((RIGS[i], "xy") for i in (2, -2, -1))]
)
def test_a_rig_alone_and_in_a_compiled_loop_gives_the_same_bits(values, axes):
    steps, (_, one) = 600, rig(values, tuple(axes))
    amplitude = 400.0 if one.drive == "reference_force" else 4.0
    time = 0.002 * np.arange(steps)[:, np.newaxis] + np.arange(len(axes))
    commands = amplitude * np.sin(2 * np.pi * 6.0 * time)
    states, found = np.empty((steps, 4, len(axes))), np.empty(steps, dtype=np.int64)
    noise = one.sensors.noise_block(0)[:steps]
    run(one.parameters, one.state, commands, noise, states, found)
    told = one.violation_of(int(found[-1]))
    alone = np.array([one.reset(), *(one.step(command) for command in commands[:-1])])
    np.testing.assert_array_equal(alone, states)
    assert one.saturation == saturation_of(found)
    assert one.violation == told
    assert np.abs(states[:, 0]).max() > 0.002


def test_rigs_do_not_share_what_they_remember():
    """Two at once, step by step, and each for itself."""
    command = np.full(1, 3.0)
    (_, one), (_, other) = rig(RIGS[1]), rig(RIGS[1])
    one.reset()
    alone = np.array([one.step(command) for _ in range(50)])
    one.reset()
    other.reset()
    pairs = [(one.step(command), other.step(-command)) for _ in range(50)]
    np.testing.assert_array_equal([first for first, _ in pairs], alone)
    for first, second in itertools.islice(pairs, 5):
        assert first is not second
