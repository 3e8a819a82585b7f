"""Uncompensated tests on the paper's rig come out as the paper's did (section 4)."""

import numpy as np
import pytest
from graph_tools import JHU, ROOT
from seft_msgs_py.config.experiment import Experiment
from seft_ros.analysis.summary import reference_of, summarise
from seft_ros.design.plan import Plan
from seft_ros.design.stability_margins import instability_band
from seft_ros.test_run.compiled_loop import build_blocks
from seft_ros.test_run.offline import simulate_test
from seft_ros.test_run.parameter_tables import TABLES

pytestmark = pytest.mark.offline
RECORDS = ROOT.parent / "shared" / "data"
MOTIONS = {
    "synthetic 1": {"synthetic.seed": 1},
    "synthetic 7": {"synthetic.seed": 7},
    "Kobe JMA": {"file": RECORDS / "kobe_jma_1995.txt", "column": 0},
    "El Centro": {"file": RECORDS / "elcentro_1940.txt", "column": 0},
    "Nishi-Akashi": {"file": RECORDS / "kobe_nishi_akashi_090.AT2"},
}
AT_ONCE = ("synthetic 1", "Kobe JMA")
HERE = [
    pytest.param(name, marks=() if name in AT_ONCE else pytest.mark.thorough)
    for name, motion in MOTIONS.items()
    if motion.get("file", ROOT).exists()
]


def uncompensated(name, mass_ratio, watched=0.0):
    """Run a test as the paper did, with nobody who looks for instability, or with."""
    overrides = [("ground_motion", key, _plain(value)) for key, value in MOTIONS[name].items()]
    overrides.append(("reference_force", "mass_ratio", mass_ratio))
    overrides.append(("reference_force", "instability.ratio", watched))
    experiment = Experiment.load(TABLES, [JHU], overrides)
    record = simulate_test(experiment, build_blocks(experiment))
    return record, summarise(record)


def _plain(value):
    return value if isinstance(value, int | float) else str(value)


def vibration(acceleration, rate):
    """Spectrum above 25 Hz: its RMS and the frequency of its peak."""
    hz = np.fft.rfftfreq(len(acceleration), 1 / rate)
    spectrum = np.abs(np.fft.rfft(acceleration))
    spectrum[hz < 25] = 0.0
    return np.sqrt(np.mean(np.fft.irfft(spectrum) ** 2)), hz[spectrum.argmax()]


@pytest.mark.parametrize("name", HERE)
def test_without_computed_mass_it_agrees(name):
    _, summary = uncompensated(name, 0.0)
    assert summary["stable"]
    displacement = summary["displacement"]
    assert displacement["nrmse_aligned"] < 0.1
    assert displacement["peak"] == pytest.approx(displacement["reference_peak"], rel=0.06)
    assert 0.012 < displacement["delay_s"] < 0.016


@pytest.mark.parametrize("name", HERE)
def test_with_computed_mass_the_response_is_too_small_and_vibrates(name):
    rms = {}
    for mass_ratio in (0.0, 0.5, 1.0):
        record, summary = uncompensated(name, mass_ratio)
        assert summary["stable"]
        if mass_ratio:
            assert summary["displacement"]["peak"] < 0.9 * summary["displacement"]["reference_peak"]
        acceleration = record.series["rig/state"].values[:, 2, 0]
        exact = reference_of(record).acceleration[:, 0]
        rate = record.experiment.timebase.rate
        rms[mass_ratio] = vibration(acceleration, rate)[0] / vibration(exact, rate)[0]
    assert rms[0.0] < rms[0.5] < rms[1.0]
    assert rms[1.0] > 3 * rms[0.0]


@pytest.mark.parametrize("name", HERE)
def test_at_a_mass_ratio_of_one_and_a_half_it_is_unstable_at_30_to_40_hz(name):
    record, summary = uncompensated(name, 1.5)
    assert not summary["stable"]
    assert "acceleration_range" in summary["saturated"]
    _, hz = vibration(record.series["rig/state"].values[:, 2, 0], record.experiment.timebase.rate)
    assert 30 < hz < 40


@pytest.mark.parametrize("name", HERE)
def test_it_goes_unstable_in_the_band_where_preflight_sees_it_start(name):
    record, summary = uncompensated(name, 1.5)
    assert not summary["stable"]
    low, high = instability_band(Plan(record.experiment))
    last = record.series["rig/state"].values[-150:, 2, 0]
    spectrum = np.abs(np.fft.rfft(last * np.hanning(len(last))))
    hz = np.fft.rfftfreq(len(last), record.experiment.timebase.dt)[spectrum.argmax()]
    assert low < hz < high


@pytest.mark.parametrize("name", HERE)
def test_the_watch_brings_it_down_softly_long_before_any_limit(name):
    record, summary = uncompensated(name, 1.5, watched=5.0)
    assert summary["trip"]["reason"].startswith("instability: acceleration above 20.1 Hz on axis x")
    assert not summary["saturated"]
    states = record.series["rig/state"].values
    limits = record.experiment["supervisor"]
    for row, quantity in enumerate(("displacement", "velocity", "acceleration", "force")):
        assert np.abs(states[:, row]).max() < 0.5 * limits[f"limits.{quantity}"]
    whole = reference_of(uncompensated(name, 0.0)[0])
    assert np.abs(states[:, 0]).max() < 1.5 * np.abs(whole.displacement).max()
    assert np.abs(record.series["reference_force"].values[-1]).max() == 0.0


@pytest.mark.parametrize("name", HERE)
def test_the_watch_leaves_the_papers_tests_alone(name):
    for mass_ratio in (0.0, 0.5, 1.0):
        assert uncompensated(name, mass_ratio, watched=5.0)[1]["trip"] is None
