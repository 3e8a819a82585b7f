"""Low-order fits of closed loops."""

import numpy as np
import pytest
from seft_plant_sim.lti import TransferFunction
from seft_ros.design.response_fits import fit_tracking

F = np.arange(0.3, 100.0, 0.1)
ONES = np.ones(len(F))


def pair(hz, damping):
    w = 2 * np.pi * hz
    return np.array([1.0, 2 * damping * w, w * w])


def test_a_pair_with_dead_time_is_found():
    known = TransferFunction((pair(25.0, 0.6)[2],), tuple(pair(25.0, 0.6)), 0.008)
    fit = fit_tracking(F, known.response(F), ONES)
    assert fit.error < 1e-6
    assert fit.model.dead_time == pytest.approx(0.008, rel=1e-4)
    np.testing.assert_allclose(fit.model.denominator, pair(25.0, 0.6), rtol=1e-3)
    np.testing.assert_allclose(fit.model.numerator, [pair(25.0, 0.6)[2]], rtol=1e-3)


def test_further_pairs_are_added_where_the_response_needs_them():
    numerator = np.polymul(pair(10.2, 0.1), [pair(30.0, 0.7)[2] * 3000.0])
    denominator = np.polymul(np.polymul(pair(10.0, 0.12), pair(30.0, 0.7)), [1.0, 3000.0])
    known = TransferFunction(tuple(numerator), tuple(denominator), 0.007)
    fit = fit_tracking(F, known.response(F), ONES)
    assert fit.error < 0.01
    assert len(fit.model.denominator) == 5
    assert np.abs(fit.model.response(F) - known.response(F)).max() < 0.03


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_it_is_stable_whatever_the_data(seed):
    rng = np.random.default_rng(seed)
    noise = rng.standard_normal(len(F)) + 1j * rng.standard_normal(len(F))
    fit = fit_tracking(F, np.exp(-0.06j * F) + 0.5 * noise, ONES)
    assert np.roots(fit.model.denominator).real.max() < 0
    assert fit.model.dead_time >= 0


def test_noise_is_weighed_out():
    known = TransferFunction((pair(25.0, 0.6)[2],), tuple(pair(25.0, 0.6)), 0.008)
    rng = np.random.default_rng(1)
    deviation = np.where(F > 40.0, 0.3, 0.001)
    noise = deviation * (rng.standard_normal(len(F)) + 1j * rng.standard_normal(len(F)))
    fit = fit_tracking(F, known.response(F) + noise, 1 / np.hypot(deviation, 0.01))
    low = F < 40.0
    assert np.abs(fit.model.response(F) - known.response(F))[low].max() < 0.01


def test_the_dead_time_is_at_least_the_latency_that_is_there():
    """Lags in series may pass for a dead time and the other way round: 6 ms, of which 2 dead."""
    lags = 1 / np.polyval(np.polymul([0.002, 1.0], [0.002, 1.0]), 2j * np.pi * F)
    measured = lags * np.exp(-2j * np.pi * F * 0.002)
    free = fit_tracking(F, measured, ONES)
    held = fit_tracking(F, measured, ONES, least_dead_time=0.003)
    assert free.model.dead_time == pytest.approx(0.002, rel=0.05)
    assert held.model.dead_time >= 0.003
    assert held.error < 0.1
