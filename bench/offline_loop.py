"""Steps per second of the offline loop (`seft simulate`), beside a bare loop of plain floats."""

import statistics
import sys
from pathlib import Path

from _plain_loop import steps_per_second as plain_steps_per_second
from seft_msgs_py.experiment import Experiment
from seft_ros.experiment.blocks import build_blocks
from seft_ros.experiment.offline import simulate
from seft_ros.experiment.tables import TABLES

ROUNDS = 7
WANTED = 100_000  # steps/s


def main() -> int:
    config = Path(__file__).parent.parent / "config" / "jhu.yaml"
    overrides = [
        ("reference_force", "mass_ratio", 0.5),
        ("ground_motion", "synthetic.duration", 120.0),
    ]
    experiment = Experiment.load(TABLES, [config], overrides)
    blocks = build_blocks(experiment)
    motion = blocks.ground_motion.samples[:, 0].tolist()
    ours, floor = [], []
    for _ in range(ROUNDS):  # interleaved: the machine's speed drifts
        record = simulate(experiment, blocks)
        ours.append(len(motion) / (record.wall_s or float("nan")))
        floor.append(plain_steps_per_second(motion))
    speed, bare = statistics.median(ours), statistics.median(floor)
    print(f"offline loop   {speed:12,.0f} steps/s (wanted: {WANTED:,})")
    print(f"plain floats   {bare:12,.0f} steps/s, {bare / speed:.1f} times as fast")
    return 0 if speed >= WANTED else 1


if __name__ == "__main__":
    sys.exit(main())
