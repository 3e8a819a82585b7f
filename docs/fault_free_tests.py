"""Fault-free tests of protection_results.md, drawn at random: no detector may end one.

Run it in the project:

    .venv/bin/python docs/fault_free_tests.py 1000 kobe.txt:cm/s2:0.005:0 nishi_akashi.AT2

Each motion is FILE, or FILE:UNIT:DT:COLUMN (yours to bring); half of the tests take the synthetic
one.
"""

import sys
from dataclasses import replace

import numpy as np

sys.path.append("src/seft_ros/test")

from rig_faults import LATE, MISSED, SlowHost
from seft_msgs_py.config.facts import CHANNELS
from seft_plant_sim.judge.detector_list import DETECTORS
from seft_ros.test_run.blocks import build_blocks
from seft_ros.test_run.offline import simulate_test
from test_detectors import KIND, NOISE, OBEYS, PLAN, SPECIMEN, load

RATES = 250.0, 500.0, 500.0, 500.0, 1000.0, 2000.0
COMPENSATION = "reference_force:compensation."
LOOPS = (
    *(PLAN, PLAN, PLAN),
    (f"{COMPENSATION}method:=none",),
    (f"{COMPENSATION}method:=model", "actuator.delay:=0.017"),
    (f"{COMPENSATION}method:=restoring",),
    (f"{COMPENSATION}method:=target_motion", *OBEYS),
    (f"{COMPENSATION}method:=model", *OBEYS),
)
YIELD, HARDENING = f"{SPECIMEN}yield_displacement:=", f"{SPECIMEN}hardening_ratio:="
GAIN, DEAD_TIME = "rig:simulated.actuator.flow_gain:=", "rig:simulated.actuator.dead_time:="
MASS, STIFFNESS, OIL = 52.7, 2.11e5, "rig:simulated.actuator.oil_stiffness:="
VALVE, ADC = "rig:simulated.actuator.valve_frequency:=", "/**:sensors.adc_bits:=12"


def specimen(draw):
    """Give the words of a specimen; draw(least, most) draws a number, its logarithm evenly."""
    yields = f"{YIELD}{draw(0.001, 0.006)}", f"{HARDENING}{draw(0.02, 0.1)}"
    gap = (
        f"{SPECIMEN}gap.width:={draw(0.0005, 0.006)}",
        f"{SPECIMEN}gap.stiffness:={draw(1e5, 1e6)}",
    )
    flag, exponent = f"{SPECIMEN}flag.dissipation:={draw(0.2, 1)}", f"{draw(1, 5)}"
    return (
        (),
        (f"{KIND}bilinear", *yields),
        (f"{KIND}pinching", *yields),
        (f"{KIND}flag", *yields, flag),
        (f"{KIND}bouc_wen", *yields, f"{SPECIMEN}bouc_wen.exponent:={exponent}"),
        (f"{KIND}gap", *gap),
        (f"{KIND}friction", f"{SPECIMEN}friction.force:={draw(20, 400)}"),
        (f"{KIND}duffing", f"{SPECIMEN}duffing.cubic:={draw(5e8, 1e10)}"),
        (f"{KIND}duffing", f"{SPECIMEN}duffing.cubic:={-draw(1e8, 8e8)}"),
    )


def difference(draw, rng):
    """Give the words of what differs from what is assumed; or `LATE`, or `MISSED`."""
    sensors = dict(zip(CHANNELS, NOISE, strict=True))
    hertz = draw(80, 200)
    sign = dict(zip(sensors, rng.choice([-2.0, 2.0], 4), strict=True))
    return (
        (),
        (f"{GAIN}{0.0403 * draw(0.75, 1.25)}",),
        (f"{DEAD_TIME}{draw(1e-4, 4e-3)}",),
        (f"{OIL}{MASS * (2 * np.pi * 90 * draw(0.8, 1.25)) ** 2 - STIFFNESS:.6g}",),
        (f"{VALVE}{70 * draw(0.7, 1.4)}",),
        (f"rig:simulated.actuator.friction:={draw(20, 100)}",),
        (f"rig:simulated.actuator.leakage:={50 * draw(0.5, 2)}",),
        (f"rig:simulated.actuator.force_capacity:={24500 * draw(0.5, 1.5)}",),
        (f"{GAIN}{0.0403 * draw(0.8, 1.2)}", f"{DEAD_TIME}{draw(1e-4, 3e-3)}", ADC),
        (f"specimen.stiffness:={STIFFNESS * draw(0.6, 1.5)}", f"{SPECIMEN}stiffness:={STIFFNESS}"),
        (ADC,),
        tuple(f"rig:simulated.sensors.{name}_filter:={hertz}" for name in sensors),
        ("sensors.velocity:=derived",),
        tuple(f"sensors.{name}_noise:=0.0" for name in sensors),
        tuple(f"sensors.{name}_noise:={5 * noise}" for name, noise in sensors.items()),
        tuple(
            f"rig:simulated.sensors.{name}_bias:={sign[name] * noise}"
            for name, noise in sensors.items()
        ),
        MISSED,
        LATE,
    )


def one_test(seed, motions):
    """Run a test; give its words, and why it ended."""
    rng = np.random.default_rng(seed)

    def draw(least, most):
        return float(f"{np.exp(rng.uniform(*np.log([least, most]))):.4g}")

    def one_of(all_of):
        return all_of[rng.integers(len(all_of))]

    words, differs, motion = one_of(specimen(draw)), one_of(difference(draw, rng)), one_of(motions)
    misses = differs in (MISSED, LATE)
    rate = 500.0 if misses else one_of(RATES)
    loop = PLAN if misses else one_of(LOOPS)
    ratios = (0.5, 3.0) if loop == PLAN else (0.1, 0.5)  # others are unstable with more
    given = (
        *loop,
        *(words if misses else (*words, *differs)),
        *(motion if motion and rng.random() < 0.5 else ()),
        *(f"ground_motion:synthetic.seed:={seed}", f"rig:seed:={seed}", f"rate:={rate}"),
        *(
            f"reference_force:mass_ratio:={draw(*ratios)}",
            f"ground_motion:peak_force:={draw(200, 700)}",
        ),
        f"ground_motion:time_scale:={one_of((0.3, 0.5, 1.0))}",
    )
    experiment = load(*given)
    blocks = build_blocks(experiment)
    if misses:
        blocks = replace(blocks, rig=SlowHost(blocks.rig, differs, blocks.force_controller))
        given = (*given, differs)
    recording = simulate_test(experiment, blocks)
    return given, recording.trip.reason if recording.trip else ""


def motion_words(word):
    """Give the words of a motion, ``FILE`` or ``FILE:UNIT:DT:COLUMN``."""
    file, *given_parts = word.split(":")
    names = ("file", "unit", "dt", "column")[: 1 + len(given_parts)]
    return tuple(
        f"ground_motion:{n}:={v}" for n, v in zip(names, (file, *given_parts), strict=True)
    )


def main():
    """Run the tests; print those that a detector ended."""
    count, motions = int(sys.argv[1]), [motion_words(word) for word in sys.argv[2:]] or [()]
    ended = {"by a detector": 0, "otherwise": 0}
    for seed in range(1, 1 + count):
        given, reason = one_test(seed, motions)
        if any(reason.endswith(f": {one.name}") for one in DETECTORS):
            ended["by a detector"] += 1
            print(f"{reason}\n    {' '.join(given)}", flush=True)
        elif reason:
            ended["otherwise"] += 1
    print(f"of {count} fault-free tests, ended by a detector: {ended['by a detector']},", end=" ")
    print(f"by a limit that is too narrow for them: {ended['otherwise']}")


if __name__ == "__main__":
    main()
