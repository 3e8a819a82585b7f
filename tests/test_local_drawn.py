"""Offline = nodes, and plain = compiled loop, bit for bit, for configurations drawn at random."""

import json

import numpy as np
import pytest
from experiments_at_hand import load
from graph_tools import JHU
from local_tools import SHORT, TARGET_MOTION, TWO_AXES, UNREHEARSED, assert_same, begin, offline
from recordings_at_hand import assert_same_samples
from seft_msgs_py.config.facts import CHANNELS
from seft_ros.test_run import offline as offline_loop
from seft_ros.test_run.blocks import build_blocks
from seft_ros.test_run.compiled_loop import why_not_compiled
from seft_ros.test_run.offline import simulate_test

MANY = (pytest.mark.thorough, pytest.mark.offline)
RATES = (250.0, 500.0, 1000.0, 1024.0, 1365.33, 4096.0)  # Hz
LATENCY = 2e-5  # s, of a message: a lap of three is within the shortest period
SPECIMEN, RIG = "rig:simulated.specimen.", "rig:simulated.actuator."
DELAYED, SERVO = "actuator.kind:=delay", "actuator.kind:=position_servo"
SPECIMENS = (
    ("kind:=linear",),
    ("kind:=bilinear", "yield_displacement:={small}"),
    ("kind:=bouc_wen", "yield_displacement:={small}", "bouc_wen.exponent:={exponent}"),
    ("kind:=flag", "yield_displacement:={small}", "flag.dissipation:=0.8"),
    ("kind:=friction", "friction.force:={force}"),
    ("kind:=gap", "gap.width:={small}", "gap.stiffness:=2.11e5"),
    ("kind:=duffing", "duffing.cubic:=2e9"),
)
EFT = ("reference_force:method:=eft", "reference_force:mass_ratio:=0.0")
METHODS = (
    TARGET_MOTION,
    TARGET_MOTION,
    (*TARGET_MOTION, "loop_delay:=3"),
    ("reference_force:compensation.method:=restoring",),
    ("reference_force:compensation.method:=model", "actuator.delay:=0.0109"),
    EFT,
)
ACTUATORS = (
    *((f"{RIG}flow_gain:={{gain}}", f"{RIG}dead_time:={{late}}"),) * 3,
    ("actuator.kind:=servo_hydraulic_linear",),
    (DELAYED, f"{RIG}delay:={{lag}}"),
    (SERVO, f"{RIG}dead_time:={{late}}", f"{RIG}servo.integral:=1e4"),
    (SERVO, "sensors.velocity:=derived", "sensors.acceleration:=derived"),
)
DIFFERENCES = (
    (),
    ("/**:sensors.adc_bits:=12",),
    ("sensors.velocity:=derived",),
    ("rig:simulated.sensors.force_filter:=150.0", "rig:simulated.sensors.acceleration_lag:=0.0007"),
    ("calibration.displacement_lag:={short}",),
    ("calibration.force_scale:=1.03", "calibration.acceleration_lag:={short}"),
    ("calibration.force_filter:=70.0", "calibration.displacement_lag:={short}"),
    tuple(
        word
        for channel in CHANNELS
        for word in (
            f"calibration.{channel}_lag:=0.0025",
            f"rig:simulated.sensors.{channel}_lag:=0.0",
            f"rig:simulated.sensors.{channel}_filter:=90.0",
        )
    ),
    ("calibration.force_scale:=0.98", "rig:simulated.sensors.force_scale:=1.0"),
    ("specimen.stiffness:=1.8e5", f"{SPECIMEN}stiffness:=2.11e5"),
    ("limits.force:={force}",),
    ("limits.acceleration:=8.0",),
    ("limits.command:=0.4",),
)
WRONG = (
    "displacement set 0.03 at {at} for 1",
    "velocity add -0.2 at {at} for 2",
    "acceleration flip at {at} for {some}",
    "force set nan at {at} for 1",
    "force add {force} at {at} for {some}",
    "force scale 0.5 at {at}",
    "acceleration freeze at {at}",
    "valve stick at {at} for 20",
    "supply scale 0.5 at {at}",
    "specimen slip 1e-4 at {at}",
)

BESIDE = {
    "method of another package": (
        "reference_force:compensation.method:=polynomial",
        "actuator.delay:=0.0109",
    ),
    "eft of an ideal actuator": ("actuator.kind:=ideal", *EFT),
    "coupled axes": (
        *TWO_AXES,
        f"{SPECIMEN}stiffness:=[2.0e5, -1.0e4, -1.0e4, 2.2e5]",
        f"{SPECIMEN}mass:=[52.7, 55.0]",
        "actuator.dead_time:=[0.001, 0.0023]",
        "calibration.tilt:=[1.0, 0.03, -0.04, 1.0]",
        'rig:faults:=["north/acceleration set nan at 0.7 for 1"]',
    ),
    "forces late over a link": (
        *(DELAYED, "actuator.delay:=0.0113", "loop_delay:=5"),
        "reference_force:compensation.method:=model",
    ),
    "a target late over a link": (
        *(*TARGET_MOTION, DELAYED, "actuator.delay:=0.005", "loop_delay:=2"),
        "force_controller:method:=transfer_function",
    ),
}
"""What is not drawn, each at a mass ratio of 0.2."""


AT_ONCE = (2, 4, 5, 8, 9, 12, 15, 16, 17, 20, 24)
"""Seeds that draw at least once whatever can be drawn."""


def drawn(seed):
    """Draw the words of an experiment."""
    rng = np.random.default_rng(seed)
    values = {
        **{"small": rng.uniform(5e-4, 2e-3), "force": rng.uniform(100.0, 600.0)},
        **{"exponent": rng.uniform(1.0, 4.0), "gain": rng.uniform(0.035, 0.046)},
        **{"late": rng.uniform(2e-4, 3e-3), "lag": rng.uniform(2e-3, 0.012)},
        **{"at": rng.uniform(0.5, 1.6), "some": rng.integers(1, 5)},
        **{"short": rng.uniform(2e-4, 3e-3)},
    }
    values = {name: f"{value:.6g}" for name, value in values.items()}

    def one_of(lists):
        return [word.format(**values) for word in lists[rng.integers(len(lists))]]

    faults = ", ".join(f'"{WRONG[k].format(**values)}"' for k in rng.choice(len(WRONG), 2))
    words = [
        *one_of(METHODS),
        *(f"{SPECIMEN}{word}" for word in one_of(SPECIMENS)),
        *one_of(ACTUATORS),
        *one_of(DIFFERENCES),
        f"reference_force:mass_ratio:={rng.uniform(0.2, 1.5):.4g}",
        f"ground_motion:peak_force:={rng.uniform(100.0, 500.0):.4g}",
        f"ground_motion:synthetic.seed:={seed}",
        *SHORT,
        *(f"rig:seed:={seed}", f"rate:={rng.choice(RATES)}"),
        f"rig:pace:={rng.choice(['lockstep', 'realtime'])}",
    ]
    if rng.random() < 0.3:
        words += TWO_AXES
    bias = rng.choice([0.0, 8.0])  # less than is refused at rest
    words.append(f"rig:simulated.sensors.force_bias:={bias}")
    if rng.random() < 0.7:
        words.append(f"rig:faults:=[{faults}]")
    if EFT[0] in words:
        words.append(EFT[1])
    if DELAYED in words:
        words += ["actuator.delay:=0.017", "loop_delay:=0"]
        words += ["force_controller:method:=transfer_function"]
    if SERVO in words:
        words.append(f"{RIG}servo.proportional:={rng.choice([0.0, 3000.0])}")
        words += [*TARGET_MOTION[:1], "force_controller:method:=position_servo"]
        words += ["actuator.response.numerator:=[7.38e12]", "actuator.response.dead_time:=0.002"]
        known = "[1.0, 593.0, 5.484e5, 1.82e8, 6.21e10, 7.42e12]"
        words += [f"actuator.response.denominator:={known}", "limits.command:=0.05"]
        words += ["reference_force:compensation.horizon:=0.2", "ground_motion:lead:=1.0"]
        words = [word for word in words if word != EFT[0]]
    if not any("flow_gain" in word for word in words):
        words = [word for word in words if "supply" not in word]
    for channel in ("velocity", "acceleration"):
        if f"sensors.{channel}:=derived" in words:  # there is no such sensor
            words = [w for w in words if f'"{channel}' not in w and f"{channel}_" not in w]
    return words


def check_nodes(local_graph, words):
    with local_graph(*words, UNREHEARSED, config=JHU, latency=LATENCY) as graph:
        begin(graph)
        graph.until(lambda: graph.state in ("done", "tripped"))
        recording = offline(graph)
        assert (recording.trip is None) == (graph.state == "done")
        reported = graph.until(lambda: graph.status("rig").get("simulated"))
        assert_same(graph, recording, steps=len(recording.series["rig/state"].steps))
        assert json.loads(reported) == vars(recording.simulated)
        if graph.state == "done":
            assert graph.status("rig")["missed"] == "0"
        else:
            assert graph.values["step"] == recording.trip.step
            detail = graph.values["detail"].removeprefix("force_controller: ")
            assert recording.trip.reason.startswith(detail)  # which also tells of a ramp before


@pytest.mark.parametrize(
    "seed", [pytest.param(seed, marks=() if seed in AT_ONCE else MANY) for seed in range(1, 150)]
)
def test_nodes_give_the_bits_of_the_offline_loop(local_graph, seed):
    check_nodes(local_graph, drawn(seed))


@pytest.mark.parametrize("pace", ["lockstep", "realtime"])
@pytest.mark.parametrize("what", BESIDE)
def test_so_they_do_of_what_is_not_drawn(local_graph, what, pace):
    ratio = "reference_force:mass_ratio:=0.2"
    check_nodes(local_graph, (*SHORT, ratio, *BESIDE[what], f"rig:pace:={pace}"))


@pytest.mark.parametrize("seed", [pytest.param(seed, marks=MANY) for seed in range(1, 150)])
def test_the_compiled_loop_gives_the_bits_of_the_plain_one(seed, monkeypatch):
    experiment = load(*drawn(seed))
    blocks, others = (build_blocks(experiment) for _ in range(2))
    if why_not_compiled(blocks):
        return
    compiled = simulate_test(experiment, blocks, compiles=True)
    monkeypatch.setattr(offline_loop, "_compiles", lambda *_: False)
    plain = simulate_test(experiment, others)
    assert plain.trip == compiled.trip
    assert_same_samples(compiled, plain)
