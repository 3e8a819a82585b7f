"""Known plants are found again from responses with noise."""

import numpy as np
import pytest
from seft_ros.identification.measurement import Measurement
from seft_ros.identification.plant_fit import fit_plant
from seft_ros.identification.plant_model import PlantModel, oil_column_model
from seft_ros.identification.rational import sampled
from seft_ros.loop_shaping.roots import Root

RIGS = {  # specimen, oil column in Hz, leakage in 1/s, valve, dead time in s, rate in Hz
    "paper": (Root(10.07, 0.1355), 90.0, 20.0, Root(60.0, 0.7), 0.001, 500.0),
    "soft, hardly damped": (Root(1.5, 0.005), 40.0, 5.0, Root(100.0, 0.9), 0.003, 500.0),
    "stiff, damped": (Root(28.0, 0.3), 150.0, 180.0, Root(150.0, 0.6), 0.0, 1000.0),
    "slow": (Root(4.0, 0.05), 35.0, 60.0, Root(30.0, 0.8), 0.006, 200.0),
    "fast": (Root(20.0, 0.02), 190.0, 100.0, Root(45.0, 0.5), 0.0005, 2000.0),
}


def measured(plant, rate, noise, seed=1, highest=200.0):
    """Response of a plant, each frequency with noise of the same power in force."""
    f = np.arange(0.3, min(0.45 * rate, highest), 0.0625)
    exact = sampled(plant, f, 1 / rate)
    rng = np.random.default_rng(seed)
    error = noise * (rng.standard_normal(len(f)) + 1j * rng.standard_normal(len(f))) / np.sqrt(2)
    coherence = np.abs(exact) ** 2 / (np.abs(exact) ** 2 + 13 * noise**2)
    return Measurement(f, exact + error, np.full(len(f), noise), coherence)


@pytest.mark.parametrize("name", RIGS)
@pytest.mark.parametrize("noise", [0.0, 5.0])
def test_poles_zeros_and_dead_time_are_found(name, noise):
    specimen, oil_hz, leakage, valve, dead_time, rate = RIGS[name]
    plant = oil_column_model(6e5, specimen, oil_hz, leakage, valve, dead_time)
    start = Root(1.02 * specimen.hz, 1.2 * specimen.damping)
    fit = fit_plant(measured(plant, rate, noise), 1 / rate, start)
    found, tight = fit.model, 1.0 if noise else 0.1
    assert found.zeros[0].hz == pytest.approx(specimen.hz, rel=0.01 * tight)
    assert found.zeros[0].damping == pytest.approx(specimen.damping, rel=0.25 * tight)
    assert found.poles[0].hz == pytest.approx(plant.poles[0].hz, rel=0.005 * tight)
    assert found.poles[0].damping == pytest.approx(plant.poles[0].damping, rel=0.05 * tight)
    assert found.valve.hz == pytest.approx(valve.hz, rel=0.03 * tight)
    assert found.valve.damping == pytest.approx(valve.damping, rel=0.03 * tight)
    assert found.dead_time == pytest.approx(dead_time, abs=1e-4 * tight)
    assert found.gain == pytest.approx(6e5, rel=0.02 * tight)
    assert fit.leakage == pytest.approx(leakage, rel=0.2 * tight)
    if not noise:
        assert fit.error < 2e-3


def test_the_error_grows_with_the_noise():
    plant = oil_column_model(6e5, *RIGS["paper"][:5])
    errors = [
        fit_plant(measured(plant, 500.0, noise), 0.002, RIGS["paper"][0]).error
        for noise in (0.0, 5.0, 50.0)
    ]
    assert errors[0] < 0.3 * errors[1] < 0.3 * errors[2]


def test_a_reversed_valve_has_a_negative_gain():
    plant = oil_column_model(-6e5, *RIGS["paper"][:5])
    fit = fit_plant(measured(plant, 500.0, 1.0), 0.002, RIGS["paper"][0])
    assert fit.model.gain == pytest.approx(-6e5, rel=0.01)


def test_a_resonance_above_half_the_rate_is_found_by_its_image():
    specimen, _, _, valve, dead_time, _ = RIGS["paper"]
    plant = oil_column_model(6e5, specimen, 150.0, 30.0, valve, dead_time)
    fit = fit_plant(measured(plant, 200.0, 1.0), 1 / 200.0, specimen)
    assert fit.error < 0.01
    assert fit.model.poles[0].hz == pytest.approx(plant.poles[0].hz, rel=0.01)


def test_another_pair_is_added_only_where_the_data_need_it():
    one = oil_column_model(6e5, *RIGS["paper"][:5])
    two = PlantModel(
        one.gain,
        (*one.zeros, Root(30.0, 0.02)),
        (*one.poles, Root(32.0, 0.03)),
        one.leakage,
        one.valve,
        one.dead_time,
    )
    simple, double = (
        fit_plant(measured(p, 500.0, 2.0), 0.002, one.zeros[0], 2) for p in (one, two)
    )
    assert len(simple.model.zeros) == 1
    assert len(double.model.zeros) == len(double.model.poles) == 2
    assert double.model.zeros[1].hz == pytest.approx(30.0, rel=0.01)
    assert double.model.poles[1].hz == pytest.approx(32.0, rel=0.01)
