"""The coming target of preview_inverse against the whole structure, integrated step by step."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from seft_plant_sim.computed_substructure import ComputedSubstructure
from seft_ros.reference_force.compensation.compensator import Knowledge
from seft_ros.reference_force.compensation.preview.target_prediction import (
    WAY_BACK,
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


def coming(known, restoring, motion, ground_motion, rest, nominal=None, committed=()):
    """Displacements and velocities over the horizon, shape (1 + horizon, 2n).

    Over the first steps forces that are committed move the nominal specimen.
    """
    n, times = known.axes, DT * np.arange(len(ground_motion))
    inverse = np.linalg.inv(known.total_mass)

    def rate(t, y):
        a_g, p = (
            np.array([np.interp(t, times, column) for column in signal.T])
            for signal in (ground_motion, rest)
        )
        return np.concatenate([y[n:], -a_g - inverse @ (restoring @ y + p)])

    def driven(t, y):
        force = np.array([np.interp(t, times[: len(committed)], f) for f in committed.T])
        force -= nominal.restoring @ y
        return np.concatenate([y[n:], np.linalg.solve(nominal.mass, force)])

    found = [motion]
    for step, start in enumerate(times[:-1]):
        span = (start, start + DT)
        moving = driven if step + 1 < len(committed) else rate
        found.append(solve_ivp(moving, span, found[-1], rtol=1e-10, atol=1e-13).y[:, -1])
    return np.array(found)


def draw(n, seed=3):
    rng = np.random.default_rng(seed)
    motion = rng.normal(size=2 * n) * np.repeat([3e-3, 0.2], n)
    return motion, rng.normal(0, 4.0, (1 + HORIZON, n)), rng.normal(0, 200.0, (1 + HORIZON, n))


def all_of(gains, motion, ground_motion, rest, committed):
    """What gains make of all that is known."""
    known = motion, ground_motion.ravel(), rest.ravel(), committed.ravel()
    return sum(gain @ value for gain, value in zip(gains, known, strict=True))


def needed(known, restoring, nominal, path, ground_motion, rest):
    """Forces that move the nominal specimen along a path of the whole structure, (steps, n)."""
    r = path @ restoring.T + rest
    acceleration = np.linalg.solve(known.total_mass, -r.T).T - ground_motion
    return acceleration @ nominal.mass.T + path @ nominal.restoring.T


def forces_on_their_way(n, steps):
    return np.random.default_rng(steps).normal(0, 300.0, (1 + steps, n))


@pytest.mark.parametrize(
    ("felt", "steps"),
    [("not", 0), ("same mass", 0), ("other mass", 0), ("same mass", 1), ("other mass", 4)],
)
@pytest.mark.parametrize("varying", [False, True])
@pytest.mark.parametrize("n", [1, 2, 3])
def test_the_weighted_target_is_that_of_the_whole_structure(n, varying, felt, steps):
    known, restoring = structure(n, seed=n)
    mass = known.mass if felt == "same mass" else 40.0 * np.eye(n)
    nominal = None if felt == "not" else NominalSpecimen(mass, 1.3 * restoring)
    weights = np.random.default_rng(n).normal(size=(2, 1 + HORIZON))
    motion, ground_motion, rest = draw(n)
    rest = rest if varying else np.tile(rest[0], (1 + HORIZON, 1))
    committed = forces_on_their_way(n, steps)
    gains = TargetPrediction(known, weights, nominal, restoring, steps).gains()
    found = all_of(gains, motion, ground_motion, rest, committed)

    path = coming(known, restoring, motion, ground_motion, rest, nominal, committed)
    r = path @ restoring.T + rest
    acceleration = np.linalg.solve(known.total_mass, -r.T).T - ground_motion
    force = known.mass @ acceleration.T + r.T  # that the actuators of a perfect test measure
    if nominal is not None:  # what moves the nominal specimen as this one moves
        force = nominal.mass @ acceleration.T + nominal.restoring @ path.T
    np.testing.assert_allclose(found.reshape(2, n), weights @ force.T, rtol=1e-7)


@pytest.mark.parametrize("other", [1.0, 0.7])
@pytest.mark.parametrize("late", [0, 3])
@pytest.mark.parametrize("steps", [(0,), (1,), (HORIZON,), (0, 2, 5)])
@pytest.mark.parametrize("n", [1, 3])
def test_the_coming_departure_is_what_the_nominal_specimen_needs_beside_the_force(
    n, steps, late, other
):
    rng = np.random.default_rng(n)
    known, restoring = structure(n, seed=n)
    nominal = NominalSpecimen(other * known.mass, 1.3 * restoring)
    motion, ground_motion, rest = draw(n)
    prediction = TargetPrediction(known, np.zeros((1, 1 + HORIZON)), nominal, restoring, late)
    departures, targets = np.zeros((2, steps[-1] + 1, n, n))
    departures[list(steps)], targets[list(steps)] = rng.normal(size=(2, len(steps), n, n))
    committed = forces_on_their_way(n, late)
    gains = prediction.weighed(departures, targets)
    found = all_of(gains, motion, ground_motion, rest, committed)
    count = len(departures)
    path = coming(known, restoring, motion, ground_motion, rest, nominal, committed)[:count].T
    r = restoring @ path + rest[:count].T
    acceleration = -np.linalg.solve(known.total_mass, r) - ground_motion[:count].T
    force = known.mass @ acceleration + r
    target = nominal.mass @ acceleration + nominal.restoring @ path
    expected = np.einsum("tij,jt->i", departures, target - force)
    expected += np.einsum("tij,jt->i", targets, target)
    np.testing.assert_allclose(found, expected, rtol=1e-7, atol=1e-6)


@pytest.mark.parametrize("steps", [0, 1, 5])
@pytest.mark.parametrize("n", [1, 2, 3])
def test_the_coming_displacements_are_those_of_the_whole_structure(n, steps):
    known, restoring = structure(n, seed=n + 10)
    motion, ground_motion, rest = draw(n)
    nominal = NominalSpecimen(0.7 * known.mass, 1.3 * restoring) if steps else None
    committed, weights = forces_on_their_way(n, steps), np.zeros((1, 1 + HORIZON))
    gains = TargetPrediction(known, weights, nominal, restoring, steps).displacements()
    found = all_of(gains, motion, ground_motion, rest, committed)
    exact = coming(known, restoring, motion, ground_motion, rest, nominal, committed)[:, :n]
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
    gains = TargetPrediction(known, weights, None, restoring).gains()
    assert not gains.motion.any() and not gains.rest.any()
    np.testing.assert_allclose(gains.ground_motion, -np.kron(weights, known.mass))


@pytest.mark.parametrize("steps", [0, 1, 4])
@pytest.mark.parametrize("n", [1, 2])
def test_a_deviation_from_the_course_goes_back_where_nothing_is_committed(n, steps):
    """Of a motion on its course, with forces that keep it there, the target is the usual one."""
    known, restoring = structure(n, seed=n + 20)
    nominal = NominalSpecimen(0.8 * known.mass, 1.3 * restoring)
    weights = np.random.default_rng(n).normal(size=(2, 1 + HORIZON))
    prediction = TargetPrediction(known, weights, nominal, restoring, steps)
    course, ground_motion, rest = draw(n)
    committed = forces_on_their_way(n, steps)
    gains, (lowering, by_course) = prediction.gains(), prediction.mending()
    path = coming(known, restoring, course, ground_motion, rest)
    force = weights[0] @ needed(known, restoring, nominal, path, ground_motion, rest)
    deviation = np.random.default_rng(5).normal(size=2 * n) * np.repeat([1e-3, 0.1], n)
    moved = coming(known, restoring, course + deviation, ground_motion, rest, nominal, committed)
    told = course + deviation, ground_motion, rest, committed
    found = all_of(gains, *told)[:n] - all_of(lowering, *told) - by_course @ course
    # at first the motion is what is committed, thence the deviation from the course goes back
    w, inverse = 2 * np.pi * WAY_BACK, np.linalg.inv(known.total_mass)
    back = np.hstack([w * w * np.eye(n), 2 * w * np.eye(n)])
    system = np.vstack([np.eye(n, 2 * n, k=n), -inverse @ restoring - back])
    expected, d = force, None
    for step, weight in enumerate(weights[0]):
        d = moved[step] - path[step] if step <= steps else expm(system * DT) @ d
        by_motion = prediction.share @ restoring + nominal.restoring
        if step >= steps:
            by_motion = by_motion - nominal.mass @ back
        expected = expected + weight * by_motion @ d
    np.testing.assert_allclose(found, expected, rtol=1e-7, atol=1e-6)
