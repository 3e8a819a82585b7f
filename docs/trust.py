"""Confusion table of metrics.md: verdicts on drawn tests with and without an error of the channels.

    .venv/bin/python docs/trust.py --multisine 400 1 kobe.txt:cm/s2:0.005:0 nishi_akashi.AT2 ...

Draws so many tests of one axis or three, each with and without a wrong mass, scale, lag, filter or
tilt, or a channel that changes in mid-test, and assesses them as a laboratory would see them. With
--multisine each rig has an open loop and a multisine test first, as with `seft identify`, and tests
get what these have found: once the error comes after them, and once it is there already. Of every
other specimen the mass is weighed, which tells the scale of the force. Each motion is FILE, or
FILE:UNIT:DT:COLUMN (yours to bring), beside the synthetic one.
"""

import argparse
import math
import sys
from collections import Counter
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

sys.path.append("src/seft_ros/test")

from fault_free_tests import MASS, motion_words
from seft_msgs_py.config.facts import CHANNELS
from seft_msgs_py.errors import InputError
from seft_plant_sim.rig import Rig
from seft_plant_sim.rig_parameters import truth
from seft_plant_sim.whole_structure import reference_response
from seft_ros.analysis.calibration_check import led
from seft_ros.analysis.metrics import nrmse
from seft_ros.analysis.report_numbers import report_numbers
from seft_ros.identification.calibrated import (
    MultisineResult,
    found_filters,
    moved_by,
    rough_calibration,
)
from seft_ros.identification.multisine import (
    PILOT_SECONDS,
    gains_after,
    multisine_drive,
    plan_multisine,
    with_actuators,
)
from seft_ros.identification.rig_tests import (
    Motions,
    multisine_test,
    open_loop,
    pilot_voltage,
    voltage_after,
    write_forces,
)
from seft_ros.test_run.blocks import build_blocks
from seft_ros.test_run.offline import simulate_test
from test_detectors import KIND, PLAN, SPECIMEN, load
from test_identification_multisine import identified

STOREYS = "specimen.springs:=[1.0, 0.0, 0.0, -1.0, 1.0, 0.0, 0.0, -1.0, 1.0]"
SENSORS, FRAME = "rig:simulated.sensors.", "three_storey_frame"
SECONDS = 60.0
"""Of the open loop, which shows filters."""
SPOILED = 0.05
"""A test is wrong if its displacement is off by more than this."""
SHIFTS = np.linspace(-8e-3, 8e-3, 33)
"""Of the whole test, s: such a shift is no error."""
ALONE, BEFORE, AFTER = (
    "with error",
    "error before the multisine test",
    "error after the multisine test",
)


def specimen(draw):
    """Give the words of each specimen; draw(least, most) draws a number, its logarithm evenly."""
    yields = (
        f"{SPECIMEN}yield_displacement:={draw(0.001, 0.006)}",
        f"{SPECIMEN}hardening_ratio:={draw(0.02, 0.1)}",
    )
    flag, exponent = f"{SPECIMEN}flag.dissipation:={draw(0.2, 1)}", draw(1, 5)
    gap = (
        f"{SPECIMEN}gap.width:={draw(0.0005, 0.006)}",
        f"{SPECIMEN}gap.stiffness:={draw(1e5, 3e6)}",
    )
    return (
        (),
        (f"{KIND}bilinear", *yields),
        (f"{KIND}pinching", *yields),
        (f"{KIND}flag", *yields, flag),
        (f"{KIND}bouc_wen", *yields, f"{SPECIMEN}bouc_wen.exponent:={exponent}"),
        (f"{KIND}gap", *gap),
        (f"{KIND}friction", f"{SPECIMEN}friction.force:={draw(20, 400)}"),
        (f"{KIND}duffing", f"{SPECIMEN}duffing.cubic:={draw(5e8, 5e9)}"),
        (f"{KIND}duffing", f"{SPECIMEN}duffing.cubic:={-draw(1e8, 4e8)}"),
    )


class Errors:
    """Draws what is wrong with the mass that a test of n axes knows, or with its channels."""

    def __init__(self, rng, draw, n):
        self.rng, self.draw, self.n = rng, draw, n
        one = (self.mass, self.mass, self.scale, self.lag, self.lag, self.filter, self.midway)
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

    def of_axis(self, value, others):
        """Give a value to all axes, or to one of several."""
        one = self.rng.integers(self.n)
        if self.n > 1 and self.rng.random() < 0.6:
            return str([value if i == one else others for i in range(self.n)])
        return str(value)

    def mass(self):
        """Draw a mass that is known wrongly."""
        wrong = MASS * float(np.exp(self.sign() * self.draw(0.01, 0.25)))
        masses = [wrong] * self.n
        if self.n > 1 and self.rng.random() < 0.5:
            masses = [MASS] * self.n
            masses[self.rng.integers(self.n)] = wrong
        shown = masses if self.n > 1 else masses[0]
        return f"specimen.mass:={shown}", f"{SPECIMEN}mass:={MASS}"

    def scale(self):
        """Draw a channel's scale."""
        name = self.rng.choice(CHANNELS)
        value = round(float(1 + self.sign() * self.draw(0.005, 0.08)), 5)
        return (f"{SENSORS}{name}_scale:={self.of_axis(value, 1.0)}",)

    def lag(self):
        """Draw a channel's lag."""
        name = self.rng.choice(CHANNELS)
        return (f"{SENSORS}{name}_lag:={self.of_axis(self.draw(1e-4, 3e-3), 0.0)}",)

    def filter(self):
        """Draw a channel's filter."""
        name = self.rng.choice(CHANNELS)
        return (f"{SENSORS}{name}_filter:={self.of_axis(self.draw(60, 400), 0.0)}",)

    def midway(self):
        """Draw a channel that changes in mid-test."""
        scale, at = round(float(1 + self.sign() * self.draw(0.01, 0.1)), 4), self.rng.uniform(1, 6)
        ways = (
            *(f"{name} scale {scale}" for name in ("displacement", "acceleration", "force")),
            f"force drift {self.sign() * self.draw(2, 50):.3g}",
            f"force add {self.sign() * self.draw(5, 100):.3g}",
            f"acceleration add {self.sign() * self.draw(0.05, 1):.3g}",
        )
        return (f"rig:faults:={ways[self.rng.integers(len(ways))]} at {at:.2f}",)

    def tilt(self):
        """Draw accelerometers that see parts of other axes."""
        mixed = (1 - np.eye(self.n)) * self.rng.uniform(-1, 1, (self.n, self.n))
        tilt = np.eye(self.n) + mixed * self.draw(0.01, 0.15)
        return (f"{SENSORS}tilt:={tilt.ravel().round(4).tolist()}",)


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


def loaded(words, axes):
    """Make the experiment of a test."""
    return load(*words) if axes == 1 else load(*words, config=FRAME)


def simulated(experiment):
    """Run a test; give its blocks and its recording."""
    blocks = build_blocks(experiment)
    return blocks, simulate_test(experiment, blocks, compiles=True)


def identified_of(words, axes, weighed):
    """Run open loop and multisine test on a rig of known actuators; give the words that follow."""
    experiment = loaded(words, axes)
    rate, found = experiment.timebase.rate, identified(experiment)
    band = (0.3, min(0.45 * rate, 200.0))

    def moved(forces, test):
        with TemporaryDirectory() as folder:
            path = write_forces(Path(folder) / "forces.csv", experiment, forces)
            recording = simulated(test(experiment, path))[1]
        if recording.trip is not None:
            raise InputError(f"a test before tripped: {recording.trip.reason}")
        return recording

    def opened(seconds, volts):
        return moved(motions.unit(seconds), lambda of, path: open_loop(of, path, volts, False))

    motions = Motions(experiment, band, 1, math.inf)
    most = motions.largest_levels(SECONDS)
    volts = pilot_voltage(experiment, most)
    volts = voltage_after(opened(motions.of_pilot(SECONDS), volts), volts, most)
    recording = opened(SECONDS, volts)
    filters = found_filters(recording, band)
    known = rough_calibration(recording, band, filters)

    plan = with_actuators(plan_multisine(experiment), found, experiment)
    commands, sines = multisine_drive(plan, found, 1.0 / rate, seconds=PILOT_SECONDS)
    gains = gains_after(plan, moved_by(moved(commands, multisine_test), sines))
    commands, sines = multisine_drive(plan, found, 1.0 / rate, gains=gains)
    shaken = moved(commands, multisine_test)
    for _ in range(2):  # the second time with the filters and lags that it has found
        given = plan, shaken, sines, found, known, filters, weighed
        multisine = MultisineResult.of_recording(*given)
        filters, known = found_filters(recording, band, multisine), multisine.calibrated
    words = ("/**", multisine.facts()), ("rig", truth(experiment["rig"]))  # which stays as it was
    return tuple((place, *item) for place, section in words for item in section.items())


def run(words, axes):
    """Run a test; give its recording, and the error of the true displacement (None: it tripped)."""
    experiment = loaded(words, axes)
    blocks, recording = simulated(experiment)
    if recording.trip is not None:
        return recording, None
    rig = Rig(experiment["rig"], experiment.axes, experiment.timebase)
    commands = recording.series[rig.drive].values[:, -1]
    rig.reset()
    true = np.zeros(commands.shape)
    for k, command in enumerate(commands[:-1]):
        rig.step(command)
        true[k + 1] = rig.simulation.sample[0]
    exact = reference_response(experiment, blocks.ground_motion.samples).displacement[: len(true)]
    dt = experiment.timebase.dt
    shifted = (true + led(true, np.full(axes, shift), dt) for shift in SHIFTS)
    return recording, min(nrmse(one, exact) for one in shifted)


class Table:
    """Verdicts on sound and wrong tests, counted; prints the wrong verdicts."""

    def __init__(self):
        self.counts = Counter()

    def add(self, name, test, shown):
        """Count a test, its recording and error; one with an error that is slight is neither."""
        recording, wrong = test
        if wrong is None:
            self.counts[name, "tripped", ""] += 1
            return
        if wrong <= SPOILED and name in (ALONE, AFTER):
            self.counts[name, "neither", ""] += 1
            return
        row = "wrong" if wrong > SPOILED else "sound"
        assessment = report_numbers(recording).laboratory
        self.counts[name, row, str(assessment.verdict)] += 1
        if (assessment.verdict == "good") == (row == "wrong"):
            print(f"{name}, {row}: {assessment.text} {wrong:.3f} {shown}", flush=True)

    def show(self):
        """Print the table."""
        for (*names, verdict), number in sorted(self.counts.items()):
            print(f"{', '.join(names)}, {verdict}: {number}")


def main():
    """Run the tests and print the table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("count", type=int)
    parser.add_argument("axes", type=int, choices=(1, 3))
    parser.add_argument("motions", nargs="*", type=motion_words)
    parser.add_argument("--first", type=int, default=1, help="seed of the first test")
    parser.add_argument("--multisine", action="store_true")
    given = parser.parse_args()
    axes, motions, table = given.axes, [(), (), *given.motions], Table()
    for seed in range(given.first, given.first + given.count):
        words, error = drawn_test(seed, axes, motions)
        shown = f"{seed}: {words} {error}"
        try:
            weighed = [MASS] * axes if seed % 2 else ()
            found = identified_of(words, axes, weighed) if given.multisine else ()
            fault_free = run((*words, *found), axes)
            if fault_free[1] is None:
                continue
            table.add("without error", fault_free, shown)
            after = run((*words, *found, *error), axes)
            table.add(AFTER if found else ALONE, after, shown)
            if found:
                known = identified_of((*words, *error), axes, weighed)
                table.add(BEFORE, run((*words, *error, *known), axes), shown)
        except InputError as refusal:
            table.counts["refused", "", ""] += 1
            print(f"refused: {refusal} {shown}", flush=True)
    table.show()


if __name__ == "__main__":
    main()
