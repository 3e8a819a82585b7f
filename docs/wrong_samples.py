"""Table of protection_results.md: wrong samples of one channel, and failing amplifiers, drawn.

Run it in the project:

    .venv/bin/python docs/wrong_samples.py 12

So many draws for each specimen, channel and number of wrong samples in a row. The value is drawn
from all that the sensor can show: evenly, by its logarithm, its ends, 0, or the true one reversed.
An amplifier makes acceleration and force wrong to the end of the test; of these there are four
times as many draws.
"""

import sys
from collections import defaultdict

import numpy as np

sys.path.append("src/seft_ros/test")

from seft_msgs_py.config.facts import CHANNELS
from seft_ros.analysis.summary import summarise_briefly
from seft_ros.test_run.blocks import build_blocks
from seft_ros.test_run.offline import BlockCache
from test_detectors import BILINEAR, GAP, KIND, PLAN, SPECIMEN, load

FRICTION = (f"{KIND}friction", f"{SPECIMEN}friction.force:=60.0")
TESTS = {"linear": (), "bilinear": BILINEAR, "gap": GAP, "friction": FRICTION}
RANGES = dict(zip(CHANNELS, (0.1, 1.0, 39.24, 22200.0), strict=True))
AMPLIFIER, ON = "acceleration and force", "all"
ROWS = "in a row", "largest over the fault-free peak: force", "target", "error more by", "ended"


def run(shop, words):
    """Run a test: true peak force, peak of the target, error, and whether it tripped."""
    experiment = load(*PLAN, *words)
    recording = shop.run(experiment)
    found = summarise_briefly(recording, shop.reference(experiment))
    target = np.abs(recording.series["reference_force"].values).max(axis=(0, 2))
    error = np.nan if recording.trip else found["displacement"]["nrmse"]
    return recording.simulated.force_peak, target, error, recording.trip


def wrong(rng, channel):
    """Draw what a channel shows."""
    size = RANGES[channel]
    values = (
        f"set {rng.uniform(-size, size):.6g}",
        f"set {size * rng.choice([-1, 1]) * 10 ** rng.uniform(-2.5, 0):.6g}",
        f"set {rng.choice([-size, 0.0, size])}",
        "flip",
    )
    return f"{channel} {values[rng.integers(4)]}"


def fault(rng, channel, count, steps):
    """Draw a fault."""
    at = f"at {rng.integers(100, steps - 200) * 0.002:.3f}"
    if channel == AMPLIFIER:
        lines = [f'"{wrong(rng, each)} {at}"' for each in ("acceleration", "force")]
    else:
        lines = [f'"{wrong(rng, channel)} {at} for {count}"']
    return f"rig:faults:=[{', '.join(lines)}]"


def main():
    """Print the table."""
    draws, rng, shop = int(sys.argv[1]), np.random.default_rng(3), BlockCache()
    worst, ended = defaultdict(lambda: np.zeros(3)), defaultdict(int)
    for name, words in TESTS.items():
        force, target, error, _ = run(shop, words)
        steps = build_blocks(load(*PLAN, *words)).ground_motion.steps
        for count in (1, 2, 3, ON):
            for channel in (AMPLIFIER,) if count == ON else CHANNELS:
                for _ in range(4 * draws if count == ON else draws):
                    given = fault(rng, channel, count, steps)
                    peak, aim, off, tripped = run(shop, (*words, given))
                    more = 0.0 if name == "friction" else np.nan_to_num(off - error)
                    found = peak / force, (aim / target).max(), more
                    key = channel, count
                    worst[key] = np.maximum(worst[key], found)
                    ended[key] += tripped is not None
                    if max(found[:2]) > 1.1 or found[2] > 1e-3 or (tripped and count in (1, 2)):
                        line = [f"{value:.4g}" for value in found], tripped and tripped.reason
                        print(name, given, *line, file=sys.stderr)
    print(f"| wrong | {' | '.join(ROWS)} |\n|---|{'---|' * len(ROWS)}")
    for (channel, count), (force, target, error) in worst.items():
        share = f"{error * 100:.2f} %"
        part = f"{ended[channel, count]} of {(4 if count == ON else 1) * draws * len(TESTS)}"
        print(f"| {channel} | {count} | {force:.2f} | {target:.2f} | {share} | {part} |")


if __name__ == "__main__":
    main()
