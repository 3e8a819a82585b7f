"""Confusion table of metrics.md: verdicts on drawn tests with and without an error of the channels.

    .venv/bin/python docs/trust.py 400 1 kobe.txt:cm/s2:0.005:0 elcentro.txt:cm/s2:0.005:0 ...

Draws so many tests of one axis or three, each with and without a wrong mass, scale, lag, filter
or tilt, and judges them as those of a real rig: without the simulated specimen. Each motion is
FILE, or FILE:UNIT:DT:COLUMN (yours to bring), beside the synthetic one.
"""

import sys
from collections import Counter
from dataclasses import replace

import numpy as np

sys.path.append("src/seft_ros/test")

from seft_msgs_py.config.experiment import Experiment
from seft_plant_sim.rig import Rig
from seft_plant_sim.sensors import CHANNELS
from seft_plant_sim.whole_structure import reference_response
from seft_ros.analysis.calibration_effect import led
from seft_ros.analysis.metrics import nrmse
from seft_ros.analysis.report_numbers import report_numbers
from seft_ros.test_run.compiled_loop import build_blocks
from seft_ros.test_run.offline import simulate_test
from sound_tests import motion_words
from test_detectors import KIND, PLAN, SPECIMEN, load

MASS = 52.7
STOREYS = "rig:specimen.springs:=[1.0, 0.0, 0.0, -1.0, 1.0, 0.0, 0.0, -1.0, 1.0]"
FRAME = "three_storey_frame"
SPOILED, WORSE = 0.05, 1.5
"""A test is spoiled if its displacement is off by more than this, and more than without error."""
SHIFTS = np.linspace(-8e-3, 8e-3, 33)
"""Of the whole test, s: such a shift is no error."""


def specimen(draw):
    """Give the words of each specimen; draw(least, most) draws a number, its logarithm evenly."""
    yields = (
        f"{SPECIMEN}yield_displacement:={draw(0.001, 0.006)}",
        f"{SPECIMEN}hardening_ratio:={draw(0.02, 0.1)}",
    )
    flag, exponent = f"{SPECIMEN}flag.dissipation:={draw(0.2, 1)}", draw(1, 5)
    gap = (
        f"{SPECIMEN}gap.width:={draw(0.0005, 0.006)}",
        f"{SPECIMEN}gap.stiffness:={draw(1e5, 1e6)}",
    )
    return (
        (),
        (f"{KIND}bilinear", *yields),
        (f"{KIND}pinching", *yields),
        (f"{KIND}flag", *yields, flag),
        (f"{KIND}bouc_wen", *yields, f"{SPECIMEN}bouc_wen.exponent:={exponent}"),
        (f"{KIND}gap", *gap),
        (f"{KIND}friction", f"{SPECIMEN}friction.force:={draw(20, 200)}"),
        (f"{KIND}duffing", f"{SPECIMEN}duffing.cubic:={draw(5e8, 5e9)}"),
        (f"{KIND}duffing", f"{SPECIMEN}duffing.cubic:={-draw(1e8, 4e8)}"),
    )


class Errors:
    """Draws what is wrong with the mass that a test of n axes is told, or with its channels."""

    def __init__(self, rng, draw, n):
        self.rng, self.draw, self.n = rng, draw, n
        one = (self.mass, self.mass, self.scale, self.lag, self.lag, self.filter)
        self.kinds = (*one, self.tilt) if n > 1 else one

    def words(self):
        """Give one error, or in one of four tests two."""
        words = self.kinds[self.rng.integers(len(self.kinds))]()
        if self.rng.random() < 0.25:
            words = (*words, *self.kinds[self.rng.integers(len(self.kinds))]())
        return words

    def sign(self):
        """Draw 1 or -1."""
        return self.rng.choice([-1.0, 1.0])

    def of_axis(self, value, rest):
        """Give a value to all axes, or to one of several."""
        one = self.rng.integers(self.n)
        if self.n > 1 and self.rng.random() < 0.6:
            return str([value if i == one else rest for i in range(self.n)])
        return str(value)

    def mass(self):
        """Draw a mass that is told wrong."""
        wrong = MASS * float(np.exp(self.sign() * self.draw(0.01, 0.25)))
        masses = [wrong] * self.n
        if self.n > 1 and self.rng.random() < 0.5:
            masses = [MASS] * self.n
            masses[self.rng.integers(self.n)] = wrong
        return (f"reference_force:model.mass:={masses if self.n > 1 else masses[0]}",)

    def scale(self):
        """Draw a channel's scale."""
        name = self.rng.choice(CHANNELS)
        value = round(float(1 + self.sign() * self.draw(0.005, 0.08)), 5)
        return (f"rig:sensors.{name}_scale:={self.of_axis(value, 1.0)}",)

    def lag(self):
        """Draw a channel's lag."""
        name = self.rng.choice(CHANNELS)
        return (f"rig:sensors.{name}_lag:={self.of_axis(self.draw(1e-4, 3e-3), 0.0)}",)

    def filter(self):
        """Draw a channel's filter."""
        name = self.rng.choice(CHANNELS)
        return (f"rig:sensors.{name}_filter:={self.of_axis(self.draw(60, 400), 0.0)}",)

    def tilt(self):
        """Draw accelerometers that see parts of other axes."""
        mixed = (1 - np.eye(self.n)) * self.rng.uniform(-1, 1, (self.n, self.n))
        tilt = np.eye(self.n) + mixed * self.draw(0.01, 0.15)
        return (f"rig:sensors.tilt:={tilt.ravel().round(4).tolist()}",)


def drawn_test(seed, axes, motions):
    """Draw a test; give its words, and those of the error."""
    rng = np.random.default_rng(seed)

    def draw(least, most):
        return float(f"{np.exp(rng.uniform(*np.log([least, most]))):.4g}")

    def one_of(all_of):
        return all_of[rng.integers(len(all_of))]

    words, motion = one_of(specimen(draw)), one_of(motions)
    rate = one_of((250.0, 500.0, 500.0, 500.0, 1000.0) if axes == 1 else (500.0, 500.0, 1000.0))
    ratios, forces, scales = (0.5, 3), (200, 700), (0.3, 0.5, 1.0)
    if axes > 1:
        ratios, forces, scales = (0.3, 1.5), (100, 300), (0.5, 1.0)
        words = (*words, STOREYS) if words else ()
    words = (
        *(PLAN if axes == 1 else ()),
        *motion,
        *(f"rate:={rate}", f"rig:seed:={seed}", f"ground_motion:synthetic.seed:={seed}"),
        f"reference_force:mass_ratio:={draw(*ratios)}",
        f"ground_motion:peak_force:={draw(*forces)}",
        f"ground_motion:time_scale:={one_of(scales)}",
        *words,
    )
    return words, Errors(rng, draw, axes).words()


def run(words, axes):
    """Run a test; give its record, and the error of the true displacement (None: it tripped)."""
    experiment = load(*words) if axes == 1 else load(*words, config=FRAME)
    blocks = build_blocks(experiment)
    record = simulate_test(experiment, blocks)
    if record.trip is not None:
        return record, None
    rig = Rig.from_parameters(experiment["rig"], experiment.axes, experiment.timebase)
    commands = record.series[rig.drive].values[:, -1]
    rig.reset()
    true = np.zeros(commands.shape)
    for k, command in enumerate(commands[:-1]):
        rig.step(command)
        true[k + 1] = rig.sample[0]
    exact = reference_response(experiment, blocks.ground_motion.samples).displacement[: len(true)]
    dt = experiment.timebase.dt
    shifted = (true + led(true, np.full(axes, shift), dt) for shift in SHIFTS)
    return record, min(nrmse(one, exact) for one in shifted)


def verdict_of(record):
    """Judge a test as one of a real rig, of whose specimen no more is known than the model."""
    sections = {node: own for node, own in record.experiment.sections.items() if node != "rig"}
    return report_numbers(replace(record, experiment=Experiment(sections))).judgement


def main():
    """Run the tests and print the table."""
    count, axes = int(sys.argv[1]), int(sys.argv[2])
    motions = [(), (), *map(motion_words, sys.argv[3:])]
    table = Counter()
    for seed in range(1, 1 + count):
        words, error = drawn_test(seed, axes, motions)
        record, wrong = run((*words, *error), axes)
        if wrong is None:
            table["with the error", "tripped"] += 1
            continue
        sound, right = run(words, axes)
        rows = []
        if right is not None and right <= SPOILED and not sound.saturation:
            rows.append(("sound", sound))
        if right is not None and wrong > max(SPOILED, WORSE * right):
            rows.append(("spoiled", record))
        for row, judged in rows:
            judgement = verdict_of(judged)
            table[row, str(judgement.verdict)] += 1
            if (judgement.verdict == "good") != (row == "sound"):
                print(
                    f"{row}: {judgement.text} {wrong:.3f} {right:.3f} {words} {error}", flush=True
                )
    for (row, verdict), number in sorted(table.items()):
        print(f"{row}, {verdict}: {number}")


if __name__ == "__main__":
    main()
