"""The law with a corner: what it learns of a specimen that yields, and when it is used."""

import numpy as np
import pytest
from seft_ros.reference_force import restoring_model as models
from seft_ros.reference_force.stop_operators import stop_operators
from seft_ros.reference_force.yield_corner import FORETELLS, HOLDS, may_begin
from test_target_motion import K, followed

YIELDS, HARDENS = 0.003, 0.05
T = 0.002 * np.arange(3000)


def bilinear(x, v):
    """Restoring force of a specimen that yields."""
    stop = stop_operators(x, np.array([YIELDS]))[:, 0]
    return K * (HARDENS * x + (1.0 - HARDENS) * stop) + 800.0 * v


def sway(amplitude, cycles=4.0):
    """Displacement and velocity of a motion that grows."""
    w, grows = 2 * np.pi * cycles / T[-1], amplitude / T[-1]
    return grows * T * np.sin(w * T), grows * (np.sin(w * T) + w * T * np.cos(w * T))


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_corner_of_a_specimen_that_yields_is_found_and_used(seed):
    x, v = sway(0.012)
    _, state, left = followed(bilinear(x, v), x, v, seed=seed)
    assert state.corner.slider[0].stage == FORETELLS
    assert state.thresholds[0, models.CORNER] == pytest.approx(YIELDS, rel=0.02)
    assert state.values[0, 1] == pytest.approx(HARDENS * K, rel=0.1)
    assert state.values[0, 1 + 2 + models.CORNER] == pytest.approx((1.0 - HARDENS) * K, rel=0.02)
    assert np.abs(left[0, -800:]).max() < 8.0  # without a surprise, of 600 N


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_friction_is_found_though_noise_of_the_displacement_makes_25_newtons(seed):
    (x, v), sticks = sway(0.012, cycles=20.0), 2e-5
    stop = stop_operators(x, np.array([sticks]))[:, 0]
    seen = x + 2.6e-6 * np.random.default_rng(seed).standard_normal(len(x))
    _, state, _ = followed(K * x + 190.0 / sticks * stop + 800.0 * v, seen, v, seed=seed)
    assert state.corner.slider[0].stage == FORETELLS
    assert state.thresholds[0, models.CORNER] == pytest.approx(sticks, rel=0.15)
    friction = state.corner.law[0, 1 + 2 + models.CORNER] * state.thresholds[0, models.CORNER]
    assert friction == pytest.approx(190.0, rel=0.01)
    assert state.corner.law[0, 1] == pytest.approx(K, rel=0.01)


@pytest.mark.parametrize("stiffness", [K, 0.8 * K])
def test_an_elastic_specimen_has_no_corner(stiffness):
    x, v = sway(0.012)
    _, state, _ = followed(stiffness * x + 800.0 * v, x, v)
    assert state.corner.slider[0].stage != FORETELLS
    assert state.values[0, 1 + 2 + models.CORNER] == 0.0


def test_a_gap_that_closes_and_opens_is_not_taken_for_yielding():
    x, v = sway(0.012)
    force = K * x + 2 * K * np.sign(x) * np.maximum(np.abs(x) - YIELDS, 0.0) + 800.0 * v
    _, state, _ = followed(force, x, v)
    assert state.corner.slider[0].stage != FORETELLS


def test_a_specimen_that_no_longer_yields_is_not_said_to():
    """The law is refuted, and the other model is used."""
    x, v = sway(0.012)
    stiff = bilinear(x, v)
    late = 2000
    stiff[late:] = stiff[late - 1] + K * (x[late:] - x[late - 1])
    _, state, left = followed(stiff, x, v)
    assert state.sums[0].evidence < 0.0
    assert np.abs(left[0, -300:]).max() < 40.0


@pytest.mark.parametrize(("part", "is_none"), [(-0.4, False), (-0.6, True)])
def test_a_law_that_falls_faster_than_it_rises_is_none(part, is_none):
    x, v = sway(0.012)
    parameters, state, _ = followed(bilinear(x, v), x, v)
    law, laws = state.corner.law[0], parameters.corner
    law[1] = part * law[laws.place]
    assert may_begin(laws, state.corner, 0) == is_none


def test_a_test_begins_without_a_law():
    x, v = sway(0.012)
    parameters, state, _ = followed(bilinear(x, v), x, v)
    models.begin_model(parameters, state)
    assert not any(state.corner.slider[0])
    assert state.thresholds[0, models.CORNER] == HOLDS
