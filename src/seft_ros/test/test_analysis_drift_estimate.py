"""Zeros of acceleration and force that move in a test, on signals of which they are known."""

import numpy as np
import pytest
from scipy.integrate import cumulative_trapezoid
from seft_plant_sim.calibration import SIGNIFICANT
from seft_ros.analysis.channel_estimates import acceleration_zero
from seft_ros.analysis.specimen_law import fine_law, force_drift

DT, COUNT = 0.002, 6000


def motion():
    """Displacement, velocity and acceleration of a slowly modulated sine, m."""
    t = DT * np.arange(COUNT)
    v = 0.2 * np.sin(2 * np.pi * 5.0 * t) * np.sin(np.pi * t / t[-1]) * np.sin(0.7 * t + 0.3)
    return cumulative_trapezoid(v, dx=DT, initial=0.0), v, np.gradient(v, DT)


def noise(size, seed):
    return size * np.random.default_rng(seed).standard_normal(COUNT)


@pytest.mark.parametrize("bias", [0.0, 0.05])
def test_the_zero_of_the_acceleration_is_found_whatever_the_motion(bias):
    x, _, a = (each[:, np.newaxis] for each in motion())
    a = a + bias + noise(0.05, 1)[:, np.newaxis]
    for part in (slice(0, 3000), slice(3000, COUNT)):
        zero, error = acceleration_zero(x[part] + 0.01, a[part], DT)
        assert zero[0] == pytest.approx(bias, abs=SIGNIFICANT * error[0])
        assert 0.0 < error[0] < 0.01


@pytest.mark.parametrize(
    ("kind", "moved", "how"),
    [
        ("elastic", 0.0, "slowly"),
        ("elastic", 12.0, "slowly"),
        ("elastic", 12.0, "at once"),
        ("bilinear", 0.0, "slowly"),
        ("bilinear", 12.0, "at once"),
        ("bilinear", 40.0, "from then on"),
    ],
)
def test_a_zero_of_the_force_that_moves_is_told_from_the_law(kind, moved, how):
    x, v, a = motion()
    yielding = np.zeros(COUNT)
    for k in range(1, COUNT):
        yielding[k] = np.clip(yielding[k - 1] + x[k] - x[k - 1], -1.7e-3, 1.7e-3)
    law = 2e5 * (x if kind == "elastic" else 0.1 * x + 0.9 * yielding)
    k = np.arange(COUNT)
    slowly, ramp = 0.5 - 0.5 * np.cos(np.pi * k / COUNT), np.maximum(k - 2439, 0) / (COUNT - 2439)
    shape = {"slowly": slowly, "at once": k >= 2439, "from then on": ramp}[how]
    force = law + 300.0 * v + moved * shape + noise(4.0, 2)
    fine = fine_law(x + noise(5e-6, 3), 2e-5)
    found, error, fitted = force_drift(fine, np.column_stack([v, a]), force)
    assert (abs(found) > SIGNIFICANT * error) is (moved > 0.0)
    assert found * moved >= 0.0
    if how != "slowly":
        assert found == pytest.approx(moved, rel=0.2)
        assert np.sqrt(np.mean((fitted - shape) ** 2)) < 0.15
