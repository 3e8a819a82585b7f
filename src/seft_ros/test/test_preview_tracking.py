"""Preview tracking: the optimal inverse of a force loop, against closed forms and brute force."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import toeplitz
from seft_msgs_py.experiment import Experiment
from seft_ros.experiment.tables import TABLES
from seft_ros.reference_force.compensation.preview.preview_filter import CORNER as UPPER
from seft_ros.reference_force.compensation.preview.preview_filter import (
    HIGHEST_CORNER,
    LONGEST_HORIZON,
)
from seft_ros.reference_force.compensation.preview.preview_filter import HORIZON as FADING
from seft_ros.reference_force.compensation.preview.preview_tracking import PreviewTracking
from seft_ros.reference_force.compensation.preview.tracking_model import TrackingModel

DT, CORNER, HORIZON = 0.002, 0.14, 37
CONFIG = Experiment.load(TABLES, [Path(__file__).parents[3] / "config" / "jhu.yaml"])
JHU = TrackingModel.from_options(CONFIG["reference_force"], DT)
LAG = TrackingModel.sampled(np.ones(1), np.array([0.01, 1.0]), 0.0053, DT)
HZ = np.array([0.0, 1.0, 3.0, 7.0, 12.0, 20.0, 45.0, 70.0, 110.0])


def delay(steps):
    return TrackingModel.sampled(np.ones(1), np.ones(1), steps * DT, DT)


def responses(model, tracking, hz, dt=DT):
    """Responses of reference force and of measured force to the target."""
    z = np.exp(2j * np.pi * hz[:, None] * dt)
    matrices = z[..., None] * np.eye(len(model.a)) - model.a
    states = np.linalg.solve(matrices, model.b[None, :, None])[..., 0]
    past = z ** -np.arange(1.0, 1 + len(tracking.past)) @ tracking.past
    target = z ** np.arange(len(tracking.target)) @ tracking.target
    force = target / (1 - states @ tracking.state - past)
    return force, states @ model.c * force


def wiener(model, corner, order, hz):
    """The same with all of the target known: the non-causal minimiser, frequency by frequency."""
    z = np.exp(2j * np.pi * hz * DT)
    matrices = z[:, None, None] * np.eye(len(model.a)) - model.a
    loop = np.linalg.solve(matrices, model.b[None, :, None])[..., 0] @ model.c
    cost = (np.abs(1 - z) / (2 * np.sin(np.pi * corner))) ** (2 * order)
    inverse = loop.conj() / (np.abs(loop) ** 2 + cost)
    return inverse, loop * inverse


@pytest.mark.parametrize("model", [JHU, LAG, delay(7)])
@pytest.mark.parametrize(("corner", "order"), [(0.14, 4), (0.05, 2), (0.3, 6)])
def test_over_a_long_horizon_it_is_the_non_causal_minimiser(model, corner, order):
    tracking = PreviewTracking.design(model, 400, corner, order)
    found, exact = responses(model, tracking, HZ), wiener(model, corner, order, HZ)
    for one, other in zip(found, exact, strict=True):
        np.testing.assert_allclose(one, other, atol=1e-5 * np.abs(other).max())


@given(st.floats(2.0, 12.0), st.floats(0.003, 0.03), st.integers(20, 60), st.floats(0.05, 0.3))
@settings(max_examples=30, deadline=None)
def test_its_gain_at_rest_is_one_whatever_the_horizon(steps, lag, horizon, corner):
    model = TrackingModel.sampled(np.array([0.9]), np.array([lag, 1.0]), steps * DT, DT)
    force, measured = responses(model, PreviewTracking.design(model, horizon, corner), HZ[:1])
    assert measured[0] == pytest.approx(1.0, abs=1e-8)
    assert force[0] == pytest.approx(1 / 0.9, abs=1e-8)


def test_the_paper_s_loop_follows_earthquakes_within_a_thousandth():
    hz = np.linspace(0.0, 20.0, 41)
    _, measured = responses(JHU, PreviewTracking.design(JHU, HORIZON, CORNER), hz)
    assert np.abs(measured - 1).max() < 1e-3


@pytest.mark.parametrize("rate", [250, 500, 1000, 2000])
def test_at_any_rate_the_horizon_is_long_enough_for_it(rate):
    """At 250 Hz the corner is lower, and what comes after the horizon counts a little."""
    dt, hz = 1 / rate, np.linspace(0.0, 10.0, 21)
    model = TrackingModel.from_options(CONFIG["reference_force"], dt)
    horizon = min(LONGEST_HORIZON, int(np.ceil((model.delay(dt) + FADING) / dt)))
    tracking = PreviewTracking.design(model, horizon, min(UPPER * dt, HIGHEST_CORNER))
    _, measured = responses(model, tracking, hz, dt)
    assert np.abs(measured - 1).max() < (1e-3 if rate > 250 else 3e-3)


@pytest.mark.parametrize("steps", [1, 7, 20])
def test_a_pure_delay_is_met_by_the_advance_below_the_corner(steps):
    model, hz = delay(steps), np.linspace(0.0, 60.0, 30)
    force, _ = responses(model, PreviewTracking.design(model, 200, 0.49, order=8), hz)
    np.testing.assert_allclose(force, np.exp(2j * np.pi * hz * DT * steps), atol=1e-5)


@pytest.mark.parametrize("model", [JHU, LAG, delay(7)])
@pytest.mark.parametrize("horizon", [5, HORIZON])
def test_no_other_forces_cost_less(model, horizon):
    """A target that stays as it is beyond the horizon: least squares over a long window."""
    steps, order, rng = 500, 4, np.random.default_rng(horizon)
    wanted = np.full(steps, rng.normal())
    wanted[:horizon] = rng.normal(size=horizon).cumsum()
    impulse, states = np.zeros(steps), model.b
    for k in range(1, steps):
        impulse[k], states = model.c @ states, model.a @ states
    tracking_matrix = toeplitz(impulse, np.zeros(steps))
    binomial = np.poly(np.ones(order))
    column = np.concatenate([binomial, np.zeros(steps - order - 1)])
    rho = (2 * np.sin(np.pi * CORNER)) ** (-2 * order)
    rows = np.vstack([tracking_matrix, np.sqrt(rho) * toeplitz(column, np.zeros(steps))])
    best = np.linalg.lstsq(rows, np.concatenate([wanted, np.zeros(steps)]), rcond=1e-14)[0]

    tracking = PreviewTracking.design(model, horizon, CORNER)
    states, past, found = np.zeros(len(model.a)), np.zeros(order), []
    for k in range(steps // 2):
        window = wanted[k : k + horizon + 1]
        u = tracking.state @ states + tracking.past @ past + tracking.target @ window
        states = model.a @ states + model.b * u
        past = np.concatenate([[u], past[:-1]])
        found.append(u)
    np.testing.assert_allclose(found, best[: steps // 2], atol=1e-5 * np.abs(best).max())
