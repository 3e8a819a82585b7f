"""What blocked pistons cost a force controller that inverts the specimen."""

import numpy as np
from seft_ros.identification.blocked_compliance import BlockedCompliance
from seft_ros.identification.plant_fit import PlantFit
from seft_ros.identification.plant_model import oil_column_model
from seft_ros.identification.specimen_fit import SpecimenFit
from seft_ros.loop_shaping.roots import Root

DT, GAIN, LEAKAGE, G = 0.002, 6.8e5, 50.0, 1950.0
F = np.linspace(1.0, 15.0, 15)
SPECIMEN = SpecimenFit(
    np.diag([50.0, 60.0]),
    np.array([[900.0, -300.0], [-300.0, 700.0]]),
    np.array([[4e5, -2e5], [-2e5, 2e5]]),
    error=0.0,
)


def fit(size, hz):
    """Response of a valve that drives an actuator of a size against a specimen."""
    valve = Root(70.0, 0.6)
    model = oil_column_model(size * GAIN, Root(hz, 0.05), 90.0, LEAKAGE, valve, 0.001)
    return PlantFit(model, LEAKAGE, 0.0)


def test_sizes_are_those_of_the_actuators_whatever_their_specimens():
    found = BlockedCompliance.of([fit(1.0, 8.0), fit(2.5, 15.0), fit(0.5, 3.0)], G, DT)
    np.testing.assert_allclose(found.sizes, [1.0, 2.5, 0.5])


def test_the_error_is_what_the_inverse_of_the_specimen_needs():
    """u = g Z^-1 e and f = H u, so that e = Z (g H)^-1 f."""
    found = BlockedCompliance.of([fit(1.0, 8.0), fit(2.0, 15.0)], G, DT).error(SPECIMEN, F)
    s, valve = 2j * np.pi * F, 2 * np.pi * 70.0
    lag = np.exp(-s * (0.001 + 1.5 * DT))  # dead time, latency and half a step of hold
    blocked = GAIN * valve**2 / (s**2 + 1.2 * valve * s + valve**2) * lag / (s + LEAKAGE)
    for k, each in enumerate(s):
        resists = SPECIMEN.mass * each**2 + SPECIMEN.damping * each + SPECIMEN.stiffness
        exact = resists @ np.diag([1.0, 0.5]) / (G * blocked[k])
        np.testing.assert_allclose(found[k], exact, atol=0.1 * np.abs(exact).max())
