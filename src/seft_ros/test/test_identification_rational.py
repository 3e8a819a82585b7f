"""The plant as the loop samples it, against exact sampling in the time domain."""

import numpy as np
import pytest
from seft_ros.identification.plant_model import PlantModel, oil_column_model
from seft_ros.identification.rational import Rational, sampled
from seft_ros.loop_shaping.plant import identified_plant
from seft_ros.loop_shaping.roots import Root
from seft_ros.loop_shaping.sampling import SampledPlant


def model(dead_time=0.001, oil_hz=90.0, leakage=20.0):
    return oil_column_model(6.4e5, Root(10.0, 0.12), oil_hz, leakage, Root(60.0, 0.7), dead_time)


@pytest.mark.parametrize("rate", [200.0, 500.0, 2000.0])
@pytest.mark.parametrize("dead_time", [0.0, 0.0007, 0.002, 0.0113])
def test_hold_images_and_latency_are_those_of_exact_sampling(rate, dead_time):
    f = np.geomspace(0.3, 0.45 * rate, 300)
    plant = model(dead_time)
    rational = plant.rational()
    section = {"plant.numerator": rational.numerator, "plant.denominator": rational.denominator}
    section |= {"plant.dead_time": rational.dead_time}
    exact = SampledPlant.of(identified_plant(section, 1), 1 / rate).response(f)
    np.testing.assert_allclose(sampled(plant, f, 1 / rate), exact, rtol=3e-3)
    np.testing.assert_allclose(
        sampled(rational, f, 1 / rate), sampled(plant, f, 1 / rate), rtol=1e-9
    )


def test_factors_and_polynomials_are_the_same_function():
    s = 2j * np.pi * np.geomspace(0.1, 1000.0, 50)
    plant = PlantModel(
        3.0e5,
        (Root(5.0, 0.02), Root(31.0, 0.1)),
        (Root(70.0, 0.03), Root(33.0, 0.08)),
        Root(0.5),
        Root(55.0, 0.8),
        0.0023,
    )
    np.testing.assert_allclose(plant.rational()(s), plant(s), rtol=1e-9)
    pair = plant.with_pair(Root(12.0, 0.1))
    np.testing.assert_allclose(pair(s), plant(s), rtol=1e-12)


def test_a_pure_delay_turns_the_phase_by_hold_latency_and_dead_time():
    f, dt, dead_time = np.array([1.0, 5.0]), 0.002, 0.004
    low_pass = Rational((1.0,), (4e-4, 4e-2, 1.0), dead_time)
    own = -np.angle(low_pass.response(f)) / (2 * np.pi * f)
    total = own + dt + dt / 2
    np.testing.assert_allclose(
        -np.angle(sampled(low_pass, f, dt)) / (2 * np.pi * f), total, rtol=1e-3
    )


@pytest.mark.parametrize("leakage", [0.0, 20.0, 150.0])
@pytest.mark.parametrize("damping", [0.005, 0.3])
def test_the_oil_spring_has_the_poles_of_its_equations_of_motion(leakage, damping):
    """m v' = f - k x - c v,  f' = k_oil (q w - v) - lambda f."""
    m, w, oil_hz = 50.0, 2 * np.pi * 10.0, 90.0
    k, c = m * w**2, 2 * damping * w * m
    k_oil = m * (2 * np.pi * oil_hz) ** 2 - k
    a = np.array([[0, 1, 0], [-k / m, -c / m, 1 / m], [0, -k_oil, -leakage]])
    found = oil_column_model(1.0, Root(10.0, damping), oil_hz, leakage, Root(60.0, 0.7), 0.0)
    values = np.linalg.eigvals(a)
    pair = values[values.imag > 0][0]
    assert found.poles[0].hz == pytest.approx(abs(pair) / (2 * np.pi), rel=1e-9)
    assert found.poles[0].damping == pytest.approx(-pair.real / abs(pair), rel=1e-6)
    real = values[values.imag == 0].real[0]
    assert found.leakage.hz == pytest.approx(-real / (2 * np.pi), rel=1e-6, abs=1e-9)
