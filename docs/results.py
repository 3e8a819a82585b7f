"""Tables of compensation.md, sections Results and Limits: run it in the folder of the project.

    .venv/bin/python docs/results.py kobe.txt

kobe.txt is Kobe 1995, JMA N-S, in cm/s^2 at 0.005 s (yours to bring). Without it the tables are of
the synthetic motion alone. Each row is what `seft simulate` says of these overrides, in percent.
"""

import sys

import numpy as np
from seft_msgs_py.config.experiment import Experiment, parse_override
from seft_plant_sim.whole_structure import reference_response
from seft_ros.analysis.metrics import nrmse
from seft_ros.test_run.blocks import build_blocks
from seft_ros.test_run.offline import simulate_test
from seft_ros.test_run.parameter_tables import TABLES

SPECIMEN, METHOD = "rig:simulated.specimen.", "reference_force:compensation.method"
UNZEROED = "calibration.zeroing:=0.0"
WATCH = "reference_force:instability.ratio:=100.0"  # each test goes on to its end
YIELD = f"{SPECIMEN}yield_displacement:="
STOREYS = "specimen.springs:=[1.0, 0.0, 0.0, -1.0, 1.0, 0.0, 0.0, -1.0, 1.0]"
LINK = "loop_delay:=5"
EXAMPLES = "three_storey_frame", "six_storey_frame", "two_pier_bridge", "water_tower", "demo"
Row = tuple[str, ...]
"""Overrides; one that begins with ``config:`` names the file."""


def loaded(alpha: float, newtons: float) -> Row:
    """Mass ratio and peak force."""
    return f"reference_force:mass_ratio:={alpha}", f"ground_motion:peak_force:={newtons}"


def specimen(kind: str, *settings: str) -> Row:
    """Choose a law."""
    return (WATCH, f"{SPECIMEN}kind:={kind}", *(SPECIMEN + setting for setting in settings))


def wrong(name: str, known: float, true: float) -> Row:
    """Choose what is known wrong, and what it truly is."""
    return f"{name}:={known:.6g}", f"rig:simulated.{name}:={true:.6g}"


ONE = loaded(1.0, 500.0)
PLAN = (f"{METHOD}:=target_motion", "force_controller:method:=velocity_feedforward")
DELAY = (
    *(f"{METHOD}:=target_motion", WATCH),
    *("actuator.kind:=delay", "actuator.delay:=0.01"),
)
TESTS: dict[str, list[Row]] = {
    "mass ratios": [
        (*PLAN, *loaded(alpha, newtons))
        for alpha, newtons in zip(
            (0.5, 1.0, 1.5, 3.0, 5.0, 10.0),
            (500.0, 500.0, 400.0, 250.0, 180.0, 120.0),
            strict=True,
        )
    ],
    "specimens": [
        (*PLAN, *ONE, *specimen(*words))
        for words in (
            ("bouc_wen", "yield_displacement:=0.003"),
            ("pinching", "yield_displacement:=0.003"),
            ("flag", "yield_displacement:=0.003"),
            ("bilinear", "yield_displacement:=0.003"),
            ("bilinear", "yield_displacement:=0.003", "hardening_ratio:=0.0"),
            ("duffing", "duffing.cubic:=1.0e9"),
            ("duffing", "duffing.cubic:=-3.0e8"),
            *(("friction", f"friction.force:={force}") for force in (20.0, 60.0, 190.0)),
            ("gap", "gap.width:=0.003", "gap.stiffness:=6.0e5"),
        )
    ]
    + [(*PLAN, *loaded(3.0, 250.0), *specimen("bouc_wen", "yield_displacement:=0.0025"))],
    "other noise": [
        (*PLAN, *ONE, *specimen(kind, "yield_displacement:=0.003"), f"rig:seed:={seed}")
        for kind in ("bouc_wen", "bilinear", "flag")
        for seed in (1, 2, 3)
    ]
    + [
        (*PLAN, *ONE, *specimen("friction", f"friction.force:={force}"), f"rig:seed:={seed}")
        for force in (60.0, 190.0)
        for seed in (1, 2, 3)
    ],
    "several axes": [
        *((f"config:{name}",) for name in EXAMPLES),
        ("config:three_storey_frame", "ground_motion:peak_force:=100.0"),
        *(
            ("config:three_storey_frame", *specimen(kind), f"{YIELD}0.008", STOREYS)
            for kind in ("bouc_wen", "bilinear")
        ),
    ],
    "wrong assumptions": [
        (*PLAN, *ONE, *wrong(*values))
        for values in (
            *(("specimen.stiffness", factor * 2.11e5, 2.11e5) for factor in (0.7, 1.4)),
            ("actuator.flow_gain", 0.8 * 0.0403, 0.0403),
            ("actuator.dead_time", 0.003, 0.001),
            ("actuator.valve_frequency", 1.2 * 70.0, 70.0),
        )
    ],
    "other rigs": [
        *((*PLAN, *ONE, f"rate:={rate}") for rate in (250.0, 2000.0)),
        (*PLAN, *ONE, "actuator.valve_frequency:=30.0"),
        (*PLAN, *ONE, "actuator.dead_time:=0.006"),
        (*PLAN, *ONE, "actuator.dead_time:=0.01", "reference_force:compensation.horizon:=0.08"),
    ],
    "behind a link of 10 ms": [
        (*PLAN, *ONE, LINK, *specimen(*words))
        for words in (
            ("linear",),
            ("bouc_wen", "yield_displacement:=0.003"),
            ("bilinear", "yield_displacement:=0.003"),
        )
    ],
    "rigs that obey forces": [
        *((*DELAY, *loaded(alpha, newtons)) for alpha, newtons in ((1.0, 500.0), (3.0, 250.0))),
        *(
            (*DELAY, *ONE, *specimen(*words))
            for words in (
                ("bouc_wen", "yield_displacement:=0.003"),
                ("bilinear", "yield_displacement:=0.003"),
            )
        ),
    ],
    "limits": [
        *((*PLAN, *loaded(1.0, newtons)) for newtons in (700.0, 1000.0)),
        (*PLAN, *ONE, "sensors.displacement_noise:=0.0"),
        *(
            (*PLAN, *ONE, UNZEROED, f"rig:simulated.sensors.{name}_bias:={value}")
            for name, value in (("force", 5.0), ("displacement", 1e-4), ("acceleration", 0.1))
        ),
    ],
}

ANOTHER = (f"{SPECIMEN}stiffness:=2.1142e5",), (f"{SPECIMEN}damping:=808.3",)
"""A specimen of 0.2 % more stiffness, and one of 1 % more damping."""


def named(word: str) -> str:
    """Write an override for a table."""
    name, _, value = word.partition(":")
    return f"`config/{value}.yaml`" if name == "config" else f"`{word}`"


def tested(row: Row, motion: Row) -> str:
    """Run a test, and give its displacement error in percent, of all axes together."""
    special = dict(word.split(":", 1) for word in row if ":=" not in word)
    plan = [word for word in row if ":=" in word]
    config = f"config/{special.get('config', 'jhu')}.yaml"
    overrides = [parse_override(word) for word in (*plan, *motion)]
    experiment = Experiment.load(TABLES, [config], overrides)
    blocks = build_blocks(experiment)
    recording = simulate_test(experiment, blocks)
    if recording.trip:
        return f"trips at {recording.trip.time_s:.1f} s"
    exact = reference_response(experiment, blocks.ground_motion.samples).displacement
    return percent(nrmse(recording.measured.values[:, 0], exact))


def percent(ratio: float) -> str:
    """Write a ratio in percent, with two digits."""
    return f"{100 * ratio:#.2g}".rstrip(".")


def moved(row: Row, motion: Row) -> str:
    """Give the change of the exact displacement in percent for each of `ANOTHER`."""
    exact = exact_displacement((*row, *motion))
    changed = (exact_displacement((*row, *other, *motion)) for other in ANOTHER)
    return ", ".join(percent(nrmse(displacement, exact)) for displacement in changed)


def exact_displacement(words: Row) -> np.ndarray:
    """Displacement of the whole structure, solved exactly, shape (N, n), m."""
    experiment = Experiment.load(TABLES, ["config/jhu.yaml"], map(parse_override, words))
    motion = build_blocks(experiment).ground_motion.samples
    return reference_response(experiment, motion).displacement


def main() -> None:
    """Print all tables."""
    motions: dict[str, Row] = {"synthetic": ()}
    if len(sys.argv) > 1:
        values = (("file", sys.argv[1]), ("unit", "cm/s2"), ("dt", "0.005"), ("column", "0"))
        motions["Kobe JMA N-S"] = tuple(f"ground_motion:{name}:={word}" for name, word in values)
    hidden = {*PLAN, *DELAY, *ONE, WATCH, STOREYS, LINK}
    for title, rows in TESTS.items():
        print_head(title, motions)
        for row in rows:
            words = [named(word) for word in row if word not in hidden]
            errors = [tested(row, motion) for motion in motions.values()]
            print(f"| {', '.join(words) or 'as it is'} | {' | '.join(errors)} |", flush=True)
    print_head("a specimen of 0.2 % more stiffness, 1 % more damping", motions)
    row = (*ONE, *specimen("linear"))
    changes = [moved(row, motion) for motion in motions.values()]
    print(f"| linear | {' | '.join(changes)} |", flush=True)


def print_head(title: str, motions: dict[str, Row]) -> None:
    """Print the head of a table."""
    print(f"\n{title}\n\n| overrides | {' | '.join(motions)} |\n|{'---|' * (1 + len(motions))}")


if __name__ == "__main__":
    main()
