"""The tests of an identification as experiments, run offline."""

import numpy as np
import pytest
import scipy.signal
from experiments_at_hand import JHU, load, simulated
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.errors import InputError
from seft_ros.ground_motion.synthetic_motion import excitation
from seft_ros.identification.rig_tests import (
    Levels,
    Motions,
    check_levels,
    frequency_response,
    has_valve,
    motion_spectra,
    open_loop,
    pilot_voltage,
    voltage_after,
)
from seft_ros.test_run.parameter_tables import TABLES

LEVELS = Levels(voltage=0.1, force=200.0)


@pytest.fixture
def record(tmp_path):
    """A record for an experiment, of 10 s, and the unit excitation in it."""

    def make(of):
        band, seed = (1.0, 100.0), 1
        motions = Motions(of, LEVELS.force, band, seed)
        unit = excitation(5000, len(of.axes), of.timebase.dt, band, seed)
        return motions.write(tmp_path / "record.csv", 10.0), unit

    return make


TWO_AXES = ("axes:=[x, y]", "reference_force:model.mass:=[52.7, 3.0, 3.0, 40.0]")


@pytest.mark.parametrize("overrides", [(), TWO_AXES])
@pytest.mark.parametrize("mass_ratio", [0.0, 2.0])
def test_in_the_open_loop_the_record_drives_the_valves_whatever_the_experiment_was(
    record, overrides, mass_ratio
):
    of = load(
        *overrides,
        f"reference_force:mass_ratio:={mass_ratio}",
        "ground_motion:peak_force:=1000.0",
        "ground_motion:influence:=2.0",
    )
    path, unit = record(of)
    done = simulated(open_loop(of, path, LEVELS))
    commands = done.series["valve_command"].values[:, 0]
    np.testing.assert_allclose(commands[: len(unit)], LEVELS.voltage * unit, atol=1e-9)
    np.testing.assert_allclose(commands[len(unit) :], 0.0, atol=1e-9)
    assert np.abs(done.series["rig/state"].values[:, 3]).max() > 100.0


@pytest.mark.parametrize(
    ("levels", "told"),
    [
        (Levels(3.0, 200.0), "--amplitude is 3 V RMS.*voltage_limit, 10 V"),
        (Levels(0.0, 200.0), "--amplitude is 0 V"),
        (Levels(0.1, 5000.0), "--force is 5000 N RMS.*22200 N"),
        (Levels(0.1, 40e3), "in a band up to 20 Hz changes faster .* give 9.19e[+]03 N at most"),
        (Levels(0.1, -1.0), "--force is -1 N"),
        (Levels(float("nan"), 1.0), "--amplitude is nan"),
    ],
)
def test_levels_beyond_the_limits_are_refused(levels, told):
    with pytest.raises(InputError, match=told):
        check_levels(load(), levels, (0.3, 20.0))


def test_after_a_pilot_the_rig_uses_a_fifth_of_its_limits(record):
    of = load("rig:actuator.kind:=servo_hydraulic_linear")
    path, _ = record(of)
    low = Levels(pilot_voltage(of), LEVELS.force)
    pilot = simulated(open_loop(of, path, low))
    voltage = voltage_after(pilot, low.voltage)
    assert voltage > 2 * low.voltage
    states = (
        simulated(open_loop(of, path, Levels(voltage, LEVELS.force))).series["rig/state"].values
    )
    limits = of["supervisor"]
    shares = [
        np.abs(states[:, row]).max() / limits[f"limits.{name}"]
        for row, name in enumerate(("displacement", "velocity", "acceleration", "force"))
    ]
    assert max(shares) == pytest.approx(0.22, rel=0.05)


def test_a_rig_that_hardly_moves_gets_a_tenth_of_the_voltage_limit_and_no_more(record):
    of = load("rig:actuator.flow_gain:=1.0e-5", "rig:actuator.friction:=0.0")
    path, _ = record(of)
    low = Levels(pilot_voltage(of), LEVELS.force)
    assert voltage_after(simulated(open_loop(of, path, low)), low.voltage) == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("kind", "valve"), [("ideal", False), ("delay", False), ("servo_hydraulic", True)]
)
def test_idealised_actuators_have_no_valve(kind, valve):
    assert has_valve(load(f"rig:actuator.kind:={kind}")) is valve


def test_of_a_rig_that_is_not_described_a_valve_is_expected():
    tables = [table for table in TABLES if table.node != "rig"]
    assert has_valve(Experiment.load(tables, [JHU])) is True


RATE = 500.0
COUNT = 120_000
SEGMENT = 8.0
BAND = (1.0, 200.0)
INPUT, OUTPUT = slice(0, 1), slice(1, 2)


def resonator(u):
    """Resonance at 40 Hz, and its frequency response."""
    b, a = scipy.signal.iirpeak(40.0, 8.0, fs=RATE)
    return scipy.signal.lfilter(b, a, u), lambda f: scipy.signal.freqz(b, a, f, fs=RATE)[1]


def measured(noise, seed=1):
    rng = np.random.default_rng(seed)
    u = rng.standard_normal(COUNT)
    y, known = resonator(u)
    y = y + noise * rng.standard_normal(COUNT)
    found = frequency_response(
        motion_spectra(np.column_stack([u, y]), RATE, SEGMENT), INPUT, OUTPUT, BAND
    )
    return found, known(found.frequencies_hz)


def test_without_noise_it_is_the_known_response_with_coherence_1():
    found, known = measured(0.0)
    np.testing.assert_allclose(found.response[:, 0, 0], known, atol=0.02)
    assert found.coherence.min() > 0.99
    assert found.frequencies_hz[0] == BAND[0]
    assert found.frequencies_hz[-1] == BAND[1]


def test_coherence_is_the_share_of_power_that_the_input_explains():
    for noise in (0.1, 1.0, 3.0):
        found, known = measured(noise)
        share = np.abs(known) ** 2 / (np.abs(known) ** 2 + noise**2)
        bias = 1 / 29  # of the estimate where there is no coherence at all
        np.testing.assert_allclose(found.coherence.mean(), share.mean(), atol=1.5 * bias)
        at_peak = np.abs(found.frequencies_hz - 40.0).argmin()
        assert found.coherence[at_peak, 0] == pytest.approx(share[at_peak], abs=0.25)


def test_of_several_inputs_at_once_each_response_is_found():
    rng = np.random.default_rng(2)
    u = rng.standard_normal((COUNT, 2)) @ np.array([[1.0, 0.4], [0.0, 1.0]])  # correlated
    gains = np.array([[2.0, -0.5], [0.3, 1.5]])
    y = np.roll(u, 3, axis=0) @ gains.T + 0.1 * rng.standard_normal((COUNT, 2))
    found = frequency_response(
        motion_spectra(np.hstack([u, y]), RATE, SEGMENT), slice(0, 2), slice(2, 4), (2.0, 150.0)
    )
    turn = np.exp(-6j * np.pi * found.frequencies_hz / RATE)[:, np.newaxis, np.newaxis]
    np.testing.assert_allclose((found.response / turn).mean(axis=0), gains, atol=0.005)
    assert found.coherence.min() > 0.95
    np.testing.assert_allclose(
        np.abs(found.noise[:, 0, 1]).mean() / found.noise[:, 0, 0].real.mean(), 0, atol=0.3
    )
