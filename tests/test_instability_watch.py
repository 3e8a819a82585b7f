"""The instability watch trips what grows by the loop's fault, and nothing else."""

import numpy as np
import pytest
from experiments_at_hand import load, simulated
from real_records import words_of
from seft_ros.design.planned_tests import PlannedTest
from seft_ros.design.stability_margins import instability_band
from seft_ros.test_run.blocks import with_method

pytestmark = pytest.mark.offline
THOROUGH = pytest.mark.thorough
MOTIONS = ("synthetic", "Kobe JMA", "El Centro")
IN_SHORT = ["synthetic", *(pytest.param(name, marks=THOROUGH) for name in MOTIONS[1:])]
PEAKS = {0.5: 500.0, 1.0: 500.0, 3.0: 250.0, 10.0: 120.0}  # mass ratio: N, what the valve serves
YIELDS = ("specimen.yield_displacement:=0.0038",)
SPECIMENS = {
    "linear": (),
    "bilinear": YIELDS,
    "bouc_wen": YIELDS,
    "pinching": YIELDS,
    "flag": YIELDS,
    "friction, 20 N": ("specimen.friction.force:=20.0",),
    "friction, 60 N": ("specimen.friction.force:=60.0",),
    "friction, 190 N": ("specimen.friction.force:=190.0",),
    "gap": ("specimen.gap.width:=0.002", "specimen.gap.stiffness:=2.11e5"),
    "duffing": ("specimen.duffing.cubic:=5e9",),
}
AT_ONCE = (("El Centro", 3.0, "friction, 190 N"), ("Kobe JMA", 0.5, "flag"))
VALID = [  # each specimen under each motion, and each at some of the mass ratios
    *(
        pytest.param(motion, list(PEAKS)[(row + column) % len(PEAKS)], specimen, marks=marks)
        for row, (motion, marks) in enumerate(zip(MOTIONS, ((), THOROUGH, THOROUGH), strict=True))
        for column, specimen in enumerate(SPECIMENS)
    ),
    *AT_ONCE,
]
HIGHER, LOWER = 6.0, 4.0
"""Ratios about the default, 5: there is a margin on either side."""


def run(motion, method, mass_ratio, peak_force, ratio, *words, loop_delay=0):
    """Record of a test, and its largest acceleration until it began to come down."""
    given = (
        *(*words_of(motion), f"ground_motion:peak_force:={peak_force}"),
        f"reference_force:mass_ratio:={mass_ratio}",
        f"reference_force:instability.ratio:={ratio}",
        f"loop_delay:={loop_delay}",
        *(f"rig:simulated.{word}" for word in words),
        "rig:detectors.warn_only:=all",
    )
    found = simulated(with_method(load(*given), method))
    until = None if found.trip is None else found.trip.step + 1
    return found, np.abs(found.series["rig/state"].values[:until, 2]).max()


@pytest.mark.parametrize(("motion", "mass_ratio", "specimen"), VALID)
def test_no_fault_free_test_trips_whatever_the_specimen_is(motion, mass_ratio, specimen):
    words = f"specimen.kind:={specimen.split(',')[0]}", *SPECIMENS[specimen]
    found, _ = run(motion, "target_motion", mass_ratio, PEAKS[mass_ratio], LOWER, *words)
    assert found.trip is None


@pytest.mark.parametrize("specimen", ["bilinear", "bouc_wen", "duffing"])
@pytest.mark.parametrize("motion", IN_SHORT)
def test_a_link_of_10_ms_to_a_specimen_that_yields_trips_nothing(motion, specimen):
    """The target is known late, each corner knocks the oil, and it rings for some cycles."""
    words = f"specimen.kind:={specimen}", *SPECIMENS[specimen]
    found, _ = run(motion, "target_motion", 1.0, 330.0, 5.0, *words, loop_delay=5)
    assert found.trip is None


@pytest.mark.parametrize("peak_force", [200.0, 1000.0])
@pytest.mark.parametrize("motion", IN_SHORT)
def test_an_unstable_test_shakes_as_foreseen_and_trips_long_before_a_limit(motion, peak_force):
    """Of the paper's: mass ratio 1.5, without compensation."""
    limit, _ = run(motion, "none", 1.5, peak_force, 0.0)
    assert limit.trip.reason.startswith("acceleration")
    low, high = instability_band(PlannedTest(limit.experiment))  # where preflight sees it start
    last = limit.series["rig/state"].values[-150:, 2, 0]
    spectrum = np.abs(np.fft.rfft(last * np.hanning(len(last))))
    assert low < np.fft.rfftfreq(len(last), 0.002)[spectrum.argmax()] < high
    found, largest = run(motion, "none", 1.5, peak_force, HIGHER)
    assert found.trip.reason.startswith("instability")
    assert found.trip.step < 0.8 * limit.trip.step
    assert largest < 0.25 * 39.24
