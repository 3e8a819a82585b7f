"""What a step costs by the number of axes: the offline loop, and coding a message.

Every axis has its own actuator and specimen; over one axis the arrays are small, so that what
grows is what is done axis by axis.
"""

import sys
import time
from pathlib import Path

import numpy as np
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.wire.topics import RIG_STATE
from seft_msgs_py.wire.trajectory import TrajectoryCodec
from seft_ros.test_run.blocks import build_blocks
from seft_ros.test_run.offline import simulate_test
from seft_ros.test_run.parameter_tables import TABLES

CONFIG = Path(__file__).parent.parent / "config" / "jhu.yaml"
AXES = (1, 2, 5, 10, 50)
ROUNDS, MESSAGES = 9, 1000
ASSESSED, WANTED = 10, 3.0  # axes, and how many times as long as one a step may take
KINDS = ("servo_hydraulic_linear", "servo_hydraulic")


def load(axes: int, kind: str) -> Experiment:
    overrides = [
        ("/**", "axes", [f"x{axis}" for axis in range(axes)]),
        ("/**", "actuator.kind", kind),
        ("reference_force", "mass_ratio", 0.5),
        ("ground_motion", "synthetic.duration", 2.0),
        ("ground_motion", "tail", 0.5),
    ]
    return Experiment.load(TABLES, [CONFIG], overrides)


def coding_time(experiment: Experiment) -> float:
    """Seconds to encode and decode one rig/state."""
    codec = TrajectoryCodec(RIG_STATE, experiment.axes, experiment.timebase)
    state = np.random.default_rng(1).normal(
        size=(1, len(RIG_STATE.quantities), len(experiment.axes))
    )
    start = time.perf_counter()
    for step in range(MESSAGES):
        codec.decode(codec.encode(step, state))
    return (time.perf_counter() - start) / MESSAGES


def main() -> int:
    experiments = {(kind, axes): load(axes, kind) for kind in KINDS for axes in AXES}
    blocks = {key: build_blocks(experiment) for key, experiment in experiments.items()}
    times: dict[tuple[str, int], list[float]] = {}
    for _ in range(ROUNDS):  # interleaved: the machine's speed drifts
        for (kind, axes), experiment in experiments.items():
            recording = simulate_test(experiment, blocks[kind, axes], compiles=True)
            steps = len(recording.series[RIG_STATE.name].steps)
            times.setdefault((kind, axes), []).append((recording.wall_s or np.nan) / steps)
            if kind == KINDS[0]:
                times.setdefault(("codec", axes), []).append(coding_time(experiment))
    met = True
    print(f"{'step, by axes':24s}" + "".join(f"{axes:>18d}" for axes in AXES))
    for kind in (*KINDS, "codec"):
        least = [min(times[kind, axes]) for axes in AXES]
        cells = [f"{1e6 * t:9.1f} us {t / least[0]:5.2f}" for t in least]
        print(f"{kind:24s}" + "".join(f"{cell:>18s}" for cell in cells))
        met &= least[AXES.index(ASSESSED)] <= WANTED * least[0]
    print(f"wanted: {ASSESSED} axes at most {WANTED:g} times one axis")
    return 0 if met else 1


if __name__ == "__main__":
    sys.exit(main())
