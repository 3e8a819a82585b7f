"""Uncompensated tests on the paper's rig come out as the paper's did (section 4)."""

import numpy as np
import pytest
from experiments_at_hand import load, simulated
from real_records import words_of
from seft_ros.analysis.summary import summarise
from seft_ros.design.plan import Plan
from seft_ros.design.stability_margins import instability_band

pytestmark = pytest.mark.offline
MOTIONS = {
    "synthetic 1": ("ground_motion:synthetic.seed:=1",),
    "synthetic 7": ("ground_motion:synthetic.seed:=7",),
    **dict.fromkeys(("Kobe JMA", "El Centro", "Nishi-Akashi"), ()),
}
AT_ONCE = ("synthetic 1", "Kobe JMA")
HERE = [
    pytest.param(name, marks=() if name in AT_ONCE else pytest.mark.thorough) for name in MOTIONS
]


def uncompensated(name, mass_ratio, watched=0.0):
    """Run a test as the paper did, with nobody who looks for instability, or with."""
    test = load(
        *words_of(name, *MOTIONS[name]),
        f"reference_force:mass_ratio:={mass_ratio}",
        f"reference_force:instability.ratio:={watched}",
    )
    record = simulated(test)
    return record, summarise(record)


@pytest.mark.parametrize("name", HERE)
def test_it_goes_unstable_in_the_band_where_preflight_sees_it_start(name):
    record, summary = uncompensated(name, 1.5)
    assert not summary["stable"]
    low, high = instability_band(Plan(record.experiment))
    last = record.series["rig/state"].values[-150:, 2, 0]
    spectrum = np.abs(np.fft.rfft(last * np.hanning(len(last))))
    hz = np.fft.rfftfreq(len(last), record.experiment.timebase.dt)[spectrum.argmax()]
    assert low < hz < high
