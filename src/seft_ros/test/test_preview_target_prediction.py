"""The coming target of preview_inverse against the whole structure, integrated step by step."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from seft_plant_sim.computed_substructure import ComputedSubstructure
from seft_ros.reference_force.compensation.compensator import Knowledge
from seft_ros.reference_force.compensation.preview.target_prediction import (
    NominalSpecimen,
    TargetPrediction,
)

DT, HORIZON = 0.004, 9


def structure(n, seed):
    """Knowledge of a coupled structure, and (K, C)."""
    rng = np.random.default_rng(seed)

    def definite(scale, coupling):
        part = rng.normal(size=(n, n))
        return scale * (np.eye(n) + coupling * (part + part.T))

    mass, stiffness, damping = definite(50.0, 0.02), definite(2e5, 0.1), definite(800.0, 0.1)
    known = Knowledge(
        mass,
        ComputedSubstructure.lumped(rng.uniform(0.3, 4.0) * mass),
        damping,
        stiffness,
        DT,
        {},
    )
    return known, np.hstack([stiffness, damping])


def coming(known, restoring, motion, ground_motion, rest):
    """Displacements and velocities over the horizon, shape (1 + horizon, 2n)."""
    n, times = known.axes, DT * np.arange(len(ground_motion))
    inverse = np.linalg.inv(known.total_mass)

    def rate(t, y):
        a_g, p = (
            np.array([np.interp(t, times, column) for column in signal.T])
            for signal in (ground_motion, rest)
        )
        return np.concatenate([y[n:], -a_g - inverse @ (restoring @ y + p)])

    found = [motion]
    for start in times[:-1]:
        span = (start, start + DT)
        found.append(solve_ivp(rate, span, found[-1], rtol=1e-10, atol=1e-13).y[:, -1])
    return np.array(found)


def draw(n, seed=3):
    rng = np.random.default_rng(seed)
    motion = rng.normal(size=2 * n) * np.repeat([3e-3, 0.2], n)
    return motion, rng.normal(0, 4.0, (1 + HORIZON, n)), rng.normal(0, 200.0, (1 + HORIZON, n))


@pytest.mark.parametrize("felt", ["not", "same mass", "other mass"])
@pytest.mark.parametrize("varying", [False, True])
@pytest.mark.parametrize("n", [1, 2, 3])
def test_the_weighted_target_is_that_of_the_whole_structure(n, varying, felt):
    known, restoring = structure(n, seed=n)
    mass = known.mass if felt == "same mass" else 40.0 * np.eye(n)
    nominal = None if felt == "not" else NominalSpecimen(mass, 1.3 * restoring)
    weights = np.random.default_rng(n).normal(size=(2, 1 + HORIZON))
    motion, ground_motion, rest = draw(n)
    rest = rest if varying else np.tile(rest[0], (1 + HORIZON, 1))
    from_motion, from_ground, from_rest = TargetPrediction(
        known, weights, nominal, restoring
    ).gains()
    found = from_motion @ motion + from_ground @ ground_motion.ravel() + from_rest @ rest.ravel()

    path = coming(known, restoring, motion, ground_motion, rest)
    r = path @ restoring.T + rest
    acceleration = np.linalg.solve(known.total_mass, -r.T).T - ground_motion
    force = known.mass @ acceleration.T + r.T  # that the actuators of a perfect test measure
    if nominal is not None:  # what moves the nominal specimen as this one moves
        force = nominal.mass @ acceleration.T + nominal.restoring @ path.T
    np.testing.assert_allclose(found.reshape(2, n), weights @ force.T, rtol=1e-7)


@pytest.mark.parametrize("other", [1.0, 0.7])
@pytest.mark.parametrize("steps", [(0,), (1,), (HORIZON,), (0, 2, 5)])
@pytest.mark.parametrize("n", [1, 3])
def test_the_coming_departure_is_what_the_nominal_specimen_needs_beside_the_force(n, steps, other):
    rng = np.random.default_rng(n)
    known, restoring = structure(n, seed=n)
    nominal = NominalSpecimen(other * known.mass, 1.3 * restoring)
    motion, ground_motion, rest = draw(n)
    prediction = TargetPrediction(known, np.zeros((1, 1 + HORIZON)), nominal, restoring)
    departures, targets = np.zeros((2, steps[-1] + 1, n, n))
    departures[list(steps)], targets[list(steps)] = rng.normal(size=(2, len(steps), n, n))
    gains = prediction.weighed(departures, targets)
    inputs = motion, ground_motion.ravel(), rest.ravel()
    found = sum(gain @ value for gain, value in zip(gains, inputs, strict=True))
    count = len(departures)
    path = coming(known, restoring, motion, ground_motion, rest)[:count].T
    r = restoring @ path + rest[:count].T
    acceleration = -np.linalg.solve(known.total_mass, r) - ground_motion[:count].T
    force = known.mass @ acceleration + r
    needed = nominal.mass @ acceleration + nominal.restoring @ path
    expected = np.einsum("tij,jt->i", departures, needed - force)
    expected += np.einsum("tij,jt->i", targets, needed)
    np.testing.assert_allclose(found, expected, rtol=1e-7, atol=1e-6)


@pytest.mark.parametrize("n", [1, 2, 3])
def test_the_coming_displacements_are_those_of_the_whole_structure(n):
    known, restoring = structure(n, seed=n + 10)
    motion, ground_motion, rest = draw(n)
    gains = TargetPrediction(known, np.zeros((1, 1 + HORIZON)), None, restoring).displacements()
    from_motion, from_ground, from_rest = gains
    found = from_motion @ motion + from_ground @ ground_motion.ravel() + from_rest @ rest.ravel()
    exact = coming(known, restoring, motion, ground_motion, rest)[:, :n]
    np.testing.assert_allclose(found.reshape(-1, n), exact, rtol=1e-7, atol=1e-11)


def test_without_computed_mass_nothing_but_the_ground_motion_counts():
    known, restoring = structure(2, seed=4)
    known = Knowledge(
        known.mass,
        ComputedSubstructure.none(known.axes),
        known.damping,
        known.stiffness,
        DT,
        {},
    )
    weights = np.random.default_rng(1).normal(size=(1, 1 + HORIZON))
    motion, ground_motion, rest = TargetPrediction(known, weights, None, restoring).gains()
    assert not motion.any() and not rest.any()
    np.testing.assert_allclose(ground_motion, -np.kron(weights, known.mass))
