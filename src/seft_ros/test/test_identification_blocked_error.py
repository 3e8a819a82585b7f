"""The error of a force loop whose piston is held still."""

import numpy as np
import pytest
from seft_ros.identification.blocked_error import blocked_error
from seft_ros.identification.plant_fit import PlantFit
from seft_ros.identification.plant_model import oil_column_model
from seft_ros.loop_shaping.controller import Controller
from seft_ros.loop_shaping.roots import Root

DT, GAIN, LEAKAGE = 0.002, 6.8e5, 50.0
PAPER = Controller.from_coefficients([37.0], [1.0, 17.14, 4002.0])
F = np.linspace(0.5, 19.0, 20)


def of(specimen, controller=PAPER):
    valve = Root(70.0, 0.6)
    model = oil_column_model(GAIN, specimen, 90.0, LEAKAGE, valve, 0.001)
    return blocked_error(PlantFit(model, LEAKAGE, 0.0), controller, DT)


def test_it_is_the_inverse_of_oil_spring_valve_and_controller():
    s, valve = 2j * np.pi * F, 2 * np.pi * 70.0
    controller = PAPER.sampled_response(F, DT)
    lag = np.exp(-s * (0.001 + 1.5 * DT))  # dead time, latency and half a step of hold
    gain = controller * GAIN * valve**2 / (s**2 + 1.2 * valve * s + valve**2) * lag
    exact = (s + LEAKAGE) / gain
    found = np.polyval(of(Root(10.0, 0.1)), s)
    assert np.all(np.abs(found - exact) < 0.25 * np.abs(exact) + 1e-4)
    assert np.sqrt(np.mean(np.abs(found / exact - 1) ** 2)) < 0.1


def test_it_does_not_depend_on_the_specimen():
    np.testing.assert_array_equal(of(Root(10.0, 0.1)), of(Root(4.0, 0.02)))


def test_a_controller_of_twice_the_gain_halves_it():
    np.testing.assert_allclose(
        of(Root(10.0, 0.1), PAPER.scaled(2.0)), np.divide(of(Root(10.0, 0.1)), 2)
    )


@pytest.mark.parametrize("dt", [0.004, 0.0005])
def test_it_is_nearly_the_same_at_any_rate(dt):
    """But for the latency, which it holds."""
    model = oil_column_model(GAIN, Root(10.0, 0.1), 90.0, LEAKAGE, Root(70.0, 0.6), 0.001)
    found = blocked_error(PlantFit(model, LEAKAGE, 0.0), PAPER, dt)
    f = F[F < 15.0]
    lag = np.exp(-2j * np.pi * f * 1.5 * (DT - dt))
    expected = lag * np.polyval(of(Root(10.0, 0.1)), 2j * np.pi * f)
    np.testing.assert_allclose(np.polyval(found, 2j * np.pi * f), expected, atol=0.002)
